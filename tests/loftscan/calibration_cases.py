"""Artefacts before the naive station, as values and as what artefact.toml says of them."""

from __future__ import annotations

import math

import numpy as np

from acquisition.frames import Kind, Kinematics, Lifting, Turning
from loftscan.calibrating.artefact import Artefact, parse_artefact
from loftscan.calibrating.model import Seen
from tests.loftscan.naive_station import Array, Ball, Crooked, Plate, Scanned, scanned

NOMINAL = Kinematics(
    kind=Kind.NOMINAL,
    table_sense=Turning.COUNTER_CLOCKWISE,
    stage_sense=Lifting.UP,
    height_mm=-3.0,
    standoff_mm=225.0,
)
RADIUS_MM = 10.0
BALLS = (
    Ball((28.0, 0.0, 15.0), RADIUS_MM),
    Ball((-14.0, 24.0, 38.0), RADIUS_MM),
    Ball((-14.0, -24.0, 62.0), RADIUS_MM),
)
PLATE = Plate((6.0, 2.0, 40.0), (1.0, 0.35, 0.2), 16.0)
STAGES_MM = np.arange(6.0, 72.0, 3.0)
TURN_RAD = np.arange(0.0, 360.0, 15.0) * math.pi / 180.0


def spacing_mm(one: int, other: int) -> float:
    return float(np.linalg.norm(np.array(BALLS[one].centre) - np.array(BALLS[other].centre)))


def balls_toml(off_mm: float = 0.0, near_off_mm: float = 0.0) -> str:
    """Three balls, a plate and two spacings, the second held out and, if wanted, wrong."""
    return f"""
name = "balls"
[spheres.a]
radius_mm = 10.0
[spheres.b]
radius_mm = 10.0
[spheres.c]
radius_mm = 10.0
[planes.plate]
[spacings.near]
one = "a"
other = "b"
distance_mm = {spacing_mm(0, 1) + near_off_mm}
[spacings.far]
one = "a"
other = "c"
distance_mm = {spacing_mm(0, 2) + off_mm}
held_out = true
"""


def balls(certificate_seed: int | None = None) -> Artefact:
    """As certified: exactly, or to the 1 um that the file says by default."""
    if certificate_seed is None:
        return parse_artefact(balls_toml())
    off_mm = np.random.default_rng([certificate_seed, 1]).normal(0.0, 0.001, 2)
    return parse_artefact(balls_toml(*(float(each) for each in off_mm)))


def artefact(text: str) -> Artefact:
    return parse_artefact(text)


def seen_of(*scans: Scanned) -> Seen:
    profiles, first = [], 0
    for each in scans:
        profiles.append(each.profile + first)
        first += int(each.profile.max()) + 1
    return Seen(
        np.concatenate([each.planar for each in scans]),
        np.concatenate([each.stage for each in scans]),
        np.concatenate([each.table for each in scans]),
        np.repeat(np.arange(len(scans)), [len(each.planar) for each in scans]),
        np.concatenate(profiles),
    )


def look(
    station: Crooked,
    things: list[object],
    seed: int = 0,
    stages_mm: Array = STAGES_MM,
    turn_rad: Array = TURN_RAD,
) -> Seen:
    rng = np.random.default_rng(seed)
    return seen_of(scanned(station, things, stages_mm, turn_rad, rng))


def balls_seen(station: Crooked, seed: int = 0) -> Seen:
    return look(station, [*BALLS, PLATE], seed)
