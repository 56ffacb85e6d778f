"""calibration.toml: solved kinematics with all that says whether to believe them; and which holds.

Written by `loftscan calibrate`, read by every scan. It holds the kinematics, their covariance, when
and from what they were solved, and the keys of station.toml that decide where points are, as they
were then: a calibration is of one station, and the key that has changed since is named.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import Kind, Kinematics
from acquisition.settings import Key, as_table, parse_toml, read_table
from acquisition.station import Station

FORMAT = "loftscan.calibration"
VERSION = 1
# What decides where a point is: of another value it is another station.
DECIDING = (
    *("kinematics", "table.letter", "table.steps_per_deg", "table.zero", "table.zero_deg"),
    *("table.family", "table.microsteps_per_deg", "table.steps_per_turn", "table.turning"),
    *("stage.family", "stage.pulses_per_turn", "stage.screw_lead_mm", "stage.microsteps_per_mm"),
    *("stage.steps_per_mm", "stage.home_mark", "stage.home_way", "stage.home_position_mm"),
    *("profiler.family", "profiler.x_mm_per_count", "profiler.z_mm_per_count"),
    *("profiler.x_offset_mm", "profiler.z_offset_mm", "profiler.column_pitch_mm"),
)
_TABLES = ("kinematics", "fit", "sd", "covariance", "station", "scans", "checks")
_SYMMETRIC = 1e-6  # of a covariance's largest entry


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How the solve went, and what of."""

    artefact: Annotated[str, Key("what stood on the table")]
    artefact_sha256: Annotated[str, Key("of artefact.toml")]
    certificate: Annotated[str, Key("of the artefact")] = ""
    software: Annotated[str, Key("which program solved it")]
    points: Annotated[int, Key("used", at_least=1)]
    stray: Annotated[int, Key("points set aside", at_least=0)]
    sigma_mm: Annotated[float, Key("noise of a point in the laser plane", at_least=0.0)]
    s0: Annotated[float, Key("standard deviation of unit weight; 1 is right", at_least=0.0)]
    alike: Annotated[float, Key("what the covariance was multiplied with", at_least=1.0)]
    rank: Annotated[int, Key("combinations of parameters that are told", at_least=1)]
    condition: Annotated[float, Key("largest over smallest singular value", at_least=1.0)]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything calibration.toml says."""

    kinematics: Kinematics
    made: datetime
    fit: Fit
    names: tuple[str, ...]  # of the parameters that were solved for
    covariance: FloatArray  # (n, n), in their own units
    station: Mapping[str, Any]  # its deciding keys as they were
    scans: tuple[str, ...]
    checks: tuple[str, ...]
    sha256: str = ""

    def age_days(self, now: datetime) -> float:
        """How old it is."""
        return (now - self.made).total_seconds() / 86400.0


def deciding_keys(station: Station) -> dict[str, Any]:
    """The keys of a station.toml that decide where points are, by their dotted path."""
    return {
        path: value
        for path, value in _leaves(as_table(station))
        if path.startswith(DECIDING) and path != "kinematics.kind"
    }


def fingerprint(keys: Mapping[str, Any]) -> str:
    """SHA-256 of the deciding keys' canonical JSON."""
    text = json.dumps(dict(keys), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_calibration(calibration: Calibration) -> str:
    """Write a calibration.toml that reads back to an equal value.

    Raises
    ------
    ValueError
        It holds what its file may not.
    """
    kinematics = as_table(calibration.kinematics)
    rail = kinematics.pop("second_stage", None)
    sd = np.sqrt(np.diag(calibration.covariance))
    lines = [
        "# Where the laser stands, solved by loftscan calibrate. Lengths mm, angles degrees.",
        "# A scan refuses it when the station's keys below are no longer those of station.toml.",
        f"format = {_text(FORMAT)}",
        f"version = {VERSION}",
        f"made = {calibration.made.astimezone(UTC).isoformat(timespec='seconds')}",
        *_section("kinematics", kinematics),
        *(_section("kinematics.second_stage", rail) if rail else ()),
        *_section("fit", as_table(calibration.fit)),
        *_section("sd", {name: float(v) for name, v in zip(calibration.names, sd, strict=True)}),
        "",
        "[covariance]",
        f"names = {json.dumps(list(calibration.names))}",
        f"values = {json.dumps(calibration.covariance.tolist())}",
        *_section("station", calibration.station),
        "",
        "[scans]",
        f"used = {json.dumps(list(calibration.scans), ensure_ascii=False)}",
        "",
        "[checks]",
        f"held_out = {json.dumps(list(calibration.checks), ensure_ascii=False)}",
    ]
    text = "\n".join(lines) + "\n"
    parse_calibration(text)
    return text


def parse_calibration(text: str, name: str = "calibration.toml") -> Calibration:
    """Make a calibration of the text of its file.

    Raises
    ------
    ValueError
        One line: the file, the key, what is wrong and the fix.
    """
    table = parse_toml(text, name)
    if table.get("format") != FORMAT or table.get("version") != VERSION:
        raise ValueError(
            f'{name}: no calibration of version {VERSION} (format = "{FORMAT}"); make one with:'
            " loftscan calibrate"
        )
    for key in _TABLES:
        if not isinstance(table.get(key), Mapping):
            wrong = f"{name}: [{key}] is missing; make it anew: loftscan calibrate"
            raise ValueError(wrong)  # noqa: TRY004 (of a file, not of a caller)
    made = table.get("made")
    if not isinstance(made, datetime) or made.tzinfo is None:
        raise ValueError(f"{name}: made: {made!r} is no time with its zone")
    kinematics = read_table(Kinematics, table["kinematics"], name, "kinematics")
    if kinematics.kind is not Kind.CALIBRATED:
        raise ValueError(f'{name}: kinematics.kind: write "calibrated", or it is none')
    names, covariance = _covariance(table["covariance"], name)
    return Calibration(
        kinematics=kinematics,
        made=made,
        fit=read_table(Fit, table["fit"], name, "fit"),
        names=names,
        covariance=covariance,
        station=dict(table["station"]),
        scans=_texts(table["scans"].get("used"), name, "scans.used"),
        checks=_texts(table["checks"].get("held_out"), name, "checks.held_out"),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
    )


def read_calibration(path: Path) -> Calibration:
    """Read and parse a calibration.toml; raises OSError as well."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as bad:
        raise ValueError(f"{path}: not UTF-8 text: {bad}; calibrate anew") from bad
    return parse_calibration(text, str(path))


def _covariance(table: Mapping[str, Any], name: str) -> tuple[tuple[str, ...], FloatArray]:
    names = _texts(table.get("names"), name, "covariance.names")
    known = {each for each in Kinematics.__dataclass_fields__ if each.endswith(_NUMERIC)}
    if strange := [each for each in names if each not in known]:
        raise ValueError(f"{name}: covariance.names: {strange[0]!r} is no number of [kinematics]")
    if len(set(names)) != len(names) or not names:
        raise ValueError(f"{name}: covariance.names: each parameter once, and one at least")
    try:
        values = np.array(table.get("values"), np.float64)
    except (TypeError, ValueError) as bad:
        raise ValueError(f"{name}: covariance.values: no matrix of numbers") from bad
    wrong = None
    if values.shape != (len(names), len(names)):
        wrong = f"is {values.shape}, not {len(names)} by {len(names)}"
    elif not np.isfinite(values).all():
        wrong = "has a number that is not finite"
    elif np.abs(values - values.T).max() > _SYMMETRIC * np.abs(values).max():
        wrong = "is not symmetric"
    elif (np.diag(values) < 0.0).any():
        wrong = "has a variance below 0"
    if wrong:
        raise ValueError(f"{name}: covariance.values: {wrong}; make it anew: loftscan calibrate")
    return names, values


_NUMERIC = ("_mm", "_deg", "_per_deg")


def _texts(values: object, name: str, path: str) -> tuple[str, ...]:
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise ValueError(f"{name}: {path}: no list of texts")  # noqa: TRY004 (of a file)
    if wrong := [each for each in values if not isinstance(each, str)]:
        raise ValueError(f"{name}: {path}: {wrong[0]!r} is no text")
    return tuple(values)


def _section(name: str, values: Mapping[str, Any]) -> Iterator[str]:
    yield from ("", f"[{name}]")
    for key, value in values.items():
        yield f"{_key(key)} = {_value(value)}"


def _key(key: str) -> str:
    return _text(key) if "." in key else key


def _value(value: object) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"calibration: {value} is no number that a file may hold")
    return repr(value).lower()


def _text(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML also wants DEL escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _leaves(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value
