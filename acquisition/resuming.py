"""The slices that a .scan folder lacks, after one that it has was taken again and agreed."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing

from acquisition.errors import DamagedSlice
from acquisition.loop_closure import Closure, comparable, compare, must_agree
from acquisition.opening import OpenStation
from acquisition.plan import Plan
from acquisition.poses import Sweep
from acquisition.scan import PartStands, Progress, StopRequest, scan
from acquisition.scanfile import ScanFolder


def take_missing(
    station: OpenStation,
    plan: Plan,
    folder: ScanFolder,
    *,
    stop: StopRequest,
    part: PartStands = PartStands.ANYWHERE,
    progress: Callable[[Progress], None] = lambda _: None,
    compared: Callable[[Closure], None] = lambda _: None,
) -> Generator[Sweep]:
    """Take what is missing, lowest first; nothing is yielded before the comparison agreed.

    A folder with no slice yet, or none with enough points to compare, is taken as it is.

    Raises
    ------
    NotAsKept
        It is another part, or an axis lost its place; the laser is off, nothing was kept.
    """
    missing = folder.missing()
    known = known_slice(folder, missing)
    again = None if known is None else known.index
    sweeps = scan(
        station, plan, stop=stop, indices=missing, again=again, part=part, progress=progress
    )
    with closing(sweeps):
        if known is not None:
            if (taken := next(sweeps, None)) is None:
                return  # paused before it began
            closure = compare(known, taken, folder.record().calibration)
            compared(closure)
            must_agree(closure)
        yield from sweeps


def known_slice(folder: ScanFolder, missing: tuple[int, ...]) -> Sweep | None:
    """The kept slice to compare with: the last before what is missing, if it has the points."""
    if not missing:
        return None
    kept = folder.indices()
    before = [index for index in kept if index < missing[0]]
    after = [index for index in kept if index > missing[0]]
    for index in (*reversed(before), *after):
        try:
            sweep = folder.read(index)
        except DamagedSlice:
            continue
        if comparable(sweep):
            return sweep
    return None
