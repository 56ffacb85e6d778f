"""What is true at the simulated station: where the axes are, whether the laser is on.

The devices on the wires say what their makers' manuals make them say; what they do, they do here,
and everything that is done here is witnessed::

    wire -> device -> World: axes, laser -> OpticalBench -> device -> wire
                        '--> Witness

``now_s`` is always an argument: monotonic wall seconds. The station's own time runs `pace.scale`
times as fast from `pace.origin_s` on; motion and the sensor's rate follow it. Watchdogs and answers
on the wires do not: safety is never scaled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sim.crooked import CrookedBench
from sim.motion import AxisMotion
from sim.optics import OpticalBench
from sim.sensor import SeedKey, SimProfile
from sim.witness import Witness

_UM_FROM = 2**31  # stage positions in um, shifted so that none is negative


@dataclass(frozen=True, slots=True)
class Pace:
    """How the station's time runs beside the wall's."""

    origin_s: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            raise ValueError(f"a time scale of {self.scale}; it must be finite and above 0")

    def station_s(self, now_s: float) -> float:
        """The station's time at a wall time."""
        return (now_s - self.origin_s) * self.scale

    def wall_s(self, station_s: float) -> float:
        """Invert `station_s`."""
        return self.origin_s + station_s / self.scale


class WorldAxis:
    """One motor and what it drives, in rad or mm of the axis."""

    def __init__(self, name: str, motion: AxisMotion, pace: Pace, witness: Witness) -> None:
        self.name = name
        self.obstacle: float | None = None  # it cannot go above: a planted stall
        self._motion = motion
        self._pace = pace
        self._witness = witness
        self._wanted = motion.motor(0.0)

    def motor(self, now_s: float) -> float:
        """Where the motor is: what its controller counts."""
        return self._motion.motor(self._pace.station_s(now_s))

    def load(self, now_s: float) -> float:
        """Where the table or the carriage truly is, behind the play."""
        return self._motion.load(self._pace.station_s(now_s))

    def stands(self, now_s: float) -> bool:
        """Whether the motor stands."""
        return self._motion.done(self._pace.station_s(now_s))

    def ends_s(self) -> float:
        """Wall time at which it stands, or stood."""
        return self._pace.wall_s(self._motion.way.ends_s)

    def blocked(self, now_s: float) -> bool:
        """Whether it stands before an obstacle, short of where it was sent."""
        return self.stands(now_s) and self._motion.way.target != self._wanted

    def go(
        self, target: float, now_s: float, *, speed: float, acceleration: float | None = None
    ) -> None:
        """Begin to move at most as fast as told, and as the motor can; stops short at an obstacle.

        Raises
        ------
        ValueError
            It still moves: brake first, or wait.
        """
        own = self._motion.limits
        limits = replace(
            own,
            speed=min(speed, own.speed),
            acceleration=min(acceleration or own.acceleration, own.acceleration),
        )
        reached = target if self.obstacle is None else min(target, self.obstacle)
        moving = replace(self._motion, limits=limits)
        self._motion = replace(moving.moved_to(reached, self._pace.station_s(now_s)), limits=own)
        self._wanted = target
        self._witness.note(
            now_s, "move", axis=self.name, start=self.motor(now_s), target=reached,
            ends_s=self.ends_s(),
        )  # fmt: skip

    def brake(self, now_s: float) -> None:
        """Begin to slow down, at any time; standing, it stays."""
        if not self.stands(now_s):
            self._motion = self._motion.stopped(self._pace.station_s(now_s))
        self._wanted = self._motion.way.target
        self._witness.note(
            now_s, "stop", axis=self.name, target=self._wanted, ends_s=max(self.ends_s(), now_s)
        )


class World:
    """The station in truth; the devices of one simulator share it."""

    def __init__(
        self,
        bench: OpticalBench | CrookedBench,
        table: WorldAxis,
        stage: WorldAxis,
        pace: Pace,
        witness: Witness,
    ) -> None:
        self.bench = bench
        self.table = table
        self.stage = stage
        self.pace = pace
        self.witness = witness
        self.laser_on = False
        self._lit_since_s = math.inf
        self._seen: tuple[tuple[float, float], SimProfile] | None = None

    def switch_laser(self, now_s: float, *, on: bool, why: str) -> None:
        """Switch the laser; witnessed when it changes."""
        if on != self.laser_on:
            self.laser_on = on
            self._lit_since_s = now_s if on else math.inf
            self.witness.note(now_s, "laser", on=on, why=why)

    def look(self, now_s: float) -> SimProfile | None:
        """What the sensor saw a moment ago or sees now; None where the laser was off then.

        Noise is speckle: a scene that stands still looks the same however often it is looked at, so
        that a scan does not depend on how many profiles were sent before one was taken.
        """
        if now_s < self._lit_since_s:
            return None
        pose = (self.table.load(now_s), self.stage.load(now_s))
        if self._seen is None or self._seen[0] != pose:
            self._seen = (pose, self.bench.profile(*pose, _seed_key(*pose)))
        return self._seen[1]


def _seed_key(table_rad: float, stage_mm: float) -> SeedKey:
    turned_urad = round(table_rad * 1e6) % round(math.tau * 1e6)
    return SeedKey(slice_index=round(stage_mm * 1e3) + _UM_FROM, profile_index=turned_urad)
