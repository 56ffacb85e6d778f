"""The slices that a .scan folder lacks, after one that it has was taken again and agreed."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing

from acquisition.choosing import NextSlices
from acquisition.errors import DamagedSlice
from acquisition.loop_closure import Closure, comparable, compare, must_agree
from acquisition.opening import OpenStation
from acquisition.plan import Plan
from acquisition.poses import Sweep
from acquisition.scan import PartStands, Progress, StopRequest, Wish, scan
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
    tell: Callable[[str], None] = lambda _: None,
) -> Generator[Sweep]:
    """Take what is missing, lowest first; nothing is yielded before the comparison agreed.

    Of an adaptive plan then what is chosen, one by one: each sweep must be in the folder before the
    next is asked for. `tell` hears what a person should know of the choosing. A folder with no
    slice yet, or none with enough points to compare, is taken as it is.

    Raises
    ------
    NotAsKept
        It is another part, or an axis lost its place; the laser is off, nothing was kept.
    """
    missing = folder.missing()
    adaptive = plan.adaptive is not None and not folder.is_whole()
    known = known_slice(folder, missing or ((plan.count,) if adaptive else ()))
    again = None if known is None else known.index

    def interrupted() -> bool:
        left = stop.left_alone and station.safety.rules.attended
        return left or stop.wish is not Wish.GO_ON

    chosen = NextSlices(plan, folder, interrupted, tell, station.clock) if adaptive else None
    sweeps = scan(
        station, plan, stop=stop, indices=missing, again=again, chosen=chosen,
        most=max(plan.most - len(folder.indices()), 0), part=part, progress=progress,
    )  # fmt: skip
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
