"""The verb class `Station`: a station for control scripts, at rest on every way out.

    >>> with Station.open("station.toml") as station:
    ...     station.home()
    ...     station.jog(table_deg=90.0)
    ...     profile = station.profile()

Every move and every exposure waits in steps of 50 ms at most and looks for Ctrl-C there, so that it
ends with the laser off and the axes stopped before KeyboardInterrupt is raised. SIGTERM and SIGHUP
end a script the same way, by SystemExit, unless it has handlers of its own.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, Self

from acquisition.lease import LONGEST_WAIT_S, lasing, pausing
from acquisition.opening import OpenStation, at_rest_unless_done, open_station
from acquisition.safety.leading import acknowledge, arm, begin_homing, homed, make_known
from acquisition.safety.states import Event, State
from acquisition.scan import StopRequest
from acquisition.station import NoLaserSwitch, read_station
from acquisition.station import Station as Settings
from drivers.axis import Axis, AxisState, Motion, Pause
from drivers.errors import NoReply, Refused
from drivers.grbl import GrblAxis
from drivers.links import ByteLink, open_link
from drivers.profiler import Profile
from loftscan.signals import Attention

AxisName = Literal["table", "stage", "both"]
_EXPOSURE_S = 1.0  # longer than three periods of any sensor that is worth the name
_LOOK_S = LONGEST_WAIT_S / 2
_BRAKING_S = 5.0
_UNDER_WAY = (Motion.MOVING, Motion.HOMING)


@dataclass(frozen=True, slots=True)
class Stand:
    """How the station stands, read back from its devices."""

    table: AxisState  # position in rad
    stage: AxisState  # position in mm
    laser_on: bool

    @property
    def table_deg(self) -> float:
        """The table's angle, unwrapped."""
        return math.degrees(self.table.position)

    @property
    def stage_mm(self) -> float:
        """The stage's position."""
        return self.stage.position


class Closes(Protocol):
    """What ends with the station, such as a scan under way."""

    def close(self) -> None:
        """End; may be called again."""
        ...


class Station:
    """A station whose links are open; made by `Station.open`."""

    def __init__(self, devices: OpenStation, attention: Attention, folder: Path) -> None:
        self.folder = folder  # where its calibration lies
        self._devices = devices
        self._attention = attention
        self._under_way: Closes | None = None

    @classmethod
    @contextmanager
    def open(
        cls,
        station: str | os.PathLike[str] | Settings,
        *,
        links: Callable[[str], ByteLink] = open_link,
    ) -> Iterator[Self]:
        """Open a station.toml; laser off, axes stopped and links closed on every way out.

        Raises
        ------
        ValueError
            The file says what it may not; names the key and the fix.
        DriverError
            A device is not there or said no.
        """
        settings = station if isinstance(station, Settings) else read_station(Path(station))
        folder = Path() if isinstance(station, Settings) else Path(station).parent
        attention = Attention()
        devices = open_station(settings, links=links)
        with attention.listening(), attention.shielding(devices) as opened:
            found = cls(opened, attention, folder)
            try:
                yield found
            finally:
                found.end_work()

    @property
    def settings(self) -> Settings:
        """What station.toml says."""
        return self._devices.settings

    @property
    def devices(self) -> OpenStation:
        """The drivers themselves, for what has no verb."""
        return self._devices

    @property
    def attention(self) -> Attention:
        """Who hears signals for this station."""
        return self._attention

    def stand(self) -> Stand:
        """Read back how the station stands."""
        at = self._devices
        return Stand(at.table.state(), at.stage.state(), at.laser.is_on())

    def home(self, axis: AxisName = "both") -> Stand:
        """Find the references, the stage's first; a table without a switch names its place zero."""
        with self._working() as pause:
            make_known(self._devices)
            begin_homing(self._devices)
            for name in ("stage", "table"):
                if axis in (name, "both"):
                    self._axis(name).home(pause)
            homed(self._devices)
            return self.stand()

    def jog(self, *, table_deg: float | None = None, stage_mm: float | None = None) -> Stand:
        """Move to a position, the stage first.

        Raises
        ------
        Refused
            Not homed, or outside the soft limits; nothing has moved then.
        """
        with self._moving() as pause:
            if stage_mm is not None:
                self._axis("stage").move_to(stage_mm, pause)
            if table_deg is not None:
                self._axis("table").move_to(math.radians(table_deg), pause)
        return self.stand()

    def jog_by(self, *, table_deg: float = 0.0, stage_mm: float = 0.0) -> Stand:
        """Move by a distance from where it stands; unhomed by one degree or millimetre at most."""
        with self._moving() as pause:
            if stage_mm:
                _move_by(self._axis("stage"), stage_mm, pause)
            if table_deg:
                _move_by(self._axis("table"), math.radians(table_deg), pause)
        return self.stand()

    def check_table(self, *, turns: int = 0) -> float | None:
        """Look whether the table's home switch is where it was; how many degrees it is off.

        For a table whose position is counted: steps that were lost since it was homed show here and
        nowhere else, and after whole `turns` a wrong number of steps a degree. None for a table
        that is read back by a sensor of its own.

        Raises
        ------
        Refused
            Off by more than its tolerance, and no longer homed; or its switch cannot be looked for.
        """
        table = self._devices.table
        if not isinstance(table, GrblAxis):
            return None
        with self._moving() as pause:
            return math.degrees(table.check_reference(pause, turns=turns))

    def stop(self) -> Stand:
        """Laser off, then both axes stopped and seen to stand; whatever fails, the rest is done.

        Raises
        ------
        Refused
            Something was not read back as it should be: press the emergency stop.
        """
        at = self._devices
        at.safety.tell(Event.STOP)
        with self._attention.at_work(StopRequest()):
            at.rest.come()
            found = self._standing()
            if at.safety.state is State.STOPPING:
                at.safety.tell(Event.STANDS)
            return found

    def acknowledge(self) -> Stand:
        """Say that the cause of a fault or an emergency stop is gone; the devices are asked.

        Nothing moves and nothing is lit by it; after an emergency stop it must be homed anew.

        Raises
        ------
        NotNow
            There is nothing to acknowledge.
        InputTripped, DriverError
            It is not gone.
        """
        with self._attention.at_work(StopRequest()):
            acknowledge(self._devices)
            return self.stand()

    def profile(self) -> Profile:
        """One profile, the laser on for it and off again.

        Raises
        ------
        NoReply
            No profile came; says what to check.
        """
        with self.lit() as look:
            return look()

    @contextmanager
    def lit(self) -> Iterator[Callable[[], Profile]]:
        """Have the laser on inside the block; each call of what it yields is a fresh profile.

        Between two calls no more than 50 ms may pass, or the lease lapses and the laser is off.
        """
        at, stop = self._devices, StopRequest()
        pause = pausing(at.lease, lambda: self._look(stop), at.sleep)
        with self._attention.at_work(stop), at_rest_unless_done(at):
            make_known(at)
            arm(at, pause)
            with lasing(at.laser, at.lease) as keep_on:
                yield lambda: self._fresh(keep_on, stop)

    def begin(self, work: Closes) -> None:
        """Note what is under way: it ends with the station, or before the next of its kind."""
        self.end_work()
        self._under_way = work

    def end_work(self) -> None:
        """End what is under way, such as a scan; the devices stay open."""
        if self._under_way is not None:
            self._under_way.close()
            self._under_way = None

    def _fresh(self, keep_on: Callable[[], None], stop: StopRequest) -> Profile:
        """The next profile that is exposed from now on."""
        at = self._devices
        at.profiler.discard()
        deadline_s = at.clock() + _EXPOSURE_S
        while True:
            self._look(stop)
            keep_on()
            at.safety.tell(Event.EXPOSED)
            try:
                return next(at.profiler.profiles(_LOOK_S))
            except NoReply:
                if at.clock() >= deadline_s:
                    raise

    @contextmanager
    def _working(self) -> Iterator[Pause]:
        """Work that looks for a stop while it waits; left badly, the station comes to rest."""
        stop = StopRequest()
        at = self._devices
        pause = pausing(at.lease, lambda: self._look(stop), at.sleep)
        with self._attention.at_work(stop), at_rest_unless_done(at):
            yield pause

    @contextmanager
    def _moving(self) -> Iterator[Pause]:
        """A move by hand; a driver refuses what is not homed or lies outside."""
        with self._working() as pause:
            make_known(self._devices)
            self._devices.safety.ask(Event.JOG)
            yield pause
            self._devices.safety.tell(Event.ARRIVED)

    def _look(self, stop: StopRequest) -> None:
        """Raise what ends the work: a stop, or the hardware's safety chain."""
        stop.look()
        self._devices.safety.look()

    def _axis(self, name: str) -> Axis:
        return self._devices.table if name == "table" else self._devices.stage

    def _standing(self) -> Stand:
        """Wait until both axes stand; says what does not come to rest."""
        at = self._devices
        deadline_s = at.clock() + _BRAKING_S
        while True:
            found = self.stand()
            if found.laser_on and not isinstance(self.settings.laser, NoLaserSwitch):
                raise Refused("laser: it reads on after off was sent; press the emergency stop")
            moving = [
                name
                for name, state in (("table", found.table), ("stage", found.stage))
                if state.motion in _UNDER_WAY
            ]
            if not moving:
                return found
            if at.clock() >= deadline_s:
                raise Refused(
                    f"{moving[0]}: still moves {_BRAKING_S} s after its stop; press the"
                    " emergency stop"
                )
            at.sleep(LONGEST_WAIT_S)


def _move_by(axis: Axis, distance: float, pause: Pause) -> None:
    here = axis.state()
    move = axis.move_to if here.homed else axis.jog_to
    move(here.position + distance, pause)
