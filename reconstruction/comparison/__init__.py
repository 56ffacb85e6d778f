"""Deviations: how far points, clouds and meshes lie from a mesh, aligned or as they are."""

from reconstruction.comparison.alignment import best_fit, moved
from reconstruction.comparison.comparing import (
    Align,
    MeshDeviation,
    Ways,
    compare_clouds,
    compare_meshes,
    compare_to_mesh,
)
from reconstruction.comparison.deviation import (
    Alignment,
    Deviation,
    Method,
    Statistics,
    Verdict,
)
from reconstruction.comparison.reference import Readings, Reference, measure, reference
from reconstruction.comparison.sampling import sample_surface

__all__ = [
    "Align",
    "Alignment",
    "Deviation",
    "MeshDeviation",
    "Method",
    "Readings",
    "Reference",
    "Statistics",
    "Verdict",
    "Ways",
    "best_fit",
    "compare_clouds",
    "compare_meshes",
    "compare_to_mesh",
    "measure",
    "moved",
    "reference",
    "sample_surface",
]
