"""From station.toml's [laser] to the switch, and to what reads the hardware's safety chain."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from acquisition.station import (
    GrblLaser,
    HokuyoLaser,
    LaserSettings,
    NoLaserSwitch,
    OutputBy,
    RelayFamily,
    RelayLaser,
)
from drivers import grbl, hokuyo, relay
from drivers.axis import Identity
from drivers.inputs import Inputs, SafetyInputs
from drivers.laser import Guarantee, LaserSwitch
from drivers.links import ByteLink
from drivers.modbus import ModbusBus


class Wires(Protocol):
    """What opens links; `acquisition.opening` has it."""

    clock: Callable[[], float]

    def sleep(self, seconds: float) -> None:
        """Let some time pass."""
        ...

    def link(self, address: str) -> ByteLink:
        """Open an address."""
        ...

    def bus(self, address: str) -> ModbusBus:
        """Open a bus, or give the one that is open."""
        ...

    def scip(self, address: str) -> hokuyo.ScipLine:
        """A Hokuyo scanner's line, which its profiles and its laser's switch share."""
        ...


def switch_of(settings: LaserSettings, wires: Wires) -> tuple[LaserSwitch, SafetyInputs]:
    """Open what switches the laser, and what reads the safety chain.

    Raises
    ------
    ValueError
        What a driver cannot do; nothing has been opened.
    DriverError
        It is not there.
    """
    match settings:
        case NoLaserSwitch():
            return Unswitched(), NotWired()
        case GrblLaser():
            board = grbl.GrblLaser(wires.link(settings.address), clock=wires.clock)
            return board, board if settings.safety_pins else NotWired()
        case HokuyoLaser():
            return hokuyo.HokuyoLaser(wires.scip(settings.address)), NotWired()
        case RelayLaser():
            return _relay(settings, wires)


def _relay(settings: RelayLaser, wires: Wires) -> tuple[LaserSwitch, SafetyInputs]:
    by_coil = settings.output_by is OutputBy.COIL
    if settings.family is not RelayFamily.TURCK and not by_coil:
        raise ValueError(
            f'laser.output_by: a {settings.family.value} relay has coils only; write "coil"'
        )
    bus, device_id = wires.bus(settings.address), settings.device_id
    if settings.family is not RelayFamily.TURCK:
        timed = settings.family is RelayFamily.TIMED
        made = relay.TimedRelay if timed else relay.PlainRelay
        switch = made(bus, device_id, settings.output, clock=wires.clock, sleep=wires.sleep)
        return switch, NotWired()
    block = relay.WatchedBlock(
        bus,
        device_id,
        relay.Coil(settings.output) if by_coil else relay.OutputBit(settings.output),
        watchdog_s=settings.watchdog_s or 0.0,
        clock=wires.clock,
        sleep=wires.sleep,
    )
    wired = (settings.estop_input, settings.interlock_input, settings.key_input)
    if wired == (None, None, None):
        return block, NotWired()
    estop, interlock, key = wired
    return block, relay.BlockInputs(bus, device_id, estop=estop, interlock=interlock, key=key)


class NotWired:
    """No input is wired: the chain is the hardware's alone, and asking it costs nothing."""

    def read(self) -> Inputs:
        """All is as well as software can know."""
        return Inputs()


class Unswitched:
    """No switch: the laser is on while the sensor has power, and nobody claims otherwise."""

    def identify(self) -> Identity:
        """Nobody."""
        return Identity(family="none", model="no laser switch", firmware="")

    def guarantee(self) -> Guarantee:
        """Promise nothing."""
        return Guarantee(
            None,
            "laser: nothing switches it; it is on while the sensor has power: stay at the station",
        )

    def on(self) -> None:
        """Nothing to do."""

    def off(self) -> None:
        """Nothing that could be done."""

    def is_on(self) -> bool:
        """It is."""
        return True
