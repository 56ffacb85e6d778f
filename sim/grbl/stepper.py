"""The motor behind the board: the controller's count of steps, and the axis that turns.

The count is the motor's position plus an offset in steps. The board sees no encoder: it counts the
steps it sends, not those that were made::

    stalled    the count goes on to the target, and the offset swallows the rest
    killed     the count stands at once, the motor coasts on: the position is lost
"""

from __future__ import annotations

import math

from sim.world import WorldAxis


class Stepper:
    """One motor on a driver that knows steps and directions."""

    def __init__(self, axis: WorldAxis, steps_per_deg: float) -> None:
        self.moving = False  # until `settle` finds it standing
        self._axis = axis
        self._steps_per_rad = math.degrees(steps_per_deg)
        self._offset = 0.0
        self._frozen: int | None = None
        self._target: int | None = None

    def count(self, now_s: float) -> int:
        """Steps, as the controller has counted them."""
        if self._frozen is not None:
            return self._frozen
        return round(self._motor_steps(now_s) + self._offset)

    def motor_deg(self, now_s: float) -> float:
        """Where the motor truly is."""
        return math.degrees(self._axis.motor(now_s))

    def ends_s(self) -> float:
        """When it stands: a time at which the axis, too, says so."""
        ends_s = self._axis.ends_s()
        while not self._axis.stands(ends_s):  # the way from station time and back rounds
            ends_s = math.nextafter(ends_s, math.inf)
        return ends_s

    def stands(self, now_s: float) -> bool:
        """Whether the motor stands."""
        return self._axis.stands(now_s)

    def go(self, target: int, now_s: float, *, steps_s: float, steps_s2: float) -> None:
        """Send steps up to a count."""
        self._axis.go(
            (target - self._offset) / self._steps_per_rad,
            now_s,
            speed=steps_s / self._steps_per_rad,
            acceleration=steps_s2 / self._steps_per_rad,
        )
        self._target, self.moving = target, True

    def brake(self, now_s: float) -> None:
        """Slow down; no step is lost."""
        self._axis.brake(now_s)
        self._target = None

    def kill(self, now_s: float) -> None:
        """Stop sending steps at once; nothing happens to a motor that stands."""
        if self.moving:
            self._frozen = self.count(now_s)
            self.brake(now_s)

    def settle(self, now_s: float) -> bool:
        """Note that it stands, if it moved and does; return whether that is new."""
        if not self.moving or not self.stands(now_s):
            return False
        self.moving = False
        counted = self._frozen if self._frozen is not None else self._target
        if counted is not None:
            self.redefine(counted, now_s)
        return True

    def redefine(self, count: int, now_s: float) -> None:
        """Call the place where it stands by another count."""
        self._offset = count - self._motor_steps(now_s)
        self._frozen = self._target = None

    def _motor_steps(self, now_s: float) -> float:
        return self._axis.motor(now_s) * self._steps_per_rad
