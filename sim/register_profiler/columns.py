r"""From beams that fan out to columns of equal pitch, as such a sensor interpolates them itself.

::

    z |  o---o                o  what two neighbouring beams met
      | /|   |\                |  a column between them: on their straight line
      |o |   | o    o
      +--+---+---------> x       none where they lie too far apart: an edge is no surface

Written from what a sensor must do, and not from our driver.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.arrays import FloatArray
from sim.sensor import Reason, Sensor, SimProfile

NO_RETURN, OUT_OF_RANGE = 0xFFFF, 0xFFFE
_HIGHEST = 0xFFFC
_STEP_MM = 1.0  # between neighbours: farther apart there is an edge between them


def columns_of(
    profile: SimProfile | None,
    sensor: Sensor,
    columns: int,
    pitch_mm: float,
    z_mm_per_count: float,
) -> NDArray[np.uint16]:
    """Give one word a column, (columns,); the middle of them looks straight ahead.

    In the dark, `profile` is None and nothing returns.
    """
    words = np.full(columns, NO_RETURN, np.uint16)
    if profile is None:
        return words
    at_mm: FloatArray = pitch_mm * np.arange(0.5 - columns / 2.0, columns / 2.0)
    seen = profile.seen
    if np.count_nonzero(seen) >= 2:
        x = profile.counts[seen, 0] * sensor.x_mm_per_count + sensor.x_offset_mm
        z = profile.counts[seen, 1] * sensor.z_mm_per_count + sensor.z_offset_mm
        order = np.argsort(x, kind="stable")
        x, z = x[order], z[order]
        right = np.clip(np.searchsorted(x, at_mm), 1, len(x) - 1)
        wide, high = x[right] - x[right - 1], z[right] - z[right - 1]
        between = (at_mm >= x[right - 1]) & (at_mm <= x[right])
        met = between & (wide > 0.0) & (np.hypot(wide, high) <= _STEP_MM)
        share = (at_mm[met] - x[right - 1][met]) / wide[met]
        counts = np.rint((z[right - 1][met] + share * high[met]) / z_mm_per_count)
        words[met] = np.clip(counts, 0, _HIGHEST).astype(np.uint16)
    words[(words == NO_RETURN) & _beyond(profile, sensor, at_mm)] = OUT_OF_RANGE
    return words


def _beyond(profile: SimProfile, sensor: Sensor, at_mm: FloatArray) -> NDArray[np.bool_]:
    """Columns whose beam met something outside the range, seen from the middle of it."""
    slopes = np.linspace(-sensor.steepest, sensor.steepest, len(profile.reasons))
    nearest = np.clip(np.searchsorted(slopes * sensor.middle_mm, at_mm), 0, len(slopes) - 1)
    return np.asarray(profile.reasons[nearest] == Reason.OUT_OF_RANGE)
