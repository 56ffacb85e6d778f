r"""A rotary table or a linear stage on a Zaber device.

Each reply carries BUSY or IDLE and the highest warning flag, so that the end of a move and the loss
of the reference are seen in every answer, whatever was asked::

    move abs   OK BUSY --   ~~~ BUSY --   IDLE --    warnings   get pos
               taken, once      status asked         all flags  compared

Where there is an encoder the position read back is what it measures; without one it is what the
device counted, and steps that were lost do not show in it.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Final

from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.endings import stop_or_refuse, unless_done
from drivers.errors import DriverError, FrameError, NoReply, Refused
from drivers.recipes import Order, Recipe, Word
from drivers.zaber.chain import Chain
from drivers.zaber.names import UNREFERENCED, flag_name, flag_remedy, is_fault
from drivers.zaber.settings import Settings
from drivers.zaber.wire import Reply, command_bytes

_POLL_S: Final = 0.02
_UNHOMED_JOG: Final = 1.0  # degree or mm, from where the axis stands
_FIRMWARES: Final = ("6", "7")
_FAULT_CODE: Final = 1
_STOP_ID, _ASK_ID = 98, 99  # of a program that is dead nobody waits for these
_ANSWER_S: Final = 0.1
_REST_S: Final = 1.0  # longer than a stage brakes


class ZaberAxis:
    """One axis of a device on a chain; keeps `drivers.axis.Axis`.

    "Homed" is this object's own knowledge: it starts without, and forgets it on a fault, on a flag
    that says the reference is lost, on a lost link, and when the position read back is off.
    """

    def __init__(self, chain: Chain, settings: Settings) -> None:
        self._chain = chain
        self._settings = settings
        self._identity: Identity | None = None
        self._acceleration_wire = 0
        self._zero = 0  # what the device counts where homing ended
        self._homed_at: int | None = None  # the chain's count of losses then
        self._homing = False

    @property
    def kind(self) -> Kind:
        """Rotary or linear."""
        return self._settings.kind

    def identify(self) -> Identity:
        """Ask the device who it is and compare its settings; see `Axis.identify`.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            Another serial number, firmware, resolution, or narrower limits than the station's.
        """
        return self._identity or self._open(None)

    def inspect(self) -> Identity:
        """As `identify`, by questions alone; see `drivers.inspection`."""
        return self._introduced(None)

    def state(self) -> AxisState:
        """Status, flags and position; see `Axis.state`."""
        return self._state_of(self._status(None), None)

    def home(self, pause: Pause) -> AxisState:
        """Let the device find its home sensor; see `Axis.home`."""
        self._ready(pause)
        self._homed_at = None
        self._clear_flags(pause)
        with unless_done(self._give_up):
            self._homing = True
            lost = self._start("home", pause)
            reply = self._until_idle("homing", self._settings.homing_s, lost, pause)
            self._homing = False
            self._must_be_sound("homing", pause)
            if reply.flag in UNREFERENCED:
                raise Refused(
                    f"{self._name}: homing ended with {flag_name(reply.flag)}; check the home"
                    " sensor and what is in the way"
                )
            self._zero = self._count("pos", pause)
            self._homed_at = self._chain.losses
            return self._state_of(reply, pause)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move, wait, read the position back and compare; see `Axis.move_to`."""
        self._settings.check_limits(position)
        self._must_be_homed()
        self._ready(pause)
        self._must_be_homed()  # the device may have said otherwise
        target = self._zero + self._settings.microsteps(position)
        way = target - self._count("pos", pause)
        return self._travel(f"move abs {target}", way, position, pause)

    def jog_to(self, position: float, pause: Pause) -> AxisState:
        """Move slowly for a person; unhomed by a degree or a millimetre at most."""
        self._settings.check_limits(position)
        self._ready(pause)
        here = self._position(pause)
        if not self._homed and abs(self._settings.to_wire(position - here)) > _UNHOMED_JOG:
            raise Refused(
                f"{self._name}: not homed; it jogs at most {_UNHOMED_JOG:g} {self._settings.unit}"
            )
        way = self._settings.microsteps(position) - self._settings.microsteps(here)
        return self._travel(f"move rel {way}", way, position, pause)

    def stop(self) -> None:
        """Stop, decelerating; written at once, behind no reply that is still to come."""
        self._homing = False
        self._chain.stop(self._settings.device, self._settings.axis)

    def recipes(self) -> tuple[Recipe, ...]:
        """Stop, and ask until it is idle; see `drivers.recipes`."""
        device, axis = self._settings.device, self._settings.axis
        stop = command_bytes(device, axis, _STOP_ID, "stop")
        ask = command_bytes(device, axis, _ASK_ID, "")
        heard, idle = (
            b"@%02d %d %02d OK %s" % (device, axis, number, state)
            for number, state in ((_STOP_ID, b"(?:IDLE|BUSY) "), (_ASK_ID, b"IDLE "))
        )
        stopped, stands = Word(stop, heard, _ANSWER_S), Word(ask, idle, _ANSWER_S)
        return (Recipe(self._name, Order.AXIS, (stopped,), (stands,), rest_s=_REST_S),)

    # --- moving

    def _travel(self, command: str, way: int, position: float, pause: Pause) -> AxisState:
        within_s = self._settings.move_s(way, self._acceleration_wire)
        with unless_done(self._give_up):
            lost = self._start(command, pause)
            aim = f"the move to {self._settings.to_wire(position):.3f} {self._settings.unit}"
            reply = self._until_idle(aim, within_s, lost, pause)
            flags = self._must_be_sound(aim, pause)
            state = self._state_of(reply, pause)
            self._must_have_arrived(position, state, flags, lost)
            return state

    def _start(self, command: str, pause: Pause | None) -> DriverError | None:
        """Send it once. A lost answer is returned: what is read next tells what became of it."""
        try:
            self._order(command, pause)
        except (NoReply, FrameError) as lost:
            return lost
        return None

    def _until_idle(
        self, aim: str, within_s: float, lost: DriverError | None, pause: Pause
    ) -> Reply:
        deadline_s = self._chain.clock() + within_s
        begun = False
        while True:
            reply = self._status(pause)
            begun |= reply.busy
            if not reply.busy:
                if lost is not None and self._homing and not begun:
                    raise NoReply(
                        f"{self._name}: {aim} was not answered and was not repeated; home again"
                    ) from lost
                return reply
            if self._chain.clock() >= deadline_s:
                raise Refused(
                    f"{self._name}: {aim} was not over after {within_s:.1f} s; told to stop; is it"
                    " blocked?"
                )
            pause(_POLL_S)

    def _must_have_arrived(
        self, position: float, state: AxisState, flags: tuple[str, ...], lost: DriverError | None
    ) -> None:
        settings = self._settings
        if abs(state.position - position) <= settings.tolerance:
            return
        asked, found = settings.to_wire(position), settings.to_wire(state.position)
        told = ", ".join(map(flag_name, flags)) or "no flag"
        said = (
            f"{self._name}: asked for {asked:.3f} {settings.unit}, stands at {found:.3f},"
            f" tolerance {settings.to_wire(settings.tolerance):.3f}, {told}"
        )
        if lost is not None:
            raise NoReply(
                f"{said}; the answer to the move was lost, it was not sent again"
            ) from lost
        self._homed_at = None
        raise Refused(f"{said}; remove what is in its way, then home")

    def _give_up(self) -> None:
        self._homing = False
        stop_or_refuse(self.stop, self._name)

    # --- what it must be

    def _ready(self, pause: Pause) -> None:
        if self._identity is None:
            self._open(pause)
        reply = self._status(pause)
        if reply.busy:
            raise Refused(f"{self._name}: is still moving; stop it first")

    def _must_be_homed(self) -> None:
        if not self._homed:
            raise Refused(f"{self._name}: not homed, its position means nothing; home it first")

    def _clear_flags(self, pause: Pause) -> None:
        """Flags of before are no news of this homing; a fault that stays is."""
        self._start("warnings clear", pause)
        self._must_be_sound("homing", pause)

    def _must_be_sound(self, during: str, pause: Pause) -> tuple[str, ...]:
        """All flags that stand, none of them a fault."""
        flags = self._flags(pause)
        for flag in flags:
            if is_fault(flag):
                self._homed_at = None
                raise Refused(
                    f"{self._name}: {flag_name(flag)} during {during}; {flag_remedy(flag)}",
                    code=_FAULT_CODE,
                )
        return flags

    # --- asking

    def _open(self, pause: Pause | None) -> Identity:
        """Who it is, and whether it is what the station says; moves nothing."""
        self._homed_at = None
        device = self._settings.device
        first = self._chain.ask(device, 0, "get deviceid", pause)
        if not first.checked:
            with suppress(NoReply, FrameError):  # the next reply shows whether it was heard
                self._chain.order(device, 0, "set comm.checksum 1", pause)
        self._chain.expect_checks(device)
        identity = self._introduced(pause)
        self._set_speed(pause)
        self._identity = identity
        return identity

    def _introduced(self, pause: Pause | None) -> Identity:
        settings, device = self._settings, self._settings.device
        identity = Identity(
            family="zaber",
            model=f"device id {self._chain.ask(device, 0, 'get deviceid', pause).data}",
            firmware=self._chain.ask(device, 0, "get version", pause).data,
            serial=self._chain.ask(device, 0, "get system.serial", pause).data,
        )
        if settings.serial and identity.serial != settings.serial:
            raise Refused(
                f"{self._name}: serial number {identity.serial} answers as device {device},"
                f" {settings.serial} expected; renumber it or correct the station"
            )
        if identity.firmware.partition(".")[0] not in _FIRMWARES:
            raise Refused(
                f"{self._name}: firmware {identity.firmware}; this driver speaks to 6 and 7"
            )
        self._check_scale(pause)
        self._check_limits(pause)
        return identity

    def _check_scale(self, pause: Pause | None) -> None:
        found = self._count("resolution", pause)
        if found != self._settings.resolution:
            raise Refused(
                f"{self._name}: the device has a resolution of {found} microsteps, the station says"
                f" {self._settings.resolution}; every position would be wrong: correct one"
            )
        if self._settings.encoder:
            try:
                self._count("encoder.pos", pause)
            except Refused as refused:
                raise Refused(
                    f"{self._name}: has no encoder to read back; set encoder = false"
                ) from refused

    def _check_limits(self, pause: Pause | None) -> None:
        low, high = self._count("limit.min", pause), self._count("limit.max", pause)
        settings = self._settings
        for each in (settings.lower, settings.upper):
            if not low <= settings.microsteps(each) <= high:
                raise Refused(
                    f"{self._name}: {settings.to_wire(each):.3f} {settings.unit} lies outside the"
                    f" device's own limits, {low} to {high} microsteps; narrow the station's"
                )

    def _set_speed(self, pause: Pause | None) -> None:
        """Written only where it differs: the device keeps its settings for good."""
        wanted = self._settings.speed_wire
        if self._count("maxspeed", pause) != wanted:
            lost = self._start(f"set maxspeed {wanted}", pause)
            found = self._count("maxspeed", pause)
            if found != wanted:
                raise Refused(
                    f"{self._name}: maxspeed is {found}, {wanted} was to be set; is it too fast?"
                ) from lost
        self._acceleration_wire = self._count("accel", pause)

    def _status(self, pause: Pause | None) -> Reply:
        return self._ask("", pause)

    def _ask(self, query: str, pause: Pause | None) -> Reply:
        reply = self._chain.ask(self._settings.device, self._settings.axis, query, pause)
        return self._noted(reply)

    def _order(self, command: str, pause: Pause | None) -> Reply:
        reply = self._chain.order(self._settings.device, self._settings.axis, command, pause)
        return self._noted(reply)

    def _noted(self, reply: Reply) -> Reply:
        """Forget "homed" where the flag says so."""
        if is_fault(reply.flag) or reply.flag in UNREFERENCED:
            self._homed_at = None
        return reply

    def _flags(self, pause: Pause | None) -> tuple[str, ...]:
        count, *flags = self._ask("warnings", pause).data.split()
        if not count.isdecimal() or int(count) != len(flags):
            raise FrameError(f"{self._name}: flags {count} {flags}, of which the number is wrong")
        return tuple(flags)

    def _count(self, setting: str, pause: Pause | None) -> int:
        data = self._ask(f"get {setting}", pause).data
        try:
            value = float(data)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise FrameError(f"{self._name}: {setting} is {data!r}, a number was due")
        return round(value)

    # --- what replies mean

    def _state_of(self, reply: Reply, pause: Pause | None) -> AxisState:
        motion, alarm = Motion.STANDING, ""
        if reply.busy:
            motion = Motion.HOMING if self._homing else Motion.MOVING
        elif is_fault(reply.flag):
            motion, alarm = Motion.ALARM, flag_name(reply.flag)
        position = self._position(pause)  # may forget "homed"
        return AxisState(motion, position, self._homed, alarm)

    def _position(self, pause: Pause | None) -> float:
        counted = self._count("encoder.pos" if self._settings.encoder else "pos", pause)
        return self._settings.position(counted - self._zero)

    @property
    def _homed(self) -> bool:
        return self._homed_at == self._chain.losses

    @property
    def _name(self) -> str:
        return self._settings.name
