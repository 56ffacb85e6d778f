"""``loftscan compare``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated

import typer

from loftscan.commands.options import Debug, JsonLines, Out, Overwrite, Tolerance, UnitName, choice
from loftscan.commands.running import fail, run


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
    """Measure how far A lies from B: map, numbers, verdict.

    Out of tolerance is exit code 1.
    """

    def work() -> None:
        from loftscan.comparing import MARKS, compare_things
        from loftscan.inputs import Unit
        from loftscan.result import check_output
        from reconstruction.comparison import Align

        check_output(out, overwrite=overwrite, marks=MARKS)
        found = compare_things(
            a, b,
            align=choice(Align, align, "--align"),
            tolerance_mm=tolerance_mm,
            unit=choice(Unit, unit, "--unit"),
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
            fail(1, f"out of tolerance: {verdict.share_within:.2%} within {tolerance_mm:g} mm")

    run(work, debug=debug)
