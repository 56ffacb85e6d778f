"""The verbs for control scripts and notebooks: plain names in, values out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from loftscan.comparing import Comparison, compare_things
from loftscan.inputs import Unit
from loftscan.progress import Progress, silent
from loftscan.reconstructing import Method, Settings, reconstruct_with
from loftscan.result import Result
from reconstruction.cleanup import CleanupSettings
from reconstruction.comparison import Align
from reconstruction.reduction import Box
from reconstruction.survey import Axis


def reconstruct(
    source: Path | str | ArrayLike,
    *,
    axis: Literal["x", "y", "z"] = "z",
    unit: Literal["mm", "cm", "m", "um", "inch"] = "mm",
    method: Literal["paper"] = "paper",
    spacing_mm: float | None = None,
    resolution_mm: float | None = None,
    tolerance_mm: float | None = None,
    crop_mm: Sequence[Sequence[float]] | None = None,
    intermediate: int = 0,
    remesh_edge_mm: float | None = None,
    decimate_to_faces: int | None = None,
    progress: Progress = silent,
) -> Result:
    """Reconstruct a surface from a cloud.

    Parameters
    ----------
    source
        A cloud file (.ply .pcd .xyz .pts .txt .csv .npy) or an (n, 3) array.
    axis
        The stacking axis: the turntable's, or the stage's.
    unit
        Of the coordinates in `source`; everything after is in mm.
    method
        ``"paper"``, the method of the paper.
    spacing_mm, resolution_mm
        Distance between slices, and side of a cell; by default found from the cloud.
    tolerance_mm
        Judge the points by this distance from the mesh.
    crop_mm
        Low and high corner, ((x, y, z), (x, y, z)): only points in between are used.
    intermediate
        Rows of the mesh between two sections.
    remesh_edge_mm, decimate_to_faces
        Remesh to this edge length, or decimate to so many faces, with pymeshlab.
    progress
        Called with (stage, done, total).

    Raises
    ------
    reconstruction.errors.ReconstructionError
        The input or the work failed; the message says what and what to do.
    ValueError
        For an argument that cannot be meant.
    """
    settings = Settings(
        method=Method(method),
        axis=Axis(axis),
        unit=Unit(unit),
        spacing_mm=spacing_mm,
        resolution_mm=resolution_mm,
        tolerance_mm=tolerance_mm,
        crop=None if crop_mm is None else _box(crop_mm),
        intermediate=intermediate,
        cleanup=CleanupSettings(remesh_edge_mm=remesh_edge_mm, decimate_to_faces=decimate_to_faces),
    )
    return reconstruct_with(source, settings, progress=progress)


def _box(corners_mm: Sequence[Sequence[float]]) -> Box:
    corners = np.asarray(corners_mm, dtype=np.float64)
    if corners.shape != (2, 3) or not (corners[0] < corners[1]).all():
        raise ValueError(f"crop_mm {corners.tolist()}: a low and a high corner, (2, 3), expected")
    return Box(*corners)


def compare(
    a: Path | str | ArrayLike,
    b: Path | str | ArrayLike,
    *,
    align: Literal["none", "best-fit"] = "none",
    tolerance_mm: float | None = None,
    unit: Literal["mm", "cm", "m", "um", "inch"] = "mm",
) -> Comparison:
    """Measure how far `a` lies from `b`: clouds, meshes (.stl .ply .obj .off) or result folders.

    Parameters
    ----------
    a, b
        What is measured, and the reference. Signed where the reference is a mesh, positive outside.
        A cloud has no inside, so of a mesh `a` and a cloud `b` it is the cloud that is measured
        (and moved): `Comparison.measured` says which.
    align
        ``"best-fit"`` moves `a` onto `b` first; the motion is in the result.
    tolerance_mm
        Say whether all points lie within.
    unit
        Of both inputs; result folders are in mm whatever this says.
    """
    return compare_things(a, b, align=Align(align), tolerance_mm=tolerance_mm, unit=Unit(unit))
