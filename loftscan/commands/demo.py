"""``loftscan demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loftscan.commands.options import Debug, JsonLines, Overwrite
from loftscan.commands.outcome import save, tell, writable_formats
from loftscan.commands.running import run


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

        wanted = writable_formats(None)
        check_output(out, overwrite=overwrite)
        with bars(json_lines=json_lines) as progress, CadWriter(wanted) as cad:
            result = reconstruct_with(make_cloud(seed), Settings(), progress=progress, name="vase")
            save(result, out, wanted, cad, progress, overwrite=overwrite)
        tell(result, out, json_lines=json_lines)

    run(work, debug=debug)
