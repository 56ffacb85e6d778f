"""``loftscan scans list | verify | repair | export``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug, JsonLines, Overwrite
from loftscan.commands.running import fail, run

if TYPE_CHECKING:
    from acquisition.scanfile import Verification
    from loftscan.kept_scans import KeptScan

app = typer.Typer(
    help="List, verify, repair and export .scan folders.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)

ScanPath = Annotated[Path, typer.Argument(metavar="SCAN", help="A .scan folder.")]


@app.command(name="list")
def list_scans(
    place: Annotated[
        Path, typer.Argument(metavar="[FOLDER]", help="Where to look, below it, too.")
    ] = Path(),
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """List the scans under a folder: date, plan, slices, size, and how each stands."""

    def work() -> None:
        from loftscan.kept_scans import kept_scans

        found = kept_scans(place)
        if json_lines:
            for each in found:
                print(json.dumps({"event": "scan", **each.as_json()}))
        elif not found:
            print(f"{place}: no .scan folder here or below")
        else:
            _tell_list(found)

    run(work, debug=debug)


@app.command()
def verify(scan: ScanPath, json_lines: JsonLines = False, debug: Debug = False) -> None:
    """Read every slice in full against its checksums; writes nothing."""

    def work() -> None:
        from acquisition.scanfile import ScanFolder

        found = ScanFolder.open(scan).verify()
        _tell_verified(scan, found, json_lines=json_lines)
        if found.damaged:
            fail(
                1,
                f"{scan}: {len(found.damaged)} of {len(found.damaged) + len(found.sound)} slices"
                f" are damaged; mend what can be mended: loftscan scans repair {scan}",
            )

    run(work, debug=debug)


@app.command()
def repair(scan: ScanPath, json_lines: JsonLines = False, debug: Debug = False) -> None:
    """Rebuild what can be proven, set the rest aside, delete nothing; say what was done."""

    def work() -> None:
        from acquisition.repair import repair as mend

        done = mend(scan)
        for each in done.mendings:
            if json_lines:
                print(json.dumps({"event": "mended", "file": str(each.file), "done": each.done}))
            else:
                print(f"{each.file.relative_to(scan)}: {each.done}")
        if not done.mendings and not json_lines:
            print(f"{scan}: nothing to repair")
        _tell_verified(scan, done.left, json_lines=json_lines)

    run(work, debug=debug)


@app.command()
def export(
    scan: ScanPath,
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Ends in .nxs, .h5, .ply, .e57, .xyz or .las.")
    ],
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Write a scan in an exchange format, with unit, frame and provenance in its header."""

    def work() -> None:
        from loftscan.scan_exports import export_scan

        done = export_scan(scan, out, overwrite=overwrite)
        for index, why in done.left_out:
            typer.echo(f"warning: slice {index} left out ({why})", err=True)
        if json_lines:
            told = {"points": done.points, "slices": done.slices, "unit": done.unit}
            print(json.dumps({"event": "exported", "out": str(out), **told}))
        else:
            print(f"{out}: {done.points} points of {done.slices} slices, in {done.unit}")

    run(work, debug=debug)


def _tell_list(found: tuple[KeptScan, ...]) -> None:
    from loftscan.scan_folders import in_bytes

    width = max(len(str(each.path)) for each in found)
    for each in found:
        created = each.created[:16].replace("T", " ")
        print(
            f"{each.path!s:<{width}}  {created:<16}  {each.slices:>5} of {each.expected:<5}"
            f"  {in_bytes(each.bytes):>7}  {each.standing.value:<13}"
            f"  {each.trouble or f'{each.plan}, {each.station}'}".rstrip()
        )


def _tell_verified(scan: Path, found: Verification, *, json_lines: bool) -> None:
    if json_lines:
        damaged = [{"file": each.file.name, "why": each.why} for each in found.damaged]
        print(
            json.dumps(
                {
                    "event": "verified", "sound": len(found.sound), "damaged": damaged,
                    "missing": found.missing, "no_checksum": found.unchecked,
                }
            )
        )  # fmt: skip
        return
    for each in found.damaged:
        print(f"{each.file.relative_to(scan)}: damaged: {each.why}")
    parts = [f"{len(found.sound)} slices are sound"]
    if found.unchecked:
        parts.append(f"{len(found.unchecked)} of them have no checksum (an older program's)")
    if found.missing:
        parts.append(f"{len(found.missing)} of the plan are missing")
    print(f"{scan}: {', '.join(parts)}")
