"""The joint solve: robust first, then plain without what was robustly seen to be stray.

Levenberg and Marquardt's way with the analytic Jacobian; a soft loss bends nothing near the
solution and keeps strays from pulling. Then points farther than `_STRAY` standard deviations are
set aside, the noise of each scan is told anew from the spread of its residuals, and the plain least
squares of the rest has the covariance that is told.

Noise of neighbours is alike where they share a speckle. Then n points know less than n: the
covariance is multiplied by 1 + 2 (r1 + r2 + ...), the correlation of residuals along a profile
(Bartlett 1946 for the variance of a mean).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from acquisition.arrays import FloatArray
from acquisition.frames import Kinematics
from loftscan.calibrating.errors import CalibrationRefused
from loftscan.calibrating.model import IntArray, Model

_STRAY = 4.5  # standard deviations: of 100 000 sound points one
_ROUNDS = 2
_MAD = 1.4826  # of a normal distribution
_LONGEST_LAG = 24  # neighbours; a speckle is shorter
_ALIKE = 0.05  # a correlation below is none
_LEAST_EIGENVALUE = 1e-15  # rounding, where nothing is known
_MOST_EVALUATIONS = 200


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the solve ended."""

    model: Model  # with the points that were kept, and the noise as it was found
    at: FloatArray
    residuals: FloatArray  # in standard deviations, points first
    jacobian: FloatArray
    alike: float  # what the covariance is multiplied with, at least 1
    stray: int  # points set aside
    covariance: FloatArray  # of the whole parameter vector

    @property
    def kinematics(self) -> Kinematics:
        """As solved."""
        return self.model.kinematics(self.at)

    @property
    def points(self) -> int:
        """How many were kept."""
        return len(self.model.rows())

    @property
    def s0(self) -> float:
        """Standard deviation of unit weight: 1 where the noise is what it was taken for."""
        free = len(self.residuals) - len(self.at)
        return float(np.sqrt(self.residuals @ self.residuals / max(free, 1)))


def solve(model: Model) -> Solution:
    """Solve a model whose faces are found.

    Raises
    ------
    CalibrationRefused
        Fewer points than parameters.
    """
    at = model.begin()
    whole = len(model.rows())
    if whole <= len(at):
        raise CalibrationRefused(
            f"calibration: {whole} points for {len(at)} unknowns; scan more of the artefact"
        )
    try:
        at = _descended(model, at, robust=True)
        for _ in range(_ROUNDS):
            model = _kept(model, at)
            at = _descended(model, at, robust=False)
    except ValueError as nonsense:  # a step that no station can stand like
        raise CalibrationRefused(
            f"calibration: the solve ran away ({nonsense}); see that artefact.toml is what stands"
            " on the table, and that nothing else does"
        ) from nonsense
    residuals, jacobian = model.evaluate(at)
    alike = correlation(model, residuals)
    known = len(residuals) - len(model.rows())
    weight = np.concatenate([np.full(len(model.rows()), 1.0 / alike), np.ones(known)])
    covariance = _inverse((jacobian * weight[:, None]).T @ jacobian)
    stray = whole - len(model.rows())
    return Solution(model, at, residuals, jacobian, alike, stray, covariance)


def correlation(model: Model, residuals: FloatArray) -> float:
    """By what the variance of a mean of neighbours exceeds that of independent points."""
    profile = model.seen.profile[model.rows()]
    points = residuals[: len(profile)]
    variance = float(np.mean(points**2)) if len(points) else 0.0
    total = 1.0
    for lag in range(1, min(_LONGEST_LAG, len(points))):
        same = profile[lag:] == profile[:-lag]
        if variance == 0.0 or not same.any():
            break
        alike = float(np.mean((points[lag:] * points[:-lag])[same])) / variance
        if alike < _ALIKE:
            break
        total += 2.0 * alike
    return total


def _descended(model: Model, at: FloatArray, *, robust: bool) -> FloatArray:
    """The nearest place where the sum of squares, or of soft losses, is least.

    MINPACK's Levenberg-Marquardt, by QR: the singular values of a trust region take seven times as
    long. It knows no loss but the square, so that the soft one is told by residuals.
    """
    seen: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def both(where: FloatArray) -> tuple[FloatArray, FloatArray]:
        key = where.tobytes()
        if key not in seen:  # the solver asks for the one after the other
            seen.clear()
            plain = model.evaluate(where)
            seen[key] = _softened(*plain) if robust else plain
        return seen[key]

    def residuals(where: FloatArray) -> FloatArray:
        return both(where)[0]

    def jacobian(where: FloatArray) -> FloatArray:
        return both(where)[1]

    found = least_squares(
        residuals, at, jac=jacobian, x_scale="jac", max_nfev=_MOST_EVALUATIONS, method="lm"
    )
    return np.asarray(found.x, np.float64)


def _softened(residuals: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals whose squares are the loss 2 (sqrt(1 + r^2) - 1), and their Jacobian."""
    root = np.sqrt(1.0 + residuals**2)
    factor = np.sqrt(2.0 / (root + 1.0))
    return residuals * factor, jacobian / (root * factor)[:, None]


def _inverse(normal: FloatArray) -> FloatArray:
    """Of a normal matrix whose columns have units of their own."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    spread = vectors / np.sqrt(np.maximum(values, _LEAST_EIGENVALUE))
    return np.asarray((spread @ spread.T) / np.outer(size, size))


def _kept(model: Model, at: FloatArray) -> Model:
    """Without strays, with each scan's noise as its residuals tell."""
    residuals = model.residuals(at)[: len(model.rows())]
    scan = model.seen.scan[model.rows()]
    sigma_mm, wide = model.sigma_mm.copy(), np.ones(len(scan))
    for each in np.unique(scan):
        own = residuals[scan == each]
        spread = _MAD * float(np.median(np.abs(own - np.median(own))))
        wide[scan == each] = max(spread, 1e-9)
        good = own[np.abs(own) <= _STRAY * spread]
        if len(good):
            sigma_mm[each] *= max(float(np.sqrt(np.mean(good**2))), 1e-9)
    sound = np.abs(residuals) <= _STRAY * wide
    faces, first = [], 0
    for face in model.faces:
        here = sound[first : first + len(face.rows)]
        first += len(face.rows)
        faces.append(replace(face, rows=_rows(face.rows, here)))
    return replace(model, faces=tuple(faces), sigma_mm=sigma_mm)


def _rows(rows: IntArray, kept: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> IntArray:
    return np.asarray(rows[kept])
