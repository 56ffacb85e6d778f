"""Ports of loopback that a station's links open: ptys, TCP and UDP. Nothing here ever waits.

::

    the program under test                      the simulator
    serial:///.../table  --> symlink --> slave == master       Pty
    tcp://127.0.0.1:port -------------------> TcpListener --> TcpWire, one a connection
    udp://127.0.0.2:port <------------------- 127.0.0.1:port   UdpSender

Linux only: ptys that hang up as below, and 127.0.0.2 without being asked for.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
import tty
from pathlib import Path
from typing import Protocol

_READ_BYTES = 65536
_UNPLUGGED = -1
_TCGETS2, _TERMIOS2 = 0x802C542A, struct.Struct("=4IB19sII")  # asm-generic/termbits.h
_NO_COMMAND = 0xC0  # with these bits no byte means anything to any of the devices
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: what was not sent is thrown away


class HungUp(Exception):  # noqa: N818 (what a line does)
    """The other end was closed, and all that it said has been read."""


class Wire(Protocol):
    """One connection's own end."""

    def fileno(self) -> int:
        """The descriptor to wait for."""
        ...

    def read(self) -> bytes:
        """What has arrived, or nothing; raises `HungUp`."""
        ...

    def write(self, data: bytes) -> int:
        """Send as much as goes at once; return how many bytes that was. Raises `HungUp`."""
        ...

    def close(self) -> None:
        """Close it; the other end reads what is under way and then finds the link lost."""
        ...

    def reset(self) -> None:
        """Break it off; what is under way may be lost."""
        ...


class Pty:
    """A serial port, reached by a symlink of our naming; it outlives those who open and close it.

    The slave is not kept open here: whoever opened it and closed it again could not be noticed, and
    would find its answers from before in the port.

    A pty knows the rate that its port was set to. Where that is not `baud`, what is said either way
    arrives as garbage, as it does on a real line.
    """

    def __init__(self, link: Path, baud: int | None = None) -> None:
        self.path = link
        self._baud = baud
        self._master = _new_pty(link)

    def fileno(self) -> int:
        """The master's descriptor; another one after `renew`."""
        return self._master

    def attended(self) -> bool:
        """Whether somebody has the port open, or has left bytes in it."""
        events = self._events()
        return bool(events & select.POLLIN) or not events & select.POLLHUP

    def read(self) -> bytes:
        """What has arrived; raises `HungUp` while nobody has the port open."""
        try:
            return self._heard(os.read(self._master, _READ_BYTES))
        except BlockingIOError:
            return b""
        except OSError as gone:
            raise _hung_up(gone) from gone

    def write(self, data: bytes) -> int:
        """Send; what is said while nobody has the port open is lost, as on a cable."""
        if self._events() & select.POLLHUP:
            raise HungUp
        try:
            return os.write(self._master, self._heard(data))
        except BlockingIOError:
            return 0

    def unplug(self) -> None:
        """Pull the cable: whoever has the port open finds it gone, and its name is gone."""
        self.path.unlink(missing_ok=True)
        os.close(self._master)
        self._master = _UNPLUGGED

    def reset(self) -> None:
        """A serial line knows no other end than the cable's."""
        self.unplug()

    def plug(self) -> None:
        """Put the cable back: another pty, of the same name."""
        self._master = _new_pty(self.path)

    def renew(self) -> None:
        """After a hang-up: put another pty behind the name if nobody could open this one again.

        A real port forgets TIOCEXCL when its owner is killed. A pty does not, as long as its master
        lives, and then only a privileged user gets in.
        """
        try:
            os.close(os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        except OSError as refused:
            if refused.errno != errno.EBUSY or self.attended():
                return
            forsaken, self._master = self._master, _new_pty(self.path)
            os.close(forsaken)

    def close(self) -> None:
        """Close; the name is gone, too."""
        if self._master != _UNPLUGGED:
            self.unplug()

    def _heard(self, data: bytes) -> bytes:
        if self._baud is None or self._baud == _rate_of(self._master):
            return data
        return bytes(_NO_COMMAND | byte & 0x3F for byte in data)

    def _events(self) -> int:
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return sum(events for _, events in poll.poll(0))


def _rate_of(descriptor: int) -> int:
    """The rate that a port was set to, whether or not it is one of the usual ones."""
    termios2 = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    rate: int = _TERMIOS2.unpack(termios2)[-1]
    return rate


def _new_pty(link: Path) -> int:
    master, slave = os.openpty()
    tty.setraw(slave)  # before anybody opens it, or what we say would be echoed to us
    os.set_blocking(master, False)
    fresh = link.with_name(link.name + ".new")
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(os.ttyname(slave))
    fresh.replace(link)
    os.close(slave)
    return master


def _hung_up(gone: OSError) -> Exception:
    return HungUp() if gone.errno == errno.EIO else gone


class TcpListener:
    """A port that devices are reached at; 0 takes any that is free."""

    def __init__(self, port: int = 0) -> None:
        self._socket = socket.create_server(("127.0.0.1", port))
        self._socket.settimeout(0.0)
        self.address = f"tcp://127.0.0.1:{self._socket.getsockname()[1]}"

    def fileno(self) -> int:
        """The descriptor to wait for."""
        return self._socket.fileno()

    def accept(self) -> TcpWire | None:
        """Take the next connection; None when it is gone again."""
        try:
            connection, _ = self._socket.accept()
        except (BlockingIOError, ConnectionError):
            return None
        return TcpWire(connection)

    def close(self) -> None:
        """Take no more connections; those that are open stay."""
        self._socket.close()


class TcpWire:
    """One accepted connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        connection.settimeout(0.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        """The descriptor to wait for."""
        return self._socket.fileno()

    def read(self) -> bytes:
        """What has arrived; raises `HungUp` when the peer closed or broke."""
        try:
            data = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as gone:
            raise HungUp from gone
        if not data:
            raise HungUp
        return data

    def write(self, data: bytes) -> int:
        """Send as much as the kernel takes."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError as gone:
            raise HungUp from gone

    def reset(self) -> None:
        """Break it off, as a device does that lost its power or its way."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        self._socket.close()

    def close(self) -> None:
        """Close."""
        self._socket.close()


class UdpSender:
    """Where datagrams go: a port that is kept free for whoever listens; 0 takes any.

    We send from 127.0.0.1 and the listener binds the same port of 127.0.0.2. So the port is ours
    before there is a listener, and nobody else is given it meanwhile.
    """

    def __init__(self, port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.0)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError:
            self._socket.close()
            raise
        self._listener = ("127.0.0.2", int(self._socket.getsockname()[1]))
        self.address = "udp://{}:{}".format(*self._listener)

    def send(self, datagram: bytes) -> None:
        """Send one; it is lost if nobody listens, or if the kernel has no room for it."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            self._socket.sendto(datagram, self._listener)

    def close(self) -> None:
        """Close."""
        self._socket.close()
