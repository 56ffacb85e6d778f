r"""Which motions of one view on the other the shape does not hold.

A turning part resists no turn about its axis, but for the noise of its normals: a stiffness of

    E = sum w (v . N v)        v: the motion at a site, N: the covariance of its unit normal

comes from noise alone. A motion whose stiffness is no more than some times that is free, and so is
one that is very much softer than the stiffest (compare `reconstruction.comparison.alignment`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.registration.settling import Settled

_TIMES_NOISE = 6.0
_LOOSE = 1e-4  # of the stiffest
_TURN_SHARE = 0.3  # of a motion that is no mere shift


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """A motion, in the fixed view's frame: a turn about an axis, perhaps a screw, or a shift."""

    direction: FloatArray  # (3,), unit, along the axis or the shift
    place_mm: FloatArray | None  # (3,) on the axis; None: a shift
    sd_mm: float  # of the motion where the part is

    def __str__(self) -> str:
        along = _numbers(self.direction, 2)
        if self.place_mm is None:
            return f"the shift along {along}"
        return f"the turn about the axis through {_numbers(self.place_mm, 1)} mm along {along}"


def freedoms(settled: Settled) -> tuple[Freedom, ...]:
    """The motions that are free, softest first; none where all six are held."""
    stiffness, ways = np.linalg.eigh(settled.stiffness)
    found = []
    for value, way in zip(stiffness, ways.T, strict=True):
        noise = _of_noise(settled, way)
        if value < max(_TIMES_NOISE * noise, _LOOSE * float(stiffness[-1])):
            found.append(_described(settled, way, float(value)))
    return tuple(found)


def _of_noise(settled: Settled, way: FloatArray) -> float:
    arms = settled.sites.sites_mm - settled.middle_mm
    motions = np.cross(way[:3], arms) / settled.size_mm + way[3:]
    noise = np.einsum("ki,kij,kj->k", motions, settled.normal_noise, motions)
    return float((settled.weights * noise).sum())


def _described(settled: Settled, way: FloatArray, stiffness: float) -> Freedom:
    sd_mm = 1.0 / math.sqrt(max(stiffness, 1e-18))
    turn, shift = way[:3] / settled.size_mm, way[3:]
    rate = float(np.linalg.norm(way[:3]))
    if rate < _TURN_SHARE:
        return Freedom(shift / np.linalg.norm(shift), None, sd_mm)
    along = turn / np.linalg.norm(turn)
    place = settled.middle_mm + np.cross(turn, shift) / float(turn @ turn)
    return Freedom(along if along[int(np.abs(along).argmax())] > 0.0 else -along, place, sd_mm)


def _numbers(values: FloatArray, digits: int) -> str:
    return f"({', '.join(f'{each + 0.0:.{digits}f}' for each in np.round(values, digits))})"
