"""One thread that serves every wire: bytes to the devices, their answers back, profiles out.

::

    Pty, TcpWire --bytes--> Device.receive --answer--> outbox --as the wire takes it--> Pty, TcpWire
                            Device.tick    --unasked------^
                            Broadcaster.datagrams -----------------------------------> UdpSender

Nothing waits for one wire: what a wire does not take at once stays in its outbox. While the station
is lively, time is told to the devices every 2 ms; at rest every 10 ms, which costs next to nothing.
"""

from __future__ import annotations

import os
import selectors
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Self

from sim.device import Broadcaster, Device
from sim.wires import HungUp, Pty, TcpListener, UdpSender, Wire

_LIVELY_S = 0.002
_AT_REST_S = 0.010
_LIVELY_AFTER_S = 0.05  # of the last byte: whoever asked will ask again
_OUTBOX_BYTES = 1 << 20  # for a peer that does not read; more than that is lost with the line


class Ending:
    """Whether the server is to end; a signal handler as it is."""

    def __init__(self) -> None:
        self.asked = False

    def ask(self, *_signal: object) -> None:
        """End at the next turn."""
        self.asked = True


class Server:
    """Owns the wires that it is given, and closes them on its way out.

    Parameters
    ----------
    lively : callable
        Whether the station does something by itself at a time: moves, measures.
    clock : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        *,
        lively: Callable[[float], bool] = lambda _: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._lively = lively
        self._clock = clock
        self._selector = selectors.DefaultSelector()
        self._lines: list[_Line] = []
        self._ports: list[_Port] = []
        self._ticking: list[Callable[[float], object]] = []
        self._broadcasts: list[tuple[UdpSender, Broadcaster]] = []
        self._heard_s = -_LIVELY_AFTER_S
        self._closing = ExitStack()
        self._closing.callback(self._selector.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for line in list(self._lines):
            self._hang_up(line)
        self._closing.close()

    def serve_pty(self, pty: Pty, device: Device) -> None:
        """Serve a device on a serial port, whoever opens it, one after the other."""
        self._closing.callback(pty.close)
        self._ports.append(_Port(pty, device))

    def serve_tcp(self, listener: TcpListener, session: Callable[[], Device]) -> None:
        """Serve every connection to a port, each by a session of its own."""
        self._closing.callback(listener.close)
        self._selector.register(
            listener, selectors.EVENT_READ, partial(self._accept, listener, session)
        )

    def broadcast(self, sender: UdpSender, source: Broadcaster) -> None:
        """Send what a broadcaster has to say."""
        self._closing.callback(sender.close)
        self._broadcasts.append((sender, source))

    def tell_time(self, tick: Callable[[float], object]) -> None:
        """Tell the time to what must know it with nobody connected, such as a watchdog."""
        self._ticking.append(tick)

    def end_with(
        self, descriptor: int, ending: Ending, heed: Callable[[str], object] = lambda _: None
    ) -> None:
        """Ask for the end when a descriptor, such as a parent's pipe, is closed at its other end.

        Lines that come on it before are passed to `heed`.

        Raises
        ------
        PermissionError
            It is a file, which never closes.
        """
        rest = b""

        def look(_events: int) -> None:
            nonlocal rest
            data = os.read(descriptor, 65536)
            if not data:
                ending.ask()
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                heed(line.decode("ascii", "replace"))

        self._selector.register(descriptor, selectors.EVENT_READ, look)

    def run(self, ending: Ending) -> None:
        """Serve until the end is asked for."""
        while not ending.asked:
            self.turn()

    def turn(self) -> None:
        """Serve what has arrived, waiting a few ms at most, and tell everybody the time."""
        self._attend()
        for key, events in self._selector.select(self._patience_s()):
            key.data(events)
        now_s = self._clock()
        for tick in self._ticking:
            tick(now_s)
        for port in self._ports:
            if port.line is None:
                port.device.tick(now_s)  # it lives on; what it says, nobody hears
        for line in list(self._lines):
            self._say(line, line.device.tick(now_s))
            self._break_off_if_lost(line)
        for sender, source in self._broadcasts:
            for datagram in source.datagrams(now_s):
                sender.send(datagram)

    def _patience_s(self) -> float:
        now_s = self._clock()
        lively = now_s - self._heard_s < _LIVELY_AFTER_S or self._lively(now_s)
        return _LIVELY_S if lively else _AT_REST_S

    def _attend(self) -> None:
        """Take up the ports that somebody opened: a pty says nothing of that by itself."""
        for port in self._ports:
            if port.unplugged and not _lost(port.device):
                port.unplugged = False
                port.pty.plug()
            if port.line is None and not port.unplugged and port.pty.attended():
                port.line = self._connect(_Line(port.pty, port.device, port))

    def _accept(self, listener: TcpListener, session: Callable[[], Device], _events: int) -> None:
        wire = listener.accept()
        if wire is not None:
            self._connect(_Line(wire, session()))

    def _connect(self, line: _Line) -> _Line:
        self._lines.append(line)
        self._selector.register(line.wire, selectors.EVENT_READ, partial(self._serve, line))
        return line

    def _serve(self, line: _Line, events: int) -> None:
        if line.up and events & selectors.EVENT_READ:
            self._hear(line)
        if line.up and events & selectors.EVENT_WRITE:
            self._send(line)

    def _hear(self, line: _Line) -> None:
        try:
            data = line.wire.read()
        except HungUp:
            self._hang_up(line)
            return
        if data:
            self._heard_s = self._clock()
            self._say(line, line.device.receive(data, self._heard_s))
            self._break_off_if_lost(line)

    def _break_off_if_lost(self, line: _Line) -> None:
        """End a session that cannot make out where the next request begins, or has no cable."""
        if not line.up or not _lost(line.device):
            return
        if line.port is not None:
            line.port.unplugged = True
            self._hang_up(line)
            line.port.pty.unplug()
        else:
            self._hang_up(line)

    def _say(self, line: _Line, words: bytes) -> None:
        if line.up and words:
            line.outbox += words
            self._send(line)

    def _send(self, line: _Line) -> None:
        try:
            del line.outbox[: line.wire.write(bytes(line.outbox))]
        except HungUp:
            self._hang_up(line)
            return
        if len(line.outbox) > _OUTBOX_BYTES:
            self._hang_up(line)
        elif bool(line.outbox) != line.blocked:
            line.blocked = not line.blocked
            wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if line.blocked else 0)
            self._selector.modify(line.wire, wanted, partial(self._serve, line))

    def _hang_up(self, line: _Line) -> None:
        line.up = False
        self._lines.remove(line)
        self._selector.unregister(line.wire)
        if line.port is not None:
            line.port.line = None
            if not line.port.unplugged:
                line.port.pty.renew()
        elif _lost(line.device):
            line.wire.reset()
        else:
            line.wire.close()


def _lost(device: Device) -> bool:
    return bool(getattr(device, "lost", False))


@dataclass(slots=True, eq=False)
class _Line:
    """A connection that is up, and what its wire has not taken yet."""

    wire: Wire
    device: Device
    port: _Port | None = None  # of a pty, which is kept for whoever opens it next
    outbox: bytearray = field(default_factory=bytearray)
    blocked: bool = False
    up: bool = True


@dataclass(slots=True, eq=False)
class _Port:
    """A serial port, and the line to whoever has it open."""

    pty: Pty
    device: Device
    line: _Line | None = None
    unplugged: bool = False
