"""Mends a .scan folder after a bad disk, a bad copy or a dead program; deletes nothing.

What cannot be read is set aside under a new name. What can be proven is rebuilt: a slice whose
columns have their CRC, a slice under a wrong name, a slice that a dying program had written whole
but not renamed, a scan.json from its spare or the spare from scan.json, the state. Every original
is kept beside it as ``NAME.damaged``.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition.durable import rename_whole, storage, sync_folder, temporary, write_whole
from acquisition.errors import NotAScan
from acquisition.folder_lock import FolderLock
from acquisition.poses import Sweep
from acquisition.salvage import salvaged
from acquisition.scan_record import ScanRecord, State, decode_record, encode_record
from acquisition.scanfile import (
    RECORD,
    SLICES,
    SPARE,
    ScanFolder,
    Verification,
    name_aside,
    set_aside,
)
from acquisition.sweep_codec import decode_sweep, encode_sweep


@dataclass(frozen=True, slots=True)
class Mending:
    """One thing that was done."""

    file: Path  # as it is called now
    done: str


@dataclass(frozen=True, slots=True)
class Repair:
    """What was done, and what is left."""

    mendings: tuple[Mending, ...]
    left: Verification


def repair(path: Path) -> Repair:
    """Mend a folder that nobody appends to.

    Raises
    ------
    NotAScan
        Neither scan.json nor its spare can be read; nothing was changed.
    ScanInUse, StorageFailed
    """
    if not path.is_dir() or not ((path / RECORD).exists() or (path / SPARE).exists()):
        raise NotAScan(f"{path}: no {RECORD} there; is it a .scan folder?")
    folder, done = ScanFolder(path), list[Mending]()
    with storage(path, "locking the folder"):
        lock = FolderLock(path)
    with ExitStack() as last, storage(path, "repairing"):
        last.callback(lock.release)
        record = _mend_record(path, done)
        for index in folder.indices():
            _mend_slice(folder, index, done)
        for part in sorted([*temporary(path), *temporary(path / SLICES)]):
            _mend_rest(folder, part, done)
        sync_folder(path / SLICES)
        sync_folder(path)
        left = folder.verify()
        _mend_state(path, record, left, done)
    return Repair(tuple(done), left)


def _mend_record(path: Path, done: list[Mending]) -> ScanRecord:
    (record, why), (spare, _) = _read(path / RECORD), _read(path / SPARE)
    if record is None and spare is None:
        raise NotAScan(
            f"{path}: {why}, and {SPARE} beside it cannot be read either; restore one of them from"
            " a copy, nothing was changed"
        )
    if record is None:
        assert spare is not None
        _keep_aside(path / RECORD, done, why)
        write_whole(path / RECORD, encode_record(spare))
        done.append(Mending(path / RECORD, f"rebuilt from {SPARE}"))
        return spare
    if spare is None:
        _keep_aside(path / SPARE, done, "it cannot be read")
        write_whole(path / SPARE, encode_record(replace(record, state=State.SCANNING)))
        done.append(Mending(path / SPARE, f"rebuilt from {RECORD}"))
    return record


def _read(file: Path) -> tuple[ScanRecord | None, str]:
    try:
        return decode_record(file.read_bytes()), ""
    except FileNotFoundError:
        return None, f"no {file.name} there"
    except (OSError, ValueError) as bad:
        return None, str(bad)


def _mend_slice(folder: ScanFolder, index: int, done: list[Mending]) -> None:
    file = folder.file(index)
    why = folder.damage_of(index)
    if why is None:
        return
    try:
        data = file.read_bytes()
    except OSError:
        data = b""
    sweep = _whole(data) or salvaged(data)
    own = file if sweep is None else folder.file(sweep.index)
    if sweep is None or (own != file and own.exists()):
        done.append(Mending(set_aside(file), f"set aside: {why}"))
        return
    _keep_aside(file, done, why)
    write_whole(own, encode_sweep(sweep))
    done.append(Mending(own, "rebuilt: every column has its checksum"))
    if own != file:
        file.unlink()  # its bytes are kept aside


def _mend_rest(folder: ScanFolder, part: Path, done: list[Mending]) -> None:
    """A file under work of a program that died: a slice if it is whole, else a rest."""
    if not part.stat().st_size:
        part.unlink()  # a name that was made ahead: there is nothing in it
        return
    index = folder.whole_rest(part) if part.parent.name == SLICES else None
    if index is None:
        done.append(Mending(set_aside(part), "set aside: the rest of a program that died"))
        return
    rename_whole(part, folder.file(index))
    done.append(Mending(folder.file(index), "kept: it was whole when its program died"))


def _whole(data: bytes) -> Sweep | None:
    try:
        return decode_sweep(data)
    except ValueError:
        return None


def _keep_aside(file: Path, done: list[Mending], why: str) -> None:
    """Copy a file aside, so that there is no instant without it; nothing where there is none."""
    if file.exists():
        aside = name_aside(file)
        write_whole(aside, file.read_bytes())
        done.append(Mending(aside, f"set aside: {why}"))


def _mend_state(path: Path, record: ScanRecord, left: Verification, done: list[Mending]) -> None:
    """Nobody appends: a scan is complete when all is there, and else it was cut short."""
    state = State.ABORTED if left.missing else State.COMPLETE
    if record.state is not state:
        write_whole(path / RECORD, encode_record(replace(record, state=state)))
        done.append(Mending(path / RECORD, f"state: {record.state.value} is now {state.value}"))
