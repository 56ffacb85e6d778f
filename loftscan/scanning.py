"""The verb `scan`: the slices of a plan, one by one as they are taken, kept where that is asked.

    >>> with Station.open("station.toml") as station:
    ...     for sweep in scan(station, "plan.toml", out="vase.scan"):
    ...         print(sweep.index, len(sweep.profiles))

A .scan folder that was cut short is gone on with by ``resume=True``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from acquisition.calibration_in_force import in_force
from acquisition.errors import Stopped
from acquisition.frames import Kinematics
from acquisition.loop_closure import Closure
from acquisition.opening import OpenStation
from acquisition.patterns import SliceKind
from acquisition.plan import Plan, check_plan, read_plan
from acquisition.planes import check_sheet
from acquisition.poses import Sweep
from acquisition.resuming import take_missing
from acquisition.safety.leading import known
from acquisition.safety.promises import Attendance, must_be_attended
from acquisition.scan import PartStands, Progress, StopRequest, Wish
from acquisition.scan import scan as take
from acquisition.scan_record import State
from acquisition.scanfile import ScanWriter
from loftscan.scan_folders import Prospect, prospect
from loftscan.signals import Attention
from loftscan.station import Station


class Scan:
    """Sweeps as they are taken, lowest first; made by `scan`.

    Between two sweeps the laser is off and nothing moves. It ends with its station's block, or when
    it is closed: then its folder says aborted, and can be resumed.
    """

    def __init__(
        self,
        sweeps: Generator[Sweep],
        plan: Plan,
        kinematics: Kinematics,
        stop: StopRequest,
        attention: Attention,
        keeping: ExitStack,
    ) -> None:
        self.kinematics = kinematics  # takes the sweeps' points to the part
        self.plan = plan
        self._sweeps = sweeps
        self._stop = stop
        self._attention = attention
        self._keeping = keeping

    @property
    def kind(self) -> SliceKind:
        """What the sweeps are: rings, meridians or stripes."""
        return self.plan.kind

    @property
    def total(self) -> int:
        """How many sweeps there will be, those kept before among them; if adaptive, at most."""
        return self.plan.most

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Sweep:
        """Take the next slice.

        Raises
        ------
        DriverError, AcquisitionError
            The laser is off and the axes are stopped; what was kept is safe.
        """
        try:
            with self._attention.at_work(self._stop):
                return next(self._sweeps)
        except BaseException:  # the end of the sweeps is one, too
            self.close()
            raise

    def close(self) -> None:
        """Take no more; may be called again."""
        self._sweeps.close()
        self._keeping.close()


def scan(
    station: Station,
    plan: Plan | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    part: PartStands = PartStands.ANYWHERE,
    attendance: Attendance = Attendance.NOBODY,
    override: str | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    compared: Callable[[Closure], None] = lambda _: None,
    tell: Callable[[str], None] = lambda _: None,
) -> Scan:
    """Scan a plan, slice by slice.

    Parameters
    ----------
    plan
        A `acquisition.plan.Plan`, such as ``ring(...)`` makes, or a plan.toml. An adaptive one
        needs `out`, and somebody who reconstructs it meanwhile: docs/adaptive.md.
    out
        A .scan folder, new: each sweep is safe on the disk before it is yielded.
    resume
        Take the slices that are missing in `out`. Those kept are yielded, too, read back, so that
        the loop sees every slice once and in order.
    part
        Needed to resume where the table's zero is where it stands when it is homed.
    attendance
        Whether somebody stays at the station: needed for a laser that no watchdog turns off.
    override
        Why to scan without a calibration that holds; the words are kept in the scan's record.
    progress
        Told after every stop of the table.
    compared
        Told how a kept slice, taken again by a resume, lies to it.
    tell
        Told what a person should know of the choice of slices.

    Raises
    ------
    ValueError, AcquisitionError
        At once: the plan leaves the soft limits, there is no calibration that holds, the folder is
        there or does not fit the disk.
    """
    wanted = plan if isinstance(plan, Plan) else read_plan(Path(plan))
    name = "plan" if isinstance(plan, Plan) else str(plan)
    check_plan(wanted, station.settings, name)
    must_be_attended(station.devices.guarantee, attendance)
    station.devices.safety.attend(attended=attendance is Attendance.PRESENT)
    held = in_force(station.settings, station.folder, datetime.now(UTC), override=override)
    check_sheet(wanted, held.kinematics, name)
    stop = StopRequest()

    station.end_work()
    with ExitStack() as keeping:
        if out is None:
            if resume:
                raise ValueError("resume needs out, the .scan folder to go on with")
            if wanted.adaptive is not None:
                raise ValueError(
                    f"{name}: adaptive: reconstruction reads the slices from a .scan folder; give"
                    " out, or a plan without [adaptive]"
                )
            sweeps = take(station.devices, wanted, stop=stop, part=part, progress=progress)
        else:
            here = prospect(
                station.settings, wanted, Path(out), resume=resume, plan_name=name, in_force=held
            )
            with station.attention.at_work(stop):
                writer = keeping.enter_context(begin(here, station.devices, stop))
            missing = take_missing(
                station.devices, wanted, writer.folder, stop=stop, part=part,
                progress=progress, compared=compared, tell=tell,
            )  # fmt: skip
            sweeps = _kept(missing, writer)
        made = Scan(sweeps, wanted, held.kinematics, stop, station.attention, keeping.pop_all())
    station.begin(made)
    return made


def begin(here: Prospect, devices: OpenStation, stop: StopRequest) -> ScanWriter:
    """Make or reopen the folder, now that every device has said who it is.

    Raises
    ------
    DriverError
        A device did not; there is no new folder then.
    Stopped
        Somebody asked for it meanwhile; likewise.
    """
    for device in (devices.laser, devices.profiler, devices.table, devices.stage):
        device.identify()
        if stop.wish is not Wish.GO_ON:
            raise Stopped("stopped before anything moved; nothing was written")
    known(devices)
    devices.guard.report_to(here.out.with_suffix(".guard.jsonl"))
    return here.begin(datetime.now(UTC))


def _kept(taken: Generator[Sweep], writer: ScanWriter) -> Generator[Sweep]:
    """Every slice of the plan in order: read back where it is kept, else taken and kept.

    Of an adaptive plan those that are kept come first, and then the others as they are chosen.
    """
    folder = writer.folder
    missing = set(folder.missing())
    decided = folder.decided()
    adaptive = folder.record().plan.adaptive is not None
    with closing(taken):
        for index in decided:
            if index not in missing:
                yield folder.read(index)
            elif not adaptive:
                sweep = next(taken)
                writer.append(sweep)
                yield sweep
        if adaptive:
            for sweep in taken:
                writer.append(sweep)
                yield sweep
    writer.finish(State.COMPLETE if folder.is_whole() else State.ABORTED)
