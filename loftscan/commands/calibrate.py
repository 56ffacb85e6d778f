"""``loftscan calibrate``."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug, JsonLines
from loftscan.commands.running import run

if TYPE_CHECKING:
    from collections.abc import Sequence

    from acquisition.station import Station
    from loftscan.calibrating.artefact import Artefact
    from loftscan.calibrating.joint import Calibrated
    from loftscan.calibrating.model import Seen

_WHY = "scans an artefact, to calibrate the station or to check it"


def calibrate(
    station: Annotated[Path, typer.Argument(metavar="STATION.toml", help="The station.")],
    artefact: Annotated[Path, typer.Argument(metavar="ARTEFACT.toml", help="What stands on it.")],
    plan: Annotated[
        Path | None, typer.Option(help="Scan the artefact so; absent: only --scan is read.")
    ] = None,
    scan: Annotated[
        list[Path] | None, typer.Option(help="A .scan of it, kept before; may be repeated.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The calibration; by default where station.toml says.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Folder for report and pictures.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Solve nothing: has the station drifted?")
    ] = False,
    attended: Annotated[
        bool, typer.Option("--attended", help="Somebody stays at the station.")
    ] = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Find where the laser stands, from scans of an artefact."""

    def work() -> None:
        from loftscan.calibrating.artefact import read_artefact
        from loftscan.calibrating.joint import must_be_level
        from loftscan.station_files import station_of

        settings, what = station_of(station), read_artefact(artefact)
        where = out or station.parent / settings.calibration.file
        folder = report or where.with_name(f"{where.stem}-report")
        folders = [*(scan or ())]
        if not check:
            must_be_level(settings.kinematics)  # before an artefact is scanned for nothing
        if plan is not None:
            folders.append(_taken(station, plan, where, attended=attended))
        if not folders:
            raise ValueError("calibrate: nothing to solve from; give --plan, or --scan")
        seen = _seen(folders, settings)
        if check:
            _check(seen, what, where, settings, folder, json_lines=json_lines)
        else:
            _solve(seen, what, where, settings, folder, folders, json_lines=json_lines)

    run(work, debug=debug)


def _taken(station: Path, plan: Path, where: Path, *, attended: bool) -> Path:
    """Scan the artefact into a folder of its own."""
    from acquisition.safety.promises import Attendance
    from loftscan.scanning import scan
    from loftscan.station import Station

    stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    folder = where.with_name(f"{where.stem}-{stamp}.scan")
    attendance = Attendance.PRESENT if attended else Attendance.NOBODY
    with Station.open(station) as opened:
        for _ in scan(opened, plan, out=folder, attendance=attendance, override=_WHY):
            pass
    return folder


def _seen(folders: Sequence[Path], settings: Station) -> Seen:
    """Read the points of all scans; refuse those of another station."""
    from acquisition.calibration import deciding_keys
    from acquisition.scanfile import ScanFolder
    from loftscan.calibrating.joint import seen_in

    scans = []
    for each in folders:
        kept = ScanFolder.open(each)
        before, now = deciding_keys(kept.record().station), deciding_keys(settings)
        changed = [key for key in now if before.get(key) != now[key]]
        if changed:
            raise ValueError(
                f"{each}: was scanned on another station: {changed[0]} was"
                f" {before.get(changed[0])}, is {now[changed[0]]}; scan anew with --plan"
            )
        scans.append([kept.read(index) for index in kept.indices()])
    return seen_in(scans)


def _solve(
    seen: Seen,
    artefact: Artefact,
    where: Path,
    settings: Station,
    folder: Path,
    scans: Sequence[Path],
    *,
    json_lines: bool,
) -> None:
    from acquisition.calibration import write_calibration
    from acquisition.durable import write_whole
    from loftscan.calibrating.errors import CalibrationRefused
    from loftscan.calibrating.joint import calibrate
    from loftscan.calibrating.telling import lines, made, must_hold

    found = calibrate(seen, settings.kinematics, artefact)
    refused: CalibrationRefused | None = None
    try:
        must_hold(found, settings)
    except CalibrationRefused as why:
        refused = why
    _report(found, refused, folder)
    if not json_lines and found.solution.points:
        print("\n".join(lines(found)))
        print(f"report: {folder / 'report.html'}")
    if refused is not None:
        raise refused
    names = [str(each) for each in scans]
    text = write_calibration(made(found, settings, artefact, names, datetime.now(UTC)))
    write_whole(where, text.encode())
    if json_lines:
        print(json.dumps({"event": "calibrated", "file": str(where), "report": str(folder)}))
    else:
        print(f"{where}: written; scans of this station use it")


def _report(found: Calibrated, refused: Exception | None, folder: Path) -> None:
    from loftscan.calibrating.residual_plots import draw
    from loftscan.calibrating.telling import write_report

    folder.mkdir(parents=True, exist_ok=True)
    if found.solution.points:
        amplitudes = draw(found.solution, folder)
        write_report(found, amplitudes, None if refused is None else str(refused), folder)


def _check(
    seen: Seen,
    artefact: Artefact,
    where: Path,
    settings: Station,
    folder: Path,
    *,
    json_lines: bool,
) -> None:
    from acquisition.calibration import read_calibration
    from loftscan.calibrating.drift import draw_trend, drift, remember
    from loftscan.calibrating.errors import Drifted

    calibration = read_calibration(where)
    found = drift(seen, calibration, artefact, datetime.now(UTC))
    limit_mm = settings.calibration.drift_limit_mm
    folder.mkdir(parents=True, exist_ok=True)
    trend = remember(found, where.with_name(f"{where.stem}-trend.jsonl"))
    draw_trend(trend, limit_mm, folder / "trend.png")
    if json_lines:
        print(json.dumps({"event": "checked", "excess_mm": found.excess_mm,
                          "spacings_mm": found.spacings_mm, "checks": len(trend)}))  # fmt: skip
    else:
        print(
            f"noise {1e3 * found.sigma_mm:.1f} um, {1e3 * found.excess_mm:.1f} um above that of the"
            f" calibration; {len(trend)} checks: {folder / 'trend.png'}"
        )
        for name, off_mm, sd_mm in found.spacings_mm:
            print(f"spacing {name}: {1e3 * off_mm:+.1f} um (sd {1e3 * sd_mm:.1f})")
    if (off := found.beyond(limit_mm)) is not None:
        raise Drifted(
            f"{where}: drifted: {off}, and calibration.drift_limit_mm is {limit_mm:g}; see what"
            " has moved, then calibrate anew"
        )
