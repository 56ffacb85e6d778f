"""The owner's end of the guard: hands it what it needs, and holds the lease that it watches.

::

    with guarded(places) as guard:               started, every place locked
        guard.hold(link, [recipe])               before anything is lit; again after a reconnect
        guard.take(0.12) ... renew ... give_back the laser may be on in between
                                                 bye: waits until it has let go

The lease is renewed by the thread that took it and by no other: one that beat for it would hide
that it hangs. While a driver waits for its device's answer, each of its reads is a renewal: the
owner is alive, and its waits are bounded.
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import get_ident
from typing import Any, Protocol

from acquisition.errors import GuardLost
from acquisition.safety import guard as guard_process
from acquisition.safety.places import Place, wait_for_its_turn
from drivers.errors import LinkLost
from drivers.links import ByteLink, descriptor_of
from drivers.recipes import Recipe

_START_S = 10.0  # of a Python on a busy machine
_ANSWER_S = 2.0
_END_S = 5.0
_RENEW_S = 0.02  # renewals come no closer, however often a link is read


class Guard(Protocol):
    """Whoever watches the lease and acts on its end."""

    def hold(self, link: ByteLink, recipes: Sequence[Recipe]) -> bool:
        """Hand a link over with what is to be said on it; whether it has a descriptor at all."""
        ...

    def drop(self, link: ByteLink) -> None:
        """Forget a link, before it is closed to be opened again."""
        ...

    def lock(self, files: Sequence[str]) -> Mapping[str, Any]:
        """Take the locks of some places; ``ok``, or else ``file`` and its ``holder``."""
        ...

    def unlock(self, files: Sequence[str]) -> None:
        """Let go of some: what is there now is not ours any more."""
        ...

    def take(self, ttl_s: float) -> None:
        """Begin a lease, and see it acknowledged."""
        ...

    def renew(self, ttl_s: float) -> None:
        """Begin the time to live anew."""
        ...

    def give_back(self) -> None:
        """The laser was seen to be off."""
        ...

    def attend(self) -> None:
        """Renew a lease that this thread took; called wherever the loop waits."""
        ...

    def report_to(self, file: Path) -> None:
        """Name the file that a report of its acts is appended to."""
        ...

    @property
    def process_id(self) -> int | None:
        """Its process, if it is one."""
        ...


class NoGuard:
    """Nobody watches: for links inside one process, which nobody else could reach."""

    def hold(self, link: ByteLink, recipes: Sequence[Recipe]) -> bool:
        """Hold nothing."""
        return False

    def drop(self, link: ByteLink) -> None:
        """Nothing was held."""

    def lock(self, files: Sequence[str]) -> Mapping[str, Any]:
        """Nobody else could want them."""
        return {"ok": True}

    def unlock(self, files: Sequence[str]) -> None:
        """Nothing was locked."""

    def take(self, ttl_s: float) -> None:
        """Nobody watches it."""

    def renew(self, ttl_s: float) -> None:
        """Nobody watches it."""

    def give_back(self) -> None:
        """Nobody watched it."""

    def attend(self) -> None:
        """Nobody watches."""

    def report_to(self, file: Path) -> None:
        """Nothing will be reported."""

    @property
    def process_id(self) -> int | None:
        """It is none."""
        return None


class GuardProcess:
    """The guard in a process of its own; made by `guarded`."""

    def __init__(self) -> None:
        ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel = ours
        words = [sys.executable, "-I", "-S", guard_process.__file__]
        with its:
            self._process = subprocess.Popen(
                [*words, str(its.fileno()), str(os.getpid())],
                pass_fds=[its.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                cwd="/",
                start_new_session=True,  # a terminal's Ctrl-C is for its owner
            )
        self._gone = (
            ""  # why it is not asked any more: its next answer could be to another question
        )
        self._holder: int | None = None  # the thread that took the lease
        self._ttl_s = 0.0
        self._renewed_s = 0.0
        try:
            self._answer("it did not start", _START_S)
        except GuardLost:
            self._channel.close()
            self._process.kill()
            self._process.wait()
            raise

    @property
    def process_id(self) -> int | None:
        """Its process."""
        return self._process.pid

    def lock(self, files: Sequence[str]) -> Mapping[str, Any]:
        """Ask for the locks of some places; ``ok``, or else ``file`` and its ``holder``."""
        return self._ask({"word": "lock", "files": list(files)})

    def unlock(self, files: Sequence[str]) -> None:
        """Let go of some locks."""
        self._ask({"word": "unlock", "files": list(files)})

    def hold(self, link: ByteLink, recipes: Sequence[Recipe]) -> bool:
        """Hand a link over; one that was held under its address before is replaced."""
        descriptor = descriptor_of(link)
        if descriptor is None or not recipes:
            return False
        told = {"word": "hold", "key": link.address, "recipes": list(map(_plain, recipes))}
        self._ask(told, descriptor)
        return True

    def drop(self, link: ByteLink) -> None:
        """Forget a link: a port can be opened again only when nobody else has it open."""
        self._ask({"word": "drop", "key": link.address})

    def take(self, ttl_s: float) -> None:
        """Begin a lease; only a guard that answers may be relied on."""
        self._holder, self._ttl_s, self._renewed_s = get_ident(), ttl_s, time.monotonic()
        self._ask({"word": "take", "until_ns": _from_now_ns(ttl_s)})

    def renew(self, ttl_s: float) -> None:
        """Begin the time to live anew, if a lease was taken; never waits."""
        if self._holder is None:
            return
        self._renewed_s = time.monotonic()
        self._send(guard_process.LEASE.pack(b"L", _from_now_ns(ttl_s)))

    def give_back(self) -> None:
        """End the lease in peace; a guard that is gone meanwhile is found out by the next."""
        if self._holder is not None:
            self._holder = None
            with suppress(GuardLost):
                self._send(guard_process.LEASE.pack(b"L", 0))

    def attend(self) -> None:
        """Renew, unless another thread took it or it was renewed a moment ago."""
        if self._holder == get_ident() and time.monotonic() - self._renewed_s >= _RENEW_S:
            with suppress(GuardLost):  # amid "laser off": the loop's own renewal says so
                self.renew(self._ttl_s)

    def report_to(self, file: Path) -> None:
        """Name the file for its report."""
        self._ask({"word": "report", "file": str(file.absolute())})

    def end(self) -> None:
        """Say goodbye and wait until it is gone; a lease that is still held makes it act first."""
        with suppress(GuardLost):  # it is gone, then; whoever lit after that was told
            self._ask({"word": "bye"}, within_s=_END_S)
        self._channel.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _ask(
        self, told: Mapping[str, Any], *descriptors: int, within_s: float = _ANSWER_S
    ) -> Mapping[str, Any]:
        if self._gone:
            raise _lost(self._gone)
        try:
            self._send(json.dumps(told).encode(), *descriptors)
            return self._answer(f"it did not answer to {told['word']!r}", within_s)
        except GuardLost as lost:
            self._gone = str(lost.args[0]).removeprefix(_SAYS).partition(_UNLIT)[0]
            raise

    def _answer(self, else_: str, within_s: float) -> Mapping[str, Any]:
        try:
            ready, _, _ = select.select([self._channel], [], [], within_s)
            data = self._channel.recv(guard_process.MESSAGE_BYTES) if ready else b""
        except OSError as gone:
            raise _lost(str(gone)) from gone
        if not data:
            raise _lost(f"{else_} within {within_s:g} s" if not ready else "it ended")
        answer: Mapping[str, Any] = json.loads(data)
        return answer

    def _send(self, data: bytes, *descriptors: int) -> None:
        try:
            if descriptors:
                socket.send_fds(self._channel, [data], list(descriptors), socket.MSG_DONTWAIT)
            else:
                self._channel.send(data, socket.MSG_DONTWAIT)
        except OSError as gone:  # a full channel is a guard that does not listen
            raise _lost(str(gone)) from gone


class AttendedLink:
    """A link whose reads tell the guard that their thread is alive; it says when it is lost."""

    def __init__(
        self, opening: Callable[[], ByteLink], guard: Guard, lost: Callable[[], object]
    ) -> None:
        self._opening = opening
        self._link = opening()
        self._guard = guard
        self._lost = lost
        self.is_lost = False

    @property
    def address(self) -> str:
        """The address of the link inside."""
        return self._link.address

    def close(self) -> None:
        """Close; may be called again."""
        self._link.close()

    def reopen(self) -> None:
        """Open it again in place of what is lost; sends nothing. Raises LinkLost."""
        with suppress(LinkLost):
            self._link.close()
        self._link = self._opening()
        self.is_lost = False

    def fileno(self) -> int | None:
        """The descriptor of the link inside."""
        return descriptor_of(self._link)

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte."""
        with self._noticing_loss():
            data = self._link.read(timeout_s)
        self._guard.attend()
        return data

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        with self._noticing_loss():
            self._link.write(data)

    @contextmanager
    def _noticing_loss(self) -> Iterator[None]:
        try:
            yield
        except LinkLost:
            self.is_lost = True
            self._lost()
            raise


def first_word_s(ttl_s: float, quiet_s: float, wire_s: float) -> float:
    """Seconds from the last renewal until a device has heard its first word from the guard.

    The lease, a look more where the guard itself was stalled, the owner's end, the line's silence
    (waited for twice at most) and the bytes.
    """
    seconds = (guard_process.STALLED_S, guard_process.DEAD_WITHIN_S, 2.0 * quiet_s, wire_s)
    return ttl_s + sum(seconds)


@contextmanager
def unguarded(places: Sequence[Place], sleep: Callable[[float], object]) -> Iterator[NoGuard]:
    """Open a station that nobody watches over: of links inside one process."""
    yield NoGuard()


@contextmanager
def guarded(places: Sequence[Place], sleep: Callable[[float], object]) -> Iterator[GuardProcess]:
    """Start a guard that has every place for itself; gone again when the block is left.

    Raises
    ------
    PortBusy
        A place is another program's, which is alive; or its guard did not let go.
    GuardLost
        It could not be started.
    """
    process = GuardProcess()
    try:
        wait_for_its_turn(places, process.lock, sleep)
        yield process
    finally:
        process.end()


def _plain(recipe: Recipe) -> dict[str, Any]:
    """What the guard reads: JSON has no bytes."""

    def words(of: Sequence[Any]) -> list[dict[str, Any]]:
        return [
            {"send": each.send.hex(), "reply": each.reply.hex(), "within_s": each.within_s}
            for each in of
        ]

    return {
        "device": recipe.device,
        "order": int(recipe.order),
        "quiet_s": recipe.quiet_s,
        "rest_s": recipe.rest_s,
        "words": words(recipe.words),
        "check": words(recipe.check),
    }


def _from_now_ns(seconds: float) -> int:
    return time.monotonic_ns() + int(seconds * 1e9)


_SAYS, _UNLIT = "laser guard: ", "; without it nothing may be lit"


def _lost(why: str) -> GuardLost:
    return GuardLost(f"{_SAYS}{why}{_UNLIT}: is the machine out of memory or processes?")
