r"""What slices a simulated station cuts: how its sheet stands, how its stage goes, and a plan.

::

    rings                 meridians                  stripes
      ____ sheet level     | sheet upright, through   | sheet upright,
      ____ stage up        o the axis; stage up       |--> and the stage goes sideways

Truths and words of station.toml and plan.toml alike are worked out here, and nowhere from what the
program that reads them makes of them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

import numpy as np

from sim.crooked import Crookedness
from sim.sensor import Mounting, Sensor
from sim.solids import Part

_SHARE_SEEN = 0.95  # of the sheet's width that a stage position is counted on for
_MIDDLE_MM = 80.0  # stage position at which a sliding sheet meets the table's axis
_STRAIGHT = Crookedness(
    yaw_rad=0.0,
    pitch_rad=0.0,
    roll_rad=0.0,
    axis_tilt_rad=0.0,
    axis_towards_rad=0.0,
    pivot_mm=(0.0, 0.0),
    table_scale=1.0,
    lift=(0.0, 0.0, 1.0),
    x_scale=1.0,
    z_scale=1.0,
)


class Cut(Enum):
    """What the station's slices are."""

    RINGS = "rings"
    MERIDIANS = "meridians"
    STRIPES = "stripes"


def standing(cut: Cut, crooked: Crookedness | None) -> Crookedness | None:
    """How a station truly stands; None: as the level bench does."""
    if cut is Cut.RINGS:
        return crooked
    off = crooked or _STRAIGHT
    x, y, z = off.lift
    lift = (x, z, y) if cut is Cut.STRIPES else off.lift
    return replace(off, roll_rad=off.roll_rad + math.pi / 2.0, lift=lift)


def mounting_for(cut: Cut, part: Part) -> Mounting:
    """Where the sensor is mounted: a sheet that slides has its middle at the part's."""
    if cut is not Cut.STRIPES:
        # The sheet passes under the plate at stage 0, so that a ring may lie at the very foot.
        return Mounting(height_mm=-3.0)
    middle_mm = round(float(part.vertices_mm[:, 2].max()) / 2.0, 3)
    return Mounting(height_mm=middle_mm, side_mm=_MIDDLE_MM)


def kinematics_toml(cut: Cut) -> str:
    """The keys of [kinematics] that are not those of a level sheet that is lifted."""
    upright = "roll_deg = 90.0  # the sheet stands upright\n"
    sliding = "stage_x_mm = 0.0\nstage_y_mm = 1.0\nstage_z_mm = 0.0\n"
    return {Cut.RINGS: "", Cut.MERIDIANS: upright, Cut.STRIPES: upright + sliding}[cut]


def meridian_toml(mounting: Mounting, sensor: Sensor, part: Part, count: int) -> str:
    """[meridian] all round, with as many stage positions as the part's height needs."""
    height_mm = float(part.vertices_mm[:, 2].max())
    radius_mm = float(np.hypot(*part.vertices_mm.T[:2]).max())
    half_mm = _SHARE_SEEN * (mounting.standoff_mm - radius_mm) * sensor.steepest
    places = math.ceil(height_mm / (2.0 * half_mm))
    step_mm = height_mm / places
    ends_mm = [
        mounting.lifting.value * (at_mm - mounting.height_mm)
        for at_mm in (step_mm / 2.0, height_mm - step_mm / 2.0)
    ]
    lines = ["[meridian]", f"per_turn = {count}", f"first_mm = {round(min(ends_mm), 6)}"]
    if places > 1:
        lines += [f"last_mm = {round(max(ends_mm), 6)}", f"step_mm = {round(step_mm, 6)}"]
    return "\n".join(lines)


def stripe_toml(mounting: Mounting, part: Part, count: int) -> str:
    """[stripe] from one side of the part to the other."""
    low_mm, high_mm = float(part.vertices_mm[:, 1].min()), float(part.vertices_mm[:, 1].max())
    step_mm = (high_mm - low_mm) / count
    first_mm = mounting.side_mm + low_mm + step_mm / 2.0
    last_mm = first_mm + (count - 1) * step_mm
    return "\n".join(
        ("[stripe]", f"first_mm = {first_mm:.6f}", f"last_mm = {last_mm:.6f}",
         f"step_mm = {step_mm:.6f}")
    )  # fmt: skip
