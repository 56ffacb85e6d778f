"""A misreading of a manual, planted in a driver, is found out by the simulator.

Each plant is consistent in itself: the driver writes and reads back with the same mistake, so that
only somebody who knows where the axis is, or what the laser does, can tell. The judges are those
that pass without a plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum, IntFlag

import numpy as np
import pytest

import drivers.baumer_ox.profiler as ox_module
import drivers.leadshine.axis as stage_module
import drivers.leadshine.registers as stage_registers
import drivers.relay.laser as relay_module
from drivers.baumer_ox.encoding import POINTS, Content
from drivers.errors import DriverError
from drivers.grbl import GrblAxis
from drivers.grbl import Settings as GrblDriverSettings
from drivers.leadshine import StageSettings
from drivers.long_words import value_of, words_of
from drivers.relay import Coil, OutputBit
from tests.sim.judges import judge_profiler, judge_relay, judge_stage, judge_table

Plant = Callable[[pytest.MonkeyPatch], None]


@pytest.mark.parametrize("judge", [judge_stage, judge_relay, judge_table, judge_profiler])
def test_without_a_plant_the_judge_is_content(judge):
    judge()


def test_the_relay_is_judged_alike_by_coil_and_by_register():
    judge_relay(OutputBit(2))


def stage_scale(patch: pytest.MonkeyPatch) -> None:
    """Pulses of half a turn."""
    patch.setattr(
        StageSettings, "steps_per_mm", property(lambda it: 2.0 * it.pulses_per_rev / it.lead_mm)
    )


def stage_speed_scale(patch: pytest.MonkeyPatch) -> None:
    """Half revolutions a minute."""
    right = StageSettings.rpm
    patch.setattr(StageSettings, "rpm", lambda it, speed_mm_s: 2 * right(it, speed_mm_s))


def stage_sign(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(
        StageSettings, "steps_per_mm", property(lambda it: -it.pulses_per_rev / it.lead_mm)
    )


def stage_unsigned(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(stage_module, "value_of", lambda high, low: high << 16 | low)


def stage_word_order(patch: pytest.MonkeyPatch) -> None:
    """The low word first, on both ways."""
    right = words_of, value_of
    patch.setattr(stage_registers, "words_of", lambda value: right[0](value)[::-1])
    patch.setattr(stage_module, "value_of", lambda low, high: right[1](high, low))


def stage_register(name: str, address: int) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        addresses = {it.name: it.value for it in stage_registers.Register} | {name: address}
        patch.setattr(stage_module, "Register", IntEnum("Register", addresses))

    return plant


def stage_bit(name: str, bit: int) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        bits = {it.name: it.value for it in stage_registers.Status} | {name: bit}
        status = IntFlag("Status", bits)
        patch.setattr(stage_module, "Status", status)
        patch.setattr(stage_registers, "Status", status)

    return plant


def stage_ramps_one_on(patch: pytest.MonkeyPatch) -> None:
    """Acceleration and deceleration at +5 and +6, as one public program has them."""
    right = stage_registers.path_block

    def shifted(path):
        block = right(path)
        return (*block[:4], 0, *block[4:6], block[7])

    patch.setattr(stage_module, "path_block", shifted)


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(stage_scale, id="scale"),
        pytest.param(stage_speed_scale, id="scale of the speed"),
        pytest.param(stage_sign, id="sign"),
        pytest.param(stage_unsigned, id="signedness"),
        pytest.param(stage_word_order, id="word order"),
        pytest.param(stage_register("MOTOR_POSITION", 0x602E), id="register of the position"),
        pytest.param(stage_register("MOTOR_POSITION", 0x1044), id="speed read as position"),
        pytest.param(stage_register("PATH_0", 0x6208), id="register of the path"),
        pytest.param(stage_register("HOMING", 0x600B), id="register of the homing"),
        pytest.param(stage_register("TRIGGER", 0x6003), id="register of the trigger"),
        pytest.param(stage_ramps_one_on, id="registers of the ramps"),
        pytest.param(stage_bit("PATH_COMPLETE", 0x10), id="command complete for path complete"),
        pytest.param(stage_bit("HOMED", 0x20), id="path complete for homed"),
        pytest.param(stage_bit("RUNNING", 0x08), id="an unused bit for running"),
    ],
)
def test_a_misreading_of_the_stage_is_found_out(plant: Plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises((AssertionError, DriverError)):
        judge_stage()


def relay_hundredths(patch: pytest.MonkeyPatch) -> None:
    """The watchdog counts in 10 ms."""
    patch.setattr(relay_module, "watchdog_word", lambda watchdog_s: round(watchdog_s * 100.0))


def relay_thousands(patch: pytest.MonkeyPatch) -> None:
    """The watchdog counts in 10 us."""
    patch.setattr(relay_module, "watchdog_word", lambda watchdog_s: round(watchdog_s * 1e5))


def relay_register(patch: pytest.MonkeyPatch) -> None:
    """The word beside the watchdog's that can be written, too, and read back."""
    addresses = {it.name: it.value for it in relay_module.Register} | {"WATCHDOG_MS": 0x1131}
    patch.setattr(relay_module, "Register", IntEnum("Register", addresses))


def relay_sense(patch: pytest.MonkeyPatch) -> None:
    """Normally closed: written and read the other way round."""
    write, read = Coil.write, Coil.is_closed
    patch.setattr(Coil, "write", lambda it, bus, d, *, closed: write(it, bus, d, closed=not closed))
    patch.setattr(Coil, "is_closed", lambda it, bus, d: not read(it, bus, d))


@pytest.mark.parametrize("plant", [relay_hundredths, relay_thousands, relay_register, relay_sense])
def test_a_misreading_of_the_relay_is_found_out(plant: Plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises((AssertionError, DriverError)):
        judge_relay()


@pytest.mark.parametrize(
    "output", [Coil(3), Coil(1), OutputBit(10), OutputBit(2, register=0x0801)], ids=repr
)
def test_another_output_is_found_out(output):
    with pytest.raises((AssertionError, DriverError)):
        judge_relay(output)


def table_wire_unit(unit_of_a_radian: float) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        patch.setattr(GrblDriverSettings, "to_wire", lambda _, place: place * unit_of_a_radian)
        patch.setattr(GrblDriverSettings, "from_wire", lambda _, value: value / unit_of_a_radian)
        # The driver's own doubts about such a scale are silenced: the simulator is to find it.
        patch.setattr(GrblDriverSettings, "check_steps", lambda *_, **__: None)
        patch.setattr(GrblAxis, "_tolerance", lambda _: 0.05)
        patch.setattr(GrblAxis, "_feed_per_min", lambda *_: 5400.0)

    return plant


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(table_wire_unit(1.0), id="radians"),
        pytest.param(table_wire_unit(200.0 / math.pi), id="gradians"),
        pytest.param(table_wire_unit(-180.0 / math.pi), id="sign"),
    ],
)
def test_a_misreading_of_the_table_is_found_out(plant: Plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises((AssertionError, DriverError)):
        judge_table()


def ox_z_scale(patch: pytest.MonkeyPatch) -> None:
    """The scales of x and z exchanged."""
    right = ox_module.profile_of

    def exchanged(message, settings):
        profile = right(message, settings)
        object.__setattr__(profile, "scale_mm", profile.scale_mm[::-1])
        return profile

    patch.setattr(ox_module, "profile_of", exchanged)


def ox_signed_z(patch: pytest.MonkeyPatch) -> None:
    right = ox_module.profile_of

    def signed(message, settings):
        profile = right(message, settings)
        counts = profile.counts.copy()
        counts[:, 1] = counts[:, 1].astype(np.int16)
        object.__setattr__(profile, "counts", counts)
        return profile

    patch.setattr(ox_module, "profile_of", signed)


def ox_unsigned_x(patch: pytest.MonkeyPatch) -> None:
    """As the manual has it."""
    right = ox_module.profile_of

    def unsigned(message, settings):
        profile = right(message, settings)
        counts = profile.counts.copy()
        counts[:, 0] = counts[:, 0].astype(np.uint16)
        object.__setattr__(profile, "counts", counts)
        return profile

    patch.setattr(ox_module, "profile_of", unsigned)


def ox_fields_exchanged(patch: pytest.MonkeyPatch) -> None:
    """Intensity before z."""
    layout = np.dtype([("x", "<i2"), ("intensity", "<u2"), ("z", "<u2")])
    patch.setitem(POINTS, Content.Z_AND_INTENSITY, layout)


@pytest.mark.parametrize("plant", [ox_z_scale, ox_signed_z, ox_unsigned_x, ox_fields_exchanged])
def test_a_misreading_of_the_profiler_is_found_out(plant: Plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises((AssertionError, DriverError)):
        judge_profiler()
