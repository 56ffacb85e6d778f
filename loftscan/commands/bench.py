"""``loftscan home``, ``jog``, ``stop`` and ``profile``: the station by hand."""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from loftscan.commands.options import Debug, JsonLines
from loftscan.commands.running import fail, run

if TYPE_CHECKING:
    from collections.abc import Iterator

    from drivers.profiler import Profile
    from loftscan.station import Stand, Station

StationFile = Annotated[Path, typer.Argument(metavar="STATION.toml", help="The station.")]

_SHOWN_EVERY_S = 0.1  # faster than that nobody sees
_PICTURE_ROWS = 12


def home(
    station: StationFile,
    axis: Annotated[
        Literal["table", "stage", "both"], typer.Option(help="table, stage or both.")
    ] = "both",
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Find the axes' references.

    A table without a switch is 0 where it stands. Each run begins unhomed: jog and scan home, too.
    """

    def work() -> None:
        with _opened(station) as at:
            stand = at.home(axis)
        _tell(stand, json_lines=json_lines)

    run(work, debug=debug)


def jog(
    station: StationFile,
    table_deg: Annotated[float | None, typer.Option(help="Angle of the table.")] = None,
    stage_mm: Annotated[float | None, typer.Option(help="Position of the stage.")] = None,
    by: Annotated[bool, typer.Option("--by", help="By so much, from where it stands.")] = False,
    home_first: Annotated[
        bool, typer.Option("--home", help="Home the axis first: each run begins unhomed.")
    ] = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Move an axis; unhomed, only a table and only by a degree."""

    def work() -> None:
        from drivers.errors import Refused

        if table_deg is None and stage_mm is None:
            raise ValueError("jog: where to? add --table-deg or --stage-mm")
        with _opened(station) as at:
            try:
                if home_first:
                    at.home(_axis_of(table_deg, stage_mm))
                if by:
                    stand = at.jog_by(table_deg=table_deg or 0.0, stage_mm=stage_mm or 0.0)
                else:
                    stand = at.jog(table_deg=table_deg, stage_mm=stage_mm)
            except Refused as refused:
                if not home_first and "not homed" in str(refused):
                    refused.add_note("each run begins unhomed: add --home")
                raise
        _tell(stand, json_lines=json_lines)

    run(work, debug=debug)


def stop(station: StationFile, json_lines: JsonLines = False, debug: Debug = False) -> None:
    """Laser off, then both axes stopped; says what was read back."""

    def work() -> None:
        from dataclasses import asdict

        from acquisition.scan import StopRequest
        from loftscan.signals import ENDING, heeding
        from loftscan.station_files import station_of
        from loftscan.surveying import halt

        settings = station_of(station)
        # Whoever presses Ctrl-C now wants a stop, which is what goes on here.
        with heeding(dict.fromkeys(ENDING, StopRequest().now)):
            halts = halt(settings)
        for each in halts:
            if json_lines:
                print(json.dumps({"event": "stop", "ok": not each.trouble, **asdict(each)}))
            else:
                told = each.trouble.removeprefix(f"{each.role}: ")
                said = "; ".join(part for part in (each.said, told) if part)
                print(f"{each.role}: {said}")
        if failed := [each.role for each in halts if each.trouble]:
            fail(4, f"not seen to be at rest: {', '.join(failed)}; press the emergency stop")

    run(work, debug=debug)


def profile(
    station: StationFile,
    count: Annotated[int, typer.Option(help="Profiles to show; 0: until Ctrl-C.", min=0)] = 1,
    csv: Annotated[Path | None, typer.Option(help="Write the points to this new file.")] = None,
    png: Annotated[Path | None, typer.Option(help="Draw the last one into this new file.")] = None,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Show what the sensor sees; the laser is on meanwhile."""

    def work() -> None:
        from loftscan.profile_view import plot, table

        for file in (csv, png):
            if file is not None and file.exists():
                raise ValueError(f"{file}: is there already; name another file")
        seen: list[Profile] = []
        _show(station, count, seen, json_lines=json_lines)
        if csv is not None:
            csv.write_text(table(seen if count else seen[-1:]), encoding="utf-8")
        if png is not None and seen:
            png.write_bytes(plot(seen[-1]))

    run(work, debug=debug)


def _show(station: Path, count: int, seen: list[Profile], *, json_lines: bool) -> None:
    """Show profiles while the laser is on; without a count Ctrl-C is the way to end it."""
    from acquisition.errors import Stopped
    from acquisition.safety.promises import promise_of_guard

    view = _View(json_lines=json_lines)
    try:
        with _opened(station) as at:
            if not json_lines:
                print(at.devices.guarantee.sentence, flush=True)
                print(promise_of_guard(at.devices.guarded), flush=True)
                at.devices.safety.announce = print
            with at.lit() as look:
                shown_s = 0.0
                while not count or len(seen) < count:
                    found = look()
                    if count or time.monotonic() - shown_s >= _SHOWN_EVERY_S:
                        shown_s = time.monotonic()
                        view.show(found)
                    seen[:] = [*seen, found] if count else [found]
    except Stopped:
        if count:
            raise


class _View:
    """Where profiles are shown; on a terminal each over the one before."""

    def __init__(self, *, json_lines: bool) -> None:
        self._json_lines = json_lines
        self._terminal = sys.stdout.isatty() and not json_lines
        self._lines = 0

    def show(self, found: Profile) -> None:
        from dataclasses import asdict

        from loftscan.profile_view import Glyphs, numbers, picture, sentence

        said = numbers(found)
        if self._json_lines:
            print(json.dumps({"event": "profile", **asdict(said)}), flush=True)
            return
        columns = shutil.get_terminal_size().columns - 1
        glyphs = Glyphs.BRAILLE if self._terminal else Glyphs.ASCII
        lines = picture(found.points_mm, min(columns, 100), _PICTURE_ROWS, glyphs)
        lines.append(sentence(said)[: columns if self._terminal else None])
        again = f"\x1b[{self._lines}A" if self._terminal and self._lines else ""
        clear = "\x1b[K" if self._terminal else ""
        print(again + "\n".join(line + clear for line in lines), flush=True)
        self._lines = len(lines)


@contextmanager
def _opened(station: Path) -> Iterator[Station]:
    """The station; who stops it by a signal is told how it was left."""
    from acquisition.errors import Stopped
    from loftscan.station import Station
    from loftscan.station_files import station_of

    settings = station_of(station)
    try:
        with Station.open(settings) as opened:
            yield opened
    # A signal: Ctrl-C, or SIGTERM and SIGHUP, which the station's attention raises as SystemExit.
    except (KeyboardInterrupt, SystemExit) as asked:
        raise Stopped("stopped by the operator; the laser is off, the axes stand") from asked


def _axis_of(table_deg: float | None, stage_mm: float | None) -> Literal["table", "stage", "both"]:
    if table_deg is None:
        return "stage"
    return "table" if stage_mm is None else "both"


def _tell(stand: Stand, *, json_lines: bool) -> None:
    told = {
        "table_deg": _rounded(stand.table_deg),
        "stage_mm": _rounded(stand.stage_mm),
        "table_homed": stand.table.homed,
        "stage_homed": stand.stage.homed,
        "laser_on": stand.laser_on,
    }
    if json_lines:
        print(json.dumps({"event": "stand", **told}))
        return
    homed = {True: "homed", False: "not homed"}
    print(f"table: {stand.table_deg:.3f} deg, {homed[stand.table.homed]}")
    print(f"stage: {stand.stage_mm:.3f} mm, {homed[stand.stage.homed]}")


def _rounded(position: float) -> float | None:
    """JSON has no NaN: an axis in alarm has no position."""
    return None if math.isnan(position) else round(position, 4)
