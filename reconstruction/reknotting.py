"""A novel set of equidistant knots, and the control points that go with it (section 2.4).

The paper gives each section new knots, equidistant and in a wanted number, and new control points
from them, without saying how. Here the knots are equidistant in arc length, and the control points
make the new curve pass through the old one at every knot: so re-knotting does not shrink the
section a second time, as taking points of the curve for control points would.
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.nurbs import Curve, evaluate_curve, interpolate_periodic

_STEPS_A_SPAN = 16


def reknot(curve: Curve, count: int) -> Curve:
    """Pass a periodic curve through `count` points equidistant on a periodic one.

    The first knot stays where the old curve begins. The new curve has integer knots:
    ``new(i)`` is the i-th point.
    """
    parameters, lengths = measure_lengths(curve)
    wanted = np.linspace(0.0, lengths[-1], count, endpoint=False)
    return interpolate_periodic(evaluate_curve(curve, np.interp(wanted, lengths, parameters)))


def measure_lengths(curve: Curve) -> tuple[FloatArray, FloatArray]:
    """Parameters over the domain and the arc length up to each of them, in mm."""
    start, end = curve.domain
    steps = _STEPS_A_SPAN * len(curve.control_points_mm)
    parameters = np.linspace(start, end, steps + 1)
    points = evaluate_curve(curve, parameters)
    lengths = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    return parameters, lengths


def map_gaps(
    curve: Curve, bridged: BoolArray, count: int
) -> tuple[tuple[tuple[float, float], ...], float]:
    """Carry bridged segments of the first curve over to the parameter of the re-knotted one.

    Control point k of a uniform cubic is strongest at parameter k, so segment k is the interval
    from k to k + 1; neighbouring bridged segments become one gap.

    Returns
    -------
    gaps, length
        Intervals [u0, u1] of the new parameter, u1 > count where a gap crosses the start; and
        their length in mm.
    """
    if not bridged.any():
        return (), 0.0
    parameters, lengths = measure_lengths(curve)
    at_knot = np.interp(np.arange(len(bridged) + 1), parameters, lengths)
    # Begin the bookkeeping just after an unbridged segment, so that no gap is cut in two.
    offset = 0 if bridged.all() else int(np.flatnonzero(~bridged)[0]) + 1
    scale = count / lengths[-1]
    gaps: list[tuple[float, float]] = []
    for k in range(offset, offset + len(bridged)):
        turn, place = divmod(k, len(bridged))
        if not bridged[place]:
            continue
        u0 = scale * at_knot[place] + turn * count
        u1 = scale * at_knot[place + 1] + turn * count
        if gaps and abs(gaps[-1][1] - u0) < 1e-9 * count:
            gaps[-1] = (gaps[-1][0], u1)
        else:
            gaps.append((u0, u1))
    total = sum(u1 - u0 for u0, u1 in gaps) / scale
    wrapped = tuple((u0 - count, u1 - count) if u0 >= count else (u0, u1) for u0, u1 in gaps)
    return tuple(sorted(wrapped)), float(total)
