"""Which kinematics a scan uses: refused without a calibration that can be believed, or in words.

::

    [kinematics] kind = "simulated"  --------------------------------> as station.toml says
    [calibration] file, read, young enough, of this station, sane ---> as solved
    anything else: refused, or with `--override "why"` --------------> the best there is, and why
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from acquisition.calibration import Calibration, deciding_keys, read_calibration
from acquisition.frames import Kind, Kinematics
from acquisition.station import Station

_FEW_WORDS = 8  # characters: less says nothing to whoever reads the record


@dataclass(frozen=True, slots=True)
class InForce:
    """What a scan places its points by, and who answers for it."""

    kinematics: Kinematics
    source: str  # "station.toml", or the calibration's file
    calibration_sha256: str = ""
    override: str = ""  # the operator's words, and what they override


def in_force(
    station: Station, folder: Path, now: datetime, *, override: str | None = None
) -> InForce:
    """Find the kinematics to scan with.

    Parameters
    ----------
    folder
        Where station.toml lies: a relative calibration file is beside it.
    override
        The operator's words, which let pass what is refused else.

    Raises
    ------
    ValueError
        No calibration, a stale one, another station's, or one that contradicts station.toml; or
        words that say nothing.
    """
    if override is not None and len(override.strip()) < _FEW_WORDS:
        raise ValueError(
            f"--override {override!r}: say why in words; they are kept in the scan's record"
        )
    if station.kinematics.kind is Kind.SIMULATED:
        return InForce(station.kinematics, "station.toml", override=override or "")
    found, wrong = _looked_for(station, folder, now)
    if wrong is None and found is not None:
        return InForce(found.kinematics, station.calibration.file, found.sha256)
    if override is None:
        raise ValueError(f'{wrong}; or say why not: --override "..."')
    words = f"{override.strip()} ({wrong})"
    if found is None:
        return InForce(station.kinematics, "station.toml", override=words)
    return InForce(found.kinematics, station.calibration.file, found.sha256, words)


def contradiction(kinematics: Kinematics, station: Station) -> str | None:
    """What of solved kinematics contradicts station.toml, in words; None for nothing."""
    limit = station.calibration.scale_limit_percent / 100.0
    nominal = station.kinematics
    if kinematics.table_sense is not nominal.table_sense:
        return (
            f"the table turns the part {kinematics.table_sense.value} seen from above, station.toml"
            f" says {nominal.table_sense.value}: write table_sense ="
            f' "{kinematics.table_sense.value}", or turn sensor_x round if that is what is wrong'
        )
    turn = kinematics.table_deg_per_deg / nominal.table_deg_per_deg
    if abs(turn - 1.0) > limit:
        return _wrong_turn(turn, station)
    if kinematics.stage_z_mm * nominal.stage_z_mm < 0.0:
        return (
            "the stage moves the laser plane the other way than stage_sense ="
            f' "{nominal.stage_sense.value}" says: change it'
        )
    here, there = _length(kinematics), _length(nominal)
    if abs(here / there - 1.0) > limit:
        return (
            f"the stage moves {here / there:.4f} mm for a mm that it reports: the lead or the"
            " pulses a turn in [stage] are wrong"
        )
    for name in ("x_mm_per_mm", "z_mm_per_mm"):
        scale = getattr(kinematics, name) / getattr(nominal, name)
        if abs(scale - 1.0) > limit:
            return (
                f"the sensor's {name[0]} is {scale:.4f} of what it reports: {name[0]}_mm_per_count"
                " in [profiler] is wrong"
            )
    return None


def _looked_for(
    station: Station, folder: Path, now: datetime
) -> tuple[Calibration | None, str | None]:
    """The calibration that is there, and what is wrong with it or with its absence."""
    where = folder / station.calibration.file
    how = "calibrate it: loftscan calibrate STATION.toml ARTEFACT.toml"
    if not where.is_file():
        return None, f"{where}: there is no calibration of this station; {how}"
    found = read_calibration(where)
    keys = deciding_keys(station)
    changed = [key for key in sorted({*keys, *found.station})
               if keys.get(key) != found.station.get(key)]  # fmt: skip
    if changed:
        before, now_is = found.station.get(changed[0]), keys.get(changed[0])
        return found, (
            f"{where}: is of another station: {changed[0]} was {before}, is {now_is}; correct"
            " station.toml, or calibrate anew"
        )
    age_days, limit_days = found.age_days(now), station.calibration.max_age_days
    if age_days > limit_days:
        return found, (
            f"{where}: is {age_days:.1f} days old, and calibration.max_age_days is {limit_days:g};"
            f" {how}"
        )
    if age_days < -1.0:
        return found, f"{where}: was made {-age_days:.1f} days from now; set the clock right"
    if (against := contradiction(found.kinematics, station)) is not None:
        return found, f"{where}: contradicts station.toml: {against}"
    return found, None


def _wrong_turn(turn: float, station: Station) -> str:
    words = f"the table turns {turn:.4f} degrees for each that it reports"
    steps = getattr(station.table, "steps_per_deg", None)
    if steps is None:
        return f"{words}: the steps a turn in [table] are wrong"
    return (
        f"{words}: wrong steps per revolution: steps_per_deg = {steps:g} ({steps * 360.0:.0f} a"
        f" turn) should be {steps / turn:.4f} ({steps * 360.0 / turn:.0f} a turn)"
    )


def _length(kinematics: Kinematics) -> float:
    step = (kinematics.stage_x_mm, kinematics.stage_y_mm, kinematics.stage_z_mm)
    return float(sum(each**2 for each in step) ** 0.5)
