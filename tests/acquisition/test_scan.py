"""A scan on fake devices in a time of their own, which are the witnesses: what counts is what
their contact and their motors did, not what the program believes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from acquisition.errors import LeaseLapsed, NotNow, Stopped, ZeroLost
from acquisition.lease import TTL_S, Lease
from acquisition.opening import OpenStation
from acquisition.plan import Plan, StepAndShoot, ring
from acquisition.poses import Sweep
from acquisition.profilers import lost_profile
from acquisition.safety.guarding import NoGuard
from acquisition.safety.resting import Rest
from acquisition.safety.states import Event, Rules, Situation, State
from acquisition.safety.supervising import PermittedLaser, Supervisor
from acquisition.scan import (
    PartStands,
    Progress,
    StopRequest,
    Wish,
    scan,
)
from acquisition.station import Station, TableZero
from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.laser import Guarantee
from drivers.profiler import Profile, Reason, Tally
from tests.acquisition.scan_cases import STATION

PLAN = ring(10.0, 12.0, 1.0, 4)
QUARTER = math.tau / 4


@dataclass
class Bench:
    """The time, the journal of every call with the laser's state before it, and planned faults."""

    now_s: float = 50.0
    lit: bool = False
    calls: list[str] = field(default_factory=list)
    fault_at: int = -1
    fault: type[BaseException] = LinkLost
    fault_before: bool = True  # or after the device has done what it was told
    longest_wait_s: float = 0.0
    events: list[tuple[float, Callable[[], None]]] = field(default_factory=list)

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.longest_wait_s = max(self.longest_wait_s, seconds)
        self.pass_time(seconds)

    def pass_time(self, seconds: float) -> None:
        self.now_s += seconds
        while self.events and self.events[0][0] <= self.now_s:
            self.events.pop(0)[1]()

    def call(self, name: str, act: Callable[[], None] = lambda: None) -> None:
        """Journal a call and do it; fail it before or after where that is planned."""
        self.calls.append(f"{name}{' lit' if self.lit else ''}")
        if len(self.calls) - 1 != self.fault_at:
            return act()
        if not self.fault_before:
            act()
        raise self.fault(f"planned fault in {name}")


@dataclass
class FakeAxis:
    bench: Bench
    name: str
    kind: Kind
    position: float = 0.0
    homed: bool = False
    moving: bool = False
    alarm: str = ""
    speed: float = 100.0
    moves: list[float] = field(default_factory=list)

    def identify(self) -> Identity:
        self.bench.call(f"{self.name} identify")
        return Identity("fake", self.name, "1")

    def state(self) -> AxisState:
        self.bench.call(f"{self.name} state")
        motion = Motion.MOVING if self.moving else Motion.ALARM if self.alarm else Motion.STANDING
        return AxisState(motion, self.position, self.homed, self.alarm)

    def home(self, pause: Pause) -> AxisState:
        def begin() -> None:
            self.moving = True

        self.bench.call(f"{self.name} home", begin)
        pause(0.5)
        self.moving, self.homed, self.position = False, True, 0.0
        return AxisState(Motion.STANDING, 0.0, homed=True)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Unlike a good driver it does not stop by itself when its pause raises."""
        assert self.homed

        def begin() -> None:
            self.moving = True

        self.bench.call(f"{self.name} move", begin)
        self.moves.append(position)
        pause(abs(position - self.position) / self.speed + 0.02)
        self.moving = False
        self.position = position + 1e-4  # what it reads back is never quite what was asked
        return AxisState(Motion.STANDING, self.position, homed=True)

    def stop(self) -> None:
        def halt() -> None:
            self.moving = False

        self.bench.call(f"{self.name} stop", halt)


@dataclass
class FakeLaser:
    bench: Bench
    lit_since_s: float = 0.0
    longest_unkept_s: float = 0.0
    slow_s: float = 0.002

    def identify(self) -> Identity:
        self.bench.call("laser identify")
        return Identity("fake", "laser", "1")

    def guarantee(self) -> Guarantee:
        return Guarantee(0.25, "the fake drops by itself")

    def on(self) -> None:
        def close() -> None:
            if self.bench.lit:
                unkept_s = self.bench.now_s - self.lit_since_s
                self.longest_unkept_s = max(self.longest_unkept_s, unkept_s)
            self.bench.lit = True
            self.lit_since_s = self.bench.now_s

        self.bench.call("laser on", close)
        self.bench.pass_time(self.slow_s)

    def off(self) -> None:
        def open_() -> None:
            self.bench.lit = False

        self.bench.call("laser off", open_)

    def is_on(self) -> bool:
        return self.bench.lit


@dataclass
class FakeProfiler:
    """Without light nothing; `script` says what the next exposures give, then whole profiles."""

    bench: Bench
    period_s: float = 0.01
    script: list[str] = field(default_factory=list)  # whole, torn, silent, damaged or stall
    frame: int = 0
    stale: bool = True

    def identify(self) -> Identity:
        self.bench.call("profiler identify")
        return Identity("fake", "profiler", "1")

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        assert timeout_s <= 0.05
        self.bench.call("profiler profile")
        assert not self.stale, "what came before the exposure was not thrown away"
        kind = self.script[0] if self.script else "whole"
        if kind == "stall":
            self.bench.pass_time(0.3)
        due_s = self.lit_for_s() + timeout_s
        if not self.bench.lit or kind == "silent" or due_s < self.period_s:
            self.bench.pass_time(timeout_s)
            raise NoReply(f"profiler: no profile in {timeout_s} s; is the laser on?")
        if kind == "stall":
            raise NoReply("profiler: stalled")
        if kind == "damaged":
            self.bench.pass_time(min(self.period_s, timeout_s))
            raise FrameError("profiler: an answer with a wrong check; check the cable")
        self.bench.pass_time(min(self.period_s, timeout_s))
        self.frame += 1
        self.stale = True
        yield self.profile(torn_points=2 * (kind == "torn") + 3 * (kind == "tattered"))

    def profile(self, torn_points: int) -> Profile:
        reasons = np.full(5, Reason.MEASURED, np.uint8)
        reasons[:torn_points] = Reason.LOST
        counts = np.full((5, 2), self.frame, np.int32)
        none = np.empty(0, np.uint16)
        return Profile(counts, (1.0, 1.0), (0.0, 0.0), reasons, none, 0.0, 0, self.frame)

    def lit_for_s(self) -> float:
        return self.bench.now_s - self.exposed_at_s

    def discard(self) -> None:
        self.bench.call("profiler discard")
        self.exposed_at_s = self.bench.now_s
        if self.script and self.begun:
            self.script.pop(0)
        self.begun = True
        self.stale = False

    def tally(self) -> Tally:
        return Tally()

    exposed_at_s: float = 0.0
    begun: bool = False  # the script's first entry is the first exposure's


@dataclass
class Rig:
    """A bench, its devices, and the station that the scan is given."""

    bench: Bench
    table: FakeAxis
    stage: FakeAxis
    profiler: FakeProfiler
    laser: FakeLaser
    station: OpenStation
    stop: StopRequest = field(default_factory=StopRequest)

    def take(self, plan: Plan = PLAN, **options: object) -> list[Sweep]:
        return list(scan(self.station, plan, stop=self.stop, **options))  # type: ignore[arg-type]

    @property
    def at_rest(self) -> bool:
        return not (self.bench.lit or self.table.moving or self.stage.moving)


def rig(settings: Station = STATION, **bench: object) -> Rig:
    made = Bench(**bench)  # type: ignore[arg-type]
    table = FakeAxis(made, "table", Kind.ROTARY)
    stage = FakeAxis(made, "stage", Kind.LINEAR)
    profiler, laser = FakeProfiler(made), FakeLaser(made)
    promise = laser.guarantee()
    safety = Supervisor(made.clock, Rules(warning_s=0.0))
    safety.tell(Event.SELF_TESTED)
    safety.tell(Event.CONNECT)
    safety.tell(Event.OFF_CONFIRMED)
    permitted = PermittedLaser(laser, safety)
    rest = Rest(permitted, safety)
    for axis in (table, stage):
        rest.add(axis.name, axis, None)
    station = OpenStation(
        settings, table, stage, profiler, permitted, promise, made.clock,
        made.sleep, Lease(TTL_S, made.clock), NoGuard(), {}, safety, rest,
    )  # fmt: skip
    return Rig(made, table, stage, profiler, laser, station)


def test_a_scan_takes_every_slice_with_the_poses_read_back() -> None:
    at = rig()
    sweeps = at.take()
    assert [each.index for each in sweeps] == [0, 1, 2]
    for each in sweeps:
        assert len(each.profiles) == 4
        turned = [pose.table_rad for pose in each.poses]
        assert turned == pytest.approx([k * QUARTER + 1e-4 for k in range(4)], abs=1e-12)
        assert {pose.stage_mm for pose in each.poses} == {10.0 + each.index + 1e-4}
    frames = [profile.frame for each in sweeps for profile in each.profiles]
    assert frames == list(range(1, 13))
    times = [pose.time_s for each in sweeps for pose in each.poses]
    assert times == sorted(set(times))


def test_the_order_of_a_slice_is_lift_then_stop_settle_expose_read_back_and_at_last_turn_back() -> (
    None
):
    at = rig()
    at.table.homed = at.stage.homed = True
    at.take(ring(10.0, 10.0, 1.0, 3))
    stop = [
        "table move",
        "laser on",
        "profiler discard lit",
        "profiler profile lit",
        "laser off lit",
        "table state",
        "stage state",
    ]
    wanted = ["stage state", "stage move", *(3 * stop), "table move"]
    assert at.bench.calls[-len(wanted) :] == wanted
    assert at.table.moves == pytest.approx([0.0, math.tau / 3, 2 * math.tau / 3, 0.0])


def test_the_laser_is_off_in_every_move_and_it_is_the_first_thing_that_is_done() -> None:
    at = rig()
    at.take()
    assert at.bench.calls[0] == "laser off"
    assert sum(call.startswith("laser on") for call in at.bench.calls) == 12
    lit = {call for call in at.bench.calls if call.endswith(" lit")}
    assert lit == {"profiler discard lit", "profiler profile lit", "laser off lit"}


def test_it_settles_before_it_exposes() -> None:
    def exposed_at(settle_s: float) -> float:
        at = rig()
        at.take(replace(PLAN, step_and_shoot=StepAndShoot(settle_s=settle_s)))
        return at.bench.now_s

    assert exposed_at(0.7) - exposed_at(0.2) == pytest.approx(12 * 0.5)


def test_several_profiles_at_a_stop_have_a_pose_each() -> None:
    at = rig()
    (sweep,) = at.take(
        replace(ring(10.0, 10.0, 1.0, 3), step_and_shoot=StepAndShoot(profiles_per_stop=2))
    )
    assert [profile.frame for profile in sweep.profiles] == [1, 2, 3, 4, 5, 6]
    turned = [pose.table_rad for pose in sweep.poses]
    assert turned[0] == turned[1] < turned[2] == turned[3] < turned[4]


def test_an_axis_is_homed_if_it_is_not() -> None:
    at = rig()
    at.stage.homed = True
    at.take()
    assert "table home" in at.bench.calls
    assert "stage home" not in at.bench.calls


def test_what_a_dead_program_left_moving_is_stopped_before_it_is_homed() -> None:
    at = rig()
    at.stage.moving = True
    at.take()
    assert at.bench.calls.index("stage stop") < at.bench.calls.index("stage home")


def test_an_axis_that_does_not_stop_is_refused_in_time() -> None:
    at = rig()
    at.stage.moving = True
    at.stage.stop = lambda: at.bench.call("stage stop")  # type: ignore[method-assign]
    with pytest.raises(Refused, match="stage: still moves"):
        at.take()
    assert at.bench.now_s < 60.0


def test_a_slice_is_always_approached_from_below() -> None:
    at = rig()
    at.stage.homed, at.stage.position = True, 200.0
    at.take()
    assert at.stage.moves == [9.5, 10.0, 11.0, 12.0]


def test_an_approach_from_below_stays_inside_the_soft_limits() -> None:
    at = rig()
    at.stage.homed, at.stage.position = True, 200.0
    at.take(ring(0.2, 0.2, 1.0, 3))
    assert at.stage.moves == [0.0, 0.2]


def test_a_plan_outside_the_limits_is_refused_before_anything_is_asked() -> None:
    at = rig()
    with pytest.raises(ValueError, match="highest_mm"):
        scan(at.station, ring(10.0, 400.0, 1.0, 4), stop=at.stop)
    with pytest.raises(ValueError, match="no slice 3"):
        scan(at.station, PLAN, stop=at.stop, indices=[0, 3])
    assert at.bench.calls == []


def test_a_backlash_that_leaves_the_limits_is_refused_before_anything_is_asked() -> None:
    at = rig(replace(STATION, table=replace(STATION.table, backlash_deg=10.5)))
    with pytest.raises(ValueError, match=r"backlash_deg 10\.5 below"):
        scan(at.station, PLAN, stop=at.stop)
    assert at.bench.calls == []


def test_a_resume_takes_only_what_is_missing() -> None:
    at = rig()
    sweeps = at.take(indices=[2, 0], part=PartStands.AT_ZERO)
    assert [each.index for each in sweeps] == [0, 2]
    assert at.stage.moves == [10.0, 12.0]
    assert {pose.stage_mm for pose in sweeps[1].poses} == {12.0001}


def test_a_resume_with_nothing_missing_asks_nothing() -> None:
    at = rig()
    assert at.take(indices=[]) == []
    assert at.bench.calls == []


def test_a_resume_does_not_make_up_a_new_zero_of_the_table() -> None:
    at = rig()
    with pytest.raises(ZeroLost, match="turn it back"):
        at.take(indices=[1, 2])
    assert not any("home" in call or "move" in call for call in at.bench.calls)
    assert at.bench.calls[-3:] == ["laser off", "stage stop", "table stop"]


def test_a_resume_goes_on_where_the_zero_is_known() -> None:
    homed = rig()
    homed.table.homed = True
    assert len(homed.take(indices=[1])) == 1
    switch = rig(replace(STATION, table=replace(STATION.table, zero=TableZero.SWITCH)))
    assert len(switch.take(indices=[1])) == 1
    nothing_kept = rig()
    assert len(nothing_kept.take(indices=range(3))) == 3


def test_progress_is_told_after_every_stop_with_the_laser_off() -> None:
    at = rig()
    told: list[Progress] = []

    def tell(progress: Progress) -> None:
        assert at.at_rest
        told.append(progress)

    at.take(indices=[1, 2], part=PartStands.AT_ZERO, progress=tell)
    assert told[0] == Progress(1, 0, 2, 1, 4, 0)
    assert told[-1] == Progress(2, 1, 2, 4, 4, 0)
    assert len(told) == 8


# --- lost profiles ---------------------------------------------------------------------------


def test_a_lost_profile_is_taken_again() -> None:
    at = rig()
    at.profiler.script = ["whole", "silent", "silent", "silent"]
    told: list[Progress] = []
    sweeps = at.take(progress=told.append)
    assert [profile.frame for profile in sweeps[0].profiles] == [1, 2, 3, 4]
    assert told[-1].lost_profiles == 0
    assert sum(call == "laser on" for call in at.bench.calls) == 15


def test_a_profile_lost_four_times_is_kept_as_lost_and_counted() -> None:
    at = rig()
    at.profiler.script = ["whole", "silent", "silent", "silent", "silent"]
    told: list[Progress] = []
    sweeps = at.take(progress=told.append)
    lost = sweeps[0].profiles[1]
    assert lost.frame == -1
    assert set(lost.reasons) == {Reason.LOST}
    assert len(lost.points_mm) == 0
    assert len(lost.reasons) == STATION.profiler.points_per_profile
    assert [profile.frame for profile in sweeps[0].profiles] == [1, -1, 2, 3]
    assert [each.lost_profiles for each in told[:3]] == [0, 1, 1]


def test_a_damaged_answer_of_the_profiler_costs_an_exposure_and_not_the_scan() -> None:
    at = rig()
    at.profiler.script = ["damaged", "whole", "damaged", "damaged", "damaged", "damaged"]
    told: list[Progress] = []
    sweeps = at.take(progress=told.append)
    assert [profile.frame for profile in sweeps[0].profiles] == [1, -1, 2, 3]
    assert [each.lost_profiles for each in told[:3]] == [0, 1, 1]
    assert at.at_rest
    gone = rig()
    gone.profiler.script = ["damaged"] * 100
    with pytest.raises(NoReply, match=r"3 stops in a row, .*check the cable"):
        gone.take()
    assert gone.at_rest


def test_a_profiler_that_sends_nothing_ends_the_scan_with_its_remedy() -> None:
    at = rig()
    at.profiler.script = ["silent"] * 100
    with pytest.raises(NoReply, match=r"3 stops in a row, .* is the laser on\?"):
        at.take()
    assert at.at_rest
    assert at.bench.now_s < 60.0


def test_lost_profiles_that_are_not_in_a_row_do_not_end_the_scan() -> None:
    at = rig()
    at.profiler.script = 12 * ["silent", "silent", "silent", "silent", "whole"]
    told: list[Progress] = []
    assert len(at.take(progress=told.append)) == 3
    assert told[-1].lost_profiles == 6


def test_a_torn_profile_is_taken_again_and_the_fullest_is_kept() -> None:
    again = rig()
    again.profiler.script = ["torn"]
    assert again.take()[0].profiles[0].frame == 2
    fullest = rig()
    fullest.profiler.script = ["tattered", "torn", "tattered", "silent"]
    kept = fullest.take()[0].profiles[0]
    assert kept.frame == 2
    assert np.count_nonzero(kept.reasons == Reason.LOST) == 2


def test_a_lost_profile_stands_in_with_the_stations_scales() -> None:
    lost = lost_profile(STATION.profiler)
    assert lost.scale_mm == (0.01, 0.005)
    assert lost.counts.shape == (600, 2)


# --- the lease and the waits -----------------------------------------------------------------


def test_no_wait_is_longer_than_50_ms() -> None:
    at = rig()
    at.take(replace(PLAN, step_and_shoot=StepAndShoot(settle_s=1.0)))
    assert 0.0 < at.bench.longest_wait_s <= 0.05


def test_a_long_exposure_keeps_the_lease_and_the_switch_alive() -> None:
    at = rig(replace(STATION, profiler=replace(STATION.profiler, rate_hz=2.0)))
    at.profiler.period_s = 0.5
    assert len(at.take()) == 3
    assert 0.0 < at.laser.longest_unkept_s <= 0.05
    assert at.profiler.frame == 12


def test_a_stall_in_the_exposure_takes_the_profile_again() -> None:
    at = rig()
    at.profiler.script = ["stall"]
    assert len(at.take()) == 3
    assert sum(call.startswith("laser on") for call in at.bench.calls) == 13
    assert at.at_rest


def test_a_machine_that_always_stalls_may_not_light_the_laser() -> None:
    at = rig()
    at.laser.slow_s = 0.2
    with pytest.raises(LeaseLapsed, match="too busy"):
        at.take()
    assert at.at_rest
    assert sum(call.startswith("laser on") for call in at.bench.calls) == 4


# --- the operator's stop ---------------------------------------------------------------------


def test_a_stop_request_is_a_pause_first_and_a_stop_the_second_time() -> None:
    stop = StopRequest()
    stop.look()
    assert stop.wish is Wish.GO_ON
    stop.ask(2, None)  # as a signal handler is called
    stop.look()
    assert stop.wish is Wish.PAUSE
    stop.ask()
    assert stop.wish is Wish.STOP
    with pytest.raises(Stopped):
        stop.look()
    at_once = StopRequest()
    at_once.now(15, None)
    at_once.ask()
    assert at_once.wish is Wish.STOP


def test_a_pause_ends_the_scan_at_the_slices_border_with_the_table_back_at_zero() -> None:
    at = rig()
    sweeps = scan(at.station, PLAN, stop=at.stop)
    next(sweeps)
    at.bench.events.append((at.bench.now_s + 0.3, at.stop.ask))
    assert [each.index for each in sweeps] == [1]
    assert at.at_rest
    assert at.table.moves[-1] == 0.0


def test_a_pause_asked_for_before_the_start_moves_nothing() -> None:
    at = rig()
    at.stop.ask()
    assert at.take() == []
    assert at.bench.calls == []


def test_a_stop_is_heard_at_any_instant_within_50_ms() -> None:
    whole = rig()
    whole.take(ring(10.0, 10.0, 1.0, 3))
    for instant_ms in range(1, round((whole.bench.now_s - 50.0) * 1000), 7):
        at = rig()
        asked_s = 50.0 + instant_ms / 1000
        at.bench.events.append((asked_s, at.stop.now))
        with pytest.raises(Stopped, match="resume"):
            at.take(ring(10.0, 10.0, 1.0, 3))
        assert at.at_rest
        assert at.bench.now_s - asked_s <= 0.06
        assert at.bench.calls[-2:] == ["stage stop", "table stop"]


def test_a_stop_in_a_long_exposure_puts_the_laser_out_within_50_ms() -> None:
    at = rig(replace(STATION, profiler=replace(STATION.profiler, rate_hz=1.0)))
    at.profiler.period_s = 1.0
    at.table.homed = at.stage.homed = True
    at.bench.events.append((50.7, at.stop.now))
    with pytest.raises(Stopped):
        at.take(ring(10.0, 10.0, 1.0, 3))
    assert "laser off lit" in at.bench.calls
    assert "table state" not in at.bench.calls[at.bench.calls.index("laser on") :]
    assert at.bench.now_s <= 50.76


def test_a_stop_between_two_slices_is_a_stop() -> None:
    at = rig()
    sweeps = scan(at.station, PLAN, stop=at.stop)
    next(sweeps)
    at.stop.now()
    with pytest.raises(Stopped):
        next(sweeps)
    assert at.at_rest


def test_between_two_slices_everything_rests_and_closing_sends_nothing() -> None:
    at = rig()
    sweeps = scan(at.station, PLAN, stop=at.stop)
    next(sweeps)
    assert at.at_rest
    before = list(at.bench.calls)
    sweeps.close()
    assert at.bench.calls == before


# --- a fault at every call in turn -----------------------------------------------------------


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("fault", [LinkLost, NoReply, Refused, RuntimeError, KeyboardInterrupt])
def test_after_a_fault_at_any_call_the_laser_is_off_and_the_axes_stand(
    fault: type[BaseException], *, before: bool
) -> None:
    short = ring(10.0, 11.0, 1.0, 3)
    whole = rig()
    whole.take(short)
    calls = len(whole.bench.calls)
    errors: list[str] = []
    ends: set[tuple[str, ...]] = set()
    for index in range(calls):
        at = rig(fault_at=index, fault=fault, fault_before=before)
        try:
            at.take(short)
        except fault as told:
            errors.append(str(told))
            ends.add(tuple(call.removesuffix(" lit") for call in at.bench.calls[-3:]))
        assert at.at_rest, (index, at.bench.calls)
    profiles = sum(call.startswith("profiler profile") for call in whole.bench.calls)
    # A profile that does not come is taken again; every other fault is told.
    assert len(errors) == (calls - profiles if fault is NoReply else calls)
    assert all(each.startswith("planned fault") for each in errors)
    assert ends == {("laser off", "stage stop", "table stop")}


def test_after_a_fault_the_laser_goes_off_before_the_axes_are_stopped() -> None:
    at = rig()
    at.table.homed = at.stage.homed = True
    at.profiler.discard = None  # type: ignore[method-assign,assignment]
    with pytest.raises(TypeError):
        at.take()
    assert at.bench.calls[-5:] == [
        "laser on",
        "laser off lit",
        "laser off",
        "stage stop",
        "table stop",
    ]


def test_a_way_out_that_fails_is_gone_to_its_end_and_told_in_notes() -> None:
    at = rig()
    at.stop.now()

    def broken() -> None:
        raise LinkLost("gone")

    at.laser.off = at.stage.stop = broken  # type: ignore[method-assign]
    at.table.moving = True
    with pytest.raises(Stopped) as stopped:
        at.take()
    assert stopped.value.__notes__ == ["gone", "gone"]
    assert not at.table.moving


def test_an_axis_that_lost_its_position_in_the_exposure_gives_no_pose() -> None:
    at = rig()

    def trip() -> None:
        at.stage.homed, at.stage.alarm = False, "0x0F0: over-current"

    at.bench.events.append((52.0, trip))
    with pytest.raises(DriverError, match=r"stage: .* alarm, no longer homed 0x0F0"):
        at.take(replace(PLAN, step_and_shoot=StepAndShoot(settle_s=2.0)))
    assert at.at_rest


# --- who watches, and who takes ------------------------------------------------------------------


@pytest.mark.parametrize("attended", [True, False])
def test_whoever_watched_and_left_pauses_an_attended_scan_at_the_border_and_no_other(
    attended: bool,  # noqa: FBT001
) -> None:
    at = rig()
    at.station.safety.attend(attended=attended)
    taken = []
    for sweep in scan(at.station, PLAN, stop=at.stop):
        taken.append(sweep.index)
        at.stop.leave()
    assert taken == ([0] if attended else [0, 1, 2])
    assert at.at_rest
    assert at.station.safety.state is (State.PAUSED if attended else State.READY)


def test_a_scan_that_was_left_alone_is_resumed_from_its_pause() -> None:
    at = rig()
    at.station.safety.attend(attended=True)
    sweeps = scan(at.station, PLAN, stop=at.stop)
    next(sweeps)
    at.stop.leave()
    assert list(sweeps) == []
    at.stop = StopRequest()
    assert [each.index for each in at.take(indices=(1, 2))] == [1, 2]


@pytest.mark.parametrize(("slow_s", "announced"), [(0.5, 0), (30.0, 0), (90.0, 1)])
def test_whoever_is_slow_to_take_a_slice_pauses_the_scan_and_loses_none(
    slow_s: float, announced: int
) -> None:
    at = rig()
    safety, told, seen = at.station.safety, list[str](), list[Situation]()
    safety.rules, safety.announce = Rules(warning_s=3.0), told.append
    sweeps = scan(at.station, PLAN, stop=at.stop)
    next(sweeps)
    assert at.at_rest
    told.clear()
    at.bench.sleep(slow_s)
    tell = safety.tell

    def overheard(event: Event, *, since_s: float | None = None) -> object:
        actions = tell(event, since_s=since_s)
        if event is Event.BACK_PRESSURE:
            seen.append(safety.situation)
        return actions

    safety.tell = overheard  # type: ignore[method-assign, assignment]
    lit_s = at.bench.now_s
    assert [each.index for each in sweeps] == [1, 2]
    assert len(told) == announced  # the laser, anew, before it is lit
    assert [each.state for each in seen] == ([State.PAUSED] if slow_s > 1.0 else [])
    assert all(each.since_s == pytest.approx(lit_s - slow_s) for each in seen)


def test_a_key_that_was_turned_off_while_a_slice_was_taken_lights_nothing() -> None:
    at = rig()
    sweeps = scan(at.station, PLAN, stop=at.stop)
    next(sweeps)
    at.bench.sleep(5.0)
    at.station.safety.tell(Event.KEY_OFF)
    before = len(at.bench.calls)
    with pytest.raises(NotNow):
        next(sweeps)
    assert not any(call.startswith("laser on") for call in at.bench.calls[before:])
