"""Strands laid side by side: stations that belong together, over gaps and ragged ends too.

All strands are seen from one middle line, their mean: where along it each place of a strand stands,
and how far off. Where a strand has no points, its neighbours say how far off it would be.

::

      ______     ___    strand with a gap            s: where along the middle line
    --------------------  middle line                borders: where strands begin and end there,
     |  |  |  |  |  |  |  stations                   as their neighbours have it
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array, eye_array, kron, vstack
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, frozen
from reconstruction.skinning.steps import Step, find_steps
from reconstruction.skinning.strands import Strand, length_mm

_PLACES = 513  # of the middle line
_SMOOTH = 1.0 / 48.0  # of its length: narrower bends are the strands' own
_BEYOND = 0.25  # of its length, that it is carried on straight at either end
_ROUNDS = 3
_STIFF = 1.0  # of the lines along which strands begin and end: second differences beside squares
_SLACK = 0.01  # of a strand's length: one that ends earlier by more has lost its end, ...
_EARLY = 1e-3  # ... and says so little
_SIFTINGS = 12
_WALL_SPANS, _LEAST_SPANS = 3, 3  # of the wall of a step, of a face beside it
_BLIND = 0.02  # of the middle line, beside a step that a strand has run smoothly over
_FAINT = 1e-9  # beside second differences: what nothing holds stays on the middle line
_RISE = 1e-6  # of the way along a strand, that the way along the middle line grows by at least
_SHARED = 0.3  # of the strands must reach a place of the middle line
_ROUGH = 129  # places of it while it is looked for

Runs = list[tuple[FloatArray, FloatArray]]  # of a strand: where along the middle line, and places


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Stations on strands: column m runs from strand to strand."""

    positions: FloatArray  # (k,), of the strands
    places_mm: FloatArray  # (k, m, 2), in the strands' own coordinates
    measured: BoolArray  # (k, m), there is a run; elsewhere the neighbours say where it would be

    def __post_init__(self) -> None:
        for name in ("positions", "places_mm"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "measured", frozen(self.measured, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class Middle:
    """The line that all strands are seen from, evenly sampled, carried on at both ends."""

    line_mm: FloatArray  # (n, 2)
    along_mm: FloatArray  # (n,), 0 and the length at its own ends

    @property
    def end_mm(self) -> float:
        """Of what is not carried on."""
        return float(self.along_mm[-1] + self.along_mm[0])

    def at(self, along_mm: FloatArray) -> FloatArray:
        """Places (..., 2)."""
        return np.stack([np.interp(along_mm, self.along_mm, x) for x in self.line_mm.T], axis=-1)

    def feet(self, places_mm: FloatArray) -> FloatArray:
        """Where along it places (n, 2) stand, (n,)."""
        _, near = cKDTree(self.line_mm).query(places_mm)
        best = np.full(len(places_mm), np.inf)
        found = np.zeros(len(places_mm))
        for step in (-1, 0):
            start = np.clip(near + step, 0, len(self.line_mm) - 2)
            way = self.line_mm[start + 1] - self.line_mm[start]
            arm = places_mm - self.line_mm[start]
            square = np.maximum((way**2).sum(axis=1), 1e-300)
            share = np.clip((way * arm).sum(axis=1) / square, 0.0, 1.0)
            off = np.linalg.norm(arm - share[:, None] * way, axis=1)
            here = self.along_mm[start] * (1.0 - share) + self.along_mm[start + 1] * share
            found, best = np.where(off < best, here, found), np.minimum(off, best)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """All strands as they are seen from their middle line."""

    positions: FloatArray  # (k,)
    middle: Middle
    runs: tuple[Runs, ...]
    borders: tuple[FloatArray, FloatArray]  # (k,) each
    steps: tuple[Step, ...]
    cyclic: bool

    def face_spans(self, spans: int) -> tuple[int, ...]:
        """About so many spans along the strands, a whole number on every face between edges.

        With steps, every other face is the wall of one.
        """
        if not self.steps:
            return (spans,)
        bounds = self._bounds()
        widths = [float((high - low).mean()) for low, high in pairwise(bounds)]
        whole = sum(widths[::2])
        return tuple(
            _WALL_SPANS if face % 2 else max(round(spans * width / whole), _LEAST_SPANS)
            for face, width in enumerate(widths)
        )

    def stations(self, counts: Sequence[int]) -> Spread:
        """So many stations on every face, and one more at the end."""
        bounds = list(pairwise(self._bounds()))
        faces = [self._face(n, *bounds[2 * n], count) for n, count in enumerate(counts[::2])]
        parts = faces[:1]
        for (before, _), face, count in zip(faces[:-1], faces[1:], counts[1::2], strict=True):
            # A wall: straight from one edge to the other.
            share = (np.arange(1, count) / count)[:, None]
            wall = before[:, -1:] + share * (face[0][:, :1] - before[:, -1:])
            parts += [(wall, np.zeros(wall.shape[:2], np.bool_)), face]
        places, measured = zip(*parts, strict=True)
        return Spread(
            self.positions, np.concatenate(places, axis=1), np.concatenate(measured, axis=1)
        )

    def _bounds(self) -> list[FloatArray]:
        edges = [edge for step in self.steps for edge in (step.ends_mm, step.begins_mm)]
        return [self.borders[0], *edges, self.borders[1]]

    def _face(
        self, number: int, low: FloatArray, high: FloatArray, count: int
    ) -> tuple[FloatArray, BoolArray]:
        """Stations (k, count + 1, 2) of a face, and which of them runs show."""
        along = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, count + 1)
        # A run that only just reaches in is of the face beside, on the other side of a step.
        own = [
            [(s, run) for s, run in runs if _is_within(s, float(a), float(b))]
            for runs, a, b in zip(self.runs, low, high, strict=True)
        ]
        places, measured = _looked_up(own, along)
        first, last = low + self._blind(number - 1), high - self._blind(number)
        measured &= (along >= first[:, None]) & (along <= last[:, None])
        seen = self.middle.at(along)
        return seen + _filled(places - seen, measured, cyclic=self.cyclic), measured

    def _blind(self, step: int) -> FloatArray:
        """How far beside a step strands say nothing: those that went over it smoothly."""
        if not 0 <= step < len(self.steps):
            return np.zeros(len(self.positions))
        return np.where(self.steps[step].shown, 0.0, _BLIND * self.middle.end_mm)


def view(strands: Sequence[Strand], sigma_mm: float, *, cyclic: bool, stepped: bool) -> View:
    """Look at all strands from their middle line.

    Parameters
    ----------
    sigma_mm
        Scatter of a point: less is no step.
    cyclic
        The last strand is followed by the first.
    stepped
        Whether steps are looked for.
    """
    middle, runs = middle_of(strands)
    borders = _borders(runs, cyclic=cyclic)
    feet = [[(s, run - middle.at(s)) for s, run in own] for own in runs]
    steps = find_steps(feet, borders, sigma_mm) if stepped else ()
    positions = np.array([strand.position for strand in strands])
    return View(positions, middle, tuple(runs), borders, steps, cyclic)


def middle_of(strands: Sequence[Strand]) -> tuple[Middle, list[Runs]]:
    """The mean of the strands, and every strand as it is seen from there."""
    chains = [_chained(strand.runs_mm) for strand in strands]
    middle = _middle(max(chains, key=length_mm))
    runs = [_seen(strand, middle) for strand in strands]
    for _ in range(_ROUNDS):
        middle = _mean(middle, runs)
        runs = [_seen(strand, middle) for strand in strands]
    return middle, runs


def _chained(runs: Sequence[FloatArray]) -> FloatArray:
    """Runs one after the other, each next to the end that it lies nearest to; (n, 2).

    Left out are those farther from both ends than they are long: pieces beside another run.
    """
    left = sorted(runs, key=length_mm)
    chain = left.pop()
    while left:
        ways = [
            (float(np.linalg.norm(run[-mine] - chain[-its])), number, mine, its)
            for number, run in enumerate(left)
            for mine in (0, 1)
            for its in (0, 1)
        ]
        away, number, mine, its = min(ways)
        run = left.pop(number)
        if away > length_mm(run):
            continue
        if its:  # after the chain's last place
            chain = np.concatenate([chain, run[::-1] if mine else run])
        else:
            chain = np.concatenate([run if mine else run[::-1], chain])
    return chain


def _middle(line: FloatArray) -> Middle:
    """A line (n, 2) evenly sampled, smooth, carried on straight."""
    even = _evenly(line, _PLACES)
    # Odd about its ends, so that these stay.
    size = _PLACES - 1
    wide = np.concatenate([2 * even[0] - even[size:0:-1], even, 2 * even[-1] - even[-2::-1]])
    even = gaussian_filter1d(wide, _SMOOTH * size, axis=0)[size : 2 * size + 1]
    even = _evenly(even, _PLACES)
    step = float(np.linalg.norm(np.diff(even, axis=0), axis=1).mean())
    reach = int(_BEYOND * size)
    ways = [even[0] - even[reach // 8], even[-1] - even[-1 - reach // 8]]
    low, high = (way / max(float(np.linalg.norm(way)), 1e-300) * step for way in ways)
    beyond = np.arange(1, reach + 1)[:, None]
    whole = np.concatenate([(even[0] + beyond * low)[::-1], even, even[-1] + beyond * high])
    return Middle(whole, step * (np.arange(float(len(whole))) - reach))


def _evenly(line: FloatArray, count: int) -> FloatArray:
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])
    return _between(np.linspace(0.0, along[-1], count), along, line)


def _between(at: FloatArray, along: FloatArray, line: FloatArray) -> FloatArray:
    return np.stack([np.interp(at, along, x) for x in line.T], axis=1)


def _seen(strand: Strand, middle: Middle) -> Runs:
    """Every run as the middle line sees it, the way that it runs."""
    found = []
    for run in strand.runs_mm:
        s = middle.feet(run)
        if s[-1] < s[0]:
            run, s = run[::-1], s[::-1]
        # A place that seems to go back stands where its neighbours do.
        s = 0.5 * (np.maximum.accumulate(s) + np.minimum.accumulate(s[::-1])[::-1])
        steps = np.linalg.norm(np.diff(run, axis=0), axis=1)
        found.append((s + _RISE * np.concatenate([[0.0], steps.cumsum()]), run))
    return sorted(found, key=lambda each: float(each[0][0]))


def _mean(middle: Middle, runs: Sequence[Runs]) -> Middle:
    """The middle line moved to the mean of all strands.

    Where a strand has no points, it counts with what is filled in: a mean of those that have some
    would jump wherever one ends.
    """
    along = np.broadcast_to(np.linspace(0.0, middle.end_mm, _ROUGH), (len(runs), _ROUGH))
    seen = middle.at(along)
    places, measured = _looked_up(runs, along)
    shared = measured.mean(axis=0) >= _SHARED
    if int(shared.sum()) < 2:
        return middle
    offsets = _filled(places - seen, measured, cyclic=False)
    return _middle((seen + offsets).mean(axis=0)[shared])


def _is_within(s: FloatArray, low: float, high: float) -> bool:
    """Whether half of a run, or of a face from low to high, is in the other."""
    shared = min(float(s[-1]), high) - max(float(s[0]), low)
    return shared > 0.5 * min(float(s[-1] - s[0]), high - low)


def _looked_up(runs: Sequence[Runs], along: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Places (k, m, 2) of strands at (k, m) along the middle line, and whether a run is there."""
    places = np.full((*along.shape, 2), np.nan)
    for k, own in enumerate(runs):
        for s, run in own:
            inside = (along[k] >= s[0]) & (along[k] <= s[-1])
            places[k, inside] = _between(along[k, inside], s, run)
    return places, np.isfinite(places[..., 0])


def _borders(runs: Sequence[Runs], *, cyclic: bool) -> tuple[FloatArray, FloatArray]:
    """Where every strand begins and ends; one that ends early, where those beside it do."""
    low = np.array([own[0][0][0] for own in runs])
    high = np.array([max(float(s[-1]) for s, _ in own) for own in runs])
    slack = _SLACK * float(np.median(high - low))
    return _outermost(low, slack, cyclic=cyclic), -_outermost(-high, slack, cyclic=cyclic)


def _outermost(values: FloatArray, slack: float, *, cyclic: bool) -> FloatArray:
    """A smooth line through values (k,) from below: those far above it do not count.

    Asymmetric least squares (Eilers, Boelens 2005).
    """
    count = len(values)
    seconds = np.roll(np.eye(count), 1, axis=1) - 2.0 * np.eye(count) + np.roll(
        np.eye(count), -1, axis=1
    )  # fmt: skip
    seconds = seconds if cyclic else seconds[1:-1]
    stiff = _STIFF * seconds.T @ seconds
    line = np.array(values)
    for width in np.geomspace(np.ptp(values) + slack, slack, _SIFTINGS):
        weights = np.where(values > line + width, _EARLY, 1.0)
        line = np.asarray(np.linalg.solve(np.diag(weights) + stiff, weights * values), np.float64)
    return np.asarray(line)


def _filled(offsets: FloatArray, known: BoolArray, *, cyclic: bool) -> FloatArray:
    """Offsets (k, m, 2) that are not known: as smooth as may be, from all sides.

    The least squares of second differences, along the strands and across them.
    """
    unknown = np.flatnonzero(~known)
    filled = np.where(known[..., None], offsets, 0.0).reshape(-1, 2)
    if not len(unknown):
        return filled.reshape(offsets.shape)
    rows, columns = known.shape
    across = kron(_seconds(rows, cyclic=cyclic), eye_array(columns))
    along = kron(eye_array(rows), _seconds(columns, cyclic=False))
    bends = vstack([across, along]).tocsc()
    free = bends[:, unknown]
    normal = (free.T @ free + _FAINT * eye_array(len(unknown))).tocsc()
    filled[unknown] = spsolve(normal, -free.T @ (bends @ filled)).reshape(-1, 2)
    return filled.reshape(offsets.shape)


def _seconds(count: int, *, cyclic: bool) -> coo_array:
    """Second differences of so many values, sparse."""
    rows = np.arange(count if cyclic else max(count - 2, 0))
    at = np.concatenate([(rows + step) % count for step in range(3)])
    values = np.repeat([1.0, -2.0, 1.0], len(rows))
    return coo_array((values, (np.tile(rows, 3), at)), shape=(len(rows), count))
