"""Where a stiffness is told over a surface: a lattice of stations, and what lies between them.

The logarithm of each stiffness is bilinear between the stations of a coarse lattice. Neighbouring
stations are tied by a random walk, which speaks only where the data say little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.skinning.bending import Rows
from reconstruction.skinning.net import Net

_SPANS_A_STATION = 8.0
_MOST = 12  # stations in one direction
_TIE = 8.0  # precision of the difference of two neighbouring stations' log stiffness
_KIN = 0.05  # precision of the difference of the two directions' mean log stiffness
_FAINT = 0.05  # degrees of freedom that are as good as none
_STEP = 3.0  # of a logarithm, at once


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A lattice of stations over a net's domain."""

    shape: tuple[int, int]
    ends: tuple[float, float]  # of the domain
    closed: tuple[bool, bool]
    ties: FloatArray  # (stations, stations)

    @staticmethod
    def over(net: Net, halvings: tuple[int, int] = (0, 0)) -> Lattice:
        """Stations for a net, some spans apart: of those that it has once they are halved."""
        end_u, end_v = net.spans
        shape = (_count(end_u * 2.0 ** halvings[0]), _count(end_v * 2.0 ** halvings[1]))
        closed = (net.closed_u, net.closed_v)
        ties = np.kron(_walk(shape[0], closed=closed[0]), np.eye(shape[1]))
        ties += np.kron(np.eye(shape[0]), _walk(shape[1], closed=closed[1]))
        return Lattice(shape, net.spans, closed, frozen(_TIE * ties))

    def refined(self, along: tuple[bool, bool]) -> Lattice:
        """The same stations over a net with spans halved."""
        ends = (self.ends[0] * (1 + along[0]), self.ends[1] * (1 + along[1]))
        return replace(self, ends=ends)

    @property
    def count(self) -> int:
        """How many stations there are."""
        return self.shape[0] * self.shape[1]

    def hats(self, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """The stations beside each row and their weights, (r, 4) each."""
        low_u, high_u, part_u = self._beside(rows.u, 0)
        low_v, high_v, part_v = self._beside(rows.v, 1)
        width = self.shape[1]
        numbers = np.stack(
            [low_u * width + low_v, high_u * width + low_v, low_u * width + high_v,
             high_u * width + high_v], axis=1,
        )  # fmt: skip
        weights = np.stack(
            [(1 - part_u) * (1 - part_v), part_u * (1 - part_v), (1 - part_u) * part_v,
             part_u * part_v], axis=1,
        )  # fmt: skip
        return numbers, weights

    def values(self, rows: Rows, logs: FloatArray) -> FloatArray:
        """Log stiffness of every row, (r,)."""
        numbers, weights = self.hats(rows)
        return np.asarray((logs[numbers] * weights).sum(axis=1))

    def stepped(
        self,
        rows: Rows,
        logs: FloatArray,
        others: FloatArray,
        free: FloatArray,
        forms: FloatArray,
    ) -> tuple[FloatArray, float]:
        """One step towards the likelihood's maximum, held by ties; what it gains of its logarithm.

        Parameters
        ----------
        others
            Log stiffness in the other direction: where it alone does everything, the data say
            nothing of this one, which must not drift away then.
        free, forms
            (r,), degrees of freedom that each row has left to the data, and what its bend spends.
        """
        numbers, weights = self.hats(rows)
        size = self.count
        given = np.bincount(numbers.ravel(), (weights * free[:, None]).ravel(), size)
        bent = np.bincount(numbers.ravel(), (weights * forms[:, None]).ravel(), size)
        left = np.maximum(given, 0.0) + _FAINT
        wanted = np.clip(np.log(left / (bent + _FAINT)), -_STEP, _STEP)
        kin = _KIN / size
        gradient = 0.5 * left * wanted - self.ties @ logs - kin * (logs - others)
        known = np.diag(0.5 * left + kin) + self.ties
        step = np.clip(np.linalg.solve(known, gradient), -_STEP, _STEP)
        return np.asarray(logs + step), float(gradient @ step)

    def _beside(self, at: FloatArray, axis: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        count, end, closed = self.shape[axis], self.ends[axis], self.closed[axis]
        place = np.clip(at / end, 0.0, 1.0) * (count if closed else count - 1)
        low = np.minimum(np.floor(place).astype(np.int64), count - 1)
        high = (low + 1) % count if closed else np.minimum(low + 1, count - 1)
        return low, high, place - low


def _count(spans: float) -> int:
    return int(min(max(round(spans / _SPANS_A_STATION), 1), _MOST))


def _walk(count: int, *, closed: bool) -> FloatArray:
    steps = np.roll(np.eye(count), 1, axis=1) - np.eye(count)
    steps = steps if closed else steps[:-1]
    return np.asarray(steps.T @ steps)
