"""Two ends of one link in this process, for tests and for simulated devices without a wire.

    driver ── near ═══════ far ── simulated device

Bytes may be dribbled, because a driver that lives on whole chunks dies on a real port. By default
a read waits for the other end's thread; given `wait`, it calls that instead and looks again, so
that one thread and a clock of the test's own are enough.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from enum import Enum
from threading import Condition

from drivers.errors import LinkLost


class Carrying(Enum):
    """What stays together on the way."""

    STREAM = "bytes in order"
    DATAGRAMS = "one write is one read"


class Loopback:
    """One end; `loopback` makes both."""

    def __init__(
        self, address: str, inbox: _Pipe, outbox: _Pipe, wait: Callable[[float], None] | None
    ) -> None:
        self._address = address
        self._inbox = inbox
        self._outbox = outbox
        self._wait = wait
        self._closed = False

    @property
    def address(self) -> str:
        """Its name, for messages."""
        return self._address

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte."""
        self._raise_if_closed()
        if self._wait is None:
            self._inbox.wait(timeout_s)
        elif not self._inbox.ready:
            self._wait(timeout_s)
        if data := self._inbox.take():
            return data
        if self._inbox.ended:
            raise LinkLost(f"{self._address}: the other end closed")
        return b""

    def write(self, data: bytes) -> None:
        """Hand all of `data` to the other end."""
        self._raise_if_closed()
        if self._outbox.ended or self._inbox.ended:
            raise LinkLost(f"{self._address}: the other end closed")
        self._outbox.put(data)

    def close(self) -> None:
        """Close; the other end reads what is left and then finds the link lost."""
        self._closed = True
        self._outbox.end()
        self._inbox.end()

    def _raise_if_closed(self) -> None:
        if self._closed:
            raise LinkLost(f"{self._address}: the link was closed")


def loopback(
    name: str = "loopback",
    *,
    carrying: Carrying = Carrying.STREAM,
    dribble: Iterator[int] | None = None,
    wait: Callable[[float], None] | None = None,
) -> tuple[Loopback, Loopback]:
    """Make both ends of a link.

    Parameters
    ----------
    dribble
        Most bytes of each successive read, of both ends; only for a stream.
    wait
        Called with the timeout by a read that finds nothing, instead of waiting for a thread.
    """
    if dribble is not None and carrying is Carrying.DATAGRAMS:
        raise ValueError("loopback: a datagram arrives whole, so it cannot be dribbled")
    there, back = _Pipe(carrying, dribble), _Pipe(carrying, dribble)
    near = Loopback(f"{name}:near", back, there, wait)
    return near, Loopback(f"{name}:far", there, back, wait)


class _Pipe:
    """One direction."""

    def __init__(self, carrying: Carrying, dribble: Iterator[int] | None) -> None:
        self._chunks: deque[bytes] = deque()
        self._changed = Condition()
        self._carrying = carrying
        self._dribble = dribble
        self.ended = False

    @property
    def ready(self) -> bool:
        return bool(self._chunks) or self.ended

    def wait(self, timeout_s: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self.ready, timeout_s)

    def put(self, data: bytes) -> None:
        with self._changed:
            if data:
                self._chunks.append(bytes(data))
            self._changed.notify_all()

    def end(self) -> None:
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def take(self) -> bytes:
        with self._changed:
            if self._carrying is Carrying.DATAGRAMS or not self._chunks:
                return self._chunks.popleft() if self._chunks else b""
            data = b"".join(self._chunks)
            size = len(data) if self._dribble is None else max(1, next(self._dribble))
            self._chunks = deque([data[size:]] if data[size:] else [])
            return data[:size]
