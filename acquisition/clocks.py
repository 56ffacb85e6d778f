r"""Two clocks and a turning table: when a profile was taken, and where the table was then. Pure.

The sensor stamps by a clock of its own. What it sends is heard later, by the wire and by a program
that looks up now and then; never earlier. So the line under all that was heard maps its clock onto
the station's, drift included, but for a constant: the latency, which `acquisition.latency` finds::

    heard |   .   :  .       The table's angle between the times at which it was asked: straight
          | . : ._.--'       pieces by asymmetric least squares (Newey and Powell 1987,
          |_.--'  <- line    doi:10.2307/1911031), as few as the answers bear (Schwarz 1978,
          +--------- stamp   doi:10.1214/aos/1176344136): what answers late does not pull.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray

_CELL_S = 0.05  # of the sensor's clock: of each only what was heard first can lie on the line
_MOST_CELLS = 20_000  # a quarter of an hour of measuring: a drift is constant for so long
_PIECES = (1, 2, 4, 8, 16)
_SAMPLES_A_PIECE = 4
_ROUNDS = 12
_LATE = 0.005  # weight of an answer that is later than the course
_FINEST_RAD = 1e-7  # below what any table tells


@dataclass(frozen=True, slots=True)
class ClockLine:
    """The station's time at what the sensor's clock said, latency left in."""

    origin_sensor_s: float
    origin_s: float
    rate: float  # seconds of the station in one of the sensor
    late_s: float  # median of how late that was which was heard first in its moment

    def station_s(self, sensor_s: FloatArray) -> FloatArray:
        """Times (n,) of the sensor as times of the station."""
        return np.asarray(self.origin_s + self.rate * (sensor_s - self.origin_sensor_s))

    @property
    def drift_ppm(self) -> float:
        """How fast the sensor's clock is."""
        return (1.0 / self.rate - 1.0) * 1e6


class SensorClock:
    """What was heard first in each moment of the sensor's clock, over the turns of a run."""

    def __init__(self) -> None:
        self._stamps_s = np.empty(0)
        self._heard_s = np.empty(0)

    def hear(self, stamps_s: FloatArray, heard_s: FloatArray) -> None:
        """Take note of profiles (n,); a sensor that was restarted begins anew."""
        if not len(stamps_s):
            return
        if len(self._stamps_s) and stamps_s[0] < self._stamps_s[-1]:
            self._stamps_s = self._heard_s = np.empty(0)
        cells = np.floor(stamps_s / _CELL_S)
        # By how late it was beside its neighbours: a cell is so short that no drift shows in it.
        order = np.lexsort((heard_s - stamps_s, cells))
        first = order[np.unique(cells[order], return_index=True)[1]]
        self._stamps_s = np.concatenate([self._stamps_s, stamps_s[first]])[-_MOST_CELLS:]
        self._heard_s = np.concatenate([self._heard_s, heard_s[first]])[-_MOST_CELLS:]

    def line(self) -> ClockLine:
        """The line under everything heard so far that is nearest to it in the mean.

        Raises
        ------
        ValueError
            Fewer than two moments.
        """
        if len(self._stamps_s) < 2:
            raise ValueError("clock: fewer than two profiles with different time stamps")
        stamp_s, late_s = self._stamps_s, self._heard_s - self._stamps_s
        middle_s = float(stamp_s.mean())
        left, right = _edge_under(stamp_s - middle_s, late_s - late_s[0])
        slope = (late_s[right] - late_s[left]) / (stamp_s[right] - stamp_s[left])
        at_middle_s = late_s[left] + slope * (middle_s - stamp_s[left])
        off_s = late_s - (at_middle_s + slope * (stamp_s - middle_s))
        return ClockLine(
            middle_s, middle_s + float(at_middle_s), 1.0 + float(slope),
            float(np.median(off_s)),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class TableCourse:
    """Where a turning table was: straight between knots."""

    knots_s: FloatArray  # (k,)
    knots_rad: FloatArray  # (k,)
    residual_rad: float  # root mean square of answers before it: none is early but by the table

    def at(self, time_s: FloatArray) -> FloatArray:
        """Angles (n,) at times (n,); beyond the outer knots the outer pieces go on."""
        piece = np.clip(np.searchsorted(self.knots_s, time_s) - 1, 0, len(self.knots_s) - 2)
        begun_s, begun_rad = self.knots_s[piece], self.knots_rad[piece]
        speed = (np.diff(self.knots_rad) / np.diff(self.knots_s))[piece]
        return np.asarray(begun_rad + speed * (time_s - begun_s))


def table_course(asked_s: FloatArray, table_rad: FloatArray) -> TableCourse:
    """Fit straight pieces through answers (n,), as few as Schwarz's criterion asks for.

    Raises
    ------
    ValueError
        Fewer than four answers, or all at one time.
    """
    count = len(asked_s)
    if count < _SAMPLES_A_PIECE or not asked_s[-1] > asked_s[0]:
        raise ValueError(f"table: only {count} positions were read back while it turned")
    best: tuple[float, TableCourse] | None = None
    for pieces in _PIECES:
        if best is not None and count < _SAMPLES_A_PIECE * pieces:
            break
        knots_s = np.linspace(asked_s[0], asked_s[-1], pieces + 1)
        knots_rad, rms, early = _fitted(_hats(asked_s, knots_s), table_rad - table_rad[0])
        cost = 2.0 * count * math.log(max(rms, _FINEST_RAD)) + (pieces + 1) * math.log(count)
        if best is None or cost < best[0]:
            best = cost, TableCourse(knots_s, knots_rad + table_rad[0], early)
    assert best is not None  # one piece is always tried
    return best[1]


def _fitted(hats: FloatArray, angles_rad: FloatArray) -> tuple[FloatArray, float, float]:
    """Knots by asymmetric least squares; rms in the same weights; rms of what is early.

    A device that is busy answers late, never early, and a late answer is further on the table's
    way: it counts little. So a busy hour does not turn the part against a quiet one.
    """
    onward = math.copysign(1.0, float(angles_rad[-1] - angles_rad[0]))
    weight = np.ones(len(angles_rad))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        knots_rad = np.linalg.lstsq(hats * root[:, None], angles_rad * root, rcond=None)[0]
        off = angles_rad - hats @ knots_rad
        weight = np.where(onward * off > 0.0, _LATE, 1.0)
    early = off[onward * off <= 0.0]
    rms, early_rms = np.sqrt(np.average(off**2, weights=weight)), np.sqrt(np.mean(early**2))
    return np.asarray(knots_rad), float(rms), float(early_rms)


def _hats(at_s: FloatArray, knots_s: FloatArray) -> FloatArray:
    """Weights (n, k) of the knots at times (n,), linear between them."""
    return np.stack([np.interp(at_s, knots_s, each) for each in np.eye(len(knots_s))], axis=1)


def _edge_under(x: FloatArray, y: FloatArray) -> tuple[int, int]:
    """Ends of the lower hull's edge that spans x = 0, of points whose x increases."""
    hull: list[int] = []
    for here in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (x[b] - x[a]) * (y[here] - y[a]) > (y[b] - y[a]) * (x[here] - x[a]):
                break
            hull.pop()
        hull.append(here)
    right = int(np.clip(np.searchsorted(x[hull], 0.0), 1, len(hull) - 1))
    return hull[right - 1], hull[right]
