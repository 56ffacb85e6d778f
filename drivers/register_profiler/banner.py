"""Banner EZ-ARRAY measuring light screens, ready-made (manual 130426, rev. C and D, pages 36-43).

Not a triangulating profiler: its channels are light beams side by side, and what it tells is which
of them are blocked. A shadow has no depth, so a blocked channel is a point at z = 0::

    input registers (function 4), addressed as the manual numbers them, 30003 is address 30003
    30003 ...        channels, 16 a register, bit 0 the first; 1 is blocked
    30500 ... 30524  all measurements, four counts a channel
"""

from __future__ import annotations

from drivers.register_profiler.layout import Layout, Packing, Table

EZ_ARRAY_ID = 0x41  # as it leaves the factory
_CHANNELS = 30003
_MOST_CHANNELS = 16 * (30032 - 30003 + 1)
EZ_ARRAY_MEASUREMENTS = range(30500, 30525)
_COUNTS_A_CHANNEL = 4.0


def ez_array(channels: int, pitch_mm: float, *, first_channel_mm: float = 0.0) -> Layout:
    """Describe the channels of a screen: blocked or not.

    Raises
    ------
    ValueError
        More channels than the bitmap has, or an impossible pitch.
    """
    if not 1 <= channels <= _MOST_CHANNELS:
        raise ValueError(f"channels: {channels}; the screen's registers hold 1 to {_MOST_CHANNELS}")
    return Layout(
        table=Table.INPUT,
        first_register=_CHANNELS,
        columns=channels,
        packing=Packing.BITS,
        z_mm_per_count=1.0,
        column_pitch_mm=pitch_mm,
        first_column_mm=first_channel_mm,
    )


def ez_array_measurements(pitch_mm: float) -> Layout:
    """Describe the 25 words of measurements: x is a measurement's number, z its value in mm."""
    return Layout(
        table=Table.INPUT,
        first_register=EZ_ARRAY_MEASUREMENTS.start,
        columns=len(EZ_ARRAY_MEASUREMENTS),
        z_mm_per_count=pitch_mm / _COUNTS_A_CHANNEL,
        column_pitch_mm=1.0,
    )
