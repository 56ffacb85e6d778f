"""A UDP port as a ByteLink: one datagram a read, and a buffer for a burst of profiles.

There is no connection to lose: a failed send raises LinkLost, and the next may succeed. Nothing is
counted here; what was lost shows in the numbers of the protocol above.
"""

from __future__ import annotations

import contextlib
import select
import socket
from collections.abc import Iterator

from drivers.addresses import UdpAddress
from drivers.errors import LinkLost

_LARGEST_DATAGRAM = 65535
# A 30 ms stall of ours at 2 kHz and 8 kB a profile is 0.5 MB; the kernel grants what it allows.
_RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024


class UdpLink:
    """A bound port; writes go to the address's peer, or to whoever sent last."""

    def __init__(self, address: UdpAddress) -> None:
        self._address = address
        self._peer = address.peer
        self._socket = _bound(address)

    @property
    def address(self) -> str:
        """The address that it was opened by."""
        return self._address.text

    @property
    def port(self) -> int:
        """The port it is bound to, which the address leaves open when it says 0."""
        return int(self._socket.getsockname()[1])

    @property
    def receive_buffer_bytes(self) -> int:
        """What the kernel granted for 8 MB asked; Linux counts its bookkeeping in, twice that."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def read(self, timeout_s: float) -> bytes:
        """Return one datagram, or nothing after `timeout_s`; an empty datagram is nothing."""
        with self._noticing_loss():
            ready, _, _ = select.select([self._socket], [], [], max(timeout_s, 0.0))
            if not ready:
                return b""
            data, sender = self._socket.recvfrom(_LARGEST_DATAGRAM)
            if self._address.peer is None:
                self._peer = sender
            return data

    def write(self, data: bytes) -> None:
        """Send `data` as one datagram."""
        if self._peer is None:
            raise LinkLost(
                f"{self.address}: nobody has sent yet, so nobody can be answered; "
                "name the device: ?peer=host:port"
            )
        with self._noticing_loss():
            self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Close; may be called again."""
        self._socket.close()

    @contextlib.contextmanager
    def _noticing_loss(self) -> Iterator[None]:
        if self._socket.fileno() < 0:
            raise LinkLost(f"{self.address}: the link was closed")
        try:
            yield
        except (OSError, ValueError) as failure:  # ValueError: closed under a waiting select
            raise LinkLost(f"{self.address}: {failure}; is the network up?") from failure


def _bound(address: UdpAddress) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_DGRAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        listening.bind((address.host, address.port))
    except OSError as failure:
        listening.close()
        raise LinkLost(
            f"{address.text}: cannot listen there ({failure}); is another program listening?"
        ) from failure
    return listening
