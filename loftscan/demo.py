"""The demo: a simulated station scans a part, and the reconstruction follows while it scans.

Three processes, as at a real station, and nothing between them but wires and a folder::

    python -m sim            ==wires==  loftscan scan  --OUT.scan/-->  this one: sections, result
    truth of the part                                                      |
        '------------------> python -m sim.judging <------- OUT/mesh.stl --'

The scan's own process can die, and this one notices; nothing of the truth is worked out here.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from loftscan.following import FollowedScan
from loftscan.result import OutputExists
from loftscan.scans import Piece
from loftscan.simulation import Simulated
from reconstruction.skinning.layout import Layout

_END_S = 10.0  # laser off, axes stopped, links closed


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

    def look(self) -> None:
        """See whether it goes well: no slice will come of a scan that failed.

        Raises
        ------
        ScanFailed
            Says what it said.
        """
        code = self.process.poll()
        if code is not None and code < 0:
            raise ScanFailed(f"the scan was killed by signal {-code}; {self._kept()}", 1)
        if code:
            raise ScanFailed(self._last_words() or f"the scan failed; {self._kept()}", code)

    def end(self) -> None:
        """See whether it ended well, now that it has no more to say.

        Raises
        ------
        ScanFailed
        """
        try:
            self.process.wait(_END_S)
        except subprocess.TimeoutExpired as hanging:
            raise ScanFailed(f"the scan hangs at its end; {self._kept()}", 1) from hanging
        self.look()

    def pause(self, seconds: float) -> None:
        """Let some time pass for a follower.

        Raises
        ------
        ScanFailed
        """
        self.look()
        time.sleep(seconds)

    def _last_words(self) -> str:
        lines = self.said.read_text(errors="replace").strip().splitlines()
        words = lines[-1].removeprefix("loftscan: ") if lines else ""
        # Its station ends with the demo, so nobody can go on with it.
        return re.sub(r"(slices are kept), go on with: .*", rf"\1 in {self.folder}", words)

    def _kept(self) -> str:
        return f"what it kept is in {self.folder}"


@dataclass(frozen=True, slots=True, eq=False)
class SupervisedScan:
    """A scan that is followed, and that must end well: a failed one gives no result."""

    followed: FollowedScan
    scan: Scanning

    @property
    def name(self) -> str:
        """The folder's own name, so that a replay of it gives the same result."""
        return self.followed.name

    @property
    def total(self) -> int | None:
        """How many slices the plan has."""
        return self.followed.total

    def pieces(self) -> Generator[Piece]:
        """The slices as they appear.

        Raises
        ------
        ScanFailed
        """
        with closing(self.followed.pieces()) as pieces:
            yield from pieces
        self.scan.end()

    def layout(self) -> Layout:
        """As the plan had them taken."""
        return self.followed.layout()

    def origin(self) -> Mapping[str, object]:
        """What was scanned with what."""
        return self.followed.origin()

    def remarks(self) -> tuple[str, ...]:
        """What a person should know of its end."""
        return self.followed.remarks()


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
