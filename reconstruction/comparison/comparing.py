"""Comparing points, clouds and meshes with a mesh or a cloud."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.comparison.alignment import best_fit, moved
from reconstruction.comparison.deviation import (
    Alignment,
    Deviation,
    Method,
    judge,
    statistics,
)
from reconstruction.comparison.reference import measure, reference
from reconstruction.comparison.sampling import sample_surface
from reconstruction.errors import TooFewPoints
from reconstruction.meshing import Mesh


class Align(Enum):
    """What is done to the points before they are compared."""

    NONE = "none"
    BEST_FIT = "best-fit"


class Ways(Enum):
    """Whether the second mesh is compared with the first as well."""

    ONE = "one"
    BOTH = "both"


@dataclass(frozen=True, slots=True)
class Limits:
    """What counts, and what is allowed."""

    tolerance_mm: float | None = None  # None: no verdict
    required_share: float = 1.0  # of the points that must keep the tolerance
    max_distance_mm: float | None = None  # farther points are set aside and counted


@dataclass(frozen=True, slots=True, eq=False)
class MeshDeviation:
    """Two meshes compared; the points are the vertices, or `samples` drawn by area."""

    a_to_b: Deviation
    b_to_a: Deviation | None  # a is moved by the alignment of a_to_b first
    samples: int | None


def compare_to_mesh(
    points_mm: FloatArray,
    mesh: Mesh,
    *,
    align: Align = Align.NONE,
    tolerance_mm: float | None = None,
    max_distance_mm: float | None = None,
    required_share: float = 1.0,
) -> Deviation:
    """Signed distance of every point to a mesh, positive outside.

    Parameters
    ----------
    points_mm
        (n, 3), finite.
    tolerance_mm
        Largest allowed distance; without one there is no verdict.
    max_distance_mm
        Points farther off are marked `beyond`, and neither counted nor judged.
    required_share
        Share of the points that has to keep the tolerance; 1.0 is all.

    Raises
    ------
    TooFewPoints
        There are no points, or fewer than a best fit needs.
    ValueError
        The points or the mesh are not finite, the mesh has no faces, or a limit makes no sense.
    """
    if len(points_mm) == 0:
        raise TooFewPoints("compare: there are no points")
    against = reference(mesh)
    alignment = best_fit(points_mm, against) if align is Align.BEST_FIT else None
    readings = measure(points_mm if alignment is None else _aligned(points_mm, alignment), against)
    limits = Limits(tolerance_mm, required_share, max_distance_mm)
    return _deviation(
        Method.POINT_TO_TRIANGLE,
        readings.distances_mm, readings.on_border, readings.faces, limits, alignment,
    )  # fmt: skip


def compare_meshes(
    a: Mesh,
    b: Mesh,
    *,
    align: Align = Align.NONE,
    tolerance_mm: float | None = None,
    max_distance_mm: float | None = None,
    required_share: float = 1.0,
    ways: Ways = Ways.ONE,
    samples: int | None = None,
    seed: int = 0,
) -> MeshDeviation:
    """Signed distances of mesh `a` to mesh `b`, and back where asked for.

    Parameters
    ----------
    samples
        Compare this many points drawn by area; None compares the vertices in use.
    """
    limits = Limits(tolerance_mm, required_share, max_distance_mm)
    there = _points_against(_points_of(a, samples, seed), b, align, limits)
    back = None
    if ways is Ways.BOTH:
        points = _points_of(b, samples, seed + 1)
        if there.alignment is not None:
            a = Mesh(_aligned(a.vertices_mm, there.alignment), a.faces, a.synthetic)
        back = _points_against(points, a, Align.NONE, limits)
    return MeshDeviation(there, back, samples)


def compare_clouds(
    points_mm: FloatArray,
    reference_mm: FloatArray,
    *,
    tolerance_mm: float | None = None,
    max_distance_mm: float | None = None,
    required_share: float = 1.0,
) -> Deviation:
    """Distance of every point to the nearest point of another cloud, without a sign.

    It exceeds the distance to the surface that the cloud was taken from by up to the spacing of
    its points; compare with a mesh where there is one.
    """
    if len(points_mm) == 0 or len(reference_mm) == 0:
        raise TooFewPoints("compare: there are no points")
    distances, nearest = cKDTree(reference_mm).query(points_mm)
    limits = Limits(tolerance_mm, required_share, max_distance_mm)
    no_border = np.zeros(len(points_mm), dtype=np.bool_)
    return _deviation(
        Method.POINT_TO_POINT,
        np.asarray(distances, dtype=np.float64),
        no_border,
        np.asarray(nearest, dtype=np.int64),
        limits,
        None,
    )


def _points_of(mesh: Mesh, samples: int | None, seed: int) -> FloatArray:
    if samples is not None:
        return sample_surface(mesh, samples, seed=seed)
    return np.asarray(mesh.vertices_mm[np.unique(mesh.faces)])


def _points_against(points_mm: FloatArray, mesh: Mesh, align: Align, limits: Limits) -> Deviation:
    return compare_to_mesh(
        points_mm,
        mesh,
        align=align,
        tolerance_mm=limits.tolerance_mm,
        max_distance_mm=limits.max_distance_mm,
        required_share=limits.required_share,
    )


def _aligned(points_mm: FloatArray, alignment: Alignment) -> FloatArray:
    return moved(points_mm, alignment.transform)


def _deviation(
    method: Method,
    distances_mm: FloatArray,
    on_border: BoolArray,
    nearest: IntArray,
    limits: Limits,
    alignment: Alignment | None,
) -> Deviation:
    if limits.max_distance_mm is not None and not limits.max_distance_mm > 0:
        raise ValueError(f"max_distance_mm must be above 0, got {limits.max_distance_mm}")
    farthest = np.inf if limits.max_distance_mm is None else limits.max_distance_mm
    beyond = np.abs(distances_mm) > farthest
    verdict = None
    if limits.tolerance_mm is not None:
        verdict = judge(
            distances_mm,
            beyond,
            tolerance_mm=limits.tolerance_mm,
            required_share=limits.required_share,
        )
    numbers = statistics(distances_mm, on_border, beyond)
    return Deviation(method, distances_mm, on_border, beyond, nearest, numbers, verdict, alignment)
