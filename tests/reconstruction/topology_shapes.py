"""Outlines that the topology was not made for: narrow, pointed, winding, many."""

from __future__ import annotations

import math

import numpy as np

from reconstruction.arrays import FloatArray
from tests.reconstruction.topology_cases import Outline, ellipse, evenly, polar


def _polygon(*corners: tuple[float, float]) -> Outline:
    return evenly(np.array(corners))


def _turn() -> FloatArray:
    return np.linspace(0.0, math.tau, 12_000, endpoint=False)


def gear() -> Outline:
    """Twenty teeth, 8 mm high, their flanks steep."""
    return polar(40.0 + 4.0 * np.clip(3.0 * np.sin(20.0 * _turn()), -1.0, 1.0))


def rosette() -> Outline:
    return polar(35.0 + 12.0 * np.cos(9.0 * _turn()))


def spiral(pitch_mm: float) -> Outline:
    """Three turns."""
    return polar(12.0 + pitch_mm * np.linspace(0.0, 3.0, 20_000), 3.0, closed=False)


def slot(width_mm: float) -> Outline:
    """A block with a slot between whose sides there is little room."""
    near, far = 30.0 - width_mm / 2, 30.0 + width_mm / 2
    return _polygon((0, 0), (60, 0), (60, 40), (far, 40), (far, 8), (near, 8), (near, 40), (0, 40))


def clamp(width_mm: float) -> Outline:
    """A C whose mouth is narrow."""
    low, high = 20.0 - width_mm / 2, 20.0 + width_mm / 2
    return _polygon(
        (0, 0), (60, 0), (60, low), (15, low), (15, high), (60, high), (60, 40), (0, 40)
    )


def fins(pitch_mm: float) -> Outline:
    """A heat sink of six fins, as thick as the room between them."""
    corners = [(pitch_mm / 4, 0.0), (5.75 * pitch_mm, 0.0)]
    for fin in reversed(range(6)):
        right, left = (fin + 0.75) * pitch_mm, (fin + 0.25) * pitch_mm
        corners += [(right, 5.0), (right, 40.0), (left, 40.0), (left, 5.0)]
    return _polygon(corners[0], corners[1], *corners[3:-1])


def beam() -> Outline:
    """A T."""
    return _polygon((0, 0), (60, 0), (60, 6), (33, 6), (33, 50), (27, 50), (27, 6), (0, 6))


def box() -> Outline:
    return _polygon((0, 0), (80, 0), (80, 30), (0, 30))


def star() -> Outline:
    angle = np.arange(10) * math.pi / 5
    radius = np.where(np.arange(10) % 2, 25.0, 60.0)
    return evenly(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def heart() -> Outline:
    t = _turn()
    y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
    return evenly(3.0 * np.stack([16 * np.sin(t) ** 3, y], axis=1))


def airfoil() -> Outline:
    """NACA 0012 with a closed trailing edge, 100 mm."""
    t = np.linspace(0.0, 1.0, 3000)
    powers = [np.sqrt(t), t, t**2, t**3, t**4]
    y = 0.6 * np.dot([0.2969, -0.126, -0.3516, 0.2843, -0.1036], powers)
    return evenly(100.0 * np.stack([np.r_[t, t[-2:0:-1]], np.r_[y, -y[-2:0:-1]]], axis=1))


def tight_s(band_mm: float) -> Outline:
    """An S whose short ends come within five bands, the middle stroke between them."""
    half, radius = 2.5 * band_mm, 10.0
    sweep = np.linspace(-math.pi, math.pi, 1600) * (1.0 - math.asin(half / 2 / radius) / math.pi)
    bulb = np.stack([32.0 + radius * np.cos(sweep), half / 2 + radius * np.sin(sweep)], axis=1)
    right = np.vstack([bulb, [[0.0, half]]])
    return evenly(np.vstack([-right[::-1], right]), closed=False)


def concentric(apart_mm: float) -> list[Outline]:
    return [ellipse(40, 40), ellipse(40 - apart_mm, 40 - apart_mm)]


def side_by_side(apart_mm: float) -> list[Outline]:
    return [ellipse(25, 25), ellipse(25, 25, (50.0 + apart_mm, 0.0))]


def plate() -> list[Outline]:
    """A plate with twelve holes."""
    holes = [ellipse(5, 5, (10.0 + 20 * x, 10.0 + 20 * y)) for x in range(4) for y in range(3)]
    return [_polygon((-3, -3), (83, -3), (83, 63), (-3, 63)), *holes]
