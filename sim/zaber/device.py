"""One device: what it is told, what its axis does in time, its settings and its flags.

It counts microsteps of its motor, from 0 where the power came on and from 0 at home. Without an
encoder a stalled motor counts on. With one, `encoder.pos` is the truth, and a stall stops it with
FS, unless its detection is switched off::

    WR  until it was homed         FS  stalled, until homed or cleared
    NI  a move was stopped         FO  the driver is disabled
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from sim.world import WorldAxis

_SPEED = 1.6384
_RAMP = _SPEED / 10_000.0
_FLAG_ORDER = ("FO", "FS", "WR", "NI")


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberSettings:
    """What the device is, and where its home sensor is; in the world's own unit, rad or mm."""

    microsteps_per_unit: float = 2000.0  # of a mm or a radian
    home_at: float = 0.0
    travel: tuple[float, float] = (0.0, 150.0)  # from home, the limits it is delivered with
    device_id: int = 50081
    serial: int = 33001
    version: str = "7.38"
    resolution: int = 64
    encoder: bool = False
    detects_stalls: bool = True
    checks: bool = False  # comm.checksum as delivered
    alerts: bool = False  # comm.alert as delivered
    maxspeed: int = 153600
    accel: int = 205


@dataclass(frozen=True, slots=True)
class Answer:
    """What it says to a command."""

    taken: bool
    data: str = "0"
    infos: tuple[str, ...] = ()


class ZaberDevice:
    """A device with one axis."""

    def __init__(self, axis: WorldAxis, settings: ZaberSettings | None = None) -> None:
        self.settings = settings or ZaberSettings()
        self.writes = 0  # of settings: each is kept for good
        self._axis = axis
        per_unit = self.settings.microsteps_per_unit
        self._values: dict[str, int] = {
            "maxspeed": self.settings.maxspeed,
            "accel": self.settings.accel,
            "resolution": self.settings.resolution,
            "limit.min": round(self.settings.travel[0] * per_unit),
            "limit.max": round(self.settings.travel[1] * per_unit),
            "comm.checksum": int(self.settings.checks),
            "comm.alert": int(self.settings.alerts),
        }
        self._power_up(0.0)

    def _power_up(self, now_s: float) -> None:
        self._zero = self._axis.motor(now_s)  # where the count is 0
        self._encoder_zero = self._zero
        self._flags = {"WR"}
        self._under_way = ""  # home, move or stop
        self._next: tuple[float, str, int | None] | None = None
        self._wanted = self._zero
        self._enabled = True

    def power_cycle(self, now_s: float) -> None:
        """Lose power and get it back."""
        self._axis.brake(now_s)
        self._power_up(now_s)

    @property
    def sends_checks(self) -> bool:
        """Whether its messages carry one."""
        return bool(self._values["comm.checksum"])

    def seen(self, now_s: float) -> tuple[str, str]:
        """What every reply says: BUSY or IDLE, and the highest flag."""
        self.tick(now_s)
        return "BUSY" if self._under_way else "IDLE", self._standing_flags()[0]

    def _standing_flags(self) -> tuple[str, ...]:
        return tuple(each for each in _FLAG_ORDER if each in self._flags) or ("--",)

    def do(self, axis: int, words: Sequence[str], now_s: float) -> Answer:
        """Execute a command that was understood so far."""
        self.tick(now_s)
        if axis > 1:
            return Answer(taken=False, data="BADAXIS")
        match list(words):
            case []:
                return Answer(taken=True)
            case ["get", name]:
                return self._get(name, now_s)
            case ["set", name, value]:
                return self._set(name, value)
            case ["warnings"]:
                flags = [each for each in self._standing_flags() if each != "--"]
                return Answer(taken=True, data=" ".join([f"{len(flags):02d}", *flags]))
            case ["warnings", "clear"]:
                self._flags &= {"WR", "FO"}
                return Answer(taken=True)
            case ["system", "reset"]:
                self.power_cycle(now_s)
                return Answer(taken=True)
            case ["help"]:
                return Answer(taken=True, infos=("COMMAND USAGE:", "type '/help commands'"))
            case ["driver", "disable" | "enable" as what]:
                return self._switch(enabled=what == "enable", now_s=now_s)
            case [("stop" | "estop")]:
                return self._stop(now_s)
            case ["home"]:
                return self._home(now_s)
            case ["move", how, *rest] if how in ("abs", "rel", "vel", "min", "max"):
                return self._move(how, rest, now_s)
        return Answer(taken=False, data="BADCOMMAND")

    def tick(self, now_s: float) -> Iterable[tuple[int, str, str]]:
        """Finish what is over; the alerts that this brings: axis, state, flag."""
        if not self._under_way or not self._axis.stands(now_s):
            return ()
        ended, self._under_way = self._under_way, ""
        if self._next is not None:
            (target, what, speed), self._next = self._next, None
            self._go(target, what, now_s, speed)
            return ()
        if self._axis.blocked(now_s):
            self._stalled(now_s)
        elif ended == "home":
            self._zero = self._encoder_zero = self._axis.motor(now_s)
            self._flags -= {"WR", "FS"}
        elif ended == "stop":
            self._flags.add("NI")
        return ((1, "IDLE", self._standing_flags()[0]),) if self._values["comm.alert"] else ()

    def _stalled(self, now_s: float) -> None:
        if self.settings.encoder and self.settings.detects_stalls:
            self._flags.add("FS")
            self._axis.brake(now_s)
            return
        lost = self._wanted - self._axis.motor(now_s)  # counted, not made
        self._zero -= lost
        self._axis.brake(now_s)

    # ---- settings

    def _get(self, name: str, now_s: float) -> Answer:
        told: dict[str, Callable[[], object]] = {
            "deviceid": lambda: self.settings.device_id,
            "device.id": lambda: self.settings.device_id,
            "system.serial": lambda: self.settings.serial,
            "version": lambda: self.settings.version,
            "system.axiscount": lambda: 1,
            "pos": lambda: self._steps(self._axis.motor(now_s) - self._zero),
        }
        if self.settings.encoder:
            told["encoder.pos"] = lambda: self._steps(self._axis.motor(now_s) - self._encoder_zero)
        if name in told:
            return Answer(taken=True, data=str(told[name]()))
        if name in self._values:
            return Answer(taken=True, data=str(self._values[name]))
        return Answer(taken=False, data="BADCOMMAND")

    def _set(self, name: str, value: str) -> Answer:
        if name not in self._values:
            return Answer(taken=False, data="BADCOMMAND")
        if not value.removeprefix("-").isdecimal() or (name == "maxspeed" and int(value) < 1):
            return Answer(taken=False, data="BADDATA")
        self._values[name] = int(value)
        self.writes += 1
        return Answer(taken=True)

    # ---- motion

    def _steps(self, way: float) -> int:
        return round(way * self.settings.microsteps_per_unit)

    def _switch(self, *, enabled: bool, now_s: float) -> Answer:
        self._enabled = enabled
        if enabled:
            self._flags.discard("FO")
        else:
            self._flags |= {"FO", "WR"}
            self._axis.brake(now_s)
        return Answer(taken=True)

    def _stop(self, now_s: float) -> Answer:
        if self._under_way:
            self._axis.brake(now_s)
            self._next, self._under_way = None, "stop"
        return Answer(taken=True)

    def _home(self, now_s: float) -> Answer:
        if not self._enabled:
            return Answer(taken=False, data="DRIVERDISABLED")
        self._flags |= {"WR"}
        self._flags -= {"FS", "NI"}
        self._go(self.settings.home_at, "home", now_s)
        return Answer(taken=True)

    def _move(self, how: str, rest: Sequence[str], now_s: float) -> Answer:
        if not self._enabled:
            return Answer(taken=False, data="DRIVERDISABLED")
        here = self._steps(self._axis.motor(now_s) - self._zero)
        low, high = self._values["limit.min"], self._values["limit.max"]
        if how in ("min", "max"):
            target, speed = (low if how == "min" else high), None
        elif len(rest) != 1 or not rest[0].removeprefix("-").isdecimal():
            return Answer(taken=False, data="BADDATA")
        elif how == "vel":
            speed = int(rest[0])
            target = high if speed > 0 else low
        else:
            target, speed = int(rest[0]) + (here if how == "rel" else 0), None
        referenced = "WR" not in self._flags
        if referenced and not low <= target <= high:
            return Answer(taken=False, data="BADDATA")
        if not referenced and how != "rel":
            return Answer(taken=False, data="BADDATA")
        self._flags -= {"FS", "NI"}
        per_unit = self.settings.microsteps_per_unit
        self._go(self._zero + target / per_unit, "move", now_s, speed)
        return Answer(taken=True)

    def _go(self, target: float, what: str, now_s: float, speed: int | None = None) -> None:
        if not self._axis.stands(now_s):  # a new command replaces the one under way
            self._axis.brake(now_s)
            self._next, self._under_way = (target, what, speed), "stop"
            return
        per_unit = self.settings.microsteps_per_unit
        wire = abs(speed) if speed else self._values["maxspeed"]
        ramp = self._values["accel"]
        self._wanted = target
        self._axis.go(
            target,
            now_s,
            speed=wire / _SPEED / per_unit,
            acceleration=ramp / _RAMP / per_unit if ramp else math.inf,
        )
        self._under_way = what
