"""Curves through points, and surfaces through sections.

The knots are the caller's wherever they can be: a closed curve has its knots at the parameters, so
that n points make n control points whatever their spacing; an open one has averaged knots (*The
NURBS Book*, eq. 9.8), for which the system is solvable for any increasing parameters (Schoenberg
and Whitney).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.nurbs.basis import basis_functions
from reconstruction.nurbs.evaluation import homogeneous
from reconstruction.nurbs.knot_algebra import repeated_knots
from reconstruction.nurbs.values import Curve, Surface


def interpolate_periodic(
    points_mm: FloatArray, *, degree: int = 3, parameters: ArrayLike | None = None
) -> Curve:
    """Return the closed curve through points (n, d), in their order.

    Parameters
    ----------
    parameters
        (n + 1,), increasing: where each point is met, and at last where the first is met again.
        Default 0, 1, .. n: then ``curve(i)`` is ``points_mm[i]``, and the system is circulant,
        solved by FFT ((1, 4, 1) / 6 for cubics).

    Returns
    -------
    Curve whose knots are the parameters if the degree is odd. For an even degree knots there would
    make the system singular; they lie midway between, and the domain starts midway too.

    Raises
    ------
    TooFewPoints
        Fewer points than the degree, or than 3.
    """
    count = len(points_mm)
    least = max(degree, 3)
    if count < least:
        raise TooFewPoints(f"{count} points; a closed degree-{degree} curve needs {least}")
    met = _increasing(parameters, count + 1)
    knots = _periodic_knots(met, degree)
    spans, values = basis_functions(met[:-1], degree, knots, periodic=True)
    if parameters is None:
        control_points = _solved_circulant(spans - degree, values, points_mm)
    else:
        control_points = _solved_cyclic(spans - degree, values, points_mm)
    return Curve(degree, knots, control_points, np.ones(count), periodic=True)


def interpolate_open(
    points_mm: FloatArray, *, parameters: ArrayLike | None = None, degree: int = 3
) -> Curve:
    """Return the clamped curve through points (n, d), in their order.

    Parameters
    ----------
    parameters
        (n,), increasing; default chord length on [0, 1].

    Raises
    ------
    TooFewPoints
        Fewer points than degree + 1.
    ValueError
        Parameters that do not increase, or two equal points in a row with the default ones.
    """
    count = len(points_mm)
    if count < degree + 1:
        raise TooFewPoints(f"{count} points; a degree-{degree} curve needs {degree + 1}")
    met = chord_parameters(points_mm) if parameters is None else _increasing(parameters, count)
    knots, control_points = _interpolated(met, points_mm, degree)
    return Curve(degree, knots, control_points, np.ones(count), periodic=False)


def loft_sections(
    control_nets_mm: FloatArray,
    *,
    degree_u: int,
    knots_u: FloatArray,
    periodic_u: bool,
    parameters: ArrayLike,
    degree_v: int = 3,
    weights: FloatArray | None = None,
) -> Surface:
    """Return the surface that contains every section, at its own parameter v.

    Parameters
    ----------
    control_nets_mm
        (nv, nu, 3): the control points of nv sections on the common knots `knots_u`.
    parameters
        (nv,), increasing: the v of each section, for example its height in mm.
    degree_v
        Lowered to nv - 1 where there are too few sections.
    weights
        (nv, nu) or, common to all sections, (nu,); default 1. They are interpolated together with
        the points, in homogeneous space.

    Raises
    ------
    NotLoftable
        Fewer than two sections, parameters that do not increase, or weights that become zero or
        negative between sections; it names the sections where one can.

    References
    ----------
    The NURBS Book, section 10.3.
    """
    nets = np.asarray(control_nets_mm, dtype=np.float64)
    count = len(nets)
    heights = _section_parameters(parameters, count)
    degree = min(degree_v, count - 1)
    if weights is None:
        knots, rows = _interpolated(heights, nets, degree)
        points, lofted_weights = rows, np.ones(rows.shape[:2])
    else:
        common = np.broadcast_to(weights, nets.shape[:2])
        knots, rows = _interpolated(heights, homogeneous(nets, common), degree)
        lofted_weights = _positive(rows[..., 3])
        points = rows[..., :3] / lofted_weights[..., None]
    return Surface(
        degree_u, degree, knots_u, knots,
        points.swapaxes(0, 1), lofted_weights.T, periodic_u, periodic_v=False,
    )  # fmt: skip


def chord_parameters(points_mm: FloatArray) -> FloatArray:
    """Chord-length parameters on [0, 1]; (n, d) -> (n,)."""
    chords = np.linalg.norm(np.diff(points_mm, axis=0), axis=1)
    if not np.all(chords > 0):
        twice = int(np.argmin(chords > 0))
        raise ValueError(f"points {twice} and {twice + 1} are equal: chord length cannot part them")
    lengths = np.concatenate([[0.0], chords.cumsum()])
    return np.asarray(lengths / lengths[-1])


def averaged_knots(parameters: FloatArray, degree: int) -> FloatArray:
    """Return the clamped knots (n + p + 1,) that suit interpolation at parameters (n,)."""
    means = np.lib.stride_tricks.sliding_window_view(parameters[1:-1], degree).mean(axis=1)
    ends = np.ones(degree + 1)
    return np.concatenate([parameters[0] * ends, means, parameters[-1] * ends])


def _interpolated(
    met: FloatArray, values: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Clamped knots and control values (n, ...) of the spline through values (n, ...)."""
    knots = averaged_knots(met, degree) if len(met) > degree + 1 else _bezier_knots(met, degree)
    spline = make_interp_spline(met, values, k=degree, t=knots)
    return knots, np.asarray(spline.c)


def _bezier_knots(met: FloatArray, degree: int) -> FloatArray:
    return np.repeat(met[[0, -1]], degree + 1)


def _periodic_knots(met: FloatArray, degree: int) -> FloatArray:
    ends = met if degree % 2 else _midways(met)
    count = len(met) - 1
    domain = float(ends[0]), float(ends[-1])
    return repeated_knots(ends[:-1], domain, -degree, count + 2 * degree + 1)


def _midways(met: FloatArray) -> FloatArray:
    """Midpoints (n + 1,) before each parameter, the first reaching back over the seam."""
    before = np.concatenate([[met[0] - (met[-1] - met[-2])], met])
    return np.asarray((before[:-1] + before[1:]) / 2)


def _solved_circulant(first: IntArray, values: FloatArray, points: FloatArray) -> FloatArray:
    row = np.zeros(len(points))
    np.add.at(row, (first[0] + np.arange(values.shape[1])) % len(points), values[0])
    symbol = np.conj(np.fft.rfft(row))[:, None]
    spectrum = np.fft.rfft(points, axis=0) / symbol
    return np.asarray(np.fft.irfft(spectrum, n=len(points), axis=0))


def _solved_cyclic(first: IntArray, values: FloatArray, points: FloatArray) -> FloatArray:
    count, terms = values.shape
    columns = (first[:, None] + np.arange(terms)) % count
    rows = np.repeat(np.arange(count), terms)
    matrix = csc_array((values.ravel(), (rows, columns.ravel())), shape=(count, count))
    return np.asarray(splu(matrix).solve(np.ascontiguousarray(points, dtype=np.float64)))


def _increasing(parameters: ArrayLike | None, count: int) -> FloatArray:
    if parameters is None:
        return np.arange(count, dtype=np.float64)
    met = np.asarray(parameters, dtype=np.float64)
    if met.shape != (count,) or not np.all(np.diff(met) > 0):
        raise ValueError(f"{count} increasing parameters expected, got an array {met.shape}")
    return met


def _section_parameters(parameters: ArrayLike, count: int) -> FloatArray:
    heights = np.asarray(parameters, dtype=np.float64)
    if count < 2:
        raise NotLoftable(f"{count} section; a surface needs 2", indices=tuple(range(count)))
    if heights.shape != (count,):
        raise ValueError(f"{count} sections need {count} parameters, got {heights.shape}")
    wrong = np.flatnonzero(~(np.diff(heights) > 0))
    if len(wrong):
        pair = int(wrong[0]), int(wrong[0]) + 1
        raise NotLoftable(
            f"sections {pair[0]} and {pair[1]}: parameters {heights[pair[0]]:g} and "
            f"{heights[pair[1]]:g} do not increase; sort the sections, drop doubles",
            indices=pair,
        )
    return heights


def _positive(weights: FloatArray) -> FloatArray:
    low = np.flatnonzero(weights.min(axis=1) <= 0)
    if len(low):
        raise NotLoftable(
            f"weights fall to {weights.min():g} near section {low[0]}: too unlike its neighbours; "
            "use common weights, or degree_v=1",
            indices=tuple(int(index) for index in low),
        )
    return weights
