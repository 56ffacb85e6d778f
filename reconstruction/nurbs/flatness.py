r"""How far a surface bends away from flat triangles: its second derivatives between the knots.

Over a rectangle of parameters h x k that a diagonal cuts in two, with all corners on the surface,
the surface is off by an eighth of about the greatest of

    h^2 |S_uu|    k^2 |S_vv|    |h^2 L +- 2 h k M + k^2 N|

at the middles of its sides and of the diagonal, whose choice is the sign; L, M, N are S_uu, S_uv
and S_vv along the normal (the second fundamental form). Where a surface is a saddle the last term
is small. The sum of all terms bounds any triangle in the rectangle (Filip, Magedson, Markot 1986,
doi:10.1016/0167-8396(86)90005-1); it is several times what is needed.

Of S_uu and S_vv only what is across S_u and S_v counts, so that an uneven speed along a line costs
nothing. They are sampled at the corners of at least 32 x 32 cells that knots do not cut: second
derivatives of a cubic polynomial are linear in between. So this says where a surface bends more
than elsewhere; how far triangles are really off is measured afterwards (`tessellation`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.nurbs.basis import domain_of
from reconstruction.nurbs.surface_evaluation import surface_derivatives, surface_normals_at
from reconstruction.nurbs.values import Surface

_LEAST_CELLS = 32
_INSIDE = 1e-7  # of a span, so that a sample at a knot is taken on the right side of it


@dataclass(frozen=True, slots=True, eq=False)
class Flatness:
    """How a surface bends in each of its cells.

    `sharp` breaks are those across which the surface may have an edge; the ends of the domain are.
    """

    breaks_u: FloatArray  # (a + 1,), from the domain's start to its end
    breaks_v: FloatArray  # (b + 1,)
    sharp_u: BoolArray  # (a + 1,)
    sharp_v: BoolArray  # (b + 1,)
    bends: Bends  # of (a, b) cells

    def __post_init__(self) -> None:
        for name in ("breaks_u", "breaks_v"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        for name in ("sharp_u", "sharp_v"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.bool_))

    @property
    def turned(self) -> Flatness:
        """That of the surface with u and v exchanged."""
        return Flatness(self.breaks_v, self.breaks_u, self.sharp_v, self.sharp_u, self.bends.turned)


@dataclass(frozen=True, slots=True, eq=False)
class Bends:
    """Second derivatives, each the most that any cell of a group has; all arrays of one shape."""

    along_u: FloatArray  # |S_uu| across S_u
    along_v: FloatArray  # |S_vv| across S_v
    least: FloatArray  # (3, ...), L, M and N
    most: FloatArray  # (3, ...)

    @property
    def turned(self) -> Bends:
        """With u and v exchanged; the normal turns round."""
        return Bends(
            self.along_v.T, self.along_u.T,
            -self.most[::-1].swapaxes(1, 2), -self.least[::-1].swapaxes(1, 2),
        )  # fmt: skip

    @property
    def twist(self) -> FloatArray:
        """Greatest |M|."""
        return np.asarray(np.maximum(np.abs(self.least[1]), np.abs(self.most[1])))

    def off(self, h: FloatArray, k: FloatArray) -> FloatArray:
        """How far a rectangle h x k is from its triangles, along the better diagonal."""
        squares = np.maximum(h * h * self.along_u, k * k * self.along_v)
        sums = [h * h * each[0] + k * k * each[2] for each in (self.least, self.most)]
        low, high = 2.0 * h * k * self.least[1], 2.0 * h * k * self.most[1]
        one = np.maximum(np.abs(sums[0] + low), np.abs(sums[1] + high))
        other = np.maximum(np.abs(sums[0] - high), np.abs(sums[1] - low))
        return np.asarray(np.maximum(squares, np.minimum(one, other)) / 8.0)

    def over(self, groups: Callable[[np.ufunc, FloatArray], FloatArray]) -> Bends:
        """Those of groups of cells; `groups(ufunc, values)` reduces the last axes."""
        return Bends(
            groups(np.maximum, self.along_u), groups(np.maximum, self.along_v),
            np.stack([groups(np.minimum, each) for each in self.least]),
            np.stack([groups(np.maximum, each) for each in self.most]),
        )  # fmt: skip


def flatness(surface: Surface) -> Flatness:
    """Sample the second derivatives of a surface."""
    breaks_u, sharp_u = _breaks(surface.degree_u, surface.knots_u)
    breaks_v, sharp_v = _breaks(surface.degree_v, surface.knots_v)
    u, v = _samples(breaks_u), _samples(breaks_v)
    sampled = _sampled(surface, np.repeat(u, len(v)), np.tile(v, len(u)))
    corners = sampled.reshape(5, len(u) // 2, 2, len(v) // 2, 2)
    most, least = corners.max(axis=(2, 4)), corners.min(axis=(2, 4))
    return Flatness(
        breaks_u, breaks_v, sharp_u, sharp_v, Bends(most[0], most[1], least[2:], most[2:])
    )


def _sampled(surface: Surface, u: FloatArray, v: FloatArray) -> FloatArray:
    """What counts of S_uu and S_vv, and L, M and N, at scattered parameters (m,); (5, m)."""
    derivatives = surface_derivatives(surface, u, v, 2)
    seconds = derivatives[[2, 1, 0], [0, 1, 2]]
    form = np.einsum("kij,ij->ki", seconds, surface_normals_at(surface, u, v))
    return np.concatenate(
        [
            _across(derivatives[2, 0], derivatives[1, 0])[None],
            _across(derivatives[0, 2], derivatives[0, 1])[None],
            form,
        ]
    )


def _across(second: FloatArray, first: FloatArray) -> FloatArray:
    """Length of the second derivatives (m, 3) across the first ones."""
    squares = np.einsum("ij,ij->i", first, first)
    along = np.einsum("ij,ij->i", second, first)
    share = np.divide(along, squares, out=np.zeros_like(along), where=squares > 0)
    return np.asarray(np.linalg.norm(second - share[:, None] * first, axis=1))


def _samples(breaks: FloatArray) -> FloatArray:
    """Just inside both ends of every cell, (2 cells,)."""
    widths = np.diff(breaks)
    return np.stack([breaks[:-1] + _INSIDE * widths, breaks[1:] - _INSIDE * widths], axis=1).ravel()


def _breaks(degree: int, knots: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Knots of the domain, and places between them where they are few; whether they are sharp."""
    spans = _spans(degree, knots)
    end = domain_of(degree, knots)[1]
    pieces = 1 if degree == 1 else -(-_LEAST_CELLS // len(spans))
    starts, widths = knots[spans], knots[spans + 1] - knots[spans]
    breaks = (starts[:, None] + np.arange(pieces) / pieces * widths[:, None]).ravel()
    times = np.searchsorted(knots, starts, "right") - np.searchsorted(knots, starts, "left")
    sharp = np.zeros((len(spans), pieces), dtype=np.bool_)
    sharp[:, 0] = times >= degree
    sharp[0, 0] = True
    return np.append(breaks, end), np.append(sharp.ravel(), True)


def _spans(degree: int, knots: FloatArray) -> IntArray:
    """Indices k of the spans of the domain that have a length."""
    start, end = domain_of(degree, knots)
    inside = (knots[:-1] < knots[1:]) & (knots[:-1] >= start) & (knots[1:] <= end)
    return np.flatnonzero(inside)
