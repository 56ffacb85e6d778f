"""What a reconstruction tells while slices come: sections, slices that gave none, the result."""

from __future__ import annotations

from dataclasses import dataclass

from loftscan.methods import AnySection, mesh_so_far
from loftscan.result import Result
from reconstruction.meshing import Mesh


@dataclass(frozen=True, slots=True)
class Standing:
    """How far the work is."""

    done: int  # slices that came, or never will
    total: int | None  # of the plan, if it is known
    coverage: float  # share of the turn, or of an open slice's places, with points in the last
    lag_s: float | None  # from the appearance of the slice's file to now, if it was waited for


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A slice became a section."""

    section: AnySection
    standing: Standing
    sections: tuple[AnySection, ...]  # all so far, this one last

    @property
    def index(self) -> int:
        """Of the slice."""
        return self.section.index

    def mesh(self) -> Mesh | None:
        """The mesh of the sections so far, closed wherever they end; None for one section.

        Made when it is asked for, in time that grows with the sections: not for every update of a
        long scan.
        """
        return mesh_so_far(self.sections)


@dataclass(frozen=True, slots=True)
class Missed:
    """A slice gave no section."""

    index: int
    points: int
    why: str
    standing: Standing


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """Everything: the last update."""

    result: Result


Update = Fitted | Missed | Finished
