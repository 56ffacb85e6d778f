"""A serial port as a ByteLink: raw, exclusively ours, and honest when it vanishes.

pyserial configures the port. We wait on its descriptor ourselves, because setting pyserial's
timeout configures the port again each time, and one unplug shows as four kinds of exception: two
sorts of SerialException, OSError, and termios.error, which is no OSError. All are LinkLost here.

POSIX only. Two locks keep others out: flock those that ask, TIOCEXCL those that do not; neither
keeps out a root that does not ask.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import select
import termios
from collections.abc import Iterator

import serial  # type: ignore[import-untyped]

from drivers.addresses import Dtr, SerialAddress
from drivers.errors import LinkLost, PortBusy
from drivers.holders import holders_of

_VANISHED = (OSError, termios.error)  # SerialException is an OSError
_BUSY = (errno.EBUSY, errno.EAGAIN)
NO_PORT = "no such port; is the cable in?"
_REMEDIES = {
    errno.ENOENT: NO_PORT,
    errno.EACCES: "not permitted; on Debian: sudo adduser $USER dialout, then log in again",
}


class SerialLink:
    """An open serial port.

    Parameters
    ----------
    write_s : float
        A device that takes no bytes for so long counts as lost.

    Raises
    ------
    PortBusy
        Another process holds the port; named where /proc lets us see it.
    LinkLost
        There is no such port, or it may not be used.
    """

    def __init__(self, address: SerialAddress, *, write_s: float = 1.0) -> None:
        self._address = address
        self._port = _opened(address, write_s)
        self._lost = ""

    @property
    def address(self) -> str:
        """The address that it was opened by."""
        return self._address.text

    def fileno(self) -> int:
        """The descriptor, for a guard that must reach the device when this process cannot."""
        with self._noticing_loss():
            return int(self._port.fileno())

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte."""
        with self._noticing_loss():
            ready, _, _ = select.select([self._port.fileno()], [], [], max(timeout_s, 0.0))
            return bytes(self._port.read(max(self._port.in_waiting, 1))) if ready else b""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        with self._noticing_loss():
            self._port.write(data)

    def close(self) -> None:
        """Close; may be called again, and after the port is gone."""
        self._lost = self._lost or "the link was closed"
        with contextlib.suppress(*_VANISHED):  # the mark outlives us while others keep it open
            fcntl.ioctl(self._port.fileno(), termios.TIOCNXCL)
        with contextlib.suppress(*_VANISHED):
            self._port.close()

    @contextlib.contextmanager
    def _noticing_loss(self) -> Iterator[None]:
        if self._lost:
            raise LinkLost(f"{self.address}: {self._lost}")
        try:
            yield
        except serial.SerialTimeoutException as stuck:
            self._lost = f"takes no bytes in {self._port.write_timeout} s; is the device on?"
            raise LinkLost(f"{self.address}: {self._lost}") from stuck
        except _VANISHED as gone:
            self._lost = f"the port is gone ({gone}); is the cable in?"
            raise LinkLost(f"{self.address}: {self._lost}") from gone


def _opened(address: SerialAddress, write_s: float) -> serial.Serial:
    port = serial.Serial(
        baudrate=address.baud,
        parity=address.parity,
        stopbits=address.stop_bits,
        timeout=0,
        write_timeout=write_s,
        exclusive=True,
    )
    port.port = address.device
    port.dtr = address.dtr is not Dtr.LOW
    try:
        port.open()
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        _hang_up_on_close(port.fileno(), address.dtr)
    except _VANISHED as failure:
        port.close()
        raise _why_not(address, failure) from failure
    return port


def _hang_up_on_close(descriptor: int, dtr: Dtr) -> None:
    attributes = termios.tcgetattr(descriptor)
    attributes[2] &= ~termios.HUPCL
    if dtr is not Dtr.HELD:
        attributes[2] |= termios.HUPCL
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


def _why_not(address: SerialAddress, failure: Exception) -> LinkLost:
    number = getattr(failure, "errno", None)
    if number in _BUSY:
        holders = " and ".join(map(str, holders_of(address.device)))
        return PortBusy(f"{address.text}: held by {holders or 'another process'}; end it first")
    reason = _REMEDIES.get(number or 0, f"{failure}; is it a serial port?")
    return LinkLost(f"{address.text}: {reason}")
