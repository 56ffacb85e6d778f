"""A naive evaluator, and surfaces of every kind for the CAD files to be held against it."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reconstruction.exporting import write_step, write_threedm
from reconstruction.nurbs.values import Curve, Surface

LARGEST_DIFFERENCE_MM = 1e-6
STAMP = "2026-01-02T03:04:05+00:00"
PROVENANCE = {"input": Path("/somewhere/secret/UHU.pcd"), "settings": {"cell_mm": 4.0}}


# --- the naive evaluator -------------------------------------------------------------------------


def naive_basis(i: int, p: int, t: float, knots: tuple[float, ...], end: float) -> float:
    """The textbook recursion; the last span before `end` is closed on the right."""
    if p == 0:
        inside = knots[i] <= t < knots[i + 1]
        return float(inside or (t == end and knots[i] < end == knots[i + 1]))
    total = 0.0
    if knots[i + p] > knots[i]:
        total += (t - knots[i]) / (knots[i + p] - knots[i]) * naive_basis(i, p - 1, t, knots, end)
    if knots[i + p + 1] > knots[i + 1]:
        total += (
            (knots[i + p + 1] - t)
            / (knots[i + p + 1] - knots[i + 1])
            * naive_basis(i + 1, p - 1, t, knots, end)
        )
    return total


def naive_row(degree, knots, count, periodic, t):
    """The values of all `count` basis functions at t; wrapped ones are added to their originals."""
    row = np.zeros(count)
    end = float(knots[len(knots) - 1 - degree])
    for i in range(len(knots) - degree - 1):
        row[i % count if periodic else i] += naive_basis(i, degree, t, tuple(knots.tolist()), end)
    return row


def naive_surface_point(surface: Surface, u: float, v: float):
    rows, columns = surface.weights.shape
    in_u = naive_row(surface.degree_u, surface.knots_u, rows, surface.periodic_u, u)
    in_v = naive_row(surface.degree_v, surface.knots_v, columns, surface.periodic_v, v)
    weights = in_u[:, None] * in_v * surface.weights
    return (weights[..., None] * surface.control_points_mm).sum(axis=(0, 1)) / weights.sum()


def naive_curve_point(curve: Curve, t: float):
    weights = curve.weights * naive_row(
        curve.degree, curve.knots, len(curve.weights), curve.periodic, t
    )
    return weights @ curve.control_points_mm / weights.sum()


# --- samples ------------------------------------------------------------------------------------


def sample_knots(degree, count, *, periodic, seed, multiple=None, clamped=True):
    """Uneven knots; `multiple` is the index in one period of a knot that stands twice."""
    rng = np.random.default_rng(seed)
    if periodic:
        steps = rng.uniform(0.5, 2.0, count)
        if multiple is not None:
            steps[multiple] = 0.0
        steps = np.tile(steps, 2 * degree // count + 3)
        knots = np.concatenate([[0.0], steps.cumsum()])[: count + 2 * degree + 1]
        return knots - knots[degree] + 0.25
    knots = rng.uniform(0.5, 2.0, count + degree + 1).cumsum()
    if clamped:
        knots[: degree + 1] = knots[degree]
        knots[count:] = knots[count]
    return knots


def sample_surface(
    degrees, counts, periodic, *, rational, seed=0, multiple=None, clamped=True
) -> Surface:
    """A dented tube, or a dented ring where v is periodic, too."""
    rng = np.random.default_rng(seed)
    around = np.linspace(0.0, 2 * np.pi * (1.0 if periodic[0] else 0.8), counts[0], endpoint=False)
    along = np.linspace(0.0, 2 * np.pi if periodic[1] else 3.0, counts[1], endpoint=False)
    u, v = np.meshgrid(around, along, indexing="ij")
    tube = 10.0 + rng.uniform(0.0, 2.0, u.shape)
    if periodic[1]:
        far = 40.0 + tube * np.cos(u)
        points = np.stack([far * np.cos(v), far * np.sin(v), tube * np.sin(u)], axis=-1)
    else:
        points = np.stack([tube * np.cos(u), tube * np.sin(u), 15.0 * v], axis=-1)
    (p, q), (nu, nv) = degrees, counts
    return Surface(
        degree_u=p,
        degree_v=q,
        knots_u=sample_knots(p, nu, periodic=periodic[0], seed=seed, multiple=multiple),
        knots_v=sample_knots(q, nv, periodic=periodic[1], seed=seed + 1, clamped=clamped),
        control_points_mm=points,
        weights=rng.uniform(0.5, 2.0, counts) if rational else np.full(counts, 1.0),
        periodic_u=periodic[0],
        periodic_v=periodic[1],
    )


def with_poles(surface: Surface) -> Surface:
    """The same tube with each end drawn into a point, as caps are."""
    points = surface.control_points_mm.copy()
    points[:, 0], points[:, -1] = points[:, 0].mean(axis=0), points[:, -1].mean(axis=0)
    return dataclasses.replace(
        surface, control_points_mm=points, weights=np.ones_like(surface.weights)
    )


SURFACES = {
    "open": sample_surface((3, 3), (9, 7), (False, False), rational=False),
    "open-rational": sample_surface((3, 2), (9, 7), (False, False), rational=True),
    "open-degree-1": sample_surface((1, 1), (6, 4), (False, False), rational=False),
    "unclamped-in-v": sample_surface((3, 3), (9, 7), (True, False), rational=True, clamped=False),
    "periodic-two-sections": sample_surface((3, 1), (12, 2), (True, False), rational=False),
    "periodic-many-degree-1": sample_surface((3, 1), (12, 6), (True, False), rational=False),
    "periodic-rational": sample_surface((3, 2), (12, 5), (True, False), rational=True),
    "periodic-degree-2": sample_surface((2, 3), (10, 6), (True, False), rational=False),
    "periodic-polygon": sample_surface((1, 1), (8, 3), (True, False), rational=True),
    "periodic-3-points": sample_surface((3, 3), (3, 4), (True, False), rational=True),
    "double-knot": sample_surface((3, 2), (12, 5), (True, False), rational=True, multiple=7),
    "double-at-seam": sample_surface((3, 2), (12, 5), (True, False), rational=True, multiple=3),
    "double-before": sample_surface((3, 2), (9, 5), (True, False), rational=True, multiple=2),
    "closed-by-poles": with_poles(
        sample_surface((3, 3), (12, 7), (True, False), rational=False)
    ),
    "ring": sample_surface((3, 3), (9, 12), (True, True), rational=False),
    "ring-rational": sample_surface((2, 3), (9, 12), (True, True), rational=True),
}  # fmt: skip
every_surface = pytest.mark.parametrize("key", SURFACES)


@cache
def probes(key: str, count: int = 500):
    """Random parameters with the corners of the domain, and the naive points there."""
    surface = SURFACES[key]
    (u0, u1), (v0, v1) = surface.domain
    inside = np.random.default_rng(7).uniform((u0, v0), (u1, v1), (count - 4, 2))
    corners = [(u0, v0), (u0, v1), (u1, v0), (u1, v1)]
    parameters = np.concatenate([inside, corners])
    return parameters, np.array([naive_surface_point(surface, u, v) for u, v in parameters])


def save_step(path: Path, surfaces: list[Surface], name: str = "vase") -> None:
    write_step(path, surfaces, name=name, provenance=PROVENANCE, time_stamp=STAMP)


def save_threedm(path: Path, surfaces: list[Surface], curves: list[Curve]) -> None:
    write_threedm(path, surfaces, curves, name="vase", provenance=PROVENANCE)
