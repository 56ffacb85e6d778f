"""Parts scanned by meridians and by stripes, from closed formulas; noise in the plane of light."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.slices import Frame, Slice

Turned = Callable[[FloatArray, FloatArray], FloatArray]  # distance from the axis at angle, height
Relief = Callable[[FloatArray, FloatArray], FloatArray]  # height at x, y

SIGMA = 0.05
VASE_HEIGHT = 120.0
SPHERE_RADIUS = 30.0
STEP_MM = 2.0


def vase(angle: FloatArray, z: FloatArray) -> FloatArray:
    """Of revolution, waisted."""
    del angle
    return 35.0 + 12.0 * np.sin(math.tau * z / 130.0 + 0.4) + 4.0 * np.cos(math.tau * z / 55.0)


def lobed_vase(angle: FloatArray, z: FloatArray) -> FloatArray:
    """The same with five lobes that twist."""
    return vase(angle, z) * (1.0 + 0.1 * np.cos(5.0 * angle + z / 40.0))


def bulge(x: FloatArray, y: FloatArray) -> FloatArray:
    """A plate that is pressed out in one place, and warped."""
    round_ = ((x - 5.0) ** 2 + (y + 8.0) ** 2) / (2.0 * 18.0**2)
    return 6.0 * np.exp(-round_) + 0.002 * x * y


def beyond_step(x: FloatArray, y: FloatArray) -> FloatArray:
    """How far beyond the step that runs over `stepped_bulge`, mm along x."""
    return x - 25.0 - 0.1 * y


def stepped_bulge(x: FloatArray, y: FloatArray) -> FloatArray:
    """The same with a step across it, askew; its wall is upright, and no light meets it."""
    return bulge(x, y) + STEP_MM * (beyond_step(x, y) > 0.0)


def lost(rng: np.random.Generator, along: FloatArray, share: float) -> FloatArray:
    """Places along a section without those of one gap."""
    low, high = along.min(), along.max()
    start = rng.uniform(low, high - share * (high - low))
    return along[(along < start) | (along > start + share * (high - low))]


def meridian_slices(
    radius: Turned,
    *,
    count: int = 72,
    points: int = 400,
    share_lost: float = 0.0,
    angles_rad: Sequence[float] | None = None,
    seed: int = 0,
) -> list[Slice]:
    """Half planes about z, all round or at the angles said, of a part VASE_HEIGHT high."""
    rng = np.random.default_rng(seed)
    turned = np.arange(count) / count * math.tau if angles_rad is None else angles_rad
    found = []
    for index, angle in enumerate(turned):
        z = np.linspace(0.0, VASE_HEIGHT, points)
        z = lost(rng, z, share_lost) if share_lost else z
        r = radius(np.full(len(z), angle), z)
        found.append(half_plane(index, float(angle), _noisy(rng, r, z)))
    return found


def sphere_meridians(*, count: int = 60, points: int = 300, seed: int = 0) -> list[Slice]:
    """From pole to pole."""
    rng = np.random.default_rng(seed)
    tilt = np.linspace(0.0, math.pi, points)
    r, z = SPHERE_RADIUS * np.sin(tilt), -SPHERE_RADIUS * np.cos(tilt)
    return [
        half_plane(index, index / count * math.tau, _noisy(rng, r, z)) for index in range(count)
    ]


def _noisy(rng: np.random.Generator, r: FloatArray, z: FloatArray) -> FloatArray:
    return np.column_stack([r, z]) + rng.normal(0.0, SIGMA, (len(r), 2))


def half_plane(index: int, angle_rad: float, planar_mm: FloatArray) -> Slice:
    """A slice through the z axis: x of its plane away from it, y along it."""
    way = np.array([math.cos(angle_rad), math.sin(angle_rad), 0.0])
    axis = np.array([0.0, 0.0, 1.0])
    frame = Frame(np.zeros(3), np.stack([way, axis, np.cross(way, axis)]))
    return Slice(index, frame.to_part(planar_mm), frame)


def stripe_slices(
    height: Relief,
    *,
    count: int = 80,
    points: int = 500,
    share_lost: float = 0.0,
    ragged: float = 0.0,
    seed: int = 0,
) -> list[Slice]:
    """Stripes along x, side by side along y, of a plate of 120 mm by 80 mm.

    `ragged` is the greatest share of points that a stripe lacks at either end.
    """
    rng = np.random.default_rng(seed)
    found = []
    for index, y in enumerate(np.linspace(-40.0, 40.0, count)):
        x = np.linspace(-60.0, 60.0, points)
        if ragged:
            low, high = (int(rng.uniform(0.0, ragged) * points) for _ in range(2))
            x = x[low : points - high]
        x = lost(rng, x, share_lost) if share_lost else x
        z = height(x, np.full(len(x), y))
        noise = rng.normal(0.0, SIGMA, (len(x), 2))
        points_mm = np.column_stack([x + noise[:, 0], np.full(len(x), y), z + noise[:, 1]])
        axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        found.append(Slice(index, points_mm, Frame(np.array([0.0, y, 0.0]), axes)))
    return found


def turned_errors(radius: Turned, places_mm: FloatArray) -> FloatArray:
    """Distances (n,) of places from a part about z, to first order."""
    x, y, z = places_mm.T
    angle, r = np.arctan2(y, x), np.hypot(x, y)
    step = 1e-4
    along = (radius(angle, z + step) - radius(angle, z - step)) / (2.0 * step)
    around = (radius(angle + step, z) - radius(angle - step, z)) / (2.0 * step * r)
    return (r - radius(angle, z)) / np.sqrt(1.0 + along**2 + around**2)


def relief_errors(height: Relief, places_mm: FloatArray) -> FloatArray:
    """The same of a relief without a step nearby."""
    x, y, z = places_mm.T
    step = 1e-4
    along = (height(x + step, y) - height(x - step, y)) / (2.0 * step)
    across = (height(x, y + step) - height(x, y - step)) / (2.0 * step)
    return (z - height(x, y)) / np.sqrt(1.0 + along**2 + across**2)


def cloud_of(slices: Sequence[Slice]) -> FloatArray:
    """All points, (n, 3), as a user has them."""
    return np.concatenate([piece.points_mm for piece in slices])


def rings_of(radius: Turned, *, count: int = 72, points: int = 400, seed: int = 0) -> list[Slice]:
    """The same part by rings, as many points."""
    return list(_rings(radius, count, points, seed))


def _rings(radius: Turned, count: int, points: int, seed: int) -> Iterator[Slice]:
    rng = np.random.default_rng(seed)
    for index, z in enumerate((np.arange(count) + 0.5) / count * VASE_HEIGHT):
        angle = np.arange(points) / points * math.tau
        r = radius(angle, np.full(points, z))
        flat = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
        flat += rng.normal(0.0, SIGMA, flat.shape)
        yield Slice(
            index,
            np.column_stack([flat, np.full(points, z)]),
            Frame(np.array([0.0, 0.0, z]), np.eye(3)),
        )


def sphere_rings(*, count: int = 60, points: int = 300, seed: int = 0) -> list[Slice]:
    """The sphere by rings, as many points."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(count):
        z = ((index + 0.5) / count * 2.0 - 1.0) * SPHERE_RADIUS
        angle = rng.uniform(0.0, math.tau, points)
        r = math.sqrt(SPHERE_RADIUS**2 - z**2)
        flat = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
        flat += rng.normal(0.0, SIGMA, flat.shape)
        places = np.column_stack([flat, np.full(points, z)])
        found.append(Slice(index, places, Frame(np.array([0.0, 0.0, z]), np.eye(3))))
    return found
