"""The simulated Leadshine drive: the manuals' frames, its words in time, and our driver's stage."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.axis import Identity, Motion
from drivers.errors import FrameError, Refused
from drivers.leadshine import HomingMethod, HomingSense, Model
from sim.device import ModbusRefusal
from sim.leadshine import Alarm, Family, LeadshineDrive, LeadshineSettings
from sim.modbus import RtuServer
from sim.motion import Limits
from sim.world import Pace
from tests.sim.judges import STAGE, START_S, StageRig, world_axis

ABSOLUTE, RELATIVE, VELOCITY = 0x0001, 0x0041, 0x0002
GO = 0x0010


class Bench:
    """A drive asked directly, in words; time passes when told."""

    def __init__(self, at_mm: float = 0.0, pace: Pace | None = None, **told: object) -> None:
        self.now_s = START_S
        self.axis = world_axis("stage", at_mm, Limits(100.0, 2000.0), pace=pace)
        self.drive = LeadshineDrive(self.axis, LeadshineSettings(**told))

    def read(self, first: int, count: int = 1) -> list[int]:
        return list(self.drive.read_holding(first, count, self.now_s))

    def write(self, first: int, *words: int) -> None:
        self.drive.write_registers(first, words, self.now_s)

    def go(self, counts: int, *, mode: int = ABSOLUTE, rpm: int = 600, dwell_ms: int = 0) -> None:
        high, low = counts >> 16 & 0xFFFF, counts & 0xFFFF
        self.write(0x6200, mode, high, low, rpm & 0xFFFF, 100, 100, dwell_ms, GO)

    def home(self, mode: int) -> None:
        self.write(0x600A, mode)
        self.write(0x6002, 0x20)
        self.after(20.0)

    def after(self, seconds: float) -> None:
        ends_s = self.now_s + seconds
        while self.now_s < ends_s:
            self.now_s = min(self.now_s + 0.001, ends_s)
            self.drive.tick(self.now_s)

    @property
    def status(self) -> int:
        return self.read(0x1003)[0]

    @property
    def count(self) -> int:
        high, low = self.read(0x602C, 2)
        value = high * 65536 + low
        return value - 2**32 if value >= 2**31 else value

    @property
    def mm(self) -> float:
        return self.axis.motor(self.now_s)


# CS2RS manual 1864840 p23-25, 35, 50; CS2RS-D503 p24-26, 32; the same frames stand in the manuals
# of iEM-RS (1864935 p26) and CL57RS (p26, 33). The first one's CRC is printed D3 1B, a misprint.
# The last two: a bad CRC, a function it has not.
GOLDEN = [
    ("01 03 01 91 00 01 D4 1B", "01 03 02 00 0A 38 43"),
    ("01 03 01 BC 00 06 05 D0", "01 03 0C 00 00 00 02 00 00 00 01 00 00 00 04 B6 13"),
    ("01 10 01 46 00 04 08 00 00 00 28 00 00 00 29 1C 14", "01 10 01 46 00 04 21 E3"),
    ("01 06 18 01 22 44 C6 39", "01 06 18 01 22 44 C6 39"),
    (
        "07 10 62 00 00 08 10 00 01 00 00 27 10 00 00 27 10 27 10 00 00 00 10 8D 50",
        "07 10 62 00 00 08 DE 11",
    ),
    ("01 03 00 01 00 01 D5 C1", "01 83 08 40 F6"),
    ("01 02 00 01 00 01 E8 0A", "01 82 01 81 60"),
]


@pytest.mark.parametrize(("asked", "answered"), GOLDEN)
def test_the_manuals_frames_are_answered_to_the_byte(asked, answered):
    request = bytes.fromhex(asked)
    server = RtuServer({request[0]: Bench().drive})
    assert server.receive(request, START_S) == bytes.fromhex(answered)


# ---- one move, in the words that tell of it


def test_before_any_move_only_enabled_is_set():
    bench = Bench()
    assert bench.status == 0x0002
    bench.after(0.1)
    assert bench.status == 0x0002
    assert bench.axis._witness.events == []


def test_the_words_of_a_move_follow_each_other():
    bench = Bench()
    bench.go(100_000)  # 50 mm at 50 mm/s and 833 mm/s2
    assert (bench.status, bench.read(0x6002)) == (0x0002, [0x010])  # taken, not begun
    bench.after(0.003)
    assert (bench.status, bench.read(0x6002)) == (0x0006, [0x100])  # running
    bench.after(1.04)
    assert (bench.status, bench.read(0x6002)) == (0x0012, [0x100])  # command complete
    assert 0.01 < 50.0 - bench.mm < 1.0
    bench.after(0.03)
    assert (bench.status, bench.read(0x6002)) == (0x0032, [0x000])  # path complete
    assert bench.mm == 50.0
    assert bench.axis.stands(bench.now_s)


def test_just_after_the_trigger_the_last_moves_bits_still_stand():
    bench = Bench()
    bench.go(1_000)
    bench.after(1.0)
    bench.go(100_000)
    assert bench.status == 0x0032
    bench.after(0.003)
    assert bench.status == 0x0006


def test_the_path_is_complete_only_after_its_dwell():
    bench = Bench()
    bench.go(10_000, dwell_ms=500)  # 5 mm: 0.16 s
    bench.after(0.5)
    assert bench.status == 0x0012
    bench.after(0.3)
    assert bench.status == 0x0032


@pytest.mark.parametrize(
    ("counts", "mm"), [(1, 0.0005), (-1, -0.0005), (70_000, 35.0), (-12_345, -6.1725)]
)
def test_counts_are_of_both_signs_and_of_32_bits_high_word_first(counts, mm):
    bench = Bench()
    bench.go(counts)
    bench.after(3.0)
    assert math.isclose(bench.mm, mm, abs_tol=1e-9)
    assert bench.count == counts
    expected = [counts >> 16 & 0xFFFF, counts & 0xFFFF]
    assert [bench.read(first, 2) for first in (0x602A, 0x602C, 0x1014)] == [expected] * 3


def test_a_relative_path_goes_on_from_where_it_stands():
    bench = Bench(at_mm=7.0)
    for _ in range(2):
        bench.go(2_000, mode=RELATIVE)
        bench.after(1.0)
    assert math.isclose(bench.mm, 9.0)
    bench.go(2_000)  # absolute: the count was 0 where the power came
    bench.after(1.0)
    assert math.isclose(bench.mm, 8.0)


def test_the_speed_is_in_revolutions_a_minute_and_the_ramps_in_ms_for_1000_of_them():
    bench = Bench()
    bench.go(200_000, rpm=300)  # 100 mm at 25 mm/s; a ramp lasts 30 ms, and half of it is lost
    bench.after(0.002 + 4.03 - 0.002)
    assert not bench.axis.stands(bench.now_s)
    assert bench.read(0x1044, 2) == bench.read(0x1046, 2) == [0, 300]
    bench.after(0.004)
    assert bench.axis.stands(bench.now_s)


def test_station_time_runs_as_fast_as_its_pace():
    bench = Bench(pace=Pace(START_S, 10.0))
    bench.go(200_000, rpm=300)
    bench.after(0.002 + 0.403 + 0.003)
    assert bench.axis.stands(bench.now_s)


def test_a_path_under_way_is_not_interrupted():
    bench = Bench()
    bench.go(50_000)
    bench.after(0.1)
    bench.go(-50_000)
    bench.after(3.0)
    assert bench.mm == 25.0


def test_any_path_is_started_by_its_number():
    bench = Bench()
    bench.write(0x6200 + 8 * 3, ABSOLUTE, 0, 20_000, 600, 100, 100, 0, 0)
    bench.write(0x6002, 0x13)
    bench.after(0.1)
    assert bench.read(0x6002) == [0x103]
    bench.after(1.0)
    assert (bench.mm, bench.read(0x6002)) == (10.0, [0x003])


def test_only_path_0_is_started_by_its_last_word():
    bench = Bench()
    bench.write(0x6208, ABSOLUTE, 0, 20_000, 600, 100, 100, 0, GO)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (0.0, 0x0002)


def test_a_path_at_no_speed_runs_for_ever_and_can_be_stopped():
    bench = Bench()
    bench.go(10_000, rpm=0)
    bench.after(5.0)
    assert (bench.mm, bench.status) == (0.0, 0x0006)
    bench.write(0x6002, 0x40)
    bench.after(0.01)
    assert bench.status == 0x0012


def test_a_position_written_in_two_frames_is_torn_between_them():
    bench = Bench()
    bench.write(0x6200, ABSOLUTE, 0x0000, 0xFFF0, 600, 100, 100, 0, 0)
    bench.write(0x6201, 0x0001)  # on the way from 0x0000FFF0 to 0x00010010
    bench.write(0x6002, GO)
    bench.after(0.001)
    bench.write(0x6202, 0x0010)
    bench.after(5.0)
    assert bench.count == 0x00010010  # the second half came before the path began
    bench.write(0x6201, 0x0000)
    bench.write(0x6002, GO)
    bench.after(0.01)
    bench.write(0x6202, 0xFFF0)
    bench.after(5.0)
    assert bench.count == 0x00000010  # and here too late


# ---- stop, velocity, jog


def test_a_stopped_path_is_not_complete():
    bench = Bench()
    bench.go(100_000)
    bench.after(0.5)
    bench.write(0x6002, 0x40)
    assert bench.status == 0x0006  # it slows down
    bench.after(0.2)
    assert bench.status == 0x0012
    assert 20.0 < bench.mm < 30.0
    bench.after(2.0)
    assert bench.mm < 30.0


def test_a_stop_before_the_path_has_begun_forgets_it():
    bench = Bench()
    bench.go(1_000)
    bench.after(1.0)
    bench.go(100_000)
    bench.write(0x6002, 0x40)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (0.5, 0x0012)


def test_a_stop_at_rest_leaves_the_words_as_they_are():
    bench = Bench()
    bench.go(1_000)
    bench.after(1.0)
    bench.write(0x6002, 0x40)
    bench.after(0.1)
    assert bench.status == 0x0032


@pytest.mark.parametrize(("rpm", "low_mm", "high_mm"), [(60, 4.0, 5.0), (-60, -5.0, -4.0)])
def test_a_path_of_velocity_goes_on_until_it_is_stopped(rpm, low_mm, high_mm):
    bench = Bench()
    bench.go(0, mode=VELOCITY, rpm=rpm)
    bench.after(1.0)
    assert low_mm < bench.mm < high_mm
    assert bench.status == 0x0006
    bench.write(0x6002, 0x40)
    bench.after(1.0)
    assert abs(bench.mm) < 6.0


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_a_jog_that_is_not_renewed_within_50_ms_of_wall_time_ends(scale):
    bench = Bench(pace=Pace(START_S, scale))
    for _ in range(10):
        bench.write(0x1801, 0x4001)
        bench.after(0.04)
        assert bench.status == 0x0006
    bench.after(0.02)
    gone_mm = bench.mm
    assert gone_mm > 1.0
    bench.after(1.0)
    assert bench.mm - gone_mm < 0.5
    assert bench.status == 0x0012


def test_the_other_jog_goes_the_other_way():
    bench = Bench()
    bench.write(0x1801, 0x4002)
    bench.after(0.04)
    assert bench.mm < 0.0


# ---- limits


def test_soft_limits_count_only_when_they_are_switched_on():
    bench = Bench()
    bench.write(0x6006, 0, 10_000, 0xFFFF, 0xFFFF - 9_999)
    bench.go(20_000)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (10.0, 0x0032)
    bench.write(0x6000, 0x0002)
    bench.go(0)
    bench.after(1.0)
    bench.go(20_000)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (5.0, 0x0012)  # stands at the limit, not complete
    bench.go(-20_000)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (-5.0, 0x0012)


def test_it_stops_at_the_end_of_its_way():
    bench = Bench(travel_mm=(-1.0, 8.0))
    bench.go(20_000)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (8.0, 0x0012)


# ---- homing

SWITCH, LIMIT, TORQUE, HERE, INDEX = 0x04, 0x00, 0x0C, 0x20, 0x08


@pytest.mark.parametrize(
    ("mode", "home_mm"),
    [
        (SWITCH, 2.5),
        (SWITCH | 1, 2.5),
        (INDEX, 2.5),
        (LIMIT, -4.0),
        (LIMIT | 1, 60.0),
        (TORQUE, -4.0),
        (TORQUE | 1, 60.0),
        (HERE, 30.0),
    ],
)
def test_homing_ends_where_its_mode_says_and_counts_from_there(mode, home_mm):
    bench = Bench(at_mm=30.0, travel_mm=(-4.0, 60.0), home_switch_mm=2.5)
    bench.home(mode)
    assert (bench.mm, bench.count, bench.status) == (home_mm, 0, 0x0052)


def test_homing_by_torque_takes_an_obstacle_for_the_stop():
    bench = Bench(at_mm=30.0)
    bench.axis.obstacle = 44.0
    bench.home(TORQUE | 1)
    assert (bench.mm, bench.count, bench.status) == (44.0, 0, 0x0052)


def test_while_it_homes_it_runs_and_is_neither_homed_nor_complete():
    bench = Bench(at_mm=30.0)
    bench.home(SWITCH)
    bench.go(20_000)
    bench.after(1.0)
    assert bench.status == 0x0072
    bench.write(0x6002, 0x20)
    bench.after(0.01)
    assert bench.status == 0x0006
    bench.write(0x6002, 0x40)
    bench.after(1.0)
    assert bench.status == 0x0012


def test_home_can_have_a_count_and_a_place_to_stop_beside_it():
    bench = Bench(at_mm=30.0)
    bench.write(0x600B, 0xFFFF, 0xFFFF - 999, 0x0000, 4_000)  # home is -1000, stop at 4000
    bench.home(SWITCH | 0x02)
    assert (bench.mm, bench.count, bench.status) == (2.5, 4_000, 0x0052)


def test_the_slow_approach_is_made_in_the_direction_of_the_search():
    bench = Bench(at_mm=30.0)
    bench.home(SWITCH)
    moves = [event for event in bench.axis._witness.events if event["what"] == "move"]
    assert [event["target"] for event in moves] == [0.0, 1.0, 0.0]
    slow_s = moves[-1]["ends_s"] - moves[-1]["time_s"]
    assert math.isclose(slow_s, 1.0 / (50.0 / 60.0 * 5.0), rel_tol=0.05)


def test_homed_stays_until_the_next_homing_whatever_happens():
    bench = Bench(at_mm=30.0)
    bench.home(SWITCH)
    bench.drive.fail(Alarm.OVER_VOLTAGE, bench.now_s)
    assert bench.status & 0x0041 == 0x0041
    bench.drive.power_up(bench.now_s)
    assert bench.status & 0x0040 == 0


def test_set_zero_counts_from_here_and_is_no_homing():
    bench = Bench(at_mm=30.0)
    bench.go(2_000)
    bench.after(1.0)
    bench.write(0x6002, 0x21)
    assert (bench.count, bench.status) == (0, 0x0032)


# ---- alarms


def test_a_held_shaft_of_a_closed_loop_is_a_following_error():
    bench = Bench()
    bench.axis.obstacle = 10.0
    bench.go(40_000)
    bench.after(1.0)
    assert bench.read(0x2203) == [0x0180]
    assert bench.status == 0x0001
    assert (bench.mm, bench.count) == (10.0, 20_000)


def test_an_alarm_is_reset_by_its_word_and_until_then_nothing_moves():
    bench = Bench()
    bench.axis.obstacle = 10.0
    bench.go(40_000)
    bench.after(1.0)
    bench.axis.obstacle = None
    for begin in (lambda: bench.go(40_000), lambda: bench.write(0x1801, 0x4001)):
        begin()
        bench.after(1.0)
        assert bench.mm == 10.0
    bench.write(0x1801, 0x1122)  # the history's
    assert bench.read(0x2203) == [0x0180]
    bench.write(0x1801, 0x1111)
    assert (bench.read(0x2203), bench.status) == ([0], 0x0002)
    bench.go(40_000)
    bench.after(1.0)
    assert (bench.mm, bench.status) == (20.0, 0x0032)


def test_an_open_loop_loses_the_steps_and_says_nothing():
    bench = Bench(family=Family.EM2RS)
    bench.axis.obstacle = 10.0
    bench.go(40_000)
    bench.after(1.0)
    assert (bench.mm, bench.count, bench.status) == (10.0, 40_000, 0x0032)
    bench.go(0)
    bench.after(1.0)
    assert (bench.mm, bench.count) == (-10.0, 0)


@pytest.mark.parametrize(
    ("family", "alarm", "code"),
    [
        (Family.CS2RS, Alarm.OVER_CURRENT, 0x0E0),
        (Family.CS2RS, Alarm.OVER_VOLTAGE, 0x0C0),
        (Family.CS2RS, Alarm.ENCODER, 0x150),
        (Family.EM2RS, Alarm.OVER_CURRENT, 0x01),
        (Family.EM2RS, Alarm.OVER_VOLTAGE, 0x02),
    ],
)
def test_an_alarm_has_its_familys_code_and_brakes(family, alarm, code):
    bench = Bench(family=family)
    bench.go(100_000)
    bench.after(0.3)
    bench.drive.fail(alarm, bench.now_s)
    bench.after(1.0)
    assert bench.read(0x2203) == [code]
    assert bench.axis.stands(bench.now_s)
    assert bench.mm < 20.0


def test_an_open_loop_has_no_following_error_to_raise():
    with pytest.raises(ValueError, match="EM2RS"):
        Bench(family=Family.EM2RS).drive.fail(Alarm.FOLLOWING_ERROR, START_S)


# ---- registers


@pytest.mark.parametrize(
    ("first", "words", "code"),
    [
        (0x0001, [199], 3),
        (0x0001, [51_201], 3),
        (0x0000, [1, 0], 3),  # 65 536
        (0x0003, [3], 3),
        (0x0007, [2], 3),
        (0x01BF, [32], 3),
        (0x6002, [0x30], 3),
        (0x6207, [0x11 + 0x20], 3),
        (0x6203, [5_001], 3),
        (0x6203, [0x10000 - 5_001], 3),
        (0x6204, [0x8000], 3),
        (0x6200, [ABSOLUTE, 0, 100, 600, 100, 100, 0x8000, GO], 3),
        (0x1003, [0], 2),
        (0x2203, [0], 2),
        (0x602C, [0, 0], 2),
        (0x627F, [0, 0], 2),
        (0x3000, [0], 2),
    ],
)
def test_a_write_that_is_not_allowed_is_refused_and_changes_nothing(first, words, code):
    bench = Bench()
    with pytest.raises(ModbusRefusal) as refusal:
        bench.write(first, *words)
    assert refusal.value.code == code
    bench.after(0.5)
    assert (bench.mm, bench.read(0x0001), bench.read(0x6203)) == (0.0, [10_000], [60])


@pytest.mark.parametrize(("first", "count"), [(0x3000, 1), (0x1004, 1), (0x1016, 1), (0x6280, 1)])
def test_a_register_that_is_not_there_is_refused(first, count):
    with pytest.raises(ModbusRefusal) as refusal:
        Bench().read(first, count)
    assert refusal.value.code == 2


def test_a_message_is_200_bytes_long_at_most():
    bench = Bench()
    assert len(bench.read(0x6200, 97)) == 97
    with pytest.raises(ModbusRefusal) as refusal:
        bench.read(0x6200, 98)
    assert refusal.value.code == 3
    bench.write(0x6208, *[0] * 95)
    with pytest.raises(ModbusRefusal):
        bench.write(0x6208, *[0] * 96)


def test_the_open_loop_has_no_register_for_its_loop():
    assert Bench().read(0x0003) == [2]
    with pytest.raises(ModbusRefusal):
        Bench(family=Family.EM2RS).read(0x0003)


@pytest.mark.parametrize("ask", ["read_input", "read_coils", "read_discrete"])
def test_functions_beside_3_6_and_16_are_refused(ask):
    bench = Bench()
    with pytest.raises(ModbusRefusal) as refusal:
        getattr(bench.drive, ask)(0, 1, START_S)
    assert refusal.value.code == 1
    with pytest.raises(ModbusRefusal):
        bench.drive.write_coils(0, [True], START_S)


def test_pulses_of_a_turn_and_the_direction_scale_what_follows_and_keep_the_count():
    bench = Bench()
    bench.go(20_000)
    bench.after(1.0)
    bench.write(0x0001, 20_000)
    assert (bench.mm, bench.count) == (10.0, 20_000)
    bench.go(24_000)
    bench.after(1.0)
    assert math.isclose(bench.mm, 11.0)
    bench.write(0x0007, 1)
    assert bench.count == 24_000
    bench.go(28_000)
    bench.after(1.0)
    assert math.isclose(bench.mm, 10.0)


def test_a_reversed_axis_homes_the_other_way():
    bench = Bench(at_mm=30.0, travel_mm=(-4.0, 60.0))
    bench.write(0x0007, 1)
    bench.home(LIMIT)
    assert bench.mm == 60.0


def test_what_was_saved_survives_the_power_and_the_rest_does_not():
    bench = Bench()
    bench.write(0x0001, 20_000)
    bench.write(0x1801, 0x2211)
    bench.write(0x01E1, 120)
    assert (bench.read(0x1901), bench.read(0x1901)) == ([0x5555], [0x1111])
    bench.drive.power_up(bench.now_s)
    assert (bench.read(0x0001), bench.read(0x01E1), bench.drive.saves) == ([20_000], [60], 1)


def test_a_drive_that_is_not_enabled_does_not_move():
    bench = Bench()
    bench.write(0x0145, 0)  # no input enables any more
    assert bench.status == 0x0000
    bench.go(20_000)
    bench.after(1.0)
    assert bench.mm == 0.0
    bench.write(0x000F, 1)
    assert bench.status == 0x0002
    bench.go(20_000)
    bench.after(0.1)
    bench.write(0x000F, 0)
    bench.after(1.0)
    assert 0.0 < bench.mm < 10.0
    assert bench.status & 0x0026 == 0


def test_a_home_switch_beside_the_way_is_a_mistake():
    with pytest.raises(ValueError, match="home switch at 9"):
        LeadshineSettings(travel_mm=(0.0, 5.0), home_switch_mm=9.0)


# ---- our driver's stage


def test_the_driver_reads_who_it_is():
    rig = StageRig(told=LeadshineSettings(stored={0x01FF: 0x0304, 0x0201: 0x0506}))
    assert rig.stage.identify() == Identity(
        "leadshine", "CS2RS, closed loop, 10000 pulses/rev", "version 0x0304 firmware 0x0506"
    )


@pytest.mark.parametrize("sense", HomingSense)
@pytest.mark.parametrize(
    ("method", "low_mm", "high_mm"),
    [
        (HomingMethod.LIMIT_SWITCH, -10.0, 400.0),
        (HomingMethod.HOME_SWITCH, 0.0, 0.0),
        (HomingMethod.TORQUE, -10.0, 400.0),
    ],
)
def test_the_driver_homes_by_every_method(method, low_mm, high_mm, sense):
    homing = replace(STAGE.homing, method=method, sense=sense, fast_mm_s=90.0)
    rig = StageRig(settings=replace(STAGE, homing=homing))
    state = rig.stage.home(rig.pause)
    expected_mm = high_mm if sense is HomingSense.POSITIVE else low_mm
    assert math.isclose(rig.axis.motor(rig.now_s), expected_mm, abs_tol=1e-6)
    assert (state.position, state.homed) == (-3.0, True)


def test_the_driver_is_unhomed_after_the_drive_lost_its_power():
    rig = StageRig()
    rig.stage.home(rig.pause)
    rig.drive.power_up(rig.now_s)
    with pytest.raises(Refused, match="not homed"):
        rig.stage.move_to(10.0, rig.pause)
    assert rig.truth_mm == -3.0


class Tripped(Exception):  # noqa: N818
    """Raised out of a pause, as by an operator."""


def test_a_move_that_is_given_up_stops_the_axis_in_its_middle():
    rig = StageRig()
    rig.stage.home(rig.pause)
    given_up_s = rig.now_s + 1.0

    def pause(seconds: float) -> None:
        rig.pause(seconds)
        if rig.now_s > given_up_s:
            raise Tripped

    with pytest.raises(Tripped):
        rig.stage.move_to(100.0, pause)
    rig.pause(0.25)
    assert rig.axis.stands(rig.now_s)
    assert 10.0 < rig.truth_mm < 25.0
    state = rig.stage.state()
    assert (state.motion, state.homed) == (Motion.STANDING, True)
    assert math.isclose(state.position, rig.truth_mm, abs_tol=0.001)
    assert math.isclose(rig.stage.move_to(5.0, rig.pause).position, 5.0)
    assert math.isclose(rig.truth_mm, 5.0, abs_tol=0.001)


def test_a_move_that_somebody_else_stopped_is_not_taken_for_done():
    rig = StageRig()
    rig.stage.home(rig.pause)
    stop_s = rig.now_s + 1.0

    def pause(seconds: float) -> None:
        rig.pause(seconds)
        if rig.now_s > stop_s:
            rig.drive.write_registers(0x6002, [0x40], rig.now_s)

    with pytest.raises(Refused, match="not complete"):
        rig.stage.move_to(100.0, pause)


def test_a_stall_is_refused_by_the_alarms_name_and_the_way_back_is_home():
    rig = StageRig()
    rig.stage.home(rig.pause)
    rig.axis.obstacle = 20.0
    with pytest.raises(Refused, match="alarm 0x180 following error") as stalled:
        rig.stage.move_to(100.0, rig.pause)
    assert stalled.value.code == 0x180
    assert rig.stage.state().alarm == "0x180 following error"
    with pytest.raises(Refused, match="not homed"):
        rig.stage.move_to(0.0, rig.pause)
    rig.stage.clear_alarm()
    rig.stage.home(rig.pause)
    assert math.isclose(rig.stage.move_to(10.0, rig.pause).position, 10.0)


def test_lost_steps_of_an_open_loop_show_only_in_truth():
    told = LeadshineSettings(family=Family.EM2RS)
    rig = StageRig(told=told, settings=replace(STAGE, model=Model.EM))
    rig.stage.home(rig.pause)
    rig.axis.obstacle = 20.0
    assert rig.stage.move_to(100.0, rig.pause).position == 100.0
    assert math.isclose(rig.truth_mm, 17.0)


def test_another_scale_than_the_stations_is_refused_before_anything_moves():
    rig = StageRig(told=LeadshineSettings(pulses_per_turn=4_000))
    with pytest.raises(Refused, match="4000 pulses"):
        rig.stage.home(rig.pause)
    assert rig.axis.motor(rig.now_s) == 37.0


def test_the_drives_complaint_of_a_damaged_request_is_a_frame_error_and_moves_nothing():
    rig = StageRig()
    rig.stage.home(rig.pause)
    write = rig.link.write
    rig.link.write = lambda data: write(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(FrameError, match="damaged request"):
        rig.stage.stop()


def test_a_scan_at_ten_times_the_pace_arrives_as_well():
    rig = StageRig(pace=Pace(START_S, 10.0))
    rig.stage.home(rig.pause)
    then_s = rig.now_s
    rig.stage.move_to(100.0, rig.pause)
    assert math.isclose(rig.truth_mm, 100.0, abs_tol=0.001)
    assert rig.now_s - then_s < 0.8


def test_the_cap_of_the_axis_holds_whatever_the_drive_is_told():
    axis = world_axis("stage", 0.0, Limits(10.0, 2000.0))
    drive = LeadshineDrive(axis)
    drive.write_registers(0x6200, [ABSOLUTE, 0, 20_000, 3_000, 0, 0, 0, GO], START_S)
    drive.tick(START_S + 0.002)
    assert math.isclose(axis.ends_s() - START_S, 1.007, abs_tol=0.001)
