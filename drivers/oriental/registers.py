"""The registers of an AZ drive, its alarms, and the block that moves it in one frame.

From public code that drives AZD-KD and AZD-CD (asukiaaa/arduino-OrientalAZ @16b9a45,
ymsk-sky/orientalmotorSerial @bdd0298) and a list of its alarms; the manual HM-60262E itself was not
at hand. Every item is 32 bits, the high word at the even address, both words in one frame::

    0x0058  +0 +1     +2 +3  +4 +5     +6 +7  +8 +9       +10 +11    +12 +13  +14 +15
            data no.  type   position  speed  start rate  stop rate  current  trigger: 1 go, now
                             steps     Hz     Hz a second            0.1 %
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final

from drivers.long_words import words_of


class Register(IntEnum):
    """Holding registers by the address of their high word."""

    DIRECT_DATA = 0x0058
    PULSED_INPUT = 0x0078  # its bits go off by themselves
    OUTPUT = 0x007E
    ALARM = 0x0080
    POSITION = 0x0120  # feedback, counted in 32 bits and not wrapped
    ALARM_RESET = 0x0180
    GEAR_A = 0x0380  # this and the rest from the list of the sister series AR; may be missing
    GEAR_B = 0x0382
    WRAP = 0x038E
    WRAP_RANGE = 0x0390  # in tenths of a turn of the motor's shaft


class Input(IntFlag):
    """What the drive is told by bits."""

    HOME = 1 << 4
    STOP = 1 << 5


class Output(IntFlag):
    """What the drive tells by bits."""

    HOME_END = 1 << 4
    READY = 1 << 5
    ALARM = 1 << 7
    BUSY = 1 << 8
    MOVE = 1 << 13
    IN_POSITION = 1 << 14


class Operation(IntEnum):
    """How a direct data operation understands its position."""

    ABSOLUTE = 1
    RELATIVE = 2  # to the commanded position
    WRAP_ABSOLUTE = 8  # within the turn, never over its border
    WRAP_PROXIMITY = 9  # the shorter way round


STEPS_PER_GEAR: Final = 1000  # of a turn of the motor, times B over A
GO: Final = 1
FULL_CURRENT: Final = 1000

ALARMS: Final = {
    0x10: "excessive position deviation",
    0x20: "over-current",
    0x21: "main circuit too hot",
    0x22: "over-voltage",
    0x23: "main supply off",
    0x25: "under-voltage",
    0x26: "motor too hot",
    0x28: "sensor error",
    0x2A: "no communication with the sensor",
    0x30: "overload",
    0x31: "overspeed",
    0x33: "absolute position lost",
    0x34: "command pulse error",
    0x41: "EEPROM error",
    0x42: "sensor error at power-on",
    0x43: "shaft turning at power-on",
    0x44: "encoder EEPROM error",
    0x45: "motor does not fit the drive",
    0x4A: "move before homing",
    0x51: "regeneration resistor too hot",
    0x53: "HWTO input circuit",
    0x60: "both limit switches active",
    0x61: "limit switches exchanged",
    0x62: "homing failed",
    0x63: "no home switch found",
    0x64: "no TIM, Z or SLIT signal while homing",
    0x66: "hardware overtravel",
    0x67: "software overtravel",
    0x68: "HWTO (safe torque off)",
    0x6A: "limit switch during the homing offset",
    0x6D: "mechanical overtravel",
    0x70: "operation data wrong",
    0x71: "electronic gear wrong",
    0x72: "wrap setting wrong",
    0x81: "network bus",
    0x83: "communication switch wrong",
    0x84: "RS-485 errors",
    0x85: "RS-485 timeout: nobody spoke to the drive",
    0x8E: "network converter",
    0xF0: "CPU",
}
REMEDIES: Final = {
    0x10: "remove what is in its way, clear the alarm, home again",
    0x20: "switch the supply off, check motor and cable",
    0x22: "check the supply, or decelerate more gently",
    0x25: "check the supply",
    0x28: "switch the supply off, check the motor's cable",
    0x2A: "switch the supply off, check the motor's cable",
    0x30: "lighten the load, clear the alarm, home again",
    0x33: "home it",
    0x4A: "home it",
    0x68: "release the safety input, clear the alarm",
    0x70: "check speed and wrap setting",
    0x71: "correct the electronic gear, switch the supply off and on",
    0x72: "correct the wrap range, switch the supply off and on",
    0x85: "check the cable, clear the alarm, home again",
}


def alarm_name(code: int) -> str:
    """Code and name of an alarm, such as ``0x10 excessive position deviation``."""
    return f"0x{code:02X} {ALARMS.get(code, 'unknown alarm')}"


def alarm_remedy(code: int) -> str:
    """What an operator can do about an alarm."""
    return REMEDIES.get(code, "remove the cause, clear the alarm, home again")


@dataclass(frozen=True, slots=True)
class DirectData:
    """One direct data operation, in the drive's own units."""

    operation: Operation
    position: int  # steps
    speed_hz: int  # steps a second
    start_rate: int  # 0.001 kHz a second, which is steps a second squared
    stop_rate: int
    current: int = FULL_CURRENT  # 0.1 %
    data_number: int = 0


def direct_block(data: DirectData) -> tuple[int, ...]:
    """Sixteen words for 0x0058 that start the operation when they arrive, all or nothing."""
    items = (
        data.data_number,
        data.operation,
        data.position,
        data.speed_hz,
        data.start_rate,
        data.stop_rate,
        data.current,
        GO,
    )
    return tuple(word for each in items for word in words_of(each))
