"""Exact shapes where the cells of a branch prefer one to the free surface.

Plane, sphere, cylinder and cone are tried, and a surface of revolution where none of them will do.
A shape takes the free surface's place if three judges agree: Schwarz's criterion (1978), with the
free surface's degrees of freedom; the excess of misfit, which must be one that chance explains; and
what the shape leaves over, in which no oval, barrel, bend or dent may stand out (`lack_of_fit`).
The first alone would forgive a shape what its few freedoms save; the second drowns one systematic
deviation in the many freedoms of the free surface.

Where no free surface is fitted, the means of patches stand for it: a free surface as wild as they
come, whose squares about the shape are those of chance, or the shape is none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.skinning.adjustment import Cells, Fitted, adjusted, approached
from reconstruction.skinning.exact_shapes import Shape
from reconstruction.skinning.lack_of_fit import gained, lacks_fit, left_over
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.patches import beyond_rims, pooled
from reconstruction.skinning.primitives import Form
from reconstruction.skinning.revolving import revolved, sketched
from reconstruction.skinning.starting import (
    axis_near,
    cone_near,
    cylinder_near,
    plane_near,
    sphere_near,
)

_LEAST = 12  # cells
_FEWEST = 400  # cells to begin with ...
_FEW = 1_500  # ... cells that tell whether a shape is worth a closer look ...
_SOME = 6_000  # ... and cells for a profile
_STEPS = 12
_CHANCE = 4.0  # standard deviations of excess misfit
_HOPELESS = 6.0  # standard deviations by which few cells exceed what all may
_CAPPED = 25.0  # squared deviations of a cell, at most, in a first look
_OUTLYING = 5.0  # standard deviations, from the form and from the neighbours
_NEIGHBOURS = 8
_RARE = 0.02  # share of the cells that may be outliers
_MOST_PATCHES = 960.0

_Trial = tuple[Fitted, Cells]


def recognised(
    moments: Moments,
    noise_variance_mm2: ArrayLike,
    *,
    free_misfit: float | None = None,
    free_edf: float = 0.0,
    inflation: float = 1.0,
    weights: FloatArray | None = None,
    noise_covariance_mm2: FloatArray | None = None,
) -> Shape | None:
    """Return the shape that the cells prefer to a free surface, if there is one.

    Parameters
    ----------
    noise_variance_mm2
        Of a point across the wall, one or (m,).
    free_misfit, free_edf
        Of the free surface: `misfit_of` its distances and scatters, with the same variances,
        inflation and weights as here; and its effective degrees of freedom. None: there is none,
        and what patches leave over about the shape must be chance.
    inflation
        How many points are as good as one independent one.
    weights
        (m,), robust weights of the free surface, 0 .. 1. Without them cells that stand out from
        the shape and from their neighbours as well are left out, and are taken to be left out of
        `free_misfit` too.
    noise_covariance_mm2
        (3, 3), of a point's error; by default alike in all directions.
    """
    variances = np.broadcast_to(np.asarray(noise_variance_mm2, dtype=np.float64), len(moments))
    held = moments.counts / inflation if weights is None else moments.counts * weights / inflation
    if noise_covariance_mm2 is None:
        cells = Cells(moments, held / variances, variances, variances, np.eye(3))
    else:
        cells = Cells(
            moments, held / variances, variances, np.ones(len(moments)), noise_covariance_mm2
        )
    if int((held > 0.0).sum()) < _LEAST:
        return None
    judge = _Judge(free_misfit, free_edf, cells)
    with np.errstate(all="ignore"):  # a trial that runs away is no shape
        found = judge.best(_simple(judge, clean=weights is not None))
        if found is None:
            found = judge.best(_revolutions(judge, clean=weights is not None))
    return None if found is None else _shape(*found)


def misfit_of(
    moments: Moments,
    distances_mm: FloatArray,
    scatters_mm2: FloatArray,
    noise_variance_mm2: ArrayLike,
    *,
    inflation: float = 1.0,
    weights: FloatArray | None = None,
) -> float:
    """Sum of squares of the cells' points about a surface, in units of their noise.

    Parameters
    ----------
    distances_mm, scatters_mm2
        (m,), mean distance of each cell's points, and their variance across about it.
    """
    held = moments.counts if weights is None else moments.counts * weights
    squares = distances_mm**2 + scatters_mm2
    return float((held * squares / np.asarray(noise_variance_mm2)).sum() / inflation)


@dataclass(frozen=True, slots=True, eq=False)
class _Judge:
    free_misfit: float | None
    free_edf: float
    cells: Cells

    def best(self, trials: Iterable[_Trial]) -> _Trial | None:
        """Return the simplest trial that all judges accept, unless a richer one is worth more."""
        best: _Trial | None = None
        for found, cells in sorted(trials, key=lambda each: each[0].freedom):
            if not self._accepts(found, cells):
                continue
            if best is None or self._dearer(best, found):
                best = found, cells
        return best

    def _accepts(self, found: Fitted, cells: Cells) -> bool:
        if self.free_misfit is None:
            return _chance_in_patches(found, cells) and not lacks_fit(found, cells)
        excess = _misfit(found, cells) - self.free_misfit
        # A free surface as stiff as a plane is still more than one.
        spared = max(self.free_edf - found.freedom, 1.0)
        likely = excess < spared * self._price and excess < self._explained(found.freedom)
        return likely and not lacks_fit(found, cells)

    def _dearer(self, best: _Trial, other: Fitted) -> bool:
        """Whether another form explains more than its further freedoms are worth."""
        found, cells = best
        return gained(found, other.form, cells) > self._price * (other.freedom - found.freedom)

    @property
    def _price(self) -> float:
        """Of a degree of freedom (Schwarz), by the points that are independent of each other."""
        return math.log(max(float(self.cells.independent.sum()), 2.0))

    def hopeless(self, rough: Fitted, few: Cells) -> bool:
        """Whether few cells lie farther off than any judge will let all of them."""
        squares = few.precisions * rough.trust * rough.distances_mm**2
        excess = float(np.minimum(squares, _CAPPED).mean()) - 1.0
        least = (excess - _HOPELESS * math.sqrt(2.0 / len(few))) * len(self.cells)
        return least > self._explained(0.0)

    def _explained(self, freedom: float) -> float:
        """The greatest excess of misfit that chance explains."""
        spent = _MOST_PATCHES if self.free_misfit is None else 1.3 * self.free_edf
        usual = max(spent - freedom, 1.0)
        return usual + _CHANCE * (math.sqrt(2.0 * usual) + 1.0)


def _chance_in_patches(found: Fitted, cells: Cells) -> bool:
    """Whether the mean distances of patches scatter as chance has it, taken together."""
    waves, rest, _ = left_over(found, cells)
    spent = len(waves) + found.freedom
    usual = max(float(np.count_nonzero(rest)) - spent, 1.0)
    return float(rest @ rest) < usual + _CHANCE * math.sqrt(2.0 * usual)


def _simple(judge: _Judge, *, clean: bool) -> Iterator[_Trial]:
    """Plane, sphere, cylinder and cone, as far as a few cells allow them."""
    few = _some(judge.cells, _FEW)
    for form in _starts(few):
        rough = approached(form, few, rounds=_STEPS)
        if rough is None or judge.hopeless(rough, few):
            continue
        found = adjusted(rough.form, judge.cells, rounds=_STEPS)
        if found is None:
            continue
        kept = judge.cells if clean else _without_outliers(found, judge.cells)
        again = found if kept is judge.cells else adjusted(found.form, kept, rounds=_STEPS)
        if again is not None:
            yield again, kept


def _starts(few: Cells) -> Iterator[Form]:
    places, held = few.moments.means_mm[:_FEWEST], few.precisions[:_FEWEST]
    yield plane_near(places, held)
    yield sphere_near(places, held)
    yield cylinder_near(axis_near(places, held, degree=0), places, held)
    yield cone_near(axis_near(places, held, degree=2), places, held)


def _revolutions(judge: _Judge, *, clean: bool) -> Iterator[_Trial]:
    few = _some(judge.cells, _SOME)
    axis = axis_near(few.moments.means_mm[:_FEWEST], few.precisions[:_FEWEST], degree=8)
    sketch = sketched(axis, few)
    if sketch is None or judge.hopeless(sketch.found, few):
        return
    found = revolved(sketch, judge.cells)
    if found is None:
        return
    kept = judge.cells if clean else _without_outliers(found, judge.cells)
    again = found if kept is judge.cells else revolved(sketch, kept)
    if again is not None:
        yield again, kept


def _some(cells: Cells, count: int) -> Cells:
    """Cells drawn at random, in random order."""
    order = np.random.default_rng(0).permutation(len(cells))
    held = order[cells.precisions[order] > 0.0]
    return cells.only(held[:count])


def _without_outliers(found: Fitted, cells: Cells) -> Cells:
    """Give no weight to cells that stand out from a form and from their neighbours as well.

    A form that does not fit stands off from whole neighbourhoods: there nobody is an outlier.
    """
    root = np.sqrt(cells.precisions * found.trust)
    scattered = found.distances_mm**2 + found.spread.scatters_mm2 > cells.variances_mm2
    suspects = np.flatnonzero((root * np.abs(found.distances_mm) > _OUTLYING) & scattered)
    if not 0 < len(suspects) <= _RARE * len(cells):
        return cells
    places = cells.moments.means_mm
    beside = np.asarray(cKDTree(places).query(places[suspects], _NEIGHBOURS + 1)[1])[:, 1:]
    usual = np.median(found.distances_mm[beside], axis=1)
    apart = root[suspects] * np.abs(found.distances_mm[suspects] - usual)
    weights = np.ones(len(cells))
    weights[suspects[apart > _OUTLYING]] = 0.0
    return cells.weighed(weights)


def _misfit(found: Fitted, cells: Cells) -> float:
    """Sum of squares in units of the noise; what is no evidence counts as chance has it.

    That is what cannot be trusted, and where cells beyond a rim lie: a free surface may bend after
    them, and is none the better for it.
    """
    held, places = cells.independent, cells.moments.means_mm
    patches = pooled(found.chart, places, np.ones(len(places)))
    middles = cells.precisions * found.distances_mm**2
    middles = np.where(beyond_rims(held, patches), np.minimum(middles, 1.0), middles)
    squares = middles + cells.precisions * found.spread.scatters_mm2
    return float((found.trust * squares + (1.0 - found.trust) * held).sum())


def _shape(found: Fitted, cells: Cells) -> Shape:
    return Shape(
        found.form, found.covariance, found.freedom, cells.moments,
        found.distances_mm, found.spread.scatters_mm2,
    )  # fmt: skip
