"""What tests of several folders share: the scans outside the checkout, and one finished run."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import settings

from loftscan.result import Result
from tests.system.command_cases import FloatArray, scanned_part, start, write_cloud

# The same examples in every run, so that a run that fails can be run again. Others, of a new seed
# each time, are looked through with --hypothesis-profile=exploring.
settings.register_profile("steady", derandomize=True)
settings.register_profile("exploring")
settings.load_profile("steady")

_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure() -> None:
    """Hear Ctrl-C and SIGHUP: a shell's background job ignores the one, nohup the other.

    All that the tests start would inherit that, and go on when it is told to stop.
    """
    heard = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    for number, handler in heard.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of test data: LOFTSCAN_DATA, or ../shared/data beside the checkout."""
    named = os.environ.get("LOFTSCAN_DATA")
    folder = Path(named) if named else _BESIDE
    if not (folder / "scans").is_dir():
        pytest.skip(f"no test data: {'LOFTSCAN_DATA' if named else '../shared/data'} has no scans")
    return folder


@dataclass(frozen=True)
class Saved:
    """A result that the console script made, and what it said."""

    cloud: Path
    folder: Path
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def part_points() -> FloatArray:
    return scanned_part()


@pytest.fixture(scope="session")
def saved(part_points: FloatArray, tmp_path_factory: pytest.TempPathFactory) -> Saved:
    """The part of `command_cases` through the console script, all files, in its own process."""
    return _save(part_points, tmp_path_factory.mktemp("saved"))


@pytest.fixture(scope="session")
def paper_saved(part_points: FloatArray, tmp_path_factory: pytest.TempPathFactory) -> Saved:
    """The same, by the method of the paper."""
    return _save(part_points, tmp_path_factory.mktemp("paper"), "--method", "paper")


def _save(points: FloatArray, place: Path, *options: str) -> Saved:
    cloud = write_cloud(place / "part.xyz", points)
    child = start("reconstruct", cloud, "--out", place / "result", "--tolerance-mm", "1", *options)
    stdout, stderr = child.communicate(timeout=120)
    assert child.returncode == 0, stderr
    return Saved(cloud, place / "result", stdout, stderr)


@pytest.fixture(scope="session")
def part_result(part_points: FloatArray) -> Result:
    """The same part by the Python verb."""
    from loftscan import reconstruct

    return reconstruct(part_points, tolerance_mm=1.0)


@pytest.fixture(autouse=True)
def patient_guards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leases of seconds where pytest itself owns a station.

    Machines that test also stall, and a guard kills the process that lets its lease lapse: that
    would be pytest. The true time to live is that of every process of its own, as `make safety`
    and the tests of the guard start them.
    """
    import acquisition.opening

    monkeypatch.setattr(acquisition.opening, "TTL_S", 3.0)


@pytest.fixture(scope="session")
def paper_result(part_points: FloatArray) -> Result:
    """The same part by the method of the paper."""
    from loftscan import reconstruct

    return reconstruct(part_points, method="paper", tolerance_mm=1.0)


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without their pictures, for tests that are about something else."""
    import loftscan.comparison_report
    import loftscan.reporting

    def write(path: Path, *_: object) -> None:
        path.write_text("<html></html>", encoding="utf-8")

    monkeypatch.setattr(loftscan.reporting, "write_result_report", write)
    monkeypatch.setattr(loftscan.comparison_report, "write_comparison_report", write)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in; temporary files, too, go under it."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.chdir(tmp_path)
    return tmp_path
