"""``loftscan register``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from loftscan.commands.options import Debug, JsonLines, Out, Overwrite, UnitName, choice
from loftscan.commands.running import run


def register(
    a: Annotated[Path, typer.Argument(metavar="A", help="A .scan folder or a cloud.")],
    b: Annotated[
        Path,
        typer.Argument(metavar="B", help="The same part, turned over or moved; is laid onto A."),
    ],
    out: Out,
    near: Annotated[
        str | None,
        typer.Option(
            help="Roughly how B is to be turned, RX,RY,RZ in degrees: 180,0,0 is half a turn"
            " about x. By default every turn is tried."
        ),
    ] = None,
    unit: UnitName = "mm",
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Merge two views of a part that was turned over."""

    def work() -> None:
        from loftscan.inputs import Unit
        from loftscan.interruption import interruptible
        from loftscan.progress import bars
        from loftscan.registering import MARKS, parse_near
        from loftscan.registering import register as merge
        from loftscan.result import check_output

        check_output(out, overwrite=overwrite, marks=MARKS)
        wanted = choice(Unit, unit, "--unit")
        turn = None if near is None else parse_near(near)
        with interruptible() as interruption, bars(json_lines=json_lines) as shown:
            progress = interruption.heeding(shown)
            found = merge(a, b, near_deg=turn, unit=wanted.value, progress=progress)
        found.save(out, overwrite=overwrite)
        if json_lines:
            print(json.dumps({"event": "done", "out": str(out), **found.metrics}))
            return
        one = found.registration
        print(
            f"{found.second.name} laid on {found.first.name}: turned by"
            f" {found.metrics['turn_deg']:.4g} deg; residual {one.rms_mm:.3g} mm rms at"
            f" {int(one.counted.sum())} places; overlap {one.overlap[0]:.0%} and"
            f" {one.overlap[1]:.0%}; sd {max(found.metrics['sd_turn_deg']):.2g} deg,"  # type: ignore[call-overload]
            f" {max(found.metrics['sd_shift_mm']):.2g} mm"  # type: ignore[call-overload]
        )
        print(f"report: {out / 'report.html'}")
        print(
            f"next: loftscan reconstruct {out / 'merged.ply'} --spacing-mm {found.spacing_mm:g}"
            " --out RESULT"
        )

    run(work, debug=debug)
