r"""Handles that a field hardly has: a web across a slot is cut, or the hole beside it closed.

Where two walls come near each other, noise decides whether there is a web between them or a hole.
The inside, grown from its deepest place in order of the field so that it never closes a ring,
leaves out a sheet across the weakest place of every handle; the outside, grown from the border,
leaves out a membrane across every tunnel. The field there says what it takes to cut or to close::

    |####|  o  |####|      the tunnel: closed, or
    |####|#####|####|      the web: cut; what takes less
    |####|     |####|

A voxel joins only where it changes no ring, part or cavity: a simple point (Bertrand, Malandain
1994, doi:10.1016/0167-8655(94)90046-9), of 26 neighbours for the inside and 6 for the outside.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, label

from reconstruction.arrays import BoolArray, FloatArray, IntArray

_LEVELS = 256
_BOX = np.ones((3, 3, 3), np.int8)
_MOST = 24  # weak places: more are no slip, and each asks how all hangs together
_AROUND = 3  # voxels beyond a change
_AWAY, _FREE, _TAKEN = 0, 1, 2


def _bits(reach: int) -> IntArray:
    """For each of 27 places, those within so many steps of it along axes, as bits."""
    spots = np.stack(np.unravel_index(np.arange(27), (3, 3, 3)), axis=1)
    apart = np.abs(spots[:, None] - spots[None])
    near = (apart.max(axis=2) == 1) & (apart.sum(axis=2) <= reach)
    return np.asarray(near @ (1 << np.arange(27, dtype=np.int64)), np.int64)


_BY_CORNERS, _BY_FACES = _bits(3), _bits(1)
_MIDDLE = 13
_ALL, _NEAREST, _SIDES = (int(_bits(reach)[_MIDDLE]) for reach in (3, 2, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Leftover:
    """A sheet across a handle, or a membrane across a tunnel."""

    strength: float  # of the field at its strongest place: what its change takes
    inside: bool  # a sheet, to be cut
    places: IntArray  # (n, 3)


def without_weak_handles(values: FloatArray, weak: float) -> FloatArray:
    """The field (i, j, k), positive inside, with every weak handle cut or its tunnel closed.

    Parameters
    ----------
    weak
        In the field's unit. What is stronger on both of its sides stays. Where a great many are
        weak, all stay: it is not by a few handles that such a field is wrong.
    """
    values = values.copy()
    found = [*leftovers(values, inside=True), *leftovers(values, inside=False)]
    found = sorted((one for one in found if one.strength < weak), key=lambda one: one.strength)
    if len(found) <= _MOST:
        for each in found:
            _undo(values, each, weak)
    return values


def leftovers(values: FloatArray, *, inside: bool) -> Iterator[Leftover]:
    """What an inside, or outside, that closes no ring cannot reach."""
    own = values if inside else -values
    state = np.where(own > 0.0, _FREE, _AWAY).astype(np.int8)
    if inside:
        state[np.unravel_index(int(np.argmax(own)), own.shape)] = _TAKEN
    else:
        rim = np.ones(state.shape, np.bool_)
        rim[1:-1, 1:-1, 1:-1] = False
        state[rim] = _TAKEN  # the field's margin is outside
    levels = np.clip((1.0 - own / own.max()) * (_LEVELS - 1.0), 0.0, _LEVELS - 1.0)
    _grow(state, levels.astype(np.uint8), inside)
    labels, _ = label(state == _FREE, structure=_BOX)
    touched = binary_dilation(state == _TAKEN, _BOX if inside else None)
    for number, box in enumerate(find_objects(labels), 1):
        if not (touched[box] & (labels[box] == number)).any():
            continue  # a part of its own, or a cavity
        places = np.argwhere(labels[box] == number) + [side.start for side in box]
        yield Leftover(float(own[tuple(places.T)].max()), inside, places)


def _undo(values: FloatArray, found: Leftover, strength: float) -> None:
    """Turn a leftover to the other side, if a ring less is what comes of it.

    What is next to it goes as well: a mesh whose edges are longer than a voxel has to see it.
    """
    low = np.maximum(found.places.min(axis=0) - _AROUND, 0)
    high = found.places.max(axis=0) + _AROUND + 1
    here = values[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    own = here > 0.0 if found.inside else here <= 0.0
    changed = np.zeros(here.shape, np.bool_)
    changed[tuple((found.places - low).T)] = True
    changed = binary_dilation(changed, _BOX) & own
    after = np.where(changed, -strength if found.inside else strength, here)
    if euler_number(after > 0.0) <= euler_number(here > 0.0):
        return
    before, pieces = here.copy(), _pieces(values)
    here[:] = after
    if _pieces(values) != pieces:
        here[:] = before


def _pieces(values: FloatArray) -> tuple[int, int]:
    """Parts of the inside and of the outside."""
    return int(label(values > 0.0, structure=_BOX)[1]), int(label(values <= 0.0)[1])


def euler_number(inside: BoolArray) -> int:
    """Of the union of closed cubes (i, j, k): parts and cavities less rings."""
    cubes = np.pad(inside, 1)
    total = 0
    for axes in itertools.chain.from_iterable(
        itertools.combinations(range(3), n) for n in range(4)
    ):
        cells = cubes
        for axis in axes:  # a face, edge or corner is there where a cube at it is
            lower = np.take(cells, range(cells.shape[axis] - 1), axis)
            cells = lower | np.take(cells, range(1, cells.shape[axis]), axis)
        total += (-1) ** (3 - len(axes)) * int(np.count_nonzero(cells))
    return total


@njit(cache=True)
def _grow(state: NDArray[np.int8], levels: NDArray[np.uint8], inside: bool) -> None:  # noqa: FBT001
    """Let what is taken grow over what is free, low levels first, by simple points alone."""
    size_i, size_j, size_k = state.shape
    flat, level_of = state.ravel(), levels.ravel()
    following, waiting = np.full(len(flat), -1, np.int64), np.zeros(len(flat), np.bool_)
    first, last = np.full(_LEVELS, -1, np.int64), np.full(_LEVELS, -1, np.int64)
    near = np.empty(27, np.int64)
    for place in range(len(flat)):
        if flat[place] == _TAKEN:
            _neighbours(place, size_i, size_j, size_k, near)
            _await(near, flat, level_of, waiting, first, last, following)
    level = 0
    while level < _LEVELS:
        place = first[level]
        if place < 0:
            level += 1
            continue
        first[level], waiting[place] = following[place], False
        _neighbours(place, size_i, size_j, size_k, near)
        around = 0
        for n in range(27):
            taken = near[n] >= 0 and flat[near[n]] == _TAKEN
            around |= int(taken == inside) << n
        if _is_simple(around):
            flat[place] = _TAKEN
            level = min(level, _await(near, flat, level_of, waiting, first, last, following))


@njit(cache=True)
def _neighbours(place: int, size_i: int, size_j: int, size_k: int, near: IntArray) -> None:
    """Fill (27,) with a place and those around it; -1 outside of the grid."""
    i, rest = divmod(place, size_j * size_k)
    j, k = divmod(rest, size_k)
    for n in range(27):
        a, b, c = i + n // 9 - 1, j + n // 3 % 3 - 1, k + n % 3 - 1
        within = 0 <= a < size_i and 0 <= b < size_j and 0 <= c < size_k
        near[n] = (a * size_j + b) * size_k + c if within else -1


@njit(cache=True)
def _await(
    near: IntArray,
    flat: NDArray[np.int8],
    level_of: NDArray[np.uint8],
    waiting: BoolArray,
    first: IntArray,
    last: IntArray,
    following: IntArray,
) -> int:
    """Queue the free ones of these places by level; the lowest level among them."""
    lowest = _LEVELS
    for place in near:
        if place < 0 or flat[place] != _FREE or waiting[place]:
            continue
        level = int(level_of[place])
        waiting[place], following[place] = True, -1
        if first[level] < 0:
            first[level] = place
        else:
            following[last[level]] = place
        last[level] = place
        lowest = min(lowest, level)
    return lowest


@njit(cache=True)
def _is_simple(around: int) -> bool:
    """Whether the middle may join or leave what is around it (27 bits), and no ring changes.

    One part of it among all 26, and one part of the rest, by faces, among the 18 nearest.
    """
    taken, free = around & _ALL, ~around & _NEAREST
    return _is_one(taken, taken, _BY_CORNERS) and _is_one(free, free & _SIDES, _BY_FACES)


@njit(cache=True)
def _is_one(places: int, wanted: int, neighbours: IntArray) -> bool:
    """Whether from one wanted place all others are reached; False if there is none."""
    reached = wanted & -wanted
    fresh = reached
    while fresh:
        beside = 0
        for n in range(27):
            if fresh >> n & 1:
                beside |= neighbours[n]
        fresh = beside & places & ~reached
        reached |= fresh
    return wanted != 0 and wanted & ~reached == 0
