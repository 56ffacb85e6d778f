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

    Segment k runs from centre k to the next. A long one pulls the curve into the gap, a sixth of
    its length at either end; so a gap begins and ends not at the knot of its centre but where the
    curve is nearest to it. Gaps that touch become one.

    Returns
    -------
    gaps, length
        Intervals [u0, u1] of the new parameter, u1 > count where a gap crosses the start; and
        their length in mm.
    """
    _, lengths = measure_lengths(curve)
    total, scale = float(lengths[-1]), count / float(lengths[-1])
    gaps: list[tuple[float, float]] = []
    for start, end in sorted(_find_ends(curve, bridged, lengths)):
        if gaps and start <= gaps[-1][1]:
            gaps[-1] = (gaps[-1][0], max(end, gaps[-1][1]))
        else:
            gaps.append((start, end))
    while len(gaps) > 1 and gaps[-1][1] >= gaps[0][0] + total:
        gaps[-1] = (gaps[-1][0], max(gaps[-1][1], gaps.pop(0)[1] + total))
    gaps = [(start, min(end, start + total)) for start, end in gaps]
    mapped = tuple((start * scale, end * scale) for start, end in gaps)
    return mapped, float(sum(end - start for start, end in gaps))


def _find_ends(
    curve: Curve, bridged: BoolArray, lengths_mm: FloatArray
) -> list[tuple[float, float]]:
    """Arc lengths between which each run of bridged segments lies, the first in [0, total)."""
    if bridged.all():
        return [(0.0, float(lengths_mm[-1]))]
    points = evaluate_curve(curve, measure_lengths(curve)[0][:-1])
    count, total = len(bridged), float(lengths_mm[-1])
    ends = []
    for run in np.flatnonzero(bridged & ~np.roll(bridged, 1)):
        first = int(run)
        after = first + int(np.argmin(np.roll(bridged, -first)))
        start = _pass_by(curve, points, lengths_mm, first, first - 1)
        end = _pass_by(curve, points, lengths_mm, after % count, after)
        turns = np.floor(start / total)
        ends.append((float(start - turns * total), float(end - turns * total)))
    return ends


def _pass_by(
    curve: Curve, points_mm: FloatArray, lengths_mm: FloatArray, centre: int, span: int
) -> float:
    """Arc length at which a span of the curve passes nearest to a centre."""
    # A periodic cubic is nearest to its control point k + 1 at parameter k.
    centre_mm = curve.control_points_mm[(centre + 1) % len(curve.control_points_mm)]
    steps = np.arange(_STEPS_A_SPAN * span, _STEPS_A_SPAN * (span + 1) + 1)
    turns, places = np.divmod(steps, len(points_mm))
    nearest = int(np.argmin(np.linalg.norm(points_mm[places] - centre_mm, axis=1)))
    return float(turns[nearest] * lengths_mm[-1] + lengths_mm[places[nearest]])
