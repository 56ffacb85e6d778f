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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable, Unfittable
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.fan_ends import FanEnd, between_levels, end_of
from reconstruction.skinning.feet import nearby, off_the_walls
from reconstruction.skinning.interpolating import follows, interpolating
from reconstruction.skinning.laying import net_through, strides
from reconstruction.skinning.layout import Fan
from reconstruction.skinning.merging import Cells
from reconstruction.skinning.net import Net
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.rounds import Rim, span_mm
from reconstruction.skinning.skin import Skin, halvings, noise_of, rims_of, standing_out
from reconstruction.skinning.spreading import Spread, view
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
_FEWEST, _MOST_KEPT = 8, 0.9  # strands, and of them, that are never taken for wild
_ROUGH, _ROUGH_ENDS = 48, 4  # stations that tell which are, but for those at either end
_FEW, _SPANS_A_ROW = 20, 2  # as in `skin`: of so few, a spline may take the fit's place


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """One surface, and the slices that had no say in it."""

    skin: Skin
    wild: tuple[int, ...]  # indices of slices that stand out from both neighbours


def fit_stripes(stack: Sequence[SliceOutlines]) -> Sheet:
    """Fit one open surface to parallel open sections, given by height.

    Raises
    ------
    NotLoftable
        Fewer than two slices have an open section.
    Unfittable
        Their points do not hold a surface.
    """
    axes = stack[0].frame.axes

    def placed(found: Spread) -> FloatArray:
        return np.asarray(found.places_mm @ axes[:2] + found.positions[:, None, None] * axes[2])

    wild = _wild(_enough(stripes_of(stack)), placed, cyclic=False)
    kept = [piece for piece in stack if piece.index not in wild]
    return Sheet(_skin_stripes(kept, placed), wild)


def fit_meridians(stack: Sequence[SliceOutlines], fan: Fan) -> Sheet:
    """Fit one surface about the axis that the slices share.

    Raises
    ------
    NotLoftable, Unfittable
        As `fit_stripes`.
    """
    strands = _enough(meridians_of(stack, fan))
    cyclic = goes_round([strand.position for strand in strands])

    def placed(found: Spread) -> FloatArray:
        return _about(found, fan).swapaxes(0, 1)

    wild = _wild(strands, placed, cyclic=cyclic)
    kept = [piece for piece in stack if piece.index not in wild]
    return Sheet(_skin_meridians(kept, fan), wild)


def _wild(
    strands: Sequence[Strand], placed: Callable[[Spread], FloatArray], *, cyclic: bool
) -> tuple[int, ...]:
    """Indices of the slices whose strands stand out from both neighbours, one after another."""
    left, found = list(strands), []
    while len(left) > max(_FEWEST, _MOST_KEPT * len(strands)):
        seen = view(left, 0.0, cyclic=cyclic, stepped=False)
        # Not at the ends, where one that is short has what its neighbours say, wild or not.
        places = placed(seen.stations([_ROUGH]))[:, _ROUGH_ENDS:-_ROUGH_ENDS]
        worst = standing_out(places, cyclic=cyclic)
        if worst is None:
            break
        found.append(left.pop(worst).slice_index)
    return tuple(found)


def _skin_stripes(stack: Sequence[SliceOutlines], placed: Callable[[Spread], FloatArray]) -> Skin:
    strands = _enough(stripes_of(stack))
    runs = tuple(run for piece in stack for run in piece.runs)
    spans = _spans_along(stack), _spans_across(len(strands))
    branch = Branch(runs, cyclic=False, ends=None, hole=False)
    sigma_mm = math.sqrt(noise_of(branch).level_mm2)
    seen = view(strands, sigma_mm, cyclic=False, stepped=True)

    def laid(spans: tuple[int, int], *, through: bool = False) -> Net:
        faces = seen.face_spans(spans[0])
        whole = sum(faces)
        a_span = -(-_stations(whole) // whole)
        places = placed(seen.stations([a_span * face for face in faces]))
        rows = _evenly(places, spans[1])
        columns = np.arange(float(a_span * whole + 1)) / a_span
        creases = np.cumsum(faces)[:-1]
        return net_through(
            places, rows, columns, (whole, spans[1]), None, creases, closed=(False, False),
            through=through,
        )  # fmt: skip

    try:
        skin = _fitted(branch, laid, spans, (_LEAST_ALONG, _LEAST_ACROSS), None)
    except Unfittable:
        if len(strands) > _FEW:
            raise
    else:
        if len(strands) > _FEW or follows(skin.fit, noise_of(branch)):
            return skin
    # Few stripes far apart, which no fit holds on to: a spline through them, as through rings.
    return _through(
        branch, laid((spans[0], max(_SPANS_A_ROW * len(strands), _LEAST_ACROSS)), through=True)
    )


def _skin_meridians(stack: Sequence[SliceOutlines], fan: Fan) -> Skin:
    strands = _enough(meridians_of(stack, fan))
    round_ = goes_round([strand.position for strand in strands])
    turned = strands if round_ else _from_the_gap(strands)
    spans = _spans_across(len(strands), closed=round_), _spans_along(stack)
    seen = view(turned, 0.0, cyclic=round_, stepped=False)
    found = _upwards(seen.stations([_stations(spans[1])]))
    low, high = (end_of(found, fan.frame, last=last) for last in (False, True))
    found = between_levels(found, fan.frame, low, high)
    places = _about(found, fan)
    branch = _branch(stack, fan, len(strands), (low, high))
    places = _ended(places, low, high)
    angles = found.positions - found.positions[0]
    turn = math.tau if round_ else float(angles[-1])

    def laid(spans: tuple[int, int]) -> Net:
        rows, columns = _evenly(places, spans[1]), angles / turn * spans[0]
        ends = low.end, high.end
        return net_through(places, rows, columns, spans, ends, closed=(round_, False))

    return _fitted(branch, laid, spans, (_LEAST_ACROSS, _LEAST_ALONG), (low, high))


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
    laid: Callable[[tuple[int, int]], Net],
    spans: tuple[int, int],
    least: tuple[int, int],
    ends: tuple[FanEnd, FanEnd] | None,
) -> Skin:
    """A net laid with few spans to begin with, where they may do, and fitted."""
    times = halvings(spans[0], least[0], _WIDE), halvings(spans[1], least[1], _WIDE)
    wide = -(-spans[0] // 2 ** times[0]), -(-spans[1] // 2 ** times[1])
    try:
        return _fitted_to(branch, laid(wide), ends, times)
    except Unfittable:  # too wide to find the points: narrow from the beginning
        if not any(times):
            raise
        return _fitted_to(branch, laid(spans), ends, (0, 0))


def _fitted_to(
    branch: Branch, net: Net, ends: tuple[FanEnd, FanEnd] | None, times: tuple[int, int]
) -> Skin:
    noise = noise_of(branch)
    moments = Moments.together([outline.moments for outline in branch.outlines])
    near, u, v = nearby(net, moments, _REACH * span_mm(net))
    u = off_the_walls(net, near, u, v)
    brims = None if ends is None else (ends[0].end, ends[1].end)
    rims = FREE if brims is None else rims_of(brims)
    if not net.closed_u:  # a pole that is not gone round has no tangent plane to be tied to
        rims = (Rim(level=rims[0].level), Rim(level=rims[1].level))
    fit = fit_net(net, Cells((near,), u, v), noise, rims=rims, halvings=times)
    seen = (False, False) if ends is None else (ends[0].seen, ends[1].seen)
    return Skin(branch, brims, fit, seen=seen)


def _through(branch: Branch, net: Net) -> Skin:
    """The surface through the stripes as they are."""
    moments = Moments.together([outline.moments for outline in branch.outlines])
    near, u, v = nearby(net, moments, _REACH * span_mm(net))
    u = off_the_walls(net, near, u, v)
    fit = interpolating(net, Cells((near,), u, v), noise_of(branch), FREE)
    if fit is None:
        raise Unfittable(f"{moments.total} points of stripes do not hold a surface")
    return Skin(branch, None, fit)


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
