"""Outlines of a branch laid side by side: direction, seam and numbering against their neighbours.

Every outline runs counter-clockwise as seen against the stacking axis. Its seam is turned to where
the outline lies nearest to the one before (the peak of their cross-correlation); then all stations
slide along their outlines until each lies abreast of its neighbours above and below, and evenly
between those beside it. A station that slides stays on its outline: nothing is smoothed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from scipy.fft import dst, idst

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.skinning.outlines import Outline

_LEAST_SPANS = 3  # of a face
_NONE = np.empty(0, np.int64)
_TABLE = 1024  # places of an outline, evenly along it
_FINE = 4096  # places from which arc length is told
_SHAPE = 16.0  # how much more the distance from the middle counts than the place
_CERTAIN = 20.0  # variances of an outline: less variation around says nothing
_SLOW = 24  # stations of the shortest wave of uneven spacing
_SWEEPS = 24
_EVEN = 0.5  # pull towards even spacing, against that of the neighbouring outlines
_HASTE = 0.4
_DENSER = 0.35  # of an even step: stations never come nearer


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Places on outlines that belong together: column m runs from outline to outline."""

    places_mm: FloatArray  # (k, m, 3)
    shares: FloatArray  # (k, m), of each outline's length, increasing; beyond 1 around the seam
    cell_shares: tuple[FloatArray, ...]  # k of (cells,): where on its length each cell belongs
    creases: tuple[int, ...] = ()  # columns that run along edges of the part
    spans: int | None = None  # that they stand for, if edges say how many

    def __post_init__(self) -> None:
        object.__setattr__(self, "places_mm", frozen(self.places_mm))
        object.__setattr__(self, "shares", frozen(self.shares))

    def columns_of_cells(self) -> list[FloatArray]:
        """The column of every cell, a real number in [0, m), outline by outline."""
        return [self.columns_of(k, cells) for k, cells in enumerate(self.cell_shares)]

    def columns_of(self, row: int, shares: FloatArray) -> FloatArray:
        """Columns, real numbers in [0, m), of shares of one outline's length."""
        own, count = self.shares[row], self.shares.shape[1]
        around = np.append(own, own[0] + 1.0)
        lifted = own[0] + np.mod(shares - own[0], 1.0)
        return np.asarray(np.mod(np.interp(lifted, around, np.arange(count + 1.0)), count))

    def shares_at(self, row: int, columns: FloatArray) -> FloatArray:
        """The other way round; columns below 0 or from m on are in the turn before or after."""
        own, count = self.shares[row], self.shares.shape[1]
        turns, inside = np.divmod(columns, count)
        around = np.append(own, own[0] + 1.0)
        return np.asarray(np.interp(inside, np.arange(count + 1.0), around) + turns)


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """Closed outlines as places evenly along them, which no alignment changes."""

    places_mm: FloatArray  # (k, table, 3), counter-clockwise
    cell_shares: tuple[FloatArray, ...]  # k of (cells,), of the outline's length

    def without(self, row: int) -> Tables:
        """All but one outline."""
        kept = self.cell_shares[:row] + self.cell_shares[row + 1 :]
        return Tables(np.delete(self.places_mm, row, axis=0), kept)


def align(
    outlines: Sequence[Outline],
    count: int,
    *,
    cyclic: bool = False,
    tables_of: Tables | None = None,
) -> Stations:
    """Lay `count` stations on every closed outline.

    Parameters
    ----------
    cyclic
        The last outline is followed by the first.
    tables_of
        The outlines' tables, where they are known already.
    """
    known = tables_of or tabled(outlines)
    tables, cell_shares = known.places_mm, known.cell_shares
    axes = outlines[0].frame.axes[:2]
    doubts = np.array([float((each.fitted.deviations_mm**2).mean()) for each in outlines])
    starts = _seams(tables @ axes.T, doubts)
    shares = starts[:, None] + np.arange(count) / count
    shares = _calmed(_slide(tables, shares, _NONE, _SWEEPS, cyclic=cyclic))
    return Stations(_places(tables, shares), shares, cell_shares)


def align_between(
    outlines: Sequence[Outline], creases: FloatArray, spans: int, a_span: int, *, cyclic: bool
) -> Stations:
    """Lay stations between edges of the part, a whole number of spans on every face.

    Parameters
    ----------
    creases
        (k, c), shares of the outlines' lengths at which edges cross them.
    spans, a_span
        About how many spans there are around, and how many stations each of them has.
    """
    known = tabled(outlines)
    tables, cell_shares = known.places_mm, known.cell_shares
    faces = np.diff(creases, axis=1, append=creases[:, :1] + 1.0)
    counts = np.maximum(np.rint(spans * faces.mean(axis=0)).astype(np.int64), _LEAST_SPANS)
    # The seam lies in the middle of the widest face: no edge is cut in two.
    widest = int(np.argmax(counts))
    order = np.roll(np.arange(len(counts)), -widest - 1)
    ahead = int(counts[widest]) // 2
    starts = creases[:, order] + (order <= widest)
    knots = np.concatenate([[0], counts[order].cumsum()]) + int(counts[widest]) - ahead
    shares = np.concatenate(
        [_even(starts[:, f], faces[:, order[f]], int(counts[order[f]]) * a_span)
         for f in range(len(order))], axis=1,
    )  # fmt: skip
    pinned = (knots[:-1] - knots[0]) * a_span
    shares = _slide(tables, shares, pinned, _SWEEPS, cyclic=cyclic)
    borders = [*pinned.tolist(), shares.shape[1]]
    shares = np.concatenate(
        [_calmed_face(shares[:, start:end], starts[:, f], faces[:, order[f]])
         for f, (start, end) in enumerate(pairwise(borders))], axis=1,
    )  # fmt: skip
    # From the first edge on to the seam: the last stations come first, a turn before.
    turned = int(knots[0]) * a_span
    shares = np.concatenate([shares[:, -turned:] - 1.0, shares[:, :-turned]], axis=1)
    columns = tuple((knots[:-1] * a_span).tolist())
    return Stations(_places(tables, shares), shares, cell_shares, columns, int(counts.sum()))


def _even(starts: FloatArray, faces: FloatArray, count: int) -> FloatArray:
    """Shares (k, count) from the start of a face, evenly."""
    return starts[:, None] + faces[:, None] * (np.arange(count) / count)


def tabled(outlines: Sequence[Outline]) -> Tables:
    """Places evenly along each outline, and where on it its cells belong."""
    tables, cells = np.empty((len(outlines), _TABLE, 3)), []
    at = np.arange(_TABLE) / _TABLE
    for k, outline in enumerate(outlines):
        walk = _walk(outline)
        cells.append(walk.shares_of(outline.u))
        way = slice(None, None, -1) if walk.clockwise else slice(None)
        along = 1.0 - walk.along[way] if walk.clockwise else walk.along
        even = np.stack([np.interp(at, along, x) for x in walk.planar_mm[way].T], axis=1)
        tables[k] = outline.frame.to_part(even)
    return Tables(tables, tuple(cells))


def shares_along(outline: Outline, u: FloatArray) -> FloatArray:
    """Shares of an outline's length, counter-clockwise, at parameters of its curve."""
    if not len(u):  # most outlines have no corners
        return np.empty(0)
    return _walk(outline).shares_of(u)


@dataclass(frozen=True, slots=True, eq=False)
class _Walk:
    """Once along an outline as its parameter runs."""

    u: FloatArray  # (fine + 1,)
    planar_mm: FloatArray  # (fine + 1, 2)
    along: FloatArray  # (fine + 1,), shares of its length
    clockwise: bool

    def shares_of(self, u: FloatArray) -> FloatArray:
        shares = np.interp(u, self.u, self.along)
        return 1.0 - shares if self.clockwise else shares


def _walk(outline: Outline) -> _Walk:
    start, end = outline.fitted.domain
    u = np.linspace(start, end, _FINE + 1)
    planar = outline.fitted(u)
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(planar, axis=0), axis=1).cumsum()])
    along /= max(float(along[-1]), 1e-300)
    return _Walk(u, planar, along, _area(planar) < 0.0)


def _area(planar: FloatArray) -> float:
    x, y = (planar - planar[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _seams(planar: FloatArray, doubts_mm2: FloatArray) -> FloatArray:
    """Where each outline (k, table, 2) begins, as a share of its length.

    Nearness holds the seam where nothing stands out; the distance from the middle, which turns with
    the part, lets it follow lobes and corners that twist, as far as it is more than the outlines'
    own uncertainty (k,).
    """
    rings = planar[..., 0] + 1j * planar[..., 1]
    arms = rings - rings.mean(axis=1, keepdims=True)
    spectra, shapes = np.fft.fft(arms, axis=1), np.fft.fft(np.abs(arms), axis=1)
    starts = np.zeros(len(rings))
    told = np.clip(1.0 - _CERTAIN * doubts_mm2 / np.maximum(np.abs(arms).var(axis=1), 1e-300), 0, 1)
    for k in range(1, len(rings)):
        overlap = np.fft.ifft(spectra[k] * np.conj(spectra[k - 1])).real
        shape = _SHAPE * min(told[k], told[k - 1])
        overlap += shape * np.fft.ifft(shapes[k] * np.conj(shapes[k - 1])).real
        starts[k] = (starts[k - 1] + int(np.argmax(overlap)) / _TABLE) % 1.0
    # The same turn, without jumps of whole turns.
    return np.asarray(np.unwrap(starts, period=1.0))


def _calmed(shares: FloatArray) -> FloatArray:
    """Shares (k, m) whose spacing varies slowly around: what the outlines' noise added is left out.

    Uneven spacing would look to the fit like a bend.
    """
    count = shares.shape[1]
    even = np.arange(count) / count
    waves = np.fft.rfft(shares - even, axis=1)
    waves[:, max(count // _SLOW, 3) :] = 0.0
    away = np.fft.irfft(waves, count, axis=1)
    # Not so far that stations would change places.
    narrow = -np.diff(away, axis=1, append=away[:, :1]).min(axis=1, keepdims=True)
    most = (1.0 - _DENSER) / count
    return np.asarray(even + away * np.minimum(1.0, most / np.maximum(narrow, 1e-300)))


def _calmed_face(shares: FloatArray, starts: FloatArray, faces: FloatArray) -> FloatArray:
    """The same between two edges, (k, n) stations from the first edge on."""
    count = shares.shape[1]
    even = _even(starts, faces, count)
    waves = dst((shares - even)[:, 1:], type=1, axis=1)
    waves[:, max(count // _SLOW, 1) :] = 0.0
    away = np.concatenate([np.zeros((len(shares), 1)), idst(waves, type=1, axis=1)], axis=1)
    narrow = -np.diff(away, axis=1, append=0.0).min(axis=1, keepdims=True)
    most = (1.0 - _DENSER) * faces[:, None] / count
    return np.asarray(even + away * np.minimum(1.0, most / np.maximum(narrow, 1e-300)))


def _places(tables: FloatArray, shares: FloatArray) -> FloatArray:
    out = np.empty((*shares.shape, 3))
    for k in range(len(tables)):
        _look_up(tables[k], shares[k], out[k])
    return out


@njit(cache=True, nogil=True)
def _look_up(table: FloatArray, shares: FloatArray, out: FloatArray) -> None:
    """Places at shares of a closed table."""
    size = len(table)
    for m in range(len(shares)):
        at = shares[m] * size
        low = int(np.floor(at))
        part = at - low
        for d in range(3):
            out[m, d] = (1.0 - part) * table[low % size, d] + part * table[(low + 1) % size, d]


@njit(cache=True, nogil=True, error_model="numpy")
def _slide(
    tables: FloatArray, shares: FloatArray, pinned: IntArray, sweeps: int, *, cyclic: bool
) -> FloatArray:
    """Slide stations along their outlines towards their four neighbours, evenly weighed.

    `pinned` columns stay. The pull of the neighbours above and below counts in full, that of the
    ones beside by `_EVEN`.
    """
    rows, count = shares.shape
    lengths = _lengths(tables)
    places, tangents = np.empty((rows, 3, count)), np.empty((rows, 3, count))
    for k in range(rows):
        _look_around(tables[k], shares[k], lengths[k], places[k], tangents[k])
    least, most = _DENSER / count, 0.3 / count
    fresh, pulls = np.empty((rows, count)), np.empty(count)
    for _ in range(sweeps):
        for k in range(rows):
            above = k + 1 if k + 1 < rows else (0 if cyclic else -1)
            below = k - 1 if k > 0 else (rows - 1 if cyclic else -1)
            neighbours = (above >= 0) + (below >= 0)
            pulls[:] = 0.0
            for other in (above, below):
                if other >= 0:
                    for d in range(3):
                        for m in range(count):
                            away = places[other, d, m] - places[k, d, m]
                            pulls[m] += tangents[k, d, m] * away
            own = shares[k]
            for m in range(count):
                before = own[m - 1] if m > 0 else own[count - 1] - 1.0
                after = own[m + 1] if m + 1 < count else own[0] + 1.0
                even = 0.5 * (before + after) - own[m]
                pull = pulls[m] / max(neighbours, 1)
                move = _HASTE * (pull + _EVEN * even) / (1.0 + _EVEN)
                fresh[k, m] = own[m] + min(max(move, -most), most)
        for k in range(rows):
            _spread(fresh[k], least)
            for column in pinned:
                fresh[k, column] = shares[k, column]
            shares[k] = fresh[k]
            _look_around(tables[k], shares[k], lengths[k], places[k], tangents[k])
    return shares


@njit(cache=True, nogil=True)
def _lengths(tables: FloatArray) -> FloatArray:
    """Length of each closed table, (k,), never quite nothing."""
    lengths = np.empty(len(tables))
    for k in range(len(tables)):
        total = 0.0
        for p in range(tables.shape[1]):
            after = tables[k, p + 1 if p + 1 < tables.shape[1] else 0]
            square = 0.0
            for d in range(3):
                square += (after[d] - tables[k, p, d]) ** 2
            total += np.sqrt(square)
        lengths[k] = max(total, 1e-300)
    return lengths


@njit(cache=True, nogil=True, error_model="numpy")
def _look_around(
    table: FloatArray, shares: FloatArray, length: float, places: FloatArray, tangents: FloatArray
) -> None:
    """Places at shares of a closed table, and unit tangents there over its length; (3, m) each."""
    size = len(table)
    for m in range(len(shares)):
        at = shares[m] * size
        low = int(np.floor(at))
        part = at - low
        if low < 0 or low >= size:  # seldom, and a remainder takes long
            low %= size
        high = low + 1 if low + 1 < size else 0
        x, y, z = table[low, 0], table[low, 1], table[low, 2]
        dx, dy, dz = table[high, 0] - x, table[high, 1] - y, table[high, 2] - z
        places[0, m], places[1, m], places[2, m] = x + part * dx, y + part * dy, z + part * dz
        scale = 1.0 / (max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-300) * length)
        tangents[0, m], tangents[1, m], tangents[2, m] = scale * dx, scale * dy, scale * dz


@njit(cache=True, nogil=True)
def _spread(shares: FloatArray, least: float) -> None:
    """Keep stations in order and apart."""
    count = len(shares)
    for m in range(1, count):
        shares[m] = max(shares[m], shares[m - 1] + least)
    over = shares[count - 1] - (shares[0] + 1.0 - least)
    if over > 0.0:
        for m in range(count - 1, -1, -1):
            most = shares[0] + 1.0 - least * (count - m)
            shares[m] = min(shares[m], most) if m > 0 else shares[m]
