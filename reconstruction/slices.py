"""A slice: the points near one cutting plane, and that plane's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A right-handed frame of a cutting plane: rows x, y, normal.

    ::

              normal (the stacking axis, from slice to slice)
                 |   y
                 |  /
                 | /
        origin   o------ x
    """

    origin_mm: FloatArray  # (3,)
    axes: FloatArray  # (3, 3), orthonormal rows x, y, normal

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_mm", frozen(self.origin_mm))
        object.__setattr__(self, "axes", frozen(self.axes))

    def to_plane(self, points_mm: FloatArray) -> FloatArray:
        """Part coordinates (n, 3) to (x, y, height over the plane) in mm, (n, 3)."""
        return np.asarray((points_mm - self.origin_mm) @ self.axes.T)

    def to_part(self, planar_mm: FloatArray) -> FloatArray:
        """(n, 2) or (n, 3) coordinates of this frame to part coordinates, (n, 3)."""
        return np.asarray(self.origin_mm + planar_mm @ self.axes[: planar_mm.shape[1]])


@dataclass(frozen=True, slots=True, eq=False)
class Slice:
    """Measured points near one cutting plane, in the part frame; unordered, unreduced.

    Whoever makes the points can note between which corners they lie while they pass by anyway:
    then nobody has to read them again for it.
    """

    index: int
    points_mm: FloatArray  # (n, 3)
    frame: Frame
    corners_mm: FloatArray | None = None  # (2, 3) lowest and highest coordinates of the points

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_mm", frozen(self.points_mm))
        if self.corners_mm is not None:
            object.__setattr__(self, "corners_mm", frozen(self.corners_mm))
            if (
                self.corners_mm.shape != (2, 3)
                or not (self.corners_mm[0] <= self.corners_mm[1]).all()
            ):
                raise ValueError(f"slice {self.index}: corners {self.corners_mm.tolist()} of a box")
