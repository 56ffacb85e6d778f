"""What a person types: ``loftscan COMMAND``.

Exit codes: 0 done; 1 the work failed; 2 bad usage or bad input; 3 stopped by the operator. Every
message is one line that says what and what to do; a traceback needs ``--debug``.
"""

from __future__ import annotations

import errno
import json
import math
import sys
import time
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from loftscan.cad_files import CadWriter
    from loftscan.progress import Progress
    from loftscan.reconstructing import Settings
    from loftscan.result import Result

Choice = TypeVar("Choice", bound=Enum)

_BEGUN = time.monotonic()

app = typer.Typer(
    help="Turn the slices of a scanning station into one watertight NURBS surface.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"loftscan {version('loftscan')}")
        raise typer.Exit


@app.callback()
def _about(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_say_version, is_eager=True, help="Say it and end."),
    ] = False,
) -> None:
    """Turn the slices of a scanning station into one watertight NURBS surface."""


Out = Annotated[Path, typer.Option(help="Folder for the result; it must not exist yet.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an older result in --out.")]
JsonLines = Annotated[bool, typer.Option("--json", help="Print machine-readable lines.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Tolerance = Annotated[float | None, typer.Option(help="Judge the points by this distance.")]
UnitName = Annotated[str, typer.Option(help="Unit of the input: mm, cm, m, um or inch.")]
Formats = Annotated[
    str | None, typer.Option(help="Files to write, of step,3dm,stl,ply,glb; by default all.")
]


@app.command()
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
        wanted = _formats(formats)
        check_output(out, overwrite=overwrite)
        with bars(json_lines=json_lines) as progress, CadWriter(wanted) as cad:
            result = reconstruct_with(source, settings, progress=progress)
            _save(result, out, wanted, cad, progress, overwrite=overwrite)
        _tell(result, out, json_lines=json_lines)

    _run(work, debug=debug)


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A cloud, a mesh or a result folder.")],
    b: Annotated[
        Path,
        typer.Argument(
            metavar="B",
            help="The reference, the same; of a mesh and a cloud, the cloud is measured.",
        ),
    ],
    out: Out,
    align: Annotated[str, typer.Option(help="none or best-fit.")] = "none",
    tolerance_mm: Tolerance = None,
    unit: UnitName = "mm",
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Measure how far A lies from B: deviation map, statistics, verdict (exit 1 if out)."""

    def work() -> None:
        from loftscan.comparing import MARKS, compare_things
        from loftscan.inputs import Unit
        from loftscan.result import check_output
        from reconstruction.comparison import Align

        check_output(out, overwrite=overwrite, marks=MARKS)
        found = compare_things(
            a, b,
            align=_choice(Align, align, "--align"),
            tolerance_mm=tolerance_mm,
            unit=_choice(Unit, unit, "--unit"),
        )  # fmt: skip
        found.save(out, overwrite=overwrite)
        numbers, verdict = found.deviation.statistics, found.deviation.verdict
        if json_lines:
            print(json.dumps({"event": "done", "out": str(out), **found.metrics}))
        else:
            print(
                f"{found.measured.name} against {found.reference.name}: "
                f"rms {numbers.rms_mm:.4g} mm, mean {numbers.mean_mm:+.4g} mm, "
                f"95 % within {numbers.absolute_95_mm:.4g} mm, {numbers.count} points"
            )
            aligned = found.deviation.alignment
            if aligned is not None:
                print(
                    f"aligned by best fit: turned by {math.degrees(aligned.rotation_rad):.4g}°, "
                    f"moved by {aligned.translation_mm:.4g} mm; comparison.json has the transform"
                )
            print(f"report: {out / 'report.html'}")
        if verdict is not None and not verdict.within:
            _fail(1, f"out of tolerance: {verdict.share_within:.2%} within {tolerance_mm:g} mm")

    _run(work, debug=debug)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the result.")] = Path("demo-out"),
    seed: Annotated[int, typer.Option(help="Of the noise.", min=0)] = 20,
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Reconstruct a noisy, gappy vase that the program makes itself, and say where to look."""

    def work() -> None:
        from loftscan.cad_files import CadWriter
        from loftscan.demo import make_cloud
        from loftscan.progress import bars
        from loftscan.reconstructing import Settings, reconstruct_with
        from loftscan.result import check_output

        wanted = _formats(None)
        check_output(out, overwrite=overwrite)
        with bars(json_lines=json_lines) as progress, CadWriter(wanted) as cad:
            result = reconstruct_with(make_cloud(seed), Settings(), progress=progress, name="vase")
            _save(result, out, wanted, cad, progress, overwrite=overwrite)
        _tell(result, out, json_lines=json_lines)

    _run(work, debug=debug)


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
        method=_choice(Method, method, "--method"),
        axis=_choice(Axis, axis, "--axis"),
        unit=_choice(Unit, unit, "--unit"),
        spacing_mm=spacing_mm,
        resolution_mm=resolution_mm,
        tolerance_mm=tolerance_mm,
        crop=None if crop is None else parse_crop(crop),
        intermediate=intermediate,
        cleanup=CleanupSettings(remesh_edge_mm=remesh_mm, decimate_to_faces=decimate_faces),
    )


def _formats(wanted: str | None) -> tuple[str, ...]:
    """The formats to write; those that cannot be written by default are said."""
    from loftscan.result import FORMATS, choose_formats

    if wanted is not None:
        return choose_formats(wanted.split(","))
    chosen = choose_formats(None)
    left_out = [each for each in FORMATS if each not in chosen]
    if left_out:
        typer.echo(
            f"warning: {' and '.join(left_out)} left out, their libraries are not installed: "
            "pip install 'loftscan[cad]'",
            err=True,
        )
    return chosen


def _choice(names: type[Choice], wanted: str, option: str) -> Choice:
    """Find the member of an enumeration by its value, which is what a person types."""
    try:
        return names(wanted.lower())
    except ValueError as unknown:
        known = ", ".join(str(member.value) for member in names)
        raise ValueError(f"{option} {wanted!r}: one of {known} expected") from unknown


def _save(
    result: Result,
    out: Path,
    formats: tuple[str, ...],
    cad: CadWriter,
    progress: Progress,
    *,
    overwrite: bool,
) -> None:
    progress("saving", 0, 1)
    result.save(out, formats=formats, overwrite=overwrite, cad=cad)
    progress("saving", 1, 1)


def _tell(result: Result, out: Path, *, json_lines: bool) -> None:
    """Say what came out, in a few lines or in one JSON object."""
    numbers = result.metrics
    if json_lines:
        done = {"event": "done", "out": str(out), "warnings": result.warnings, **numbers}
        print(json.dumps(done, ensure_ascii=False))
        return
    for warning in result.warnings:
        typer.echo(f"warning: {warning}", err=True)
    state = "watertight" if numbers["watertight"] else "NOT watertight"
    print(
        f"{result.name}: {numbers['points_in']} points, {numbers['sections']} of "
        f"{numbers['slices']} slices became sections, {numbers['patches']} patches"
    )
    print(
        f"mesh: {numbers['faces']} faces, {state}; "
        f"residual rms {numbers['residual_rms_mm'] or math.nan:.3g} mm "
        f"of {numbers['residual_points']} points, cloud width {numbers['thickness_mm']:.3g} mm"
    )
    verdict = result.deviation.verdict
    if verdict is not None:
        print(f"tolerance: {verdict.share_within:.2%} within {verdict.tolerance_mm:g} mm")
    whole = time.monotonic() - _BEGUN
    print(
        f"time: {numbers['seconds']:.1f} s, {whole:.1f} s with saving; "
        f"peak memory {numbers['peak_memory_mb']:.0f} MB"
    )
    print(f"report: {out / 'report.html'}")


def _run(work: Callable[[], None], *, debug: bool) -> None:
    """Run a command's work and turn what is known to go wrong into a line and an exit code."""
    from reconstruction.errors import (
        NotLoftable,
        ReconstructionError,
        TooFewPoints,
        UnreadableCloud,
    )

    try:
        work()
    except KeyboardInterrupt:
        if debug:
            raise
        _fail(3, "stopped by the operator; nothing was written")
    except (UnreadableCloud, TooFewPoints, ValueError) as error:
        if debug:
            raise
        _fail(2, str(error))
    except (NotLoftable, ReconstructionError) as error:
        if debug:
            raise
        _fail(1, str(error))
    except MemoryError as error:
        if debug:
            raise
        remedy = "use a larger --resolution-mm or --spacing-mm, less --intermediate, or --crop"
        _fail(1, f"out of memory ({error}); {remedy}")
    except OSError as error:
        if debug:
            raise
        _fail(1, _explain(error))


_UNWRITABLE = {
    *(errno.EACCES, errno.EPERM, errno.EROFS),
    *(errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP),
}


def _explain(error: OSError) -> str:
    where = f"{error.filename}: " if error.filename else ""
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        return (
            f"{where}the disk is full; free some space and run again, nothing half-written is left"
        )
    if error.errno in _UNWRITABLE:
        return f"{where}{error.strerror}; name a folder that may be written as --out"
    return f"{where}{error.strerror or error}"


def _fail(code: int, message: str) -> None:
    typer.echo(f"loftscan: {' '.join(message.split())}", err=True)
    raise typer.Exit(code)


def main() -> None:
    """Entry point of the console script."""
    app()


if __name__ == "__main__":
    sys.exit(app())
