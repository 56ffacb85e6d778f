"""A disk that forgets what was not synced, and every state that a power cut may leave on it.

The strict reading of POSIX, stricter than any journal: the bytes of a file last after its fsync,
a name (created, renamed, removed) after the fsync of its folder, and of what is pending any part
may be there, in any order::

    open .part   write   fsync .part   rename   fsync folder   "kept 3"
                 ^^^^^ none, half, all of the bytes
    ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^   ^^^^^^   each name there or not

`images` gives these states after every call of a log.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from tests.campaigns.tracing import Call

_MOST_PENDING = 6  # names whose subsets are all tried; of more: up to each, and only each


@dataclass(eq=False)
class _File:
    """Bytes as programs see them, and as the disk has them for sure."""

    data: bytes = b""
    lasting: bytes = b""


@dataclass(frozen=True)
class _Naming:
    """A pending change of one folder: what its name means from now on."""

    folder: str
    changes: tuple[tuple[str, _File | None], ...]


@dataclass(frozen=True)
class Image:
    """What a power cut leaves: files with their bytes, and what had been told until then."""

    call: int
    files: tuple[tuple[str, bytes], ...]
    told: tuple[int, ...]

    def write(self, place: Path, root: str) -> None:
        """Make it under `place`, in which `root` of the log becomes the top."""
        for name, data in self.files:
            file = place / Path(name).relative_to(root)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)


@dataclass
class _Disk:
    root: str
    names: dict[str, _File] = field(default_factory=dict)  # as programs see them
    lasting: dict[str, _File] = field(default_factory=dict)
    pending: list[_Naming] = field(default_factory=list)
    told: list[int] = field(default_factory=list)

    def do(self, call: Call) -> bool:
        """Do a call; whether it changed anything."""
        if call.name in {"write", "pwrite64"} and (
            kept := re.fullmatch(rb"kept (\d+)\n", call.data)
        ):
            self.told.append(int(kept[1]))
            return True
        if not all(each.startswith(self.root) for each in call.paths):
            return False
        act = getattr(self, f"_{call.name}", None)
        return bool(act and act(call))

    def _openat(self, call: Call) -> bool:
        (path,) = call.paths
        if "O_CREAT" in call.flags and path not in self.names:
            self._name(path, ((path, _File()),))
        elif "O_TRUNC" in call.flags:
            self.names[path].data = b""
        else:
            return False
        return True

    def _write(self, call: Call) -> bool:
        self.names[call.paths[0]].data += call.data
        return True

    def _pwrite64(self, call: Call) -> bool:
        self.names[call.paths[0]].data = call.data  # the lock's, at 0
        return True

    def _ftruncate(self, call: Call) -> bool:
        self.names[call.paths[0]].data = b""
        return True

    def _fsync(self, call: Call) -> bool:
        (path,) = call.paths
        if path in self.names:
            self.names[path].lasting = self.names[path].data
            return True
        for naming in [each for each in self.pending if each.folder == path]:
            _apply(naming, self.lasting)
            self.pending.remove(naming)
        return True

    def _rename(self, call: Call) -> bool:
        old, new = call.paths
        self._name(new, ((old, None), (new, self.names[old])))
        return True

    def _unlink(self, call: Call) -> bool:
        self._name(call.paths[0], ((call.paths[0], None),))
        return True

    def _name(self, path: str, changes: tuple[tuple[str, _File | None], ...]) -> None:
        naming = _Naming(str(Path(path).parent), changes)
        _apply(naming, self.names)
        self.pending.append(naming)

    def images(self, number: int) -> Iterator[Image]:
        """Every state of names, each with none, half or all of the bytes that were not synced."""
        seen = set()
        for chosen in _subsets(self.pending):
            names = dict(self.lasting)
            for naming in chosen:
                _apply(naming, names)
            for share in (0.0, 0.5, 1.0):
                files = tuple(sorted((name, _torn(each, share)) for name, each in names.items()))
                if files not in seen:
                    seen.add(files)
                    yield Image(number, files, tuple(self.told))


def images(calls: Sequence[Call], root: str) -> Iterator[Image]:
    """What a power cut after each of these calls may leave under `root`."""
    disk = _Disk(root)
    for number, call in enumerate(calls):
        if disk.do(call):
            yield from disk.images(number)


def _apply(naming: _Naming, names: dict[str, _File]) -> None:
    for name, file in naming.changes:
        if file is None:
            names.pop(name, None)
        else:
            names[name] = file


def _torn(file: _File, share: float) -> bytes:
    if file.data.startswith(file.lasting):
        more = file.data[len(file.lasting) :]
        return file.lasting + more[: round(share * len(more))]
    return file.lasting if share < 1.0 else file.data


def _subsets(pending: Sequence[_Naming]) -> Iterator[tuple[_Naming, ...]]:
    if len(pending) > _MOST_PENDING:
        for count in range(len(pending) + 1):
            yield tuple(pending[:count])
            yield tuple(pending[count : count + 1])
        return
    for count in range(len(pending) + 1):
        yield from combinations(pending, count)
