r"""What a plan will see of a region or a part, before anything is opened.

A place is seen if some stop has it in view, near enough to the sheet, facing the sensor::

      ________  far        in view: between near and far, within the width
      \  .   /             near:    within half a step between slices of the sheet
       \____/   near       facing:  its normal within 75 degrees of the way to the sensor
         [S]

Shadows, from the sensor's camera or of one side of a part on another, are not foreseen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
import trimesh

from acquisition.frames import (
    Kinematics,
    onto_sheet,
    part_to_station,
    sensor_to_station,
)
from acquisition.plan import Estimate, Plan, check_plan, estimate, target
from acquisition.planes import check_sheet
from acquisition.station import FieldOfView, Station
from reconstruction.arrays import FloatArray, IntArray

_MOST_SLICES, _MOST_STOPS = 60, 72  # more are thinned evenly, and reach as far as those between
_AROUND, _LEVELS = 90, 45  # places of a region
_SAMPLES = 4000  # of a part
_STEEPEST = math.cos(math.radians(75.0))
_SLACK = 1.001


class Seen(IntEnum):
    """What becomes of a place that no stop sees, at the stop that it faces best."""

    NO_SLICE = 0
    FACES_AWAY = 1
    TOO_FAR = 2
    TOO_NEAR = 3
    BESIDE = 4
    SEEN = 5


WORDS = {
    Seen.NO_SLICE: "no slice comes there: widen the plan",
    Seen.FACES_AWAY: "faces away from the sensor, or no stop looks at it",
    Seen.TOO_FAR: "beyond the far end of the field of view",
    Seen.TOO_NEAR: "before its near end",
    Seen.BESIDE: "beside it",
    Seen.SEEN: "seen",
}


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """What the plan will see, and what it will cost."""

    places_mm: FloatArray  # (n, 3), part frame
    fate: IntArray  # (n,), of `Seen`
    distances_mm: FloatArray  # the sensor's z of places that are seen, lowest and highest
    cost: Estimate
    plan: Plan
    view: FieldOfView

    @property
    def share(self) -> float:
        """Of the places that are seen."""
        return float((self.fate == Seen.SEEN).mean())

    @property
    def heights_mm(self) -> tuple[float, float] | None:
        """Lowest and highest place that is seen; None: nothing is."""
        seen = self.places_mm[self.fate == Seen.SEEN, 2]
        return (float(seen.min()), float(seen.max())) if len(seen) else None

    def shares(self) -> dict[str, float]:
        """Share of the places by what becomes of them."""
        return {each.name.lower(): float((self.fate == each).mean()) for each in Seen}


def preview(
    station: Station,
    plan: Plan,
    kinematics: Kinematics,
    places_mm: FloatArray,
    normals: FloatArray,
    *,
    name: str = "plan.toml",
) -> Preview:
    """Tell what of places (n, 3) with outward normals (n, 3) a plan will see.

    Raises
    ------
    ValueError
        The plan leaves the limits, the sheet cannot cut such slices, or station.toml does not say
        the field of view.
    """
    check_plan(plan, station, name)
    check_sheet(plan, kinematics, name)
    view = station.field_of_view
    if view is None:
        raise ValueError(
            "field_of_view is missing in station.toml; add a [field_of_view] table with near_mm,"
            " far_mm, near_width_mm and far_width_mm from the sensor's data sheet"
        )
    fate, best = np.zeros(len(places_mm), np.int64), np.full(len(places_mm), -np.inf)
    least, most = math.inf, -math.inf
    step = max(1, -(-plan.count // _MOST_SLICES))
    for index in range(0, plan.count, step):
        stops = target(plan, index).stops
        for stage_mm, table_rad in stops[:: max(1, -(-len(stops) // _MOST_STOPS))]:
            here, depth_mm, cosines = _fates(
                plan, kinematics, view, places_mm, normals, (stage_mm, table_rad), step
            )
            better = (here > Seen.NO_SLICE) & (cosines > best) & (fate != Seen.SEEN)
            better |= here == Seen.SEEN
            fate[better], best[better] = here[better], cosines[better]
            if (seen := depth_mm[here == Seen.SEEN]).size:
                least, most = min(least, float(seen.min())), max(most, float(seen.max()))
    distances_mm = np.array([least, most])
    return Preview(places_mm, fate, distances_mm, estimate(plan, station), plan, view)


def region(radius_mm: float, height_mm: float) -> tuple[FloatArray, FloatArray]:
    """Places and normals on the side of a cylinder that stands on the plate, about the axis."""
    angles, heights = np.meshgrid(
        np.arange(_AROUND) * (math.tau / _AROUND),
        (np.arange(_LEVELS) + 0.5) * height_mm / _LEVELS,
    )
    ways = np.stack([np.cos(angles.ravel()), np.sin(angles.ravel()), np.zeros(angles.size)], axis=1)
    return radius_mm * ways + np.array([0.0, 0.0, 1.0]) * heights.ravel()[:, None], ways


def part_surface(path: Path) -> tuple[FloatArray, FloatArray]:
    """Places and normals spread over a mesh file's surface, in mm where it stands on the plate.

    Raises
    ------
    ValueError
        It is no mesh.
    """
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file; check the path")
    try:
        mesh = trimesh.load_mesh(path)
        places_mm, faces = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=1)
        return np.asarray(places_mm), np.asarray(mesh.face_normals[faces])
    except (ValueError, AttributeError, IndexError, KeyError, NotImplementedError) as bad:
        raise ValueError(f"{path}: no mesh ({bad}); give .stl, .ply or .obj in mm") from bad


def parse_region(text: str) -> tuple[float, float]:
    """Read --region RADIUS,HEIGHT.

    Raises
    ------
    ValueError
    """
    try:
        radius_mm, height_mm = (float(word) for word in text.split(","))
    except ValueError as wrong:
        raise ValueError(f"--region {text!r}: radius and height in mm expected, as 30,100") from (
            wrong
        )
    if not (0.0 < radius_mm < math.inf and 0.0 < height_mm < math.inf):
        raise ValueError(f"--region {text!r}: lengths above 0 mm expected")
    return radius_mm, height_mm


def _fates(
    plan: Plan,
    kinematics: Kinematics,
    view: FieldOfView,
    places_mm: FloatArray,
    normals: FloatArray,
    stop: tuple[float, float],
    slices: int,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """What becomes of every place at one stop, its sensor's z, and how it faces the sensor."""
    count = len(places_mm)
    stage, table = np.full(count, stop[0]), np.full(count, stop[1])
    standing = part_to_station(places_mm, table, kinematics)
    facing = part_to_station(normals, table, kinematics)
    planar = onto_sheet(standing, stage, kinematics)
    on_sheet = sensor_to_station(planar, stage, kinematics)
    sensor_mm = sensor_to_station(np.zeros((1, 2)), stage[:1], kinematics)
    off_mm = np.linalg.norm(standing - on_sheet, axis=1)
    ways = sensor_mm - standing
    cosines = (ways * facing).sum(axis=1) / np.linalg.norm(ways, axis=1)
    share = (planar[:, 1] - view.near_mm) / (view.far_mm - view.near_mm)
    half_mm = 0.5 * (view.near_width_mm + share * (view.far_width_mm - view.near_width_mm))
    conditions = (
        (off_mm > _SLACK * _reach(plan, kinematics, standing, slices), Seen.NO_SLICE),
        (cosines < _STEEPEST, Seen.FACES_AWAY),
        (planar[:, 1] > view.far_mm, Seen.TOO_FAR),
        (planar[:, 1] < view.near_mm, Seen.TOO_NEAR),
        (np.abs(planar[:, 0]) > half_mm, Seen.BESIDE),
    )
    fate = np.select(
        [wrong for wrong, _ in conditions], [int(why) for _, why in conditions], int(Seen.SEEN)
    )
    return fate.astype(np.int64), planar[:, 1], cosines


def _reach(plan: Plan, kinematics: Kinematics, standing: FloatArray, slices: int) -> FloatArray:
    """How far from the sheet a place still counts as its slice's: half of what is between two."""
    pattern = plan.pattern
    if plan.meridian is not None:
        half_rad = slices * math.pi / plan.meridian.per_turn
        return np.asarray(np.hypot(standing[:, 0], standing[:, 1]) * math.sin(min(half_rad, 1.5)))
    step_mm = pattern.step_mm or 0.0
    ends = sensor_to_station(np.zeros((2, 2)), np.array([0.0, step_mm]), kinematics)
    sheet = sensor_to_station(np.array([[1.0, 0.0], [0.0, 1.0]]), np.zeros(2), kinematics)
    normal = np.cross(sheet[0] - ends[0], sheet[1] - ends[0])
    across_mm = abs(float((ends[1] - ends[0]) @ normal)) / float(np.linalg.norm(normal))
    return np.full(len(standing), 0.5 * slices * across_mm)
