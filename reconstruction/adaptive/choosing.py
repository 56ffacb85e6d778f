"""Which span between two slices is worth the next one most, and where in it.

The error inside a span is not known: nobody measured there. What is known is by how much each
measured section misses what its neighbours foretell. That was a prediction over the two spans
beside it together; over one of them it is better::

    cubic      its miss falls as the product of the distances from its nodes, which are nearer
               without the leap over the section
    straight   its miss falls likewise

Neither is believed to fall to less than a half, as at an edge between two slices it does not; the
better of the two counts.

Where contours part or join, or the part ends, nothing is foretold: the way between the two slices
is what the surface may be off. Where the plan ends and the part does not, a surface is carried on
by half the way between its last two slices: a slice close beside the last makes that short.

A span is worth as much as the surface in it that is expected out of tolerance, for each slice that
it takes to mend that.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.adaptive.foretelling import (
    QUANTILES,
    SHARE,
    Kind,
    Level,
    Miss,
    jumps_mm,
    missed,
    reach,
)
from reconstruction.arrays import FloatArray, frozen

_LEAST_SHARE = 0.5  # of a section's miss that is expected in the spans beside it
_NODES = 2  # sections to either side that foretell one
_GAPPY = 0.1  # share of a section: with more it foretells nothing ...
_LESS_GAPPY = 0.5  # ... where its neighbours have less than so much of that
_MOST_PARTS = 8  # that a span is cut into at once


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """The way between two neighbouring slices, by their places in the list."""

    low: int
    high: int
    errors_mm: FloatArray  # (QUANTILES,) of the surface in it, sorted
    area_mm2: float  # of that surface, about
    why: str
    beside: int | None = None  # the slice to be close to; None: in the middle
    foretold: bool = False  # by neighbours: then shorter spans are better in a known way

    def __post_init__(self) -> None:
        object.__setattr__(self, "errors_mm", frozen(self.errors_mm))

    @property
    def expected_mm(self) -> float:
        """What nearly all of it is within."""
        return float(self.errors_mm[-1])

    def parts(self, tolerance_mm: float) -> int:
        """Into how many it is to be cut: errors fall at least with the square of the length."""
        if not self.foretold:
            return 2
        wanted = math.ceil(math.sqrt(self.expected_mm / tolerance_mm))
        return min(max(wanted, 2), _MOST_PARTS)

    def worth_mm2(self, tolerance_mm: float) -> float:
        """Surface out of tolerance, for each slice that it takes."""
        out = float((self.errors_mm > tolerance_mm).mean())
        return out * self.area_mm2 / (self.parts(tolerance_mm) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """One slice that is worth taking."""

    position: int  # on the grid of places
    span: Span


def spans_between(levels: Sequence[Level]) -> tuple[Span, ...]:
    """The spans between slices from low to high, and what is to be expected in each.

    A section with gaps that its neighbours do not have is no end of a span: its span goes on.
    """
    ends = [k for k in range(len(levels)) if not _is_gappy(levels, k)]
    used = [levels[k] for k in ends]
    misses = {k: _missed(used, k) for k in range(1, len(used) - 1) if _foretold(used, k)}
    spans = (_span(used, k, misses) for k in range(len(used) - 1))
    found = [replace(span, low=ends[span.low], high=ends[span.high]) for span in spans]
    return (*found, *_carried_on(levels))


def expected_mm(spans: Sequence[Span]) -> float:
    """What 98 % of the whole surface is expected within."""
    errors = np.concatenate([[0.0], *(span.errors_mm for span in spans)])
    areas = np.concatenate([[0.0], *(np.full(QUANTILES, span.area_mm2) for span in spans)])
    order = np.argsort(errors)
    shares = np.cumsum(areas[order]) / max(float(areas.sum()), 1e-300)
    enough = min(int(np.searchsorted(shares, SHARE / 100.0)), len(errors) - 1)
    return float(errors[order[enough]])


def choose(
    spans: Sequence[Span],
    positions: Sequence[int],
    tolerance_mm: float,
    taken: Collection[int] = (),
) -> Choice | None:
    """The slice that is worth most; None where enough is within the tolerance, or no place is free.

    Parameters
    ----------
    positions
        Of the slices that the spans lie between, on the grid of places for slices.
    taken
        Places that need no second slice, besides those.
    """
    if expected_mm(spans) <= tolerance_mm:
        return None
    full = {*positions, *taken}
    for span in sorted(spans, key=lambda each: each.worth_mm2(tolerance_mm), reverse=True):
        if not span.worth_mm2(tolerance_mm) > 0.0:
            break
        low, high = positions[span.low], positions[span.high]
        free = [place for place in range(low + 1, high) if place not in full]
        parts = span.parts(tolerance_mm)
        wanted = low + (high - low) * (parts // 2) / parts
        if span.beside is not None:
            wanted = positions[span.beside]
        if free:
            return Choice(min(free, key=lambda place: abs(place - wanted)), span)
    return None


def _is_gappy(levels: Sequence[Level], at: int) -> bool:
    """Whether a section lost what the two beside it have."""
    here = levels[at]
    beside = [levels[k] for k in (at - 1, at + 1) if 0 <= k < len(levels)]
    return (
        here.gap_share > _GAPPY
        and len(beside) == 2
        and all(each.kind is Kind.SECTION for each in beside)
        and all(each.gap_share < _LESS_GAPPY * here.gap_share for each in beside)
    )


def _foretold(levels: Sequence[Level], at: int) -> bool:
    return all(_alike(levels[at], levels[k]) for k in (at - 1, at, at + 1))


def _alike(one: Level, other: Level) -> bool:
    """Whether contours can go on from one to the other."""
    both = one.kind is Kind.SECTION and other.kind is Kind.SECTION
    return both and one.topology == other.topology


def _missed(levels: Sequence[Level], at: int) -> Miss:
    """The miss of a section, foretold by those around it whose contours go on."""
    low, high = at, at
    while low > max(0, at - _NODES) and _alike(levels[low - 1], levels[at]):
        low -= 1
    while high < min(len(levels) - 1, at + _NODES) and _alike(levels[high + 1], levels[at]):
        high += 1
    return missed(levels[low : high + 1], at - low)


def _span(levels: Sequence[Level], k: int, misses: dict[int, Miss]) -> Span:
    low, high = levels[k], levels[k + 1]
    rise_mm = high.height_mm - low.height_mm
    wall_mm2 = rise_mm * (low.length_mm + high.length_mm) / 2.0
    kinds = {low.kind, high.kind}
    if kinds == {Kind.NOTHING}:
        return Span(k, k + 1, np.zeros(QUANTILES), 0.0, "nothing is there")
    if kinds != {Kind.SECTION}:
        # Level or domed, what closes the part is about as large as the section below it.
        end_mm2 = max(low.area_mm2, high.area_mm2) + wall_mm2
        off = np.full(QUANTILES, rise_mm)
        return Span(k, k + 1, off, end_mm2, "the part ends there, or is not seen")
    if not _alike(low, high):
        wall_mm2 += abs(low.area_mm2 - high.area_mm2)
        return Span(k, k + 1, jumps_mm(low, high), wall_mm2, "contours part or join")
    wall_mm2 = math.hypot(wall_mm2, low.area_mm2 - high.area_mm2)
    beside = [_inside(low, high, misses[j]) for j in (k, k + 1) if j in misses]
    if not beside:
        why = "no neighbours foretell it"
        return Span(k, k + 1, jumps_mm(low, high) * _LEAST_SHARE, wall_mm2, why)
    why = "the shape changes otherwise than its neighbours foretell"
    return Span(k, k + 1, np.max(beside, axis=0), wall_mm2, why, foretold=True)


def _carried_on(levels: Sequence[Level]) -> Iterator[Span]:
    """What lies beyond the first and the last slice, where these show the part."""
    last = len(levels) - 1
    for end, inner in ((0, 1), (last, last - 1)):
        if last > 0 and levels[end].kind is Kind.SECTION and levels[inner].kind is Kind.SECTION:
            half_mm = abs(levels[end].height_mm - levels[inner].height_mm) / 2.0
            low, high = sorted((end, inner))
            off, why = np.full(QUANTILES, half_mm), "the plan ends there, and the part does not"
            yield Span(low, high, off, levels[end].area_mm2, why, end)


def _inside(low: Level, high: Level, miss: Miss) -> FloatArray:
    """What the miss of one end of a span says of the span's middle."""
    middle_mm = (low.height_mm + high.height_mm) / 2.0
    shorter = reach(middle_mm, (low.height_mm, high.height_mm))
    shorter /= reach(miss.height_mm, miss.beside_mm)
    straight_mm = miss.linear_mm * max(shorter, _LEAST_SHARE)
    # In the span the end itself is a node, and the farthest of the others is not needed.
    nodes = sorted(miss.nodes_mm, key=lambda height: abs(height - middle_mm))[:-1]
    shorter = reach(middle_mm, [*nodes, miss.height_mm]) / reach(miss.height_mm, miss.nodes_mm)
    cubic_mm = miss.cubic_mm * max(shorter, _LEAST_SHARE)
    return cubic_mm if cubic_mm[-1] < straight_mm[-1] else straight_mm
