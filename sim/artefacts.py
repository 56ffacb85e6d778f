"""Calibration artefacts as parts, and the artefact.toml that says what is certified of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from sim.arrays import FaceArray, FloatArray
from sim.solids import Part, stack_rings

_AROUND, _LEVELS = 160, 100
_BALL_MM = 10.0
BALLS_MM: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {"low": (28.0, 0.0, 18.0), "middle": (-14.0, 24.0, 40.0), "high": (-14.0, -24.0, 62.0)}
)
_PLATE_AT_MM, _PLATE_FACES = (6.0, 2.0, 40.0), (1.0, 0.35, 0.2)
_PLATE_HALF_MM, _PLATE_THICK_MM = 15.0, 2.0
_HELD_OUT = ("middle", "high")


def ball_plate() -> Part:
    """Three balls at three heights and a tilted plate between them; stems are not modelled."""
    solids = [_ball(middle) for middle in BALLS_MM.values()] + [_plate()]
    vertices, faces, first = [], [], 0
    for each, corners in solids:
        vertices.append(each)
        faces.append(corners + first)
        first += len(each)
    return Part("ball-plate", np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def ball_plate_toml() -> str:
    """What a certificate of it would say."""
    lines = ['name = "ball plate"', 'certificate = "simulated, exact"']
    for name in BALLS_MM:
        lines += ["", f"[spheres.{name}]", f"radius_mm = {_BALL_MM}"]
    lines += ["", "[planes.plate]"]
    names = list(BALLS_MM)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        pair = (names[one], names[other])
        away_mm = math.dist(BALLS_MM[pair[0]], BALLS_MM[pair[1]])
        lines += ["", f"[spacings.{pair[0]}-{pair[1]}]", f'one = "{pair[0]}"',
                  f'other = "{pair[1]}"', f"distance_mm = {away_mm:.6f}", "sd_mm = 0.001",
                  f"held_out = {str(pair == _HELD_OUT).lower()}"]  # fmt: skip
    return "\n".join(lines) + "\n"


def gauge_cylinder() -> Part:
    """A reference cylinder of radius 20 mm that stands 6 mm beside the axis."""
    angle = np.arange(2048) * (math.tau / 2048)
    rings = [
        np.column_stack([6.0 + 20.0 * np.cos(angle), 20.0 * np.sin(angle), np.full(2048, z)])
        for z in (0.0, 60.0)
    ]
    return Part("gauge-cylinder", *_closed(np.stack(rings), (6.0, 0.0)))


def step_gauge() -> Part:
    """Cylinders of 30, 24 and 18 mm radius on each other, 20 mm high each, coaxial."""
    angle = np.arange(2048) * (math.tau / 2048)
    levels = ((30.0, 0.0), (30.0, 20.0), (24.0, 20.0), (24.0, 40.0), (18.0, 40.0), (18.0, 60.0))
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(2048, z)])
             for r, z in levels]  # fmt: skip
    return Part("step-gauge", *stack_rings(np.stack(rings)))


def _ball(middle_mm: tuple[float, float, float]) -> tuple[FloatArray, FaceArray]:
    # A polyhedron lies inside its ball: made larger, it is off by nothing in the mean.
    inside = ((math.pi / _AROUND) ** 2 + (math.pi / _LEVELS / 2.0) ** 2) / 3.0
    radius = _BALL_MM * (1.0 + inside)
    lat = np.linspace(-math.pi / 2, math.pi / 2, _LEVELS + 1)[1:-1]
    lon = np.arange(_AROUND) * (math.tau / _AROUND)
    rings = np.stack(
        [np.column_stack([radius * math.cos(a) * np.cos(lon), radius * math.cos(a) * np.sin(lon),
                          np.full(_AROUND, radius * math.sin(a))]) for a in lat]
    )  # fmt: skip
    vertices, faces = stack_rings(rings, top_mm=np.array([0.0, 0.0, radius]))
    vertices[-2] = (0.0, 0.0, -radius)
    return vertices + np.array(middle_mm), faces


def _plate() -> tuple[FloatArray, FaceArray]:
    normal = np.array(_PLATE_FACES) / np.linalg.norm(_PLATE_FACES)
    across = np.cross([0.0, 0.0, 1.0], normal)
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    front = np.array(_PLATE_AT_MM)
    corners = []
    for back in (_PLATE_THICK_MM, 0.0):
        for a, u in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            corners.append(front - back * normal + _PLATE_HALF_MM * (a * across + u * up))
    quads = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    faces = [t for q in quads for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    return np.array(corners), np.array(faces, np.int32)


def _closed(rings: FloatArray, middle: tuple[float, float]) -> tuple[FloatArray, FaceArray]:
    vertices, faces = stack_rings(rings)
    vertices[-2:, :2] = middle
    return vertices, faces


ARTEFACTS: Mapping[str, Callable[[], Part]] = MappingProxyType(
    {"ball-plate": ball_plate, "gauge-cylinder": gauge_cylinder, "step-gauge": step_gauge}
)
CERTIFICATES: Mapping[str, Callable[[], str]] = MappingProxyType({"ball-plate": ball_plate_toml})
