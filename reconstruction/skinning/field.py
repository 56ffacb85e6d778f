r"""Inside and outside of a cloud, from all slices at once: a field that is positive inside.

Where slices alone do not tell what is a wall of what (thin parts beside each other, contours seen
from one side, shapes that change from slice to slice), their neighbours do. Outward directions are
guessed from what lies inside of the points (`basins`), or from what can be reached from outside,
and then made to agree with the field that they are the gradient of, from coarse to fine::

    points, directions -> smeared on a grid -> field by a Poisson equation (FFT) -> directions ...

Kazhdan, Bolitho, Hoppe 2006 for the field; Hou et al. 2022 (iterative Poisson reconstruction,
doi:10.1145/3528223.3530096) for the repetition. The grid reaches past the part, so that the
transform's repetition of space does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label, map_coordinates

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.skinning.basins import inside_of

Spectrum = NDArray[np.complex128]

_MARGIN = 0.1  # of the size, around
_FINEST = 180  # cells along the longest side at most
_A_GRAIN = 1.8  # cells
_FLOODED_CELLS = 96
_CLOSED = 2.0  # grains: what is narrower is not reached from outside at first
_SMEARED: tuple[float, ...] = (
    (4.0,) * 3 + (3.0,) * 3 + (2.5,) * 3 + (2.0,) * 3 + (1.6,) * 3 + (1.3,) * 2 + (1.0,) * 4
)
# Where the guess is right nearly everywhere. At a whole grain, slots of two grains close.
_SMEARED_LESS: tuple[float, ...] = (1.3, 1.1, 0.9, 0.7, 0.7, 0.7, 0.7)
_LEAST_SMEARED = 0.8  # cells
_DENSITY = 1.5  # grains in which density is told
_OPEN = 0.9  # of the margin: certainly outside
_EMPTY = 1e-12


class Guess(Enum):
    """How outward directions are first told."""

    BASINS = "basins"  # space divided where it is narrowest: follows slots, bridges holes
    REACHED = "reached"  # what is reached through wide openings: for parts thin everywhere


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Values on a cubic grid, zero on the surface, positive inside."""

    values: FloatArray  # (i, j, k)
    low_mm: FloatArray  # (3,), of the first node
    step_mm: float
    outward: FloatArray  # (n, 3), unit, of the points


def field_of(
    points_mm: FloatArray, counts: FloatArray, grain_mm: float, guess: Guess = Guess.BASINS
) -> Field:
    """The field of points (n, 3), each counted (n,) times.

    Parameters
    ----------
    grain_mm
        What is smaller cannot be told: the distance of slices, or of points on the surface.

    Raises
    ------
    Unfittable
        Nothing lies deep inside of the points, where that is the guess.
    """
    grid = _Grid(points_mm, grain_mm)
    areas = _areas(grid, points_mm, counts, _DENSITY * grain_mm)
    if guess is Guess.BASINS:
        outward = _divided(grid, points_mm, grain_mm)
        widths = _SMEARED_LESS
    else:
        outward, widths = _flooded(points_mm, grain_mm), _SMEARED
    spectrum = np.empty(0, dtype=np.complex128)
    for smeared in widths:
        width = max(smeared * grain_mm, _LEAST_SMEARED * grid.step_mm)
        spectrum = grid.integrated(points_mm, -outward * areas[:, None], width)
        outward = -_unit(grid.gradient_at(spectrum, points_mm))
    values = grid.back(spectrum)
    level = float(np.average(grid.at(values, points_mm), weights=areas))
    return Field(values - level, grid.low_mm, grid.step_mm, outward)


class _Grid:
    """A periodic grid around points, and its waves."""

    def __init__(self, points_mm: FloatArray, grain_mm: float, cells: int = 0) -> None:
        low, high = points_mm.min(axis=0), points_mm.max(axis=0)
        margin = _MARGIN * float(np.linalg.norm(high - low))
        longest = float((high - low).max())
        self.step_mm = longest / cells if cells else max(grain_mm / _A_GRAIN, longest / _FINEST)
        self.low_mm, self.margin_mm = low - margin, margin
        counts = np.ceil((high - low + 2.0 * margin) / self.step_mm).astype(int) + 1
        self.shape = tuple(int(scipy.fft.next_fast_len(int(n), real=True)) for n in counts)
        full = [np.fft.fftfreq(n, self.step_mm) for n in self.shape[:2]]
        waves = [*full, np.fft.rfftfreq(self.shape[2], self.step_mm)]
        self._waves = np.meshgrid(
            *(2.0 * np.pi * each for each in waves), indexing="ij", sparse=True
        )
        self._squares = sum(each**2 for each in self._waves)

    def smearing(self, width_mm: float) -> FloatArray:
        """A Gaussian's transform."""
        return np.asarray(np.exp(-0.5 * width_mm**2 * self._squares))

    def taken(self, points_mm: FloatArray) -> BoolArray:
        """Nodes next to points."""
        taken = np.zeros(self.shape, dtype=np.bool_)
        taken[tuple(np.rint((points_mm - self.low_mm) / self.step_mm).astype(int).T)] = True
        return taken

    def splat(self, points_mm: FloatArray, values: FloatArray) -> FloatArray:
        """Values (n,) a volume, shared among the nodes around each point."""
        out = np.zeros(self.shape)
        _splat((points_mm - self.low_mm) / self.step_mm, values / self.step_mm**3, out)
        return out

    def at(self, values: FloatArray, points_mm: FloatArray) -> FloatArray:
        """Values between nodes, linearly."""
        places = ((points_mm - self.low_mm) / self.step_mm).T
        return np.asarray(map_coordinates(values, places, order=1, mode="nearest"))

    def integrated(self, points_mm: FloatArray, vectors: FloatArray, width_mm: float) -> Spectrum:
        """The spectrum of the field whose gradient is nearest to vectors smeared about points."""
        total = np.zeros(self._squares.shape, dtype=np.complex128)
        for wave, column in zip(self._waves, vectors.T, strict=True):
            total += 1j * wave * scipy.fft.rfftn(self.splat(points_mm, column))
        total *= -self.smearing(width_mm) / np.maximum(self._squares, _EMPTY)
        total[0, 0, 0] = 0.0
        return total

    def back(self, spectrum: Spectrum) -> FloatArray:
        """From waves to nodes."""
        return np.asarray(scipy.fft.irfftn(spectrum, self.shape))

    def gradient_at(self, spectrum: Spectrum, points_mm: FloatArray) -> FloatArray:
        """(n, 3)."""
        sides = [self.at(self.back(1j * wave * spectrum), points_mm) for wave in self._waves]
        return np.stack(sides, axis=1)


def _areas(grid: _Grid, points_mm: FloatArray, counts: FloatArray, width_mm: float) -> FloatArray:
    """The surface that each point stands for, by how dense the points are around it."""
    spectrum = scipy.fft.rfftn(grid.splat(points_mm, counts)) * grid.smearing(width_mm)
    dense = np.maximum(grid.at(grid.back(spectrum), points_mm), _EMPTY)
    # Across a plane, a Gaussian spreads what lies on it over sqrt(2 pi) widths.
    return np.asarray(counts / (dense * np.sqrt(2.0 * np.pi) * width_mm))


def _divided(grid: _Grid, points_mm: FloatArray, grain_mm: float) -> FloatArray:
    """Directions away from what lies inside of the points."""
    inside = inside_of(
        grid.taken(points_mm), grid.step_mm, grain_mm=grain_mm, margin_mm=_OPEN * grid.margin_mm
    )
    spectrum = scipy.fft.rfftn(inside.astype(np.float64)) * grid.smearing(grain_mm)
    return -_unit(grid.gradient_at(spectrum, points_mm))


def _flooded(points_mm: FloatArray, grain_mm: float) -> FloatArray:
    """Directions away from what cannot be reached from outside past the points."""
    grid = _Grid(points_mm, grain_mm, _FLOODED_CELLS)
    free = ~grid.taken(points_mm)
    reach = max(_CLOSED * grain_mm, 1.5 * grid.step_mm)
    regions, _ = label(distance_transform_edt(free) * grid.step_mm > reach)
    inside = distance_transform_edt(regions != regions[0, 0, 0]) * grid.step_mm > reach
    spectrum = scipy.fft.rfftn(inside.astype(np.float64)) * grid.smearing(_DENSITY * grain_mm)
    return -_unit(grid.gradient_at(spectrum, points_mm))


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, _EMPTY))


@njit(cache=True)
def _splat(places: FloatArray, values: FloatArray, out: FloatArray) -> None:
    for n in range(len(places)):
        i, j, k = int(places[n, 0]), int(places[n, 1]), int(places[n, 2])
        a, b, c = places[n, 0] - i, places[n, 1] - j, places[n, 2] - k
        for x in range(2):
            for y in range(2):
                for z in range(2):
                    share = (a if x else 1 - a) * (b if y else 1 - b) * (c if z else 1 - c)
                    out[i + x, j + y, k + z] += share * values[n]
