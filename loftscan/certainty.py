"""The standard deviation of a fitted surface, drawn on the surface itself."""

from __future__ import annotations

import numpy as np

from loftscan import figures
from loftscan.rendering import Camera, MeshLayer, Scene, render_scene
from loftscan.report import Picture
from reconstruction.arrays import FloatArray, IntArray
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.meshing import Mesh
from reconstruction.nurbs import evaluate_surface
from reconstruction.skinning.exact_skins import AnySkin

_STEPS_A_SPAN = 2
_LEAST_STEPS = 64
_MOST_STEPS = 160  # either way
_DRAWN_QUANTILE = 0.98  # the colours end there: a tip nobody saw must not hide all else


def draw_certainty(done: FittedReconstruction, camera: Camera, size_px: tuple[int, int]) -> Picture:
    """Map the posterior standard deviation, mm, over every branch; caps are left out."""
    sheets = [_sheet(skin) for skin in done.skinned.shown]
    every = np.concatenate([deviations for _, deviations in sheets])
    limit = max(float(np.quantile(every, _DRAWN_QUANTILE)), 1e-9)
    layers = [
        MeshLayer(mesh, figures.certainty_colours(deviations, limit)) for mesh, deviations in sheets
    ]
    image = render_scene(Scene(meshes=tuple(layers)), camera=camera, size_px=size_px)
    title = "Standard deviation of the surface"
    middle, largest = float(np.median(every)), float(every.max())
    return Picture(
        figures.png(figures.certainty_figure(image, limit_mm=limit, title=title)),
        title,
        f"How far the surface may lie off, across itself, by the noise of the points and where they"
        f" are: median {middle:.2g} mm, at most {largest:.2g} mm. It does not know what no slice"
        " has seen.",
    )


def _sheet(skin: AnySkin) -> tuple[Mesh, FloatArray]:
    """A branch as a lattice of triangles, and the deviation at each of its vertices."""
    surface = skin.surface
    u, v = (
        np.linspace(*domain, _steps(knots) + 1)
        for domain, knots in zip(surface.domain, (surface.knots_u, surface.knots_v), strict=True)
    )
    places = evaluate_surface(surface, u, v).reshape(-1, 3)
    at_u, at_v = np.meshgrid(u, v, indexing="ij")
    deviations = skin.deviation_mm(at_u.ravel(), at_v.ravel())
    faces = _triangles(len(u), len(v))
    return Mesh(places, faces, np.zeros(len(places), dtype=np.bool_)), deviations


def _steps(knots: FloatArray) -> int:
    """Enough to see the spans of a direction, and that an exact surface of few spans is round."""
    return int(np.clip(_STEPS_A_SPAN * len(knots), _LEAST_STEPS, _MOST_STEPS))


def _triangles(rows: int, columns: int) -> IntArray:
    """Two triangles (m, 3) for every square of a lattice."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    beside, above = corner + columns, corner + 1
    lower = np.stack([corner, beside, above], axis=1)
    upper = np.stack([beside, beside + 1, above], axis=1)
    return np.concatenate([lower, upper])
