"""Reading the files that a person wrote, with the remedy where there is none."""

from __future__ import annotations

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
    return read_station(path)


def plan_of(path: Path) -> Plan:
    """Read a plan.toml; raises as `station_of`."""
    _must_be_a_file(path, "run: loftscan init --plan plan.toml")
    return read_plan(path)


def _must_be_a_file(path: Path, remedy: str) -> None:
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, a .toml file is expected")
    try:
        path.open("rb").close()
    except FileNotFoundError as absent:
        raise ValueError(f"{path}: there is no such file; check the path, or {remedy}") from absent
    except OSError as closed:
        raise ValueError(f"{path}: cannot be read ({closed.strerror}); check it") from closed
