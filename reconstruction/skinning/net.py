"""A net of control points under way to a surface: uniform bicubic, clamped or closed.

Knots are the integers in both directions; u runs around the outlines, v from outline to outline. An
open direction is clamped, so that a surface ends on its last row of control points. A row may be an
*apex*: all its control points are one.

At a *crease*, an integer u, the knot stands four times: two columns of control points end there,
one from either face, so that each moves along the normal of its own face. They are one in space,
and one, on a triple knot, in the surface that the net hands out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.nurbs import Surface, basis_derivatives
from reconstruction.nurbs.kernels import basis_derivative_rows

_DEGREE = 3
_EMPTY = 1e-300
_NONE = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Net:
    """Control points (nu, nv, 3)."""

    control_mm: FloatArray  # (nu, nv, 3)
    knots_u: FloatArray  # as `reconstruction.nurbs` stores them
    knots_v: FloatArray
    closed_u: bool
    closed_v: bool
    apex: BoolArray  # (nv,), rows that are one point

    def __post_init__(self) -> None:
        for name in ("control_mm", "knots_u", "knots_v"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "apex", frozen(self.apex, np.bool_))

    @property
    def creases(self) -> IntArray:
        """Values of u (c,) at which the surface has an edge."""
        counts = np.bincount(self.knots_u[4:-4].astype(np.int64))
        return np.asarray(np.flatnonzero(counts > _DEGREE))

    @property
    def crease_columns(self) -> IntArray:
        """Columns of control points (c, 2) that meet in creases, from before and from behind."""
        right = np.searchsorted(self.knots_u, self.creases)
        return np.stack([right - 1, right], axis=1)

    @property
    def walls(self) -> IntArray:
        """First and last column of control points (w, 2) of every wall of a step.

        In an open net creases are the edges of walls that no section shows, two and two (`sheets`).
        """
        if self.closed_u or not len(self.creases):
            return np.empty((0, 2), np.int64)
        pairs = self.crease_columns.reshape(-1, 2, 2)
        return np.asarray(np.stack([pairs[:, 0, 1], pairs[:, 1, 0]], axis=1))

    @property
    def spans(self) -> tuple[float, float]:
        """Ends of the domain, which begins at 0."""
        return (
            float(self.knots_u[len(self.knots_u) - 4]),
            float(self.knots_v[len(self.knots_v) - 4]),
        )

    def moved(self, control_mm: FloatArray) -> Net:
        """The same net with other control points."""
        return replace(self, control_mm=control_mm)

    def cut_at(self, creases: IntArray) -> Net:
        """The same with two columns of control points for one at triple knots (c,) of u."""
        if not len(creases):
            return self
        whole = np.searchsorted(self.knots_u, creases) - 1
        knots_u = knots_of(
            int(self.spans[0]), closed=self.closed_u, creases=creases, times=_DEGREE + 1
        )
        control = np.insert(self.control_mm, whole, self.control_mm[whole], axis=0)
        return replace(self, control_mm=control, knots_u=knots_u)

    def surface(self) -> Surface:
        """As a NURBS surface of weights one."""
        knots_u, control = self.knots_u, self.control_mm
        if len(self.creases):
            knots_u = knots_of(int(self.spans[0]), closed=self.closed_u, creases=self.creases)
            control = np.delete(control, self.crease_columns[:, 1], axis=0)
        return Surface(
            3, 3, knots_u, self.knots_v, control, np.ones(control.shape[:2]), self.closed_u,
            self.closed_v,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """The four basis functions that live at each of m parameters, and their derivatives."""

    first: IntArray  # (m,), control point of the first of them
    values: FloatArray  # (m, order + 1, 4)


def knots_of(
    spans: int, *, closed: bool, creases: IntArray = _NONE, times: int = _DEGREE
) -> FloatArray:
    """Integer knots of a cubic on [0, spans]: clamped, or repeating.

    Parameters
    ----------
    creases
        (c,), knots between 0 and spans that stand so many `times`.
    """
    if not closed:
        inner = np.sort(np.append(np.arange(1, spans), np.repeat(creases, times - 1)))
        return np.concatenate([np.zeros(4), inner, np.full(4, float(spans))])
    period = np.sort(np.append(np.arange(spans), np.repeat(creases, times - 1)))
    turns, places = np.divmod(np.arange(-_DEGREE, len(period) + _DEGREE + 1), len(period))
    return np.asarray(period[places] + turns * float(spans))


def basis_at(t: FloatArray, knots: FloatArray, order: int, *, closed: bool) -> Basis:
    """Basis functions at parameters (m,) inside the domain."""
    if order <= 2:
        t = np.mod(t, knots[-4]) if closed else t
        return Basis(*_cubics(np.ascontiguousarray(t), frozen(knots), order))
    spans, values = basis_derivatives(t, 3, knots, order, periodic=closed)
    return Basis(spans - 3, np.ascontiguousarray(np.moveaxis(values, 0, 1)))


@njit(cache=True, nogil=True, error_model="numpy")
def _cubics(t: FloatArray, knots: FloatArray, order: int) -> tuple[IntArray, FloatArray]:
    """What `nurbs.basis_derivatives` gives, for knots that are integers, several times as fast."""
    first, values = np.empty(len(t), np.int64), np.zeros((len(t), order + 1, 4))
    spans = int(knots[-4])
    starts = np.searchsorted(knots, np.arange(spans), "right") - 1
    line, plain = np.empty(2), np.empty(3)
    for m in range(len(t)):
        s = starts[min(max(int(np.floor(t[m])), 0), spans - 1)] - 3
        first[m] = s
        # The knots about the span: k2 <= t < k3; both beside them may repeat.
        k0, k1, k2, k3, k4, k5 = (
            knots[s + 1], knots[s + 2], knots[s + 3], knots[s + 4], knots[s + 5], knots[s + 6]
        )  # fmt: skip
        x = t[m]
        line[0], line[1] = k3 - x, x - k2  # of a span as long as one
        a, b = line[0] / (k3 - k1), line[1] / (k4 - k2)
        plain[0] = a * (k3 - x)
        plain[1] = a * (x - k1) + b * (k4 - x)
        plain[2] = b * (x - k2)
        c, d, e = plain[0] / (k3 - k0), plain[1] / (k4 - k1), plain[2] / (k5 - k2)
        out = values[m]
        out[0, 0] = c * (k3 - x)
        out[0, 1] = c * (x - k0) + d * (k4 - x)
        out[0, 2] = d * (x - k1) + e * (k5 - x)
        out[0, 3] = e * (x - k2)
        if order > 0:
            out[1, 0], out[1, 1], out[1, 2], out[1, 3] = (
                -3.0 * c, 3.0 * (c - d), 3.0 * (d - e), 3.0 * e
            )  # fmt: skip
        if order > 1:
            # Slopes of the quadratics, over the same knots.
            p, q = 2.0 * a, 2.0 * b
            c, d, e = -p / (k3 - k0), (p - q) / (k4 - k1), q / (k5 - k2)
            out[2, 0], out[2, 1], out[2, 2], out[2, 3] = (
                -3.0 * c, 3.0 * (c - d), 3.0 * (d - e), 3.0 * e
            )  # fmt: skip
    return first, values


def basis_of_spans(knots: FloatArray) -> Basis:
    """Basis functions at both ends of every span (s,): values (2 s, 3, 4), start and end in turn.

    Of a span's own polynomial: at a crease the next span bends otherwise.
    """
    spans = int(knots[-4])
    starts = np.searchsorted(knots, np.arange(spans), "right") - 1
    at = np.arange(spans)[:, None] + np.array([0.0, 1.0])
    rows = basis_derivative_rows(at.ravel(), np.repeat(starts, 2), knots, _DEGREE, 2)
    return Basis(np.repeat(starts - _DEGREE, 2), np.ascontiguousarray(np.moveaxis(rows, 2, 1)))


def greville(knots: FloatArray, count: int) -> FloatArray:
    """Where each of `count` control points has most influence, (count,)."""
    return np.asarray((knots[1 : count + 1] + knots[2 : count + 2] + knots[3 : count + 3]) / 3.0)


def derivatives_at(net: Net, u: FloatArray, v: FloatArray) -> FloatArray:
    """Points and derivatives S, Su, Sv, Suu, Suv, Svv at (m,), (m,); (m, 6, 3)."""
    at_u = basis_at(u, net.knots_u, 2, closed=net.closed_u)
    at_v = basis_at(v, net.knots_v, 2, closed=net.closed_v)
    return np.asarray(
        _derivatives(net.control_mm, at_u.first, at_u.values, at_v.first, at_v.values)
    )


def unit_normals(first_u: FloatArray, first_v: FloatArray) -> FloatArray:
    """Su x Sv over its length, (m, 3); zero where there is none."""
    cross = np.cross(first_u, first_v)
    lengths = np.linalg.norm(cross, axis=-1, keepdims=True)
    return np.asarray(cross / np.maximum(lengths, _EMPTY))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _derivatives(
    control: FloatArray, first_u: IntArray, bases_u: FloatArray, first_v: IntArray,
    bases_v: FloatArray,
) -> FloatArray:  # fmt: skip
    count_u, count_v = control.shape[:2]
    out = np.zeros((len(first_u), 6, 3))
    along = np.empty((3, 3))
    for m in range(len(first_u)):
        for a in range(4):
            i = (first_u[m] + a) % count_u
            along[:] = 0.0
            for b in range(4):
                point = control[i, (first_v[m] + b) % count_v]
                for d in range(3):
                    for order in range(3):
                        along[order, d] += bases_v[m, order, b] * point[d]
            b0, b1, b2 = bases_u[m, 0, a], bases_u[m, 1, a], bases_u[m, 2, a]
            for d in range(3):
                out[m, 0, d] += b0 * along[0, d]
                out[m, 1, d] += b1 * along[0, d]
                out[m, 2, d] += b0 * along[1, d]
                out[m, 3, d] += b2 * along[0, d]
                out[m, 4, d] += b1 * along[1, d]
                out[m, 5, d] += b0 * along[2, d]
    return out
