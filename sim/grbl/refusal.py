"""What the firmware says no with: `error:N` to a line, `ALARM:N` to everything."""

from __future__ import annotations

from enum import IntEnum


class Error(IntEnum):
    """Numbers of `error:N`."""

    LETTER_EXPECTED = 1
    BAD_NUMBER = 2
    INVALID_STATEMENT = 3
    NEGATIVE_VALUE = 4
    HOMING_DISABLED = 5
    STEP_PULSE_TOO_SHORT = 6
    NOT_IDLE = 8
    LOCKED = 9
    SOFT_LIMITS_NEED_HOMING = 10
    LINE_TOO_LONG = 11
    TRAVEL_EXCEEDED = 15
    INVALID_JOG = 16
    UNSUPPORTED = 20
    MODAL_GROUP_TWICE = 21
    NO_FEED_RATE = 22
    NOT_AN_INTEGER = 23
    AXIS_COMMANDS_CONFLICT = 24
    WORD_REPEATED = 25
    NO_AXIS_WORDS = 26
    LINE_NUMBER_TOO_HIGH = 27
    VALUE_MISSING = 28
    NO_SUCH_COORDINATES = 29
    G53_NEEDS_G0_OR_G1 = 30
    AXIS_WORDS_IN_G80 = 31
    UNUSED_WORDS = 36
    TOOL_TOO_HIGH = 38


class Alarm(IntEnum):
    """Numbers of `ALARM:N`."""

    HARD_LIMIT = 1
    SOFT_LIMIT = 2
    RESET_IN_MOTION = 3
    HOMING_RESET = 6
    PULL_OFF_FAILED = 8
    SWITCH_NOT_FOUND = 9


CRITICAL = frozenset({Alarm.HARD_LIMIT, Alarm.SOFT_LIMIT})  # nothing but a reset is heard


class Refusal(Exception):  # noqa: N818 (an answer, no fault of the program)
    """A line is answered `error:N`."""

    def __init__(self, error: Error) -> None:
        super().__init__(f"error:{error.value}")
        self.error = error


class Alarmed(Exception):  # noqa: N818
    """What the board was doing ends in an alarm."""

    def __init__(self, alarm: Alarm) -> None:
        super().__init__(f"ALARM:{alarm.value}")
        self.alarm = alarm
