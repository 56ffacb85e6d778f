"""`--method fit`: slices in, sections as they come, at last one watertight surface of them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import ClassVar

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.cleanup import Cleaned, CleanupSettings, clean
from reconstruction.course import Remedy, too_few
from reconstruction.fitted_sections import (
    LEFT_OUT_SIGMAS,
    FittedSection,
    draw_fitted_section,
    explain_nothing,
)
from reconstruction.fitting.curve import Exact
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Surface
from reconstruction.sections import Residual, Skipped
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.ends import Brim
from reconstruction.skinning.layout import Layout, is_turned, layout_of
from reconstruction.skinning.standing_in import Nurbs
from reconstruction.skinning.surfacing import Skinned, skin_slices
from reconstruction.slices import Slice

_LEVEL = 1e-9  # of the height


@dataclass(frozen=True, slots=True, eq=False)
class FittedReconstruction:
    """Everything that became of the slices."""

    REACH: ClassVar = f"{LEFT_OUT_SIGMAS:g} standard deviations"  # as in `pipeline`
    SIGMA_RULE: ClassVar = "sigma of points across curves"

    sections: tuple[FittedSection, ...]
    skipped: tuple[Skipped, ...]
    skinned: Skinned
    cleaned: Cleaned  # what the cleanup did and found

    @property
    def patches(self) -> tuple[Surface, ...]:
        """One surface a branch, from the outside in; none where the mesh is not theirs."""
        return tuple(skin.surface for skin in self.skinned.shown)

    @property
    def mesh(self) -> Mesh:
        """Closed, cleaned."""
        return self.cleaned.mesh

    @property
    def residual(self) -> Residual:
        """Of the unreduced points that the sections stand for."""
        return reduce(Residual.plus, (section.residual for section in self.sections))

    @property
    def residual_all(self) -> Residual:
        """Of all points of all sections, those left out too."""
        return reduce(Residual.plus, (section.residual_all for section in self.sections))

    @property
    def normal(self) -> FloatArray:
        """The direction (3,) along which heights are told: the stack's, or that of the axis."""
        if self.skinned.shown:
            return np.asarray(self.skinned.shown[0].branch.axes[2])
        return np.asarray(self.sections[0].frame.axes[2])

    @property
    def cap_heights_mm(self) -> FloatArray:
        """Heights along the stacking normal at which flat caps close the part."""
        if not self.skinned.shown:
            return self._level_ends_mm()
        brims = [brim for skin in self.skinned.shown for brim in skin.brims or ()]
        return np.array([brim.height_mm for brim in brims if isinstance(brim, Brim)])

    def _level_ends_mm(self) -> FloatArray:
        """Heights of level faces beyond the outermost slices, of a mesh that stands in."""
        heights = self.skinned.mesh.vertices_mm @ self.normal
        ends = [heights.min(), heights.max()]
        corners = heights[self.skinned.mesh.faces]
        near = _LEVEL * (ends[1] - ends[0])
        return np.array([end for end in ends if (np.abs(corners - end) < near).all(axis=1).any()])


class FitCourse:
    """`--method fit`: what a slice leaves is its curves, and the moments of their points."""

    def __init__(
        self,
        exact: Exact,
        cleanup: CleanupSettings,
        *,
        nurbs: Nurbs = Nurbs.AUTO,
        layout: Layout = Layout.AUTO,
    ) -> None:
        self._exact = exact
        self._nurbs = nurbs
        self._layout = layout
        self._cleanup = cleanup
        self._stack: list[SliceOutlines] = []
        self._sections: list[FittedSection] = []

    def draw(self, piece: Slice) -> FittedSection:
        """Turn the next slice into a section."""
        drawn, section = draw_fitted_section(piece, exact=self._exact, solid=self._solid(piece))
        # Without a section, too: that a slice is empty, or a heap, says how a part goes on.
        self._stack.append(drawn)
        if section is None:
            raise explain_nothing(drawn, len(piece.points_mm))
        self._sections.append(section)
        return section

    def finish(self, skipped: Sequence[Skipped], remedy: Remedy) -> FittedReconstruction:
        """One surface a branch through all slices, those without a section too."""
        indices = [section.index for section in self._sections]
        layout = layout_of(self._stack, self._layout)
        ringed = layout is Layout.RINGS
        found = [each.index for each in self._sections if each.closed is ringed]
        if len(found) < 2:
            kind = "closed section" if ringed else "section that is open"
            raise too_few(kind, found, indices, skipped, remedy)
        skinned = skin_slices(self._stack, exact=self._exact, nurbs=self._nurbs, layout=layout)
        # The border of an open surface is no hole in it.
        settings = replace(self._cleanup, max_hole_edges=0) if skinned.open else self._cleanup
        cleaned = clean(skinned.mesh, settings)
        return FittedReconstruction(tuple(self._sections), tuple(skipped), skinned, cleaned)

    def _solid(self, piece: Slice) -> bool:
        """Whether a run of this slice that may be closed is: not of stripes, nor of meridians."""
        if self._layout is not Layout.AUTO:
            return self._layout is Layout.RINGS
        return not (self._stack and is_turned(piece.frame, self._stack[0].frame))
