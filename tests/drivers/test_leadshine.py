"""The Leadshine stage against a drive modelled, register by register, from the manual's text.

The model is written a second time on purpose: it knows addresses, words and counts, nothing of
`drivers.leadshine.registers` and nothing of millimetres.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.register_message import WriteMultipleRegistersRequest

from drivers.axis import Axis, AxisState, Identity, Kind, Motion
from drivers.bus import Bus
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.leadshine import (
    Homing,
    HomingMethod,
    HomingSense,
    LeadshineStage,
    Model,
    StageSettings,
)
from drivers.leadshine.registers import (
    HomeSearch,
    Path,
    PathMode,
    Status,
    Watch,
    alarm_name,
    alarm_remedy,
    homing_block,
    path_block,
)
from drivers.long_words import value_of, words_of
from sim.leadshine import LeadshineDrive
from sim.modbus import RtuServer
from sim.motion import Limits
from tests.sim.judges import StageRig, world_axis

STATION = 7
PULSES = 10_000
LEAD_MM = 5.0

# CS2RS manual page 50, "immediate trigger", and the drive's answer (its caption says 200 rpm, its
# speed word says 0: an example of framing only).
GOLDEN_MOVE = bytes.fromhex("07106200000810000100002710000027102710000000108D50")
GOLDEN_ANSWER = bytes.fromhex("071062000008DE11")

SETTINGS = StageSettings(
    model=Model.CS2RS,
    pulses_per_rev=PULSES,
    lead_mm=LEAD_MM,
    low_mm=0.0,
    high_mm=100.0,
    speed_mm_s=20.0,
    tolerance_mm=0.01,
    homing=Homing(HomingMethod.HOME_SWITCH, HomingSense.NEGATIVE, fast_mm_s=10.0, slow_mm_s=1.0),
)


@dataclass
class Drive:
    """The manual's drive on a bus of its own; `now_s` is the only time there is."""

    now_s: float = 0.0
    transaction_s: float = 0.004
    latency_s: float = 0.06  # from the frame to "running": until then the old bits stand
    position: float = 3_000.0  # counts, by its own zero
    words: dict[int, int] = field(default_factory=dict)
    fault: int = 0
    enabled: bool = True
    homed: bool = False
    complete: bool = True
    switch: float | None = 1_000.0  # where the home switch is, by its zero of power-up
    stuck_at: float | None = None
    slipped: int = 0  # counts by which it ends short
    breaks: list[tuple[str, DriverError, bool]] = field(default_factory=list)
    log: list[tuple[str, int, tuple[int, ...]]] = field(default_factory=list)
    losses: int = 0  # of the link
    trips: dict[float, int] = field(default_factory=dict)  # when which alarm comes
    _begun_s: float | None = None
    _begun_at: float = 0.0
    _goal: float = 0.0
    _counts_s: float = 0.0
    _homing: bool = False

    @property
    def address(self) -> str:
        return "serial:///dev/ttyTEST"

    def pause(self, seconds: float, /) -> None:
        assert 0.0 < seconds <= 0.05
        self.now_s += seconds

    def clock(self) -> float:
        return self.now_s

    # --- the wire

    def read_holding(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        self._transact("read", device_id, first, ())
        known = {0x0001: PULSES, 0x0003: 2, 0x1003: self._status(), 0x2203: self.fault}
        known.update(zip((0x602C, 0x602D), self._position_words(), strict=True))
        known.update(self.words)
        if any(at not in known for at in range(first, first + count)):
            raise Refused("no such register", code=2)
        return tuple(known[at] for at in range(first, first + count))

    def write_register(self, device_id: int, register: int, value: int) -> None:
        lost = self._transact("write", device_id, register, (value,))
        if lost is None or not lost[1]:
            self._written(register, value)
        if lost is not None:
            raise lost[0]

    def write_registers(self, device_id: int, first: int, values: Sequence[int]) -> None:
        lost = self._transact("write", device_id, first, tuple(values))
        if lost is None or not lost[1]:
            for at, value in enumerate(values, first):
                assert 0 <= value <= 0xFFFF
                self._written(at, value)
        if lost is not None:
            raise lost[0]

    def read_input(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        raise Refused("function 4 is not supported", code=1)

    def read_coils(self, device_id: int, first: int, count: int) -> tuple[bool, ...]:
        raise Refused("function 1 is not supported", code=1)

    def write_coil(self, device_id: int, coil: int, value: bool) -> None:  # noqa: FBT001
        raise Refused("function 5 is not supported", code=1)

    def _transact(
        self, what: str, device_id: int, first: int, values: tuple[int, ...]
    ) -> tuple[DriverError, bool] | None:
        assert device_id == STATION
        self.now_s += self.transaction_s
        self._live()
        self.log.append((what, first, values))
        if not self.breaks or self.breaks[0][0] not in (what, f"{what} 0x{first:04X}"):
            return None
        _, error, before = self.breaks.pop(0)
        if what == "read":
            raise error
        return error, before

    # --- the motor

    def _written(self, register: int, value: int) -> None:
        if register == 0x1801 and value == 0x1111:
            self.fault = 0
            return
        if register == 0x6207:
            register = 0x6002  # "Pr9.07 is mapped to Pr8.02"
        if register != 0x6002:
            self.words[register] = value
        elif value == 0x10:
            self._go()
        elif value == 0x20:
            self._look_for_home()
        elif value == 0x40:
            self._live()
            self._begun_s = None

    def _signed(self, first: int) -> int:
        (value,) = struct.unpack(">i", struct.pack(">HH", self.words[first], self.words[first + 1]))
        return int(value)

    def _go(self) -> None:
        assert self.words[0x6200] == 1, "only absolute moves are modelled"
        if self.fault or not self.enabled:
            return
        self._begin(self._signed(0x6201), rpm=self.words[0x6203])

    def _look_for_home(self) -> None:
        if self.fault or not self.enabled:
            return
        sense = 1 if self.words[0x600A] & 1 else -1
        goal = self.switch if self.switch is not None else self.position + sense * 1e9
        self._homing = True
        self._begin(goal, rpm=self.words[0x600F])

    def _begin(self, goal: float, *, rpm: int) -> None:
        self._begun_s = self.now_s + self.latency_s
        self._begun_at = self.position
        self._goal = goal
        self._counts_s = rpm * PULSES / 60.0

    def _live(self) -> None:
        for at_s in list(self.trips):
            if self.now_s >= at_s:
                self.fault = self.trips.pop(at_s)
                self._begun_s = None
        if self._begun_s is None or self.now_s < self._begun_s:
            return
        self.complete = False
        self.homed = self.homed and not self._homing
        gone = self._counts_s * (self.now_s - self._begun_s)
        left = abs(self._goal - self._begun_at) - gone
        way = math.copysign(1.0, self._goal - self._begun_at)
        self.position = self._begun_at + way * gone
        if self.stuck_at is not None and way * (self.position - self.stuck_at) > 0.0:
            self.position = self.stuck_at
        elif left <= 0.0:
            self._end(way)

    def _end(self, way: float) -> None:
        self._begun_s = None
        self.position = self._goal - way * self.slipped
        if self._homing:
            self._homing = False
            self.homed = True
            self.position = float(self._signed(0x600B))
        else:
            self.complete = True

    def _status(self) -> int:
        running = self._begun_s is not None and self.now_s >= self._begun_s
        low = [bool(self.fault), self.enabled, running, False]
        bits = [*low, not running, self.complete, self.homed]
        return sum(bit << at for at, bit in enumerate(bits))

    def _position_words(self) -> tuple[int, int]:
        high, low = struct.unpack(">HH", struct.pack(">i", round(self.position)))
        return int(high), int(low)

    def writes(self, first: int) -> list[tuple[int, ...]]:
        return [values for what, at, values in self.log if (what, at) == ("write", first)]

    @property
    def standing(self) -> bool:
        return self._begun_s is None


def stage_on(drive: Drive, **changes: Any) -> LeadshineStage:
    return LeadshineStage(drive, STATION, replace(SETTINGS, **changes), clock=drive.clock)


def homed_stage(drive: Drive, **changes: Any) -> LeadshineStage:
    stage = stage_on(drive, **changes)
    stage.home(drive.pause)
    drive.log.clear()
    return stage


@pytest.fixture
def drive() -> Drive:
    return Drive()


# --- the registers


def test_the_move_of_the_manual_is_framed_byte_for_byte() -> None:
    path = Path(PathMode.ABSOLUTE, 10_000, 0, 10_000, 10_000)
    request = WriteMultipleRegistersRequest(
        address=0x6200, registers=list(path_block(path)), dev_id=STATION
    )
    assert FramerRTU(DecodePDU(is_server=False)).buildFrame(request) == GOLDEN_MOVE


def test_the_answer_of_the_manual_acknowledges_eight_words_at_path_0() -> None:
    _, device_id, _, data = FramerRTU(DecodePDU(is_server=False)).decode(GOLDEN_ANSWER)
    answer = DecodePDU(is_server=False).decode(data)
    assert answer is not None
    assert (device_id, answer.address, answer.count) == (STATION, 0x6200, 8)


@given(st.integers(-(2**31), 2**31 - 1))
def test_a_signed_number_goes_high_word_first_and_comes_back(value: int) -> None:
    words = words_of(value)
    assert struct.pack(">HH", *words) == struct.pack(">i", value)
    assert value_of(*words) == value


@pytest.mark.parametrize("value", [-(2**31) - 1, 2**31])
def test_a_number_wider_than_32_bits_is_a_mistake(value: int) -> None:
    with pytest.raises(ValueError, match="32 bits"):
        words_of(value)


@given(
    st.sampled_from(PathMode),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(0, 0x7FFF),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFFFF),
)
def test_a_path_is_eight_words_in_the_manuals_order(
    mode: PathMode, position: int, rpm: int, up_ms: int, down_ms: int
) -> None:
    block = struct.pack(">8H", *path_block(Path(mode, position, rpm, up_ms, down_ms)))
    assert struct.unpack(">HiHHHHH", block) == (mode, position, rpm, up_ms, down_ms, 0, 0x10)


@pytest.mark.parametrize(
    "path",
    [
        Path(PathMode.ABSOLUTE, 0, -1, 0, 0),
        Path(PathMode.ABSOLUTE, 0, 0x8000, 0, 0),
        Path(PathMode.ABSOLUTE, 0, 0, 0x10000, 0),
        Path(PathMode.ABSOLUTE, 0, 0, 0, 0x10000),
    ],
)
def test_a_word_that_does_not_fit_is_a_mistake(path: Path) -> None:
    with pytest.raises(ValueError, match="is outside 0 to"):
        path_block(path)


def test_the_same_alarm_has_another_code_in_another_family() -> None:
    assert alarm_name(Model.EM, 0x01) == "0x001 over-current"
    assert alarm_name(Model.CS2RS, 0x0E0) == "0x0E0 over-current"
    assert "not in the table of EM2RS" in alarm_name(Model.EM, 0x0E0)


def test_a_drive_that_ran_is_over_at_once_when_it_says_so() -> None:
    watch = Watch(Status.PATH_COMPLETE, settle_s=0.2, stood_since_s=0.0)
    assert not watch.over(Status.RUNNING | Status.PATH_COMPLETE, 0.01)
    assert watch.over(Status.PATH_COMPLETE, 0.02)


def test_a_drive_that_only_pauses_between_two_phases_is_not_over() -> None:
    watch = Watch(Status.PATH_COMPLETE, settle_s=0.2, stood_since_s=0.0)
    assert not watch.over(Status.RUNNING, 5.0)
    assert not watch.over(Status.ENABLED, 5.19)
    assert not watch.over(Status.RUNNING, 6.0)
    assert not watch.over(Status.ENABLED, 6.1)
    assert watch.over(Status.ENABLED, 6.2)


# --- the scale


def test_counts_and_rpm_follow_from_the_screw() -> None:
    assert SETTINGS.steps_per_mm == 2_000.0
    assert SETTINGS.counts(12.5) == 25_000
    assert SETTINGS.counts(-0.25) == -500
    assert SETTINGS.rpm(20.0) == 240


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"lead_mm": 0.0}, "lead"),
        ({"lead_mm": math.nan}, "lead"),
        ({"pulses_per_rev": 100}, "pulses"),
        ({"low_mm": 5.0, "high_mm": 5.0}, "soft limits"),
        ({"high_mm": math.inf}, "soft limits"),
        ({"high_mm": 2e6}, "32 bits"),
        ({"tolerance_mm": math.nan}, "tolerance_mm"),
        ({"tolerance_mm": 0.0}, "tolerance_mm"),
        ({"speed_mm_s": 0.01}, "less than 1"),
        ({"speed_mm_s": math.nan}, "less than 1"),
        ({"speed_mm_s": 5_000.0}, "speed_rpm"),
        ({"homing": replace(SETTINGS.homing, slow_mm_s=0.0)}, "less than 1"),
    ],
)
def test_settings_that_no_drive_could_keep_are_a_mistake(
    change: dict[str, Any], match: str
) -> None:
    with pytest.raises(ValueError, match=match):
        replace(SETTINGS, **change)


# --- homing


def test_homing_writes_how_to_look_in_one_frame_and_then_starts(drive: Drive) -> None:
    state = stage_on(drive, homing=replace(SETTINGS.homing, reference_mm=-2.0)).home(drive.pause)
    # -4000 counts as the switch's position; 120 and 12 rpm; 200 ms for 1000 rpm both ways
    expected = (0x04, 0xFFFF, 0xF060, 0xFFFF, 0xF060, 120, 12, 200, 200)
    assert drive.writes(0x600A) == [expected]
    assert drive.writes(0x6002) == [(0x20,)]
    assert state == AxisState(Motion.STANDING, -2.0, homed=True)


def test_homing_the_other_way_sets_bit_0(drive: Drive) -> None:
    looking = replace(SETTINGS.homing, sense=HomingSense.POSITIVE, method=HomingMethod.LIMIT_SWITCH)
    stage_on(drive, homing=looking).home(drive.pause)
    assert drive.writes(0x600A)[0][0] == 0x01


def test_homing_is_not_over_while_the_bit_is_of_the_last_time(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.position = 40_000.0
    drive.latency_s = 0.15
    assert stage.home(drive.pause).position == 0.0
    assert drive.standing


def test_a_homing_that_never_starts_is_refused_though_the_old_bit_stands(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.breaks.append(("write 0x6002", NoReply("stage: no answer"), True))
    with pytest.raises(Refused, match="found no reference"):
        stage.home(drive.pause)
    assert not stage.state().homed
    assert drive.writes(0x6002) == [(0x20,), (0x40,)]


def test_a_first_homing_that_is_over_before_the_first_look_is_no_failure(drive: Drive) -> None:
    late_s = 10.0  # the way to the switch takes less than 2 s

    def held_up(seconds: float, /) -> None:
        drive.now_s += seconds

    drive.transaction_s = late_s
    assert stage_on(drive).home(held_up).homed


def test_a_switch_that_is_not_there_ends_by_the_deadline_with_a_stop(drive: Drive) -> None:
    drive.switch = None
    with pytest.raises(Refused, match=r"homing was not over after .*told to stop"):
        stage_on(drive).home(drive.pause)
    assert drive.standing
    assert drive.now_s < 2.0 * 100.0 / 10.0 + 10.0 / 1.0 + 5.0


def test_the_reference_may_be_a_whole_travel_away(drive: Drive) -> None:
    drive.position = 190_000.0
    looking = replace(SETTINGS.homing, creep_mm=0.1)
    assert stage_on(drive, homing=looking).home(drive.pause).homed


def test_while_it_looks_the_state_says_homing(drive: Drive) -> None:
    stage = stage_on(drive)
    seen: list[Motion] = []

    def pause(seconds: float, /) -> None:
        drive.pause(seconds)
        seen.append(stage.state().motion)

    stage.home(pause)
    assert set(seen) == {Motion.STANDING, Motion.HOMING}
    seen.clear()
    stage.move_to(20.0, pause)
    assert set(seen) == {Motion.STANDING, Motion.MOVING}


def test_another_scale_in_the_drive_is_refused_before_anything_moves(drive: Drive) -> None:
    with pytest.raises(Refused, match="10000 pulses per revolution, the station says 4000"):
        stage_on(drive, pulses_per_rev=4_000).home(drive.pause)
    assert all(what == "read" for what, _, _ in drive.log)


# --- moving


def test_a_move_is_one_frame_and_ends_where_the_drive_says(drive: Drive) -> None:
    state = homed_stage(drive).move_to(50.0, drive.pause)
    assert state == AxisState(Motion.STANDING, 50.0, homed=True)
    # 50 mm on 2000 counts a mm is 0x000186A0
    assert drive.writes(0x6200) == [(1, 0x0001, 0x86A0, 240, 200, 200, 0, 0x10)]
    assert [first for what, first, _ in drive.log if what == "write"] == [0x6200]
    assert drive.position == 100_000.0


def test_a_negative_position_keeps_its_sign_both_ways(drive: Drive) -> None:
    stage = homed_stage(drive, low_mm=-50.0)
    assert stage.move_to(-30.0, drive.pause).position == -30.0
    assert drive.position == -60_000.0


@pytest.mark.parametrize("position", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_a_mistake_and_sends_nothing(drive: Drive, position: float) -> None:
    stage = homed_stage(drive)
    with pytest.raises(ValueError, match="no position"):
        stage.move_to(position, drive.pause)
    assert drive.log == []


@pytest.mark.parametrize("position", [-0.001, 100.001, 1e308])
def test_beyond_a_soft_limit_nothing_is_sent(drive: Drive, position: float) -> None:
    stage = homed_stage(drive)
    with pytest.raises(Refused, match=r"outside its soft limits 0\.000 to 100\.000 mm"):
        stage.move_to(position, drive.pause)
    assert drive.log == []


def test_without_homing_nothing_is_sent_though_the_drive_believes_it_is_homed(drive: Drive) -> None:
    drive.homed = True
    with pytest.raises(Refused, match="not homed"):
        stage_on(drive).move_to(10.0, drive.pause)
    assert drive.log == []


@settings(max_examples=60, deadline=None)
@given(
    targets=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=4),
    latency_s=st.floats(0.0, 0.18),
    transaction_s=st.floats(0.0, 0.02),
    pause_s=st.floats(0.001, 0.05),
)
def test_whatever_the_delays_a_move_returns_only_standing_at_its_target(
    targets: list[float], latency_s: float, transaction_s: float, pause_s: float
) -> None:
    drive = Drive(latency_s=latency_s, transaction_s=transaction_s)
    stage = homed_stage(drive)

    def pause(seconds: float, /) -> None:
        drive.pause(pause_s)

    for target in targets:
        state = stage.move_to(target, pause)
        assert drive.standing
        assert abs(drive.position / 2_000.0 - target) <= 0.00026
        assert state.position == drive.position / 2_000.0


def test_a_move_too_short_to_be_seen_is_over_after_the_settling_time(drive: Drive) -> None:
    stage = homed_stage(drive)
    stage.move_to(50.0, drive.pause)
    drive.latency_s = 0.0
    before_s = drive.now_s
    assert stage.move_to(50.0005, drive.pause).position == 50.0005
    assert SETTINGS.settle_s <= drive.now_s - before_s < SETTINGS.settle_s + 0.1


def test_the_bit_of_the_move_before_does_not_end_this_one(drive: Drive) -> None:
    stage = homed_stage(drive)
    stage.move_to(10.0, drive.pause)
    drive.latency_s = 0.15
    assert stage.move_to(90.0, drive.pause).position == 90.0


def test_where_it_stops_short_both_positions_are_named(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.slipped = 100
    with pytest.raises(Refused, match=r"asked for 50\.000 mm, stands at 49\.950 mm"):
        stage.move_to(50.0, drive.pause)


def test_what_is_off_by_less_than_the_tolerance_is_returned_as_read(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.slipped = 10
    assert stage.move_to(50.0, drive.pause).position == 49.995


def test_a_blocked_stage_is_stopped_by_the_deadline_and_both_positions_are_named(
    drive: Drive,
) -> None:
    stage = homed_stage(drive)
    drive.stuck_at = 60_000.0
    before_s = drive.now_s
    with pytest.raises(Refused, match=r"move to 50\.000 mm was not over .* at 30\.000 mm"):
        stage.move_to(50.0, drive.pause)
    # 50 mm at 20 mm/s, ramps, settling and slack
    assert 2.5 < drive.now_s - before_s < 6.0
    assert drive.standing
    assert drive.writes(0x6002) == [(0x40,)]


def test_a_stop_from_elsewhere_ends_the_wait_with_both_positions(drive: Drive) -> None:
    stage = homed_stage(drive)
    stop_s = drive.now_s + 1.0

    def pause(seconds: float, /) -> None:
        drive.pause(seconds)
        if drive.now_s > stop_s:
            drive.write_register(STATION, 0x6002, 0x40)

    with pytest.raises(Refused, match=r"asked for 90\.000 mm, stands at \d+"):
        stage.move_to(90.0, pause)
    assert drive.now_s < stop_s + 0.5


class Abandoned(BaseException):
    """What a caller may raise from its pause."""


def test_a_caller_who_leaves_the_wait_leaves_a_stopped_stage(drive: Drive) -> None:
    stage = homed_stage(drive)
    began_s = drive.now_s

    def pause(seconds: float, /) -> None:
        drive.pause(seconds)
        if drive.now_s > began_s + 0.5:
            raise Abandoned

    with pytest.raises(Abandoned):
        stage.move_to(90.0, pause)
    assert drive.standing
    assert drive.writes(0x6002) == [(0x40,)]


def test_a_stop_that_fails_does_not_hide_why_it_was_sent(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.breaks.extend([("write 0x6002", NoReply("stage: no answer"), True)] * 3)

    def pause(seconds: float, /) -> None:
        raise Abandoned

    with pytest.raises(Abandoned) as caught:
        stage.move_to(90.0, pause)
    assert any("the stop failed" in note for note in caught.value.__notes__)


@pytest.mark.parametrize("error", [NoReply("no answer"), FrameError("checksum")])
def test_a_lost_answer_to_a_move_is_not_sent_again_when_the_stage_arrives(
    drive: Drive, error: DriverError
) -> None:
    stage = homed_stage(drive)
    drive.breaks.append(("write 0x6200", error, False))
    assert stage.move_to(50.0, drive.pause).position == 50.0
    assert len(drive.writes(0x6200)) == 1


def test_a_lost_move_is_not_sent_again_and_refused_where_the_stage_stands(drive: Drive) -> None:
    stage = homed_stage(drive)
    stage.move_to(10.0, drive.pause)
    drive.log.clear()
    lost = NoReply("no answer")
    drive.breaks.append(("write 0x6200", lost, True))
    with pytest.raises(Refused, match=r"10\.000 mm, .*lost; it was not sent again") as caught:
        stage.move_to(50.0, drive.pause)
    assert caught.value.__cause__ is lost
    assert len(drive.writes(0x6200)) == 1


def test_standing_in_the_right_place_by_chance_is_no_arrival(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.complete = False
    drive.breaks.append(("write 0x6200", NoReply("no answer"), True))
    with pytest.raises(Refused, match=r"stands at 0\.000 mm, .* path not complete"):
        stage.move_to(0.0, drive.pause)


def test_the_drives_own_checksum_complaint_counts_as_a_lost_move(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.breaks.append(("write 0x6200", Refused("exception 8", code=8), True))
    with pytest.raises(Refused, match="not sent again") as caught:
        stage.move_to(50.0, drive.pause)
    assert isinstance(caught.value.__cause__, FrameError)


def test_a_move_the_drive_refuses_is_refused_with_its_code(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.breaks.append(("write 0x6200", Refused("exception 3", code=3), True))
    with pytest.raises(Refused) as caught:
        stage.move_to(50.0, drive.pause)
    assert caught.value.code == 3


def test_a_stage_that_is_moving_is_not_sent_elsewhere(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.write_registers(STATION, 0x6200, (1, 0, 40_000, 10, 200, 200, 0, 0x10))
    drive.now_s += 0.2
    drive.log.clear()
    with pytest.raises(Refused, match="still moving"):
        stage.move_to(50.0, drive.pause)
    assert drive.writes(0x6200) == []


# --- alarms, enable, link


def test_an_alarm_in_a_move_is_named_and_homed_is_forgotten(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.trips[drive.now_s + 1.0] = 0x180
    with pytest.raises(Refused, match=r"alarm 0x180 following error.*home again") as caught:
        stage.move_to(90.0, drive.pause)
    assert caught.value.code == 0x180
    state = stage.state()
    assert (state.motion, state.homed) == (Motion.ALARM, False)
    assert state.alarm == "0x180 following error"


def test_an_alarm_is_only_reset_when_asked_and_homed_stays_lost(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.fault = 0x0C0
    with pytest.raises(Refused, match="over-voltage"):
        stage.move_to(5.0, drive.pause)
    with pytest.raises(Refused, match="over-voltage"):
        stage.home(drive.pause)
    assert drive.writes(0x1801) == []
    stage.clear_alarm()
    assert drive.writes(0x1801) == [(0x1111,)]
    assert drive.standing
    assert stage.state() == AxisState(Motion.STANDING, 0.0, homed=False)
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(5.0, drive.pause)


def test_an_alarm_that_was_cleared_before_it_was_seen_still_loses_homed(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.fault = 0x0E0
    stage.clear_alarm()
    assert drive.homed
    assert stage.state() == AxisState(Motion.STANDING, 0.0, homed=False)


def test_an_alarm_between_two_moves_is_seen_before_the_second_is_sent(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.fault = 0x0E0
    with pytest.raises(Refused, match="over-current"):
        stage.move_to(5.0, drive.pause)
    assert drive.writes(0x6200) == []


def test_a_drive_that_is_not_enabled_is_refused_and_forgets_homed(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.enabled = False
    with pytest.raises(Refused, match="not enabled"):
        stage.move_to(5.0, drive.pause)
    drive.enabled = True
    assert not stage.state().homed


def test_a_drive_that_lost_its_power_between_moves_has_to_home(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.homed = False
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(5.0, drive.pause)
    assert drive.writes(0x6200) == []


def test_a_lost_link_forgets_homed_though_the_drive_does_not(drive: Drive) -> None:
    stage = homed_stage(drive)
    drive.breaks.append(("read", LinkLost("serial:///dev/ttyTEST: gone"), True))
    with pytest.raises(LinkLost):
        stage.state()
    assert drive.homed
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(5.0, drive.pause)


# --- stop, identity


@pytest.mark.parametrize("lost", [0, 1, 2])
@pytest.mark.parametrize("error", [NoReply("no answer"), FrameError("checksum")])
def test_a_stop_is_sent_until_it_is_acknowledged(
    drive: Drive, lost: int, error: DriverError
) -> None:
    stage = stage_on(drive)
    drive.breaks.extend([("write 0x6002", error, True)] * lost)
    stage.stop()
    assert drive.writes(0x6002) == [(0x40,)] * (lost + 1)


def test_a_stop_that_is_never_acknowledged_calls_for_the_emergency_stop(drive: Drive) -> None:
    drive.breaks.extend([("write", NoReply("no answer"), True)] * 3)
    with pytest.raises(NoReply) as caught:
        stage_on(drive).stop()
    assert "emergency stop" in caught.value.__notes__[0]
    assert len(drive.log) == 3


def test_after_a_stop_the_position_is_kept_and_the_next_move_goes(drive: Drive) -> None:
    stage = homed_stage(drive)
    stage.stop()
    assert stage.state().homed
    assert stage.move_to(20.0, drive.pause).position == 20.0


def test_it_says_who_it_is_from_the_registers_there_are(drive: Drive) -> None:
    stage = stage_on(drive)
    model = "CS2RS, closed loop, 10000 pulses/rev"
    assert stage.identify() == Identity("leadshine", model, "")
    drive.words.update({0x0003: 0, 0x01FF: 0x0102})
    model = "CS2RS, open loop, 10000 pulses/rev"
    assert stage.identify() == Identity("leadshine", model, "version 0x0102")


@pytest.mark.parametrize("error", [NoReply("no answer"), Refused("device failure", code=4)])
def test_a_version_that_is_not_answered_is_no_missing_version(
    drive: Drive, error: DriverError
) -> None:
    drive.breaks.append(("read 0x01FF", error, True))
    with pytest.raises(type(error)):
        stage_on(drive).identify()


def test_it_is_a_linear_axis_and_the_model_is_a_bus(drive: Drive) -> None:
    axis: Axis = stage_on(drive)
    bus: Bus = drive
    assert (axis.kind, bus.address) == (Kind.LINEAR, "serial:///dev/ttyTEST")


def test_nothing_is_ever_saved_to_the_drives_memory(drive: Drive) -> None:
    stage = homed_stage(drive)
    stage.home(drive.pause)
    stage.move_to(5.0, drive.pause)
    stage.stop()
    assert drive.writes(0x1801) == []


# --- beside the move -------------------------------------------------------------------------


def test_against_a_stop_time_and_current_go_along_in_the_same_frame() -> None:
    search = HomeSearch(HomingMethod.TORQUE, HomingSense.POSITIVE, 0, 120, 30, 200, 200, 150, 40)
    assert homing_block(search) == (0x0D, 0, 0, 0, 0, 120, 30, 200, 200, 150, 40)
    here = replace(search, method=HomingMethod.HERE, sense=HomingSense.NEGATIVE)
    assert homing_block(here) == (0x20, 0, 0, 0, 0, 120, 30, 200, 200)
    with pytest.raises(ValueError, match="torque_percent 101"):
        homing_block(replace(search, torque_percent=101))


def test_an_alarm_says_what_to_do() -> None:
    assert alarm_remedy(Model.CS2RS, 0x180) == "remove what is in its way"
    assert alarm_remedy(Model.EM, 0x02).startswith("check the supply")
    assert alarm_remedy(Model.EM, 0x77) == "remove the cause"


def test_the_drive_is_told_the_soft_limits_when_it_is_homed_and_they_are_lifted_before() -> None:
    rig = StageRig()
    rig.stage.home(rig.pause)
    bus = rig.bus()
    assert bus.read_holding(7, 0x6006, 4) == (9, 0x27C0, 0xFFFF, 0xD8F0)  # 300 mm and -5 mm
    assert bus.read_holding(7, 0x6000, 1) == (2,)
    rig.pause(0.2)
    bus.write_registers(7, 0x6200, (1, 10, 0, 240, 100, 100, 0, 0x10))  # past the driver: 327 mm
    rig.pause(30.0)
    assert rig.truth_mm == pytest.approx(300.0, abs=0.001)
    assert rig.drive.saves == 0
    rig.stage.stop()
    rig.stage.home(rig.pause)  # the limits lifted meanwhile
    assert rig.stage.state().position == -3.0


def test_a_search_that_finds_nothing_says_which_inputs_are_closed() -> None:
    drive = Drive(enabled=True, words={0x0179: 0b101})
    drive._look_for_home = lambda: None  # type: ignore[method-assign] # it hears, and stands
    with pytest.raises(Refused, match="no reference, the drive stands, inputs closed: SI1, SI3;"):
        stage_on(drive).home(drive.pause)


# --- frames of the manuals that tell of errors -----------------------------------------------


@pytest.mark.parametrize(
    ("sent", "answered"),
    [("01 03 00 01 00 01 D5 C1", "01 83 08 40 F6"), ("01 02 00 01 00 01 E8 0A", "01 82 01 81 60")],
    ids=["wrong CRC", "wrong function"],
)
def test_the_simulated_drive_answers_the_manuals_errors_byte_for_byte(sent, answered) -> None:
    """iEM-RS page 20, CS2RS page 25, CL57RS page 26: "example F", both of them."""
    server = RtuServer({1: LeadshineDrive(world_axis("stage", 0.0, Limits(1.0, 1.0)))})
    assert server.receive(bytes.fromhex(sent), 1.0) == bytes.fromhex(answered)


def test_parameters_whose_answer_is_lost_are_read_back(drive: Drive) -> None:
    drive.breaks.append(("write 0x600A", NoReply("stage: no answer"), False))
    assert stage_on(drive).home(drive.pause).homed
    assert len(drive.writes(0x600A)) == 1


def test_parameters_that_were_not_heard_end_the_homing(drive: Drive) -> None:
    drive.words.update(dict.fromkeys(range(0x600A, 0x6013), 0))
    drive.breaks.append(("write 0x600A", NoReply("stage: no answer"), True))
    with pytest.raises(NoReply):
        stage_on(drive).home(drive.pause)
    assert drive.writes(0x6002) == [(0x40,)]  # it was told to stop, and never to search
