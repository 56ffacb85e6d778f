"""Which span between two slices is worth the next one most, and where in it.

The error inside a span is not known: nobody measured there. What is known is by how much each
measured section misses what its neighbours foretell. That was a prediction over the two spans
beside it together; over one of them it is better::

    smooth     the miss of a cubic falls as the product of the distances from its nodes, which are
               nearer without the leap over the section; but it is not believed to fall more than
               to an eighth
    rough      an edge between two slices: the miss of a straight line falls with its length only

Where contours part or join, or the part ends, nothing is foretold: the way between the two slices
is what the surface may be off. Where the plan ends and the part does not, a surface is carried on
by half the way between its last two slices: a slice close beside the last makes that short.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from reconstruction.adaptive.foretelling import Kind, Level, Miss, jump_mm, missed, reach

_SMOOTH = 1.0 / 8.0
_ROUGH = 1.0 / 2.0
_NODES = 2  # sections to either side that foretell one
_GAPPY = 0.1  # share of a section: with more it foretells nothing ...
_LESS_GAPPY = 0.5  # ... where its neighbours have less than so much of that


@dataclass(frozen=True, slots=True)
class Span:
    """The way between two neighbouring slices, by their places in the list."""

    low: int
    high: int
    expected_mm: float  # how far the surface may be off in it
    why: str
    beside: int | None = None  # the slice to be close to; None: in the middle


@dataclass(frozen=True, slots=True)
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
    found = [replace(s, low=ends[s.low], high=ends[s.high]) for s in spans]
    return (*found, *_carried_on(levels))


def choose(
    spans: Sequence[Span],
    positions: Sequence[int],
    tolerance_mm: float,
    taken: Collection[int] = (),
) -> Choice | None:
    """The middle of the span that is off most, if that is more than the tolerance.

    Parameters
    ----------
    positions
        Of the slices that the spans lie between, on the grid of places for slices.
    taken
        Places that need no second slice, besides those.

    Returns
    -------
    None where every span with a free place in it is within the tolerance.
    """
    full = {*positions, *taken}
    for span in sorted(spans, key=lambda each: each.expected_mm, reverse=True):
        if span.expected_mm <= tolerance_mm:
            break
        low, high = positions[span.low], positions[span.high]
        free = [place for place in range(low + 1, high) if place not in full]
        wanted = (low + high) / 2 if span.beside is None else positions[span.beside]
        if free:
            return Choice(min(free, key=lambda place: abs(place - wanted)), span)
    return None


def _carried_on(levels: Sequence[Level]) -> Iterator[Span]:
    """What lies beyond the first and the last slice, where these show the part."""
    last = len(levels) - 1
    for end, inner in ((0, 1), (last, last - 1)):
        if last > 0 and levels[end].kind is Kind.SECTION and levels[inner].kind is Kind.SECTION:
            half_mm = abs(levels[end].height_mm - levels[inner].height_mm) / 2.0
            low, high = sorted((end, inner))
            yield Span(low, high, half_mm, "the plan ends there, and the part does not", end)


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
    kinds = {low.kind, high.kind}
    if kinds == {Kind.NOTHING}:
        return Span(k, k + 1, 0.0, "nothing is there")
    if kinds != {Kind.SECTION}:
        way_mm = high.height_mm - low.height_mm
        return Span(k, k + 1, way_mm, "the part ends there, or is not seen")
    if not _alike(low, high):
        return Span(k, k + 1, jump_mm(low, high), "contours part or join")
    beside = [_inside(levels, k, levels[j], misses[j]) for j in (k, k + 1) if j in misses]
    if not beside:
        return Span(k, k + 1, jump_mm(low, high) * _ROUGH, "no neighbours foretell it")
    return Span(k, k + 1, max(beside), "the shape changes otherwise than its neighbours foretell")


def _inside(levels: Sequence[Level], k: int, end: Level, miss: Miss) -> float:
    """What the miss of one end of span k says of the span's middle."""
    middle_mm = (levels[k].height_mm + levels[k + 1].height_mm) / 2.0
    rough_mm = miss.linear_mm * _ROUGH
    if miss.cubic_mm >= miss.linear_mm:
        return rough_mm
    # In the span the end itself is a node, and the farthest of the others is not needed.
    nodes = sorted(miss.nodes_mm, key=lambda height: abs(height - middle_mm))[:-1]
    shorter = reach(middle_mm, [*nodes, end.height_mm]) / reach(end.height_mm, miss.nodes_mm)
    return min(rough_mm, miss.cubic_mm * max(shorter, _SMOOTH))
