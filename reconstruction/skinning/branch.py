"""What contours over many slices amount to: branches, and where they meet.

::

    slice 4    o   o        two branches end in the same joint ...
               |   |
    joint      +-+-+
                 |
    slice 3      o          ... out of which one branch goes on
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from reconstruction.arrays import FloatArray
from reconstruction.skinning.outlines import Outline
from reconstruction.slices import Frame

_BOXES = 64
_CELLS_A_BOX = 4  # on average: by chance hardly one is empty


class Ending(Enum):
    """What becomes of a branch beyond its last outline."""

    UNSEEN = "unseen"  # no slice was taken there
    CLOSED = "closed"  # the next slice has nothing there
    JOINED = "joined"  # contours split or merge before the next slice


@dataclass(frozen=True, slots=True)
class End:
    """One end of a branch."""

    ending: Ending
    height_mm: float  # JOINED: of the joint; CLOSED: of the next slice; UNSEEN: of the outline
    joint: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """Outlines that follow each other, one to one; or runs side by side, or about an axis.

    Most go up from slice to slice. One may go up outside and come down inside, where a loop and
    the hole in it vanish together; if that happens at both ends it is `cyclic`, as a torus is.
    """

    outlines: tuple[Outline, ...]
    cyclic: bool  # the last outline is followed by the first
    ends: tuple[End, End] | None  # None: cyclic
    hole: bool  # it bounds a cavity: material lies outside
    pitch_mm: float = math.inf  # usual way from slice to slice of the stack, if it is known
    frame: Frame | None = None  # of meridians: on their axis, its normal along it
    across: int = 0  # sections that u runs across; 0: v does, from outline to outline

    @property
    def axes(self) -> FloatArray:
        """Rows x, y across the axis of the surface and its direction, (3, 3)."""
        return (self.frame or self.outlines[0].frame).axes

    def boxes(self, cells: int) -> tuple[int, int]:
        """How many boxes over (u, v) tell where cells are: a gap's width apart."""
        if self.across:
            columns = min(max(self.across // 2, 1), _BOXES)
            return columns, min(max(cells // (_CELLS_A_BOX * columns), 8), _BOXES)
        rows = min(max(len(self.outlines) // 2, 1), _BOXES)
        return min(max(cells // (_CELLS_A_BOX * rows), 8), _BOXES), rows


@dataclass(frozen=True, slots=True)
class Joint:
    """Branches, by number, that meet in a plane between two slices."""

    height_mm: float
    below: tuple[int, ...]
    above: tuple[int, ...]

    @property
    def shoulder(self) -> bool:
        """Whether one contour goes on in one other, but steps abruptly."""
        return len(self.below) == len(self.above) == 1
