"""Outlines of a branch laid side by side: direction, seam and numbering against their neighbours.

Every outline runs counter-clockwise as seen against the stacking axis. Its seam is turned to where
the outline lies nearest to the one before (the peak of their cross-correlation); then all stations
slide along their outlines until each lies abreast of its neighbours above and below, and evenly
between those beside it. A station that slides stays on its outline: nothing is smoothed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, frozen
from reconstruction.skinning.outlines import Outline

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

    def __post_init__(self) -> None:
        object.__setattr__(self, "places_mm", frozen(self.places_mm))
        object.__setattr__(self, "shares", frozen(self.shares))

    def columns_of_cells(self) -> list[FloatArray]:
        """The column of every cell, a real number in [0, m), outline by outline."""
        count = self.shares.shape[1]
        found = []
        for shares, cells in zip(self.shares, self.cell_shares, strict=True):
            around = np.append(shares, shares[0] + 1.0)
            lifted = shares[0] + np.mod(cells - shares[0], 1.0)
            found.append(np.mod(np.interp(lifted, around, np.arange(count + 1.0)), count))
        return found


def align(outlines: Sequence[Outline], count: int, *, cyclic: bool = False) -> Stations:
    """Lay `count` stations on every closed outline.

    Parameters
    ----------
    cyclic
        The last outline is followed by the first.
    """
    tables = np.empty((len(outlines), _TABLE, 3))
    cell_shares = []
    for k, outline in enumerate(outlines):
        tables[k], shares = _evenly(outline)
        cell_shares.append(shares)
    axes = outlines[0].frame.axes[:2]
    doubts = np.array([float((each.fitted.deviations_mm**2).mean()) for each in outlines])
    starts = _seams(tables @ axes.T, doubts)
    shares = starts[:, None] + np.arange(count) / count
    shares = _calmed(_slide(tables, shares, _SWEEPS, cyclic=cyclic))
    return Stations(_places(tables, shares), shares, tuple(cell_shares))


def _evenly(outline: Outline) -> tuple[FloatArray, FloatArray]:
    """Places evenly along the outline, counter-clockwise, (table, 3); the cells' shares of it."""
    start, end = outline.fitted.domain
    u = np.linspace(start, end, _FINE + 1)
    planar = outline.fitted(u)
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(planar, axis=0), axis=1).cumsum()])
    along /= max(float(along[-1]), 1e-300)
    cells = np.interp(outline.u, u, along)
    if _area(planar) < 0.0:
        planar, along, cells = planar[::-1], 1.0 - along[::-1], 1.0 - cells
    at = np.arange(_TABLE) / _TABLE
    even = np.stack([np.interp(at, along, column) for column in planar.T], axis=1)
    return outline.frame.to_part(even), cells


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
def _slide(tables: FloatArray, shares: FloatArray, sweeps: int, *, cyclic: bool) -> FloatArray:
    """Slide stations along their outlines towards their four neighbours, evenly weighed.

    The pull of the neighbours above and below counts in full, that of the ones beside by `_EVEN`.
    """
    rows, count = shares.shape
    size = tables.shape[1]
    lengths = np.empty(rows)
    for k in range(rows):
        total = 0.0
        for p in range(size):
            square = 0.0
            for d in range(3):
                step = tables[k, (p + 1) % size, d] - tables[k, p, d]
                square += step * step
            total += np.sqrt(square)
        lengths[k] = max(total, 1e-300)
    places = np.empty((rows, count, 3))
    for k in range(rows):
        _look_up(tables[k], shares[k], places[k])
    least = _DENSER / count
    for _ in range(sweeps):
        fresh = shares.copy()
        for k in range(rows):
            above = k + 1 if k + 1 < rows else (0 if cyclic else -1)
            below = k - 1 if k > 0 else (rows - 1 if cyclic else -1)
            neighbours = (above >= 0) + (below >= 0)
            for m in range(count):
                low = int(np.floor(shares[k, m] * size))
                pull = tangent = 0.0
                for d in range(3):
                    step = tables[k, (low + 1) % size, d] - tables[k, low % size, d]
                    mean = 0.0
                    if above >= 0:
                        mean += places[above, m, d] - places[k, m, d]
                    if below >= 0:
                        mean += places[below, m, d] - places[k, m, d]
                    pull += step * mean
                    tangent += step * step
                # As a share of the length: along the tangent, over the length.
                pull /= max(np.sqrt(tangent), 1e-300) * lengths[k] * max(neighbours, 1)
                before = shares[k, m - 1] if m > 0 else shares[k, count - 1] - 1.0
                after = shares[k, m + 1] if m + 1 < count else shares[k, 0] + 1.0
                even = 0.5 * (before + after) - shares[k, m]
                move = _HASTE * (pull + _EVEN * even) / (1.0 + _EVEN)
                fresh[k, m] += min(max(move, -0.3 / count), 0.3 / count)
        for k in range(rows):
            _spread(fresh[k], least)
            shares[k] = fresh[k]
            _look_up(tables[k], shares[k], places[k])
    return shares


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
