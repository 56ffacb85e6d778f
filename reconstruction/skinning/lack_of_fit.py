"""Whether what a form leaves over is more than chance: ovals, barrels, bends, lobes, dents.

A sum of squares over all cells drowns a small but systematic deviation in noise. So the distances
are gathered in patches, and their parts along a few smooth waves over the form taken out, each at
right angles to the form's own freedoms and to the waves before it. Under the form every part is one
standard normal number; so is what then remains of every patch.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_triangular

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.skinning.adjustment import Cells, Fitted
from reconstruction.skinning.patches import Patches, pooled
from reconstruction.skinning.primitives import Form, Plane, Sphere
from reconstruction.skinning.revolution import Revolution

_WAVE = 4.5  # standard deviations that none of some forty waves reaches by chance ...
_WAVES = 6.0  # ... nor the squares of the first few of them together ...
_PATCH = 5.2  # ... and none of some thousand patches
_REACHES = (1, 2)  # boxes, of windows: a dent wider than a patch shows little in each
_DOUBT = 2.0  # standard deviations by which squares may fall short
_LOBES = (8, 4, 3)  # around, where the wave along is constant, linear, quadratic
_BULGES = 4  # greatest degree along, of what is the same all around
_PATCHES_A_WAVE = 3
_RIDGE = 1e-9  # of a column: below it, it depends on others
_DEGREE = 5  # of polynomials over a plane


def lacks_fit(found: Fitted, cells: Cells) -> bool:
    """Whether the cells' distances show a wave or a dent that chance does not explain."""
    waves, rest, dents = left_over(found, cells)
    counts = np.arange(1.0, len(waves) + 1.0)
    usual = counts + _WAVES * (np.sqrt(2.0 * counts) + 1.0)
    return bool(
        np.abs(waves).max(initial=0.0) > _WAVE
        or (np.cumsum(waves**2) > usual).any()
        or np.abs(rest).max(initial=0.0) > _PATCH
        or np.abs(dents).max(initial=0.0) > _PATCH
    )


def left_over(found: Fitted, cells: Cells) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What is left of the distances: along waves (k,), of every patch (p,), of windows (q,).

    All are standard normal numbers where the cells are those of the form; the windows, of 3 x 3
    and 5 x 5 patches, overlap.
    """
    bounds = found.chart.min(axis=0), found.chart.max(axis=0)
    patches = pooled(found.chart, cells.moments.means_mm, cells.precisions * found.trust)
    parts, rest = _apart(found, cells, patches, lambda at: _waves(found.form, at, bounds))
    told = ~_one_sided(rest, found, cells, patches)
    held = np.where(told, patches.held, 0.0)
    # Of the whole distances: the waves take a dent apart among them, and none then sees it.
    whole = patches.mean(found.distances_mm, cells.precisions * found.trust)
    dents = [_dents(whole, held, patches, reach) for reach in _REACHES]
    return parts, np.where(told, rest, 0.0), np.concatenate(dents)


def _dents(distances: FloatArray, held: FloatArray, patches: Patches, reach: int) -> FloatArray:
    """Mean distances of windows of patches, in standard deviations, (q,)."""
    sums = patches.windows(held * distances, reach)
    weights = patches.windows(held, reach)
    return np.asarray(sums[weights > 0.0] / np.sqrt(weights[weights > 0.0]))


def gained(found: Fitted, other: Form, cells: Cells) -> float:
    """How much of the sum of squares another form nearby takes away, in units of the noise.

    Told by patches, as waves are: the squares themselves also tell how noise frays at the rims.
    """
    patches = pooled(found.chart, cells.moments.means_mm, cells.precisions * found.trust)

    def between(places: FloatArray) -> FloatArray:
        there, here = other.measure(places), found.form.measure(places)
        # Planes, and forms nearly so, may be turned inside out.
        side = np.sign((there.normals * here.normals).sum(axis=1))
        return np.asarray((here.distances_mm - side * there.distances_mm)[:, None])

    return float((_apart(found, cells, patches, between)[0] ** 2).sum())


def _apart(
    found: Fitted, cells: Cells, patches: Patches, columns: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Parts of the distances along columns, beyond the form's freedoms, and every patch's rest.

    Parameters
    ----------
    columns
        Of places (p, 3) their values (p, k).
    """
    weights, places = cells.precisions * found.trust, cells.moments.means_mm

    def rows_at(middles: FloatArray) -> FloatArray:
        return np.hstack([found.form.measure(middles).slopes, columns(middles)])

    freedoms = len(found.normal_matrix)
    if len(patches.held) <= freedoms:
        return np.empty(0), np.zeros(len(patches.held))
    told = max(len(patches.held) // _PATCHES_A_WAVE, freedoms)  # few patches tell few waves
    rows = rows_at(patches.middles_mm)[:, :told]
    distances = patches.mean(found.distances_mm, weights)
    right = rows.T @ (patches.held * distances)
    if not isinstance(found.form, Revolution):  # its profile takes up what is alike all around
        arms = places - patches.middles_mm[patches.of_cell]
        pulls = found.spread.pulls_mm2 + found.distances_mm[:, None] * arms
        turns = patches.along(rows_at, patches.mean(pulls, weights))[:, :told]
        right = right + patches.held @ turns
    parts, factors = _taken_out(np.sqrt(patches.held)[:, None] * rows, right)
    return parts[freedoms:], np.sqrt(patches.held) * (distances - rows @ factors)


def _one_sided(rest: FloatArray, found: Fitted, cells: Cells, patches: Patches) -> BoolArray:
    """Which patches stand off only because a cut went through the noise of a level wall.

    A slab that ends there holds the points that noise has lifted and not the others. They scatter
    the less about their mean: their squares are still what noise makes them.
    """
    squares = found.distances_mm**2 + found.spread.scatters_mm2
    points = patches.sums(found.trust * cells.independent)
    excess = patches.sums(found.trust * cells.precisions * squares) - points
    return np.asarray(excess < rest**2 - _DOUBT * np.sqrt(2.0 * points))


def _taken_out(rows: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parts along columns, each at right angles to those before, and their factors, (k,) each.

    By Cholesky's factor of the rows (m, k), since a column that depends on others may be any: its
    part is none.

    Parameters
    ----------
    right
        (k,), products of the columns and what is to be taken apart.
    """
    lengths = np.maximum(np.sqrt((rows * rows).sum(axis=0)), 1e-300)
    rows = rows / lengths
    root = np.linalg.cholesky(rows.T @ rows + _RIDGE * np.eye(rows.shape[1]))
    parts = solve_triangular(root, right / lengths, lower=True)
    return parts, solve_triangular(root, parts, lower=True, trans="T") / lengths


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
