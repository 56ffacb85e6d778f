"""The demo: a simulated station scans a part, and the reconstruction follows while it scans.

Three processes, as at a real station, and nothing between them but wires and a folder::

    python -m sim            ==wires==  loftscan scan  --OUT.scan/-->  this one: sections, result
    truth of the part                                                      |
        '------------------> python -m sim.judging <------- OUT/mesh.stl --'

The scan's own process can die, and this one notices; nothing of the truth is worked out here.
"""

from __future__ import annotations

import itertools
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from acquisition.scanfile import ScanFolder
from loftscan.result import OutputExists
from loftscan.simulation import Simulated

_END_S = 10.0  # laser off, axes stopped, links closed
_PATIENCE_S = 60.0


class ScanFailed(Exception):  # noqa: N818 (the house names errors after the fact)
    """The scan's process ended early; `code` is its exit code."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Scanning:
    """The process that scans, and where its slices appear."""

    process: subprocess.Popen[bytes]
    folder: Path
    said: Path

    def pause(self, seconds: float) -> None:
        """Let some time pass for a follower; no slice will come of a scan that failed.

        Raises
        ------
        ScanFailed
        """
        if self.process.poll() not in (None, 0):
            raise ScanFailed(self._last_words(), self.process.returncode)
        time.sleep(seconds)

    def _last_words(self) -> str:
        lines = self.said.read_text(errors="replace").strip().splitlines()
        words = lines[-1] if lines else f"the scan ended with exit code {self.process.returncode}"
        return words.removeprefix("loftscan: ")


def check_scan_folder(folder: Path, *, overwrite: bool) -> None:
    """Make room for the demo's .scan folder; with `overwrite` an older scan goes.

    Raises
    ------
    OutputExists
    """
    if not folder.exists():
        return
    if not overwrite:
        raise OutputExists(f"{folder}: is there already; name another --out, or add --overwrite")
    if not (folder / "scan.json").exists():
        raise OutputExists(f"{folder}: holds no scan, so it is not overwritten")
    shutil.rmtree(folder)


@contextmanager
def scanning(station: Simulated, folder: Path) -> Iterator[Scanning]:
    """Run ``loftscan scan`` beside this process; stopped, laser off, when the block is left."""
    files = [str(station.station), str(station.plan), "--out", str(folder)]
    command = [sys.executable, "-P", "-m", "loftscan.cli", "scan", *files]
    with tempfile.TemporaryDirectory(prefix="loftscan-demo-") as own:
        said = Path(own) / "said.txt"
        with said.open("wb") as errors:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is for the demo, which stops it in its own way
            )
        try:
            yield Scanning(process, folder, said)
        finally:
            _end(process)


def slice_period_s(folder: Path) -> float:
    """Median time between two slices, by the files' times."""
    scan = ScanFolder(folder)
    times_s = sorted(scan.file(index).stat().st_mtime_ns * 1e-9 for index in scan.indices())
    steps = [after - before for before, after in itertools.pairwise(times_s)]
    return statistics.median(steps) if steps else 0.0


def judge(part: str, mesh: Path) -> dict[str, float]:
    """Ask the simulator how far a mesh lies from the part that was truly there.

    Raises
    ------
    ScanFailed
        It could not tell; says what it said.
    """
    command = [sys.executable, "-P", "-m", "sim.judging", str(mesh), "--part", part]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    if told.returncode:
        raise ScanFailed(told.stderr.strip().splitlines()[-1], 1)
    found: dict[str, float] = json.loads(told.stdout)
    return found


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
