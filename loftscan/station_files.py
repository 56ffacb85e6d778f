"""Reading the files that a person wrote, with the remedy where there is none."""

from __future__ import annotations

import tomllib
from pathlib import Path

from acquisition.plan import Plan, read_plan
from acquisition.station import Station, read_station


def station_of(path: Path) -> Station:
    """Read a station.toml.

    Raises
    ------
    ValueError
        It is not there, cannot be read or is no station; says what to do.
    """
    _must_be_a_file(path, "run: loftscan init --out station.toml")
    if _holds(path, "ring"):
        raise ValueError(f"{path}: is a plan; name the station's file in its place")
    return read_station(path)


def plan_of(path: Path) -> Plan:
    """Read a plan.toml; raises as `station_of`."""
    _must_be_a_file(path, "run: loftscan init --plan plan.toml")
    if _holds(path, "profiler"):
        raise ValueError(f"{path}: is a station; name the plan's file in its place")
    return read_plan(path)


def _holds(path: Path, table: str) -> bool:
    """Whether a file has a table that only the other kind has; what is no TOML has none."""
    try:
        return table in tomllib.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False


def _must_be_a_file(path: Path, remedy: str) -> None:
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, a .toml file is expected")
    try:
        path.open("rb").close()
    except FileNotFoundError as absent:
        raise ValueError(f"{path}: there is no such file; check the path, or {remedy}") from absent
    except OSError as closed:
        raise ValueError(f"{path}: cannot be read ({closed.strerror}); check it") from closed
