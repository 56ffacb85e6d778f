r"""How late a profile's time is, from one slice seen both ways round. Pure, without calibration.

With a time that is late by tau, and a table that turns at w, a profile is given an angle that is
too large by w tau one way round, and too small by as much the other way. Written as images
z(angle, x) in the sensor's own plane, what was seen is the same but for twice that shift::

    z one way       /\__/\__        s = w tau moves the two onto each other;
    the other     /\__/\__          a part that is round about the axis looks the same for every s

The shift is where sum J (F - B) = 0, with F and B the images at angles + s and - s, and J = F' + B'
their slopes. The steps are divided by sum 4 F' B': the noise of either image is independent of the
other's, so that noise alone is no slope, and a round part is seen not to tell. The standard
deviation is that between sectors of the turn, so that speckle and an uneven table are in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray

_COLUMNS = 48
_CELLS = 720  # of the turn: half a degree each
_SECTORS = 24
_SLOPE_OVER = 3  # cells to either side
_COARSE_COLUMNS = 6  # every so many of them, for the first look
_WIDEST_GAP = 4.0  # pitches between points that bound no line
_EARLIEST_S, _LATEST_S = -0.02, 0.1  # a latency outside of that is a fault
_TURNS_SEEN = 5.0  # standard deviations that the slopes must stand out of their noise
_STEPS = 12
_STRAY = 3.0  # sigma


@dataclass(frozen=True, slots=True)
class Shift:
    """How far two images of one slice are apart."""

    shift_rad: float  # half of it: w tau; nan where the part does not tell
    sd_rad: float  # one standard deviation; inf where the part does not tell
    apart_mm: float  # root mean square between the images after it, noise and all, strays left out
    noise_mm: float  # the part of that which changes from profile to profile

    @property
    def told(self) -> bool:
        """Whether the part tells."""
        return math.isfinite(self.sd_rad)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One turn: profiles in the sensor's plane, and their angles with no latency assumed."""

    points_mm: Sequence[FloatArray]  # each (m, 2) of x and z
    angles_rad: FloatArray  # (n,)


def shift_between(forward: View, backward: View, speed_rad_s: float) -> Shift:
    """Find the shift between a turn at +speed and one at -speed.

    Raises
    ------
    ValueError
        They have too few points in common to be compared.
    """
    columns_mm = _columns(forward, backward)
    images = [_image(each, columns_mm) for each in (forward, backward)]
    start = _first_look(images, speed_rad_s)
    return _refined(images, start, speed_rad_s)


_Image = tuple[FloatArray, FloatArray]  # angles (n,) increasing, z (n, columns) with nan for none


def _columns(*views: View) -> FloatArray:
    """Places x at which all are read, (columns,): where most profiles have points."""
    ends = [
        (points[:, 0].min(), points[:, 0].max())
        for view in views
        for points in view.points_mm
        if len(points) > _COLUMNS // 4
    ]
    if len(ends) < _SECTORS:
        raise ValueError("latency: too few profiles with points to compare the two turns")
    low, high = np.median(np.array(ends), axis=0)
    inset = 0.02 * (high - low)
    return np.linspace(low + inset, high - inset, _COLUMNS)


def _image(view: View, columns_mm: FloatArray) -> _Image:
    order = np.argsort(view.angles_rad, kind="stable")
    return view.angles_rad[order], np.stack([_read(view.points_mm[k], columns_mm) for k in order])


def _read(points_mm: FloatArray, columns_mm: FloatArray) -> FloatArray:
    """Z at the columns, nan where no points are near on both sides."""
    x, first = np.unique(points_mm[:, 0], return_index=True)
    if len(x) < 4:
        return np.full(len(columns_mm), math.nan)
    z = np.interp(columns_mm, x, points_mm[first, 1], left=math.nan, right=math.nan)
    right = np.clip(np.searchsorted(x, columns_mm), 1, len(x) - 1)
    z[x[right] - x[right - 1] > _WIDEST_GAP * float(np.median(np.diff(x)))] = math.nan
    return np.asarray(z)


def _at(image: _Image, angles_rad: FloatArray, columns: slice = slice(None)) -> FloatArray:
    """The image at angles (k,), linear between its profiles: (k, columns)."""
    own_rad, z = image
    right = np.clip(np.searchsorted(own_rad, angles_rad), 1, len(own_rad) - 1)
    width = own_rad[right] - own_rad[right - 1]
    share = (angles_rad - own_rad[right - 1]) / np.where(width > 0.0, width, 1.0)
    share[(share < 0.0) | (share > 1.0) | (width > math.tau / 90.0)] = math.nan
    left_z, right_z = z[right - 1, columns], z[right, columns]
    return np.asarray(left_z + share[:, None] * (right_z - left_z))


def _grid(count: int) -> FloatArray:
    return math.tau * (np.arange(count) + 0.5) / count


def _first_look(images: Sequence[_Image], speed_rad_s: float) -> float:
    """Of evenly spaced shifts the one after which the images are nearest, by the median."""
    forward, backward = images
    grid, columns = _grid(_CELLS // 2), slice(None, None, _COARSE_COLUMNS)
    tried = speed_rad_s * np.linspace(_EARLIEST_S, _LATEST_S, 61)
    apart = []
    for shift in tried:
        off = _at(forward, grid + shift, columns) - _at(backward, grid - shift, columns)
        there = np.isfinite(off)
        apart.append(float(np.mean(np.minimum(np.abs(off[there]), 1.0))) if there.any() else 9.0)
    return float(tried[int(np.argmin(apart))])


def _refined(images: Sequence[_Image], start_rad: float, speed_rad_s: float) -> Shift:
    forward, backward = images
    grid, shift, most = _grid(_CELLS), start_rad, speed_rad_s * 0.02
    off, lag = np.empty(0), _lag(images)
    bounds = speed_rad_s * _EARLIEST_S, speed_rad_s * _LATEST_S
    for _ in range(_STEPS):
        there, here = _at(forward, grid + shift), _at(backward, grid - shift)
        off = there - here
        slopes = _slope(there), _slope(here)
        weight = _weights(off, *slopes)
        pulled = np.nansum(weight * (slopes[0] + slopes[1]) * off, axis=1)
        steep = 4.0 * np.nansum(weight * slopes[0] * slopes[1], axis=1)
        pulled, steep = (_by_sector(each) for each in (pulled, steep))
        if not _stands_out(steep):
            return Shift(math.nan, math.inf, *_rms(off, weight, lag))
        step = -float(pulled.sum() / steep.sum())
        shift = float(np.clip(shift + np.clip(step, -most, most), *bounds))
        if abs(step) < 1e-7:
            break
    spread = pulled - pulled.mean()
    sd = math.sqrt(float(np.sum(spread**2)) * _SECTORS / (_SECTORS - 1)) / float(steep.sum())
    return Shift(shift, sd, *_rms(off, weight, lag))


def _slope(z: FloatArray) -> FloatArray:
    """Dz / d angle at each cell, by the cells around it on either side: symmetric, nan at gaps."""
    before, after = (
        np.mean([np.roll(z, sign * k, axis=0) for k in range(1, _SLOPE_OVER + 1)], axis=0)
        for sign in (1, -1)
    )
    return np.asarray((after - before) / ((_SLOPE_OVER + 1) * math.tau / _CELLS))


def _weights(off: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """1 where both images are whole and alike within their scatter, else 0."""
    whole = np.isfinite(off) & np.isfinite(one) & np.isfinite(other)
    if np.count_nonzero(whole) < _SECTORS * _COLUMNS // 4:
        raise ValueError("latency: the two turns have too few points in common to be compared")
    sigma = 1.4826 * float(np.median(np.abs(off[whole])))
    with np.errstate(invalid="ignore"):
        return np.where(whole & (np.abs(off) <= _STRAY * sigma), 1.0, 0.0)


def _by_sector(values: FloatArray) -> FloatArray:
    return np.asarray(values.reshape(_SECTORS, -1).sum(axis=1))


def _stands_out(steep: FloatArray) -> bool:
    """Whether slopes are there in more than noise: all around the turn, or anywhere in it."""
    around = float(np.std(np.diff(steep))) / math.sqrt(2.0)
    anywhere = 1.4826 * float(np.median(np.abs(steep)))
    return float(steep.sum()) > _TURNS_SEEN * math.sqrt(_SECTORS) * min(around, anywhere)


def _rms(off: FloatArray, weight: FloatArray, lag: int) -> tuple[float, float]:
    """Root mean square of what was kept, and of its change from cell to cell that are so far."""
    kept = np.where(weight > 0.0, off, math.nan)
    change = (kept[lag:] - kept[:-lag]) / math.sqrt(2.0)
    return math.sqrt(float(np.nanmean(kept**2))), math.sqrt(float(np.nanmean(change**2)))


def _lag(images: Sequence[_Image]) -> int:
    """How many cells apart no two are read off the same profile."""
    widest = max(float(np.median(np.diff(angles))) for angles, _ in images)
    return 1 + math.ceil(widest / (math.tau / _CELLS))
