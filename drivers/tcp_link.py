"""A TCP connection as a ByteLink: no delay, a deadline on connecting, and keepalive.

Without keepalive a peer that lost its power is never noticed by a reader that only waits.
"""

from __future__ import annotations

import contextlib
import select
import socket
from collections.abc import Iterator

from drivers.addresses import TcpAddress
from drivers.errors import LinkLost

LONGEST_CONNECT_S = 3.0
_READ_BYTES = 65536
# Seconds idle before the first probe, between probes, and probes before giving up: 11 s in all.
_KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class TcpLink:
    """An open connection to a listening peer.

    Parameters
    ----------
    connect_s, write_s : float
        Deadlines of connecting and of one write.
    """

    def __init__(
        self, address: TcpAddress, *, connect_s: float = LONGEST_CONNECT_S, write_s: float = 1.0
    ) -> None:
        self._address = address
        self._lost = ""
        self._socket = _connected(address, connect_s)
        self._socket.settimeout(write_s)

    @property
    def address(self) -> str:
        """The address that it was opened by."""
        return self._address.text

    def fileno(self) -> int:
        """The descriptor, for a guard that must reach the device when this process cannot."""
        with self._noticing_loss():
            return self._socket.fileno()

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte."""
        with self._noticing_loss():
            ready, _, _ = select.select([self._socket], [], [], max(timeout_s, 0.0))
            if not ready:
                return b""
            data = self._socket.recv(_READ_BYTES)
            if not data:
                raise ConnectionResetError("the peer closed")
            return data

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        with self._noticing_loss():
            self._socket.sendall(data)

    def close(self) -> None:
        """Close; may be called again."""
        self._lost = self._lost or "the link was closed"
        self._socket.close()

    @contextlib.contextmanager
    def _noticing_loss(self) -> Iterator[None]:
        if self._lost:
            raise LinkLost(f"{self.address}: {self._lost}")
        try:
            yield
        except (OSError, ValueError) as gone:  # ValueError: closed under a waiting select
            self._lost = f"the connection is gone ({gone}); is the device on?"
            raise LinkLost(f"{self.address}: {self._lost}") from gone


def _connected(address: TcpAddress, connect_s: float) -> socket.socket:
    try:
        connection = socket.create_connection((address.host, address.port), timeout=connect_s)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    except OSError as failure:
        raise LinkLost(
            f"{address.text}: no connection ({_why(failure, connect_s)}); "
            "is the device on, its address and port right?"
        ) from failure
    return connection


def _why(failure: OSError, connect_s: float) -> str:
    if isinstance(failure, TimeoutError):
        return f"nothing in {connect_s} s"
    return failure.strerror or str(failure)
