"""The firmware's state machine of motion: queued blocks run one after the other, hold, resume, jog.

::

    Idle --block--> Run --'!'--> Hold:1 --stands--> Hold:0 --'~'--> Run, or Idle
      '---$J=-----> Jog --'!' or 0x85--> slows down, still Jog, flushes --> Idle
    Idle --'!'--> Hold:0
    Jog --ends--> Idle --0x85 within microseconds--> says Idle, and reads no line until '~'

A block begins and ends at rest; the firmware would run through between two in one direction.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum

from sim.grbl.moves import Move, Pace
from sim.grbl.settings import Eeprom
from sim.grbl.stepper import Stepper

BLOCKS = 15  # of the ring's 16, one is always free
_SLOWEST_DEG_MIN = 1.0

_FEED_BACK = 0x90
_FEED_CHANGES = {0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
_FEED_PERCENT = (10, 200)
_RAPID_PERCENTS = {0x95: 100, 0x96: 50, 0x97: 25}


class State(Enum):
    """What a report begins with."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    JOG = "Jog"
    HOME = "Home"
    ALARM = "Alarm"


class Cycle:
    """The planner's queue and the state of the machine."""

    def __init__(self, stepper: Stepper, eeprom: Eeprom, *, late_cancel_s: float) -> None:
        self.state = State.IDLE
        self.feed_percent = self.rapid_percent = 100
        self.braking = False  # a hold or the end of a jog is on its way
        self.going_idle = False  # a hold that ends in Idle: a soft limit was met
        self._late_cancel_s = late_cancel_s
        self._jog_ended_s = -math.inf
        self._stuck = False
        self._queue: deque[Move] = deque()
        self._stepper = stepper
        self._eeprom = eeprom
        self._from = 0
        self._rate_deg_min = 0.0

    @property
    def suspended(self) -> bool:
        """Whether the main program stands still: no line is read, none is answered."""
        return self.braking or self._stuck or self.state is State.HOLD

    @property
    def free(self) -> int:
        """Blocks the planner can still take."""
        return BLOCKS - len(self._queue)

    @property
    def drained(self) -> bool:
        """Whether every queued block was run."""
        return not self._queue and self.state is not State.RUN

    @property
    def busy(self) -> bool:
        """Whether rare fields of the reports come more rarely."""
        return self.state not in (State.IDLE, State.ALARM)

    @property
    def label(self) -> str:
        """The state as a report says it."""
        if self.state is State.HOLD:
            return f"Hold:{int(self.braking)}"
        return str(self.state.value)

    def reset(self, state: State) -> None:
        """Forget every block."""
        self._queue.clear()
        self.restore_overrides()
        self.braking = self.going_idle = self._stuck = False
        self._jog_ended_s = -math.inf
        self.state = state

    def override(self, byte: int) -> bool:
        """Take 0x90 to 0x97 for the blocks to come; return whether anything changed."""
        before = (self.feed_percent, self.rapid_percent)
        lowest, highest = _FEED_PERCENT
        feed = 100 if byte == _FEED_BACK else self.feed_percent + _FEED_CHANGES.get(byte, 0)
        self.feed_percent = min(max(feed, lowest), highest)
        self.rapid_percent = _RAPID_PERCENTS.get(byte, self.rapid_percent)
        return before != (self.feed_percent, self.rapid_percent)

    def restore_overrides(self) -> None:
        """Go back to full speed."""
        self.feed_percent = self.rapid_percent = 100

    def plan(self, move: Move, now_s: float) -> None:
        """Queue a block, and begin when nothing else runs; one without a step is dropped."""
        planned = self._queue[-1].target if self._queue else self._stepper.count(now_s)
        if move.target == planned:
            return
        self._queue.append(move)
        if self.state is State.IDLE:
            self.state = State.JOG if move.pace is Pace.JOG else State.RUN
            self._begin(now_s)

    def hold(self, now_s: float) -> None:
        """Do `!`."""
        if self.state is State.JOG:
            self.cancel_jog(now_s)
        elif self.state is State.RUN:
            self.state, self.braking = State.HOLD, True
            self._stepper.brake(now_s)
        elif self.state is State.IDLE:
            self.state = State.HOLD

    def cancel_jog(self, now_s: float) -> None:
        """Do 0x85; it is nothing to any other state, but for a moment after a jog."""
        if self.state is State.JOG and not self.braking:
            self.braking = True
            self._stepper.brake(now_s)
        elif self.state is State.IDLE:
            self._stuck = self._stuck or now_s - self._jog_ended_s <= self._late_cancel_s

    def resume(self, now_s: float) -> None:
        """Do `~`."""
        self._stuck = False
        if self.state is State.HOLD and not self.braking:
            self.state = State.RUN if self._queue else State.IDLE
            if self._queue:
                self._begin(now_s)

    def settle(self, now_s: float) -> bool:
        """Go on when the motor stands; return whether moves were thrown away."""
        if not self._stepper.settle(now_s):
            return False
        if self.braking:
            return self._braked()
        if self.state in (State.RUN, State.JOG):
            self._queue.popleft()
            if self._queue:
                self._begin(now_s)
            else:
                self._jog_ended_s = now_s if self.state is State.JOG else -math.inf
                self.state = State.IDLE
        return False

    def rate_deg_min(self, now_s: float) -> float:
        """How fast it goes, told from how far the ends of the way are."""
        if not self._stepper.moving or self.state is State.ALARM:
            return 0.0
        here = self._stepper.count(now_s)
        end = self._stepper.count(self._stepper.ends_s())
        way_deg = min(abs(here - self._from), abs(end - here)) / self._eeprom.steps_per_deg
        ramp_deg_s = math.sqrt(2.0 * self._eeprom.acceleration_deg_s2 * way_deg)
        return min(self._rate_deg_min, 60.0 * ramp_deg_s)

    def drive(self, target: int, rate_deg_min: float, now_s: float) -> None:
        """Send the motor somewhere, past the planner."""
        rate_deg_min = max(min(rate_deg_min, self._eeprom.max_rate_deg_min), _SLOWEST_DEG_MIN)
        self._from, self._rate_deg_min = self._stepper.count(now_s), rate_deg_min
        self._stepper.go(
            target,
            now_s,
            steps_s=rate_deg_min / 60.0 * self._eeprom.steps_per_deg,
            steps_s2=self._eeprom.acceleration_deg_s2 * self._eeprom.steps_per_deg,
        )

    def _begin(self, now_s: float) -> None:
        move = self._queue[0]
        self.drive(move.target, self._programmed_deg_min(move), now_s)

    def _programmed_deg_min(self, move: Move) -> float:
        if move.pace is Pace.RAPID:
            return self._eeprom.max_rate_deg_min * self.rapid_percent / 100.0
        if move.pace is Pace.FEED:
            return move.feed_deg_min * self.feed_percent / 100.0
        return move.feed_deg_min

    def _braked(self) -> bool:
        self.braking = False
        if self.state is State.JOG or self.going_idle:
            self._queue.clear()
            self.state, self.going_idle = State.IDLE, False
            return True
        return False
