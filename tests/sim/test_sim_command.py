"""Whole simulated stations: their files, their faults, and the real drivers at their wires."""

from __future__ import annotations

import fcntl
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields, replace
from io import BytesIO
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
import trimesh
from pymodbus.framer import FramerRTU

from acquisition.frames import part_points
from acquisition.lease import Lease, lasing
from acquisition.opening import OpenStation, open_station
from acquisition.plan import Plan, check_plan, parse_plan, read_plan, targets
from acquisition.poses import Sweep
from acquisition.scan import StopRequest, scan
from acquisition.station import Station, parse_station, read_station
from drivers.axis import Motion
from drivers.errors import NoReply, Refused
from drivers.links import open_link
from sim.__main__ import main
from sim.arrays import FloatArray
from sim.cabling import Cabling
from sim.faults import (
    Breath,
    Dropping,
    Faults,
    Garbling,
    Silent,
    Speaker,
    Unsent,
    parse_faults,
)
from sim.motion import Limits
from sim.parts import PARTS, cylinder, find_part, vase
from sim.sensor import Hand, Lifting, Mounting, Sensor, Turning
from sim.serving import Ending, Server
from sim.solids import Part
from sim.stations import (
    Addresses,
    Layout,
    build,
    connect,
    plan_toml,
    station_toml,
    truth_ply,
)
from sim.witness import Memory, read_witness

REPOSITORY = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0  # a deadline that only a broken simulator reaches
FAST = 20.0

# Nothing in it is as it is by default, and nothing is 0: no sign can hide.
TURNED_ROUND = Layout(
    seed=7,
    time_scale=FAST,
    cloud_width_mm=0.0,
    outlier_rate=0.0,
    mounting=Mounting(
        standoff_mm=215.0,
        side_mm=4.0,
        height_mm=140.0,
        azimuth_rad=0.7,
        turning=Turning.CLOCKWISE,
        lifting=Lifting.DOWN,
        hand=Hand.LEFT,
    ),
    sensor=Sensor(
        points=321, x_mm_per_count=0.01, z_mm_per_count=0.004, x_offset_mm=1.5, z_offset_mm=100.0
    ),
    rate_hz=50.0,
    table_limits=Limits(math.radians(90.0), math.radians(900.0)),
    table_play_rad=math.radians(0.5),
    table_stands_rad=-0.4,
    table_switch_deg=-45.0,
    stage_limits=Limits(25.0, 250.0),
    stage_play_mm=0.3,
    stage_stands_mm=11.0,
    stage_travel_mm=(-5.0, 175.0),
    stage_baud=38400,
    watchdog_s=0.5,
)
ADDRESSES = Addresses(
    table="serial:///ports/table?baud=115200",
    stage="serial:///ports/stage?baud=38400",
    profiler="tcp://127.0.0.1:502",
    profiles="udp://127.0.0.2:9000",
    laser="tcp://127.0.0.1:503",
)


# --- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", [Layout(), TURNED_ROUND], ids=["normal", "turned round"])
def test_station_toml_says_what_is_true_of_the_layout(layout: Layout) -> None:
    station = parse_station(station_toml(layout, ADDRESSES, 'part "3"'))
    mounting, sensor = layout.mounting, layout.sensor
    table, stage, profiler = station.table, station.stage, station.profiler
    assert 'part "3"' in station.name
    assert table.address == ADDRESSES.table
    assert table.speed_deg_s == pytest.approx(math.degrees(layout.table_limits.speed))
    assert table.backlash_deg == pytest.approx(math.degrees(layout.table_play_rad))
    assert table.zero.value == "switch"
    assert stage.address == ADDRESSES.stage
    assert stage.speed_mm_s == layout.stage_limits.speed
    assert stage.home_position_mm == layout.stage_travel_mm[0]
    assert layout.stage_travel_mm[0] < stage.lowest_mm
    assert stage.highest_mm < layout.stage_travel_mm[1]
    assert (profiler.address, profiler.profiles) == (ADDRESSES.profiler, ADDRESSES.profiles)
    assert (profiler.rate_hz, profiler.points_per_profile) == (layout.rate_hz, sensor.points)
    assert profiler.setup is None
    for name in ("x_mm_per_count", "z_mm_per_count", "x_offset_mm", "z_offset_mm"):
        assert getattr(profiler, name) == getattr(sensor, name)
    assert station.laser.switch == "relay"
    assert getattr(station.laser, "address", "") == ADDRESSES.laser
    assert getattr(station.laser, "watchdog_s", 0.0) == layout.watchdog_s
    kinematics = station.kinematics
    assert kinematics.table_sign == mounting.turning.value
    assert kinematics.stage_sign == mounting.lifting.value
    assert kinematics.x_sign == mounting.hand.value
    for name in ("height_mm", "standoff_mm", "side_mm"):
        assert getattr(kinematics, name) == getattr(mounting, name)
    assert kinematics.azimuth_deg == pytest.approx(math.degrees(mounting.azimuth_rad))


def test_an_axis_at_full_speed_stands_within_what_a_stop_may_take() -> None:
    layout = Layout()
    for limits in (layout.table_limits, layout.stage_limits):
        assert limits.speed / limits.acceleration < 0.12


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("layout", [Layout(), TURNED_ROUND], ids=["normal", "turned round"])
def test_the_plan_rings_the_whole_part_within_the_soft_limits(layout: Layout, name: str) -> None:
    part = PARTS[name]()
    plan = parse_plan(plan_toml(layout, part))
    check_plan(plan, parse_station(station_toml(layout, ADDRESSES, name)))
    mounting = layout.mounting
    heights_mm = sorted(
        mounting.height_mm + mounting.lifting.value * target.stage_mm for target in targets(plan)
    )
    top_mm = part.vertices_mm[:, 2].max()
    assert len(heights_mm) == 40
    assert np.allclose(np.diff(heights_mm), top_mm / 40, atol=1e-5)
    assert 0.0 < heights_mm[0] < 0.05 * top_mm
    assert 0.95 * top_mm < heights_mm[-1] < top_mm
    assert plan.ring.profiles_per_turn == 12
    assert plan.step_and_shoot.settle_s == 0.0


def test_a_part_higher_than_the_stage_goes_is_ringed_as_far_as_it_goes() -> None:
    layout, tower = Layout(), cylinder(20.0, 400.0, around=64)
    plan = parse_plan(plan_toml(layout, tower))
    check_plan(plan, parse_station(station_toml(layout, ADDRESSES, tower.name)))
    assert 10 < plan.ring.count < 20


def test_a_part_that_the_sensor_cannot_see_is_refused_with_what_it_sees() -> None:
    layout = Layout()
    build(layout, cylinder(0.99 * layout.reach_mm, around=64), Memory(), 0.0)
    with pytest.raises(ValueError, match=r"100 mm .* sees 60; scale it down"):
        build(layout, cylinder(100.0, around=64), Memory(), 0.0)


@pytest.mark.parametrize("name", PARTS)
def test_the_true_part_is_kept_to_the_last_bit(name: str) -> None:
    part = PARTS[name]()
    mesh = trimesh.load(BytesIO(truth_ply(part)), file_type="ply", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    assert np.array_equal(mesh.vertices, part.vertices_mm)
    assert np.array_equal(mesh.faces, part.faces)


# --- faults --------------------------------------------------------------------------------------


def test_faults_are_read_by_name() -> None:
    assert parse_faults("") == Faults()
    found = parse_faults("silent-stage=3, silent-relay,drop-blocks=50,stall-stage=12.5,garbage=7")
    assert dict(found.silent_after) == {Speaker.STAGE: 3, Speaker.RELAY: 0}
    assert (found.drop_every, found.garble_every, found.stage_stalls_mm) == (50, 7, 12.5)
    assert found.profiles
    assert not parse_faults("no-profiles").profiles


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("flood", "'flood' is not known; known are silent-table"),
        ("silent", "not known"),
        ("no-profiles=2", "not known"),
        ("drop-blocks", "a whole number from 1 on"),
        ("drop-blocks=0", "a whole number from 1 on"),
        ("garbage=x", "a whole number from 1 on"),
        ("silent-table=", "a whole number from 0 on"),
        ("silent-table=-1", "a whole number from 0 on"),
        ("stall-stage", "a number after the ="),
        ("stall-stage=nan", "a number after the ="),
    ],
)
def test_a_fault_that_is_not_known_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said) as refused:
        parse_faults(f"no-profiles,{text}")
    assert "\n" not in str(refused.value)


class Capitals:
    """A device and a broadcaster that answers in capitals."""

    def __init__(self) -> None:
        self.told_s: list[float] = []

    def receive(self, data: bytes, now_s: float) -> bytes:
        del now_s
        return data.upper()

    def tick(self, now_s: float) -> bytes:
        self.told_s.append(now_s)
        return b""

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        return [b"%d" % now_s, b"and"]


def test_a_device_out_of_breath_is_silent_on_every_connection_but_lives_on() -> None:
    device, breath = Capitals(), Breath(2)
    one, two = Silent(device, breath), Silent(device, breath)
    said = [each.receive(b"x", 0.0) for each in (one, two, one, two)]
    assert said == [b"X", b"X", b"", b""]
    one.tick(7.0)
    assert device.told_s == [7.0]


def test_garbage_is_one_byte_of_every_nth_answer_and_none_of_ascii() -> None:
    line = Garbling(Capitals(), 3)
    said = []
    for _ in range(9):
        line.tick(0.0)  # nothing said counts for nothing
        said.append(line.receive(b"ok\n", 0.0))
    assert [words == b"OK\n" for words in said] == [True, True, False] * 3
    wrong = [bytes(a ^ b for a, b in zip(words, b"OK\n", strict=True)) for words in said[2::3]]
    assert wrong == [b"\0\x80\0", b"\0\0\x80", b"\x80\0\0"]


def test_every_nth_datagram_is_lost_and_no_other() -> None:
    network = Dropping(Capitals(), 3)
    assert [network.datagrams(time_s) for time_s in range(3)] == [
        [b"0", b"and"],
        [b"and"],
        [b"2"],
    ]
    assert Unsent(Capitals()).datagrams(0.0) == ()


# --- devices -------------------------------------------------------------------------------------


def test_the_station_is_lively_while_anything_moves_or_the_laser_is_on() -> None:
    devices = build(Layout(), cylinder(around=32), Memory(), 0.0)
    world = devices.world
    assert not devices.lively(1.0)
    for axis in (world.table, world.stage):
        axis.go(axis.motor(1.0) + 1.0, 1.0, speed=1.0)
        assert devices.lively(1.5)
        axis.brake(1.5)
        assert not devices.lively(9.0)
    world.switch_laser(9.0, on=True, why="test")
    assert devices.lively(9.0)


def test_the_sensors_rate_is_the_layouts_in_the_stations_own_time() -> None:
    layout = Layout(rate_hz=20.0, time_scale=2.0)
    devices = build(layout, cylinder(around=32), Memory(), 0.0)
    devices.world.switch_laser(0.0, on=True, why="test")
    sent = [devices.profiler.datagrams(0.003 * step) for step in range(1, 334)]
    assert sum(bool(each) for each in sent) == pytest.approx(40, abs=1)


# --- real drivers at the wires, one process ------------------------------------------------------


@dataclass(frozen=True)
class Live:
    """A station that is served, and what one needs to judge what comes from it."""

    station: Station
    plan: Plan
    witness: Memory


@contextmanager
def served(layout: Layout, part: Part, faults: str = "") -> Iterator[Live]:
    """Serve a station from a thread of this process."""
    witness, ending, planted = Memory(), Ending(), parse_faults(faults)
    devices = build(layout, part, witness, time.monotonic(), faults=planted)
    with tempfile.TemporaryDirectory() as folder, Server(lively=devices.lively) as server:
        cabling = Cabling(planted, layout.seed, witness)
        addresses = connect(devices, layout, cabling, server, Path(folder))
        thread = threading.Thread(target=server.run, args=(ending,))
        thread.start()
        try:
            yield Live(
                parse_station(station_toml(layout, addresses, part.name)),
                parse_plan(plan_toml(layout, part, rings=2, stops=3)),
                witness,
            )
        finally:
            ending.ask()
            thread.join(PATIENCE_S)


def pause(seconds: float, /) -> None:
    time.sleep(min(seconds, 0.05))


def off_the_surface_mm(sweeps: Sequence[Sweep], station: Station, part: Part) -> FloatArray:
    """How far each point lies outside the part, along the radius."""
    assert part.radius_mm is not None
    points_mm = np.concatenate([part_points(sweep, station.kinematics) for sweep in sweeps])
    x_mm, y_mm, z_mm = points_mm.T
    true_mm = part.radius_mm(np.arctan2(y_mm, x_mm), z_mm)
    return np.asarray(np.hypot(x_mm, y_mm) - true_mm)


@dataclass(frozen=True)
class Scanned:
    """A scan at a served station, and what truly happened meanwhile."""

    station: Station
    part: Part
    sweeps: list[Sweep]
    events: list[dict[str, object]]


@pytest.fixture(scope="module")
def turned_round() -> Scanned:
    part = vase(levels=26)
    with served(TURNED_ROUND, part) as live:
        with open_station(live.station) as station:
            sweeps = list(scan(station, live.plan, stop=StopRequest()))
        return Scanned(live.station, part, sweeps, list(live.witness.events))


def test_a_scan_of_a_station_turned_round_lies_on_the_true_part(turned_round: Scanned) -> None:
    assert [len(sweep.profiles) for sweep in turned_round.sweeps] == [3, 3]
    off_mm = off_the_surface_mm(turned_round.sweeps, turned_round.station, turned_round.part)
    assert len(off_mm) > 300
    assert np.abs(off_mm).max() < 0.05  # chords of the mesh, counts, and steps of the table


def test_what_is_read_back_is_where_the_witness_saw_the_part(turned_round: Scanned) -> None:
    seen = {
        place(number(event, "table_rad"), number(event, "stage_mm"))
        for event in turned_round.events
        if event["what"] == "profile"
    }
    poses = [pose for sweep in turned_round.sweeps for pose in sweep.poses]
    assert {place(pose.table_rad, pose.stage_mm) for pose in poses} == seen
    assert len(seen) == 6


def place(table_rad: float, stage_mm: float) -> tuple[complex, float]:
    """Rounded; an angle is the same after a turn."""
    turned = complex(math.cos(table_rad), math.sin(table_rad))
    return complex(round(turned.real, 3), round(turned.imag, 3)) + 0.0, round(stage_mm, 3)


def test_every_profile_was_taken_at_rest_and_the_laser_is_off_in_the_end(
    turned_round: Scanned,
) -> None:
    lit, profiles = False, 0
    stands_s = {"table": -math.inf, "stage": -math.inf}
    for event in turned_round.events:
        if event["what"] == "laser":
            lit = bool(event["on"])
        elif event["what"] in ("move", "stop"):
            assert not lit, "it moved with the laser on"
            stands_s[str(event["axis"])] = number(event, "ends_s")
        elif event["what"] == "profile":
            profiles += 1
            assert lit
            assert number(event, "time_s") >= max(stands_s.values())
    assert profiles >= 6
    assert not lit


def number(event: dict[str, object], name: str) -> float:
    return float(str(event[name]))


def test_homing_moving_and_one_exposure_end_where_they_should() -> None:
    with served(Layout(time_scale=FAST), cylinder(around=64)) as live:
        with open_station(live.station) as station:
            for axis in (station.stage, station.table):
                assert not axis.state().homed
                axis.home(pause)
            table = station.table.move_to(math.radians(-100.0), pause)
            stage = station.stage.move_to(50.0, pause)
            assert table.motion is stage.motion is Motion.STANDING
            assert (table.position, stage.position) == pytest.approx((-1.745329, 50.0), abs=1e-3)
            profile = exposure(station)
        moves = [event for event in live.witness.events if event["what"] == "move"]
    assert number(moves[-1], "target") == pytest.approx(50.0, abs=1e-6)
    assert len(profile.points_mm) > 150


def exposure(station: OpenStation):  # type: ignore[no-untyped-def]
    with lasing(station.laser.switch, Lease(0.12, station.clock)):
        assert station.laser.is_on()
        station.profiler.discard()
        return next(station.profiler.profiles(0.1))


READ_COIL = bytes.fromhex("0001 0000 0006 01 01 0000 0001")
READ_VENDOR = bytes.fromhex("0001 0000 0006 01 04 0000 0001")
READ_STATUS = bytes.fromhex("01 03 1003 0001")


@pytest.mark.parametrize(
    ("device", "question", "sound"),
    [
        ("table", b"?", b"<Alarm|"),  # it is not homed
        (
            "stage",
            READ_STATUS + FramerRTU.compute_CRC(READ_STATUS).to_bytes(2, "big"),
            b"\x01\x03\x02",
        ),
        ("profiler", READ_VENDOR, b"\0\x01\0\0\0\x05\x01\x04\x02"),
        ("relay", READ_COIL, b"\0\x01\0\0\0\x04\x01\x01\x01"),
    ],
)
def test_a_device_is_silent_and_only_on_a_serial_line_garbled(
    device: str, question: bytes, sound: bytes
) -> None:
    garbled = device in ("table", "stage")
    assert answered(device, question, "").startswith(sound)
    assert answered(device, question, f"silent-{device}") == b""
    assert answered(device, question, "garbage=1").startswith(sound) is not garbled
    other = "table" if device == "relay" else "relay"
    assert answered(device, question, f"silent-{other}").startswith(sound)


def answered(device: str, question: bytes, faults: str) -> bytes:
    """What comes back in a while; a silence is only as sure as that while is long."""
    name = "laser" if device == "relay" else device
    with (
        served(Layout(), cylinder(around=64), faults) as live,
        closing(open_link(getattr(live.station, name).address)) as link,
    ):
        link.read(0.02)  # a banner
        link.write(question)
        return link.read(0.05 if "silent-" + device in faults else PATIENCE_S)


def test_the_relays_watchdog_bites_though_nobody_is_connected() -> None:
    watchdog_ms = bytes.fromhex("0001 0000 0006 01 06 1120 0064")
    laser_on = bytes.fromhex("0002 0000 0006 01 05 0000 ff00")
    with served(Layout(), cylinder(around=64)) as live:
        with closing(open_link(getattr(live.station.laser, "address", ""))) as link:
            for request in (watchdog_ms, laser_on):
                link.write(request)
                assert link.read(PATIENCE_S) == request
        deadline_s = time.monotonic() + PATIENCE_S
        while len(switched := [e for e in live.witness.events if e["what"] == "laser"]) < 2:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
    assert [event["on"] for event in switched] == [True, False]
    assert switched[1]["why"] == "watchdog"
    assert number(switched[1], "time_s") - number(switched[0], "time_s") > 0.09


def test_a_stage_that_is_held_refuses_to_go_on() -> None:
    with (
        served(Layout(time_scale=FAST), cylinder(around=64), "stall-stage=10") as live,
        open_station(live.station) as station,
    ):
        station.stage.home(pause)
        assert station.stage.move_to(9.0, pause).position == pytest.approx(9.0)
        with pytest.raises(Refused, match="stage"):
            station.stage.move_to(20.0, pause)


def test_a_profiler_that_sends_nothing_answers_and_is_silent() -> None:
    with (
        served(Layout(time_scale=FAST), cylinder(around=64), "no-profiles") as live,
        open_station(live.station) as station,
    ):
        assert station.profiler.identify().family == "baumer_ox"
        with pytest.raises(NoReply):
            exposure(station)
        assert [event for event in live.witness.events if event["what"] == "profile"]


def test_lost_datagrams_tear_profiles() -> None:
    with (
        served(Layout(time_scale=FAST), cylinder(around=64), "drop-blocks=5") as live,
        open_station(live.station) as station,
    ):
        # Which datagrams an exposure sees is chance; that none of fifty is torn is not.
        for _ in range(50):
            exposure(station)
            if station.profiler.tally().torn_profiles:
                break
        assert station.profiler.tally().torn_profiles > 0


# --- the command ---------------------------------------------------------------------------------


@contextmanager
def running(*words: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """Run `python -m sim`; it does not outlive the block."""
    with subprocess.Popen(
        [sys.executable, "-m", "sim", "--scale", str(FAST), *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=REPOSITORY,
        env={**os.environ, "PYTHONUNBUFFERED": "", **environment},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def few_stops(plan: Plan) -> Plan:
    return replace(plan, ring=replace(plan.ring, step_mm=50.0, last_mm=60.0, profiles_per_turn=3))


@pytest.fixture(scope="module")
def at_a_process(tmp_path_factory: pytest.TempPathFactory) -> Scanned:
    """A scan at the command's own process, which is then ended."""
    out = tmp_path_factory.mktemp("sim")
    with running("--seed", "5", "--out", str(out), "--json") as process:
        told = json.loads(said(process))
        assert told.pop("pid") == process.pid
        names = ("station.toml", "plan.toml", "truth.ply", "witness.jsonl")
        assert list(told.values()) == [str(out / name) for name in names]
        settings, plan = read_station(Path(told["station"])), read_plan(Path(told["plan"]))
        with open_station(settings) as station:
            sweeps = list(scan(station, few_stops(plan), stop=StopRequest()))
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""
    part = find_part("vase")
    assert (out / "truth.ply").read_bytes() == truth_ply(part)
    return Scanned(settings, part, sweeps, read_witness(out / "witness.jsonl"))


def test_a_scan_at_a_process_lies_on_the_true_part_but_for_noise_and_outliers(
    at_a_process: Scanned,
) -> None:
    off_mm = off_the_surface_mm(at_a_process.sweeps, at_a_process.station, at_a_process.part)
    assert len(off_mm) > 1000
    assert np.quantile(np.abs(off_mm), 0.95) < 0.1
    assert 0.015 < np.quantile(np.abs(off_mm), 0.68) < 0.05


def test_the_witness_of_a_process_that_was_ended_is_whole(at_a_process: Scanned) -> None:
    told = [event["what"] for event in at_a_process.events]
    assert told.count("profile") >= 6
    assert [event["on"] for event in at_a_process.events if event["what"] == "laser"][-1] is False


def test_the_same_seed_gives_the_same_sweeps_and_another_seed_others(at_a_process: Scanned) -> None:
    sweeps = []
    for seed in (5, 6):
        layout = Layout(seed=seed, time_scale=2 * FAST)
        plan = few_stops(parse_plan(plan_toml(layout, at_a_process.part)))
        with served(layout, at_a_process.part) as live, open_station(live.station) as station:
            sweeps.append(list(scan(station, plan, stop=StopRequest(), indices=[0])))
    first = at_a_process.sweeps[:1]
    assert contents(sweeps[0]) == contents(first)
    assert contents(sweeps[1]) != contents(first)


def contents(sweeps: Sequence[Sweep]) -> list[object]:
    """Everything of sweeps but times and the numbers of frames."""
    apart = {"sensor_time_s", "frame"}
    return [
        [sweep.index, [(pose.table_rad, pose.stage_mm) for pose in sweep.poses]]
        + [
            np.asarray(getattr(profile, field.name)).tolist()
            for profile in sweep.profiles
            for field in fields(profile)
            if field.name not in apart
        ]
        for sweep in sweeps
    ]


def test_it_tells_the_station_ends_by_ctrl_c_and_leaves_nothing_behind(tmp_path: Path) -> None:
    with running(TMPDIR=str(tmp_path)) as process:
        told = said(process)
        assert told.startswith("station: ")
        station = read_station(Path(told.removeprefix("station: ").strip()))
        assert list(tmp_path.iterdir()) != []
        with open_station(station) as opened:
            assert opened.table.identify().family == "grbl"
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        assert list(tmp_path.iterdir()) == []


def test_it_ends_with_its_parents_pipe_and_keeps_what_it_was_told_to(tmp_path: Path) -> None:
    (tmp_path / "seen.jsonl").write_text('{"of": "an earlier run"}\n')
    files = ("--station", str(tmp_path / "here.toml"), "--witness", str(tmp_path / "seen.jsonl"))
    with running("--while-stdin-open", "--part", "cylinder", *files) as process:
        assert said(process) == f"station: {tmp_path / 'here.toml'}\n"
        assert process.stdin is not None
        process.stdin.write("still here\n")
        process.stdin.flush()
        with open_station(read_station(tmp_path / "here.toml")) as opened:
            assert opened.profiler.identify().family == "baumer_ox"
        assert process.poll() is None
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 0
    assert sorted(each.name for each in tmp_path.iterdir()) == ["here.toml", "seen.jsonl"]
    assert "of" not in [key for event in read_witness(tmp_path / "seen.jsonl") for key in event]


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["--part", "teapot"], "built-in parts are cylinder"),
        (["--faults", "flood"], "known are silent-table"),
        (["--scale", "0"], "above 0"),
        (["--scale", "fast"], "invalid float"),
        (["--outliers", "2"], "0 to 1"),
        (["--seed", "-1"], "2\\*\\*64"),
        (["--nonsense"], "see --help"),
    ],
)
def test_bad_usage_is_one_line_with_the_remedy_and_exit_2(
    words: list[str],
    remedy: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    try:
        code = main(words)
    except SystemExit as left:
        code = int(str(left.code))
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert len(captured.err.strip().splitlines()) == 1
    assert re.search(remedy, captured.err)
    assert list(tmp_path.iterdir()) == []


def test_what_is_asked_for_becomes_the_layout(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[tuple[Layout, Faults]] = []

    def build_none(layout: Layout, *_: object, faults: Faults) -> NoReturn:
        asked.append((layout, faults))
        raise ValueError("enough")

    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr("sim.__main__.build", build_none)
    words = "--seed 9 --scale 2.5 --cloud-width-mm 0.3 --outliers 0.02 --part cone --out"
    assert main([*words.split(), str(tmp_path)]) == 2
    words = "--part cone --faults stall-stage=9 --out"
    assert main([*words.split(), str(tmp_path)]) == 2
    wanted = Layout(seed=9, time_scale=2.5, cloud_width_mm=0.3, outlier_rate=0.02)
    assert asked == [(wanted, Faults()), (Layout(), parse_faults("stall-stage=9"))]
    assert (wanted.optics.flaws.cloud_width_mm, wanted.optics.flaws.outlier_rate) == (0.3, 0.02)
    assert (wanted.optics.flaws.seed, wanted.optics.flaws.speckle_points) == (9, 4)


def test_a_folder_that_cannot_be_made_is_one_line_and_exit_1(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("signal.signal", lambda *_: None)
    (tmp_path / "file").write_bytes(b"")
    assert main(["--out", str(tmp_path / "file" / "out")]) == 1
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_the_parts_and_the_faults_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    listed = capsys.readouterr().out
    for name in (*PARTS, "drop-blocks=N", "silent-relay"):
        assert name in listed


@pytest.mark.parametrize(
    ("other", "fix"),
    [
        (("--cut", "meridians"), "--cut rings"),
        (("--profiler", "hokuyo"), "--profiler baumer_ox or riftek"),
        (("--table", "zaber"), "--table grbl or grblhal"),
    ],
)
def test_a_plan_of_steady_turning_is_refused_where_nobody_could_follow_it(
    other: tuple[str, str], fix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--continuous", *other]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"sim: --continuous: not with {' '.join(other)}; use {fix}")


def test_a_folder_that_a_simulator_serves_from_is_left_to_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "station.toml").write_text("of another")
    holder = os.open(tmp_path, os.O_RDONLY)
    try:
        fcntl.flock(holder, fcntl.LOCK_EX)
        assert main(["--out", str(tmp_path)]) == 2
    finally:
        os.close(holder)
    assert "another simulator serves from there" in capsys.readouterr().err
    assert (tmp_path / "station.toml").read_text() == "of another"
