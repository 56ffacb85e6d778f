"""The verbs for control scripts and notebooks: plain names in, values out."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from acquisition.frames import Kinematics
from acquisition.poses import Sweep
from acquisition.scanfile import ScanFolder
from loftscan.comparing import Comparison, compare_things
from loftscan.following import PATIENCE_S, FollowedScan, KeptScan
from loftscan.inputs import Unit
from loftscan.methods import Method
from loftscan.progress import Progress, silent
from loftscan.reconstructing import Settings, reconstruct_with
from loftscan.result import Result
from loftscan.scans import (
    GivenSlices,
    GivenSweeps,
    Source,
    Sweeps,
    given_sweeps,
    is_scan,
    kind_of_layout,
)
from loftscan.streaming import finish, stream
from loftscan.updates import Update
from loftscan.warming import warm_up
from reconstruction.cleanup import CleanupSettings
from reconstruction.comparison import Align
from reconstruction.fitting.curve import Exact
from reconstruction.reduction import Box
from reconstruction.skinning.layout import Layout
from reconstruction.skinning.standing_in import Nurbs
from reconstruction.slices import Slice
from reconstruction.survey import Axis


def reconstruct(
    source: Path | str | ArrayLike | Iterable[Slice] | Sweeps,
    *,
    axis: Literal["x", "y", "z"] = "z",
    unit: Literal["mm", "cm", "m", "um", "inch"] = "mm",
    method: Literal["fit", "paper"] = "fit",
    exact: Literal["auto", "never"] = "auto",
    nurbs: Literal["auto", "always"] = "auto",
    layout: Literal["auto", "rings", "stripes", "meridians"] = "auto",
    axis_at_mm: tuple[float, float] | None = None,
    spacing_mm: float | None = None,
    resolution_mm: float | None = None,
    tolerance_mm: float | None = None,
    crop_mm: Sequence[Sequence[float]] | None = None,
    intermediate: int = 0,
    remesh_edge_mm: float | None = None,
    decimate_to_faces: int | None = None,
    progress: Progress = silent,
) -> Result:
    """Reconstruct a surface from a cloud, or from the slices of a scan.

    Parameters
    ----------
    source
        A cloud file (.ply .pcd .xyz .pts .txt .csv .npy) or an (n, 3) array; a .scan folder as it
        is now; what `scan` gives; or an iterator of `Slice`, in mm.
    axis
        The stacking axis of a cloud: the turntable's, or the stage's. A scan's slices say theirs.
    unit
        Of a cloud's coordinates; everything after is in mm.
    method
        ``"fit"``: curves fitted to the raw points of every slice, and one surface a branch through
        all of them; or ``"paper"``, the method of the paper, one contour a slice.
    exact
        Of ``"fit"``: whether circles of slices, and cylinders, cones, spheres and surfaces of
        revolution of the part, are returned as such, with their figures (`Result.shapes`), where
        the points prefer it.
    nurbs
        Of ``"fit"``: ``"always"`` keeps the NURBS surfaces of the branches where one mesh around
        all points would stand in for them, because it follows the points and they do not.
    layout
        Of ``"fit"``: how the slices lie. ``"rings"`` are closed sections over one another,
        ``"stripes"`` open ones side by side, ``"meridians"`` open ones about an axis; ``"auto"``:
        as a scan's plan says, or as they show themselves. A cloud is cut in meridians only when
        asked for.
    axis_at_mm
        Where the axis of a cloud's meridians stands, (x, y) for ``axis="z"``; by default (0, 0) if
        the cloud lies around it, else its middle.
    spacing_mm, resolution_mm
        Distance between slices (of a cloud only), and side of a cell (of ``"paper"`` only); by
        default found from the points.
    tolerance_mm
        Judge the points by this distance from the mesh.
    crop_mm
        Low and high corner, ((x, y, z), (x, y, z)): only points in between are used.
    intermediate
        Rows of the mesh between two sections, of ``"paper"`` only.
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
        exact=Exact(exact),
        nurbs=Nurbs(nurbs),
        layout=Layout(layout),
        axis_at_mm=axis_at_mm,
        cleanup=CleanupSettings(remesh_edge_mm=remesh_edge_mm, decimate_to_faces=decimate_to_faces),
    )
    slices = _slices_in(source)
    if slices is not None:
        return finish(stream(slices, settings, progress=progress))
    return reconstruct_with(source, settings, progress=progress)  # type: ignore[arg-type] # no slices: a cloud


def reconstruct_stream(
    source: Path | str | Sweeps | Iterable[Slice] | Iterable[Sweep],
    *,
    kinematics: Kinematics | None = None,
    name: str | None = None,
    method: Literal["fit", "paper"] = "fit",
    exact: Literal["auto", "never"] = "auto",
    nurbs: Literal["auto", "always"] = "auto",
    layout: Literal["auto", "rings", "stripes", "meridians"] = "auto",
    resolution_mm: float | None = None,
    tolerance_mm: float | None = None,
    crop_mm: Sequence[Sequence[float]] | None = None,
    intermediate: int = 0,
    remesh_edge_mm: float | None = None,
    decimate_to_faces: int | None = None,
    patience_s: float = PATIENCE_S,
    progress: Progress = silent,
) -> Generator[Update]:
    """Reconstruct slices while they come.

    Parameters
    ----------
    source
        What `scan` gives; a .scan folder, which is followed while another program writes it;
        sweeps, with their `kinematics`; or an iterator of `Slice`, in mm.
    kinematics
        How the axes and the sensor stand, for sweeps that do not say it.
    name
        Of the result; by default that of the folder.
    patience_s
        How long a folder that is not there yet is waited for.

    The other parameters are those of `reconstruct`.

    Yields
    ------
    Fitted
        A section, as soon as its slice was there; its `mesh()` is that of the sections so far.
    Missed
        A slice that gave no section, and why.
    Finished
        At last, with the `result`.

    Raises
    ------
    reconstruction.errors.ReconstructionError, acquisition.errors.AcquisitionError
        The work or the scan failed; the message says what and what to do.
    ValueError
        For an argument that cannot be meant.
    """
    settings = Settings(
        method=Method(method),
        resolution_mm=resolution_mm,
        tolerance_mm=tolerance_mm,
        crop=None if crop_mm is None else _box(crop_mm),
        intermediate=intermediate,
        exact=Exact(exact),
        nurbs=Nurbs(nurbs),
        layout=Layout(layout),
        cleanup=CleanupSettings(remesh_edge_mm=remesh_edge_mm, decimate_to_faces=decimate_to_faces),
    )
    slices = _coming(source, kinematics, patience_s, settings.layout)
    return stream(slices, settings, name=name, progress=progress, prepare=warm_up)


def _coming(
    source: Path | str | Sweeps | Iterable[Slice] | Iterable[Sweep],
    kinematics: Kinematics | None,
    patience_s: float,
    layout: Layout,
) -> Source:
    if isinstance(source, (str, Path)):
        return FollowedScan(Path(source), patience_s=patience_s)
    if isinstance(source, Sweeps):
        _must_be_in_order(source)
        return given_sweeps(source)
    if kinematics is not None:
        kind = kind_of_layout(layout)
        return GivenSweeps(source, kinematics, _length(source), kind=kind)  # type: ignore[arg-type] # told so
    return GivenSlices(source, _length(source))  # type: ignore[arg-type] # checked as they come


def _slices_in(source: object) -> Source | None:
    """The slices that a source holds or gives; None for a cloud."""
    if isinstance(source, (str, Path)):
        return KeptScan(ScanFolder.open(Path(source))) if is_scan(source) else None
    if isinstance(source, Sweeps):
        _must_be_in_order(source)
        return given_sweeps(source)
    listed = isinstance(source, (list, tuple)) and all(
        isinstance(each, Slice) for each in source[:1]
    )
    if isinstance(source, Iterator) or listed:
        return GivenSlices(source, _length(source))  # type: ignore[arg-type] # checked as they come
    return None


def _must_be_in_order(sweeps: Sweeps) -> None:
    """Refuse the sweeps of an adaptive scan: they come as they are chosen."""
    plan = getattr(sweeps, "plan", None)
    if getattr(plan, "adaptive", None) is not None:
        raise ValueError(
            "an adaptive scan: its slices come in no order, and it waits for somebody who follows"
            " its folder; run `loftscan reconstruct NAME.scan --follow` beside it"
        )


def _length(source: object) -> int | None:
    return len(source) if isinstance(source, (list, tuple)) else None


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
