"""What Hokuyo's sensors say besides ranges: statuses, and ranges that are error codes.

C-42-03320B, pages 11 to 14 and 23 (statuses), table 3 (URG-04LX, UBG-04LX-F01, UHG-08LX) and
table 4 (UTM-30LX) of page 12. A range below the sensor's least that no table names is UNKNOWN.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import IntArray
from drivers.profiler import Reason

LASER_OFF: Final = "10"
OK: Final = "00"
ALREADY: Final = "02"  # of BM: the laser is on already
# Of what we send, only a line that was damaged on its way is answered so: worth saying again.
MISHEARD: Final = ("0A", "0B", "0C", "0D", "0E", "0F", "0G", "0H")

_STATUSES: Final = {
    "01": "a parameter is wrong, or the laser has a malfunction",
    "02": "a parameter is wrong",
    "03": "a parameter is wrong",
    "04": "the last step is out of range",
    "05": "the last step is before the first",
    "10": "the laser is off",
    "0A": "cannot make the reply",
    "0B": "short of buffers, or a command that was repeated",
    "0C": "a command with too few parameters",
    "0D": "an unknown command",
    "0E": "an unknown command",
    "0F": "a command with too few parameters",
    "0G": "a string of more than 16 letters",
    "0H": "a string with letters that it may not have",
    "0I": "in firmware update mode; reset it",
}

# Page 12, table 3. Those that the manual calls "others" are no reason we could name.
_URG: Final[Mapping[int, Reason]] = {
    0: Reason.OUT_OF_RANGE,  # possibly at 22 m
    1: Reason.NO_RETURN,  # low intensity
    2: Reason.NO_RETURN,
    18: Reason.SATURATED,  # strongly reflecting
    19: Reason.OUT_OF_RANGE,  # a step that cannot be measured
}
# Table 4.
_UTM: Final[Mapping[int, Reason]] = {
    1: Reason.NO_RETURN,  # nothing in the range
    2: Reason.OUT_OF_RANGE,  # too near
    4: Reason.OUT_OF_RANGE,  # at the near end
}


def status_name(status: str) -> str:
    """Say what a status means; all of 50 to 97 are trouble with the hardware."""
    if status.isdecimal() and 50 <= int(status) <= 97:
        return "trouble with its hardware, such as laser or motor"
    if status.isdecimal() and 21 <= int(status) <= 49:
        return "stopped to verify an error"
    return _STATUSES.get(status, "unknown to us")


def reasons_of(ranges: IntArray, model: str, least_mm: int, most_mm: int) -> NDArray[np.uint8]:
    """Say for each range whether it is one; (n,) -> (n,) of `Reason`."""
    reasons = np.full(len(ranges), Reason.MEASURED, dtype=np.uint8)
    reasons[ranges > most_mm] = Reason.OUT_OF_RANGE
    reasons[ranges < least_mm] = Reason.UNKNOWN
    for code, reason in (_UTM if model.startswith("UTM") else _URG).items():
        if code < least_mm:
            reasons[ranges == code] = reason
    return reasons
