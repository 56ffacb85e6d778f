"""What the sensor makes of the light: noise, range, outliers, counts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.arrays import FloatArray, ReasonArray, SingleArray
from sim.returns import Returns
from sim.sensor import Flaws, Reason, Sensor, SimProfile

_MEASURED, _OUTLIER = int(Reason.MEASURED), int(Reason.OUTLIER)
_NO_HIT, _OUT_OF_RANGE = int(Reason.NO_HIT), int(Reason.OUT_OF_RANGE)


class Gauge(NamedTuple):
    """How a sensor limits, blurs, strays and counts, as plain numbers for the kernel."""

    near_mm: float
    far_mm: float
    sigma_mm: float  # across the contour
    outlier_rate: float
    x_mm_per_count: float
    z_mm_per_count: float
    x_offset_mm: float
    z_offset_mm: float
    full_intensity: float


def gauge(sensor: Sensor, flaws: Flaws) -> Gauge:
    """Collect what the readout needs to know."""
    return Gauge(
        near_mm=sensor.near_mm,
        far_mm=sensor.far_mm,
        sigma_mm=0.25 * flaws.cloud_width_mm,
        outlier_rate=flaws.outlier_rate,
        x_mm_per_count=sensor.x_mm_per_count,
        z_mm_per_count=sensor.z_mm_per_count,
        x_offset_mm=sensor.x_offset_mm,
        z_offset_mm=sensor.z_offset_mm,
        full_intensity=float(flaws.full_intensity),
    )


def read_out(
    light: Returns, slopes: FloatArray, speckle: tuple[SingleArray, SingleArray], by: Gauge
) -> list[SimProfile]:
    """Count k profiles of n beams.

    Parameters
    ----------
    light : its reasons become the profiles', and are finished here
    slopes : (n,)
    speckle : standard normals and uniforms on [0, 1), each (k, n), or (k, 0) where not needed
    """
    counts = np.zeros((*light.reasons.shape, 2), np.int32)
    shades = np.zeros(light.reasons.shape, np.uint16)
    amounts = (light.z_mm, light.lean, light.brightness)
    _read(amounts, slopes, speckle, by, light.reasons, counts, shades)
    for each in (counts, shades, light.reasons):
        each.flags.writeable = False
    return [SimProfile(*row) for row in zip(counts, light.reasons, shades, strict=True)]


@njit(cache=True, nogil=True, error_model="numpy")
def _read(
    amounts: tuple[FloatArray, FloatArray, FloatArray],
    slopes: FloatArray,
    speckle: tuple[SingleArray, SingleArray],
    by: Gauge,
    reasons: ReasonArray,
    counts: NDArray[np.int32],
    shades: NDArray[np.uint16],
) -> None:
    z_mm, lean, brightness = amounts
    normals, uniforms = speckle
    for profile in range(reasons.shape[0]):
        for beam in range(reasons.shape[1]):
            reason = reasons[profile, beam]
            if reason == _NO_HIT:
                continue
            way_mm = z_mm[profile, beam]
            if normals.size:
                way_mm += by.sigma_mm * normals[profile, beam] / lean[profile, beam]
            if way_mm < by.near_mm or way_mm > by.far_mm:
                reason = _OUT_OF_RANGE
            elif reason == _MEASURED and uniforms.size:
                share = uniforms[profile, beam] / by.outlier_rate
                # Given that it is an outlier, the same draw, stretched, is uniform over the range.
                if share < 1.0:
                    reason = _OUTLIER
                    way_mm = by.near_mm + share * (by.far_mm - by.near_mm)
            reasons[profile, beam] = reason
            if reason <= _OUTLIER:
                x_mm = way_mm * slopes[beam]
                counts[profile, beam, 0] = np.rint((x_mm - by.x_offset_mm) / by.x_mm_per_count)
                counts[profile, beam, 1] = np.rint((way_mm - by.z_offset_mm) / by.z_mm_per_count)
                shades[profile, beam] = np.rint(brightness[profile, beam] * by.full_intensity)
