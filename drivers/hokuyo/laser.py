"""The laser of a Hokuyo sensor as a switch: BM lights it, QT puts it out, II reads it back.

The specification (C-42-03320B, page 14) has no watchdog: nothing turns the laser off when nobody
talks to the sensor, so that such a station refuses unattended runs.
"""

from __future__ import annotations

from typing import Final

from drivers.axis import Identity
from drivers.endings import insist_dark, unless_done
from drivers.errors import FrameError, Refused
from drivers.hokuyo.codes import ALREADY, OK
from drivers.hokuyo.line import ScipLine, refusal
from drivers.laser import Guarantee
from drivers.recipes import Order, Recipe, Word

_LASER: Final = "LASR"


class HokuyoLaser:
    """Keeps `drivers.laser.LaserSwitch`; shares its line with the profiler of the same sensor."""

    def __init__(self, line: ScipLine, *, name: str = "laser of the scanner") -> None:
        self._line = line
        self._name = name

    def identify(self) -> Identity:
        """Ask who it is, and whether its laser can be read back; switches nothing.

        Raises
        ------
        Refused, FrameError
        """
        identity = self._line.identify()
        self.is_on()
        return identity

    def guarantee(self) -> Guarantee:
        """Promise nothing; nothing is sent."""
        return Guarantee(
            None,
            f"{self._name}: SCIP 2.0 has no watchdog; nothing turns the laser off when this program"
            " and its guard are dead: stay at the station",
        )

    def on(self) -> None:
        """Switch on and read back; off again where that fails. Called again, it only reads back.

        Raises
        ------
        Refused
            The laser did not go on; says the sensor's status.
        """
        with unless_done(self.off):
            if self.is_on():
                return
            reply = self._line.ask("BM")  # may be said twice: 02 is no error
            if reply.status not in (OK, ALREADY):
                raise refusal(self._line.address, "BM", reply.status)
            if not self.is_on():
                raise Refused(f"{self._name}: the laser did not go on; is it in a fault?")

    def off(self) -> None:
        """Write QT at once, whatever reply is due, and read back; three tries.

        Raises
        ------
        Refused
            Not confirmed: press the emergency stop.
        """
        insist_dark(self._put_out, self._name)

    def _put_out(self) -> bool:
        self._line.end_torn_commands()
        self._line.dialogue.give_up(self._line.send("QT"))  # only II confirms it
        return not self._reads_on_once()

    def is_on(self) -> bool:
        """Read the laser's state back."""
        return self._lit(self._line.fields("II", _LASER)[_LASER])

    def recipes(self) -> tuple[Recipe, ...]:
        """QT behind an empty line, which ends a command that broke off; see `drivers.recipes`."""
        within_s = min(self._line.reply_s, 1.0)
        off = Word(b"\nQT\n", rb"QT\n00P\n", within_s)
        dark = Word(b"II\n", rb"\nLASR:OFF;7\n", within_s)
        wire_s = self._line.wire_s(len(off.send))
        return (Recipe(self._name, Order.LASER, (off,), (dark,), wire_s=wire_s),)

    def _reads_on_once(self) -> bool:
        """As `is_on`, asked once: an off has tries of its own."""
        reply = self._line.order("II")
        found = dict(each.split(":", 1) for each in reply.lines if ":" in each)
        return self._lit(found.get(_LASER, ""))

    def _lit(self, said: str) -> bool:
        if said not in ("ON", "OFF"):
            raise FrameError(f"{self._name}: says {said!r} of its laser; ON or OFF was due")
        return said == "ON"
