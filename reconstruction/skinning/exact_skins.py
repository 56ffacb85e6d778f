"""The skin of a branch whose points are one exact shape: the shape itself, ended as the branch is.

::

    outlines' cells -> shape -> noise about it -> shape again -> its surface between the ends
                   `recognition`  `noise`                       `exact_surfaces`, `exact_ends`

Where the outlines alone say what they are, no free surface is fitted: what patches leave over about
the shape then takes its place as judge. Where they do not, the free surface is fitted, with the
loose points that it gathers, and is the judge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.nurbs import Surface, evaluate_surface_at
from reconstruction.skinning.branch import Branch
from reconstruction.skinning.ends import Apex, Brim
from reconstruction.skinning.exact_ends import Levels, ended, ended_as
from reconstruction.skinning.exact_shapes import Shape
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.primitives import Plane, Sphere
from reconstruction.skinning.recognition import misfit_of, recognised
from reconstruction.skinning.revolution import Revolution
from reconstruction.skinning.skin import Skin, noise_of
from reconstruction.skinning.unseen import lies_in, unseen_bands

_ROUNDS = 2  # of shape and noise, one after the other
_REACH = 6.0  # standard deviations: a loose cell nearer than that may be the shape's


@dataclass(frozen=True, slots=True, eq=False)
class ExactSkin:
    """A branch and the exact surface that its points are of."""

    branch: Branch
    brims: tuple[Brim | Apex, Brim | Apex] | None  # None: it closes in v
    shape: Shape
    surface: Surface  # rational, u counter-clockwise about the axis, v up
    noise: Noise  # the scatter of a point about it
    seen: tuple[bool, bool] = (False, False)  # as in `Skin`

    @property
    def open(self) -> bool:
        """Never: as in `Skin`."""
        return False

    def deviation_mm(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Standard deviation across the surface at (m,), (m,)."""
        return self.shape.deviation_mm(evaluate_surface_at(self.surface, u, v))

    def synthetic(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether no measured point stands near parameters of any shape."""
        places = evaluate_surface_at(self.surface, np.ravel(u), np.ravel(v))
        counts = self.support
        column, row = self._boxes(places, counts.shape)
        heights = places @ self.branch.axes[2]
        missing = lies_in(heights, self.unseen)
        return np.asarray((counts[column, row] == 0) | missing).reshape(np.shape(u))

    @property
    def unseen(self) -> FloatArray:
        """Bands of height (g, 2) where slices are missing."""
        return unseen_bands(self.branch, self.shape.moments)

    @property
    def support(self) -> IntArray:
        """Cells in each box of a lattice around the axis and along, a gap's width apart."""
        places = self.shape.moments.means_mm
        shape = self.branch.boxes(len(places))
        counts = np.zeros(shape, np.int64)
        np.add.at(counts, self._boxes(places, shape), 1)
        return counts

    def _boxes(self, places: FloatArray, shape: tuple[int, ...]) -> tuple[IntArray, IntArray]:
        chart, (low, high) = self._chart(places), self._range()
        share = np.column_stack([chart[:, 0] / math.tau, (chart[:, 1] - low) / (high - low)])
        share[:, 0] = np.mod(share[:, 0], 1.0)
        at = np.clip((share * shape).astype(np.int64), 0, np.array(shape) - 1)
        return at[:, 0], at[:, 1]

    def _chart(self, places: FloatArray) -> FloatArray:
        """Angle about the axis, and height along the stack; on a loop, the way along it."""
        form, axes = self.shape.form, self.branch.axes
        if isinstance(form, Revolution) and form.closed:
            return form.chart(places)
        if isinstance(form, Sphere):
            arms = (places - form.centre_mm) @ axes.T
            return np.column_stack([np.arctan2(arms[:, 1], arms[:, 0]), places @ axes[2]])
        return np.column_stack([form.chart(places)[:, 0], places @ axes[2]])

    def _range(self) -> tuple[float, float]:
        """From where to where the second coordinate of the chart runs."""
        form = self.shape.form
        if isinstance(form, Revolution) and form.closed:
            return 0.0, float(len(form.control_mm))
        heights = self.surface.control_points_mm @ self.branch.axes[2]
        return float(heights.min()), float(heights.max())


AnySkin = Skin | ExactSkin


def exact_skin(branch: Branch, loose: Moments | None, levels: Levels) -> ExactSkin | None:
    """The skin of a branch whose outlines alone say that they are one exact shape.

    None: they do not, or loose cells lie near it that have a say as well.
    """
    moments = Moments.together([outline.moments for outline in branch.outlines])
    noise, shape = noise_of(branch), None
    for _ in range(_ROUNDS):
        variances = noise.level_mm2 if shape is None else noise.across(_normals(shape))
        shape = recognised(
            moments, variances, inflation=noise.inflation,
            noise_covariance_mm2=noise.covariance_mm2,
        )  # fmt: skip
        if shape is None or isinstance(shape.form, Plane):
            return None  # of a plane are the outlines of one slice: they bound no wall
        noise = _noise_about(shape, noise)
    assert shape is not None, "it went round"
    if loose is not None and len(loose) and _any_near(shape, loose, noise):
        return None
    return _skinned(branch, shape, noise, levels)


def exact_in_place_of(skin: Skin, levels: Levels) -> ExactSkin | None:
    """The exact skin that the cells of a branch prefer to its free surface; None: they do not."""
    shape = _preferred(skin)
    return None if shape is None else _skinned(skin.branch, shape, skin.noise, levels)


def exact_of_meridians(skin: Skin) -> ExactSkin | None:
    """The same where meridians go all round an axis."""
    if skin.open or skin.brims is None:
        return None
    shape = _preferred(skin)
    found = None if shape is None else ended_as(skin.branch, shape, skin.brims)
    if shape is None or found is None:
        return None
    return ExactSkin(skin.branch, found.brims, shape, found.surface, skin.noise, skin.seen)


def _preferred(skin: Skin) -> Shape | None:
    fit, moments = skin.fit, skin.moments
    variances = fit.noise.across(fit.feet.normals)
    misfit = misfit_of(
        moments, fit.feet.distances_mm, fit.feet.scatters_mm2, variances,
        inflation=fit.noise.inflation, weights=fit.weights,
    )  # fmt: skip
    return recognised(
        moments, variances, free_misfit=misfit, free_edf=fit.edf, inflation=fit.noise.inflation,
        weights=fit.weights, noise_covariance_mm2=fit.noise.covariance_mm2,
    )  # fmt: skip


def _skinned(branch: Branch, shape: Shape, noise: Noise, levels: Levels) -> ExactSkin | None:
    if len(branch.outlines) < 2:
        return None  # one outline and loose points beside it do not say how far a wall goes
    found = ended(branch, shape, levels)
    return None if found is None else ExactSkin(branch, found.brims, shape, found.surface, noise)


def _normals(shape: Shape) -> FloatArray:
    return shape.form.measure(shape.moments.means_mm).normals


def _noise_about(shape: Shape, noise: Noise) -> Noise:
    squares = shape.distances_mm**2 + shape.scatters_mm2
    return noise.looked_at_again(_normals(shape), squares, shape.moments.counts, shape.freedom)


def _any_near(shape: Shape, loose: Moments, noise: Noise) -> bool:
    reach = _REACH * math.sqrt(noise.level_mm2)
    return bool((np.abs(shape.form.measure(loose.means_mm).distances_mm) < reach).any())
