"""The two methods, and what their sections and surfaces have in common.

::

    fit     `reconstruction.fit_pipeline`  curves fitted to raw points, one surface a branch
    paper   `reconstruction.pipeline`      cells, centres of mass, patches a run
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from reconstruction.course import Course
from reconstruction.errors import NotLoftable
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.fitted_sections import FittedSection
from reconstruction.fitting.curve import Exact
from reconstruction.lofting import mesh_sections
from reconstruction.meshing import Mesh
from reconstruction.pipeline import Reconstruction
from reconstruction.sections import Section
from reconstruction.skinning.standing_in import Nurbs
from reconstruction.skinning.surfacing import skin_slices

AnySection = Section | FittedSection
AnyReconstruction = Reconstruction | FittedReconstruction
AnyCourse = Course[AnySection, AnyReconstruction]


class Method(Enum):
    """How sections and surface are made."""

    FIT = "fit"
    PAPER = "paper"


def mesh_so_far(sections: Sequence[AnySection]) -> Mesh | None:
    """Mesh the sections of one method so far; None while no two of them are joined."""
    drawn = [section for section in sections if isinstance(section, Section)]
    fitted = [section.outlines for section in sections if isinstance(section, FittedSection)]
    if drawn:
        return mesh_sections(drawn) if len(drawn) > 1 else None
    try:
        # What is there so far may be a cylinder and the whole none: nothing is claimed of it.
        return skin_slices(fitted, exact=Exact.NEVER, nurbs=Nurbs.ALWAYS).mesh
    except NotLoftable:
        return None
