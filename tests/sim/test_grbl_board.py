"""The simulated Grbl board: what gnea/grbl documents, and the driver at the other end of it.

A transcript is what goes over the wire::

    > G1X10F600       a line to the board          rt !\\x85    characters without an end of line
    < ok              its next line                wait 0.5    seconds

All that the board says must stand in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drivers.grbl.axis
from drivers.axis import Kind, Motion
from drivers.errors import Refused
from drivers.grbl import GrblAxis, Homing, Settings
from drivers.loopback import loopback
from sim.grbl import GrblBoard, GrblSettings
from sim.motion import AxisMotion, Limits, Play
from sim.witness import Memory
from sim.world import Pace, WorldAxis

BANNER = "Grbl 1.1h ['$' for help]"
LOCKED = "[MSG:'$H'|'$X' to unlock]"
UNHOMED = GrblSettings(homing=False)
STEP_DEG = 1.0 / GrblSettings().steps_per_deg


def table(*, play_deg: float = 0.0, at_deg: float = 0.0, pace: Pace | None = None) -> WorldAxis:
    motor = Limits(math.radians(120.0), math.radians(360.0))
    play = Play(math.radians(play_deg))
    motion = AxisMotion.standing(math.radians(at_deg), motor, play)
    return WorldAxis("table", motion, pace or Pace(), Memory())


def motor_deg(axis: WorldAxis, now_s: float) -> float:
    return math.degrees(axis.motor(now_s))


class Host:
    """Somebody at the other end of the wire, with a clock."""

    def __init__(self, board: GrblBoard) -> None:
        self.board = board
        self.now_s = 100.0
        self.heard = self.lines(board.tick(self.now_s))

    def lines(self, said: bytes) -> list[str]:
        return [line for line in said.decode().split("\r\n") if line]

    def say(self, text: str) -> list[str]:
        return self.lines(self.board.receive(text.encode("latin-1"), self.now_s))

    def wait(self, seconds: float) -> list[str]:
        end_s, heard = self.now_s + seconds, []
        while self.now_s < end_s:
            self.now_s = min(self.now_s + 0.01, end_s)
            heard += self.lines(self.board.tick(self.now_s))
        return heard

    def follow(self, transcript: str) -> None:
        pending: list[str] = []
        for line in filter(None, map(str.strip, transcript.splitlines())):
            kind, _, text = line.partition(" ")
            if kind == "<":
                assert pending[:1] == [text], f"instead of {line}: {pending}"
                pending.pop(0)
                continue
            assert not pending, f"before {line}: {pending}"
            if kind == "wait":
                pending = self.wait(float(text))
            else:
                escaped = text.encode().decode("unicode_escape")
                pending = self.say(escaped if kind == "rt" else escaped + "\n")
        assert not pending, f"at the end: {pending}"

    def position_deg(self) -> float:
        (report,) = self.say("?")
        return float(report.partition("MPos:")[2].partition(",")[0])


def idle(board_settings: GrblSettings = UNHOMED, axis: WorldAxis | None = None) -> Host:
    """A board whose first two reports, with the rare fields, are over."""
    host = Host(GrblBoard(axis or table(), board_settings))
    host.say("??")
    return host


# --- lines ------------------------------------------------------------------------------------


def test_a_board_that_homes_starts_locked_and_tells_the_rare_fields_once():
    host = Host(GrblBoard(table(), GrblSettings()))
    assert host.heard == [BANNER, LOCKED]
    host.follow("""
        rt ?
        < <Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>
        rt ?
        < <Alarm|MPos:0.000,0.000,0.000|FS:0,0|Ov:100,100,100>
        rt ?
        < <Alarm|MPos:0.000,0.000,0.000|FS:0,0>
        > G0X1
        < error:9
        > $J=X1F100
        < error:8
        > $I
        < [VER:1.1h.20190830:]
        < [OPT:V,15,128]
        < ok
        > $X
        < [MSG:Caution: Unlocked]
        < ok
        > G0X1
        < ok
    """)


def test_a_board_that_does_not_home_starts_idle():
    host = Host(GrblBoard(table(), UNHOMED))
    assert host.heard == [BANNER]
    host.follow("rt ?\n< <Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>")


@pytest.mark.parametrize(("moving", "every"), [("", 10), ("G1X3000F60\n", 30)])
def test_the_work_offset_is_told_every_so_many_reports(moving, every):
    host = Host(GrblBoard(table(), UNHOMED))
    host.say(moving)
    told = ["WCO:" in line for line in host.say("?" * (2 * every + 1)) if line != "ok"]
    assert [index for index, seen in enumerate(told) if seen] == [0, every, 2 * every]


def test_lines_are_read_as_the_firmware_reads_them():
    host = idle()
    host.follow(r"""
        >
        < ok
        rt \r\n
        < ok
        < ok
        > ; a comment
        < ok
        > g0 (to one) x 1 / ; there
        < ok
        wait 1
        rt ?
        < <Idle|MPos:1.000,0.000,0.000|FS:0,0>
    """)
    assert host.say("G0X2" + " " * 200 + "\n") == ["ok"]
    assert host.say("G0X1." + "0" * 74 + "\n") == ["ok"]
    assert host.say("G0X1." + "0" * 75 + "\n") == ["error:11"]
    assert host.say("G0X1\n") == ["ok"]


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("10", 1), ("GX1", 2), ("G1X-F100", 2), ("$foo", 2), ("$X1", 3), ("$HX", 3), ("$JX1", 3),
        ("$16=1", 3), ("$300=1", 3), ("$100=80X", 3), ("$26=-1", 4), ("G1X1F-1", 4), ("$H", 5),
        ("$0=2", 6), ("$20=1", 10), ("$J=G0X1F100", 16), ("$J=M5X1F100", 16), ("G2X1I1F10", 20),
        ("G0A1", 20), ("M6", 20), ("G92.5X1", 20), ("G10L3P1X0", 20), ("G20G21", 21),
        ("G1X1", 22), ("$J=X1", 22), ("$J=X1F0", 22), ("G0.5X1", 23), ("M3.5", 23),
        ("G10G92X1", 24), ("G0G1X1F1", 24), ("X1X2", 25), ("G92", 26), ("G10L2P1", 26),
        ("G0X1N10000001", 27), ("G4", 28), ("G10X1", 28), ("G10L2P7X0", 29), ("G80G53", 30),
        ("G80X1", 31), ("G0X1P1", 36), ("G0X1I1", 36), ("$J=X1F100S1", 36), ("T256", 38),
    ],
)  # fmt: skip
def test_a_faulty_line_is_answered_by_its_number_and_moves_nothing(line, error):
    host = idle()
    assert host.say(line + "\n") == [f"error:{error}"]
    assert host.wait(0.5) == []
    assert host.say("?") == ["<Idle|MPos:0.000,0.000,0.000|FS:0,0>"]
    assert host.say("$G\n")[0] == "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"


def test_modes_stay_until_the_program_ends_and_the_units_after_it():
    idle().follow("""
        > G1G55G20G91F10M3S500T7
        < ok
        > $G
        < [GC:G1 G55 G17 G20 G91 G94 M3 M9 T7 F254 S500]
        < ok
        rt ?
        < <Idle|MPos:0.000,0.000,0.000|FS:0,500|WCO:0.000,0.000,0.000>
        > M2
        < [MSG:Pgm End]
        < ok
        rt ?
        < <Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>
        > $G
        < [GC:G1 G54 G17 G20 G90 G94 M5 M9 T0 F254 S500]
        < ok
    """)


def test_a_jog_changes_no_mode_and_no_feed_rate():
    host = idle()
    host.follow("> $J=G91G20X1F100\n< ok\nwait 3")
    assert host.position_deg() == pytest.approx(25.4, abs=STEP_DEG)
    assert host.say("$G\n")[0] == "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"


def test_work_coordinates_are_offset_and_machine_coordinates_are_not():
    host = idle()
    host.follow("""
        > G0X10
        < ok
        wait 1
        > G10L20P2X2
        < ok
        > G92X1
        < ok
        > G55
        < ok
        rt ?
        < <Idle|MPos:10.000,0.000,0.000|FS:0,0|WCO:17.000,0.000,0.000>
        > G0X0
        < ok
        wait 1
    """)
    assert host.position_deg() == 17.0
    assert {"[G54:0.000,0.000,0.000]", "[G55:8.000,0.000,0.000]", "[G92:9.000,0.000,0.000]"} < set(
        host.say("$#\n")
    )
    host.follow("> G53G0X3\n< ok\nwait 1\n> $10=0\n< ok")
    assert host.say("?") == ["<Idle|WPos:-14.000,0.000,0.000|FS:0,0>"]
    host.follow("> G10L20P2X1\n< ok\n> $10=1\n< ok")  # 3 = 9 of G92, -7 of G55, and 1
    assert "[G55:-7.000,0.000,0.000]" in host.say("$#\n")
    host.follow("> G10L2P2X4\n< ok")
    assert "|WCO:13.000,0.000,0.000" in host.say("?")[0]
    host.follow("> G92X0\n< ok")  # 3 = -1 of G92 and 4 of G55
    assert "[G92:-1.000,0.000,0.000]" in host.say("$#\n")
    host.follow("> G92.1\n< ok\n> G10L2P0X1\n< ok\n> $J=X0F3000\n< ok\nwait 1\n> $10=1\n< ok")
    assert host.position_deg() == 1.0


def test_reports_are_in_inches_if_so_set():
    host = idle()
    host.follow("""
        > $13=1
        < ok
        > G20G0X1
        < ok
        wait 2
        rt ?
        < <Idle|MPos:1.0000,0.0000,0.0000|FS:0.0,0|WCO:0.0000,0.0000,0.0000>
    """)


def test_an_axis_that_stock_boards_lack_is_reported_fourth():
    axis = table()
    host = idle(GrblSettings(letter="A", homing=False), axis)
    host.follow("""
        > $I
        < [VER:1.1h.20190830:]
        < [OPT:V,15,128]
        < [AXS:4:XYZA]
        < ok
        > G0A5X3
        < ok
        wait 1
        rt ?
        < <Idle|MPos:0.000,0.000,0.000,5.000|FS:0,0>
    """)
    assert motor_deg(axis, host.now_s) == pytest.approx(5.0)
    assert "$103=80.000" in host.say("$$\n")


# --- settings ---------------------------------------------------------------------------------


def test_settings_survive_a_loss_of_power_and_the_position_does_not():
    host = idle()
    host.follow("> $110=600\n< ok\n> G0X5\n< ok\nwait 2")
    host.board.power_cycle(host.now_s)
    assert host.wait(0.01) == [BANNER]
    assert "$110=600.000" in host.say("$$\n")
    assert host.position_deg() == 0.0


def test_a_wrong_number_of_steps_turns_the_table_wrongly():
    axis = table()
    host = idle(axis=axis)
    host.follow("> $100=40\n< ok\n> G0X20\n< ok\nwait 2")
    assert host.position_deg() == 20.0
    assert motor_deg(axis, host.now_s) == pytest.approx(10.0)


def test_no_move_is_faster_than_the_setting():
    axis = table()
    host = idle(axis=axis)
    host.follow("> $110=600\n< ok\n> G1X20F6000\n< ok\nwait 1")
    assert host.say("?") == ["<Run|MPos:9.863,0.000,0.000|FS:600,0>"]
    assert motor_deg(axis, host.now_s) == pytest.approx(10.0, abs=0.2)


def test_numbers_no_table_can_follow_do_not_stop_the_board():
    host = idle()
    assert host.say("$100=0\n$110=0\n$120=0\n") == ["error:3"] * 3
    assert host.say("G0X1" + "0" * 70 + "\n") == ["ok"]
    assert host.say("?")[0].startswith("<Run|")


def test_soft_limits_go_with_homing():
    host = idle(GrblSettings())
    host.say("$20=1\n")
    assert "$20=1" in host.say("$$\n")
    host.say("$22=0\n")
    assert "$20=0" in host.say("$$\n")


def test_positions_are_whole_steps():
    axis = table()
    host = idle(axis=axis)
    host.follow("> G0X0.007\n< ok\nwait 1")
    assert host.position_deg() == 0.013
    assert motor_deg(axis, host.now_s) == pytest.approx(0.0125)
    host.follow("> G0X0.006\n< ok\nwait 1")
    assert host.position_deg() == 0.0
    host.follow("> G0X-0.007\n< ok\nwait 1")
    assert host.position_deg() == -0.013


def test_after_45_turns_a_thousandth_of_a_degree_is_no_longer_told_apart():
    fine = replace(UNHOMED, steps_per_deg=1000.0, max_rate_deg_min=1e7, acceleration_deg_s2=1e6)
    fast = Limits(1e4, 1e6)
    axis = WorldAxis("table", AxisMotion.standing(0.0, fast), Pace(), Memory())
    host = idle(fine, axis)
    host.follow("> G0X16777.217\n< ok\nwait 2")
    assert motor_deg(axis, host.now_s) == pytest.approx(16777.216, abs=1e-5)
    host.follow("> G0X20000.001\n< ok\nwait 2")
    assert host.position_deg() == 20000.002


# --- motion -----------------------------------------------------------------------------------


def test_ok_says_that_a_move_is_understood_and_a_dwell_that_it_is_done():
    axis = table()
    host = idle(axis=axis)
    assert host.say("G1X10F600\n") == ["ok"]
    assert host.wait(0.5) == []
    assert host.say("?") == ["<Run|MPos:4.863,0.000,0.000|FS:600,0>"]
    assert host.say("$$\nG4P0.01\n") == ["error:8"]
    assert motor_deg(axis, host.now_s) == pytest.approx(4.861, abs=1e-3)
    assert host.wait(0.57) == []
    assert host.say("?")[0].startswith("<Idle|MPos:10.000,")
    assert host.wait(0.01) == ["ok"]  # 1 s and two half ramps of 14 ms, and 50 ms of dwell


def test_a_dwell_of_nothing_is_over_at_once():
    assert idle().say("G4P0\n?") == ["ok", "<Idle|MPos:0.000,0.000,0.000|FS:0,0>"]


@pytest.mark.parametrize("scale", [0.3, 1.0, 7.0, 97.3])
def test_moves_end_whatever_the_pace(scale):
    board = GrblBoard(table(pace=Pace(origin_s=1234.567, scale=scale)), UNHOMED)
    now_s = 5021.443
    said = board.tick(now_s)
    for number in range(60):
        said += board.receive(f"G1X{number % 7 + number / 9:.3f}F{600 + number}\n".encode(), now_s)
        now_s += 3.0 / scale
    assert said.count(b"ok") == 60
    assert b"<Idle|MPos:9.550," in board.receive(b"?", now_s)


def test_fifteen_moves_are_queued_and_run_one_after_the_other():
    axis = table()
    host = idle(axis=axis)
    turns = "".join(f"G1X{10 * (-1) ** n}F6000\n" for n in range(16))
    assert host.say(turns) == ["ok"] * 15
    assert host.wait(0.5) == ["ok"]
    assert host.wait(10.0) == []
    moves = [each for each in axis._witness.events if each["what"] == "move"]
    ends = [round(math.degrees(each["target"])) for each in moves]
    assert ends == [10, -10] * 8
    begins = [each["time_s"] for each in moves[1:]]
    assert begins == pytest.approx([each["ends_s"] for each in moves[:-1]], abs=1e-9)


def test_how_seldom_a_board_is_asked_changes_nothing_of_its_moves():
    often, rarely = table(), table()
    for axis, steps in ((often, 400), (rarely, 2)):
        board = GrblBoard(axis, UNHOMED)
        said = board.receive(b"G1X10F3000\nG1X-5\nG4P1\nG0X3\n", 1.0)
        for step in range(1, steps + 1):
            said += board.tick(1.0 + 4.0 * step / steps)
        assert said.count(b"ok") == 4
    assert often._witness.events == rarely._witness.events


def test_moves_follow_the_station_s_pace():
    host = idle(axis=table(pace=Pace(origin_s=3.0, scale=10.0)))
    host.follow("""
        > G1X100F600
        < ok
        wait 0.5
        rt ?
        < <Run|MPos:49.863,0.000,0.000|FS:600,0>
        wait 0.6
        rt ?
        < <Idle|MPos:100.000,0.000,0.000|FS:0,0>
    """)


def test_overrides_hold_for_the_moves_to_come_and_are_told():
    host = idle()
    host.follow(r"""
        rt \x91\x93\x96
        rt ?
        < <Idle|MPos:0.000,0.000,0.000|FS:0,0|Ov:111,50,100>
        > G1X20F600
        < ok
        wait 0.5
        rt ?
        < <Run|MPos:5.375,0.000,0.000|FS:666,0>
        rt \x90
        wait 2
        > $J=X0F600
        < ok
        wait 0.5
        rt ?
        < <Jog|MPos:15.138,0.000,0.000|FS:600,0|Ov:100,50,100>
    """)


def test_a_hold_slows_down_keeps_the_rest_and_answers_no_line_until_it_is_resumed():
    axis = table()
    host = idle(axis=axis)
    host.follow("""
        > G1X60F3600
        < ok
        wait 0.5
        rt !
        wait 0.05
    """)
    assert host.say("?")[0].startswith("<Hold:1|")
    braking_deg = 60.0**2 / (2 * 360.0)
    host.wait(0.5)
    assert motor_deg(axis, host.now_s) == pytest.approx(25.0 + braking_deg, abs=0.01)
    host.follow("""
        rt ?
        < <Hold:0|MPos:30.000,0.000,0.000|FS:0,0>
        > $G
        wait 1
        rt ~
        < [GC:G1 G54 G17 G21 G90 G94 M5 M9 T0 F3600 S0]
        < ok
        wait 1
        rt ?
        < <Idle|MPos:60.000,0.000,0.000|FS:0,0>
    """)


def test_a_hold_of_an_idle_board_leaves_it_deaf_to_lines():
    idle().follow("""
        rt !
        > G0X1
        rt ?
        < <Hold:0|MPos:0.000,0.000,0.000|FS:0,0>
        wait 1
        rt ~
        < ok
        wait 1
        rt ?
        < <Idle|MPos:1.000,0.000,0.000|FS:0,0>
    """)


def test_a_pause_waits_for_the_moves_before_it_and_for_the_operator():
    host = idle()
    host.follow("> G1X1F600\n< ok\n> M0\nwait 1")
    assert host.say("?") == ["<Hold:0|MPos:1.000,0.000,0.000|FS:0,0>"]
    assert host.say("~") == ["ok"]


@pytest.mark.parametrize("ending", ["!", "\x85"])
def test_a_jog_is_cancelled_without_losing_the_position(ending):
    axis = table()
    host = idle(axis=axis)
    # Once as jogging.md has it, with spaces, and once without them.
    host.follow("> $J=G91 X90 F3600\n< ok\n> $J=G91X90F3600\n< ok\n> G0X0\n< error:9\nwait 0.5")
    host.say(ending)
    assert host.say("?$G\n")[0].startswith("<Jog|MPos:25.0")
    assert host.wait(0.15) == []  # no line is read while it slows down
    assert len(host.wait(0.15)) == 2
    assert host.say("?") == ["<Idle|MPos:30.000,0.000,0.000|FS:0,0>"]
    assert motor_deg(axis, host.now_s) == pytest.approx(30.0, abs=STEP_DEG / 2)
    host.follow("> $J=G91X1F3600\n< ok\nwait 1")
    assert host.position_deg() == 31.0


def test_a_jog_cancel_after_the_jog_does_nothing_and_a_hold_suspends():
    idle().follow(r"""
        > $J=G91X1F3600
        < ok
        wait 1
        rt \x85
        > $G
        < [GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]
        < ok
        rt !
        > $G
        rt ?
        < <Hold:0|MPos:1.000,0.000,0.000|FS:0,0>
    """)


def test_a_jog_cancel_in_the_moment_the_jog_ends_suspends_an_idle_board():
    idle(replace(UNHOMED, late_cancel_s=0.02)).follow(r"""
        > $J=G91X1F6000
        < ok
        wait 0.11
        rt \x85?
        < <Idle|MPos:1.000,0.000,0.000|FS:0,0>
        > G4P0
        wait 1
        rt ?
        < <Idle|MPos:1.000,0.000,0.000|FS:0,0>
        rt ~
        < ok
    """)


def test_a_jog_without_axis_words_goes_to_machine_zero():
    host = idle()
    host.follow("> G0X5\n< ok\nwait 1\n> $J=G91F3000\n< ok\nwait 1")
    assert host.position_deg() == 0.0


def test_bytes_beyond_the_buffer_are_lost():
    host = idle()
    host.follow("> $10=3\n< ok\nrt !")
    host.say(" " * 127 + "\n" + "G0X1\n")
    assert host.say("?") == ["<Hold:0|MPos:0.000,0.000,0.000|Bf:15,0|FS:0,0>"]
    assert host.say("~") == ["ok"]
    assert host.say("?") == ["<Idle|MPos:0.000,0.000,0.000|Bf:15,128|FS:0,0>"]


def test_the_board_counts_on_when_the_motor_stalls():
    axis = table()
    axis.obstacle = math.radians(4.0)
    host = idle(axis=axis)
    host.follow("> G1X10F3000\n< ok\nwait 1")
    assert host.position_deg() == 10.0
    assert motor_deg(axis, host.now_s) == pytest.approx(4.0)
    axis.obstacle = None
    host.follow("> G1X0F3000\n< ok\nwait 1")
    assert motor_deg(axis, host.now_s) == pytest.approx(-6.0)


# --- resets and alarms ------------------------------------------------------------------------


def test_a_reset_in_motion_is_an_alarm_and_loses_the_position():
    axis = table()
    host = idle(axis=axis)
    host.follow(r"""
        > G1X60F3600
        < ok
        wait 0.5
        rt \x18
        < ALARM:3
        rt ?
        > $X
        wait 0.49
    """)
    assert host.wait(0.02) == [BANNER, LOCKED]
    assert host.say("?")[0].startswith("<Alarm|MPos:25.0")
    assert motor_deg(axis, host.now_s) == pytest.approx(30.0, abs=0.01)
    host.follow("> G0X0\n< error:9\n> $X\n< [MSG:Caution: Unlocked]\n< ok\n> G0X0\n< ok\nwait 1")
    assert motor_deg(axis, host.now_s) == pytest.approx(5.0, abs=0.01)


def test_a_reset_does_not_unlock():
    host = Host(GrblBoard(table(), GrblSettings()))
    assert host.say("\x18") == [BANNER, LOCKED]
    host.say("$X\n\x91")
    assert host.say("\x18") == [BANNER]
    assert host.say("??")[1].endswith("|Ov:100,100,100>")


def test_after_a_reset_in_motion_the_board_waits_for_a_motor_that_coasts():
    motion = AxisMotion.standing(0.0, Limits(math.radians(60.0), math.radians(30.0)))
    axis = WorldAxis("table", motion, Pace(), Memory())
    host = idle(axis=axis)
    host.follow("> G1X600F3600\n< ok\nwait 4")
    assert host.say("\x18") == ["ALARM:3"]
    assert host.wait(1.9) == []
    assert host.wait(0.2) == [BANNER, LOCKED]
    assert host.position_deg() == pytest.approx(180.0, abs=STEP_DEG)
    host.say("$X\nG0X180\nG0X190\n")
    host.wait(3.0)
    assert motor_deg(axis, host.now_s) == pytest.approx(250.0, abs=0.05)


@pytest.mark.parametrize("before", ["", "G1X60F3600\n", "$J=X60F3600\n"])
def test_a_reset_of_a_standing_board_keeps_the_position_and_drops_the_rest(before):
    host = idle()
    host.say(before)
    host.wait(0.5)
    host.say("\x85!")
    host.wait(0.5)
    stood_deg = host.position_deg()
    assert host.say("\x18") == [BANNER]
    assert host.wait(1.0) == []
    assert host.say("?")[0].startswith("<Idle|")
    assert host.position_deg() == stood_deg
    assert host.say("$G\n")[0] == "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"


def test_a_reset_while_a_hold_slows_down_loses_the_position():
    host = idle()
    host.follow("> G1X60F3600\n< ok\nwait 0.5\nrt !\nwait 0.05")
    assert host.say("\x18") == ["ALARM:3"]


def test_soft_limits_refuse_a_jog_and_stop_a_program():
    axis = table()
    host = Host(GrblBoard(axis, GrblSettings(travel_deg=90.0)))
    host.follow("""
        > $X
        < [MSG:Caution: Unlocked]
        < ok
        > $20=1
        < ok
        > $J=X1F600
        < error:15
        > $J=X-91F600
        < error:15
        > G1X-90F3600
        < ok
        wait 0.5
        > G0X1
    """)
    assert host.say("?")[0].startswith("<Hold:1|MPos:-25.0")
    assert host.wait(0.2) == ["ALARM:2"]
    assert motor_deg(axis, host.now_s) == pytest.approx(-30.0, abs=0.01)
    host.follow(r"""
        rt \x18
        wait 0.5
        < [MSG:Reset to continue]
        rt ?!~
        > $X
        wait 2
        rt \x18
        < Grbl 1.1h ['$' for help]
        < [MSG:'$H'|'$X' to unlock]
    """)
    assert host.position_deg() == -30.0
    assert motor_deg(axis, host.now_s) == pytest.approx(-30.0, abs=0.01)


def test_a_hard_limit_is_an_alarm_only_where_it_is_enabled():
    axis = table()
    host = idle(axis=axis)
    host.say("G1X60F3600\n")
    host.wait(0.5)
    host.board.press_limit(host.now_s)
    assert host.say("?")[0].startswith("<Run|")
    host.board.release_limit(host.now_s)
    assert host.say("$21=1\n") == ["error:8"]
    host.follow("wait 1\n> $21=1\n< ok\n> G1X0F3600\n< ok\nwait 0.5")
    host.board.press_limit(host.now_s)
    assert host.wait(0.6) == ["ALARM:1", "[MSG:Reset to continue]"]
    assert motor_deg(axis, host.now_s) == pytest.approx(30.0, abs=0.01)
    assert host.say("?$X\n") == []
    assert host.say("\x18") == [BANNER, "[MSG:Check Limits]", LOCKED]
    assert "|Pn:X" in host.say("?")[0]
    assert host.position_deg() == pytest.approx(35.0, abs=0.1)


# --- homing -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("at_deg", "downward", "rest_deg", "position_deg"),
    [
        (0.0, False, 28.0, -2.0),
        (100.0, False, 388.0, -2.0),
        (32.0, False, 28.0, -2.0),
        (-700.0, False, -692.0, -2.0),
        (100.0, True, 37.0, -3598.0),
        (0.0, True, 37.0 - 360.0, -3598.0),
    ],
)
def test_homing_ends_a_pull_off_before_the_switch(at_deg, downward, rest_deg, position_deg):
    axis = table(at_deg=at_deg)
    host = Host(GrblBoard(axis, GrblSettings()))
    if downward:
        host.say("$23=1\n")
    assert host.say("$H\n") == []
    assert host.wait(30.0) == ["ok"]
    assert motor_deg(axis, host.now_s) == pytest.approx(rest_deg, abs=2 * STEP_DEG)
    assert host.position_deg() == position_deg
    assert host.say("?")[0].startswith("<Idle|")


def test_while_it_homes_it_answers_all_questions_once_at_the_end():
    host = Host(GrblBoard(table(), GrblSettings()))
    host.say("??")
    assert host.say("$H\n?!\x85?") == []
    assert host.wait(0.5) == []
    assert host.say("?$G\n") == []
    report, *others = host.wait(5.0)
    assert report == "<Home|MPos:-2.000,0.000,0.000|FS:0,0>"
    assert others == ["ok", "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]", "ok"]


def test_a_reset_while_it_homes_is_an_alarm():
    host = Host(GrblBoard(table(), GrblSettings()))
    host.say("$H\n")
    host.wait(0.3)
    assert host.say("\x18") == ["ALARM:6"]
    assert host.wait(0.6) == [BANNER, LOCKED]


@pytest.mark.parametrize(
    ("built", "alarm"),
    [
        (GrblSettings(travel_deg=10.0), "ALARM:9"),
        (GrblSettings(cam_deg=358.5, switch_deg=2.0), "ALARM:8"),
    ],
)
def test_homing_that_fails_is_an_alarm(built, alarm):
    host = Host(GrblBoard(table(), built))
    host.say("$H\n")
    assert host.wait(3.0) == [alarm, BANNER, LOCKED]


# --- pieces of a stream -----------------------------------------------------------------------


def line_of(text: str) -> str:
    return text + "\n"


LINES = st.sampled_from(
    [
        "G1X5F3000",
        "G0X-3",
        "$J=G91X4F2000",
        "$G",
        "G4P0.1",
        "G4P0",
        "M0",
        "$H",
        "$X",
        "",
        "(x)",
        "G1X",
        "$$",
    ]
)
NONSENSE = st.text("GXFMPNJ$=.-+0123459 H;(", max_size=20)
CHARACTERS = st.sampled_from(["?", "!", "~", "\x85", "\x18", "\x91", "?", "~"])
PIECES = st.lists(st.one_of(LINES.map(line_of), NONSENSE.map(line_of), CHARACTERS), max_size=12)


@settings(deadline=None, max_examples=60)
@given(
    stream=st.lists(st.tuples(st.floats(0.0, 0.7), PIECES.map("".join)), max_size=6),
    built=st.sampled_from([UNHOMED, GrblSettings(late_cancel_s=0.1), GrblSettings(letter="Z")]),
    data=st.data(),
)
def test_answers_do_not_depend_on_the_pieces_in_which_bytes_come(stream, built, data):
    whole_axis, cut_axis = table(), table()
    whole, cut = GrblBoard(whole_axis, built), GrblBoard(cut_axis, built)
    said, said_in_pieces, now_s = b"", b"", 1.0
    for seconds, text in [*stream, (30.0, "")]:
        for share in sorted(data.draw(st.lists(st.floats(0.0, 1.0), max_size=3))):
            said_in_pieces += cut.tick(now_s + share * seconds)
        now_s += seconds
        sent = text.encode("latin-1")
        said += whole.receive(sent, now_s)
        size = data.draw(st.integers(1, 9))
        for at in range(0, max(len(sent), 1), size):
            said_in_pieces += cut.receive(sent[at : at + size], now_s)
    assert said_in_pieces == said
    assert cut_axis._witness.events == whole_axis._witness.events


# --- the driver at the other end ----------------------------------------------------------------

TABLE = Settings(
    name="table",
    kind=Kind.ROTARY,
    letter="X",
    steps_per_unit=80.0,
    lower=-11 * math.tau,
    upper=11 * math.tau,
    speed=math.radians(60.0),
    tolerance=math.radians(0.02),
)
WITHIN_RAD = math.radians(STEP_DEG / 2 + 0.0005)  # half a step and half a digit


@dataclass
class Laboratory:
    """A driver and a board on one wire, one thread and one clock."""

    axis: WorldAxis
    board: GrblBoard
    driver_settings: Settings

    def __post_init__(self) -> None:
        self.now_s = 50.0
        near, self._far = loopback(wait=self.pass_time)
        self._passing = False
        self.driver = GrblAxis(near, self.driver_settings, clock=lambda: self.now_s)

    def pass_time(self, seconds: float) -> None:
        if self._passing:  # the far end's own read of nothing
            return
        self._passing = True
        self.now_s += seconds
        self._far.write(self.board.receive(self._far.read(0.0), self.now_s))
        self._passing = False

    def turned_rad(self, since_rad: float = 0.0) -> float:
        return self.axis.motor(self.now_s) - since_rad

    def homed(self) -> float:
        """Home, and say where the motor then truly is."""
        assert self.driver.home(self.pass_time).homed
        return self.turned_rad()


def laboratory(*, play_deg: float = 0.0, built: GrblSettings | None = None, **known) -> Laboratory:
    axis = table(play_deg=play_deg)
    return Laboratory(axis, GrblBoard(axis, built), replace(TABLE, **known))


def test_the_driver_learns_who_answers():
    identity = laboratory().driver.identify()
    assert (identity.family, identity.model, identity.firmware) == ("grbl", "Grbl", "1.1h.20190830")


def test_the_driver_homes_where_the_switch_is():
    lab = laboratory()
    zero_rad = lab.homed()
    assert zero_rad == pytest.approx(math.radians(28.0), abs=WITHIN_RAD)
    assert lab.driver.state().position == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("homing", list(Homing))
def test_the_table_truly_turns_where_the_driver_sends_it(homing):
    lab = laboratory(homing=homing)
    zero_rad = lab.homed()
    for wanted_rad in (0.3, -1.2, math.pi, 20.0 * math.pi, 0.0):
        state = lab.driver.move_to(wanted_rad, lab.pass_time)
        assert lab.axis.stands(lab.now_s)
        assert lab.turned_rad(zero_rad) == pytest.approx(wanted_rad, abs=WITHIN_RAD)
        assert state.position == pytest.approx(wanted_rad, abs=WITHIN_RAD)
        assert (state.motion, state.homed) == (Motion.STANDING, True)


def scaled_wire(monkeypatch: pytest.MonkeyPatch, wire_per_rad: float) -> None:
    monkeypatch.setattr(Settings, "to_wire", lambda _, rad: rad * wire_per_rad)
    monkeypatch.setattr(Settings, "from_wire", lambda _, wire: wire / wire_per_rad)


def wrong_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    sent, read = drivers.grbl.axis.feed_move, drivers.grbl.axis.machine_coordinate
    monkeypatch.setattr(
        "drivers.grbl.axis.feed_move", lambda letter, position, feed: sent(letter, -position, feed)
    )
    monkeypatch.setattr("drivers.grbl.axis.machine_coordinate", lambda *asked: -read(*asked))


PLANTED = {
    "degrees taken for radians": lambda patch: scaled_wire(patch, 1.0),
    "a gear forgotten": lambda patch: scaled_wire(patch, 10.0 * 360.0 / math.tau),
    "gradians for degrees": lambda patch: scaled_wire(patch, 400.0 / math.tau),
    "the wrong sign": wrong_sign,
}


@pytest.mark.parametrize("fault", PLANTED)
def test_a_fault_planted_in_the_driver_shows_in_the_table_s_true_angle(fault, monkeypatch):
    PLANTED[fault](monkeypatch)
    lab = laboratory(tolerance=0.1, speed=0.7)
    zero_rad = lab.homed()
    state = lab.driver.move_to(0.3, lab.pass_time)
    assert state.position == pytest.approx(0.3, abs=0.02)  # the driver itself sees nothing
    assert lab.turned_rad(zero_rad) != pytest.approx(0.3, abs=0.02)


def test_the_driver_moves_at_the_speed_it_was_told():
    lab = laboratory()
    lab.homed()
    begun_s = lab.now_s
    lab.driver.move_to(math.pi, lab.pass_time)
    assert lab.axis.ends_s() - begun_s == pytest.approx(180.0 / 60.0 + 60.0 / 360.0, abs=0.05)


class Impatience(Exception):  # noqa: N818 (nothing went wrong)
    """Somebody wants to stop."""


def test_a_stop_in_mid_move_is_over_within_the_deceleration():
    lab = laboratory()
    zero_rad = lab.homed()
    stop_s = lab.now_s + 1.0

    def impatient(seconds: float) -> None:
        lab.pass_time(seconds)
        if lab.now_s >= stop_s:
            raise Impatience

    with pytest.raises(Impatience):
        lab.driver.move_to(math.pi, impatient)
    assert lab.axis.stands(lab.now_s)
    assert lab.axis.ends_s() - stop_s < 60.0 / 360.0 + 0.02
    reached_rad = lab.turned_rad(zero_rad)
    assert math.radians(45.0) < reached_rad < math.radians(61.0)
    state = lab.driver.state()
    assert state.homed
    assert state.position == pytest.approx(reached_rad, abs=WITHIN_RAD)
    lab.driver.move_to(0.1, lab.pass_time)
    assert lab.turned_rad(zero_rad) == pytest.approx(0.1, abs=WITHIN_RAD)


@pytest.mark.parametrize("late_cancel_s", [0.0, 0.5])
@pytest.mark.parametrize("when", ["as it has ended", "in the middle"])
def test_after_a_jog_was_stopped_the_table_turns_where_it_is_sent(late_cancel_s, when):
    lab = laboratory(built=GrblSettings(late_cancel_s=late_cancel_s))
    zero_rad = lab.homed()
    lab.driver.move_to(0.0, lab.pass_time)

    def impatient(seconds: float) -> None:
        lab.pass_time(seconds)
        turned_rad = lab.turned_rad(zero_rad)
        if turned_rad > 0.5 and (when == "in the middle" or lab.axis.stands(lab.now_s)):
            raise Impatience

    with pytest.raises(Impatience):
        lab.driver.jog_to(1.0, impatient)
    assert lab.axis.stands(lab.now_s)
    state = lab.driver.move_to(0.2, lab.pass_time)
    assert state.position == pytest.approx(0.2, abs=WITHIN_RAD)
    assert lab.turned_rad(zero_rad) == pytest.approx(0.2, abs=WITHIN_RAD)


def test_an_alarm_in_mid_move_is_named_and_homing_is_due_again():
    lab = laboratory()
    lab.homed()
    lab.board.receive(b"$21=1\n", lab.now_s)
    trip_s = lab.now_s + 0.5

    def tripping(seconds: float) -> None:
        lab.pass_time(seconds)
        if seconds and trip_s <= lab.now_s < trip_s + seconds:
            lab.board.press_limit(lab.now_s)
            lab.board.release_limit(lab.now_s)

    with pytest.raises(Refused, match="hard limit"):
        lab.driver.move_to(math.pi, tripping)
    assert lab.axis.stands(lab.now_s)
    with pytest.raises(Refused, match="not homed"):
        lab.driver.move_to(0.1, lab.pass_time)
    lab.homed()
    lab.driver.move_to(0.1, lab.pass_time)


def test_the_board_s_own_soft_limit_is_named():
    lab = laboratory(built=GrblSettings(travel_deg=720.0))
    lab.homed()
    lab.board.receive(b"$20=1\n", lab.now_s)
    with pytest.raises(Refused, match="soft limit"):
        lab.driver.move_to(0.5, lab.pass_time)


def test_play_is_taken_up_from_below():
    lab = laboratory(play_deg=0.4, backlash=math.radians(1.0))
    zero_rad = lab.homed()
    for wanted_rad in (1.0, 0.5, 0.7, -0.2):
        lab.driver.move_to(wanted_rad, lab.pass_time)
        true_rad = lab.axis.load(lab.now_s) - zero_rad
        assert true_rad == pytest.approx(wanted_rad, abs=WITHIN_RAD)


def test_play_that_is_not_taken_up_shows_at_the_table():
    lab = laboratory(play_deg=0.4)
    zero_rad = lab.homed()
    lab.driver.move_to(1.0, lab.pass_time)
    lab.driver.move_to(0.5, lab.pass_time)
    true_rad = lab.axis.load(lab.now_s) - zero_rad
    assert true_rad - 0.5 == pytest.approx(math.radians(0.4), abs=WITHIN_RAD)


def test_a_table_of_other_steps_is_refused():
    with pytest.raises(Refused, match="steps a deg"):
        laboratory(built=GrblSettings(steps_per_deg=88.889)).driver.identify()


def test_a_loss_of_power_is_noticed_and_homing_is_due_again():
    lab = laboratory()
    lab.homed()
    lab.board.power_cycle(lab.now_s)
    lab.pass_time(0.01)
    assert not lab.driver.state().homed
