"""What a block of G-code asks for, checked as the firmware checks it, and where the parser stands.

The parser runs ahead of the motor: its position is where the last move it accepted will end.
Angles are degrees of the table in machine coordinates; a letter without a motor is read, and moves
nothing::

    machine = work + coordinate system (G54..G59) + G92
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim.grbl.gcode import Block, Modes, read_block
from sim.grbl.moves import Motion, Pace
from sim.grbl.numbers import MM_PER_INCH, single
from sim.grbl.refusal import Error, Refusal
from sim.grbl.settings import SYSTEMS, Eeprom

_INCHES, _INCREMENTAL = 20, 91
_DWELL, _STORE_OFFSET, _MACHINE, _OFFSET, _NO_OFFSET = 4.0, 10.0, 53.0, 92.0, 92.1
_JOG_GROUPS = frozenset({"distance", "units", "action"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A checked block: what is to be done, in this order."""

    modes: Modes
    feed_deg_min: float
    speed_rpm: float
    tool: int
    dwell_s: float | None
    stored: tuple[int, float] | None  # G10: which system, its new offset
    g92_deg: float | None
    motion: Motion | None
    flow: int | None


class Parser:
    """The state of the firmware's G-code parser; a reset makes a new one."""

    def __init__(self, eeprom: Eeprom, axes: str, letter: str, position_deg: float) -> None:
        self.modes = Modes()
        self.feed_deg_min = 0.0
        self.speed_rpm = 0.0
        self.tool = 0
        self.g92_deg = 0.0
        self.position_deg = position_deg
        self._eeprom = eeprom
        self._axes = axes
        self._letter = letter

    @property
    def offset_deg(self) -> float:
        """From machine to work coordinates: the WCO of the reports."""
        return single(self._eeprom.offsets_deg[self.modes.system] + self.g92_deg)

    def order(self, line: str) -> Order:
        """Check a line; raises `Refusal`, and changes nothing either way."""
        block = read_block(line, self._axes, self.modes)
        feed_deg_min = self._feed_deg_min(block)
        self._check_action(block)
        self._check_motion(block, feed_deg_min)
        self._check_used(block, "FNST")
        return Order(
            modes=block.modes,
            feed_deg_min=feed_deg_min,
            speed_rpm=block.values.get("S", self.speed_rpm),
            tool=int(block.values.get("T", 0)),  # forgotten with the next line
            dwell_s=block.values["P"] if block.action == _DWELL else None,
            stored=self._stored(block) if block.action == _STORE_OFFSET else None,
            g92_deg=self._new_g92_deg(block),
            motion=self._motion(block, feed_deg_min) if _moves(block, self._axes) else None,
            flow=block.flow,
        )

    def jog(self, line: str) -> Motion:
        """Check what stands behind `$J=`; raises `Refusal`, and changes nothing either way."""
        block = read_block(line, self._axes, replace(self.modes, motion=1))
        if "F" not in block.values:
            raise Refusal(Error.NO_FEED_RATE)
        self._check_action(block)
        self._check_motion(block, block.values["F"])
        self._check_used(block, "FN")
        if block.groups - _JOG_GROUPS or block.action not in (None, _MACHINE):
            raise Refusal(Error.INVALID_JOG)
        # The firmware does not look for axis words here: without any it goes to machine zero.
        target_deg = self._target_deg(block) if _has_axis_words(block, self._axes) else 0.0
        return Motion(target_deg, self._feed_deg_min(block), Pace.JOG)

    def must_wait(self, order: Order) -> bool:
        """Whether every queued move has to end before an order is done."""
        switched = [
            (modes.system, modes.spindle, modes.coolant) for modes in (self.modes, order.modes)
        ]
        waited_for = (order.dwell_s, order.stored, order.g92_deg)
        return switched[0] != switched[1] or any(each is not None for each in waited_for)

    def accept(self, order: Order) -> bool:
        """Take over all of an order but its target; return whether the work offset was touched."""
        touched = order.modes.system != self.modes.system or order.g92_deg is not None
        self.modes = order.modes
        self.feed_deg_min, self.speed_rpm = order.feed_deg_min, order.speed_rpm
        self.tool = order.tool
        if order.g92_deg is not None:
            self.g92_deg = order.g92_deg
        if order.stored is not None:
            system, self._eeprom.offsets_deg[system] = order.stored
            touched = touched or system == self.modes.system
        return touched

    def _feed_deg_min(self, block: Block) -> float:
        if "F" not in block.values:
            return self.feed_deg_min
        return block.values["F"] * _unit(block)

    def _check_action(self, block: Block) -> None:
        axis_words = _has_axis_words(block, self._axes)
        if block.action == _DWELL and "P" not in block.values:
            raise Refusal(Error.VALUE_MISSING)
        if block.action in (_STORE_OFFSET, _OFFSET) and not axis_words:
            raise Refusal(Error.NO_AXIS_WORDS)
        if block.action == _STORE_OFFSET:
            _check_store(block)
        if block.action == _MACHINE and block.modes.motion not in (0, 1):
            raise Refusal(Error.G53_NEEDS_G0_OR_G1)

    def _check_motion(self, block: Block, feed_deg_min: float) -> None:
        axis_words = _has_axis_words(block, self._axes)
        if block.modes.motion == 80:
            if axis_words:
                raise Refusal(Error.AXIS_WORDS_IN_G80)
            return
        explicit = block.axis_command == "motion"
        wanted = explicit or (axis_words and not block.axis_command)
        if wanted and block.modes.motion == 1 and feed_deg_min == 0.0:
            raise Refusal(Error.NO_FEED_RATE)

    def _check_used(self, block: Block, always: str) -> None:
        used = set(always)
        used |= {"P"} if block.action == _DWELL else set()
        used |= {"P", "L"} if block.action == _STORE_OFFSET else set()
        used |= set(self._axes)  # axis words without a command are a motion
        if block.values.keys() - used:
            raise Refusal(Error.UNUSED_WORDS)

    def _motion(self, block: Block, feed_deg_min: float) -> Motion:
        pace = Pace.RAPID if block.modes.motion == 0 else Pace.FEED
        return Motion(self._target_deg(block), feed_deg_min, pace)

    def _target_deg(self, block: Block) -> float:
        if self._letter not in block.values:
            return self.position_deg
        value_deg = block.values[self._letter] * _unit(block)
        if block.action == _MACHINE:
            return single(value_deg)
        if block.modes.distance == _INCREMENTAL:
            return single(value_deg + self.position_deg)
        return single(value_deg + self._eeprom.offsets_deg[block.modes.system] + self.g92_deg)

    def _stored(self, block: Block) -> tuple[int, float]:
        coordinates = int(block.values.get("P", 0.0))
        system = SYSTEMS[coordinates - 1] if coordinates else block.modes.system
        if self._letter not in block.values:
            return system, self._eeprom.offsets_deg[system]
        value_deg = block.values[self._letter] * _unit(block)
        if int(block.values["L"]) == 2:
            return system, single(value_deg)
        return system, single(self.position_deg - self.g92_deg - value_deg)

    def _new_g92_deg(self, block: Block) -> float | None:
        if block.action == _NO_OFFSET:
            return 0.0
        if block.action != _OFFSET:
            return None
        if self._letter not in block.values:
            return self.g92_deg
        system_deg = self._eeprom.offsets_deg[block.modes.system]
        value_deg = block.values[self._letter] * _unit(block)
        return single(self.position_deg - system_deg - value_deg)


def _unit(block: Block) -> float:
    return MM_PER_INCH if block.modes.units == _INCHES else 1.0


def _has_axis_words(block: Block, axes: str) -> bool:
    return bool(block.values.keys() & set(axes))


def _moves(block: Block, axes: str) -> bool:
    wanted = block.axis_command in (None, "motion") and _has_axis_words(block, axes)
    return wanted and block.modes.motion != 80


def _check_store(block: Block) -> None:
    if not block.values.keys() & {"P", "L"}:
        raise Refusal(Error.VALUE_MISSING)
    if not 0 <= int(block.values.get("P", 0.0)) <= len(SYSTEMS):
        raise Refusal(Error.NO_SUCH_COORDINATES)
    if int(block.values.get("L", 0.0)) not in (2, 20):
        raise Refusal(Error.UNSUPPORTED)
    if int(block.values["L"]) == 2 and "R" in block.values:
        raise Refusal(Error.UNSUPPORTED)
