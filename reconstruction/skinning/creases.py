"""Creases of a branch: corners of its outlines that follow each other from slice to slice.

A corner that one slice alone shows is noise; one that most of them show, in the same place among
the stations, is an edge of the part, and passes through the slices that do not show it. What only
some of them show, as where an edge is blunt beside its noise, the surface itself must prefer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.aligning import Stations, shares_along
from reconstruction.skinning.outlines import Outline

_NEAR = 1.0 / 24.0  # of the stations, that a corner may lie off the one in the slice before
_APART = 0.45  # of the way to the nearest other corner, likewise
_FORGOTTEN = 8  # outlines without it
_SURE = 0.6  # of the outlines show an edge that is certain ...
_LIKELY = 0.15  # ... and one that is worth a trial
_FEWEST = 3  # outlines
_LEAST_FACE = 1.0 / 40.0  # of the stations, between two edges


@dataclass(slots=True)
class _Thread:
    """A corner followed through the outlines."""

    at: list[int] = field(default_factory=list)  # outlines
    columns: list[float] = field(default_factory=list)  # where among the stations


def find_creases(outlines: Sequence[Outline], stations: Stations) -> tuple[FloatArray, FloatArray]:
    """Where the edges of a branch cross its outlines: shares of their lengths (k, c).

    Shares grow from edge to edge, and may lie beyond 1. Without an edge, c is 0.

    Returns
    -------
    sure, likely
        Edges that most outlines show; and these with those that some do.
    """
    threads = _threads(outlines, stations)
    count = len(outlines)
    sure, likely = (
        [each for each in threads if len(each.at) >= max(share * count, _FEWEST)]
        for share in (_SURE, _LIKELY)
    )
    return _crossings(sure, stations, count), _crossings(likely, stations, count)


def _threads(outlines: Sequence[Outline], stations: Stations) -> list[_Thread]:
    """Every corner with those that it goes on in."""
    count = stations.shares.shape[1]
    threads: list[_Thread] = []
    for k, outline in enumerate(outlines):
        corners = shares_along(outline, np.array(outline.fitted.creases))
        columns = stations.columns_of(k, corners)
        _follow(threads, k, np.sort(columns), count)
    return threads


def _crossings(edges: list[_Thread], stations: Stations, outlines: int) -> FloatArray:
    """Shares (k, c) at which followed corners cross every outline, in order around."""
    count = stations.shares.shape[1]
    found = np.empty((outlines, len(edges)))
    for number, each in enumerate(edges):
        turns = np.unwrap(each.columns, period=count)
        found[:, number] = np.interp(np.arange(outlines), each.at, turns)
    found = found[:, np.argsort(found.mean(axis=0) % count)] if len(edges) else found
    found -= count * np.floor(found.mean(axis=0) / count)
    found = _apart(found, count)
    return np.stack([stations.shares_at(k, row) for k, row in enumerate(found)])


def _follow(threads: list[_Thread], k: int, columns: FloatArray, count: int) -> None:
    """Add the corners of outline k to the threads that they go on, each the nearest other."""
    alive = [each for each in threads if k - each.at[-1] <= _FORGOTTEN]
    ends = np.array([each.columns[-1] for each in alive])
    away = np.abs((columns[:, None] - ends[None, :] + 0.5 * count) % count - 0.5 * count)
    for corner, column in enumerate(columns):
        others = np.delete(columns, corner)
        gaps = np.abs((others - column + 0.5 * count) % count - 0.5 * count)
        reach = min(_NEAR * count, _APART * float(gaps.min(initial=np.inf)))
        mate = int(np.argmin(away[corner])) if len(alive) else -1
        if mate >= 0 and away[corner, mate] <= reach and np.argmin(away[:, mate]) == corner:
            alive[mate].at.append(k)
            alive[mate].columns.append(float(column))
        else:
            threads.append(_Thread([k], [float(column)]))


def _apart(columns: FloatArray, count: int) -> FloatArray:
    """Leave out edges (k, c) that come too near to the one before, or cross it."""
    kept: list[int] = []
    for edge in range(columns.shape[1]):
        before = columns[:, kept[-1]] if kept else columns[:, edge] - count
        beyond = columns[:, kept[0]] + count if kept else columns[:, edge] + count
        least = _LEAST_FACE * count
        if (columns[:, edge] - before).min() > least and (beyond - columns[:, edge]).min() > least:
            kept.append(edge)
    return columns[:, kept]
