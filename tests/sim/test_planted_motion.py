"""A misreading of Zaber's or Oriental Motor's protocol, planted in the driver, is found out.

As in test_planted_faults: each plant is consistent in itself, and the judge asks the world.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum, IntFlag

import pytest

import drivers.oriental.axis as az_axis
import drivers.oriental.registers as az_registers
import drivers.zaber.settings as zaber_settings
import drivers.zaber.wire as zaber_wire
from drivers.errors import DriverError
from drivers.long_words import value_of, words_of
from drivers.oriental import AzAxis, Turning
from drivers.oriental import Settings as AzSettings
from drivers.zaber import Settings as ZaberSettings
from tests.drivers.motion_cases import AZ, FAMILIES, Bench

Plant = Callable[[pytest.MonkeyPatch], None]
SPEED = math.radians(90.0)
RAMP_S = {"zaber": 0.052, "oriental": 0.1}  # of the devices, from 0 to that speed


def judge(name: str) -> None:
    """Home and turn, over more than a turn and below 0; where, and in what time."""
    bench = Bench(FAMILIES[name])
    axis = bench.driver()
    home = axis.home(bench.pause)
    zero_rad = bench.axis.motor(bench.now_s)
    assert zero_rad == pytest.approx({"zaber": 0.4, "oriental": 0.5}[name], abs=1e-4)
    place = home.position
    for target_rad in (0.7, 8.5, -1.3, 0.0):
        then_s = bench.now_s
        state = axis.move_to(target_rad, bench.pause)
        assert bench.axis.stands(bench.now_s)
        assert bench.axis.motor(bench.now_s) - zero_rad == pytest.approx(target_rad, abs=5e-4)
        assert state.position == pytest.approx(target_rad, abs=5e-4)
        ideal_s = abs(target_rad - place) / SPEED + RAMP_S[name]
        assert ideal_s - 0.01 <= bench.now_s - then_s <= ideal_s + 0.15
        place = target_rad


def judge_nearest() -> None:
    """By the shorter way: ten degrees on from 350 to 0, and each is called what was asked for."""
    bench = Bench(FAMILIES["oriental"])
    wide = replace(
        AZ, turning=Turning.WRAP_PROXIMITY, steps_per_unit=1000.0 / 360.0, tolerance=0.01
    )
    bench._end._units[3]._items[0x390] = 10  # the drive wraps at a turn of its motor
    object.__setattr__(bench._end._units[3].settings, "steps_per_unit", 1000.0 / math.tau)
    table = AzAxis(bench.bus(), 3, wide, clock=bench.clock)
    table.home(bench.pause)
    ways_deg = ((100.0, 100.0), (230.0, 130.0), (350.0, 120.0), (0.0, 10.0), (300.0, -60.0))
    for target_deg, way_deg in ways_deg:
        before_rad = bench.axis.motor(bench.now_s)
        state = table.move_to(math.radians(target_deg), bench.pause)
        turned_deg = math.degrees(bench.axis.motor(bench.now_s) - before_rad)
        assert turned_deg == pytest.approx(way_deg, abs=0.5)
        assert math.degrees(state.position) == pytest.approx(target_deg, abs=0.5)


@pytest.mark.parametrize("name", ["zaber", "oriental"])
def test_without_a_plant_the_judge_is_content(name) -> None:
    judge(name)


def test_without_a_plant_the_judge_of_the_shorter_way_is_content() -> None:
    judge_nearest()


# --- Zaber -----------------------------------------------------------------------------------


def zaber_speed(factor: float) -> Plant:
    return lambda patch: patch.setattr(zaber_settings, "_SPEED", factor)


def zaber_scale(factor: float) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        there, back = ZaberSettings.microsteps, ZaberSettings.position
        patch.setattr(ZaberSettings, "microsteps", lambda it, p: round(factor * there(it, p)))
        patch.setattr(ZaberSettings, "position", lambda it, m: back(it, m / factor))

    return plant


def zaber_idle_for_busy(patch: pytest.MonkeyPatch) -> None:
    right = zaber_wire.parsed

    def exchanged(line: str) -> object:
        found = right(line)
        return replace(found, busy=not found.busy) if isinstance(found, zaber_wire.Reply) else found

    patch.setattr(zaber_wire, "parsed", exchanged)


def zaber_check(patch: pytest.MonkeyPatch) -> None:
    """The sum itself, for its two's complement."""
    patch.setattr(zaber_wire, "check_of", lambda body: sum(body) & 0xFF)


def zaber_check_from_the_first_byte(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(zaber_wire, "check_of", lambda body: -(sum(body) + ord("/")) & 0xFF)


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(zaber_speed(1.0), id="microsteps a second"),
        pytest.param(zaber_speed(1.0 / 1.6384), id="the factor's inverse"),
        pytest.param(zaber_scale(2.0), id="scale"),
        pytest.param(zaber_scale(-1.0), id="sign"),
        pytest.param(zaber_idle_for_busy, id="idle for busy"),
        pytest.param(zaber_check, id="check"),
        pytest.param(zaber_check_from_the_first_byte, id="check from the first byte on"),
    ],
)
def test_a_misreading_of_zaber_is_found_out(plant: Plant, monkeypatch) -> None:
    plant(monkeypatch)
    with pytest.raises((AssertionError, DriverError)):
        judge("zaber")


# --- Oriental Motor AZ -----------------------------------------------------------------------


def az_word_order(patch: pytest.MonkeyPatch) -> None:
    """The low word first, on both ways."""
    there, back = words_of, value_of
    for module in (az_registers, az_axis):
        patch.setattr(module, "words_of", lambda value: there(value)[::-1])
    patch.setattr(az_axis, "value_of", lambda low, high: back(high, low))


def az_unsigned(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(az_axis, "value_of", lambda high, low: high << 16 | low)


def az_register(name: str, address: int) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        addresses = {it.name: it.value for it in az_registers.Register} | {name: address}
        patch.setattr(az_axis, "Register", IntEnum("Register", addresses))

    return plant


def az_output(name: str, bit: int) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        bits = {it.name: it.value for it in az_registers.Output} | {name: 1 << bit}
        patch.setattr(az_axis, "Output", IntFlag("Output", bits))

    return plant


def az_input(name: str, bit: int) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        bits = {it.name: it.value for it in az_registers.Input} | {name: 1 << bit}
        patch.setattr(az_axis, "Input", IntFlag("Input", bits))

    return plant


def az_fields_exchanged(patch: pytest.MonkeyPatch) -> None:
    """Speed before position."""
    right = az_registers.direct_block

    def exchanged(data):
        block = right(data)
        return (*block[:4], *block[6:8], *block[4:6], *block[8:])

    patch.setattr(az_axis, "direct_block", exchanged)


def az_scale(name: str, factor: float) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        right = getattr(AzSettings, name).fget
        patch.setattr(AzSettings, name, property(lambda it: round(factor * right(it))))

    return plant


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(az_word_order, id="word order"),
        pytest.param(az_unsigned, id="signedness"),
        pytest.param(az_register("POSITION", 0x00CC), id="the wrapped position for the count"),
        pytest.param(az_register("POSITION", 0x0124), id="register of the position"),
        pytest.param(az_register("DIRECT_DATA", 0x0060), id="register of the direct data"),
        pytest.param(az_register("OUTPUT", 0x0080), id="register of the outputs"),
        pytest.param(az_input("HOME", 3), id="start for home"),
        pytest.param(az_output("MOVE", 14), id="in position for move"),
        pytest.param(az_output("HOME_END", 6), id="info for the end of homing"),
        pytest.param(az_output("READY", 7), id="alarm for ready"),
        pytest.param(az_fields_exchanged, id="order of the fields"),
        pytest.param(az_scale("speed_hz", 2.0), id="scale of the speed"),
        pytest.param(az_scale("rate", 0.1), id="scale of the ramps"),
    ],
)
def test_a_misreading_of_the_az_is_found_out(plant: Plant, monkeypatch) -> None:
    plant(monkeypatch)
    with pytest.raises((AssertionError, DriverError)):
        judge("oriental")


@pytest.mark.parametrize("other", [1, 2, 8, 10, 11])
def test_another_operation_than_the_shorter_way_is_found_out(other, monkeypatch) -> None:
    right = az_axis.direct_block
    monkeypatch.setattr(
        az_axis, "direct_block", lambda data: (*right(data)[:3], other, *right(data)[4:])
    )
    with pytest.raises((AssertionError, DriverError)):
        judge_nearest()
