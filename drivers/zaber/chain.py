"""One serial line with a chain of Zaber devices on it, which several axes may share.

Every wait is bounded by the clock that was handed in. A question is asked twice at most, an order
never; a stop is written at once, whatever is still unanswered.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from drivers.axis import Pause
from drivers.endings import insist
from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.links import ByteLink
from drivers.zaber.names import reason_name
from drivers.zaber.wire import Asked, Dialogue, Reply

REPLY_S: Final = 0.5  # a device answers within 20 ms; 24 of them in a chain pass it on
_REST_S: Final = 5.0  # no reply comes later than that
_STEP_S: Final = 0.005
_AGAIN: Final = "AGAIN"


class _NotNow(Refused):
    """The device asks to be asked again."""


class Chain:
    """Commands with ids over a link; replies found by their id.

    Parameters
    ----------
    link : ByteLink
        The port; this chain is its only holder.
    clock : callable
        Monotonic seconds.
    """

    def __init__(self, link: ByteLink, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.dialogue = Dialogue()
        self._asked = self._timeouts = 0
        self.losses = 0  # of the link: whoever was homed before one is not any more
        self._link = link
        self._torn = False
        self._checks_due: set[int] = set()

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

    def expect_checks(self, device: int) -> None:
        """From now on a reply of this device without a check is damaged."""
        self._checks_due.add(device)

    def ask(self, device: int, axis: int, query: str, pause: Pause | None = None) -> Reply:
        """Ask something that changes nothing; asked again once if no sound answer came.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            Rejected; says the device's reason.
        """
        try:
            return self._exchange(device, axis, query, pause)
        except (NoReply, FrameError, _NotNow):
            pass
        return self._exchange(device, axis, query, pause)

    def order(self, device: int, axis: int, command: str, pause: Pause | None = None) -> Reply:
        """Send something that does something: once, whatever becomes of the answer."""
        return self._exchange(device, axis, command, pause)

    def stop(self, device: int, axis: int) -> None:
        """Stop, acknowledged; a stop may be said again, and waits for no other reply.

        Raises
        ------
        NoReply, FrameError, LinkLost
            It was never acknowledged: press the emergency stop.
        """
        insist(lambda: self._exchange(device, axis, "stop", None), f"zaber {device}")

    def _exchange(self, device: int, axis: int, command: str, pause: Pause | None) -> Reply:
        asked, data = self.dialogue.send(device, axis, command, self.clock())
        damaged = self.dialogue.damaged
        self._asked += 1
        try:
            self._write(data)
            reply = self._reply(asked, pause)
        finally:  # also where the caller's pause raised: the reply may still come
            if asked.message_id in self.dialogue.waiting:
                self.dialogue.give_up(asked, self.clock() + _REST_S)
        return self._sound(asked, reply, self.dialogue.damaged - damaged)

    def _reply(self, asked: Asked, pause: Pause | None) -> Reply | None:
        deadline_s = self.clock() + REPLY_S
        while (reply := self.dialogue.take(asked)) is None:
            left_s = deadline_s - self.clock()
            if left_s <= 0.0:
                return None
            self._listen(min(left_s, _STEP_S), pause)
        return reply

    def _sound(self, asked: Asked, reply: Reply | None, damaged: int) -> Reply:
        self._timeouts += reply is None
        said = f"{self.address}: device {asked.device}, {asked.command or 'status'!r}"
        if reply is None and damaged:
            raise FrameError(f"{said}: {damaged} damaged lines, no sound reply; check the cable")
        if reply is None:
            raise NoReply(
                f"{said}: no reply in {REPLY_S} s; is it powered, its number and baud rate right?"
            )
        if not reply.checked and asked.device in self._checks_due:
            raise FrameError(f"{said}: a reply without its check; was the device reset?")
        if not reply.accepted:
            kind = _NotNow if reply.data == _AGAIN else Refused
            raise kind(f"{said}: rejected, {reason_name(reply.data)}")
        return reply

    def _listen(self, seconds: float, pause: Pause | None) -> None:
        try:
            data = self._link.read(seconds if pause is None else 0.0)
        except LinkLost:
            self.losses += 1
            raise
        self.dialogue.feed(data)
        if pause is not None:
            pause(0.0 if data else seconds)

    def _write(self, data: bytes) -> None:
        torn, self._torn = self._torn, True
        try:
            self._link.write(b"\n" + data if torn else data)  # what was torn off ends here
        except LinkLost:
            self.losses += 1
            raise
        self._torn = False
