"""What each place sees around it: which way the band leads, how thick it is, what is no band.

Along the band a place may look farther than across it: far enough to bridge the holes that chance
leaves in a sparse band, without seeing the next band beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.fitting.frames import frames
from reconstruction.fitting.nearness import medians_of
from reconstruction.fitting.places import Places, middling

_HOODS = np.array([6, 9, 13, 19, 27])  # neighbours that may tell a direction
_SLENDER = 1.5  # slenderness up to which a place sees no farther along than across ...
_AHEAD = 3.0  # ... and how many times farther at most
_ALIKE = 9  # places that share what they scatter
_BAND = 1.7  # slenderness from which they lie in a band
_PATCHED = 0.4  # share of the points in patches from which they are a band wider than can be seen
_LEAST = 40  # places of a patch
_SPARSE = 3.0  # times the usual spacing: farther apart, places are no patch
_AWAY = 2.5  # times the median distance from its middle: in a full patch nothing is farther
_FEW = 10  # places; fewer beside it tell nothing
_WIDE = 3.0  # times as far as bands, patches scatter across, ...
_WIDER = 2.2  # ... times as far as what lies beside them, ...
_COMPACT = 3.0  # ... not so many times as far along, ...
_FULL = 0.8  # ... and hold so many of the places in their middle for which there is room
_BESIDE = (2.0, 5.0)  # times its deviation along, from the middle: what lies beside a patch


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What each of m places sees."""

    frames: FloatArray  # (m, 3), a direction, and how many times as far it sees along it
    slenderness: FloatArray  # (m,), deviation of the nearest few along over that across
    scatter: FloatArray  # (m,), deviation across; infinite where there is no direction
    in_patch: BoolArray  # (m,), of a patch: much wider than the band and hardly longer
    width: float  # of the band, where it is a few places wide; of a wider one too small


def look_around(places: Places) -> Sight:
    """Look at the nearest few of each place."""
    neighbours = places.neighbours
    found = frames(places.at, neighbours, _HOODS)
    width = math.sqrt(12.0) * middling(found[:, 2], places.counts)
    across, slender, wider = medians_of(found[:, 2:].copy(), neighbours[:, :_ALIKE]).T
    ahead = np.clip(found[:, 3] / _SLENDER, 1.0, _AHEAD)
    scatter = np.where(slender > _BAND, across, np.inf)
    return Sight(
        np.column_stack([found[:, :2], ahead]),
        found[:, 3],
        scatter,
        _in_patches(places, scatter, wider < _BAND),
        width,
    )


def _in_patches(places: Places, scatter: FloatArray, blind: BoolArray) -> BoolArray:
    """Which of the places that see no band are of patches, where most are of bands."""
    found = np.zeros(len(blind), np.bool_)
    known = np.isfinite(scatter) & ~blind
    # Strays see no band either, and would tie everything near them to one wide patch.
    blind = blind & (places.spacing <= _SPARSE * middling(places.spacing, places.counts))
    if (
        not blind.any()
        or not known.any()
        or places.counts[blind].sum() > _PATCHED * places.counts.sum()
    ):
        return found
    wide = _WIDE * middling(scatter[known], places.counts[known])
    near = places.neighbours[:, :_ALIKE]
    own, other = np.repeat(np.arange(len(blind)), near.shape[1]), near.ravel()
    kept = blind[own] & blind[other]
    graph = coo_array((np.ones(kept.sum()), (own[kept], other[kept])), (len(blind),) * 2)
    label = connected_components(graph, directed=False)[1]
    counts = np.bincount(label[blind])
    for number in np.flatnonzero(counts >= _LEAST):
        mine = label == number
        if _is_patch(places, mine, wide):
            found |= mine
    return found


def _is_patch(places: Places, mine: BoolArray, wide: float) -> bool:
    """Whether places are wider than the band, full, hardly longer, and not of a wider band."""
    held = places.at[mine]
    away = np.linalg.norm(held - np.median(held, axis=0), axis=1)
    held = held[away <= _AWAY * np.median(away)]
    middle = held.mean(axis=0)
    shorter, longer = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(held.T)), 0.0))
    if shorter < wide or longer > _COMPACT * shorter:
        return False
    apart = np.linalg.norm(places.at - middle, axis=1)
    # Within a spacing there is room for the four neighbours that it is the distance of.
    room = 4.0 * (shorter / max(float(np.median(places.spacing[mine])), 1e-300)) ** 2
    if (apart < shorter).sum() < _FULL * room:
        return False
    beside = (apart > _BESIDE[0] * longer) & (apart < _BESIDE[1] * longer) & ~mine
    return bool(_scatter_of(places.at[beside]) < shorter / _WIDER)


def _scatter_of(at: FloatArray) -> float:
    """Median deviation across of places alone; 0 of a few."""
    if len(at) < _FEW:
        return 0.0
    near = np.asarray(cKDTree(at).query(at, k=min(int(_HOODS[-1]), len(at)))[1])
    return float(np.median(frames(at, near, _HOODS)[:, 2]))
