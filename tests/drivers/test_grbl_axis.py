"""The Grbl axis against a board that was written from the manual, on a clock that tests own."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from drivers.axis import Axis, Kind, Motion
from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.grbl import GrblAxis, Homing, Settings

BANNER = "\r\nGrbl 1.1h ['$' for help]\r\n"  # report.c of gnea/grbl@bfb67f0, with its empty line
DEGREE = math.tau / 360

TABLE = Settings(
    name="table",
    kind=Kind.ROTARY,
    letter="X",
    steps_per_unit=88.889,
    lower=-20 * math.tau,
    upper=20 * math.tau,
    speed=60 * DEGREE,
    tolerance=0.02 * DEGREE,
)


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class Board:
    """Grbl 1.1h with one axis turning, its own words for everything; XYZ reported.

    Bytes go in by `hear`, come out of `said`; `run` lets time pass. Motion has constant speed and
    coasts for `brake_s` after a hold; the planner starts `start_s` after the line was answered.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.said = bytearray()
        self.lines: list[str] = []
        self.bytes_heard: list[str] = []
        self.settings = {
            10: "1", 13: "0", 22: "1", 24: "600.000", 25: "3600.000", 27: "1.000",
            100: "88.889", 101: "250.000", 102: "250.000",
            110: "7200.000", 111: "500.000", 112: "500.000",
            120: "360.000", 121: "10.000", 122: "10.000",
            130: "720.000", 131: "200.000", 132: "200.000",
        }  # fmt: skip
        self.state = "Idle"
        self.at = 0.0
        self.goal = 0.0
        self.speed = 0.0  # a second
        self.locked = False
        self.brake_s, self.start_s, self.read_s, self.home_s = 0.04, 0.002, 0.0, 3.0
        self.braked_at: float | None = None
        self.events: list[tuple[float, Callable[[], None]]] = []
        self.buffer = ""
        self.then = 0.0
        self.swallow: set[str] = set()  # lines whose answer is lost, by their beginning
        self.deaf: set[str] = set()  # lines that are lost themselves
        self.silent = False
        self.ignored_reports = 0
        self.no_banner = False
        self.unheeded = ""  # realtime bytes without effect
        self.off_by = 0.0
        self.work_reports = False

    # What happens by itself.

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        self.events.append((self.clock() + seconds, event))

    def run(self) -> None:
        for due, event in [e for e in self.events if e[0] <= self.clock()]:
            self.events.remove((due, event))
            event()
        passed, self.then = self.clock() - self.then, self.clock()
        if self.state in ("Run", "Jog", "Hold:1"):
            step = math.copysign(
                min(self.speed * passed, abs(self.goal - self.at)), self.goal - self.at
            )
            self.at += step
            if self.braked_at is not None and self.clock() >= self.braked_at:
                self.rest("Idle" if self.state == "Jog" else "Hold:0")
            elif self.at == self.goal and self.state != "Hold:1":
                self.at += self.off_by
                self.rest("Idle")

    def rest(self, state: str) -> None:
        self.state, self.braked_at = state, None
        self.at = round(self.at * 88.889) / 88.889

    def say(self, text: str) -> None:
        if not self.silent:
            self.said += text.encode()

    def alarm(self, number: int) -> None:
        self.state, self.braked_at = "Alarm", None
        self.say(f"ALARM:{number}\r\n")
        if number in (1, 2):
            self.locked = True
            self.say("[MSG:Reset to continue]\r\n")

    def restart(self) -> None:
        self.locked, self.buffer, self.events, self.braked_at = False, "", [], None
        if self.no_banner:
            return
        self.say(BANNER)
        if self.state == "Alarm":
            self.say("[MSG:'$H'|'$X' to unlock]\r\n")
        else:
            self.state = "Idle"

    # What it hears.

    def hear(self, data: bytes) -> None:
        for character in data.decode("latin-1"):
            if character in "?!~\x18\x85":
                self.bytes_heard.append(character)
                if character not in self.unheeded:
                    self.realtime(character)
            elif character == "\n":
                line, self.buffer = self.buffer, ""
                self.lines.append(line)
                if self.read_s:
                    self.later(self.read_s, lambda line=line: self.execute(line))
                else:
                    self.execute(line)
            else:
                self.buffer += character

    def realtime(self, character: str) -> None:
        if character == "\x18":
            if self.state == "Home":
                self.alarm(6)
            elif self.state in ("Run", "Jog", "Hold:1"):
                self.alarm(3)
            self.restart()
        elif self.locked or self.state == "Home":
            return
        elif character == "?":
            self.report()
        elif self.state == "Jog" and character in "!\x85":
            self.braked_at = self.braked_at or self.clock() + self.brake_s
        elif character == "!" and self.state in ("Run", "Idle"):
            self.braked_at = self.clock() + self.brake_s
            self.state = "Hold:1" if self.state == "Run" else "Hold:0"

    def report(self) -> None:
        if self.ignored_reports:
            self.ignored_reports -= 1
            return
        if self.work_reports:
            self.say(f"<{self.state}|WPos:{self.at - 5:.3f},0.000,0.000|WCO:5.000,0.000,0.000>\r\n")
        else:
            self.say(f"<{self.state}|MPos:{self.at:.3f},0.000,0.000|FS:0,0>\r\n")

    def execute(self, line: str) -> None:
        if self.locked or any(line.startswith(lost) for lost in self.deaf):
            return
        answer = self.obey(line)
        if answer and not any(line.startswith(lost) for lost in self.swallow):
            self.say(answer + "\r\n")

    def obey(self, line: str) -> str:
        if line == "$I":
            self.say("[VER:1.1h.20190825:Left table]\r\n[OPT:V,15,128]\r\n")
        elif line == "$$":
            self.say("".join(f"${n}={value}\r\n" for n, value in self.settings.items()))
        elif line == "$G":
            self.say("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\n")
        elif line == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            self.say("[MSG:Caution: Unlocked]\r\n")
        elif line == "$H":
            return self.seek()
        elif line.startswith("$J="):
            return "error:8" if self.state not in ("Idle", "Jog") else self.go(line[3:], "Jog")
        elif self.state in ("Alarm", "Jog"):
            return "error:9"
        else:
            return self.go(line, "Run")
        return "ok"

    def seek(self) -> str:
        if self.settings[22] == "0":
            return "error:5"
        self.state = "Home"
        self.later(self.home_s, self.found)
        return ""

    def found(self) -> None:
        self.at, self.state = -1.0, "Idle"
        self.say("ok\r\n")

    def go(self, block: str, state: str) -> str:
        words = re.findall(r"([A-Z])(-?[0-9]+\.?[0-9]*)", block)
        if "".join(letter + value for letter, value in words) != block:
            return "error:1"
        values = dict(words)
        if ("G", "53") not in words or ("G", "21") not in words:
            return "error:20"
        if float(values.get("F", 0)) <= 0:
            return "error:22"
        goal, speed = float(values["X"]), float(values["F"]) / 60
        self.later(self.start_s, lambda: self.start(goal, speed, state))
        return "ok"

    def start(self, goal: float, speed: float, state: str) -> None:
        if self.state in ("Idle", state):
            self.goal, self.speed, self.state = goal, speed, state
            self.then = self.clock()


@dataclass
class Cable:
    """A link without a port: reading lets the clock run."""

    board: Board
    clock: Clock
    address: str = "test://board"
    cut: bool = False

    def read(self, timeout_s: float) -> bytes:
        deadline = self.clock.now_s + timeout_s
        while True:
            if self.cut:
                raise LinkLost(f"{self.address}: cut")
            self.board.run()
            if self.board.said or self.clock.now_s >= deadline:
                data = bytes(self.board.said)
                self.board.said.clear()
                return data
            self.clock.now_s = min(self.clock.now_s + 0.001, deadline)

    def write(self, data: bytes) -> None:
        if self.cut:
            raise LinkLost(f"{self.address}: cut")
        self.board.run()
        self.board.hear(data)

    def close(self) -> None:
        self.cut = True


class StoppedError(Exception):
    """What a caller's pause raises to abandon a wait."""


@dataclass
class Bench:
    """A board, its axis, and a pause that checks the contract."""

    clock: Clock
    board: Board
    cable: Cable
    axis: GrblAxis
    abandon_at_s: float = math.inf

    def pause(self, seconds: float, /) -> None:
        assert 0 <= seconds <= 0.05
        self.clock.now_s += seconds
        if self.clock.now_s >= self.abandon_at_s:
            raise StoppedError

    def moves(self) -> list[str]:
        return [line for line in self.board.lines if "G53" in line]


def bench(settings: Settings = TABLE) -> Bench:
    clock = Clock()
    board = Board(clock)
    cable = Cable(board, clock)
    return Bench(clock, board, cable, GrblAxis(cable, settings, clock=clock))


def homed(settings: Settings = TABLE) -> Bench:
    made = bench(settings)
    made.axis.home(made.pause)
    return made


def test_the_driver_keeps_the_axis_protocol() -> None:
    axis: Axis = bench().axis
    assert axis.kind is Kind.ROTARY


def test_the_handshake_resets_asks_who_it_is_and_names_it() -> None:
    made = bench()
    made.board.said += b"\xff\x00garbage<Idle|MPos"  # of before the port was opened
    identity = made.axis.identify()
    assert (identity.family, identity.model, identity.firmware, identity.serial) == (
        "grbl", "Grbl", "1.1h.20190825", "Left table",
    )  # fmt: skip
    assert made.board.bytes_heard[0] == "\x18"
    assert made.board.lines == ["$I", "$$"]
    made.axis.identify()
    assert made.board.lines == ["$I", "$$"]


def test_a_board_that_greets_nobody_is_asked_instead() -> None:
    made = bench()
    made.board.no_banner = True
    assert made.axis.identify().model == "Grbl"


def test_a_late_banner_of_a_boot_loader_is_waited_for() -> None:
    made = bench()
    made.board.no_banner = True
    made.board.later(1.9, lambda: made.board.say(BANNER))
    assert made.axis.identify().firmware == "1.1h.20190825"


def test_a_port_without_a_grbl_says_so_in_bounded_time() -> None:
    made = bench()
    made.board.silent = True
    with pytest.raises(NoReply, match=r"table: no report in 1\.0 s at test://board"):
        made.axis.identify()
    assert made.clock.now_s < 6


def test_a_wrong_baud_rate_is_told_from_silence() -> None:
    made = bench()
    made.board.report = lambda: made.board.say("\x00~~\r\n")  # type: ignore[method-assign]
    with pytest.raises(FrameError, match="unreadable lines"):
        made.axis.state()


@pytest.mark.parametrize(("code", "value"), [(100, "88.880"), (100, "250.000"), (13, "1")])
def test_a_board_set_for_another_axis_is_refused_by_the_number_of_the_setting(
    code: int, value: str
) -> None:
    made = bench()
    made.board.settings[code] = value
    with pytest.raises(Refused, match=f"\\${code}") as refusal:
        made.axis.identify()
    assert refusal.value.code == code


def test_a_tolerance_finer_than_a_step_is_refused() -> None:
    made = bench(replace(TABLE, tolerance=0.003 * DEGREE))
    with pytest.raises(Refused, match="finer than half a step"):
        made.axis.identify()


def test_a_homed_table_turns_a_quarter_and_reads_it_back() -> None:
    made = homed()
    state = made.axis.move_to(math.tau / 4, made.pause)
    assert state.motion is Motion.STANDING
    assert state.homed
    assert state.position == pytest.approx(math.tau / 4, abs=0.01 * DEGREE)
    # Homing left the machine at -1 (its pull-off), which is our zero: 90 - 1 degrees.
    assert made.moves() == ["G21G94G53G1X89F3600"]
    assert made.board.at == pytest.approx(89, abs=0.01)


def test_ten_turns_are_twenty_pi() -> None:
    made = homed()
    assert made.axis.move_to(10 * math.tau, made.pause).position == pytest.approx(
        20 * math.pi, abs=0.01 * DEGREE
    )
    assert made.board.at == pytest.approx(3599, abs=0.01)


def test_a_stage_moves_in_millimetres() -> None:
    stage = replace(
        TABLE, name="stage", kind=Kind.LINEAR, lower=0.0, upper=100.0, speed=20.0, tolerance=0.02
    )
    made = homed(stage)
    assert made.axis.move_to(12.5, made.pause).position == pytest.approx(12.5, abs=0.01)
    assert made.moves() == ["G21G94G53G1X11.5F1200"]


def test_a_move_never_asks_for_more_than_the_boards_own_rate() -> None:
    made = bench(replace(TABLE, speed=1000 * DEGREE))
    made.axis.home(made.pause)
    made.axis.move_to(DEGREE, made.pause)
    assert made.moves() == ["G21G94G53G1X0F7200"]


def test_when_the_board_falls_silent_in_a_move_that_stays_the_cause() -> None:
    made = homed()
    made.board.later(0.3, lambda: setattr(made.board, "silent", True))
    with pytest.raises(NoReply, match="no report in") as silent:
        made.axis.move_to(2 * math.tau, made.pause)
    (note,) = silent.value.__notes__
    assert "the stop was not confirmed" in note


def test_idle_before_the_planner_starts_is_not_taken_for_arrival() -> None:
    made = homed()
    made.board.start_s = 0.08  # the first report after ok still says Idle
    state = made.axis.move_to(2 * math.tau, made.pause)
    assert state.position == pytest.approx(2 * math.tau, abs=0.01 * DEGREE)


def test_a_report_is_asked_for_at_most_twenty_times_a_second_in_a_move() -> None:
    made = homed()
    asked, begun = made.board.bytes_heard.count("?"), made.clock.now_s
    made.axis.move_to(math.tau, made.pause)
    assert made.clock.now_s - begun > 5
    assert made.board.bytes_heard.count("?") - asked <= 3 + 20 * (
        made.clock.now_s - begun
    )  # three before it moves


def test_a_homing_position_can_be_called_other_than_zero() -> None:
    made = homed(replace(TABLE, home_position=90 * DEGREE))
    assert made.axis.state().position == pytest.approx(90 * DEGREE)
    made.axis.move_to(100 * DEGREE, made.pause)
    assert made.board.at == pytest.approx(9, abs=0.01)


def test_a_table_without_a_switch_calls_where_it_stands_zero_and_moves_nothing() -> None:
    made = bench(replace(TABLE, homing=Homing.SOFTWARE_ZERO))
    made.board.at, made.board.settings[22] = 42.0, "0"
    state = made.axis.home(made.pause)
    assert (state.homed, state.position) == (True, 0.0)
    assert made.board.at == 42.0
    made.axis.move_to(10 * DEGREE, made.pause)
    assert made.board.at == pytest.approx(52, abs=0.01)


def test_homing_without_a_switch_enabled_is_refused_with_the_setting() -> None:
    made = bench()
    made.board.settings[22] = "0"
    with pytest.raises(Refused, match="homing is not enabled") as refusal:
        made.axis.home(made.pause)
    assert refusal.value.code == 5
    assert "$H" not in made.board.lines


# interface.md: the failed homing prints ALARM:9 and restarts; there is no ok.
def test_a_switch_that_is_not_found_is_refused_by_its_alarm() -> None:
    made = bench()

    def not_found() -> None:
        made.board.alarm(9)
        made.board.restart()

    made.board.found = not_found  # type: ignore[method-assign]
    with pytest.raises(Refused, match="did not find the switch") as refusal:
        made.axis.home(made.pause)
    assert refusal.value.code == 9
    state = made.axis.state()
    assert (state.motion, state.homed) == (Motion.ALARM, False)


def test_a_homing_that_never_ends_is_stopped_by_a_reset() -> None:
    made = bench()
    made.board.home_s = 1e6
    with pytest.raises(NoReply, match=r"\$H was not answered"):
        made.axis.home(made.pause)
    assert made.board.state == "Alarm"
    assert made.board.bytes_heard[-1] == "\x18"


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_position_that_is_no_number_is_the_callers_mistake(wrong: float) -> None:
    made = homed()
    with pytest.raises(ValueError, match="no position"):
        made.axis.move_to(wrong, made.pause)


def test_a_soft_limit_is_kept_before_a_byte_is_sent() -> None:
    made = homed()
    heard = (list(made.board.lines), list(made.board.bytes_heard))
    with pytest.raises(Refused, match=r"7201.000 deg is outside its limits -7200.000 to 7200.000"):
        made.axis.move_to(7201 * DEGREE, made.pause)
    assert (made.board.lines, made.board.bytes_heard) == heard


def test_an_axis_that_is_not_homed_does_not_move() -> None:
    made = bench()
    with pytest.raises(Refused, match="not homed"):
        made.axis.move_to(0.0, made.pause)
    assert made.moves() == []


def test_an_axis_that_is_not_homed_jogs_one_degree_and_no_more() -> None:
    made = bench()
    with pytest.raises(Refused, match="not homed"):
        made.axis.jog_to(1.1 * DEGREE, made.pause)
    assert made.moves() == []
    state = made.axis.jog_to(0.9 * DEGREE, made.pause)
    assert made.moves() == ["$J=G21G53X0.9F3600"]
    assert (state.homed, made.board.at) == (False, pytest.approx(0.9, abs=0.01))


@pytest.mark.parametrize("call", ["move_to", "jog_to"])
def test_an_abandoned_motion_is_stopped_gently_and_the_axis_stays_homed(call: str) -> None:
    made = homed()
    made.abandon_at_s = made.clock.now_s + 1.0
    with pytest.raises(StoppedError):
        getattr(made.axis, call)(math.tau, made.pause)
    assert made.board.state == "Idle"
    assert 30 < made.board.at < 70
    expected = "!" if call == "move_to" else "\x85"
    assert expected in made.board.bytes_heard
    assert ("\x18" in made.board.bytes_heard[1:]) == (call == "move_to")
    state = made.axis.state()
    assert (state.motion, state.homed) == (Motion.STANDING, True)
    made.abandon_at_s = math.inf
    assert made.axis.move_to(0.0, made.pause).position == pytest.approx(0, abs=0.01 * DEGREE)


def test_a_stop_is_on_the_wire_at_once() -> None:
    made = homed()
    made.abandon_at_s = made.clock.now_s + 1.0
    with pytest.raises(StoppedError):
        made.axis.jog_to(math.tau, made.pause)
    assert made.board.at - (made.abandon_at_s - 3.1) * 60 < 60 * 0.3
    assert made.clock.now_s - made.abandon_at_s < 0.25


def test_a_stop_does_not_wait_for_a_line_that_the_board_has_not_read() -> None:
    made = homed()
    made.board.read_s = 0.2
    made.abandon_at_s = made.clock.now_s + 0.25  # just after the jog was written
    with pytest.raises(StoppedError):
        made.axis.jog_to(math.tau, made.pause)
    made.board.read_s = 0.0
    made.clock.now_s += 5
    made.board.run()
    assert made.board.state in ("Idle", "Alarm")
    assert made.board.at < 20
    assert made.clock.now_s < 12
    made.abandon_at_s = math.inf
    made.axis.home(made.pause)
    assert made.axis.move_to(DEGREE, made.pause).position == pytest.approx(DEGREE, abs=1e-3)


# Seen with Grbl 1.1h built for Linux: a second 0x85 that arrives just after the jog's end is taken
# in Idle, suspends the controller (protocol.c, EXEC_MOTION_CANCEL) and no line is read any more.
def test_a_jog_is_cancelled_once() -> None:
    made = homed()
    made.board.brake_s = 0.3
    made.abandon_at_s = made.clock.now_s + 1.0
    with pytest.raises(StoppedError):
        made.axis.jog_to(math.tau, made.pause)
    assert made.board.bytes_heard.count("\x85") == 1


def test_a_controller_left_idle_and_deaf_by_a_jog_cancel_is_reset_and_stays_homed() -> None:
    made = homed()
    made.abandon_at_s = made.clock.now_s + 1.0
    with pytest.raises(StoppedError):
        made.axis.jog_to(math.tau, made.pause)
    made.abandon_at_s = math.inf
    made.board.deaf = {""}  # every line
    revive = made.board.restart

    def restart() -> None:
        made.board.deaf = set()
        revive()

    made.board.restart = restart  # type: ignore[method-assign]
    assert made.axis.move_to(0.0, made.pause).homed
    assert len(made.moves()) == 2


def test_a_stop_that_finds_nothing_moving_still_sends_its_byte_and_loses_nothing() -> None:
    made = homed()
    before = len(made.board.bytes_heard)
    made.axis.stop()
    assert made.board.bytes_heard[before] == "\x85"
    assert "\x18" not in made.board.bytes_heard[before:]
    assert made.axis.state().homed


def test_a_line_that_was_never_answered_is_dropped_by_a_reset_from_standstill() -> None:
    made = homed()
    made.board.deaf = {"$J"}
    made.abandon_at_s = made.clock.now_s + 0.5
    with pytest.raises(StoppedError):
        made.axis.jog_to(math.tau, made.pause)
    assert "\x18" in made.board.bytes_heard[1:]
    assert made.axis.state().homed


def test_a_stop_after_a_cancelled_jog_keeps_the_axis_homed() -> None:
    made = homed()
    made.abandon_at_s = made.clock.now_s + 1.0
    with pytest.raises(StoppedError):
        made.axis.jog_to(math.tau, made.pause)
    made.axis.stop()
    made.axis.stop()
    assert made.axis.state().homed


def test_a_stop_before_anything_was_asked_is_allowed() -> None:
    made = bench()
    made.axis.stop()
    assert made.board.bytes_heard[0] == "\x85"


def test_a_hold_that_is_not_heeded_ends_in_a_reset_and_the_position_is_lost() -> None:
    made = homed()
    made.board.unheeded = "!"
    made.abandon_at_s = made.clock.now_s + 1.0
    with pytest.raises(StoppedError):
        made.axis.move_to(math.tau, made.pause)
    assert made.board.state == "Alarm"
    state = made.axis.state()
    assert (state.motion, state.homed) == (Motion.ALARM, False)
    assert state.alarm == "ALARM:3 (reset while in motion)"
    with pytest.raises(Refused, match="not homed"):
        made.axis.move_to(0.0, made.pause)


def test_a_stop_that_nobody_confirms_names_the_emergency_stop() -> None:
    made = homed()
    made.board.silent = True
    with pytest.raises(NoReply, match="press the emergency stop"):
        made.axis.stop()
    assert made.board.bytes_heard[-1] == "\x18"
    made.board.silent = False
    assert not made.axis.state().homed


def test_a_lost_ok_is_answered_by_the_position_and_the_move_is_sent_once() -> None:
    made = homed()
    made.board.swallow = {"G21"}
    state = made.axis.move_to(math.tau / 4, made.pause)
    assert state.position == pytest.approx(math.tau / 4, abs=0.01 * DEGREE)
    assert len(made.moves()) == 1
    made.board.swallow = set()
    made.axis.move_to(0.0, made.pause)
    assert made.board.lines[-2] == "$G"  # the fence stands before the next line


def test_a_lost_move_is_not_repeated_and_says_where_the_axis_stands() -> None:
    made = homed()
    made.board.deaf = {"G21"}
    with pytest.raises(NoReply, match=r"not repeated; the axis stands at 0.000 deg, not at 90.000"):
        made.axis.move_to(math.tau / 4, made.pause)
    assert len(made.moves()) == 1
    assert made.board.bytes_heard[-2] == "\x18"  # whatever still lay in its buffers is gone
    assert made.axis.state().homed  # it has not moved, and was asked


def test_a_late_ok_is_not_taken_for_the_next_lines_answer() -> None:
    made = homed()
    made.board.swallow = {"G21"}
    made.axis.move_to(math.tau / 4, made.pause)
    made.board.swallow = set()
    made.board.say("ok\r\n")  # at last
    assert made.axis.move_to(0.0, made.pause).position == pytest.approx(0, abs=0.01 * DEGREE)
    assert made.board.at == pytest.approx(-1, abs=0.01)


def test_a_report_that_is_ignored_is_asked_for_again() -> None:
    made = homed()
    made.board.ignored_reports = 1
    assert made.axis.state().motion is Motion.STANDING
    made.board.ignored_reports = 2
    with pytest.raises(NoReply, match="no report"):
        made.axis.state()


# interface.md: after ALARM:1 and 2 "Reset is required before Grbl accepts any other commands".
def test_a_hard_limit_in_a_move_is_refused_by_name_and_homing_gets_out_of_it() -> None:
    made = homed()
    made.board.later(1.0, lambda: made.board.alarm(1))
    with pytest.raises(Refused, match=r"ALARM:1 \(hard limit\).*free the axis") as refusal:
        made.axis.move_to(math.tau, made.pause)
    assert refusal.value.code == 1
    state = made.axis.state()
    assert (state.motion, state.homed, state.alarm) == (
        Motion.ALARM, False, "ALARM:1 (hard limit)",
    )  # fmt: skip
    assert math.isnan(state.position)
    assert made.axis.home(made.pause).homed


def test_an_alarm_is_cleared_by_the_software_zero_only_when_home_is_called() -> None:
    made = homed(replace(TABLE, homing=Homing.SOFTWARE_ZERO))
    made.board.later(1.0, lambda: made.board.alarm(3))
    with pytest.raises(Refused, match="ALARM:3"):
        made.axis.move_to(math.tau, made.pause)
    with pytest.raises(Refused, match="not homed"):
        made.axis.move_to(0.0, made.pause)
    assert "$X" not in made.board.lines
    assert made.axis.home(made.pause).homed
    assert "$X" in made.board.lines


def test_a_board_that_restarts_by_itself_is_no_longer_homed() -> None:
    made = homed()
    made.board.restart()
    assert not made.axis.state().homed
    with pytest.raises(Refused, match="not homed"):
        made.axis.move_to(0.0, made.pause)


def test_a_restart_in_a_move_is_refused_and_says_so() -> None:
    made = homed()
    made.board.later(1.0, made.board.restart)
    with pytest.raises(Refused, match="restarted during the move"):
        made.axis.move_to(math.tau, made.pause)


def test_a_line_refused_by_the_board_is_named_and_leaves_the_axis_homed() -> None:
    made = homed()
    made.board.go = lambda _block, _state: "error:15"  # type: ignore[method-assign]
    with pytest.raises(Refused, match="jog target exceeds travel") as refusal:
        made.axis.jog_to(math.tau, made.pause)
    assert refusal.value.code == 15
    assert made.axis.state().homed


def test_a_move_that_ends_elsewhere_is_refused_and_the_position_distrusted() -> None:
    made = homed()
    made.board.off_by = 0.05
    with pytest.raises(Refused, match=r"from 90.000, tolerated 0.020"):
        made.axis.move_to(math.tau / 4, made.pause)
    assert not made.axis.state().homed


def test_a_move_that_never_ends_is_stopped_within_its_own_time() -> None:
    made = homed()
    made.board.goal = 0.0
    start = made.board.start
    made.board.start = lambda goal, _speed, state: start(goal, 0.0, state)  # type: ignore[method-assign]
    begun = made.clock.now_s
    with pytest.raises(NoReply, match=r"still moving after 14\.[34] s"):
        made.axis.move_to(math.tau, made.pause)  # 6 s + 1/6 s of braking, twice, 2 s
    assert made.clock.now_s - begun < 16
    assert made.board.state == "Idle"


def test_a_hold_by_the_boards_own_button_is_told_and_the_queue_dropped() -> None:
    made = homed()
    made.board.later(1.0, lambda: made.board.realtime("!"))
    with pytest.raises(Refused, match="Hold during a move"):
        made.axis.move_to(math.tau, made.pause)
    assert made.board.state == "Idle"
    assert made.axis.state().homed


def test_play_is_always_taken_up_from_below() -> None:
    made = homed(replace(TABLE, backlash=2 * DEGREE))
    for degrees in (30, 40, 10, 20):
        made.axis.move_to(degrees * DEGREE, made.pause)
    legs = [float(re.findall(r"X(-?[0-9.]+)", line)[0]) + 1 for line in made.moves()]
    assert legs == [28, 30, 40, 8, 10, 20]  # the first goes up, but after homing nothing is sure


def test_play_is_taken_up_anew_after_a_stop() -> None:
    made = homed(replace(TABLE, backlash=2 * DEGREE))
    made.axis.move_to(30 * DEGREE, made.pause)
    made.axis.stop()
    made.axis.move_to(40 * DEGREE, made.pause)
    assert len(made.moves()) == 4


def test_the_way_of_taking_up_play_keeps_the_soft_limits() -> None:
    made = homed(replace(TABLE, backlash=2 * DEGREE, lower=0.0))
    with pytest.raises(Refused, match=r"-2\.000 deg is outside"):
        made.axis.move_to(0.0, made.pause)
    assert made.moves() == []


def test_work_positions_are_turned_into_machine_positions_by_their_offset() -> None:
    made = bench()
    made.board.work_reports, made.board.at = True, 7.0
    assert made.axis.state().position == pytest.approx(7 * DEGREE)


def test_a_cut_cable_is_link_lost_and_homed_is_forgotten() -> None:
    made = homed()
    made.cable.cut = True
    with pytest.raises(LinkLost):
        made.axis.move_to(1.0, made.pause)
    made.cable.cut = False
    assert not made.axis.state().homed


def test_a_cable_cut_in_a_motion_is_link_lost_and_homed_is_forgotten() -> None:
    made = homed()

    def cut(seconds: float, /) -> None:
        made.pause(seconds)
        made.cable.cut = made.board.state == "Run"

    with pytest.raises(LinkLost):
        made.axis.move_to(math.tau, cut)
    made.cable.cut = False
    made.axis.stop()
    assert not made.axis.state().homed


def test_a_link_lost_while_reading_forgets_homed_as_well() -> None:
    made = homed()
    read = made.cable.read

    def broken(timeout_s: float) -> bytes:
        raise LinkLost(f"no port after {timeout_s} s")

    made.cable.read = broken  # type: ignore[method-assign]
    with pytest.raises(LinkLost):
        made.axis.state()
    made.cable.read = read  # type: ignore[method-assign]
    assert not made.axis.state().homed


def test_a_second_banner_just_after_the_first_does_not_disturb_the_handshake() -> None:
    made = bench()
    say = made.board.restart

    def twice() -> None:
        say()
        made.board.later(0.05, say)

    made.board.restart = twice  # type: ignore[method-assign]
    made.board.read_s = 0.06
    assert made.axis.identify().model == "Grbl"


def test_an_axis_that_the_board_does_not_have_is_a_frame_error() -> None:
    made = bench(replace(TABLE, letter="A"))
    with pytest.raises(FrameError, match=r"\$103|no A"):
        made.axis.identify()


def test_an_axis_in_motion_of_somebody_elses_is_not_moved() -> None:
    made = homed()
    made.board.start(300.0, 1.0, "Run")
    with pytest.raises(Refused, match="state Run; stop it first"):
        made.axis.move_to(0.0, made.pause)
    assert made.axis.state().motion is Motion.MOVING
    made.axis.stop()
    assert made.axis.state().motion is Motion.STANDING


def test_a_caller_who_leaves_an_exchange_can_come_back() -> None:
    made = bench()
    made.board.read_s = 0.02
    made.abandon_at_s = 0.13  # in the middle of $I
    with pytest.raises(StoppedError):
        made.axis.home(made.pause)
    made.abandon_at_s = math.inf
    assert made.axis.home(made.pause).homed


@pytest.mark.parametrize(
    "wrong",
    [
        {"letter": "Q"}, {"letter": "XY"}, {"steps_per_unit": 0.0}, {"speed": math.nan},
        {"tolerance": -1.0}, {"lower": 1.0, "upper": 1.0}, {"backlash": -1.0}, {"poll_s": 0.01},
        {"home_position": math.inf},
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_the_callers_mistake(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="table"):
        replace(TABLE, **wrong)  # type: ignore[arg-type]
