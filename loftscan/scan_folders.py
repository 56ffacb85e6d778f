"""A scan's folder before the scan: may it be there, does it fit the disk, is it that scan's.

All of it is asked before the station is opened, and the folder appears only after every device has
answered: a cable that is out leaves no empty scan behind.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from acquisition.calibration_in_force import InForce
from acquisition.durable import temporary
from acquisition.errors import StorageFailed
from acquisition.folder_lock import LOCK
from acquisition.plan import Estimate, Plan, check_plan, estimate
from acquisition.planes import check_sheet
from acquisition.scan_record import ScanRecord
from acquisition.scanfile import SLICES, SPARE, ScanFolder, ScanWriter
from acquisition.settings import as_table
from acquisition.station import Station

_RECORD_BYTES = 65_536
# What a resume must not change: it decides where the kept slices' points are.
_MEANING = (
    *("kinematics", "table.letter", "table.steps_per_deg", "table.zero", "table.zero_deg"),
    *("table.family", "table.microsteps_per_deg"),
    *("stage.family", "stage.pulses_per_turn", "stage.screw_lead_mm", "stage.microsteps_per_mm"),
    *("table.turning", "stage.steps_per_mm"),
    *("stage.home_mark", "stage.home_way", "stage.home_position_mm"),
    *("name", "profiler.family", "profiler.x_mm_per_count", "profiler.z_mm_per_count"),
)


@dataclass(frozen=True, slots=True)
class Prospect:
    """A scan that may begin: what it will cost, where it goes, what is there already."""

    station: Station
    plan: Plan
    out: Path
    resumed: bool
    kept: tuple[int, ...]  # indices that are on the disk already
    missing: tuple[int, ...]  # as far as they are decided
    whole: bool  # nothing is left to take
    cost: Estimate  # of the slices that are left; of an adaptive plan: at most
    free_bytes: int
    in_force: InForce

    def begin(self, created: datetime) -> ScanWriter:
        """Make the folder, or open the one that is resumed."""
        if self.resumed:
            return ScanFolder.open(self.out).resume()
        record = ScanRecord(
            station=self.station,
            plan=self.plan,
            calibration=self.in_force.kinematics,
            software=f"loftscan {version('loftscan')}",
            created=created.astimezone(UTC).isoformat(timespec="seconds"),
            calibrated_by=self.in_force.source,
            calibration_file_sha256=self.in_force.calibration_sha256,
            override=self.in_force.override,
        )
        return ScanFolder.create(self.out, record)


def prospect(
    station: Station,
    plan: Plan,
    out: Path,
    *,
    resume: bool,
    plan_name: str = "plan.toml",
    in_force: InForce | None = None,
) -> Prospect:
    """Refuse what cannot work, before anything is opened or moves.

    Parameters
    ----------
    in_force
        The calibration to scan with; what station.toml says when absent.

    Raises
    ------
    ValueError
        The plan leaves the soft limits; something is there and nobody asked to resume it; or it is
        another scan.
    NotAScan
        Nothing to resume.
    StorageFailed
        The disk is too small, or may not be written.
    """
    check_plan(plan, station, plan_name)
    held = in_force or InForce(station.kinematics, "station.toml")
    check_sheet(plan, held.kinematics, plan_name)
    kept: tuple[int, ...] = ()
    missing, whole = tuple(plan.first_indices), False
    if resume:
        folder = ScanFolder.open(out)
        _must_be_the_same(folder, station, plan)
        _must_be_calibrated_the_same(folder, held)
        # Damaged slices count as missing: the resume sets them aside and takes them again.
        kept, missing = (found := folder.verify()).sound, found.missing
        whole = folder.is_whole() and not missing
    else:
        _refuse_rest(out)
    left = len(missing) if plan.adaptive is None or whole else plan.most - len(kept)
    cost = _share(estimate(plan, station), max(left, len(missing)))
    free_bytes = _room(out, cost.bytes_at_most)
    return Prospect(station, plan, out, resume, kept, missing, whole, cost, free_bytes, held)


def _refuse_rest(out: Path) -> None:
    if (out / "scan.json").exists():
        record = ScanFolder.open(out).record()
        count = len(ScanFolder(out).indices())
        raise ValueError(
            f"{out}: holds a scan already, {count} of {record.plan.most} slices"
            f" ({record.state.value}); add --resume to take the rest, or name another --out"
        )
    if out.is_file():
        raise ValueError(f"{out}: is a file; name another --out")
    # A program that was killed before scan.json was there leaves these; the writer takes them over.
    rests = {out / SLICES, out / LOCK, out / SPARE, *temporary(out)}
    found = [*(each for each in out.glob("*") if each not in rests), *out.glob("slices/*")]
    if found:
        raise ValueError(f"{out}: is there and holds {found[0].name}, no scan; name another --out")


def _must_be_the_same(folder: ScanFolder, station: Station, plan: Plan) -> None:
    record = folder.record()
    before, now = dict(_leaves(as_table(record.plan))), dict(_leaves(as_table(plan)))
    if changed := [key for key in now if before.get(key) != now[key]]:
        raise ValueError(
            f"{folder.path}: was begun with another plan: {changed[0]} was"
            f" {before.get(changed[0])}, is {now[changed[0]]}; give the plan it was begun with, or"
            " scan anew with another --out"
        )
    before, now = dict(_leaves(as_table(record.station))), dict(_leaves(as_table(station)))
    for key in (*before, *now):
        if key.startswith(_MEANING) and before.get(key) != now.get(key):
            raise ValueError(
                f"{folder.path}: was begun on a station that stood otherwise: {key} was"
                f" {before.get(key)}, is {now.get(key)}; correct the station file, or scan anew"
                " with another --out"
            )


def _must_be_calibrated_the_same(folder: ScanFolder, held: InForce) -> None:
    before = dict(_leaves(as_table(folder.record().calibration)))
    now = dict(_leaves(as_table(held.kinematics)))
    for key in (*before, *now):
        if before.get(key) != now.get(key):
            raise ValueError(
                f"{folder.path}: was begun with another calibration: {key} was {before.get(key)},"
                f" is {now.get(key)}; put back the one it was begun with, or scan anew with"
                " another --out"
            )


def _leaves(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _share(whole: Estimate, slices: int) -> Estimate:
    part = slices / whole.slices
    return Estimate(
        slices,
        round(whole.profiles * part),
        whole.seconds_at_least * part,
        round(whole.bytes_at_most * part) + _RECORD_BYTES,
    )


def _room(out: Path, wanted_bytes: int) -> int:
    place = next(each for each in (out.resolve(), *out.resolve().parents) if each.exists())
    if not os.access(place, os.W_OK | os.X_OK):
        raise StorageFailed(
            f"{out}: no permission to write in {place}; change it, or name another --out"
        )
    free_bytes = shutil.disk_usage(place).free
    if wanted_bytes > free_bytes:
        raise StorageFailed(
            f"{out}: the scan needs up to {in_bytes(wanted_bytes)}, the disk has"
            f" {in_bytes(free_bytes)} free; free some space, or name a folder on another disk as"
            " --out"
        )
    return free_bytes


def in_bytes(count: float) -> str:
    """Write a size for a person, in powers of 1000."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"
