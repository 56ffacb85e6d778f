"""``loftscan scan``."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug, JsonLines
from loftscan.commands.running import fail, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from acquisition.safety.promises import Attendance
    from acquisition.scan import PartStands, StopRequest
    from drivers.links import ByteLink
    from loftscan.scan_folders import Prospect
    from loftscan.scan_progress import Manner, ScanTeller
    from loftscan.wire_logs import WireLogs


def scan(
    station: Annotated[Path, typer.Argument(metavar="STATION.toml", help="The station.")],
    plan: Annotated[Path, typer.Argument(metavar="PLAN.toml", help="What to scan.")],
    out: Annotated[Path, typer.Option(help="The .scan folder; it must not exist yet.")],
    resume: Annotated[
        bool, typer.Option("--resume", help="Take the slices that are missing in --out.")
    ] = False,
    at_zero: Annotated[
        bool,
        typer.Option(
            "--at-zero",
            help="With --resume: the table stands where the scan began (for a software zero).",
        ),
    ] = False,
    attended: Annotated[
        bool,
        typer.Option(
            "--attended",
            help="Somebody stays at the station: for a laser that no watchdog turns off.",
        ),
    ] = False,
    override: Annotated[
        str | None,
        typer.Option(help="Why to scan without a calibration that holds; kept in the record."),
    ] = None,
    wire_log: Annotated[
        Path | None,
        typer.Option(help="Write every byte both ways, to a file of this name for each link."),
    ] = None,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Scan slice by slice into a .scan folder. Ctrl-C pauses after the slice, twice stops now."""

    def work() -> None:
        if at_zero and not resume:
            raise ValueError("--at-zero: says where a resumed scan stands; add --resume")
        from signal import SIGHUP, SIGINT, SIGTERM

        from acquisition.calibration_in_force import in_force
        from acquisition.scan import PartStands, StopRequest
        from loftscan.scan_folders import prospect
        from loftscan.scan_progress import ScanTeller
        from loftscan.signals import heeding
        from loftscan.station_files import plan_of, station_of
        from loftscan.wire_logs import WireLogs

        settings, wanted = station_of(station), plan_of(plan)
        held = in_force(settings, station.parent, datetime.now(UTC), override=override)
        here = prospect(settings, wanted, out, resume=resume, plan_name=str(plan), in_force=held)
        logs = None if wire_log is None else WireLogs(wire_log)
        stop = StopRequest()
        # From before the first device is opened until the last is closed, and the folder with it.
        with heeding({SIGINT: stop.ask, SIGTERM: stop.now, SIGHUP: stop.now}):
            teller = ScanTeller(sys.stdout, _manner(json_lines), held.kinematics, stop)
            teller.estimate(here)
            if held.override:
                teller.note(f"calibration overridden: {held.override}")
            part = PartStands.AT_ZERO if at_zero else PartStands.ANYWHERE
            with _telling_how_to_resume(here, f"{station} {plan}", teller):
                if not here.whole:
                    _take(here, stop, part, teller, logs, _attendance(attended))
                else:
                    _only_finish(here)
            _tell_the_end(here, f"{station} {plan}", teller)

    run(work, debug=debug)


def _take(
    here: Prospect,
    stop: StopRequest,
    part: PartStands,
    teller: ScanTeller,
    logs: WireLogs | None,
    attendance: Attendance,
) -> None:
    """Open the station, take what is missing, keep it; at rest and closed on every way out."""
    from acquisition.opening import open_station
    from acquisition.resuming import take_missing
    from acquisition.safety.promises import Attendance, must_be_attended
    from acquisition.scan_record import State
    from loftscan.scanning import begin

    with _links(logs, teller) as links, open_station(here.station, links=links) as devices:
        must_be_attended(devices.guarantee, attendance)
        devices.safety.attend(attended=attendance is Attendance.PRESENT)
        teller.laser(devices.guarantee, devices.guarded)
        devices.safety.announce = teller.note
        with begin(here, devices, stop) as writer:
            for damage in writer.set_aside:
                teller.note(f"{damage.file}: set aside ({damage.why}); the slice is taken again")
            for sweep in take_missing(
                devices, here.plan, writer.folder, stop=stop, part=part,
                progress=teller.stopped_at, compared=teller.compared, tell=teller.note,
            ):  # fmt: skip
                writer.append(sweep)
                teller.kept(sweep)
            writer.finish(State.COMPLETE if writer.folder.is_whole() else State.ABORTED)


def _only_finish(here: Prospect) -> None:
    """Every slice is there; a program that died may not have said so."""
    from acquisition.scan_record import State
    from acquisition.scanfile import ScanFolder

    with ScanFolder.open(here.out).resume() as writer:
        writer.finish(State.COMPLETE)


def _tell_the_end(here: Prospect, files: str, teller: ScanTeller) -> None:
    from acquisition.scanfile import ScanFolder

    folder = ScanFolder.open(here.out)
    kept = len(folder.indices())
    if folder.is_whole():
        teller.done(here, kept)
        return
    teller.paused(here, kept)
    most = "at most " if here.plan.adaptive else ""
    fail(
        3,
        f"paused: {kept} of {most}{here.plan.most} slices are kept, the laser is off, the axes"
        f" stand; go on with: loftscan scan {files} --out {here.out} --resume",
    )


@contextmanager
def _links(logs: WireLogs | None, teller: ScanTeller) -> Iterator[Callable[[str], ByteLink]]:
    from drivers.links import open_link

    if logs is None:
        yield open_link
        return
    try:
        yield logs.open
    finally:
        for failure in logs.failures:
            typer.echo(f"warning: {failure}", err=True)
        teller.note(f"wire logs: {', '.join(str(file) for file in logs.files)}")


@contextmanager
def _telling_how_to_resume(here: Prospect, files: str, teller: ScanTeller) -> Iterator[None]:
    from acquisition.errors import AcquisitionError, ZeroLost
    from acquisition.scanfile import ScanFolder
    from drivers.errors import DriverError

    try:
        yield
    except (AcquisitionError, DriverError) as error:
        teller.end_line()
        if isinstance(error, ZeroLost):
            error.add_note("--at-zero says so")
        elif (here.out / "scan.json").exists():
            count, kept = here.plan.most, len(ScanFolder(here.out).indices())
            error.add_note(
                f"{kept} of {count} slices are kept, go on with: loftscan scan {files}"
                f" --out {here.out} --resume"
            )
        raise


def _attendance(attended: bool) -> Attendance:
    from acquisition.safety.promises import Attendance

    return Attendance.PRESENT if attended else Attendance.NOBODY


def _manner(json_lines: bool) -> Manner:
    from loftscan.scan_progress import Manner

    if json_lines:
        return Manner.JSON
    return Manner.LIVE if sys.stdout.isatty() else Manner.LINES
