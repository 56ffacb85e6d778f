"""Who guarantees what at this station, in milliseconds, said before anything is lit.

Two layers beside the program's own way out: the guard, for a program that is dead or hangs, and the
switch's own watchdog, for a machine that is. A switch without one lights only for somebody who
stays at the station: nobody else could press the emergency stop.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from acquisition.errors import NotNow
from acquisition.lease import TTL_S
from drivers.laser import Guarantee


class Attendance(Enum):
    """Whether somebody could press the emergency stop."""

    NOBODY = "nobody is at the station"
    PRESENT = "somebody stays at the station"


def must_be_attended(guarantee: Guarantee, attendance: Attendance) -> None:
    """Refuse an unattended run of a laser that only a person could turn off.

    Raises
    ------
    NotNow
    """
    if guarantee.watchdog_s is None and attendance is Attendance.NOBODY:
        raise NotNow(
            f"{guarantee.sentence}; so nothing is lit while nobody is there: stay, and say so"
            " (--attended), or switch the laser by a relay with a watchdog of its own"
        )


def promise_of_guard(guarded_s: Mapping[str, float]) -> str:
    """What the guard does, in one sentence; `guarded_s` is `OpenStation.guarded`."""
    laser_s = [seconds for device, seconds in guarded_s.items() if device.startswith("laser")]
    if not laser_s:
        return "guard: it has no way to the laser, it only stops the axes of a dead program"
    hung_ms, dead_ms = 1000.0 * laser_s[0], 1000.0 * (laser_s[0] - TTL_S)
    return (
        f"guard: the laser is off within {dead_ms:.0f} ms after this program is killed or crashes,"
        f" within {hung_ms:.0f} ms after it hangs or is stopped, and then it is ended"
    )
