"""The home switch as a witness, the controller's own travel, and grblHAL's dialect."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.axis import Kind
from drivers.errors import Refused
from drivers.grbl import GrblAxis, Homing, Settings
from sim.grbl import GrblBoard, GrblSettings
from sim.motion import Limits
from tests.sim.judges import TABLE, Rig, world_axis

WATCHED = replace(TABLE, tolerance=math.radians(0.05))


class Bench(Rig):
    """A board that turns a table, and the driver that commands it."""

    def __init__(self, made: GrblSettings | None = None, settings: Settings = WATCHED) -> None:
        self.axis = world_axis("table", 0.3, Limits(math.pi, 30.0))
        self.board = GrblBoard(self.axis, made or GrblSettings())
        self.heard: list[bytes] = []
        super().__init__(self)
        self.table = GrblAxis(self.link, settings, clock=self.clock)

    def receive(self, data: bytes, now_s: float) -> bytes:
        if data:
            self.heard.append(data)
        return self.board.receive(data, now_s)

    def tick(self, now_s: float) -> bytes:
        return self.board.tick(now_s)

    def set(self, line: bytes) -> None:
        """Write a setting past the driver, before it has spoken."""
        self.board.receive(line + b"\n", self.now_s)


def test_the_switch_is_found_where_homing_found_it() -> None:
    bench = Bench()
    bench.table.home(bench.pause)
    for turns in (0, 1):
        assert abs(bench.table.check_reference(bench.pause, turns=turns)) < math.radians(0.05)
        assert math.isclose(
            bench.table.state().position, turns * math.tau, abs_tol=math.radians(0.02)
        )


@pytest.mark.parametrize("lost_deg", [0.3, 1.0, 1.7, 5.0])
def test_steps_that_were_lost_are_found_by_the_switch(lost_deg) -> None:
    bench = Bench()
    bench.table.home(bench.pause)
    home_rad = bench.axis.motor(bench.now_s)
    bench.axis.obstacle = home_rad + math.radians(90.0 - lost_deg)
    assert bench.table.move_to(math.radians(90.0), bench.pause).homed  # it counts what it sends
    bench.axis.obstacle = None
    with pytest.raises(Refused, match=r"the home switch is .* from its place.*steps were lost"):
        bench.table.check_reference(bench.pause)
    assert not bench.table.state().homed


@pytest.mark.parametrize("deep_deg", [0.5, 2.5, 4.9])
def test_a_table_that_stands_on_its_cam_leaves_it_before_it_homes(deep_deg: float) -> None:
    made = GrblSettings()  # its cam is 5 degrees long, its pull-off 2
    bench = Bench(made)
    bench.axis = world_axis(
        "table", math.radians(made.switch_deg + deep_deg), Limits(math.pi, 30.0)
    )
    bench.board = GrblBoard(bench.axis, made)
    bench.table.home(bench.pause)
    home_deg = math.degrees(bench.axis.motor(bench.now_s)) % 360.0
    assert math.isclose(home_deg, made.switch_deg - made.pull_off_deg, abs_tol=0.05)
    assert abs(bench.table.check_reference(bench.pause)) < math.radians(0.05)


def test_a_switch_that_stays_closed_ends_the_homing_with_the_axis_at_rest() -> None:
    bench = Bench(GrblSettings(cam_deg=359.0))
    with pytest.raises(Refused, match=r"stays closed over 20 deg; check its wiring"):
        bench.table.home(bench.pause)
    assert not bench.table.state().homed
    assert b"$H\n" not in b"".join(bench.heard)


def test_with_the_boards_limits_on_a_closed_switch_is_the_boards_own_affair() -> None:
    bench = Bench(GrblSettings(cam_deg=359.0))
    bench.set(b"$21=1")
    with pytest.raises(Refused, match="did not clear the switch"):
        bench.table.home(bench.pause)


def test_a_gear_that_is_not_what_everybody_says_is_found_by_a_turn() -> None:
    bench = Bench(GrblSettings(steps_per_deg=80.0 * 1.003))
    bench.set(b"$100=80")  # the board believes the station, and both are wrong
    bench.table.home(bench.pause)
    bench.table.check_reference(bench.pause)  # near home nothing shows
    with pytest.raises(Refused, match="the home switch is"):
        bench.table.check_reference(bench.pause, turns=1)


def test_a_check_that_cannot_be_done_says_why() -> None:
    for code in (20, 21):
        bench = Bench(GrblSettings(travel_deg=400.0), replace(WATCHED, lower=-1.0, upper=1.0))
        bench.set(b"$%d=1" % code)
        bench.table.home(bench.pause)
        with pytest.raises(Refused, match=f"set \\${code}=0"):
            bench.table.check_reference(bench.pause)
    software = Bench(settings=replace(WATCHED, homing=Homing.SOFTWARE_ZERO))
    software.table.home(software.pause)
    with pytest.raises(Refused, match="no switch to compare with"):
        software.table.check_reference(software.pause)
    linear = Bench(settings=replace(WATCHED, kind=Kind.LINEAR, speed=20.0))
    with pytest.raises(ValueError, match="no turns"):
        linear.table.check_reference(linear.pause, turns=1)


def test_a_move_beyond_the_boards_own_travel_is_refused_before_a_byte_is_sent() -> None:
    bench = Bench(GrblSettings(travel_deg=100.0))
    bench.set(b"$20=1")
    bench.table.home(bench.pause)
    bench.table.move_to(math.radians(-90.0), bench.pause)
    bench.heard.clear()
    for outside_deg in (-99.0, 3.0):  # home is 2 below the board's upper end
        with pytest.raises(Refused, match=r"its own travel -100 to 0; raise \$130"):
            bench.table.move_to(math.radians(outside_deg), bench.pause)
    assert bench.heard == []


def test_a_grblhal_board_of_four_axes_turns_its_a_axis() -> None:
    bench = Bench(GrblSettings(letter="A", hal=True), replace(WATCHED, letter="A"))
    who = bench.table.identify()
    assert (who.model, who.firmware) == ("GrblHAL", "1.1f.20260817")
    bench.table.home(bench.pause)
    home_rad = bench.axis.motor(bench.now_s)
    for target_rad in (1.0, 7.0, -1.0):
        state = bench.table.move_to(target_rad, bench.pause)
        assert math.isclose(bench.axis.motor(bench.now_s) - home_rad, target_rad, abs_tol=5e-4)
        assert math.isclose(state.position, target_rad, abs_tol=5e-4)
    moves = [line for line in b"".join(bench.heard).split(b"\n") if b"G53" in line]
    assert all(line.lstrip(b"?").startswith(b"G21G94G53G1A") for line in moves)


def test_the_sizes_of_planner_and_line_buffer_are_what_the_board_says() -> None:
    for hal, sizes in ((False, (15, 128)), (True, (100, 1024))):
        bench = Bench(GrblSettings(hal=hal))
        bench.table.identify()
        assert bench.table._talk.dialogue.sizes == sizes


def test_what_grblhal_adds_has_names() -> None:
    from drivers.grbl.messages import Feedback, alarm_name, error_name, parsed

    assert error_name(53) == "error:53 (setting not available)"
    assert alarm_name(17) == "ALARM:17 (motor fault)"
    assert parsed("[NVS STORAGE:*EEPROM]") == Feedback("NVS STORAGE", "*EEPROM")


@pytest.mark.parametrize(("mask", "line"), [(1, b"$H\n"), (3, b"$HA\n")])
def test_grblhal_homes_the_axis_alone_where_that_is_allowed(mask, line) -> None:
    bench = Bench(GrblSettings(letter="A", hal=True), replace(WATCHED, letter="A"))
    bench.set(b"$22=%d" % mask)
    assert bench.table.home(bench.pause).homed
    assert line in b"".join(bench.heard)


def test_a_firmware_before_1_1_is_refused() -> None:
    bench = Bench()
    bench.board._tell = lambda _: bench.board._say("[VER:0.9j.20160303:]")  # type: ignore[method-assign]
    with pytest.raises(Refused, match=r"firmware 0\.9j\.20160303"):
        bench.table.identify()
