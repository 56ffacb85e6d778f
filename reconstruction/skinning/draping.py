"""A mesh near points laid through them: all its vertices at once, stiff as the points have it.

Vertices move along their normals by h, so that the mesh goes through the points and its curvature
changes little from place to place::

    sum over points  (rise - h)^2 / variance  +  integral of  stiffness (excess + Laplacian h)^2

The excess is the mesh's curvature beyond that of its surroundings, as far as points have seen
them. So noise and roundings of the mesh that h starts from do not stay, and what no slice tells, at
a gap, between slices or on a top that lies between two of them, goes on bent as all around is.
(With the Laplacian of h alone, a mesh that dipped between the last outlines of a dome kept its dip.
A quadratic surface through the points around each vertex by itself was twice as far off beside
gaps: a window that sees points on one side only goes on as their noise happens to slope.)

The stiffness varies over the surface: a broad flank is smoothed widely, and an ear is not smoothed
away. It follows from the points by two steps of restricted likelihood (Wood, Fasiolo 2017,
doi:10.1111/biom.12666), its two sums taken over some grains around each vertex. The freedom that
points use up is told by surfaces drawn from the posterior, an exact inverse being far dearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import SuperLU, splu
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.mesh_feet import MeshFeet, mesh_feet, vertex_normals

_FIRST_WAVE = 0.8  # grains: what is shorter, the first stiffness smooths
_WIDER = 1.3  # than likelihood says after so few steps; 1.25 and 1.35 do about as well
_MOST_WIDER = 4.0  # than before, and narrower: no one step tells more
_ALIKE = 3.0  # grains: over which curvature is compared with that of the surroundings
_BARELY, _LEAST_SEEN = 0.1, 1e-4  # of the usual weight of points around a vertex
_AROUND = 1.0  # grains, in which the stiffness is alike
_DRAWN = 4  # surfaces
_LESSONS = 2  # turns after which the stiffness is learnt
_ROUNDS = 2  # after the first turn
_LEVEL = 0.05  # of the variance in the plane: what is left of it on a level wall
_EXACT = 1e-3  # of a grain: scatter below it is none
_FAR, _FAR_GRAINS = 5.0, 0.5  # standard deviations and grains up to which points are of a mesh
_FLATTEST, _STEEPEST = 0.02, 3.0  # halves of cotangents: slivers would tear the Laplacian
_LEAST_AREA = 1e-3  # of the usual one of a vertex
_RIDGE = 1e-9  # of the usual pivot
_EMPTY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points, where they look and how certain they are."""

    points_mm: FloatArray  # (n, 3)
    outward: FloatArray  # (n, 3)
    counts: FloatArray  # (n,)
    sigma_mm: float  # of one count, in the planes perpendicular to ...
    axis: FloatArray  # ... (3,)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """What points ask of moves h of the vertices: design @ h = rises."""

    design: csr_array  # (m, v)
    rises_mm: FloatArray  # (m,)
    weights: FloatArray  # (m,), inverse variances


def draped(
    vertices_mm: FloatArray, faces: IntArray, cloud: Cloud, *, grain_mm: float
) -> FloatArray:
    """Vertices (v, 3) of a closed mesh laid through points; without points they stay.

    Parameters
    ----------
    grain_mm
        What is smaller cannot be told: the distance of slices, or of points on the surface.
    """
    laplacian, areas = _laplacian(vertices_mm, faces)
    normals = vertex_normals(vertices_mm, faces)
    rows = _rows(vertices_mm, faces, cloud, grain_mm)
    if not rows.weights.any():
        return vertices_mm
    density = float(rows.weights.sum() / areas.sum())
    stiffness = np.full(len(areas), density * (_FIRST_WAVE * grain_mm) ** 4)
    around = _around(laplacian, areas, grain_mm)
    seen = _seen(rows, areas, around)
    for turn in range(_ROUNDS + 1):
        excess = _excess(vertices_mm, faces, normals, seen, grain_mm)
        factor, step = _solved(rows, laplacian, areas, stiffness, excess)
        if turn < _LESSONS:
            bends = excess + (laplacian @ step) / areas
            stiffness = _learnt(rows, laplacian, areas, stiffness, bends, factor, around)
        vertices_mm = vertices_mm + np.clip(step, -grain_mm, grain_mm)[:, None] * normals
        if turn == _ROUNDS:
            break
        normals = vertex_normals(vertices_mm, faces)
        rows = _rows(vertices_mm, faces, cloud, grain_mm)
    return vertices_mm


def _around(laplacian: csr_array, areas: FloatArray, grain_mm: float) -> SuperLU:
    """What smooths over a grain around each vertex, once factorised."""
    return _factorised(csr_array(diags_array(areas) + (_AROUND * grain_mm) ** 2 * laplacian))


def _seen(rows: _Rows, areas: FloatArray, around: SuperLU) -> FloatArray:
    """How much of what the surface is at vertices (v,) points say: 1 nearly all, 0 nothing."""
    told = np.asarray(around.solve(np.asarray(rows.design.T @ rows.weights)))
    share = np.maximum(told, 0.0) / (_BARELY * float(np.median(told)))
    return np.asarray(np.maximum(share / (1.0 + share), _LEAST_SEEN))


def _excess(
    vertices_mm: FloatArray,
    faces: IntArray,
    normals: FloatArray,
    seen: FloatArray,
    grain_mm: float,
) -> FloatArray:
    """Curvature (v,) beyond that of the surroundings that points have seen, 1/mm."""
    laplacian, areas = _laplacian(vertices_mm, faces)
    curvature = np.einsum("vd,vd->v", laplacian @ vertices_mm, normals) / areas
    wide = csr_array(diags_array(areas * seen) + (_ALIKE * grain_mm) ** 2 * laplacian)
    return np.asarray(curvature - _factorised(wide).solve(areas * seen * curvature))


def _rows(vertices_mm: FloatArray, faces: IntArray, cloud: Cloud, grain_mm: float) -> _Rows:
    feet = mesh_feet(cloud.points_mm, cloud.outward, vertices_mm, faces)
    shape = (len(feet.which), len(vertices_mm))
    places = (np.repeat(np.arange(shape[0]), 3), feet.corners.ravel())
    design = csr_array((feet.shares.ravel(), places), shape=shape)
    return _Rows(design, feet.rises_mm, _weights(feet, cloud, grain_mm))


def _weights(feet: MeshFeet, cloud: Cloud, grain_mm: float) -> FloatArray:
    """Inverse variances along the normals (m,); none for what lies too far off."""
    sigma = max(cloud.sigma_mm, _EXACT * grain_mm)
    variances = sigma**2 * (1.0 - (feet.normals @ cloud.axis) ** 2 + _LEVEL)
    reach = _FAR * sigma + _FAR_GRAINS * grain_mm
    near = np.clip((reach - feet.away_mm) / sigma, 0.0, 1.0)
    return np.asarray(cloud.counts[feet.which] * near / variances)


def _laplacian(vertices_mm: FloatArray, faces: IntArray) -> tuple[csr_array, FloatArray]:
    """The cotangent Laplacian (v, v), not divided by the areas of vertices (v,)."""
    count = len(vertices_mm)
    values, rows, columns, areas = [], [], [], np.zeros(count)
    for k in range(3):
        i, j, apex = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3], faces[:, k]
        one, other = vertices_mm[i] - vertices_mm[apex], vertices_mm[j] - vertices_mm[apex]
        twice = np.linalg.norm(np.cross(one, other), axis=1)
        cotangents = np.einsum("fd,fd->f", one, other) / np.maximum(twice, _EMPTY)
        half = np.clip(cotangents / 2.0, _FLATTEST, _STEEPEST)
        values += [half, half]
        rows += [i, j]
        columns += [j, i]
        areas += np.bincount(apex, twice / 6.0, count)
    places = (np.concatenate(rows), np.concatenate(columns))
    beside = csr_array((np.concatenate(values), places), shape=(count, count))
    total = np.asarray(beside.sum(axis=1)).ravel()
    return (
        csr_array(diags_array(total) - beside),
        np.maximum(areas, _LEAST_AREA * float(np.median(areas))),
    )


def _solved(
    rows: _Rows,
    laplacian: csr_array,
    areas: FloatArray,
    stiffness: FloatArray,
    excess: FloatArray,
) -> tuple[SuperLU, FloatArray]:
    """The factor of the system, and the moves (v,) that it asks for."""
    design = rows.design
    bending = laplacian @ diags_array(stiffness / areas) @ laplacian
    factor = _factorised(csr_array(design.T @ diags_array(rows.weights) @ design + bending))
    right = design.T @ (rows.weights * rows.rises_mm) - laplacian @ (stiffness * excess)
    return factor, np.asarray(factor.solve(right))


def _factorised(matrix: csr_array) -> SuperLU:
    """Of a positive matrix, that need not be quite positive where nothing stands."""
    ridge = _RIDGE * float(np.median(matrix.diagonal()))
    whole = csc_array(matrix + diags_array(np.full(matrix.shape[0], ridge)))
    with threadpool_limits(1, "blas"):
        return splu(
            whole,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )


def _learnt(
    rows: _Rows,
    laplacian: csr_array,
    areas: FloatArray,
    stiffness: FloatArray,
    bends: FloatArray,
    factor: SuperLU,
    around: SuperLU,
) -> FloatArray:
    """The stiffness (v,) after one step: freedom used up over the bends there are, around each."""
    rng = np.random.default_rng(0)
    design, weights = rows.design, rows.weights
    noise = design.T @ (np.sqrt(weights)[:, None] * rng.normal(size=(len(weights), _DRAWN)))
    prior = np.sqrt(stiffness / areas)[:, None] * rng.normal(size=(len(areas), _DRAWN))
    drawn = np.asarray(factor.solve(noise + laplacian @ prior))
    used = design.T @ (weights * ((design @ drawn) ** 2).mean(axis=1))
    squares = areas * bends**2
    used, squares = (areas * around.solve(np.asarray(each)) for each in (used, squares))
    told = _WIDER**4 * np.maximum(used, _EMPTY) / np.maximum(squares, _EMPTY) / stiffness
    return np.asarray(stiffness * np.clip(told, _MOST_WIDER**-4, _MOST_WIDER**4))
