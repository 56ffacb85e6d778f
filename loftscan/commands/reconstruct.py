"""``loftscan reconstruct``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
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
    from loftscan.progress import Progress
    from loftscan.reconstructing import Settings
    from loftscan.result import Result


def reconstruct(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="INPUT", help="A .scan folder, or a cloud: .ply .pcd .xyz .pts .txt .csv .npy"
        ),
    ],
    out: Out,
    follow: Annotated[
        bool, typer.Option("--follow", help="Take a scan's slices as another program writes them.")
    ] = False,
    patience_s: Annotated[
        float, typer.Option(help="With --follow: seconds to wait for the scan to begin.", min=0.0)
    ] = 60.0,
    method: Annotated[
        str, typer.Option(help="How sections and surface are made: fit or paper.")
    ] = "fit",
    axis: Annotated[str, typer.Option(help="Stacking axis: x, y or z.")] = "z",
    unit: UnitName = "mm",
    spacing_mm: Annotated[
        float | None, typer.Option(help="Distance between slices; by default found.")
    ] = None,
    resolution_mm: Annotated[
        float | None,
        typer.Option(help="Side of a cell, method paper; by default the paper's rule."),
    ] = None,
    exact: Annotated[
        str,
        typer.Option(help="Circles, cylinders and the like as such, method fit: auto or never."),
    ] = "auto",
    nurbs: Annotated[
        str,
        typer.Option(
            help="Method fit: auto, or always, where a mesh of all points would be truer."
        ),
    ] = "auto",
    layout: Annotated[
        str,
        typer.Option(
            help="How the slices lie, method fit: rings, stripes, meridians, or auto: as they show."
        ),
    ] = "auto",
    axis_at: Annotated[
        str | None,
        typer.Option(
            help="Where the axis of a cloud's meridians stands, in mm: X,Y of --axis z; by default"
            " 0,0, or the cloud's middle."
        ),
    ] = None,
    tolerance_mm: Tolerance = None,
    crop: Annotated[
        str | None, typer.Option(help="Use only this box, in mm: xmin,xmax,ymin,ymax,zmin,zmax.")
    ] = None,
    intermediate: Annotated[
        int, typer.Option(help="Mesh rows between sections, method paper.")
    ] = 0,
    remesh_mm: Annotated[float | None, typer.Option(help="Remesh to this edge length.")] = None,
    decimate_faces: Annotated[
        int | None, typer.Option(help="Decimate the mesh to so many faces.")
    ] = None,
    formats: Formats = None,
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Turn a scan or a cloud into a mesh, NURBS and a report."""

    def work() -> None:
        from loftscan.cad_files import CadWriter
        from loftscan.result import check_output

        settings = _settings(
            method, axis, unit, spacing_mm, resolution_mm, tolerance_mm, crop, intermediate,
            exact, nurbs, layout, axis_at, remesh_mm, decimate_faces,
        )  # fmt: skip
        # Refused before the work, not after it.
        wanted = writable_formats(formats)
        check_output(out, overwrite=overwrite)
        with CadWriter(wanted) as cad:
            if follow:
                making = _followed(source, settings, patience_s, json_lines=json_lines)
            else:
                making = _made(source, settings, json_lines=json_lines)
            with making as (result, progress):
                save(result, out, wanted, cad, progress, overwrite=overwrite, json_lines=json_lines)
        tell(result, out, json_lines=json_lines)
        if not json_lines:
            _tell_lag(result)

    run(work, debug=debug)


@contextmanager
def _made(
    source: Path, settings: Settings, *, json_lines: bool
) -> Iterator[tuple[Result, Progress]]:
    """The result of what is there, and the progress to go on with."""
    from acquisition.scanfile import ScanFolder
    from loftscan.following import KeptScan
    from loftscan.interruption import interruptible
    from loftscan.progress import bars
    from loftscan.reconstructing import reconstruct_with
    from loftscan.scans import is_scan
    from loftscan.streaming import finish, stream

    with interruptible() as interruption, bars(json_lines=json_lines) as shown:
        progress = interruption.heeding(shown)
        if is_scan(source):
            kept = KeptScan(ScanFolder.open(source))
            yield finish(stream(kept, settings, progress=progress)), progress
        else:
            yield reconstruct_with(source, settings, progress=progress), progress


@contextmanager
def _followed(
    source: Path, settings: Settings, patience_s: float, *, json_lines: bool
) -> Iterator[tuple[Result, Progress]]:
    """The result of a scan that another program is writing, told slice by slice."""
    from loftscan.following import FollowedScan, is_begun
    from loftscan.interruption import interruptible
    from loftscan.streaming import check_settings, finish, stream
    from loftscan.warming import warm_up
    from loftscan.watching import watching

    check_settings(settings)
    if not is_begun(source) and not json_lines:
        typer.echo(f"waiting for {source} to begin, at most {patience_s:g} s", err=True)
    with interruptible() as interruption, watching(json_lines=json_lines) as watch:
        pause, progress = interruption.pausing(), interruption.heeding(watch.step)
        coming = FollowedScan(source, patience_s=patience_s, pause=pause)
        updates = stream(coming, settings, progress=progress, prepare=warm_up)
        yield finish(watch.passing(updates)), progress


def _tell_lag(result: Result) -> None:
    numbers = result.metrics
    if "lag_median_s" in numbers:
        period_s = numbers["slice_period_median_s"]
        print(
            f"lag: {numbers['lag_median_s']:.2f} s from a slice's file to its section, at most"
            f" {numbers['lag_max_s']:.2f} s, of {numbers['lag_slices']} slices"
            + ("" if period_s is None else f"; a slice every {period_s:.2f} s")
        )


def _settings(
    method: str,
    axis: str,
    unit: str,
    spacing_mm: float | None,
    resolution_mm: float | None,
    tolerance_mm: float | None,
    crop: str | None,
    intermediate: int,
    exact: str,
    nurbs: str,
    layout: str,
    axis_at: str | None,
    remesh_mm: float | None,
    decimate_faces: int | None,
) -> Settings:
    from loftscan.inputs import Unit, parse_crop, parse_place
    from loftscan.methods import Method
    from loftscan.reconstructing import Settings
    from reconstruction.cleanup import CleanupSettings
    from reconstruction.fitting.curve import Exact
    from reconstruction.skinning.layout import Layout
    from reconstruction.skinning.standing_in import Nurbs
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
        exact=choice(Exact, exact, "--exact"),
        nurbs=choice(Nurbs, nurbs, "--nurbs"),
        layout=choice(Layout, layout, "--layout"),
        axis_at_mm=None if axis_at is None else parse_place(axis_at),
        cleanup=CleanupSettings(remesh_edge_mm=remesh_mm, decimate_to_faces=decimate_faces),
    )
