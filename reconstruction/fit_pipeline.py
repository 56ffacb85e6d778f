"""`--method fit`: slices in, sections as they come, at last one watertight surface of them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.cleanup import Cleaned, CleanupSettings, clean
from reconstruction.fitted_sections import FittedSection
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Surface
from reconstruction.sections import Residual, Skipped
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.ends import Brim
from reconstruction.skinning.surfacing import Skinned, skin_slices


@dataclass(frozen=True, slots=True, eq=False)
class FittedReconstruction:
    """Everything that became of the slices."""

    sections: tuple[FittedSection, ...]
    skipped: tuple[Skipped, ...]
    skinned: Skinned
    cleaned: Cleaned  # what the cleanup did and found

    @property
    def patches(self) -> tuple[Surface, ...]:
        """One surface a branch, from the outside in."""
        return tuple(skin.fit.net.surface() for skin in self.skinned.skins)

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
    def cap_heights_mm(self) -> FloatArray:
        """Heights along the stacking normal at which flat caps close the part."""
        brims = [brim for skin in self.skinned.skins for brim in skin.brims or ()]
        return np.array([brim.height_mm for brim in brims if isinstance(brim, Brim)])


def skin_sections(
    stack: Sequence[SliceOutlines],
    sections: Sequence[FittedSection],
    skipped: Sequence[Skipped],
    cleanup: CleanupSettings,
) -> FittedReconstruction:
    """Skin all slices, those without a section too, and clean the mesh.

    Raises
    ------
    NotLoftable
        Fewer than two slices with outlines, or none that follow each other.
    CleanupFailed, MissingExtra
        From the mesh cleanup.
    """
    skinned = skin_slices(stack)
    return FittedReconstruction(
        tuple(sections), tuple(skipped), skinned, clean(skinned.mesh, cleanup)
    )
