"""A result, saved and told: what `reconstruct` and `demo` end with."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from loftscan.cad_files import CadWriter
    from loftscan.progress import Progress
    from loftscan.result import Result

_BEGUN = time.monotonic()


def writable_formats(wanted: str | None) -> tuple[str, ...]:
    """The formats to write; those that cannot be written by default are said."""
    from loftscan.result import USUAL_FORMATS, choose_formats

    if wanted is not None:
        return choose_formats(wanted.split(","))
    chosen = choose_formats(None)
    left_out = [each for each in USUAL_FORMATS if each not in chosen]
    if left_out:
        typer.echo(
            f"warning: {' and '.join(left_out)} left out, their libraries are not installed: "
            "pip install 'loftscan[cad]'",
            err=True,
        )
    return chosen


def save(
    result: Result,
    out: Path,
    formats: tuple[str, ...],
    cad: CadWriter,
    progress: Progress,
    *,
    overwrite: bool,
    json_lines: bool,
) -> None:
    """Write the result folder, told as progress."""

    def remark(words: str) -> None:
        if json_lines:
            print(json.dumps({"event": "remark", "warning": words}, ensure_ascii=False))
        else:
            typer.echo(f"warning: {words}", err=True)

    progress("saving", 0, 1)
    result.save(out, formats=formats, overwrite=overwrite, cad=cad, remark=remark)
    progress("saving", 1, 1)


def tell(result: Result, out: Path, *, json_lines: bool) -> None:
    """Say what came out, in a few lines or in one JSON object."""
    from loftscan.shape_findings import tell_shapes

    numbers = result.metrics
    if json_lines:
        done = {"event": "done", "out": str(out), "warnings": result.warnings, **numbers}
        print(json.dumps(done, ensure_ascii=False))
        return
    for warning in result.warnings:
        typer.echo(f"warning: {warning}", err=True)
    state = "watertight" if numbers["watertight"] else "NOT watertight"
    if numbers.get("surface_open"):
        state = "an open surface, no solid"
    print(
        f"{result.name}: {numbers['points_in']} points, {numbers['sections']} of "
        f"{numbers['slices']} slices became sections, {numbers['patches']} patches"
    )
    print(
        f"mesh: {numbers['faces']} faces, {state}; "
        f"residual rms {numbers['residual_rms_mm'] or math.nan:.3g} mm "
        f"of {numbers['residual_points']} points, cloud width {numbers['thickness_mm']:.3g} mm"
    )
    for sentence in tell_shapes(result.reconstruction):
        print(f"shape: {sentence}")
    verdict = result.deviation.verdict
    if verdict is not None:
        print(f"tolerance: {verdict.share_within:.2%} within {verdict.tolerance_mm:g} mm")
    whole = time.monotonic() - _BEGUN
    print(
        f"time: {numbers['seconds']:.1f} s, {whole:.1f} s with saving; "
        f"peak memory {numbers['peak_memory_mb']:.0f} MB"
    )
    print(f"report: {out / 'report.html'}")
