"""The spindle output of a Grbl board as a laser switch, and its control pins as a safety chain.

On is ``M3 S`` at the fastest speed that the board allows, in spindle mode ($32=0): in laser mode
the output would follow the motion. Off is a soft reset, because M5 waits behind what was queued; it
loses the position of a board that moves, so the board that moves the table is not the laser's
unless axes only move in the dark, as they do here: then nothing moves while it is lit.

Read back is the ``FS:`` field of a report: what the firmware drives, not what the contact does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from drivers.axis import Identity
from drivers.endings import insist_dark, unless_done
from drivers.errors import LinkLost, NoReply, Refused
from drivers.grbl.conversation import BANNER_S, QUIET_S, Conversation, identity_of
from drivers.grbl.messages import State, Status
from drivers.grbl.wire import Realtime
from drivers.inputs import Inputs
from drivers.laser import Guarantee
from drivers.links import ByteLink
from drivers.recipes import Order, Recipe, Word

_RESET_S: Final = 0.1  # a board that is up greets within milliseconds
_REPORT_S: Final = 0.05


class GrblLaser:
    """A board whose spindle output is the laser's supply or interlock; keeps `LaserSwitch`."""

    def __init__(
        self, link: ByteLink, *, name: str = "laser board", clock: Callable[[], float]
    ) -> None:
        self._name = name
        self._talk = Conversation(link, name, clock)
        self._fastest_rpm: float | None = None
        self._patience_s = BANNER_S  # opening the port may have reset the board

    def identify(self) -> Identity:
        """Reset the board, ask who it is, and compare its mode.

        Raises
        ------
        Refused
            It is in laser mode, or its fastest spindle is 0.
        """
        return self._talk.insist(self._introduced)

    def _introduced(self) -> Identity:
        self._talk.drain()
        self._talk.reset(None, within_s=BANNER_S)
        self._talk.until(lambda: False, QUIET_S, None)
        self._talk.dialogue.reset_asked = False
        self._talk.status(None)
        self._talk.dialogue.settings.clear()
        for line in ("$X", "$I", "$$"):
            self._talk.exchange(line, None)
        self._check_mode()
        self._fastest_rpm = self._talk.rate(30)
        return identity_of(self._talk)

    def inspect(self) -> Identity:
        """As `identify`, without the reset; see `drivers.inspection`."""
        identity = self._talk.introduced()
        self._check_mode()
        return identity

    def counters(self) -> dict[str, int]:
        """How the line fares; see `drivers.inspection`."""
        return self._talk.counters()

    def _check_mode(self) -> None:
        if self._talk.setting(32):
            raise Refused(
                f"{self._name}: is in laser mode, its output follows the motion; set $32=0", code=32
            )

    def guarantee(self) -> Guarantee:
        """Promise nothing; nothing is sent."""
        return Guarantee(
            None,
            f"{self._name}: Grbl keeps its output when nobody talks to it; nothing turns the laser"
            " off when this program and its guard are dead: stay at the station",
        )

    def on(self) -> None:
        """Switch on and read back; off again where that fails. Called again, it only reads back.

        Raises
        ------
        Refused
            The output did not follow, or the board is in an alarm.
        """
        with unless_done(self.off):
            if self._fastest_rpm is None:
                self.identify()
            if not self.is_on():
                self._talk.exchange(f"M3S{self._fastest_rpm:.0f}", None)
                if not self.is_on():
                    raise Refused(f"{self._name}: the output did not go on; is it in an alarm?")

    def off(self) -> None:
        """Reset the board and read back, three tries.

        Raises
        ------
        Refused
            Not confirmed: press the emergency stop.
        """
        insist_dark(self._put_out, self._name)

    def _put_out(self) -> bool:
        try:
            self._talk.reset(None, within_s=self._patience_s)
            self._patience_s = _RESET_S
            self._talk.dialogue.reset_asked = False
            return not self.is_on()
        except LinkLost:
            self._patience_s = BANNER_S  # opening it again may reset the board
            raise

    def is_on(self) -> bool:
        """Read the spindle's speed back."""
        return self._report().spindle != 0.0

    def read(self) -> Inputs:
        """Read the control pins: R is the emergency stop's, D the interlock's."""
        status = self._report()
        door = status.state is State.DOOR or "D" in status.pins
        return Inputs(estop_pressed="R" in status.pins, interlock_open=door)

    def recipes(self) -> tuple[Recipe, ...]:
        """Reset, and read back; see `drivers.recipes`."""
        reset = Word(Realtime.RESET.wire, rb"Grbl\w* \S+ \[", 0.05)
        dark = Word(Realtime.STATUS.wire, rb"<[^>]*\|FS:[0-9.]+,0[|>]", 0.05)
        return (Recipe(self._name, Order.LASER, (reset,), (dark,)),)

    def _report(self) -> Status:
        for _ in range(2):
            status = self._talk.report(None, within_s=_REPORT_S)
            if status is not None:
                if status.spindle is None:
                    raise Refused(f"{self._name}: reports no spindle speed; set $10=3")
                return status
        raise NoReply(
            f"{self._name}: no report in {2 * _REPORT_S} s; is the board on, and is this its port?"
        )
