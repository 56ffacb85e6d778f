"""What can go wrong between us and a device.

    DriverError                 root of drivers; catch this at the station
    ├── LinkLost(OSError)       the port vanished, the peer closed, the cable is out
    │   └── PortBusy            another process holds the port; the message names it where it can
    ├── NoReply(TimeoutError)   says device, seconds, what to check
    ├── FrameError              the peer's bytes are wrong (checksum, length, an answer to nothing)
    └── Refused                 the device said no (limit, interlock, alarm); `code` is its own

A caller's mistake stays ``ValueError``: the split is by who is at fault. Every message is one line
that names the device, the quantity, the limit and the remedy.
"""

from __future__ import annotations


class DriverError(Exception):
    """Root of what this package raises on purpose."""


class LinkLost(DriverError, OSError):  # noqa: N818 (the house names errors after the fact)
    """The link to the device is gone; reconnecting moves nothing and forgets "homed"."""


class PortBusy(LinkLost):
    """The port is held by another process."""


class NoReply(DriverError, TimeoutError):  # noqa: N818
    """A deadline passed without the answer that was due."""


class FrameError(DriverError):
    """Bytes that are no valid frame, or a frame that answers another question."""


class Refused(DriverError):  # noqa: N818
    """The device understood and said no."""

    def __init__(self, message: str, *, code: int | None = None) -> None:
        super().__init__(message)
        self.code = code
