"""The .scan folders under a directory: what each holds and how it stands. Reads, writes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path

from acquisition.errors import NotAScan
from acquisition.folder_lock import is_locked
from acquisition.patterns import Meridian, Stripe
from acquisition.plan import Plan, Ring
from acquisition.scanfile import RECORD, SPARE, ScanFolder


class Standing(Enum):
    """How a scan stands, as far as names and scan.json say it; `verify` reads the slices."""

    WHOLE = "whole"
    PAUSED = "paused"  # slices are missing, nobody appends: it can be resumed
    WRITTEN = "being written"
    DAMAGED = "damaged"  # scan.json cannot be read, or slices were set aside and not taken again


@dataclass(frozen=True, slots=True)
class KeptScan:
    """One line of the list."""

    path: Path
    standing: Standing
    created: str = ""
    station: str = ""
    plan: str = ""
    slices: int = 0
    expected: int = 0
    bytes: int = 0
    trouble: str = ""

    def as_json(self) -> dict[str, object]:
        """Its fields as JSON knows them."""
        return {**asdict(self), "path": str(self.path), "standing": self.standing.value}


def kept_scans(place: Path) -> tuple[KeptScan, ...]:
    """The scans in a directory and below it, by name; a .scan folder itself is one.

    Raises
    ------
    NotAScan
        There is no such directory.
    """
    if not place.is_dir():
        raise NotAScan(f"{place}: no such folder; name one that holds .scan folders")
    return tuple(_described(each) for each in sorted(_folders(place)))


def plan_in_words(plan: Plan) -> str:
    """A plan on one line."""
    match plan.pattern:
        case Ring() as rings:
            how = "stops" if plan.continuous is None else "profiles a turn, turning"
            if plan.adaptive is not None:
                return (
                    f"at most {plan.most} rings chosen from {rings.first_mm:g} to"
                    f" {rings.last_mm:g} mm for {plan.adaptive.tolerance_mm:g} mm,"
                    f" {rings.profiles_per_turn} {how}"
                )
            return (
                f"{rings.count} rings from {rings.first_mm:g} mm by {rings.step_mm:g} mm,"
                f" {rings.profiles_per_turn} {how}"
            )
        case Meridian() as meridians:
            return (
                f"{meridians.count} meridians from {meridians.first_deg:g} deg by"
                f" {360.0 / meridians.per_turn:g} deg, {meridians.stops} stops"
            )
        case Stripe() as stripes:
            return f"{stripes.count} stripes from {stripes.first_mm:g} mm by {stripes.step_mm:g} mm"


def _folders(place: Path) -> Iterator[Path]:
    if (place / RECORD).exists() or (place / SPARE).exists() or place.suffix == ".scan":
        yield place
        return
    for each in place.iterdir():
        if each.is_dir() and not each.is_symlink() and not each.name.startswith("."):
            yield from _folders(each)


def _described(path: Path) -> KeptScan:
    folder = ScanFolder(path)
    size = sum(each.stat().st_size for each in path.rglob("*") if each.is_file())
    indices = folder.indices()
    try:
        record = folder.record()
    except NotAScan as bad:
        return KeptScan(path, Standing.DAMAGED, slices=len(indices), bytes=size, trouble=str(bad))
    missing = list(folder.missing())
    aside = {each.name[:6] for each in path.glob("slices/*.damaged*")}
    lost = [index for index in missing if f"{index:06d}" in aside]
    return KeptScan(
        path,
        _standing(path, lost, whole=folder.is_whole()),
        record.created,
        record.station.name,
        plan_in_words(record.plan),
        len(indices),
        len(indices) + len(missing),
        size,
        f"{len(lost)} slices were damaged and set aside; resume the scan" if lost else "",
    )


def _standing(path: Path, lost: list[int], *, whole: bool) -> Standing:
    if is_locked(path):
        return Standing.WRITTEN
    if lost:
        return Standing.DAMAGED
    return Standing.WHOLE if whole else Standing.PAUSED
