"""Whether what a form leaves over is more than chance: ovals, barrels, bends, lobes, dents.

A sum of squares over all cells drowns a small but systematic deviation in noise. So the distances
are gathered in patches, and their parts along a few smooth waves over the form taken out, each at
right angles to the form's own freedoms and to the waves before it. Under the form every part is one
standard normal number; so is what then remains of every patch.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_triangular

from reconstruction.arrays import FloatArray
from reconstruction.skinning.adjustment import Cells, Fitted
from reconstruction.skinning.patches import pooled
from reconstruction.skinning.primitives import Form, Plane, Sphere
from reconstruction.skinning.revolution import Revolution

_WAVE = 4.5  # standard deviations that none of some forty waves reaches by chance ...
_PATCH = 5.2  # ... and none of some thousand patches
_LOBES = (8, 4, 3)  # around, where the wave along is constant, linear, quadratic
_BULGES = 4  # greatest degree along, of what is the same all around
_PATCHES_A_WAVE = 3
_RIDGE = 1e-9  # of a column: below it, it depends on others
_DEGREE = 5  # of polynomials over a plane


def lacks_fit(found: Fitted, cells: Cells) -> bool:
    """Whether the cells' distances show a wave or a dent that chance does not explain."""
    weights = cells.precisions * found.trust
    places = cells.moments.means_mm
    if not float(weights.sum()) > 0.0:
        return True
    chart = found.form.chart(places)
    patches = pooled(chart, places, weights)
    bounds = chart.min(axis=0), chart.max(axis=0)

    def rows_at(middles: FloatArray) -> FloatArray:
        return np.hstack([found.form.measure(middles).slopes, _waves(found.form, middles, bounds)])

    rows, root = rows_at(patches.middles_mm), np.sqrt(patches.held)
    freedoms = len(found.normal_matrix)
    told = max(len(rows) // _PATCHES_A_WAVE, freedoms)  # few patches tell few waves
    if len(rows) <= freedoms:
        return False
    left = root * patches.mean(found.distances_mm, weights)
    pulled = np.zeros(rows.shape[1])
    if not isinstance(found.form, Revolution):  # its profile takes up what is alike all around
        turns = patches.along(rows_at, patches.mean(found.spread.pulls_mm2, weights))
        pulled = patches.held @ turns
    parts, rest = _taken_out(root[:, None] * rows[:, :told], left, pulled[:told])
    waves = parts[freedoms:]
    usual = len(waves) + _WAVE * (math.sqrt(2.0 * len(waves)) + 1.0)
    return bool(
        np.abs(waves).max(initial=0.0) > _WAVE
        or float(waves @ waves) > usual
        or np.abs(rest).max() > _PATCH
    )


def _taken_out(
    rows: FloatArray, left: FloatArray, pulled: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Parts (k,) of `left` (m,) along columns, each at right angles to those before; the rest (m,).

    By Cholesky's factor, since a column that depends on others may then be any: its part is none.

    Parameters
    ----------
    pulled
        (k,), what the products of `left` and the columns lack, see `adjustment`.
    """
    lengths = np.maximum(np.sqrt((rows * rows).sum(axis=0)), 1e-300)
    rows = rows / lengths
    factor = np.linalg.cholesky(rows.T @ rows + _RIDGE * np.eye(rows.shape[1]))
    parts = solve_triangular(factor, rows.T @ left + pulled / lengths, lower=True)
    return parts, left - rows @ solve_triangular(factor, parts, lower=True, trans="T")


def _waves(form: Form, places: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Smooth waves over a form at places (m, 3), (m, k); those that come first are the simplest."""
    if isinstance(form, Sphere):
        return _harmonics(form.measure(places).normals)
    chart = form.chart(places)
    x, y = ((2.0 * chart - bounds[0] - bounds[1]) / np.maximum(bounds[1] - bounds[0], 1e-300)).T
    if isinstance(form, Plane):
        return _polynomials(x, y)
    lobes = _lobes(chart[:, 0], y)
    return lobes if isinstance(form, Revolution) else np.hstack([_bulges(y), lobes])


def _polynomials(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.stack(
        [x ** (n - k) * y**k for n in range(2, _DEGREE + 1) for k in range(n + 1)], axis=1
    )


def _harmonics(normals: FloatArray) -> FloatArray:
    """Polynomials of degree 2 to 4 on the unit sphere: on it z**2 is one of the others."""
    x, y, z = normals.T
    powers = [(n - k - e, k, e) for n in (2, 3, 4) for e in (0, 1) for k in range(n - e + 1)]
    return np.stack([x**a * y**b * z**e for a, b, e in powers], axis=1)


def _bulges(along: FloatArray) -> FloatArray:
    legendre = np.polynomial.legendre.legvander(along, _BULGES)
    return np.asarray(legendre[:, 1:])


def _lobes(angles: FloatArray, along: FloatArray) -> FloatArray:
    waves = [
        along**degree * wave(k * angles)
        for degree, most in enumerate(_LOBES)
        for k in range(1, most + 1)
        for wave in (np.cos, np.sin)
    ]
    return np.stack(waves, axis=1)
