"""Bytes to and from a device, whatever carries them."""

from __future__ import annotations

from typing import Protocol

from drivers.addresses import SerialAddress, TcpAddress, parse_address
from drivers.serial_link import SerialLink
from drivers.tcp_link import TcpLink
from drivers.udp_link import UdpLink


class ByteLink(Protocol):
    """One open connection. Reads are bounded by their timeout, writes by the link's own."""

    @property
    def address(self) -> str:
        """The address that it was opened by, for messages."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte.

        Returns
        -------
        bytes
            Empty when nothing came. A UDP link returns exactly one datagram.

        Raises
        ------
        LinkLost
            The port vanished or the peer closed; every later call raises it again.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises
        ------
        LinkLost
        """
        ...

    def close(self) -> None:
        """Close; may be called again."""
        ...


def descriptor_of(link: ByteLink) -> int | None:
    """The open descriptor of a link, for a guard in another process; None where it has none."""
    fileno = getattr(link, "fileno", None)
    descriptor = None if fileno is None else fileno()
    return descriptor if isinstance(descriptor, int) else None


def open_link(address: str) -> ByteLink:
    """Open what the address says; `drivers.addresses` draws the forms.

    Raises
    ------
    ValueError
        No address; says what was expected.
    PortBusy
        A serial port that another process holds; names it.
    LinkLost
        Nothing there.
    """
    parsed = parse_address(address)
    if isinstance(parsed, SerialAddress):
        return SerialLink(parsed)
    if isinstance(parsed, TcpAddress):
        return TcpLink(parsed)
    return UdpLink(parsed)
