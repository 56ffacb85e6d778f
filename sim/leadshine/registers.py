"""The drive's registers, as its manual numbers them, and what may be written to each.

After the manuals of CS2RS (1864840, 2419962, CS2RS-D503), iEM-RS (1864935), StepperOnline CL57RS
(identical to CS2RS) and RS485 (identical to EM2RS). Two kinds::

    below 0x1000   a parameter is 32 bits: high word at the even address, low at the odd one
    from 0x6000    16-bit words; positions are two of them, the high word first

The CS2RS closes the loop over an encoder; the EM2RS does not, has no register for it, and so cannot
tell that its motor was held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum

from sim.device import ModbusRefusal

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, BAD_CRC = 1, 2, 3, 8

PULSES_PER_TURN = 0x0001
LOOP_MODE = 0x0003
DIRECTION = 0x0007
FORCED_ENABLE = 0x000F
INPUT_FUNCTIONS = range(0x0145, 0x0153, 2)
JOG_RPM = 0x01E1
JOG_MS_PER_1000_RPM = 0x01E7
VERSION = 0x01FF
FIRMWARE = 0x0201

MOTION_STATUS = 0x1003
FEEDBACK_POSITION = 0x1014
PROFILE_RPM = 0x1044
FEEDBACK_RPM = 0x1046
CONTROL_WORD = 0x1801
SAVE_STATUS = 0x1901
CURRENT_ALARM = 0x2203

PATH_GLOBAL = 0x6000
PATH_CONTROL = 0x6002
UPPER_LIMIT = 0x6006
LOWER_LIMIT = 0x6008
HOMING_MODE = 0x600A
HOME_POSITION = 0x600B
HOME_STOP_POSITION = 0x600D
HOMING_FAST_RPM = 0x600F
HOMING_SLOW_RPM = 0x6010
HOMING_MS_PER_1000_RPM = 0x6011
COMMAND_POSITION = 0x602A
MOTOR_POSITION = 0x602C
PATHS = 0x6200
WORDS_A_PATH = 8
NUMBER_OF_PATHS = 16
PATH_0_TRIGGER = PATHS + 7  # mapped to `PATH_CONTROL`

ENABLE_IF_CLOSED, ENABLE_IF_OPEN = 0x08, 0x88  # functions of an input; nothing is wired to it


class Family(Enum):
    """The family a drive is of."""

    CS2RS = "CS2RS"
    EM2RS = "EM2RS"


class Alarm(Enum):
    """What a drive can complain of."""

    OVER_CURRENT = "over current"
    OVER_VOLTAGE = "over voltage"
    FOLLOWING_ERROR = "position following error"
    ENCODER = "encoder"


ALARM_CODES: Mapping[Family, Mapping[Alarm, int]] = {
    Family.CS2RS: {
        Alarm.OVER_CURRENT: 0x0E0,
        Alarm.OVER_VOLTAGE: 0x0C0,
        Alarm.FOLLOWING_ERROR: 0x180,
        Alarm.ENCODER: 0x150,
    },
    Family.EM2RS: {Alarm.OVER_CURRENT: 0x01, Alarm.OVER_VOLTAGE: 0x02},
}

_WORD = (0, 0xFFFF)
_ANY = (0, *_WORD)
_RPM = (-5000, 5000)
_RAMP_MS = (0, 32767)

# low address: default, least, most
_PARAMETERS: Mapping[int, tuple[int, int, int]] = {
    PULSES_PER_TURN: (10000, 200, 51200),
    0x0005: (1, 0, 10),  # control mode source
    DIRECTION: (0, 0, 1),
    0x0009: (1499, 0, 10000),  # motor inductance, uH
    FORCED_ENABLE: (0, 0, 1),
    0x00A1: (15, 0, 512),  # command filter, 0.1 ms
    **dict.fromkeys(INPUT_FUNCTIONS, _ANY),
    INPUT_FUNCTIONS[0]: (ENABLE_IF_OPEN, *_WORD),
    **dict.fromkeys((0x0157, 0x0159, 0x015B), _ANY),  # functions of outputs
    0x0191: (10, 0, 70),  # peak current, 0.1 A
    0x01BD: (2, 0, 6),  # baud rate
    0x01BF: (1, 0, 31),  # id
    0x01C1: (4, 0, 11),  # character format
    JOG_RPM: (60, 0, 5000),
    JOG_MS_PER_1000_RPM: (200, *_RAMP_MS),
    VERSION: (0x0102, *_WORD),
    FIRMWARE: (0x0105, *_WORD),
}
_INDICATORS = (0x0179, 0x017B)  # inputs and outputs, as they stand

_WORDS: Mapping[int, tuple[int, int, int]] = {
    PATH_GLOBAL: (0, 0, 0x1F),
    0x6001: _ANY,
    **dict.fromkeys(range(0x6003, 0x600A), _ANY),
    HOMING_MODE: (0, 0, 0x1FF),
    **dict.fromkeys(range(HOME_POSITION, HOMING_FAST_RPM), _ANY),
    HOMING_FAST_RPM: (200, 0, 5000),
    HOMING_SLOW_RPM: (50, 0, 5000),
    HOMING_MS_PER_1000_RPM: (100, *_RAMP_MS),
    0x6012: (100, *_RAMP_MS),
    0x6013: (100, *_WORD),  # torque homing: ms
    0x6014: (100, *_WORD),  # torque homing: % of the current
}
_A_PATH = (
    _ANY,  # mode
    _ANY,
    _ANY,  # position
    (60, *_RPM),
    (100, *_RAMP_MS),
    (100, *_RAMP_MS),
    (0, 0, 32767),  # dwell, ms
    _ANY,  # special
)
_TRIGGERS = {0, *range(0x10, 0x10 + NUMBER_OF_PATHS), 0x20, 0x21, 0x40}
_LIVE = {
    MOTION_STATUS, SAVE_STATUS, CURRENT_ALARM, *_INDICATORS, *(a - 1 for a in _INDICATORS),
    *range(FEEDBACK_POSITION, FEEDBACK_POSITION + 2), *range(PROFILE_RPM, FEEDBACK_RPM + 2),
    *range(COMMAND_POSITION, MOTOR_POSITION + 2),
}  # fmt: skip
_READ_ONLY = {*_LIVE, VERSION - 1, VERSION, FIRMWARE - 1, FIRMWARE}


class RegisterBank:
    """What is stored, by address; live registers are the drive's to tell."""

    def __init__(self, family: Family, replaced: Mapping[int, int]) -> None:
        self._allowed = _allowed(family)
        self._words = {address: default & 0xFFFF for address, (default, _, _) in _WORDS.items()}
        for low in (low for low in self._allowed if low < MOTION_STATUS):
            self._words[low - 1] = 0
        self._words.update({address: rule[0] & 0xFFFF for address, rule in self._allowed.items()})
        self._words.update(dict.fromkeys((CONTROL_WORD, PATH_CONTROL), 0))
        self._words.update(replaced)

    def word(self, address: int) -> int:
        """One stored word, unsigned."""
        return self._words[address]

    def words(self, first: int, count: int, live: Mapping[int, int]) -> list[int]:
        """Some words in a row, the live ones as given."""
        told = {**self._words, **dict.fromkeys(_LIVE, 0), **live}
        try:
            return [told[address] for address in range(first, first + count)]
        except KeyError as unknown:
            raise ModbusRefusal(ILLEGAL_ADDRESS) from unknown

    def store(self, first: int, words: Sequence[int]) -> None:
        """Store some words in a row, all or none of them."""
        written = dict(enumerate(words, first))
        for address in written:
            if address not in self._words or address in _READ_ONLY:
                raise ModbusRefusal(ILLEGAL_ADDRESS)
        after = {**self._words, **written}
        for address in written:
            self._check(address, after)
        self._words = after

    def copy(self) -> dict[int, int]:
        """Everything stored, as a save to EEPROM keeps it."""
        return dict(self._words)

    def _check(self, address: int, words: Mapping[int, int]) -> None:
        if address in (PATH_CONTROL, PATH_0_TRIGGER):
            if words[address] not in _TRIGGERS:
                raise ModbusRefusal(ILLEGAL_VALUE)
        elif address < MOTION_STATUS:
            low = address | 1
            _, least, most = self._allowed[low]
            if not least <= joined(words[low - 1], words[low]) <= most:
                raise ModbusRefusal(ILLEGAL_VALUE)
        elif address in self._allowed:
            _, least, most = self._allowed[address]
            value = signed16(words[address]) if least < 0 else words[address]
            if not least <= value <= most:
                raise ModbusRefusal(ILLEGAL_VALUE)


def joined(high: int, low: int) -> int:
    """A signed 32-bit value of its words."""
    value = high << 16 | low
    return value - (1 << 32) if value >> 31 else value


def split(value: int) -> tuple[int, int]:
    """High and low word of a signed 32-bit value; more bits than that are lost, as in a counter."""
    return value >> 16 & 0xFFFF, value & 0xFFFF


def signed16(word: int) -> int:
    """A word as a signed value."""
    return word - (1 << 16) if word >> 15 else word


def _allowed(family: Family) -> dict[int, tuple[int, int, int]]:
    allowed = {**_PARAMETERS, **_WORDS}
    if family is Family.CS2RS:
        allowed[LOOP_MODE] = (2, 0, 2)
    for path in range(NUMBER_OF_PATHS):
        for offset, rule in enumerate(_A_PATH):
            allowed[PATHS + WORDS_A_PATH * path + offset] = rule
    return allowed
