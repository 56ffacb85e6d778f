"""Chance that depends on nothing but the seed and the profile's key: order and timing play no part.

Philox counts through its stream (Salmon et al. 2011, doi:10.1145/2063384.2063405): slice and
profile sit in the upper words of its counter, so that every profile owns 2**128 draws of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.arrays import SingleArray
from sim.sensor import Flaws, SeedKey

_DOMAIN = 0x6C6F6674  # the key's second word: no other use of the same seed meets these draws
_EMPTY_BUFFER = 4  # Philox makes four words at a time; 4 used means: make the next


class Speckle:
    """Draws for profiles; it holds a generator only to spare making one, and sets it each time."""

    def __init__(self, flaws: Flaws) -> None:
        self._flaws = flaws
        self._bits = np.random.Philox(0)
        self._generator = np.random.Generator(self._bits)
        self._counter = np.zeros(4, np.uint64)
        self._state: Any = {
            "bit_generator": "Philox",
            "state": {
                "counter": self._counter,
                "key": np.array([flaws.seed, _DOMAIN], np.uint64),
            },
            "buffer": np.zeros(4, np.uint64),
            "buffer_pos": _EMPTY_BUFFER,
            "has_uint32": 0,
            "uinteger": 0,
        }

    def draw(self, keys: Sequence[SeedKey], points: int) -> tuple[SingleArray, SingleArray]:
        """Standard normals and uniforms on [0, 1), each (keys, points); (keys, 0) if not needed."""
        flaws = self._flaws
        blurred, strayed = flaws.cloud_width_mm > 0.0, flaws.outlier_rate > 0.0
        drawn = points + flaws.speckle_points - 1 if blurred else 0
        normals = np.empty((len(keys), drawn), np.float32)
        uniforms = np.empty((len(keys), points if strayed else 0), np.float32)
        for row, key in enumerate(keys if blurred or strayed else ()):
            self._turn_to(key)
            self._generator.standard_normal(out=normals[row], dtype=np.float32)
            self._generator.random(out=uniforms[row], dtype=np.float32)
        return _shared(normals, flaws.speckle_points) if blurred else normals, uniforms

    def _turn_to(self, key: SeedKey) -> None:
        self._counter[2], self._counter[3] = key.slice_index, key.profile_index
        self._bits.state = self._state


def _shared(normals: SingleArray, window: int) -> SingleArray:
    """Sum runs of `window` neighbours, still of variance 1: (k, n + window - 1) -> (k, n)."""
    if window == 1:
        return normals
    sums = np.cumsum(normals, axis=1, dtype=np.float64)
    sums[:, window:] -= sums[:, :-window].copy()
    shared: SingleArray = (sums[:, window - 1 :] / math.sqrt(window)).astype(np.float32)
    return shared
