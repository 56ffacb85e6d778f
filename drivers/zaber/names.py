"""Zaber's warning flags and reasons of rejection by name, and what an operator can do about them.

The flags are those of `zaber_motion.ascii.WarningFlags` 10.3; the reasons are of the ASCII protocol
manual. Flags rank: F is a fault (the axis stopped or will not move), W a warning, N a note.
"""

from __future__ import annotations

from typing import Final

FLAGS: Final = {
    "FF": "critical system error",
    "FN": "peripheral not supported",
    "FZ": "peripheral inactive",
    "FH": "hardware emergency stop",
    "FV": "supply over- or under-voltage",
    "FO": "driver disabled, no fault",
    "FC": "current inrush",
    "FM": "motor too hot",
    "FD": "driver disabled by a fault",
    "FQ": "encoder error",
    "FI": "index error",
    "FA": "analog encoder sync error",
    "FR": "overdrive limit exceeded",
    "FS": "stalled and stopped",
    "FB": "stream bounds error",
    "FP": "interpolated path deviation",
    "FE": "limit error",
    "FT": "excessive twist",
    "WL": "unexpected limit trigger",
    "WV": "voltage out of range",
    "WT": "controller hot",
    "WS": "stalled, recovered",
    "WM": "displaced while standing",
    "WP": "invalid calibration type",
    "WR": "no reference position",
    "WH": "not homed",
    "NC": "manual control",
    "NI": "movement interrupted",
    "ND": "stream discontinuity",
    "NR": "value rounded",
    "NT": "value truncated",
    "NU": "setting update pending",
    "NJ": "joystick calibrating",
    "NB": "firmware update mode",
}

FLAG_REMEDIES: Final = {
    "FF": "switch its supply off and on",
    "FH": "release the emergency stop, then home",
    "FV": "check the supply",
    "FO": "enable the driver",
    "FD": "check supply and motor, enable the driver, then home",
    "FQ": "check the encoder's cable, then home",
    "FS": "remove what is in its way, then home",
    "FE": "check the limit sensors, then home",
    "FM": "let the motor cool down",
    "NC": "let go of the knob",
}

# A flag after which the count of microsteps is not where the load is, or nobody knows.
UNREFERENCED: Final = frozenset({"WR", "WH", "WS", "WM", "WL"})

REASONS: Final = {
    "AGAIN": "not now, ask again",
    "BADAXIS": "no such axis",
    "BADCOMMAND": "unknown command or setting",
    "BADDATA": "value out of range",
    "BADMESSAGEID": "bad message id",
    "DEVICEONLY": "a command for the whole device",
    "DRIVERDISABLED": "the driver is disabled",
    "FULL": "no room to store it",
    "INACTIVE": "the axis is inactive",
    "LOCKSTEP": "the axis is in a lockstep group",
    "NOACCESS": "no access at this level",
    "NOTSUPPORTED": "not supported in this configuration",
    "PARKED": "the axis is parked",
    "STATUSBUSY": "not while it moves",
}


def flag_name(flag: str) -> str:
    """Flag and name, such as ``FS stalled and stopped``."""
    return f"{flag} {FLAGS.get(flag, 'unknown flag')}"


def flag_remedy(flag: str) -> str:
    """What an operator can do about a flag."""
    return FLAG_REMEDIES.get(flag, "see the device's manual, then home")


def is_fault(flag: str) -> bool:
    """Whether the device counts it as a fault."""
    return flag.startswith("F")


def reason_name(reason: str) -> str:
    """Reason and name, such as ``BADDATA (value out of range)``."""
    return f"{reason} ({REASONS.get(reason, 'a reason unknown to us')})"
