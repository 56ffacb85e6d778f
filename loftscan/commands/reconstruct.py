"""``loftscan reconstruct``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import (
    Debug,
    Formats,
    JsonLines,
    Out,
    Overwrite,
    Tolerance,
    UnitName,
    choice,
)
from loftscan.commands.outcome import save, tell, writable_formats
from loftscan.commands.running import run

if TYPE_CHECKING:
    from loftscan.reconstructing import Settings


def reconstruct(
    source: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A cloud: .ply .pcd .xyz .pts .txt .csv .npy")
    ],
    out: Out,
    method: Annotated[str, typer.Option(help="How sections are made: paper.")] = "paper",
    axis: Annotated[str, typer.Option(help="Stacking axis: x, y or z.")] = "z",
    unit: UnitName = "mm",
    spacing_mm: Annotated[
        float | None, typer.Option(help="Distance between slices; by default found.")
    ] = None,
    resolution_mm: Annotated[
        float | None, typer.Option(help="Side of a cell; by default the paper's rule.")
    ] = None,
    tolerance_mm: Tolerance = None,
    crop: Annotated[
        str | None, typer.Option(help="Use only this box, in mm: xmin,xmax,ymin,ymax,zmin,zmax.")
    ] = None,
    intermediate: Annotated[int, typer.Option(help="Mesh rows between two sections.")] = 0,
    remesh_mm: Annotated[float | None, typer.Option(help="Remesh to this edge length.")] = None,
    decimate_faces: Annotated[
        int | None, typer.Option(help="Decimate the mesh to so many faces.")
    ] = None,
    formats: Formats = None,
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Turn a point cloud into a watertight mesh, NURBS patches and a report."""

    def work() -> None:
        from loftscan.cad_files import CadWriter
        from loftscan.progress import bars
        from loftscan.reconstructing import reconstruct_with
        from loftscan.result import check_output

        settings = _settings(
            method, axis, unit, spacing_mm, resolution_mm, tolerance_mm, crop, intermediate,
            remesh_mm, decimate_faces,
        )  # fmt: skip
        # Refused before the work, not after it.
        wanted = writable_formats(formats)
        check_output(out, overwrite=overwrite)
        with bars(json_lines=json_lines) as progress, CadWriter(wanted) as cad:
            result = reconstruct_with(source, settings, progress=progress)
            save(result, out, wanted, cad, progress, overwrite=overwrite)
        tell(result, out, json_lines=json_lines)

    run(work, debug=debug)


def _settings(
    method: str,
    axis: str,
    unit: str,
    spacing_mm: float | None,
    resolution_mm: float | None,
    tolerance_mm: float | None,
    crop: str | None,
    intermediate: int,
    remesh_mm: float | None,
    decimate_faces: int | None,
) -> Settings:
    from loftscan.inputs import Unit, parse_crop
    from loftscan.reconstructing import Method, Settings
    from reconstruction.cleanup import CleanupSettings
    from reconstruction.survey import Axis

    if remesh_mm is not None and not 0.0 < remesh_mm < math.inf:
        raise ValueError(f"--remesh-mm {remesh_mm:g}: a length above 0 mm is expected")
    if decimate_faces is not None and decimate_faces < 4:
        raise ValueError(f"--decimate-faces {decimate_faces}: a closed mesh has at least 4")
    return Settings(
        method=choice(Method, method, "--method"),
        axis=choice(Axis, axis, "--axis"),
        unit=choice(Unit, unit, "--unit"),
        spacing_mm=spacing_mm,
        resolution_mm=resolution_mm,
        tolerance_mm=tolerance_mm,
        crop=None if crop is None else parse_crop(crop),
        intermediate=intermediate,
        cleanup=CleanupSettings(remesh_edge_mm=remesh_mm, decimate_to_faces=decimate_faces),
    )
