"""The two methods as the streams see them: a slice goes in, a section comes out, at last a surface.

::

    paper   `reconstruction.paper`            cells, centres of mass, patches a run
    fit     `reconstruction.fitted_sections`  curves fitted to raw points, one surface a branch
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from reconstruction.cleanup import CleanupSettings
from reconstruction.errors import NotLoftable
from reconstruction.fit_pipeline import FittedReconstruction, skin_sections
from reconstruction.fitted_sections import FittedSection, draw_fitted_section, explain_nothing
from reconstruction.fitting.curve import Exact
from reconstruction.lofting import mesh_sections
from reconstruction.meshing import Mesh
from reconstruction.paper import Base, PaperSettings, draw_section
from reconstruction.pipeline import Reconstruction, loft, trim_ends
from reconstruction.sections import Section, Skipped
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.surfacing import skin_slices
from reconstruction.slices import Slice

AnySection = Section | FittedSection
AnyReconstruction = Reconstruction | FittedReconstruction


class Method(Enum):
    """How sections and surface are made."""

    PAPER = "paper"
    FIT = "fit"


@dataclass(frozen=True, slots=True)
class Remedy:
    """What to do where there are too few sections, as it depends on where slices come from."""

    more_slices: str
    other_settings: str  # where slices gave no section


class Course(Protocol):
    """One reconstruction under way."""

    def draw(self, piece: Slice) -> AnySection:
        """Turn the next slice into a section.

        Raises
        ------
        TooFewPoints
            It has none; the message says why.
        """
        ...

    def finish(self, skipped: Sequence[Skipped], remedy: Remedy) -> AnyReconstruction:
        """Make the surface of all sections.

        Raises
        ------
        NotLoftable
            There are fewer than two, or none that follow each other.
        CleanupFailed, MissingExtra
            From the mesh cleanup.
        """
        ...


class PaperCourse:
    """`--method paper`: the 25 % rule looks only back, so a section is ready with its slice."""

    def __init__(self, settings: PaperSettings, cleanup: CleanupSettings) -> None:
        self._settings = settings
        self._cleanup = cleanup
        self._base: Base | None = None
        self._sections: list[Section] = []

    def draw(self, piece: Slice) -> Section:
        """Turn the next slice into a section."""
        section, self._base = draw_section(piece, self._settings, self._base)
        self._sections.append(section)
        return section

    def finish(self, skipped: Sequence[Skipped], remedy: Remedy) -> Reconstruction:
        """Patches and mesh of all sections but those that only grazed the part."""
        sections, trimmed = trim_ends(self._sections)
        every = [*skipped, *trimmed]
        if len(sections) < 2:
            raise _too_few(every, sections, remedy)
        return loft(sections, every, self._settings, self._cleanup)


class FitCourse:
    """`--method fit`: what a slice leaves is its curves, and the moments of their points."""

    def __init__(self, exact: Exact, cleanup: CleanupSettings) -> None:
        self._exact = exact
        self._cleanup = cleanup
        self._stack: list[SliceOutlines] = []
        self._sections: list[FittedSection] = []

    def draw(self, piece: Slice) -> FittedSection:
        """Turn the next slice into a section."""
        drawn, section = draw_fitted_section(piece, exact=self._exact)
        # Without a section, too: that a slice is empty, or a heap, says how a part goes on.
        self._stack.append(drawn)
        if section is None:
            raise explain_nothing(drawn, len(piece.points_mm))
        self._sections.append(section)
        return section

    def finish(self, skipped: Sequence[Skipped], remedy: Remedy) -> FittedReconstruction:
        """One surface a branch, through all slices."""
        if sum(section.closed for section in self._sections) < 2:
            raise _too_few(skipped, self._sections, remedy)
        return skin_sections(self._stack, self._sections, skipped, self._cleanup)


def mesh_so_far(sections: Sequence[AnySection]) -> Mesh | None:
    """Mesh the sections of one method so far; None while no two of them are joined."""
    drawn = [section for section in sections if isinstance(section, Section)]
    fitted = [section.outlines for section in sections if isinstance(section, FittedSection)]
    if drawn:
        return mesh_sections(drawn) if len(drawn) > 1 else None
    try:
        return skin_slices(fitted).mesh
    except NotLoftable:
        return None


def _too_few(
    skipped: Sequence[Skipped], sections: Sequence[AnySection], remedy: Remedy
) -> NotLoftable:
    count, kind = len(sections), "section"
    if sections and isinstance(sections[0], FittedSection):
        count, kind = sum(section.closed for section in sections), "closed section"
    found = f"{count} of {len(sections) + len(skipped)} slices gave a {kind}, two are needed"
    indices = tuple(section.index for section in sections)
    if not skipped:
        return NotLoftable(f"{found}: {remedy.more_slices}", indices=indices)
    fullest = max(skipped, key=lambda each: each.points)
    return NotLoftable(
        f"{found}; slice {fullest.index}: {fullest.reason}. {remedy.other_settings}",
        indices=indices,
    )
