r"""How an axis moves: pure functions of time, which is always an argument.

A trajectory is a run of phases of constant acceleration. A move is a trapezoid of speed (a triangle
when it is short), a stop is one phase from whatever speed there is::

    speed |    ______                 |    ____
          |   /      \                |   /    \  <- stop: slows down from here
          |  /        \               |  /      \
          +-/----------\--- time      +-/--------\-- time

Positions are in the axis's own unit, radians or millimetres; so are speeds and accelerations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Limits:
    """What an axis reaches, in its own unit a second, and a second squared."""

    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"motion: {name} = {value}; it must be finite and above 0")


@dataclass(frozen=True, slots=True)
class _Phase:
    """Constant acceleration for a while."""

    seconds: float
    speed: float  # signed, at its begin
    acceleration: float  # signed

    def travel(self, seconds: float) -> float:
        return self.speed * seconds + self.acceleration * seconds * seconds / 2.0


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One way of the motor; standing before and after it."""

    begun_s: float
    start: float
    target: float  # where it ends, exactly: no rounding of the phases shows at rest
    phases: tuple[_Phase, ...] = ()

    @property
    def ends_s(self) -> float:
        """When it stands again."""
        return self.begun_s + sum(phase.seconds for phase in self.phases)

    def done(self, time_s: float) -> bool:
        """Whether it stands again."""
        return time_s >= self.ends_s

    def position(self, time_s: float) -> float:
        """Where the motor is."""
        if self.done(time_s):
            return self.target
        left_s, position = max(time_s - self.begun_s, 0.0), self.start
        for phase in self.phases:
            position += phase.travel(min(left_s, phase.seconds))
            left_s -= min(left_s, phase.seconds)
        return position

    def speed(self, time_s: float) -> float:
        """How fast it moves, signed."""
        left_s = time_s - self.begun_s
        if left_s < 0.0 or self.done(time_s):  # the phases' own sum may be a rounding longer
            return 0.0
        for phase in self.phases:
            if left_s < phase.seconds:
                return phase.speed + phase.acceleration * left_s
            left_s -= phase.seconds
        return 0.0


def move(start: float, target: float, limits: Limits, begun_s: float) -> Trajectory:
    """Go from rest at `start` to rest at `target` as fast as the limits allow."""
    if not math.isfinite(target):
        raise ValueError(f"motion: the target {target} is no position")
    way, sign = abs(target - start), math.copysign(1.0, target - start)
    top = min(limits.speed, math.sqrt(way * limits.acceleration))
    if top == 0.0:  # nowhere to go, or so near that it underflows
        return Trajectory(begun_s, start, target)
    ramp_s = top / limits.acceleration
    cruise_s = max(way - top * ramp_s, 0.0) / top
    ramp = sign * limits.acceleration
    phases = (
        _Phase(ramp_s, 0.0, ramp),
        _Phase(cruise_s, sign * top, 0.0),
        _Phase(ramp_s, sign * top, -ramp),
    )
    return Trajectory(begun_s, start, target, phases)


def stop(way: Trajectory, acceleration: float, time_s: float) -> Trajectory:
    """Leave a trajectory at `time_s` and slow down; a finished one stays where it ended."""
    here, speed = way.position(time_s), way.speed(time_s)
    if time_s + abs(speed) / acceleration == time_s:  # at rest, or in less than a tick
        return Trajectory(time_s, here, here)
    phase = _Phase(abs(speed) / acceleration, speed, -math.copysign(acceleration, speed))
    return Trajectory(time_s, here, here + phase.travel(phase.seconds), (phase,))


@dataclass(frozen=True, slots=True)
class Play:
    """The slack between motor and load.

    The motor drags the load by either end of it::

    load  |<------ width ------>|  lies between  motor  and  motor + width
       upward: load = motor        downward: load = motor + width
    """

    width: float = 0.0

    def load(self, before: float, motor: float) -> float:
        """Where the load is after a way in one direction, if it was at `before`."""
        return min(max(before, motor), motor + self.width)


@dataclass(frozen=True, slots=True)
class AxisMotion:
    """An axis's motor on its way, and the load behind its play."""

    limits: Limits
    way: Trajectory
    play: Play = Play()
    load_before: float = 0.0  # where the load was when the way began

    @classmethod
    def standing(cls, position: float, limits: Limits, play: Play | None = None) -> AxisMotion:
        """At rest, the play taken up upward."""
        return cls(limits, Trajectory(0.0, position, position), play or Play(), position)

    def motor(self, time_s: float) -> float:
        """What the controller counts."""
        return self.way.position(time_s)

    def load(self, time_s: float) -> float:
        """Where the table or the carriage truly is."""
        return self.play.load(self.load_before, self.motor(time_s))

    def done(self, time_s: float) -> bool:
        """Whether the motor stands."""
        return self.way.done(time_s)

    def moved_to(self, target: float, time_s: float) -> AxisMotion:
        """Begin a move now.

        Raises
        ------
        ValueError
            It is still moving: stop it first, or wait.
        """
        if not self.done(time_s):
            raise ValueError(f"motion: a move to {target} while moving to {self.way.target}")
        way = move(self.motor(time_s), target, self.limits, time_s)
        return replace(self, way=way, load_before=self.load(time_s))

    def stopped(self, time_s: float) -> AxisMotion:
        """Begin to slow down now; allowed at any time."""
        way = stop(self.way, self.limits.acceleration, time_s)
        return replace(self, way=way, load_before=self.load(time_s))


@dataclass(frozen=True, slots=True)
class ScaledClock:
    """The station's time: `scale` seconds of it pass in a second of `clock`, from 0 on."""

    clock: Callable[[], float]
    scale: float
    origin_s: float

    @classmethod
    def started(cls, clock: Callable[[], float], scale: float = 1.0) -> ScaledClock:
        """Start the station's time now."""
        if not (math.isfinite(scale) and scale > 0.0):
            raise ValueError(f"motion: a time scale of {scale}; it must be finite and above 0")
        return cls(clock, scale, clock())

    def __call__(self) -> float:
        """The station's time in seconds."""
        return (self.clock() - self.origin_s) * self.scale

    def wall_s(self, station_s: float) -> float:
        """How long a wait of the station's time takes."""
        return station_s / self.scale
