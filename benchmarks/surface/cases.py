"""The clouds that every method gets, each with the surface it was taken from.

Lengths are scaled so that the diagonal of the bounding box is 100 mm, so millimetres there are per
cent of the diagonal. The cylinder keeps its own size. Every random draw has a seed of the run's
seed and the case's name: the same names and seed give the same clouds, whatever else is run.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.surface.contours import draw, outlines
from benchmarks.surface.shapes import cone, vase

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

DIAGONAL_MM = 100.0
SLICES, POINTS_A_SLICE = 60, 500
NOISE_SHARE = 0.003  # of the diagonal, in each of the two directions of the slice
GAP_SHARE = 0.2  # of the length of every contour
DATA = Path(os.environ.get("LOFTSCAN_DATA", Path(__file__).resolve().parents[3] / "shared/data"))
MODELS = ("spot", "nefertiti_lowres", "penguin_hr", "torus")

RADIUS_MM, HEIGHT_MM, SIGMA_MM = 50.0, 100.0, 0.2
CYLINDER_POINTS = 1_000_000
GAP_RAD, PATCH_MM, PATCHES = math.radians(36.0), 20.0, 5
JUDGED_MM = (3.0, 97.0)  # of the height: the rims are nobody's side surface


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A closed triangle mesh, faces counter-clockwise seen from outside."""

    vertices_mm: Array  # (n, 3)
    faces: NDArray[np.int64]  # (m, 3)

    def solid(self) -> trimesh.Trimesh:
        """The same for trimesh, untouched."""
        return trimesh.Trimesh(self.vertices_mm, self.faces, process=False)


@dataclass(frozen=True, slots=True)
class Gap:
    """A missing piece of the cylinder's side: from an angle on, between two heights."""

    start_rad: float
    low_mm: float
    high_mm: float

    def holds(self, angle_rad: Array, height_mm: Array) -> Bools:
        """Which places (n,) lie in it."""
        turned = np.mod(angle_rad - self.start_rad, math.tau)
        return (turned < GAP_RAD) & (height_mm >= self.low_mm) & (height_mm < self.high_mm)

    def meets(self, other: Gap) -> bool:
        """Whether the two have a place in common."""
        apart = abs((self.start_rad - other.start_rad + math.pi) % math.tau - math.pi)
        level = self.low_mm < other.high_mm and other.low_mm < self.high_mm
        return apart < GAP_RAD and level


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A cloud and where it comes from."""

    name: str
    points_mm: Array  # (n, 3), shuffled
    normals: Array  # (n, 3), of the true surface, outward
    axis: str  # perpendicular to the slices
    pitch_mm: float  # from slice to slice, or the grain the cylinder's peers are reduced to
    truth: Truth | None  # None: the cylinder, whose truth is its radius
    gaps: tuple[Gap, ...] = ()  # of the cylinder
    apex_mm: Array | None = None
    notes: tuple[str, ...] = field(default=())


def case_names() -> list[str]:
    """Every case, those with gaps after those without."""
    sliced = [*MODELS, "cone", "vase"]
    return ["cylinder", *sliced, *(f"{name}+gaps" for name in sliced)]


def make_case(name: str, *, seed: int, axis: str = "z") -> Case:
    """Make a case by its name.

    Raises
    ------
    FileNotFoundError
        A model of the data folder is not there.
    """
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    if name == "cylinder":
        return cylinder(rng)
    shape = name.removesuffix("+gaps")
    if shape in ("cone", "vase"):
        made: Callable[[], tuple[Array, NDArray[np.int64]]] = {"cone": cone, "vase": vase}[shape]
        solid = trimesh.Trimesh(*made(), process=False)
        chosen = "z"
    else:
        solid = _model(DATA / "models" / f"{shape}.obj")
        chosen = axis if axis != "longest" else "xyz"[int(np.argmax(solid.extents))]
    solid.apply_scale(DIAGONAL_MM / float(np.linalg.norm(solid.extents)))
    apex = solid.vertices[np.argmax(solid.vertices[:, 2])] if shape == "cone" else None
    return sliced_case(name, solid, rng, axis=chosen, apex_mm=apex)


def _model(path: Path) -> trimesh.Trimesh:
    """Read a model with its vertices merged: the files repeat them for texture."""
    if not path.is_file():
        raise FileNotFoundError(f"{path.name}: no such model; set LOFTSCAN_DATA")
    read = trimesh.load_mesh(path, process=False)
    merged = trimesh.Trimesh(read.vertices, read.faces, process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    assert merged.is_watertight, path
    return trimesh.Trimesh(merged.vertices, merged.faces, process=False)


def sliced_case(
    name: str,
    solid: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    axis: str,
    apex_mm: Array | None = None,
) -> Case:
    """Cut a solid at the mid-heights of 60 layers; noise in the plane of the cut only."""
    column = "xyz".index(axis)
    low, high = solid.bounds[:, column]
    pitch, direction = (high - low) / SLICES, np.eye(3)[column]
    lost = GAP_SHARE if name.endswith("+gaps") else 0.0
    pieces, counts = [], []
    for k in range(SLICES):
        found = outlines(solid, direction, low + (k + 0.5) * pitch)
        pieces.append(draw(found, POINTS_A_SLICE, rng, lost_share=lost))
        counts.append(len(found))
    clean = np.concatenate([places for places, _ in pieces])
    faces = np.concatenate([numbers for _, numbers in pieces])
    sigma = NOISE_SHARE * float(np.linalg.norm(solid.extents))
    noise = rng.normal(0.0, sigma, clean.shape) * (1.0 - direction)
    order = rng.permutation(len(clean))
    return Case(
        name,
        (clean + noise)[order],
        np.array(solid.face_normals[faces])[order],
        axis,
        pitch,
        Truth(np.array(solid.vertices), np.array(solid.faces, dtype=np.int64)),
        apex_mm=apex_mm,
        notes=(
            f"{SLICES} slices perpendicular to {axis} at mid-heights, {pitch:.3f} mm apart, "
            f"{min(counts)} to {max(counts)} outlines each; {len(clean)} points uniform in arc "
            f"length, sigma {sigma:.3f} mm in the plane"
            + (f"; an arc of {lost:.0%} of every outline lost" if lost else ""),
        ),
    )


def cylinder(rng: np.random.Generator, count: int = CYLINDER_POINTS) -> Case:
    """Draw the side of a cylinder, uniform by area outside the gaps, noise in all directions."""
    gaps = draw_gaps(rng)
    angles, heights = np.empty(0), np.empty(0)
    while len(angles) < count:
        more, up = rng.uniform(0.0, math.tau, count), rng.uniform(0.0, HEIGHT_MM, count)
        seen = ~in_gaps(gaps, more, up)
        angles, heights = np.append(angles, more[seen]), np.append(heights, up[seen])
    angles, heights = angles[:count], heights[:count]
    normals = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    places = RADIUS_MM * normals + np.stack([np.zeros(count), np.zeros(count), heights], axis=1)
    area = math.tau * HEIGHT_MM
    missing = sum(GAP_RAD * (gap.high_mm - gap.low_mm) for gap in gaps) / area
    return Case(
        "cylinder",
        places + rng.normal(0.0, SIGMA_MM, places.shape),
        normals,
        "z",
        1.0,
        None,
        gaps,
        notes=(
            f"D 100 mm, H 100 mm, {count} points, sigma {SIGMA_MM:g} mm in every direction, "
            f"{100 * missing:.1f} % of the side missing; judged for "
            f"{JUDGED_MM[0]:g} <= z <= {JUDGED_MM[1]:g} mm",
        ),
    )


def draw_gaps(rng: np.random.Generator) -> tuple[Gap, ...]:
    """Draw a strip of full height and five patches that touch neither it nor one another."""
    gaps = [Gap(rng.uniform(0.0, math.tau), 0.0, HEIGHT_MM)]
    low, high = JUDGED_MM
    while len(gaps) < 1 + PATCHES:
        bottom = rng.uniform(low, high - PATCH_MM)
        tried = Gap(rng.uniform(0.0, math.tau), bottom, bottom + PATCH_MM)
        if not any(tried.meets(gap) for gap in gaps):
            gaps.append(tried)
    return tuple(gaps)


def in_gaps(gaps: tuple[Gap, ...], angle_rad: Array, height_mm: Array) -> Bools:
    """Which places (n,) of the side lie in a gap."""
    inside = np.zeros(len(angle_rad), dtype=np.bool_)
    for gap in gaps:
        inside |= gap.holds(angle_rad, height_mm)
    return inside
