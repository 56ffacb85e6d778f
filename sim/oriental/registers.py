"""The AZ drive's registers, written down again from public lists of them.

Every item is two words, the high one at the even address, and is read and written whole. What is
not in the list has no address.
"""

from __future__ import annotations

from collections.abc import Mapping

# direct data operation: eight items in a row from here, the last one starts it
DATA_NUMBER, DATA_TYPE, DATA_POSITION, DATA_SPEED = 0x58, 0x5A, 0x5C, 0x5E
DATA_START_RATE, DATA_STOP_RATE, DATA_CURRENT, DATA_TRIGGER = 0x60, 0x62, 0x64, 0x66
INPUTS_PULSED, INPUTS = 0x78, 0x7C
OUTPUTS, PRESENT_ALARM = 0x7E, 0x80
HISTORY = range(0x82, 0x96, 2)
FEEDBACK, FEEDBACK_SPEED = 0xCC, 0xCE
DRIVER_TEMPERATURE, MOTOR_TEMPERATURE = 0xF8, 0xFA
FEEDBACK_COUNT, COMMAND_COUNT = 0x120, 0x122
RESET_ALARM, CLEAR_HISTORY, PRESET = 0x180, 0x184, 0x18A
GEAR_A, GEAR_B, WRAP, WRAP_TENTHS = 0x380, 0x382, 0x38E, 0x390

STORED: Mapping[int, int] = {
    DATA_NUMBER: 0, DATA_TYPE: 2, DATA_POSITION: 0, DATA_SPEED: 1000, DATA_START_RATE: 1_000_000,
    DATA_STOP_RATE: 1_000_000, DATA_CURRENT: 1000, DATA_TRIGGER: 0,
    INPUTS_PULSED: 0, INPUTS: 0, RESET_ALARM: 0, CLEAR_HISTORY: 0, PRESET: 0,
    GEAR_A: 1, GEAR_B: 1, WRAP: 1, WRAP_TENTHS: 10,
}  # fmt: skip
TOLD = frozenset(
    {OUTPUTS, PRESENT_ALARM, *HISTORY, FEEDBACK, FEEDBACK_SPEED, DRIVER_TEMPERATURE,
     MOTOR_TEMPERATURE, FEEDBACK_COUNT, COMMAND_COUNT}
)  # fmt: skip

BIT_HOME, BIT_STOP, BIT_FREE, BIT_RESET = 0x10, 0x20, 0x40, 0x80
OUT_HOME_END, OUT_READY, OUT_ALARM, OUT_MOVE, OUT_IN_POSITION = 0x10, 0x20, 0x80, 0x2000, 0x4000

DEVIATION, NOT_HOMED, HOMING_FAILED, BAD_DATA = 0x10, 0x4A, 0x62, 0x70


def joined(high: int, low: int) -> int:
    """A signed number of its words."""
    return int.from_bytes(bytes((high >> 8, high & 255, low >> 8, low & 255)), "big", signed=True)


def halves(value: int) -> tuple[int, int]:
    """High and low word."""
    data = (value & 0xFFFF_FFFF).to_bytes(4, "big")
    return int.from_bytes(data[:2], "big"), int.from_bytes(data[2:], "big")
