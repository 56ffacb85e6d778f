"""Profilers in registers: layouts against words laid out by hand, and reads against a device."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from drivers.bus import Bus
from drivers.errors import NoReply, Refused
from drivers.loopback import loopback
from drivers.modbus import ModbusBus
from drivers.profiler import Profile, Profiler, Reason, Tally
from drivers.register_profiler import (
    EZ_ARRAY_ID,
    EZ_ARRAY_MEASUREMENTS,
    Flag,
    Layout,
    Packing,
    RegisterProfiler,
    Table,
    Trigger,
    WordOrder,
    decoded,
    ez_array,
    ez_array_measurements,
)

PLAIN = Layout(
    first_register=100,
    columns=4,
    z_mm_per_count=0.01,
    z_offset_mm=50.0,
    column_pitch_mm=0.5,
    first_column_mm=-1.0,
    missing=((0xFFFF, Reason.NO_RETURN), (0xFFFE, Reason.SATURATED), (0, Reason.OUT_OF_RANGE)),
)
LONG = replace(PLAIN, columns=300, sequence_register=7)  # three frames: 124, 124, 52
PERIOD_S = 0.01


class Bank:
    """A `drivers.bus.Bus` with one device, whose registers change when the test says."""

    address = "tcp://192.0.2.1:502"
    quiet_s = 0.0

    def __init__(self, byte_s: float = 0.0) -> None:
        self.inputs: dict[int, int] = {}
        self.holding: dict[int, int] = {}
        self.asked: list[tuple[int, int, int, int]] = []  # function, device, first, count
        self.wrote: list[tuple[int, int, int]] = []
        self.after: Callable[[int], None] = lambda first: None
        self.silent = False
        self.now_s = 100.0
        self._byte_s = byte_s

    def clock(self) -> float:
        return self.now_s

    def pause(self, seconds: float, /) -> None:
        self.now_s += seconds

    def wire_s(self, size: int) -> float:
        return size * self._byte_s

    def framed(self, device_id: int, pdu: bytes) -> bytes:
        raise AssertionError("nothing is recited")

    def read_holding(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        return self._read(3, self.holding, device_id, first, count)

    def read_input(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        return self._read(4, self.inputs, device_id, first, count)

    def write_register(self, device_id: int, register: int, value: int) -> None:
        self.wrote.append((device_id, register, value))
        self.after(-1)
        if self.silent:
            raise NoReply("no answer")

    def read_coils(self, device_id: int, first: int, count: int) -> tuple[bool, ...]:
        raise AssertionError("it has no coils")

    def write_registers(self, device_id: int, first: int, values: Sequence[int]) -> None:
        raise AssertionError("one register is written at a time")

    def write_coil(self, device_id: int, coil: int, value: bool) -> None:  # noqa: FBT001
        raise AssertionError("it has no coils")

    def write_coil_word(self, device_id: int, coil: int, word: int) -> None:
        raise AssertionError("it has no coils")

    def _read(
        self, function: int, words: dict[int, int], device_id: int, first: int, count: int
    ) -> tuple[int, ...]:
        self.now_s += 0.001
        if self.silent:
            raise NoReply("no answer")
        self.asked.append((function, device_id, first, count))
        said = tuple(words.get(register, 0) for register in range(first, first + count))
        self.after(first)
        return said


def device(bank: Bank, layout: Layout = PLAIN, **more: Any) -> RegisterProfiler:
    bus: Bus = bank
    return RegisterProfiler(
        bus, 5, layout, period_s=PERIOD_S, clock=bank.clock, pause=bank.pause, **more
    )


def filled(bank: Bank, layout: Layout, number: int, value: int) -> None:
    """A profile all of whose columns say the same, and its number."""
    bank.inputs |= dict.fromkeys(layout.registers, value)
    if layout.sequence_register is not None:
        bank.inputs[layout.sequence_register] = number


def take(profiler: Profiler, count: int = 1) -> list[Profile]:
    return list(islice(profiler.profiles(0.5), count))


# -- words to points -------------------------------------------------------------------------------


def test_columns_become_points_by_pitch_scale_and_offset() -> None:
    profile = decoded([100, 200, 65_535, 300], PLAIN, frame=9)
    assert profile.points_mm.tolist() == [[-1.0, 51.0], [-0.5, 52.0], [0.5, 53.0]]
    assert profile.counts.tolist() == [[0, 100], [1, 200], [2, 0], [3, 300]]
    assert (profile.frame, len(profile.intensity)) == (9, 0)


def test_each_missing_column_keeps_its_place_and_says_why() -> None:
    profile = decoded([65_535, 65_534, 0, 65_533], PLAIN, frame=0)
    assert profile.reasons.tolist() == [
        Reason.NO_RETURN, Reason.SATURATED, Reason.OUT_OF_RANGE, Reason.MEASURED,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("signed", "order", "words", "values"),
    [
        (False, WordOrder.HIGH_FIRST, [0x0001, 0x86A0, 0, 7], [100_000, 7]),
        (False, WordOrder.LOW_FIRST, [0x86A0, 0x0001, 7, 0], [100_000, 7]),
        (True, WordOrder.HIGH_FIRST, [0xFFFF, 0xFFFE, 0x7FFF, 0xFFFF], [-2, 2_147_483_647]),
        (True, WordOrder.LOW_FIRST, [0xFFFE, 0xFFFF, 0xFFFF, 0x7FFF], [-2, 2_147_483_647]),
    ],
)
def test_two_words_are_one_value_in_either_order_and_sign(signed, order, words, values) -> None:
    layout = replace(
        PLAIN, columns=2, packing=Packing.TWO_WORDS, signed=signed, word_order=order, missing=()
    )
    assert decoded(words, layout, frame=0).counts[:, 1].tolist() == values


def test_one_signed_word_is_negative_from_its_middle_on() -> None:
    layout = replace(PLAIN, signed=True, missing=((-32_768, Reason.NO_RETURN),))
    profile = decoded([0xFFFF, 0x7FFF, 0x8000, 0x8001], layout, frame=0)
    assert profile.counts[:, 1].tolist() == [-1, 32_767, 0, -32_767]
    assert profile.reasons.tolist() == [0, 0, Reason.NO_RETURN, 0]


def test_a_value_that_no_count_holds_is_unknown_unless_it_says_why() -> None:
    layout = replace(
        PLAIN, columns=2, packing=Packing.TWO_WORDS, missing=((0xFFFF_FFFF, Reason.NO_RETURN),)
    )
    profile = decoded([0x8000, 0, 0xFFFF, 0xFFFF], layout, frame=0)
    assert profile.reasons.tolist() == [Reason.UNKNOWN, Reason.NO_RETURN]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"columns": 0}, "columns: 0; write a whole number from 1 to 65536"),
        ({"first_register": 65_533}, "first_register: 4 columns from 65533 on end at 65536"),
        ({"z_mm_per_count": 0.0}, "z_mm_per_count = 0.0; it must be finite and not 0"),
        ({"column_pitch_mm": float("nan")}, "column_pitch_mm = nan; it must be finite"),
        ({"z_offset_mm": float("inf")}, "z_offset_mm = inf; write a finite number"),
        ({"missing": ((70_000, Reason.UNKNOWN),)}, "unknown_value: 70000; write a whole"),
        ({"missing": ((-1, Reason.NO_RETURN),)}, "no_return_value: -1; write"),
        (
            {"missing": ((1, Reason.NO_RETURN), (1, Reason.UNKNOWN))},
            "unknown_value: 1 stands for no_return_value, too",
        ),
        ({"sequence_register": 102}, "sequence_register: 102 holds a column"),
        ({"sequence_register": 65_536}, "sequence_register: 65536; write a whole number"),
    ],
)
def test_an_impossible_layout_is_refused_in_one_line(change, says) -> None:
    with pytest.raises(ValueError, match=re.escape(says)) as refused:
        replace(PLAIN, **change)
    assert "\n" not in str(refused.value)


def test_a_flags_bit_and_a_triggers_value_fit_their_registers() -> None:
    for wrong in (lambda: Flag(0, 16), lambda: Flag(-1, 0), lambda: Trigger(0, 65_536)):
        with pytest.raises(ValueError, match="write a whole number from 0 to"):
            wrong()
    with pytest.raises(ValueError, match="ready_register: 101 holds a column"):
        replace(PLAIN, ready=Flag(101, 0))


# -- reading ---------------------------------------------------------------------------------------


def test_frames_have_at_most_125_words_and_never_part_a_value() -> None:
    bank = Bank()
    layout = replace(LONG, columns=150, packing=Packing.TWO_WORDS)
    assert device(bank, layout).identify().family == "registers"
    read = [(first, count) for _, _, first, count in bank.asked]
    assert read == [(100, 124), (224, 124), (348, 52), (7, 1)]


def test_a_slow_line_gets_shorter_frames_so_that_the_lease_is_renewed_between_them() -> None:
    at_19200 = Bank(byte_s=11 / 19_200)
    device(at_19200, LONG).identify()
    counts = [count for _, _, _, count in at_19200.asked[:-1]]
    assert sum(counts) == 300
    assert max(at_19200.wire_s(13 + 2 * count) for count in counts) <= 0.04
    whole = Bank(byte_s=11 / 19_200)  # which nothing but one frame keeps together
    device(whole, replace(PLAIN, columns=125)).identify()
    assert [count for _, _, _, count in whole.asked] == [125]


@pytest.mark.parametrize(("table", "function"), [(Table.HOLDING, 3), (Table.INPUT, 4)])
def test_the_columns_are_read_by_the_function_of_their_table(table, function) -> None:
    bank = Bank()
    (bank.holding if table is Table.HOLDING else bank.inputs)[103] = 700
    (profile,) = take(device(bank, replace(PLAIN, table=table)))
    assert profile.counts[3, 1] == 700
    assert {(asked[0], asked[1]) for asked in bank.asked} == {(function, 5)}


def test_a_number_that_changes_amid_a_read_is_a_torn_read_counted_and_repeated() -> None:
    bank = Bank()
    filled(bank, LONG, 40, 1000)
    profiler = device(bank, LONG)
    tears = [224, 224]

    def after(first: int) -> None:
        if first == 7 and bank.inputs[7] == 40:
            filled(bank, LONG, 41, 1001)
        elif tears and first == tears[0]:
            tears.pop()
            filled(bank, LONG, bank.inputs[7] + 1, bank.inputs[100] + 1)

    bank.after = after
    (profile,) = take(profiler)
    assert set(profile.counts[:, 1].tolist()) == {1003}
    assert profile.frame == 43
    reads = profiler.reads()
    assert (reads.profiles, reads.torn, reads.skipped) == (1, 2, 2)
    assert profiler.tally() == Tally(profiles=1, lost_profiles=2)


def test_a_device_that_is_always_torn_is_said_to_be_too_fast() -> None:
    bank = Bank()
    filled(bank, LONG, 1, 1)
    bank.after = lambda first: filled(bank, LONG, (bank.inputs[7] + 1) % 65_536, 1)
    with pytest.raises(NoReply, match=r"in 0\.5 s, \d+ torn reads; .*use its trigger"):
        take(device(bank, LONG))


def test_a_read_that_ends_without_an_answer_is_counted_and_begun_anew() -> None:
    bank = Bank()
    filled(bank, LONG, 1, 1)
    profiler = device(bank, LONG)
    with pytest.raises(NoReply):
        take(profiler)
    filled(bank, LONG, 2, 1)
    bank.silent = True
    for _ in range(3):
        with pytest.raises(NoReply, match="no answer"):
            take(profiler)
    bank.silent = False
    assert [profile.frame for profile in take(profiler)] == [2]
    assert profiler.tally() == Tally(profiles=1, bad_frames=3)


def test_every_number_is_told_once_and_over_65535_comes_0() -> None:
    bank = Bank()
    filled(bank, LONG, 65_534, 1)
    profiler = device(bank, LONG)
    with pytest.raises(NoReply):
        take(profiler)  # what was there when it was opened is not new
    frames = []
    for number in (65_535, 0, 3):
        filled(bank, LONG, number, 1)
        frames += [profile.frame for profile in take(profiler)]
    assert frames == [65_535, 0, 3]
    assert profiler.tally() == Tally(profiles=3, lost_profiles=2)


def test_a_wait_that_ends_amid_a_read_loses_nothing_of_it() -> None:
    bank = Bank()
    filled(bank, LONG, 1, 1)
    profiler = device(bank, LONG)
    with pytest.raises(NoReply):
        next(profiler.profiles(0.0))
    filled(bank, LONG, 2, 2)
    waits = 0
    while True:
        try:
            profile = next(profiler.profiles(0.0))
            break
        except NoReply:
            waits += 1
    assert profile.frame == 2
    pieces = [first for _, _, first, _ in bank.asked if first >= 100]
    assert pieces == [100, 224, 348]  # each of them once
    assert waits > len(pieces)


def test_discard_lets_go_of_all_that_was_measured_before() -> None:
    bank = Bank()
    filled(bank, LONG, 1, 1)
    profiler = device(bank, LONG)
    with pytest.raises(NoReply):
        next(profiler.profiles(0.0))
    filled(bank, LONG, 9, 9)
    profiler.discard()
    with pytest.raises(NoReply):
        take(profiler)
    filled(bank, LONG, 10, 10)
    assert [profile.frame for profile in take(profiler)] == [10]
    assert profiler.tally().lost_profiles == 0


def test_without_number_and_trigger_two_periods_go_by_before_a_read_is_believed() -> None:
    bank = Bank()
    profiler = device(bank)
    profiler.discard()
    from_s = bank.now_s
    take(profiler)
    assert bank.now_s - from_s >= 2.0 * PERIOD_S
    assert bank.asked == [(4, 5, 100, 4)]


def test_a_trigger_is_written_once_a_profile_and_its_flag_is_waited_for() -> None:
    bank = Bank()
    layout = replace(PLAIN, columns=200, trigger=Trigger(20, 3), ready=Flag(8, 2))
    polls = 0

    def after(first: int) -> None:
        nonlocal polls
        if first == -1:
            polls, bank.inputs[8] = 0, 0b011
        elif first == 8:
            polls += 1
            if polls == 3:
                filled(bank, layout, 0, len(bank.wrote))
                bank.inputs[8] = 0b111

    bank.after = after
    profiles = take(device(bank, layout), 3)
    assert bank.wrote == [(5, 20, 3)] * 3
    assert [profile.counts[199, 1] for profile in profiles] == [1, 2, 3]


def test_a_trigger_whose_answer_is_lost_is_not_sent_again_until_what_came_is_discarded() -> None:
    bank = Bank()
    layout = replace(PLAIN, trigger=Trigger(20), ready=Flag(8, 0))
    profiler = device(bank, layout)
    bank.silent = True
    for _ in range(3):
        with pytest.raises(NoReply):
            take(profiler)
    assert len(bank.wrote) == 1
    bank.silent, bank.inputs[8] = False, 1
    assert len(take(profiler)) == 1
    assert len(bank.wrote) == 1
    profiler.discard()
    take(profiler)
    assert len(bank.wrote) == 2


@pytest.mark.parametrize(
    ("layout", "says"),
    [
        (replace(PLAIN, columns=126), "nothing tells a torn read; give sequence_register"),
        (replace(PLAIN, trigger=Trigger(3)), "nothing tells when the profile is there"),
    ],
)
def test_what_cannot_be_told_is_refused_before_anything_is_sent(layout, says) -> None:
    bank = Bank()
    with pytest.raises(ValueError, match=says):
        device(bank, layout)
    assert not bank.asked


def test_identify_says_what_the_device_refuses() -> None:
    bank = Bank()

    def after(first: int) -> None:
        if first == 7:
            raise Refused("tcp://192.0.2.1:502: device 5, read 1 input from 0x0007", code=2)

    bank.after = after
    with pytest.raises(Refused, match="0x0007"):
        device(bank, LONG).identify()


# -- Banner EZ-ARRAY -------------------------------------------------------------------------------


def sent_by(layout: Layout) -> bytes:
    """The first frame that is sent to a screen as it leaves the factory."""
    near, far = loopback(wait=lambda _: None)
    bus = ModbusBus(near, timeout_s=0.01, slowest_reply_s=0.0, clock=iter(range(99)).__next__)
    screen = RegisterProfiler(bus, EZ_ARRAY_ID, layout, period_s=0.1)
    with pytest.raises(NoReply):
        screen.identify()
    return far.read(0.0)[:8]


def test_the_screens_measurements_are_asked_for_in_the_frame_of_its_manual() -> None:
    # Banner 130426, its example of function 4: all 25 measurements, from 30500 on.
    assert sent_by(ez_array_measurements(5.0)) == bytes.fromhex("41 04 77 24 00 19 64 BF")
    assert list(EZ_ARRAY_MEASUREMENTS) == list(range(30_500, 30_525))


def test_blocked_channels_are_points_the_lowest_bit_first() -> None:
    screen = ez_array(20, 5.0, first_channel_mm=2.5)
    assert (screen.registers, screen.words) == (range(30_003, 30_005), 2)
    profile = decoded([0b1000_0000_0000_0101, 0b1_0001], screen, frame=0)
    assert profile.points_mm.tolist() == [[2.5, 0.0], [12.5, 0.0], [77.5, 0.0], [82.5, 0.0]]
    clear = np.flatnonzero(profile.reasons == Reason.NO_RETURN)
    assert sorted({*range(20)} - {*clear.tolist()}) == [0, 2, 15, 16]


def test_a_measurement_is_told_in_quarters_of_a_channel() -> None:
    profile = decoded([8, *[0] * 23, 42], ez_array_measurements(5.0), frame=0)
    assert profile.points_mm[0].tolist() == [0.0, 10.0]
    assert profile.points_mm[24].tolist() == [24.0, 52.5]


@pytest.mark.parametrize("channels", [0, 481])
def test_a_screen_has_as_many_channels_as_its_bitmap(channels) -> None:
    with pytest.raises(ValueError, match="hold 1 to 480"):
        ez_array(channels, 5.0)
