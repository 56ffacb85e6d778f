"""A scan: slices, one sweep after the other; the laser on only while it exposes.

One stop of the table::

    table    ~~move~~|                                  |~~move~~
    settle           |......|
    laser                    on ______________ off
    profiler                    discard, profile
    read back                                    pose

A table that turns while it is measured is lit for the turn: `acquisition.turning`.

Everything waits in steps of 50 ms at most, and looks for the operator's stop in each of them.
Between slices nothing moves and the laser is off (and the table is back at 0 from a ring): there,
and only there, the generator rests, so that closing it late leaves nothing on. Whoever takes a
sweep for long, such as a slow disk, holds the scan up there: that is a pause, after a minute of
which the laser is announced anew. The laser's own way out is `open_station`, whose block stands
around the loop that takes the sweeps.

An axis that is not homed is homed first; when a scan is resumed, every axis that has a reference of
its own is, and a kept slice may be taken `again` before the others. Not so a table whose zero is
software when a scan is resumed: homing it makes its present angle 0, and the slices would be turned
against those kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import chain

import numpy as np

from acquisition.continuous import Continuous, WayBack, speed_deg_s
from acquisition.errors import LeaseLapsed, Stopped, ZeroLost
from acquisition.lease import LONGEST_WAIT_S, lasing, pausing
from acquisition.opening import OpenStation, at_rest_unless_done
from acquisition.patterns import SliceKind
from acquisition.plan import Plan, StepAndShoot, Target, check_plan, target
from acquisition.poses import Pose, Sweep
from acquisition.profilers import lost_profile, patience_s
from acquisition.safety.leading import arm, begin_homing, homed, known, resume
from acquisition.safety.states import Event, State
from acquisition.station import GrblTable, HomeMark, LeadshineStage, TableZero
from acquisition.timing import Steadiness, Timekeeper, timed_sweep
from acquisition.turning import Sense, StampsBroken, Turned, Turner
from drivers.axis import Axis, AxisState, Motion
from drivers.errors import FrameError, NoReply, Refused
from drivers.profiler import Profile, Reason, Tally

_TRIES = 4  # an exposure, and three more for a profile that was lost
_MOST_LOST_IN_A_ROW = 3  # stops: then it is the profiler that is lost
_LOOK_S = LONGEST_WAIT_S / 2  # half, because switching on again takes its time, too
_TAKE_UP_MM = 0.5  # more than any screw's backlash
_BRAKING_S = 5.0
_SLOW_S = 1.0  # whoever takes a sweep for longer holds the scan up: it is paused since then
_UNDER_WAY = (Motion.MOVING, Motion.HOMING)


class Wish(Enum):
    """What the operator wants."""

    GO_ON = "go on"
    PAUSE = "pause at the slice's border"
    STOP = "stop now"


class StopRequest:
    """The one thing that travels against the stream; set by signal handlers or another thread."""

    def __init__(self) -> None:
        self._wish = Wish.GO_ON
        self.left_alone = False  # who watched has left: attended, that pauses at the border

    @property
    def wish(self) -> Wish:
        """What was asked for so far."""
        return self._wish

    def ask(self, *_signal: object) -> None:
        """Pause at the border; asked twice, stop now. A handler for SIGINT as it is."""
        self._wish = Wish.PAUSE if self._wish is Wish.GO_ON else Wish.STOP

    def now(self, *_signal: object) -> None:
        """Stop now. A handler for SIGTERM and SIGHUP as it is."""
        self._wish = Wish.STOP

    def leave(self) -> None:
        """Who watched has left; a scan that is attended pauses at the border, another goes on."""
        self.left_alone = True

    def look(self) -> None:
        """Raise `Stopped` if it is to stop now."""
        if self._wish is Wish.STOP:
            raise Stopped("stopped amid a slice; what was kept is safe, resume takes the rest")


class PartStands(Enum):
    """What a person says of the part when a scan is resumed."""

    ANYWHERE = "nobody says"
    AT_ZERO = "the table stands where the scan's first slice had its zero"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a scan is, told after every stop of the table."""

    index: int  # of the slice
    slices_done: int  # before this one
    slices: int  # to be taken
    stops_done: int  # of this slice
    stops: int
    lost_profiles: int  # never came, in this scan
    tally: Tally = field(default_factory=Tally)  # of the profiler, since it was opened


def scan(
    station: OpenStation,
    plan: Plan,
    *,
    stop: StopRequest,
    indices: Collection[int] | None = None,
    again: int | None = None,
    chosen: Callable[[Callable[[float], None]], Iterator[int]] | None = None,
    most: int | None = None,
    part: PartStands = PartStands.ANYWHERE,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Generator[Sweep]:
    """Take the slices of a plan, lowest first; ends early at a slice's border when asked to.

    Parameters
    ----------
    indices
        Of the slices to take, as `ScanFolder.missing` gives them to a resume; all when absent.
    again
        A kept slice, taken and yielded before them, for a comparison; no progress is told of it.
    chosen
        Of an adaptive plan, instead of `indices`: called with what waits, it gives each index when
        the sweep before has been taken away; nothing moves meanwhile and the laser is off.
    most
        How many will be chosen at most, for whoever hears of the progress; the plan's when absent.
    part
        Needed to resume with a software zero: the table is homed where it stands.

    Raises
    ------
    ValueError
        At once: the plan leaves the soft limits, or has no slice of an index.
    Stopped
        The operator asked twice; the laser is off and the axes are stopped.
    ZeroLost
        See the module.
    LeaseLapsed, DriverError
        The laser is off and the axes are stopped; the slice under way is not kept.
    """
    check_plan(plan, station.settings)
    whole = range(plan.count)
    wanted = sorted(set(whole if indices is None else indices))
    first = [] if again is None else [again]
    if unknown := [index for index in (*first, *wanted) if index not in whole]:
        raise ValueError(f"plan: it has the slices 0 to {whole[-1]}, no slice {unknown[0]}")
    run = _Scan(station, plan, stop, part, progress)
    if chosen is not None:
        coming = chain(first, chosen(run.pause))
        slices = plan.most if most is None else most
        return run.sweeps((target(plan, index) for index in coming), len(first), slices, None,
                          resumed=bool(first))  # fmt: skip
    taken = [target(plan, index) for index in (*first, *wanted)] if wanted else []
    return run.sweeps(
        taken, len(first), len(wanted), len(taken) - 1, resumed=len(wanted) < len(whole)
    )


class _Scan:
    """One run over some slices: the devices, the lease, and what was lost on the way."""

    def __init__(
        self,
        station: OpenStation,
        plan: Plan,
        stop: StopRequest,
        part: PartStands,
        progress: Callable[[Progress], None],
    ) -> None:
        self._station = station
        self._plan = plan
        self._stop = stop
        self._part = part
        self._progress = progress
        self._lease = station.lease
        self.pause = self._pause = pausing(self._lease, self._look, station.sleep)
        self._patience_s = patience_s(station.settings.profiler)
        self._keeper = Timekeeper()
        self._lost_profiles = 0
        self._lost_in_a_row = 0

    def sweeps(
        self, wanted: Iterable[Target], known: int, slices: int, last: int | None, *, resumed: bool
    ) -> Generator[Sweep]:
        """Take them, the first `known` for comparison; the state machine is told of all.

        `slices` are told as progress; `last` is the number of the last one, if it is known before.
        """
        safety = self._station.safety
        upcoming = enumerate(wanted)
        try:
            while not (self._stop.wish is Wish.PAUSE or self._is_left_alone()):
                with at_rest_unless_done(self._station):
                    self._look()
                    done, target = next(upcoming, (0, None))
                    if target is None:
                        break
                    if not done:
                        self._prepare(resumed=resumed)
                    elif safety.state is State.PAUSED:
                        resume(self._station, self._pause)
                    sweep = self._sweep(target, done - known, slices)
                if done == last:
                    self._complete()
                given_s = self._station.clock()
                yield sweep
                if self._station.clock() - given_s > _SLOW_S and safety.state is State.SCANNING:
                    safety.tell(Event.BACK_PRESSURE, since_s=given_s)
            if last is None and self._stop.wish is Wish.GO_ON and safety.state is State.SCANNING:
                self._complete()
        finally:
            if safety.state is State.SCANNING:
                safety.ask(Event.PAUSE)

    def _complete(self) -> None:
        # What this asks for was done with the last slice: dark, read back, and standing.
        self._station.safety.tell(Event.COMPLETE)
        self._station.safety.tell(Event.STANDS)

    def _is_left_alone(self) -> bool:
        """Whether a person was to be there and is not any more."""
        if not self._stop.left_alone:
            return False
        self._station.safety.tell(Event.CONTROL_LOST)
        return self._station.safety.rules.attended

    def _look(self) -> None:
        """Raise what ends the scan: the operator's wish, or the hardware's safety chain."""
        self._stop.look()
        self._station.safety.look()

    def _prepare(self, *, resumed: bool) -> None:
        """Laser off, everybody who they should be, both axes standing and homed."""
        station = self._station
        station.laser.off()
        for device in (station.laser, station.profiler, station.table, station.stage):
            device.identify()
        known(station)
        for axis in (station.stage, station.table):
            self._bring_to_rest(axis)
        if resumed and not station.table.state().homed:
            self._must_know_the_zero()
        begin_homing(station)
        for axis in (station.stage, station.table):
            if not axis.state().homed or (resumed and self._has_reference(axis)):
                axis.home(self._pause)
        homed(station)
        station.safety.ask(Event.VALIDATE)
        station.safety.tell(Event.VALIDATED)  # before anything was opened: `check_plan`
        arm(station, self._pause)
        station.safety.ask(Event.START)

    def _must_know_the_zero(self) -> None:
        table = self._station.settings.table
        software = isinstance(table, GrblTable) and table.zero is TableZero.SOFTWARE_ZERO
        if software and self._part is not PartStands.AT_ZERO:
            raise ZeroLost(
                "table: its software zero is forgotten, so that new slices would be turned against"
                " those kept; turn it back to where the scan began and say so, or scan anew"
            )

    def _has_reference(self, axis: Axis) -> bool:
        """Whether homing finds the same place again, and not the one where it stands."""
        table, stage = self._station.settings.table, self._station.settings.stage
        if axis is self._station.table:
            return not (isinstance(table, GrblTable) and table.zero is TableZero.SOFTWARE_ZERO)
        return not (isinstance(stage, LeadshineStage) and stage.home_mark is HomeMark.HERE)

    def _bring_to_rest(self, axis: Axis) -> None:
        """Stop what a program that died may have left moving."""
        if axis.state().motion not in _UNDER_WAY:
            return
        axis.stop()
        deadline_s = self._station.clock() + _BRAKING_S
        while axis.state().motion in _UNDER_WAY:
            if self._station.clock() >= deadline_s:
                raise Refused(
                    f"{self._name(axis)}: still moves {_BRAKING_S} s after its stop; press the"
                    " emergency stop"
                )
            self._pause(LONGEST_WAIT_S)

    def _sweep(self, target: Target, done: int, slices: int) -> Sweep:
        if self._plan.continuous is not None:
            self._lift_to(target.stage_mm)
            return self._turned_sweep(self._plan.continuous, target, done, slices)
        return self._stopped_sweep(target, done, slices)

    def _turned_sweep(self, plan: Continuous, target: Target, done: int, slices: int) -> Sweep:
        """Turn once, and back; the way back is measured, too, where it is wanted."""
        settings, count = self._station.settings, len(target.table_rad)

        def heard(profiles: int) -> None:
            self._tell(target, done, slices, min(profiles, count), count)

        speed = math.radians(speed_deg_s(count, settings.profiler.rate_hz))
        both = plan.way_back is WayBack.MEASURED or self._keeper.must_learn(speed)
        turner = Turner(self._station, self._look, self._patience_s, heard)
        turns = [self._turned(turner, plan, speed, Sense.FORWARD)]
        if both:
            turns.append(self._turned(turner, plan, speed, Sense.BACKWARD))
        pose = self._pose()
        self._station.table.move_to(0.0, self._pause)
        steady = Steadiness(
            speed, math.radians(plan.run_in_deg), math.radians(settings.table.tolerance_deg)
        )
        nothing = lost_profile(settings.profiler)
        sweep = timed_sweep(target.index, turns, pose.stage_mm, steady, self._keeper, nothing)
        self._lost_profiles += 0 if sweep.timing is None else sweep.timing.lost
        self._tell(target, done, slices, count, count)
        return sweep

    def _turned(self, turner: Turner, plan: Continuous, speed_rad_s: float, sense: Sense) -> Turned:
        """One turn, from where it begins; begun again where the lease lapsed in it."""
        low_rad, high_rad = -math.radians(plan.run_in_deg), math.radians(360.0 + plan.run_in_deg)
        backward = sense is Sense.BACKWARD
        begin_rad, end_rad = (high_rad, low_rad) if backward else (low_rad, high_rad)
        table, settings = self._station.table, self._station.settings.table
        tolerance_rad = math.radians(settings.tolerance_deg)
        for tries_left in reversed(range(_TRIES)):
            if abs(table.state().position - begin_rad) > tolerance_rad:
                table.move_to(begin_rad, self._pause)
            try:
                turned = turner.turn(end_rad, speed_rad_s)
                # Downward the gear drives the part by its other flank: it lags by the play.
                play_rad = math.radians(settings.backlash_deg) if backward else 0.0
                return replace(turned, table_rad=turned.table_rad + play_rad)
            except (LeaseLapsed, StampsBroken):
                if not tries_left:
                    raise
        raise AssertionError  # the last try returned or raised

    def _tell(self, target: Target, done: int, slices: int, number: int, stops: int) -> None:
        if done >= 0:
            lost, tally = self._lost_profiles, self._station.profiler.tally()
            self._progress(Progress(target.index, done, slices, number, stops, lost, tally))

    def _stopped_sweep(self, target: Target, done: int, slices: int) -> Sweep:
        how = self._plan.step_and_shoot or StepAndShoot()
        profiles: list[Profile] = []
        poses: list[Pose] = []
        stops = target.stops
        lifted_mm: float | None = None
        for number, (stage_mm, table_rad) in enumerate(stops, start=1):
            if stage_mm != lifted_mm:
                self._lift_to(stage_mm)
                lifted_mm = stage_mm
            self._station.table.move_to(table_rad, self._pause)
            self._pause(how.settle_s)
            for _ in range(how.profiles_per_stop):
                profiles.append(self._profile())
                poses.append(self._pose())
            self._tell(target, done, slices, number, len(stops))
        if self._plan.kind is SliceKind.RING or (
            self._plan.kind is SliceKind.MERIDIAN and done == slices - 1
        ):
            self._station.table.move_to(0.0, self._pause)
        return Sweep(target.index, tuple(profiles), tuple(poses))

    def _lift_to(self, stage_mm: float) -> None:
        """Come from below, always: the screw's backlash is taken up by the way it comes."""
        stage, lowest_mm = self._station.stage, self._station.settings.stage.lowest_mm
        if stage.state().position > stage_mm:
            stage.move_to(max(lowest_mm, stage_mm - _TAKE_UP_MM), self._pause)
        stage.move_to(stage_mm, self._pause)

    def _profile(self) -> Profile:
        """One profile that is whole, or after some tries the fullest, or none but LOST points."""
        best: Profile | None = None
        silence: NoReply | FrameError | None = None
        for tries_left in reversed(range(_TRIES)):
            try:
                seen = self._expose()
            except LeaseLapsed:
                if not tries_left:
                    raise
                continue
            if isinstance(seen, NoReply | FrameError):
                silence = seen
                continue
            self._lost_in_a_row = 0
            best = seen if best is None else min(best, seen, key=_lost_points)
            if not _lost_points(best):
                break
        return best or self._count_lost(silence)

    def _expose(self) -> Profile | NoReply | FrameError:
        """Laser on, what came before thrown away, the next profile if one comes, laser off."""
        station = self._station
        with lasing(station.laser, self._lease) as keep_on:
            station.profiler.discard()
            deadline_s = station.clock() + self._patience_s
            while True:
                self._look()
                try:
                    return next(station.profiler.profiles(_LOOK_S))
                except (NoReply, FrameError) as silence:
                    if station.clock() >= deadline_s:
                        return silence
                keep_on()

    def _count_lost(self, silence: NoReply | FrameError | None) -> Profile:
        self._lost_profiles += 1
        self._lost_in_a_row += 1
        if self._lost_in_a_row >= _MOST_LOST_IN_A_ROW:
            raise NoReply(
                f"profiler: nothing at {self._lost_in_a_row} stops in a row, {_TRIES} exposures of"
                f" {self._patience_s:.2f} s each ({silence})"
            ) from silence
        return lost_profile(self._station.settings.profiler)

    def _pose(self) -> Pose:
        table, stage = self._standing(self._station.table), self._standing(self._station.stage)
        return Pose(table.position, stage.position, self._station.clock())

    def _standing(self, axis: Axis) -> AxisState:
        """Read back, after the exposure: whoever lost its position meanwhile has none to tell."""
        state = axis.state()
        if state.motion is Motion.STANDING and state.homed:
            return state
        raise Refused(
            f"{self._name(axis)}: it stood for a profile and now is {state.motion.value}"
            f"{'' if state.homed else ', no longer homed'} {state.alarm}".rstrip()
            + "; remove the cause and home it"
        )

    def _name(self, axis: Axis) -> str:
        return "table" if axis is self._station.table else "stage"


def _lost_points(profile: Profile) -> int:
    return int(np.count_nonzero(profile.reasons == Reason.LOST))
