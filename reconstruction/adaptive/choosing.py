"""Which span between two slices the next one is worth most in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reconstruction.adaptive.foretelling import Kind, Level, Miss, jump_mm, missed, reach

_SMOOTH = 1.0 / 8.0
_ROUGH = 1.0 / 2.0
_GAPPY = 0.1


@dataclass(frozen=True, slots=True)
class Span:
    """Between two neighbouring slices, by their positions in the list."""

    low: int
    high: int
    expected_mm: float
    why: str


@dataclass(frozen=True, slots=True)
class Choice:
    span: Span
    position: int


def spans_between(levels: Sequence[Level]) -> tuple[Span, ...]:
    misses: dict[int, Miss] = {}
    for k in range(1, len(levels) - 1):
        trio = levels[k - 1 : k + 2]
        if all(each.kind is Kind.SECTION for each in trio) and len({each.topology for each in trio}) == 1:
            run = _run(levels, k)
            misses[k] = missed(levels[run[0] : run[1]], k - run[0])
    return tuple(_span(levels, k, misses) for k in range(len(levels) - 1))


def _run(levels: Sequence[Level], k: int) -> tuple[int, int]:
    same = lambda j: 0 <= j < len(levels) and levels[j].kind is Kind.SECTION and levels[j].topology == levels[k].topology
    a, b = k, k + 1
    while same(a - 1) and k - a < 2:
        a -= 1
    while same(b) and b - k <= 2:
        b += 1
    return a, b


def _span(levels, k, misses) -> Span:
    low, high = levels[k], levels[k + 1]
    rise = high.height_mm - low.height_mm
    kinds = {low.kind, high.kind}
    if kinds == {Kind.NOTHING}:
        return Span(k, k + 1, 0.0, "nothing is there")
    if kinds != {Kind.SECTION}:
        return Span(k, k + 1, rise, "the part ends there")
    if low.topology != high.topology:
        return Span(k, k + 1, jump_mm(low, high), "contours part or join")
    beside = [_within(levels, j, misses[j], k) for j in (k, k + 1) if j in misses]
    if not beside:
        return Span(k, k + 1, jump_mm(low, high) / 2.0, "nothing foretells it")
    return Span(k, k + 1, max(beside), "the shape changes")


def _within(levels, j, miss, k) -> float:
    """Error inside span k of what missed section j by so much."""
    middle = (levels[k].height_mm + levels[k + 1].height_mm) / 2.0
    here = levels[j].height_mm
    # the cubic inside the span has j for a node, and one node less on the far side
    nodes = sorted(miss.nodes_mm, key=lambda h: abs(h - middle))[: len(miss.nodes_mm) - 1]
    ratio = reach(middle, [*nodes, here]) / reach(here, miss.nodes_mm)
    smooth = miss.cubic_mm * max(ratio, _SMOOTH)
    rough = miss.linear_mm * _ROUGH
    return min(smooth, rough) if miss.cubic_mm < miss.linear_mm else rough


def choose(spans, positions, tolerance_mm) -> Choice | None:
    best = None
    for span in spans:
        a, b = positions[span.low], positions[span.high]
        if span.expected_mm > tolerance_mm and b - a > 1 and (best is None or span.expected_mm > best.span.expected_mm):
            best = Choice(span, (a + b) // 2)
    return best
