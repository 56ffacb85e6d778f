"""What was acknowledged is there, however the writer ended.

SIGKILL leaves the kernel's cache alone, so that it says nothing about fsync: the order of the
fsyncs is checked in test_scanfile, calls that fail here and there.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from acquisition.errors import NotAScan
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from acquisition.sweep_codec import encode_sweep
from tests.acquisition.dying_writer import SLICES
from tests.acquisition.scan_cases import REPOSITORY, record, sweep

_LIMITED = """
import resource, sys
from pathlib import Path
from acquisition.errors import StorageFailed
from acquisition.scanfile import ScanFolder
from tests.acquisition.scan_cases import record, sweep
with ScanFolder.create(Path(sys.argv[1]), record(5)) as writer:
    writer.append(sweep(0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (20000, resource.RLIM_INFINITY))
    try:
        writer.append(sweep(1, profiles=40, points=200))
    except StorageFailed as failed:
        print(failed)
"""


def python(*arguments: object) -> str:
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def memory() -> Iterator[Path]:
    """A folder in memory where there is one: a killed process cannot tell it from a disk."""
    shared = Path("/dev/shm")
    with TemporaryDirectory(dir=shared if os.access(shared, os.W_OK) else None) as folder:
        yield Path(folder)


def died(mode: str, folder: Path, seeds: int) -> list[tuple[Path, set[int]]]:
    program = REPOSITORY / "tests" / "acquisition" / "dying_writer.py"
    lines = [line.split() for line in python(program, mode, folder, seeds).splitlines()]
    return [(folder / name, set(map(int, kept))) for name, *kept in lines]


def check_and_resume(path: Path, acknowledged: set[int]) -> None:
    """Nothing acknowledged is lost, nothing is damaged, and the scan can be finished."""
    found = ScanFolder.open(path).verify()
    assert found.damaged == ()
    assert acknowledged <= set(found.sound) <= acknowledged | {len(acknowledged)}
    with ScanFolder.open(path).resume() as writer:
        assert writer.set_aside == ()
        for index in writer.folder.missing():
            writer.append(sweep(index, profiles=4, points=1000))
        writer.finish(State.COMPLETE)
    for index in range(SLICES):
        taken = ScanFolder.open(path).read(index)
        assert encode_sweep(taken) == encode_sweep(sweep(index, profiles=4, points=1000))


def test_a_writer_killed_at_a_random_instant_loses_nothing_it_acknowledged(memory: Path) -> None:
    ends = died("instants", memory, 20)
    assert len(ends) == 20
    for path, acknowledged in ends:
        if not acknowledged and not (path / "scan.json").exists():
            ScanFolder.create(path, record()).close()  # killed before there was a scan
        else:
            check_and_resume(path, acknowledged)


def test_a_writer_killed_at_each_of_its_calls_loses_nothing_it_acknowledged(memory: Path) -> None:
    ends = died("calls", memory, 100)
    assert 6 * SLICES < len(ends) < 100, "the last child must come through"
    assert {len(acknowledged) for _, acknowledged in ends} == set(range(SLICES + 1))
    for path, acknowledged in ends:
        if not (path / "scan.json").exists():
            assert not acknowledged
            if path.exists():
                with pytest.raises(NotAScan):
                    ScanFolder.open(path)
            ScanFolder.create(path, record()).close()
        else:
            check_and_resume(path, acknowledged)


def test_a_limit_on_file_sizes_stops_the_scan_and_not_what_was_kept(tmp_path: Path) -> None:
    said = python("-c", _LIMITED, tmp_path / "part.scan")
    assert "part.scan: keeping slice 1 failed (File too large)" in said
    assert said.count("\n") == 1
    folder = ScanFolder.open(tmp_path / "part.scan")
    assert folder.verify().sound == (0,)
    assert folder.record().state is State.ABORTED
    assert not list((tmp_path / "part.scan" / "slices").glob(".*"))


def test_importing_acquisition_loads_no_fitting_and_no_other_package_of_ours() -> None:
    script = (
        "import sys, pkgutil, importlib, acquisition\n"
        "for each in pkgutil.iter_modules(acquisition.__path__):\n"
        "    importlib.import_module('acquisition.' + each.name)\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))\n"
    )
    loaded = set(python("-c", script).split())
    assert "acquisition" in loaded
    assert not loaded & {"scipy", "numba", "reconstruction", "loftscan", "sim", "matplotlib"}
