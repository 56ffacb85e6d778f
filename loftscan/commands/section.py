"""``loftscan section``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loftscan.commands.options import Debug, JsonLines, choice
from loftscan.commands.running import run

if TYPE_CHECKING:
    from loftscan.sectioning import PlanarSlice
    from reconstruction.fitting.curve import Exact
    from reconstruction.fitting.section import SectionFit

_FILES = ("section.png", "sections.json")


def section(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Points (n, 2), or (n, 3) at one height: .npy .txt .csv .xyz; or a .scan folder.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="A folder for section.png and sections.json, or the picture's FILE.png."),
    ] = None,
    exact: Annotated[
        str, typer.Option(help="Circles, ellipses, arcs, lines as such: auto or never.")
    ] = "auto",
    index: Annotated[
        int | None, typer.Option("--slice", help="Which slice of a .scan folder.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the files of an older run.")
    ] = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Fit the curves of one slice: a line each, and a picture."""

    def work() -> None:
        from loftscan.sectioning import read_slice
        from reconstruction.fitting.curve import Exact
        from reconstruction.fitting.section import require_curves, resolve_section

        wanted = choice(Exact, exact, "--exact")
        if out is not None:
            _check(out, overwrite=overwrite)
        piece = read_slice(source, index)
        found = resolve_section(piece.points_mm, exact=wanted)
        if out is not None:
            _save(out, piece, found, wanted)
        require_curves(found, len(piece.points_mm))
        (_tell_json if json_lines else _tell)(piece, found, out)

    run(work, debug=debug)


def _check(out: Path, *, overwrite: bool) -> None:
    """Refuse before the work what would fail after it."""
    picture = out.suffix.lower() == ".png"
    if picture and not out.parent.is_dir():
        raise ValueError(f"{out}: there is no folder {out.parent}; make it first")
    if out.exists() and out.is_dir() == picture:
        raise ValueError(f"{out}: is a {'folder' if picture else 'file'}; name another --out")
    older = [out] if picture else [out / name for name in _FILES]
    there = next((file for file in older if file.exists()), None)
    if there is not None and not overwrite:
        raise ValueError(f"{there}: is there already; name another --out, or add --overwrite")


def _save(out: Path, piece: PlanarSlice, found: SectionFit, exact: Exact) -> None:
    from loftscan.figures import png
    from loftscan.section_view import fitted_figure, view_fit
    from loftscan.sectioning import write_section
    from reconstruction.exporting.atomic import replacing

    picture = out if out.suffix.lower() == ".png" else out / _FILES[0]
    picture.parent.mkdir(parents=True, exist_ok=True)
    if picture != out:
        write_section(out / _FILES[1], piece, found, exact)
    with replacing(picture) as file:
        file.write(png(fitted_figure(view_fit(piece.points_mm, found), title=piece.name)))


def _tell(piece: PlanarSlice, found: SectionFit, out: Path | None) -> None:
    from loftscan.sectioning import descriptions

    for why in found.failures:
        typer.echo(f"warning: a chain gave no curve: {why}", err=True)
    if piece.lost:
        typer.echo(f"warning: {piece.lost} rows without finite numbers were set aside", err=True)
    print(
        f"{piece.name}: {len(piece.points_mm)} points, cloud width {found.width_mm:.3g} mm"
        f" (4 sigma; full band {found.band_mm:.3g}),"
        f" {len(found.strays)} stray, {len(found.unordered)} unordered"
    )
    for number, curve in enumerate(descriptions(found)):
        print(f"{number}: {_line(curve)}")
    print("picture: add --out FOLDER or FILE.png" if out is None else f"written: {out}")


def _tell_json(piece: PlanarSlice, found: SectionFit, out: Path | None) -> None:
    from loftscan.sectioning import descriptions, summary

    for number, curve in enumerate(descriptions(found)):
        print(json.dumps({"event": "curve", "number": number, **curve}))
    done = {"event": "done", "name": piece.name, "out": None if out is None else str(out)}
    print(json.dumps({**done, "curves": len(found.curves), **summary(piece, found)}))


def _line(curve: dict[str, Any]) -> str:
    words = [
        f"{_shape(curve)}, {curve['length_mm']:.5g} mm long",
        f"{curve['control_points']} control points",
        f"sigma {curve['sigma_mm']:.3g} mm",
        f"residual rms {curve['residual_rms_mm']:.3g} mm of {curve['points']} points",
        f"95 % band ±{curve['band_95_median_mm']:.2g} mm, at most {curve['band_95_max_mm']:.2g}",
        _count(len(curve["gaps"]), "gap"),
    ]
    if curve["creases"]:
        words.append(_count(len(curve["creases"]), "corner"))
    if curve["outliers"]:
        words.append(_count(curve["outliers"], "outlier"))
    return ", ".join(words)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _shape(curve: dict[str, Any]) -> str:
    ends = "closed" if curve["closed"] else "open"
    if curve["ambiguous"]:
        ends = f"ambiguous, read as {ends}"
    words = f"{curve['kind']}, {ends}{', a hole' if curve['hole'] else ''}"
    if curve["crosses_itself"]:
        words += ", crosses itself"
    if "radius_mm" in curve:
        words += f", radius {curve['radius_mm']:.5g} mm"
    if "half_axes_mm" in curve:
        words += ", half axes {:.5g} and {:.5g} mm".format(*curve["half_axes_mm"])
    if "centre_mm" in curve:
        words += ", centre ({:.5g}, {:.5g}) mm".format(*curve["centre_mm"])
    return words
