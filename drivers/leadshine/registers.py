"""The registers of a Leadshine PR drive, and the blocks of them that are written as one frame.

From the CS2RS manual (pages 24, 26, 32, 50, 59) and the iEM-RS manual (pages 18, 25, 26); EM2RS,
DM556RS and StepperOnline's CL57RS have the same map. A parameter is 32 bits wide, high word at the
even address; where the high word is always 0 only the odd address is used.

    0x6200   +0     +1 +2      +3    +4    +5    +6     +7
    path 0   mode   position   rpm   acc   dec   dwell  0x0010: go, now
                    hi lo            ms per 1000 rpm    (maps to 0x6002)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag
from types import MappingProxyType

from drivers.long_words import words_of

_WORD = 0x10000
_SPEED_MAX_RPM = 0x7FFF  # the speed word is signed


class Register(IntEnum):
    """Holding registers by their protocol address."""

    PULSES_PER_REV = 0x0001
    LOOP_MODE = 0x0003
    DIRECTION = 0x0007
    INPUTS = 0x0179  # bit 0 is SI1
    VERSION = 0x01FF  # this and the next from public code, not from a manual
    FIRMWARE = 0x0201
    STATUS = 0x1003
    CONTROL_WORD = 0x1801
    ALARM = 0x2203
    PATHS = 0x6000  # what holds for every path; bit 1: the soft limits
    TRIGGER = 0x6002
    SOFT_LIMITS = 0x6006  # four words: upper, lower
    HOMING = 0x600A  # nine words or eleven, see `homing_block`
    MOTOR_POSITION = 0x602C  # and 0x602D, signed, high word first
    PATH_0 = 0x6200  # eight words, see `path_block`


class Status(IntFlag):
    """The bits of 0x1003. PATH_COMPLETE and HOMED keep their old 1 until the next start."""

    FAULT = 0x01
    ENABLED = 0x02
    RUNNING = 0x04
    COMMAND_COMPLETE = 0x10
    PATH_COMPLETE = 0x20
    HOMED = 0x40


class Trigger(IntEnum):
    """What 0x6002 understands."""

    START_PATH_0 = 0x010
    HOME = 0x020
    STOP = 0x040


class PathMode(IntEnum):
    """What a path does."""

    ABSOLUTE = 0x0001
    RELATIVE = 0x0041
    VELOCITY = 0x0002


class HomingMethod(IntEnum):
    """What the drive looks for: bits 2, 3 and 5 of 0x600A."""

    LIMIT_SWITCH = 0x00
    HOME_SWITCH = 0x04
    INDEX_PULSE = 0x08
    TORQUE = 0x0C
    HERE = 0x20  # nothing: where it stands is the reference


class HomingSense(IntEnum):
    """Which way it looks first: bit 0 of 0x600A."""

    NEGATIVE = 0
    POSITIVE = 1


class LoopMode(IntEnum):
    """What 0x0003 reads: in open loop the position read back is the commanded one."""

    OPEN = 0
    CLOSED = 2


LIMITED = 0x0002  # of 0x6000
RESET_ALARM = 0x1111  # to the control word
DAMAGED_REQUEST = 0x08  # this drive's own exception: the checksum of our request was wrong


class Model(Enum):
    """Which table of alarms the drive has: the same cause has other codes in another family."""

    EM = "EM2RS/iEM-RS"
    CS2RS = "CS2RS"


# EM: iEM-RS manual page 26, which was read up to its second row; CS2RS: public code that drives it.
ALARMS: Mapping[Model, Mapping[int, str]] = MappingProxyType(
    {
        Model.EM: MappingProxyType({0x01: "over-current", 0x02: "over-voltage"}),
        Model.CS2RS: MappingProxyType(
            {
                0x0A1: "current sampling fault",
                0x0C0: "over-voltage",
                0x0E0: "over-current",
                0x0F0: "over-temperature",
                0x150: "encoder disconnected",
                0x152: "shaft locking failed, a motor phase is open",
                0x180: "following error",
                0x210: "two inputs have the same function",
                0x240: "EEPROM fault",
                0x5F0: "auto-tuning failed",
            }
        ),
    }
)


# What an operator can do; by the name, which is one for both tables.
REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "over-current": "switch it off, check motor and cable for a short",
        "over-voltage": "check the supply, or decelerate more gently",
        "over-temperature": "let it cool down",
        "encoder disconnected": "switch it off, check the encoder's cable",
        "shaft locking failed, a motor phase is open": "switch it off, check the motor's cable",
        "following error": "remove what is in its way",
        "two inputs have the same function": "correct what its inputs mean, 0x0145 to 0x0151",
        "EEPROM fault": "restore its factory settings",
    }
)


def alarm_remedy(model: Model, code: int) -> str:
    """What an operator can do about an alarm."""
    return REMEDIES.get(ALARMS[model].get(code, ""), "remove the cause")


def alarm_name(model: Model, code: int) -> str:
    """Code and name of an alarm, such as ``0x0E0 over-current``."""
    return f"0x{code:03X} {ALARMS[model].get(code, f'not in the table of {model.value}')}"


@dataclass(frozen=True, slots=True)
class Path:
    """One path of the drive, in the drive's own units."""

    mode: PathMode
    position_counts: int
    speed_rpm: int
    acceleration_ms: int  # for 1000 rpm
    deceleration_ms: int


def path_block(path: Path) -> tuple[int, ...]:
    """Eight words for path 0 that start it when they arrive, in one frame, all or nothing.

    Raises
    ------
    ValueError
        A number does not fit its register.
    """
    return (
        path.mode,
        *words_of(path.position_counts),
        _within(path.speed_rpm, _SPEED_MAX_RPM, "speed_rpm"),
        _within(path.acceleration_ms, _WORD - 1, "acceleration_ms"),
        _within(path.deceleration_ms, _WORD - 1, "deceleration_ms"),
        0,
        Trigger.START_PATH_0,
    )


@dataclass(frozen=True, slots=True)
class HomeSearch:
    """How the drive looks for its reference, in the drive's own units."""

    method: HomingMethod
    sense: HomingSense
    reference_counts: int  # what the position is called where the reference is
    fast_rpm: int
    slow_rpm: int
    acceleration_ms: int
    deceleration_ms: int
    torque_ms: int = 100  # against a stop: so long at
    torque_percent: int = 50  # so much of its current


def homing_block(search: HomeSearch) -> tuple[int, ...]:
    """Nine words for 0x600A..0x6012; starts nothing. ValueError where one does not fit.

    Against a stop it is eleven, with time and current of 0x6013 and 0x6014.

    The stop position (third pair) is written too, because it lies between; without bit 1 of the
    mode the drive does not go there.
    """
    reference = words_of(search.reference_counts)
    torque: tuple[int, ...] = ()
    if search.method is HomingMethod.TORQUE:
        torque = (
            _within(search.torque_ms, _WORD - 1, "torque_ms"),
            _within(search.torque_percent, 100, "torque_percent"),
        )
    return (
        search.method | search.sense,
        *reference,
        *reference,
        _within(search.fast_rpm, _SPEED_MAX_RPM, "fast_rpm"),
        _within(search.slow_rpm, _SPEED_MAX_RPM, "slow_rpm"),
        _within(search.acceleration_ms, _WORD - 1, "acceleration_ms"),
        _within(search.deceleration_ms, _WORD - 1, "deceleration_ms"),
        *torque,
    )


@dataclass(slots=True)
class Watch:
    """Decides from the status words since a start whether what was started is over."""

    done: Status  # the bit that says so: PATH_COMPLETE or HOMED
    settle_s: float
    stood_since_s: float
    started: bool = False  # the bit was seen to drop, or the drive was seen running

    def over(self, status: Status, now_s: float) -> bool:
        """Whether the drive stands and is done, or has stood for `settle_s`."""
        if Status.RUNNING in status:
            self.started = True
            self.stood_since_s = now_s
            return False
        self.started |= self.done not in status
        finished = self.started and self.done in status
        return finished or now_s - self.stood_since_s >= self.settle_s


def _within(value: int, limit: int, name: str) -> int:
    if not 0 <= value <= limit:
        raise ValueError(f"{name} {value} is outside 0 to {limit}")
    return value
