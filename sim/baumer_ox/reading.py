"""What the sensor says of itself beside the profile; registers and datagrams tell it alike."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Quality(IntEnum):
    """How much light came back."""

    OK = 0
    WEAK = 1
    NO_SIGNAL = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """The sensor's state at one measurement."""

    parametrising: bool
    quality: Quality
    rate_hz: float
    time_us: int  # the sensor's clock, which no NTP server sets

    @property
    def valid(self) -> bool:
        """Whether the measured values may be interpreted."""
        return self.quality is not Quality.NO_SIGNAL

    @property
    def alarm(self) -> bool:
        """Raised by a bad profile and in parametrisation mode (manual 1.1, page 86)."""
        return self.parametrising or not self.valid

    @property
    def clock(self) -> tuple[int, int]:
        """Seconds and microseconds of the time stamp, as two 32-bit numbers."""
        seconds, microseconds = divmod(self.time_us, 1_000_000)
        return seconds & 0xFFFF_FFFF, microseconds
