"""The .scan folder: the queue between the scan and whatever eats its slices.

::

    NAME.scan/  scan.json               record and state (docs/scan-folder.md)
                scan.spare.json         the same as it was at the start: for a repair
                slices/000000.npz       one sweep each: whole or not there
                slices/000007.npz.damaged       set aside, never deleted
                slices/.ahead-3.part            under work, or to be; nobody reads it
                choices.jsonl           of an adaptive scan: why each slice (`acquisition.choices`)
                .lock                   who appends

Completion is the set of indices that are there, never a counter; an adaptive scan, which chooses
its slices on the way, says besides in choices.jsonl that it wants no more. `ScanFolder` reads, from
any number of processes; `ScanWriter` appends, from one. `ScanWriter.append` returns when the slice
is on the disk.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from acquisition.choices import choices_in, is_ended
from acquisition.durable import (
    name_ahead,
    rename_whole,
    storage,
    sync_folder,
    temporary,
    write_named,
    write_whole,
)
from acquisition.errors import AlreadyKept, DamagedSlice, NotAScan, StorageFailed
from acquisition.folder_lock import LOCK, FolderLock
from acquisition.poses import Sweep
from acquisition.scan_record import ScanRecord, State, decode_record, encode_record
from acquisition.sweep_codec import decode_sweep, encode_sweep, has_checksum

AHEAD = 8  # slices for whose names the folder is synced at once
POLL_S = 0.02  # how long `follow` asks for in one pause
RECORD, SPARE, SLICES = "scan.json", "scan.spare.json", "slices"
_NAME = re.compile(r"(\d{6,})\.npz")


@dataclass(frozen=True, slots=True)
class Damage:
    """A slice file that does not hold what was written."""

    file: Path
    why: str


@dataclass(frozen=True, slots=True)
class Verification:
    """What a full reading of a folder found."""

    sound: tuple[int, ...]
    damaged: tuple[Damage, ...]
    missing: tuple[int, ...]  # of the plan's indices; a damaged slice is missing, too
    unchecked: tuple[int, ...] = ()  # of the sound: older files, which have no checksum


@dataclass(frozen=True, slots=True)
class ScanFolder:
    """A .scan folder, for reading."""

    path: Path

    @classmethod
    def create(cls, path: Path, record: ScanRecord) -> ScanWriter:
        """Begin a scan in a folder that is new, or empty.

        Raises
        ------
        FileExistsError
            Something is there; it is left as it is.
        StorageFailed, ScanInUse
        """
        _refuse_what_is_there(path)
        with storage(path, "creating the scan"):
            new = [each for each in (path, *path.parents) if not each.exists()]
            (path / SLICES).mkdir(parents=True, exist_ok=True)
            lock = FolderLock(path)
        with ExitStack() as undo:
            undo.callback(lock.release)
            _refuse_what_is_there(path)
            with storage(path, "creating the scan"):
                write_whole(path / SPARE, encode_record(record))
                write_whole(path / RECORD, encode_record(record))
                for each in new:
                    sync_folder(each.parent)
            undo.pop_all()
        return ScanWriter(cls(path), lock, record, ())

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing scan for reading.

        Raises
        ------
        NotAScan
        """
        folder = cls(path)
        folder.record()
        return folder

    def resume(self) -> ScanWriter:
        """Open for appending: rests of a dead writer go, damaged slices are set aside.

        Raises
        ------
        ScanInUse, StorageFailed, NotAScan
        """
        with storage(self.path, "locking the folder"):
            lock = FolderLock(self.path)
        with ExitStack() as undo:
            undo.callback(lock.release)
            record = self.record()
            with storage(self.path, "tidying the folder"):
                aside = self._tidied()
            writer = ScanWriter(self, lock, record, aside)
            if not self.is_whole():
                writer.mark(State.SCANNING)
            undo.pop_all()
        return writer

    def record(self) -> ScanRecord:
        """Read scan.json.

        Raises
        ------
        NotAScan
        """
        try:
            return decode_record((self.path / RECORD).read_bytes())
        except FileNotFoundError as absent:
            raise NotAScan(f"{self.path}: no {RECORD} there; is it a .scan folder?") from absent
        except OSError as unread:
            raise NotAScan(
                f"{self.path}: {RECORD} cannot be read: {unread.strerror}; may you read it, and is"
                " the disk sound? if not, copy the folder to another disk"
            ) from unread
        except ValueError as bad:
            raise NotAScan(
                f"{self.path}: {bad}; mend it: loftscan scans repair {self.path}"
            ) from bad

    def indices(self) -> tuple[int, ...]:
        """Indices of the slices that are there, increasing."""
        with storage(self.path, "listing the slices"):
            files = list((self.path / SLICES).glob("*.npz"))
        names = (_NAME.fullmatch(each.name) for each in files)
        return tuple(sorted(int(name[1]) for name in names if name))

    def decided(self) -> tuple[int, ...]:
        """Indices of the slices that are wanted as far as is known, increasing.

        All of the plan's; of an adaptive one the coarse ones, those chosen so far, those there.
        """
        plan = self.record().plan
        wanted = set(plan.first_indices)
        if plan.adaptive is not None:
            chosen = {each.index for each in choices_in(self.path) if each.index is not None}
            wanted |= {index for index in chosen if index < plan.count} | set(self.indices())
        return tuple(sorted(wanted))

    def missing(self) -> tuple[int, ...]:
        """Decided indices that are not there, increasing: what a resumed scan takes first."""
        there = set(self.indices())
        return tuple(index for index in self.decided() if index not in there)

    def is_whole(self) -> bool:
        """Whether no slice is wanted that is not there."""
        ended = self.record().plan.adaptive is None or is_ended(self.path)
        return ended and not self.missing()

    def read(self, index: int) -> Sweep:
        """Read one slice.

        Raises
        ------
        FileNotFoundError
            It is not there.
        DamagedSlice
            It is not what was written; names the file and the remedy.
        StorageFailed
            The disk does not give it back.
        """
        return self._decoded(index, self._bytes(index))

    def verify(self) -> Verification:
        """Read every slice in full: checksums, counts, names."""
        sound: list[int] = []
        unchecked: list[int] = []
        damaged: list[Damage] = []
        for index in self.indices():
            if (why := self.damage_of(index)) is not None:
                damaged.append(Damage(self.file(index), why))
                continue
            sound.append(index)
            if not has_checksum(self.file(index).read_bytes()):
                unchecked.append(index)
        there = set(sound)
        missing = (index for index in self.decided() if index not in there)
        return Verification(tuple(sound), tuple(damaged), tuple(missing), tuple(unchecked))

    def damage_of(self, index: int) -> str | None:
        """Say why a slice that is there cannot be read; None when it can."""
        try:
            self.read(index)
        except DamagedSlice as bad:
            return str(bad.__cause__)
        except StorageFailed as unread:
            return f"the disk does not give it back ({os.strerror(unread.errno or errno.EIO)})"
        return None

    def follow(self, pause: Callable[[float], None], stop: Callable[[], bool]) -> Iterator[Sweep]:
        """Yield the slices in the order of their indices, as they appear.

        Those of an adaptive scan in the order in which they were taken. Ends when `stop` says so,
        and after the last slice once scan.json says complete or aborted (what is missing then is
        left out). Every wait is one call of `pause`, 20 ms.

        Raises
        ------
        DamagedSlice, NotAScan
        """
        if self.record().plan.adaptive is not None:
            yield from self._follow_chosen(pause, stop)
            return
        for index in self.record().indices:
            while not self.file(index).exists():
                if stop():
                    return
                # The state is read first: what its writer appended before is then in the folder.
                if self.record().state is not State.SCANNING and not self.file(index).exists():
                    break
                pause(POLL_S)
            else:
                if stop():
                    return
                yield self.read(index)

    def _follow_chosen(
        self, pause: Callable[[float], None], stop: Callable[[], bool]
    ) -> Iterator[Sweep]:
        given: set[int] = set()
        while not stop():
            ended = self.record().state is not State.SCANNING  # before the look at what is there
            new = [index for index in self.indices() if index not in given]
            new.sort(key=lambda index: self.file(index).stat().st_mtime_ns)
            for index in new:
                yield self.read(index)
                given.add(index)
            if ended and not new:
                return
            pause(POLL_S)

    def file(self, index: int) -> Path:
        """Where a slice is, or would be."""
        return self.path / SLICES / f"{index:06d}.npz"

    def _bytes(self, index: int) -> bytes:
        file = self.file(index)
        if not file.exists():
            raise FileNotFoundError(f"{file} is not there; resume the scan to take it")
        with storage(self.path, f"reading slice {index}"):
            return file.read_bytes()

    def _decoded(self, index: int, data: bytes) -> Sweep:
        try:
            sweep = decode_sweep(data)
            if sweep.index != index:
                raise ValueError(f"it holds slice {sweep.index}")  # noqa: TRY301 (one message for all)
        except ValueError as bad:
            message = f"{self.file(index)}: {bad}; resume the scan to take the slice again"
            raise DamagedSlice(message) from bad
        return sweep

    def _tidied(self) -> tuple[Damage, ...]:
        for rest in temporary(self.path / SLICES):
            self._name_or_remove(rest)
        for rest in temporary(self.path):
            rest.unlink()
        aside = tuple(
            Damage(set_aside(damage.file), damage.why) for damage in self.verify().damaged
        )
        sync_folder(self.path / SLICES)
        return aside

    def _name_or_remove(self, rest: Path) -> None:
        """A slice that is whole was acknowledged, or as good as: a power cut took its name."""
        index = self.whole_rest(rest)
        if index is None:
            rest.unlink()
        else:
            rename_whole(rest, self.file(index))

    def whole_rest(self, rest: Path) -> int | None:
        """The index of a slice of the plan that is whole in a file under work and has no name."""
        data = rest.read_bytes()
        if not has_checksum(data):
            return None
        try:
            index = decode_sweep(data).index
        except ValueError:
            return None
        known = index in self.record().indices and not self.file(index).exists()
        return index if known else None


class ScanWriter:
    """Appends to a .scan folder; a context that says aborted when it is left unfinished."""

    def __init__(
        self,
        folder: ScanFolder,
        lock: FolderLock,
        record: ScanRecord,
        set_aside: tuple[Damage, ...],
    ) -> None:
        self.folder = folder
        self.set_aside = set_aside  # damaged slices that this opening found, under their new names
        self._lock = lock
        self._record = record
        self._broken = False
        self._ahead: list[Path] = []  # empty files whose names last
        self._named = 0  # how many there were

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._record.state is State.SCANNING:
            with suppress(StorageFailed):  # the failure that brought us here is the one to tell
                self.mark(State.ABORTED)
        self.close()

    def append(self, sweep: Sweep) -> None:
        """Keep one slice; when this returns it survives a crash and a power cut.

        Raises
        ------
        AlreadyKept
            A slice of this index is there; it stays as it is.
        StorageFailed
            It is not kept; every later append is refused until the scan is resumed.
        ValueError
            The plan has no such index.
        """
        if not self._lock.held:
            raise ValueError(f"{self.folder.path}: the writer is closed; resume the scan")
        if sweep.index not in self._record.indices:
            last = len(self._record.indices) - 1
            raise ValueError(f"{self.folder.path}: slice {sweep.index}: the plan ends at {last}")
        file = self.folder.file(sweep.index)
        if file.exists():
            raise AlreadyKept(f"{file} is there and stays as it is; take another slice")
        data = encode_sweep(sweep)
        self._keep(file, data, f"keeping slice {sweep.index}")

    def finish(self, state: State) -> None:
        """Say that no more slices will come, and let go of the folder.

        Raises
        ------
        ValueError
            Complete with slices missing, or not an end.
        StorageFailed
        """
        missing = self.folder.missing()
        if state is State.SCANNING or (state is State.COMPLETE and missing):
            raise ValueError(
                f"{self.folder.path}: {len(missing)} slices are missing; finish as aborted"
            )
        self.mark(state)
        self.close()

    def mark(self, state: State) -> None:
        """Write the state into scan.json."""
        marked = replace(self._record, state=state)
        with storage(self.folder.path, f"writing {RECORD}"):
            self._settle()
            write_whole(self.folder.path / RECORD, encode_record(marked))
        self._record = marked

    def close(self) -> None:
        """Let go of the folder; may be called again."""
        if self._lock.held:
            with suppress(OSError):  # what was kept is kept; its names are found by a resume
                self._settle()
        self._lock.release()

    def _keep(self, file: Path, data: bytes, doing: str) -> None:
        # After a failed fsync the kernel may call the next one clean: only a new start may go on.
        if self._broken:
            raise StorageFailed(f"{self.folder.path}: {doing}: the disk failed before; resume")
        self._broken = True
        with storage(self.folder.path, doing):
            if not self._ahead:
                numbers = range(self._named, self._named + AHEAD)
                self._ahead = list(name_ahead(self.folder.path / SLICES, numbers))
                self._named += AHEAD
            write_named(self._ahead.pop(), file, data)
        self._broken = False

    def _settle(self) -> None:
        """Make the names of all slices last, and leave nothing under work."""
        while self._ahead:
            self._ahead.pop().unlink(missing_ok=True)
        if not self._broken:
            sync_folder(self.folder.path / SLICES)


def _refuse_what_is_there(path: Path) -> None:
    """Refuse a folder that holds more than a creation that was cut short leaves."""
    if not path.exists():
        return
    if not path.is_dir():
        raise FileExistsError(f"{path} is a file; choose another name")
    with storage(path, "looking what is there"):
        rests = {path / SLICES, path / LOCK, path / SPARE, *temporary(path)}
        found = [*(each for each in path.iterdir() if each not in rests), *path.glob(f"{SLICES}/*")]
    if found:
        there = found[0].relative_to(path)
        raise FileExistsError(f"{path}: {there} is there; resume that scan or choose another name")


def set_aside(file: Path) -> Path:
    """Rename a damaged file so that it is kept and counts as missing."""
    return file.rename(name_aside(file))


def name_aside(file: Path) -> Path:
    """A free name for a damaged file."""
    stem = file.name.lstrip(".")  # what is set aside is not hidden
    names = (file.with_name(f"{stem}.damaged{end}") for end in ("", *range(2, 1_000_000)))
    return next(each for each in names if not each.exists())
