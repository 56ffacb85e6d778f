"""``loftscan preview``."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug, JsonLines
from loftscan.commands.running import run

if TYPE_CHECKING:
    from acquisition.frames import Kinematics
    from acquisition.station import Station
    from loftscan.previewing import Preview


def preview(
    station: Annotated[Path, typer.Argument(metavar="STATION.toml", help="The station.")],
    plan: Annotated[Path, typer.Argument(metavar="PLAN.toml", help="What is to be scanned.")],
    region: Annotated[
        str | None,
        typer.Option(help="A cylinder about the axis, on the plate: RADIUS,HEIGHT in mm."),
    ] = None,
    part: Annotated[
        Path | None, typer.Option(help="Instead: a mesh in mm, as it will stand on the plate.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the picture, a .png.")] = None,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Tell what a plan will see, how long it takes, what it keeps."""

    def work() -> None:
        from loftscan.previewing import parse_region, part_surface
        from loftscan.previewing import preview as foresee
        from loftscan.previewing import region as cylinder
        from loftscan.station_files import plan_of, station_of

        if (region is None) == (part is None):
            raise ValueError(
                "preview: what is to be seen? give either --region RADIUS,HEIGHT or --part MESH"
            )
        if out is not None and out.suffix != ".png":
            raise ValueError(f"--out {out}: the picture is a .png; name it so")
        settings, wanted = station_of(station), plan_of(plan)
        where = part_surface(part) if part is not None else cylinder(*parse_region(str(region)))
        found = foresee(settings, wanted, _kinematics(settings, station), *where, name=str(plan))
        if out is not None:
            from loftscan import figures
            from loftscan.preview_picture import preview_figure

            out.write_bytes(figures.png(preview_figure(found)))
        _tell(found, out, json_lines=json_lines)

    run(work, debug=debug)


def _kinematics(settings: Station, file: Path) -> Kinematics:
    """The calibration in force; a preview may go by a ruler's where there is none."""
    from acquisition.calibration_in_force import in_force

    why = "a preview, nothing is measured"
    return in_force(settings, file.parent, datetime.now(UTC), override=why).kinematics


def _tell(found: Preview, out: Path | None, *, json_lines: bool) -> None:
    from loftscan.previewing import WORDS, Seen
    from loftscan.scan_folders import in_bytes
    from loftscan.scan_progress import in_time

    cost, heights = found.cost, found.heights_mm
    if json_lines:
        distances = found.distances_mm.tolist() if heights else None
        print(
            json.dumps(
                {"event": "preview", "share": found.share, "shares": found.shares(),
                 "heights_mm": heights, "distances_mm": distances, "slices": cost.slices,
                 "profiles": cost.profiles, "seconds_at_least": cost.seconds_at_least,
                 "bytes_at_most": cost.bytes_at_most}
            )
        )  # fmt: skip
        return
    print(
        f"{cost.slices} slices, {cost.profiles} profiles, at least"
        f" {in_time(cost.seconds_at_least)}, at most {in_bytes(cost.bytes_at_most)}"
    )
    for fate in reversed(Seen):
        if share := float((found.fate == fate).mean()):
            print(f"{share:7.1%}  {WORDS[fate]}")
    if heights is not None:
        view, (least, most) = found.view, found.distances_mm
        print(
            f"heights {heights[0]:.4g} to {heights[1]:.4g} mm, at {least:.4g} to {most:.4g} mm from"
            f" the sensor (it measures {view.near_mm:g} to {view.far_mm:g})"
        )
    if out is not None:
        print(f"picture: {out}")
