"""One port of a Hokuyo sensor, which its two roles share: profiler and laser switch.

Every wait is bounded by the clock that was handed in. A command is written at once, whatever reply
is still due: a QT waits for nobody, only its confirmation comes behind a scan that is under way.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from drivers.axis import Identity
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.hokuyo.codes import MISHEARD, OK, status_name
from drivers.hokuyo.wire import Asked, Dialogue, Reply, fields_of
from drivers.links import ByteLink

BITS_A_CHARACTER: Final = 10
REPLY_S: Final = 0.1  # beyond what the line itself takes
_STEP_S: Final = 0.005
_LATE_S: Final = 0.02
_SCIP_2: Final = b"SCIP2.0\n"  # a URG-04LX begins in SCIP 1.1
_SWITCHING_S: Final = 0.05


class ScipLine:
    """Commands with tags over a link; replies found by their echo.

    Parameters
    ----------
    link : ByteLink
        The port; this line is its only holder, and whoever opened it closes it.
    longest_reply_s : float
        On the wire, and so the longest that another waits behind it.
    baud : int
        Of a real serial line; None on USB, where bytes take no time worth counting.
    """

    def __init__(
        self,
        link: ByteLink,
        *,
        longest_reply_s: float = 0.0,
        baud: int | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.clock = clock
        self.dialogue = Dialogue()
        self.reply_s = REPLY_S + longest_reply_s
        self._baud = baud
        self._asked = self._timeouts = 0
        self._link = link
        self._torn = False

    @property
    def address(self) -> str:
        """The address of the link, for messages."""
        return self._link.address

    def counters(self) -> dict[str, int]:
        """How the line fares; see `drivers.inspection`."""
        return {
            "asked": self._asked,
            "timeouts": self._timeouts,
            "damaged": self.dialogue.damaged,
            "late": self.dialogue.strays,
        }

    def wire_s(self, size: int) -> float:
        """Seconds that so many bytes take."""
        return size * BITS_A_CHARACTER / self._baud if self._baud else 0.0

    def send(self, command: str) -> Asked:
        """Write a command now; its reply is taken from `dialogue`."""
        asked, data = self.dialogue.send(command)
        # An empty line ends what a write that failed has left in the sensor.
        if self._torn:
            data = b"\n" + data
        self._torn = True
        try:
            self._link.write(data)
        except LinkLost:
            self.dialogue.give_up(asked)
            raise
        self._torn = False
        return asked

    def end_torn_commands(self) -> None:
        """Let the next command begin with an empty line, as a first one must."""
        self._torn = True

    def listen(self, timeout_s: float) -> bool:
        """Take what comes, for one short wait; whether anything did."""
        data = self._link.read(max(timeout_s, 0.0))
        self.dialogue.feed(data)
        return bool(data)

    def ask(self, command: str) -> Reply:
        """Ask what changes nothing; asked once more if no sound reply came.

        Raises
        ------
        NoReply, FrameError, LinkLost
        """
        try:
            return self.order(command)
        except (NoReply, FrameError):
            return self.order(command)

    def order(self, command: str) -> Reply:
        """Send a command once and return its reply, whatever the sensor says to what it heard.

        Raises
        ------
        NoReply, LinkLost
        FrameError
            Damaged replies and none to this, or the sensor heard another line.
        """
        damaged = self.dialogue.damaged
        asked = self.send(command)
        self._asked += 1
        deadline_s = self.clock() + self.reply_s
        try:
            while (reply := self.dialogue.take(asked)) is None:
                left_s = deadline_s - self.clock()
                heard = self.listen(min(max(left_s, 0.0), _STEP_S))
                # What is there already is heard, however late we come, but not for ever.
                if left_s <= (-_LATE_S if heard else 0.0):
                    break
        finally:
            self.dialogue.give_up(asked)
        if reply is not None and reply.status not in MISHEARD:
            return reply
        # Half a command may lie in the sensor; the next would be taken for its rest.
        self.end_torn_commands()
        if reply is not None:
            raise FrameError(
                f"hokuyo at {self.address}: heard no {command}, status {reply.status}:"
                f" {status_name(reply.status)}; check the cable"
            )
        self._timeouts += 1
        if damaged := self.dialogue.damaged - damaged:
            raise FrameError(
                f"hokuyo at {self.address}: {damaged} damaged replies and none to {command}; check"
                " the cable and the baud rate"
            )
        raise NoReply(
            f"hokuyo at {self.address}: no reply to {command} in {self.reply_s:.2f} s; is the"
            " sensor on, and the baud rate its own?"
        )

    def fields(self, command: str, *needed: str) -> dict[str, str]:
        """Ask VV, PP or II for its lines.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            Another status than 00.
        """
        reply = self.ask(command)
        if reply.status != OK:
            raise refusal(self.address, command, reply.status)
        return fields_of(reply, needed)

    def identify(self) -> Identity:
        """Ask the sensor who it is; one that speaks SCIP 1.1 is told to speak 2.0.

        Raises
        ------
        Refused
            Another maker's device, or another protocol.
        """
        self.end_torn_commands()
        try:
            self.order("VV")
        except (NoReply, FrameError):
            self._speak_scip_2()
        said = self.fields("VV", "VEND", "PROD", "FIRM", "PROT", "SERI")
        if "hokuyo" not in said["VEND"].lower():
            raise Refused(
                f"hokuyo at {self.address}: the vendor is {said['VEND']!r}; is the port right?"
            )
        if not said["PROT"].startswith("SCIP 2"):
            raise Refused(
                f"hokuyo at {self.address}: speaks {said['PROT']!r}; this driver needs SCIP 2"
            )
        return Identity("hokuyo", said["PROD"], said["FIRM"], said["SERI"])

    def _speak_scip_2(self) -> None:
        self._link.write(b"\n" + _SCIP_2)
        deadline_s = self.clock() + _SWITCHING_S
        while (left_s := deadline_s - self.clock()) > 0.0:
            self.listen(min(left_s, _STEP_S))


def refusal(address: str, command: str, status: str) -> DriverError:
    """Return the error of a status that is not the one that was due."""
    code = int(status) if status.isdecimal() else None
    return Refused(
        f"hokuyo at {address}: {command} was refused with status {status}: {status_name(status)}",
        code=code,
    )
