"""One surface through open sections: stripes side by side, or meridians about an axis.

strands (`strands`) -> stations side by side (`spreading`) -> a net -> the tensor fit

::

    stripes      u across the stripes' length, v from stripe to stripe; both end at open borders
    meridians    u around the axis from angle to angle, closed if they go all round; v along the
                 meridian, from a pole or a level brim to the other

The net's parameters are where the sections truly are: heights, angles. What one section does not
show, the others do; the fit's stiffness fills it, and its covariance says how well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.fan_ends import FanEnd, between_levels, end_of
from reconstruction.skinning.feet import nearby
from reconstruction.skinning.laying import net_through, strides
from reconstruction.skinning.layout import Fan
from reconstruction.skinning.merging import Cells
from reconstruction.skinning.net import Net
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.rounds import Rim, span_mm
from reconstruction.skinning.skin import Skin, halvings, noise_of, rims_of
from reconstruction.skinning.spreading import Spread, spread
from reconstruction.skinning.strands import Strand, meridians_of, stripes_of
from reconstruction.skinning.tensor_fit import FREE, fit_net

_SPANS_A_FREEDOM, _MORE_SPANS = 2.5, 10
_LEAST_ALONG, _MOST_ALONG = 12, 240
_SPANS_A_STRAND = 0.75  # as in `skin`: one to one, strands would lie in the middle of spans
_LEAST_ACROSS, _MOST_ACROSS = 6, 160
_ROUND_SPANS = 48  # as in `skin`
_WIDE = 32  # spans to begin with, if they can be halved
_STATIONS_A_SPAN, _LEAST_STATIONS = 3, 96
_ALL_ROUND = math.radians(75.0)  # no wider gap between meridians that go all round
_REACH = 3.0  # spans of the first net: cells farther off are not its
_LEAST_STRANDS = 2


def skin_stripes(stack: Sequence[SliceOutlines]) -> Skin:
    """Fit one open surface to parallel open sections, given by height.

    Raises
    ------
    NotLoftable
        Fewer than two slices have an open section.
    Unfittable
        Their points do not hold a surface.
    """
    strands = _enough(stripes_of(stack))
    runs = tuple(run for piece in stack for run in piece.runs)
    spans = _spans_along(stack), _spans_across(len(strands))
    found = spread(strands, _stations(spans[0]), cyclic=False)
    axes = stack[0].frame.axes
    places = found.places_mm @ axes[:2] + found.positions[:, None, None] * axes[2]
    branch = Branch(runs, cyclic=False, ends=None, hole=False)
    times = halvings(spans[0], _LEAST_ALONG, _WIDE), halvings(spans[1], _LEAST_ACROSS, _WIDE)
    wide = _widened(spans, times)
    rows, columns = _evenly(places, wide[1]), _evenly(places.swapaxes(0, 1), wide[0])
    net = net_through(places, rows, columns, wide, None, closed=(False, False))
    return _fitted(branch, net, None, times)


def skin_meridians(stack: Sequence[SliceOutlines], fan: Fan) -> Skin:
    """Fit one surface about the axis that the slices share.

    Raises
    ------
    NotLoftable, Unfittable
        As `skin_stripes`.
    """
    strands = _enough(meridians_of(stack, fan))
    round_ = goes_round([strand.position for strand in strands])
    turned = strands if round_ else _from_the_gap(strands)
    spans = _spans_across(len(strands), closed=round_), _spans_along(stack)
    found = _upwards(spread(turned, _stations(spans[1]), cyclic=round_))
    low, high = (end_of(found, fan.frame, last=last) for last in (False, True))
    found = between_levels(found, fan.frame, low, high)
    places = _about(found, fan)
    branch = _branch(stack, fan, len(strands), (low, high))
    times = halvings(spans[0], _LEAST_ACROSS, _WIDE), halvings(spans[1], _LEAST_ALONG, _WIDE)
    wide = _widened(spans, times)
    places = _ended(places, low, high)
    first = found.positions[0]
    turn = math.tau if round_ else float(found.positions[-1] - first)
    columns = (found.positions - first) / turn * wide[0]
    ends = low.end, high.end
    rows = _evenly(places, wide[1])
    net = net_through(places, rows, columns, wide, ends, closed=(round_, False))
    return _fitted(branch, net, (low, high), times)


def goes_round(angles: Sequence[float]) -> bool:
    """Whether angles in [0, 2 pi), in order, leave no wide gap."""
    around = np.append(np.asarray(angles), angles[0] + math.tau)
    return bool(np.diff(around).max() <= _ALL_ROUND)


def _enough(strands: tuple[Strand, ...]) -> tuple[Strand, ...]:
    if len(strands) < _LEAST_STRANDS:
        raise NotLoftable(
            f"{len(strands)} open sections: a surface needs {_LEAST_STRANDS}",
            indices=tuple(strand.slice_index for strand in strands),
        )
    return strands


def _from_the_gap(strands: tuple[Strand, ...]) -> tuple[Strand, ...]:
    """Strands of an open fan in order, beginning after its gap; angles grow from there."""
    angles = np.array([strand.position for strand in strands])
    widest = int(np.argmax(np.diff(np.append(angles, angles[0] + math.tau))))
    after = strands[widest + 1 :]
    before = strands[: widest + 1]
    return (
        *after,
        *(Strand(each.slice_index, each.position + math.tau, each.runs_mm) for each in before),
    )


def _upwards(found: Spread) -> Spread:
    """The same with rows that begin at the low end of the axis."""
    heights = found.places_mm[..., 1].mean(axis=0)
    if heights[0] <= heights[-1]:
        return found
    return Spread(found.positions, found.places_mm[:, ::-1], found.measured[:, ::-1])


def _about(found: Spread, fan: Fan) -> FloatArray:
    """Stations in the part frame, row by row along the meridians, (m, k, 3)."""
    x, y, axis = fan.frame.axes
    angles = found.positions[:, None]
    ways = np.cos(angles) * x + np.sin(angles) * y  # (k, 3)
    planar = found.places_mm.swapaxes(0, 1)
    return np.asarray(fan.frame.origin_mm + planar[..., :1] * ways[None] + planar[..., 1:] * axis)


def _branch(
    stack: Sequence[SliceOutlines], fan: Fan, strands: int, ends: tuple[FanEnd, FanEnd]
) -> Branch:
    runs = tuple(run for piece in stack for run in piece.runs)
    low, high = (End(Ending.UNSEEN, end.height_mm) for end in ends)
    return Branch(runs, cyclic=False, ends=(low, high), hole=False, frame=fan.frame, across=strands)


def _ended(places: FloatArray, low: FanEnd, high: FanEnd) -> FloatArray:
    """Rows (m, k, 3) with the ends' own first and last."""
    inner = places[(1 if low.replaces else 0) : len(places) - (1 if high.replaces else 0)]
    rows = [end.row_mm(places[-last]) for last, end in enumerate((low, high))]
    return np.concatenate([rows[0][None], inner, rows[1][None]])


def _fitted(
    branch: Branch,
    net: Net,
    ends: tuple[FanEnd, FanEnd] | None,
    times: tuple[int, int],
) -> Skin:
    noise = noise_of(branch)
    moments = Moments.together([outline.moments for outline in branch.outlines])
    near, u, v = nearby(net, moments, _REACH * span_mm(net))
    brims = None if ends is None else (ends[0].end, ends[1].end)
    rims = FREE if brims is None else rims_of(brims)
    if not net.closed_u:  # a pole that is not gone round has no tangent plane to be tied to
        rims = (Rim(level=rims[0].level), Rim(level=rims[1].level))
    fit = fit_net(net, Cells((near,), u, v), noise, rims=rims, halvings=times)
    seen = (False, False) if ends is None else (ends[0].seen, ends[1].seen)
    return Skin(branch, brims, fit, seen=seen)


def _stations(spans: int) -> int:
    return max(_STATIONS_A_SPAN * spans, _LEAST_STATIONS)


def _evenly(places: FloatArray, spans: int) -> FloatArray:
    """Parameters (k,) of rows (k, m, 3) by the distance from row to row, averaged across."""
    along = np.concatenate([[0.0], strides(places).cumsum()])
    return np.asarray(along / along[-1] * spans)


def _spans_along(stack: Sequence[SliceOutlines]) -> int:
    """Spans enough for the liveliest sections; the stiffness does the rest."""
    spent = [sum(run.fitted.edf for run in piece.runs) for piece in stack if piece.runs]
    spans = _SPANS_A_FREEDOM * float(np.quantile(spent, 0.9)) + _MORE_SPANS
    return int(min(max(spans, _LEAST_ALONG), _MOST_ALONG))


def _spans_across(strands: int, *, closed: bool = False) -> int:
    least = _ROUND_SPANS if closed else _LEAST_ACROSS
    return int(min(max(_SPANS_A_STRAND * strands, least), _MOST_ACROSS))


def _widened(spans: tuple[int, int], times: tuple[int, int]) -> tuple[int, int]:
    return -(-spans[0] // 2 ** times[0]), -(-spans[1] // 2 ** times[1])
