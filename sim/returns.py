"""What the light does where it lands, before the camera is asked and the sensor adds anything."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from sim.arrays import FloatArray, ReasonArray, SegmentArray, SingleArray
from sim.sensor import Reason

_MEASURED, _NO_HIT = int(Reason.MEASURED), int(Reason.NO_HIT)
_DARK, _GRAZING = int(Reason.DARK), int(Reason.GRAZING)


@dataclass(frozen=True, slots=True, eq=False)
class Returns:
    """Of k profiles of n beams: each (k, n), all 0 but the reason where a beam misses."""

    z_mm: FloatArray
    lean: FloatArray  # |normal . direction|: a shift along z moves the surface by lean times it
    brightness: FloatArray  # reflectance * cos(incidence)
    reasons: ReasonArray


def returned(
    section: tuple[FloatArray, FloatArray, SingleArray],
    frames: FloatArray,
    slopes: FloatArray,
    least: tuple[float, float],
    met: SegmentArray,
) -> Returns:
    """Work out the returns of beams that meet these segments.

    Parameters
    ----------
    section : ends (s, 2, 2), unit normals (s, 2) and reflectance (s,)
    frames : (k, 2, 3), of each profile: (w, x) = frame @ (X, Y, 1)
    slopes : (n,)
    least : brightness, and cosine of incidence, below which nothing comes back
    met : (k, n), which segment; negative for none
    """
    z_mm, lean, brightness = np.zeros((3, *met.shape))
    reasons = np.full(met.shape, _NO_HIT, np.uint8)
    _return(section, frames, slopes, least, met, (z_mm, lean, brightness, reasons))
    return Returns(z_mm, lean, brightness, reasons)


@njit(cache=True, nogil=True, error_model="numpy")
def _return(
    section: tuple[FloatArray, FloatArray, SingleArray],
    frames: FloatArray,
    slopes: FloatArray,
    least: tuple[float, float],
    met: SegmentArray,
    returns: tuple[FloatArray, FloatArray, FloatArray, ReasonArray],
) -> None:
    ends_mm, normals, reflectance = section
    z_mm, lean, brightness, reasons = returns
    for profile in range(met.shape[0]):
        wx, wy, w0 = frames[profile, 0, 0], frames[profile, 0, 1], frames[profile, 0, 2]
        xx, xy, x0 = frames[profile, 1, 0], frames[profile, 1, 1], frames[profile, 1, 2]
        for beam in range(met.shape[1]):
            segment, u = met[profile, beam], slopes[beam]
            if segment < 0:
                continue
            x, y = ends_mm[segment, 0, 0], ends_mm[segment, 0, 1]
            a, b = normals[segment, 0], normals[segment, 1]
            # The line through the segment in this profile's frame: its normal and one point.
            normal_w, normal_x = wx * a + wy * b, xx * a + xy * b
            way_mm = normal_w * (wx * x + wy * y + w0) + normal_x * (xx * x + xy * y + x0)
            tilt = normal_w + normal_x * u
            cosine = abs(tilt) / math.sqrt(1.0 + u * u)
            z_mm[profile, beam], lean[profile, beam] = way_mm / tilt, abs(tilt)
            brightness[profile, beam] = cosine * reflectance[segment]
            reasons[profile, beam] = _judged(brightness[profile, beam], cosine, least)


@njit(cache=True, nogil=True)
def _judged(brightness: float, cosine: float, least: tuple[float, float]) -> int:
    if cosine < least[1]:
        return _GRAZING
    if brightness < least[0]:
        return _DARK
    return _MEASURED
