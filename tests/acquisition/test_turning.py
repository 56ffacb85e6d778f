"""A table that turns while it is measured: the whole chain on virtual wires, judged by the
simulator's mesh and by its witness, which know nothing of the program.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.continuous import Continuous, WayBack
from acquisition.errors import Stopped
from acquisition.lease import Lease
from acquisition.opening import OpenStation
from acquisition.plan import Plan, Ring
from acquisition.poses import Sweep
from acquisition.resuming import take_missing
from acquisition.scan import Progress, StopRequest, scan
from acquisition.scan_record import ScanRecord
from acquisition.scanfile import ScanFolder
from drivers.axis import Axis, AxisState, Pause
from drivers.errors import NoReply, Refused
from drivers.profiler import Reason
from sim.axes import TableFamily
from sim.judging import Surface
from sim.parts import cylinder, vase
from sim.profilers import ProfilerFamily
from sim.sensor import Sensor
from sim.sensor_clock import SensorClock
from sim.stations import Layout
from tests.acquisition.virtual_station import VirtualStation, virtual_station
from tests.campaigns.turning_table import RATE_HZ, angles_off, stopped, turned

AT_MM = 33.0
CLOCK = SensorClock(latency_s=0.002, drift_ppm=40.0, started_s=777.0)
LAYOUT = Layout(
    seed=5,
    rate_hz=RATE_HZ,
    profiler_family=ProfilerFamily.RIFTEK,
    sensor=Sensor(points=160),
    sensor_clock=CLOCK,
    outlier_rate=0.0,
)
FAST = 1200  # profiles a turn: 120 deg/s, so that a test is short


def plan(slices: int = 1, profiles: int = FAST, way_back: WayBack = WayBack.EMPTY) -> Plan:
    last_mm = AT_MM + 5.0 * (slices - 1)
    ring = Ring(first_mm=AT_MM, last_mm=last_mm, step_mm=5.0, profiles_per_turn=profiles)
    return Plan(ring=ring, continuous=Continuous(way_back=way_back))


def take(at: VirtualStation, what: Plan, **options: object) -> list[Sweep]:
    return list(scan(at.station, what, stop=StopRequest(), **options))  # type: ignore[arg-type]


def lit_spans(at: VirtualStation) -> list[tuple[float, float]]:
    told = [event for event in at.witness.events if event["what"] == "laser"]
    assert len(told) % 2 == 0
    times = [float(str(event["time_s"])) for event in told]
    return list(zip(times[::2], times[1::2], strict=True))


def test_it_is_as_true_as_step_and_shoot_and_ten_times_as_fast() -> None:
    # One seed of tests.campaigns.turning_table, whose bounds these are; there are ten of it.
    part = vase()
    truth = Surface(part.vertices_mm, part.faces)
    _, once = turned(1, ProfilerFamily.RIFTEK, truth)
    still = stopped(1, ProfilerFamily.RIFTEK, 240, truth)  # as true as 2160 stops, point by point
    assert once.points_rms_mm <= 1.2 * still.points_rms_mm
    stops_s = still.seconds / 240 * once.profiles
    assert stops_s >= 10.0 * once.seconds
    # 0.12 deg is what 2 ms are at 60 deg/s; the clock's steps of 1 ms in this rig are 0.06.
    assert once.angle_rms_deg <= 0.005


@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_every_profile_has_its_number_its_angle_and_is_marked_where_it_was_lost(
    lost: float,
) -> None:
    with virtual_station(LAYOUT, vase(), lost=lost) as at:
        first, second = take(at, plan(2))
        true = {e["frame"]: e["table_rad"] for e in at.witness.events if e["what"] == "profile"}
    for sweep, turns in ((first, 2), (second, 1)):
        assert len(sweep.profiles) == pytest.approx(turns * FAST, abs=2)
        assert sweep.timing is not None
        came = [bool((p.reasons != Reason.LOST).any()) for p in sweep.profiles]
        assert came == np.isfinite(sweep.timing.arrived_s).tolist()
        assert sweep.timing.lost == came.count(False)
        # Binomial: five standard deviations of 2400 draws are 0.03.
        assert came.count(False) / len(came) == pytest.approx(lost, abs=0.03 if lost else 0.0)
        off = [
            pose.table_rad - float(str(true[profile.frame]))
            for profile, pose in zip(sweep.profiles, sweep.poses, strict=True)
        ]
        # A profile under the number of its neighbour would be 0.3 deg off.
        assert np.degrees(np.abs(off)).max() < 0.02
        frames = np.diff([profile.frame for profile in sweep.profiles])
        assert set(frames[frames != 1]) == set() if turns == 1 else len(frames[frames != 1]) == 1
        assert all(0.0 <= pose.table_rad < math.tau for pose in sweep.poses)


def test_the_latency_and_the_drift_are_found() -> None:
    with virtual_station(LAYOUT, vase()) as at:
        (sweep,) = take(at, plan())
    timing = sweep.timing
    assert timing is not None
    # The rig shows what came a step of 1 ms later at most, and 2 ms are a multiple of it.
    assert CLOCK.latency_s <= timing.latency_s <= CLOCK.latency_s + 0.0021
    assert timing.latency_sd_s < 5e-5
    assert timing.drift_ppm == pytest.approx(CLOCK.drift_ppm, abs=20.0)
    assert timing.apart_mm == pytest.approx(timing.noise_mm, rel=0.1)


def test_two_latencies_differ_by_their_difference() -> None:
    found = []
    for latency_s in (0.0, 0.0105):
        slow = replace(LAYOUT, sensor_clock=replace(CLOCK, latency_s=latency_s))
        with virtual_station(slow, vase()) as at:
            (sweep,) = take(at, plan())
        assert sweep.timing is not None
        found.append(sweep.timing.latency_s)
    # The rig's steps of 1 ms, twice.
    assert found[1] - found[0] == pytest.approx(0.0105, abs=0.0012)


def test_a_part_that_is_round_about_the_axis_does_not_tell_the_latency_and_this_is_said() -> None:
    # At 400 Hz the way back would meet the very angles of the way there, to a microradian, and with
    # them the very same speckle, which tells indeed.
    with virtual_station(replace(LAYOUT, rate_hz=397.3), cylinder(30.0, 80.0)) as at:
        sweeps = take(at, plan(4))
    timings = [sweep.timing for sweep in sweeps]
    assert all(t is not None and math.isnan(t.latency_s) for t in timings)
    # Three slices are tried; from then on nobody turns both ways round for it.
    assert [round(len(sweep.profiles) / FAST) for sweep in sweeps] == [2, 2, 2, 1]


def test_the_way_back_measures_every_slice_twice_where_that_is_planned() -> None:
    with virtual_station(LAYOUT, vase()) as at:
        sweeps = take(at, plan(2, way_back=WayBack.MEASURED))
    assert [round(len(sweep.profiles) / FAST) for sweep in sweeps] == [2, 2]


@pytest.mark.parametrize("family", [TableFamily.GRBL, TableFamily.GRBLHAL])
def test_backlash_is_not_taken_for_latency(family: TableFamily) -> None:
    play_rad = math.radians(0.3)
    loose = replace(LAYOUT, table_family=family, table_play_rad=play_rad)
    with virtual_station(loose, vase()) as at:
        assert at.settings.table.backlash_deg == pytest.approx(0.3)
        (sweep,) = take(at, plan())
        assert math.degrees(angles_off(sweep, at)) < 0.02
    assert sweep.timing is not None
    assert CLOCK.latency_s <= sweep.timing.latency_s <= CLOCK.latency_s + 0.0021


def test_between_slices_it_is_dark_and_the_table_is_back_at_0() -> None:
    with virtual_station(LAYOUT, vase()) as at:
        for _ in scan(at.station, plan(2), stop=StopRequest()):
            assert not at.devices.world.laser_on
            assert at.station.table.state().position == pytest.approx(0.0, abs=1e-3)
        spans = lit_spans(at)
    assert len(spans) == 3  # both ways round, and once
    way_s = (360.0 + 2 * 15.0) / 120.0
    for begun_s, ended_s in spans:
        assert ended_s - begun_s == pytest.approx(way_s, abs=0.5)


def first_lit(at: VirtualStation, act: Callable[[], None], after_s: float) -> None:
    """Do something so long after the laser was first lit."""
    due_s = math.nan

    def watch() -> None:
        nonlocal due_s
        if math.isnan(due_s) and at.devices.world.laser_on:
            due_s = at.room.now_s + after_s
        if at.room.now_s >= due_s:
            due_s = math.inf
            act()

    at.room.watch = watch


def stood_s(at: VirtualStation) -> list[tuple[float, str]]:
    """When the laser went off and the table was told to stop."""
    return [
        (float(str(event["time_s"])), str(event["what"]))
        for event in at.witness.events
        if (event["what"] == "laser" and not event["on"])
        or (event["what"] == "stop" and event["axis"] == "table")
    ]


def test_a_stop_is_heard_within_50_ms_and_it_is_dark_before_the_table_stops() -> None:
    stop, asked_s = StopRequest(), []
    with virtual_station(LAYOUT, vase()) as at:

        def now() -> None:
            asked_s.append(at.room.now_s)
            stop.now()

        first_lit(at, now, after_s=1.0)
        with pytest.raises(Stopped):
            list(scan(at.station, plan(), stop=stop))
        (dark_s, dark), (stopped_s, halted), *_ = stood_s(at)
        assert (dark, halted) == ("laser", "stop")
        assert dark_s <= asked_s[0] + 0.05
        assert stopped_s <= asked_s[0] + 0.1
        assert at.devices.world.table.stands(at.room.now_s)
        assert not at.devices.world.laser_on


def test_a_profiler_that_falls_silent_ends_the_turn_dark_and_standing() -> None:
    with virtual_station(LAYOUT, vase()) as at:

        def mute() -> None:
            at.devices.profiler._values["user_streams_udpEnabled"] = 0  # type: ignore[union-attr]

        first_lit(at, mute, after_s=1.0)
        with pytest.raises(NoReply, match=r"nothing for .* while the table turned"):
            take(at, plan())
        assert [what for _, what in stood_s(at)][:2] == ["laser", "stop"]
        assert at.devices.world.table.stands(at.room.now_s)


def test_a_lease_that_lapses_in_a_turn_costs_the_turn_and_it_is_dark_before_the_table_stops() -> (
    None
):
    with virtual_station(LAYOUT, vase()) as at:

        def hang() -> None:
            at.room.now_s += at.station.lease.ttl_s + 0.3

        first_lit(at, hang, after_s=1.0)
        (sweep,) = take(at, plan(profiles=2 * FAST))  # a turn outlasts the hang
        assert [what for _, what in stood_s(at)][:2] == ["laser", "stop"]
        # Both ways round, and the turn that was given up.
        assert len(lit_spans(at)) == 3
        assert math.degrees(angles_off(sweep, at)) < 0.01


@pytest.mark.parametrize("started_s", [100.0, 5000.0])
def test_a_sensor_whose_clock_is_set_in_a_turn_costs_the_turn(started_s: float) -> None:
    with virtual_station(LAYOUT, vase()) as at:

        def restart() -> None:
            clock = replace(CLOCK, started_s=started_s)
            at.devices.profiler._free_run._clock = clock  # type: ignore[union-attr]

        first_lit(at, restart, after_s=1.0)
        (sweep,) = take(at, plan())
        assert len(lit_spans(at)) == 3
        assert math.degrees(angles_off(sweep, at)) < 0.01


def test_a_table_that_is_held_is_seen_by_what_the_part_shows_on_the_way_back() -> None:
    with virtual_station(LAYOUT, vase()) as at:
        at.station.table.home(at.station.sleep)
        at.station.stage.home(at.station.sleep)
        at.devices.world.table.obstacle = math.radians(200.0)
        # The board counts its steps and notices nothing: the part shows it.
        with pytest.raises(Refused, match=r"lies .* mm from itself .* did the part slip"):
            take(at, plan())
        assert not at.devices.world.laser_on


def test_the_lease_is_renewed_all_the_time_that_it_is_lit() -> None:
    with virtual_station(LAYOUT, vase()) as at:
        lease, times = at.station.lease, []

        class Noting(Lease):
            def renew(self) -> None:
                times.append(at.room.now_s)
                lease.renew()

            @property
            def valid(self) -> bool:
                return lease.valid

        noting = Noting(lease.ttl_s, at.room.clock)
        take_with = replace(at.station, lease=noting)
        list(scan(take_with, plan(), stop=StopRequest()))
        for begun_s, ended_s in lit_spans(at):
            lit = [begun_s, *(t for t in times if begun_s <= t <= ended_s), ended_s]
            assert max(np.diff(lit)) <= 0.05 + 1e-9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "turned.scan"


def record(at: VirtualStation, what: Plan) -> ScanRecord:
    return ScanRecord(
        station=at.settings,
        plan=what,
        calibration=at.settings.kinematics,
        software="loftscan 0.0.0",
        created="2026-01-02T03:04:05+00:00",
    )


def test_a_slice_is_kept_with_all_that_its_poses_were_made_of(folder: Path) -> None:
    with (
        virtual_station(LAYOUT, vase(), lost=0.1) as at,
        ScanFolder.create(folder, record(at, plan())) as writer,
    ):
        (sweep,) = take(at, plan())
        writer.append(sweep)
        kept = writer.folder.read(0)
    assert kept.timing is not None
    assert sweep.timing is not None
    for name in sweep.timing.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(kept.timing, name), getattr(sweep.timing, name))
    assert kept.poses == sweep.poses
    # The angles follow from what is kept, without the program's help: straight between answers.
    asked = np.column_stack([kept.timing.asked_s, kept.timing.asked_rad])
    forward = asked[: int(np.argmax(asked[:, 1])) + 1]
    there = [pose for pose in kept.poses if pose.time_s < forward[-1, 0]]
    read = np.interp([p.time_s for p in there], forward[:, 0], forward[:, 1])
    assert np.degrees(np.abs(read - [p.table_rad for p in there])).max() < 0.1


def test_a_scan_that_was_cut_short_is_gone_on_with_and_agrees(folder: Path) -> None:
    what, closures = plan(3), []
    with (
        virtual_station(LAYOUT, vase(), lost=0.1) as at,
        ScanFolder.create(folder, record(at, what)) as writer,
    ):
        sweeps = scan(at.station, what, stop=StopRequest())
        writer.append(next(sweeps))
        sweeps.close()
    other = replace(LAYOUT, seed=6, sensor_clock=replace(CLOCK, started_s=3.0))
    with (
        virtual_station(other, vase(), lost=0.1) as at,
        ScanFolder.open(folder).resume() as writer,
    ):
        for sweep in take_missing(
            at.station, what, writer.folder, stop=StopRequest(), compared=closures.append
        ):
            writer.append(sweep)
        assert not writer.folder.missing()
    (closure,) = closures
    assert closure.agrees
    assert closure.difference_mm < closure.noise_mm < 0.1


def test_progress_is_told_while_it_turns() -> None:
    told: list[Progress] = []
    with virtual_station(LAYOUT, vase()) as at:
        take(at, plan(), progress=told.append)
    done = [each.stops_done for each in told]
    assert len(done) > 20
    assert done[-1] == told[-1].stops == FAST


def test_a_table_that_cannot_be_swept_is_refused_by_name() -> None:
    class Plain:
        """An axis without `sweep_to`."""

        def __init__(self, axis: Axis) -> None:
            self._axis = axis
            self.kind, self.identify, self.state = axis.kind, axis.identify, axis.state
            self.home, self.jog_to, self.stop = axis.home, axis.jog_to, axis.stop

        def move_to(self, position: float, pause: Pause) -> AxisState:
            return self._axis.move_to(position, pause)

    with virtual_station(LAYOUT, vase()) as at:
        plain: OpenStation = replace(at.station, table=Plain(at.station.table))
        with pytest.raises(Refused, match="cannot be turned at a speed of its own"):
            list(scan(plain, plan(), stop=StopRequest()))
        assert not at.devices.world.laser_on
