"""Names of the errors and alarms of Grbl 1.1h and grblHAL, and what an operator can do about them.

Below them those that grblHAL adds (errors.h and alarms.h of grblHAL/core @8689918) as far as an
axis meets them. What stands in none of these tables `messages` calls unknown.
"""

from __future__ import annotations

from typing import Final

# doc/csv/error_codes_en_US.csv of gnea/grbl, shortened.
ERRORS: Final = {
    1: "expected command letter",
    2: "bad number format",
    3: "'$' command not recognised",
    4: "negative value",
    5: "homing is not enabled",
    6: "step pulse below 3 us",
    7: "EEPROM read failed, defaults restored",
    8: "not idle",
    9: "locked by an alarm or a jog",
    10: "soft limits need homing enabled",
    11: "line too long",
    12: "step rate above the maximum",
    13: "safety door open",
    14: "stored line too long",
    15: "jog target exceeds travel",
    16: "invalid jog command",
    17: "laser mode needs PWM output",
    20: "unsupported command",
    21: "two commands of one modal group",
    22: "undefined feed rate",
    23: "command needs an integer",
    24: "two commands use axis words",
    25: "repeated word",
    26: "no axis words",
    27: "invalid line number",
    28: "missing value word",
    29: "G59.x not supported",
    30: "G53 only with G0 and G1",
    31: "axis words without a command",
    32: "arc without in-plane axis words",
    33: "invalid motion target",
    34: "invalid arc radius",
    35: "arc without in-plane offsets",
    36: "unused value words",
    37: "tool offset on the wrong axis",
    38: "tool number too large",
    # grblHAL's own
    18: "reset asserted",
    19: "value must be above zero",
    39: "value out of range",
    43: "feed rate above the maximum",
    45: "limit switch engaged",
    46: "homing required",
    50: "emergency stop",
    51: "motor fault",
    52: "setting out of range",
    53: "setting not available",
    55: "homing configuration not possible",
    79: "not while a critical event is active",
}

# doc/csv/alarm_codes_en_US.csv of gnea/grbl, shortened.
ALARMS: Final = {
    1: "hard limit",
    2: "soft limit",
    3: "reset while in motion",
    4: "probe in the wrong state",
    5: "probe made no contact",
    6: "reset during homing",
    7: "door opened during homing",
    8: "homing did not clear the switch",
    9: "homing did not find the switch",
    10: "homing did not find the second switch; on grblHAL: emergency stop",
    # grblHAL's own
    11: "homing required",
    12: "limit switch engaged",
    17: "motor fault",
    18: "homing failed",
}

ERROR_REMEDIES: Final = {
    5: "set $22=1, or choose the software zero",
    8: "stop the axis first",
    9: "home to clear the lock",
    13: "close the safety door",
    15: "widen $130 to $132, or switch soft limits off with $20=0",
    22: "give the move a speed",
    45: "free the axis from its switch",
    46: "home it",
    50: "release the emergency stop, then home",
    51: "check motor and driver, then home",
}

ALARM_REMEDIES: Final = {
    1: "free the axis from its switch, then home",
    2: "widen the controller's travel ($130 to $132), then home",
    3: "home: the position is lost",
    6: "home again",
    7: "close the door and home again",
    8: "raise the pull-off $27 or check the switch's wiring, then home",
    9: "check the switch and the travel $130 to $132, then home",
    10: "check the second switch, or release the emergency stop; then home",
    11: "home it",
    12: "free the axis from its switch, then home",
    17: "check motor and driver, then home",
    18: "check the switches and the homing settings, then home",
}
