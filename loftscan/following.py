"""A .scan folder as a source of slices: read as it is, or followed while another program writes it.

A follower waits for three things, each of which another program brings about::

    the folder       at most so long as the operator's patience
    the next slice   so long as somebody appends: then the folder's lock is held
    the end          scan.json says complete or aborted; or the lock is free, and nobody will ever
                     say it: the scanner died

A damaged slice is left out and told; the others are used.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from acquisition.errors import DamagedSlice, NotAScan
from acquisition.folder_lock import is_locked
from acquisition.scan_record import ScanRecord, State, calibration_hash
from acquisition.scanfile import POLL_S, ScanFolder
from acquisition.settings import as_table
from loftscan.advising import advise
from loftscan.scans import Absent, Piece, arrival_of, layout_of_kind
from reconstruction.skinning.layout import Layout

PATIENCE_S = 60.0
RECORD = "scan.json"
_LOOK_S = 0.5  # between two looks at the lock: a look could meet a writer that wants it just then
_LOOKS = 2  # in a row must find it free


class Ending(Enum):
    """How a scan stands when nothing more is to be read of it."""

    COMPLETE = "complete"
    ABORTED = "aborted"  # its program said so
    INTERRUPTED = "interrupted"  # its program died without a word
    GOING_ON = "going on"  # somebody is appending


@dataclass(frozen=True, slots=True, eq=False)
class KeptScan:
    """A .scan folder and the slices that are in it now."""

    folder: ScanFolder

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.path.name

    @property
    def total(self) -> int | None:
        """How many slices the plan has, or chose."""
        return len(self.folder.decided())

    def pieces(self) -> Generator[Piece]:
        """Every slice of the plan, or why it is not there."""
        record = self.folder.record()
        for index in self.folder.decided():
            yield read_piece(self.folder, index, record)

    def layout(self) -> Layout:
        """As the plan had them taken."""
        return layout_of_kind(self.folder.record().plan.kind)

    def origin(self) -> Mapping[str, object]:
        """What was scanned with what; a hash over every slice file."""
        return describe(self.folder)

    def remarks(self) -> tuple[str, ...]:
        """A scan that is not complete."""
        return remark(self.folder, how_it_stands(self.folder))


@dataclass(frozen=True, slots=True, eq=False)
class FollowedScan:
    """A .scan folder that another program is writing, or will write."""

    path: Path
    patience_s: float = PATIENCE_S
    pause: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.path.name

    @property
    def total(self) -> int | None:
        """How many slices the plan has; not known before the folder is there, or all are chosen."""
        if not is_begun(self.path):
            return None
        record = self._folder.record()
        chosen = record.plan.adaptive is None or record.state is State.COMPLETE
        return len(self._folder.decided()) if chosen else None

    def pieces(self) -> Generator[Piece]:
        """The slices as they appear, in the order of their indices.

        Raises
        ------
        NotAScan
            Nothing appeared.
        """
        folder = self.appeared()
        record, state = folder.record(), StateWatch(folder)
        writer = WriterWatch(folder.path, self.clock)
        if record.plan.adaptive is not None:
            # They come in an order of their own; a surface is made from the lowest up, afterwards.
            advise(
                folder,
                lambda index: read_piece(folder, index, record),
                lambda: state.now() is not State.SCANNING or writer.gone(),
                self.pause,
            )
        for index in folder.decided():
            while not folder.file(index).exists():
                # After an end the file is looked for once more, by whoever reads it: what the
                # writer appended before its end is then in the folder.
                if state.now() is not State.SCANNING or writer.gone():
                    break
                self.pause(POLL_S)
            piece = read_piece(folder, index, record)
            waited = record.plan.adaptive is None
            yield _timed(piece, folder.file(index)) if waited else piece

    def appeared(self) -> ScanFolder:
        """Wait for the folder.

        Raises
        ------
        NotAScan
            It did not come, or is something else.
        """
        deadline_s = self.clock() + self.patience_s
        while not is_begun(self.path):
            if self.path.is_file():
                raise NotAScan(f"{self.path}: a file, no .scan folder; name the folder")
            if self.clock() >= deadline_s:
                raise NotAScan(
                    f"{self.path}: no scan began there within {self.patience_s:g} s; start"
                    f" `loftscan scan ... --out {self.path.name}`, or wait longer with --patience-s"
                )
            self.pause(POLL_S)
        return ScanFolder.open(self.path)

    def layout(self) -> Layout:
        """As the plan had them taken."""
        return layout_of_kind(self._folder.record().plan.kind)

    def origin(self) -> Mapping[str, object]:
        """What was scanned with what; a hash over every slice file."""
        return describe(self._folder)

    def remarks(self) -> tuple[str, ...]:
        """A scan that is not complete."""
        return remark(self._folder, how_it_stands(self._folder))

    @property
    def _folder(self) -> ScanFolder:
        return ScanFolder(self.path)


class StateWatch:
    """The state in scan.json, read again only when the file is another one."""

    def __init__(self, folder: ScanFolder) -> None:
        self._folder = folder
        self._seen: tuple[int, int] | None = None
        self._state = State.SCANNING

    def now(self) -> State:
        """What it says now."""
        found = (self._folder.path / RECORD).stat()
        if (found.st_ino, found.st_mtime_ns) != self._seen:
            # Looked at before it is read: a change in between is then seen the next time.
            self._seen = (found.st_ino, found.st_mtime_ns)
            self._state = self._folder.record().state
        return self._state


class WriterWatch:
    """Notices that nobody appends any more."""

    def __init__(self, folder: Path, clock: Callable[[], float]) -> None:
        self._folder = folder
        self._clock = clock
        self._next_look_s = clock()
        self._found_free = 0

    def gone(self) -> bool:
        """Whether the lock was found free some times in a row; once gone, gone for good."""
        if self._found_free >= _LOOKS or self._clock() < self._next_look_s:
            return self._found_free >= _LOOKS
        self._next_look_s = self._clock() + _LOOK_S
        self._found_free = 0 if is_locked(self._folder) else self._found_free + 1
        return self._found_free >= _LOOKS


def read_piece(folder: ScanFolder, index: int, record: ScanRecord) -> Piece:
    """Read a slice and lay it into the part frame; say so where it is damaged or not there."""
    try:
        sweep = folder.read(index)
    except FileNotFoundError:
        return Absent(index)
    except DamagedSlice as damaged:
        return Absent(index, str(damaged.__cause__))
    if not sweep.poses:
        return Absent(index, "it holds no profile")
    return arrival_of(sweep, record.calibration, record.plan.kind)


def _timed(piece: Piece, file: Path) -> Piece:
    if isinstance(piece, Absent):
        return piece
    return replace(piece, appeared_s=file.stat().st_mtime_ns * 1e-9)


def how_it_stands(folder: ScanFolder) -> Ending:
    """Tell whether a scan is over, and how. Complete is what has every slice, whoever says so.

    Only an adaptive scan's program knows that every slice is there.
    """
    if folder.is_whole():
        return Ending.COMPLETE
    # The lock first: a writer says the state before it lets go.
    locked, state = is_locked(folder.path), folder.record().state
    if state is State.SCANNING:
        return Ending.GOING_ON if locked else Ending.INTERRUPTED
    return Ending.ABORTED


def remark(folder: ScanFolder, ending: Ending) -> tuple[str, ...]:
    """Say what is wrong with an ending, and what to do."""
    name = folder.path.name
    resume = f"`loftscan scan STATION.toml PLAN.toml --out {name} --resume`"
    sentences = {
        Ending.COMPLETE: (),
        Ending.ABORTED: (f"{name}: the scan was stopped; {resume} takes the rest",),
        Ending.INTERRUPTED: (
            f"{name}: the program that scanned died before the end; what it kept is used, and"
            f" {resume} takes the rest",
        ),
        Ending.GOING_ON: (
            f"{name}: the scan is still going on and later slices are not in this result; use"
            " --follow to wait for its end",
        ),
    }
    return sentences[ending]


def describe(folder: ScanFolder) -> Mapping[str, object]:
    """What provenance.json says of a .scan folder: no address, path or host."""
    record = folder.record()
    digest, size = _hash_slices(folder)
    return {
        "name": folder.path.name,
        "format": "scan",
        "unit": "mm",
        "bytes": size,
        "sha256": digest,
        "slices": len(folder.indices()),
        "state": how_it_stands(folder).value,
        "software": record.software,
        "scanned": record.created,
        "calibration_sha256": calibration_hash(record.calibration),
        "plan": as_table(record.plan),
        "station": _without_addresses(as_table(record.station)),
    }


def _hash_slices(folder: ScanFolder) -> tuple[str, int]:
    """SHA-256 over the names and hashes of the slice files, and their size together."""
    whole, size = hashlib.sha256(), 0
    for index in folder.indices():
        file = folder.file(index)
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            size += stream.tell()
        whole.update(f"{digest}  {file.name}\n".encode())
    return whole.hexdigest(), size


def _without_addresses(table: Mapping[str, object]) -> dict[str, object]:
    return {
        key: _without_addresses(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if not (isinstance(value, str) and "://" in value)
    }


def is_begun(path: Path) -> bool:
    """Whether there is a scan at a path: its folder alone is not enough."""
    return (path / RECORD).exists()
