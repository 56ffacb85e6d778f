"""Points, derivatives and normals of surfaces, on grids and at scattered parameters.

On a grid the basis is hoisted per row and per column, and the sum over u is done once a row.
Directions that are periodic take any real parameter; open ones raise `ValueError` outside their
domain. A function on a grid takes u (mu,) and v (mv,); its twin ``..._at`` takes pairs (m,), (m,).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.nurbs import kernels
from reconstruction.nurbs.basis import basis_derivatives, find_spans, in_domain
from reconstruction.nurbs.degenerate import are_regular, replaced_normals
from reconstruction.nurbs.evaluation import homogeneous, wrapped

if TYPE_CHECKING:
    from reconstruction.nurbs.values import Surface

_Bases = tuple[IntArray, tuple[FloatArray, FloatArray]]

# Where |Su x Sv| is below this part of what the surface's extent suggests, the slow and careful
# way (`degenerate`) decides; it only selects who looks, it decides nothing.
_SUSPECT = 1e-7


def evaluate_surface(surface: Surface, u: ArrayLike, v: ArrayLike) -> FloatArray:
    """Points of the grid u (mu,) x v (mv,); shape (mu, mv, 3), mm."""
    u, v = _inside(surface, u, v)
    (first_u, bases_u), (first_v, bases_v) = _grid_bases(surface, u, v)
    points = np.empty((len(u), len(v), 3))
    kernels.grid_points(
        _net(surface), first_u, bases_u[0], first_v, bases_v[0], *_unrolled(surface), points
    )
    return points


def surface_derivatives_on_grid(
    surface: Surface, u: ArrayLike, v: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points and both first derivatives S, S_u, S_v of a grid; (mu, mv, 3) each."""
    u, v = _inside(surface, u, v)
    (first_u, bases_u), (first_v, bases_v) = _grid_bases(surface, u, v)
    frames = np.empty((3, len(u), len(v), 3))
    parts = frames[0], frames[1], frames[2]
    kernels.grid_frames(
        _net(surface), first_u, bases_u, first_v, bases_v, *_unrolled(surface), parts
    )
    return parts


def points_and_normals(
    surface: Surface, u: ArrayLike, v: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Points and unit normals of a grid, (mu, mv, 3) each; see `surface_normals`."""
    u, v = _inside(surface, u, v)
    (first_u, bases_u), (first_v, bases_v) = _grid_bases(surface, u, v)
    points, normals = np.empty((len(u), len(v), 3)), np.empty((len(u), len(v), 3))
    missing = kernels.grid_normals(
        _net(surface), first_u, bases_u, first_v, bases_v, *_unrolled(surface),
        points, normals, _suspect_length(surface),
    )  # fmt: skip
    if missing:
        rows, columns = np.nonzero(~normals.any(axis=2))
        normals[rows, columns] = _careful_normals(surface, u[rows], v[columns])
    return points, normals


def surface_normals(surface: Surface, u: ArrayLike, v: ArrayLike) -> FloatArray:
    """Return the unit normals S_u x S_v of a grid; (mu, mv, 3).

    Where a derivative vanishes because a row of the net is one point (a pole, the apex of a cone),
    the normal is the limit from inside the domain along the other direction. Where there is no
    such limit, as on a surface that has collapsed to a line, the normal is (0, 0, 0).
    """
    return points_and_normals(surface, u, v)[1]


def evaluate_surface_at(surface: Surface, u: ArrayLike, v: ArrayLike) -> FloatArray:
    """Points at scattered parameters u (m,), v (m,); shape (m, 3), mm."""
    u, v = _pairs(surface, u, v)
    points = np.empty((len(u), 3))
    kernels.scattered_points(
        _net(surface), u, surface.knots_u, v, surface.knots_v, *_unrolled(surface), points
    )
    return _exact_at_ends(surface, u, v, points)


def points_and_normals_at(
    surface: Surface, u: ArrayLike, v: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Points and unit normals at scattered parameters, (m, 3) each; see `surface_normals`."""
    u, v = _pairs(surface, u, v)
    points, normals = np.empty((len(u), 3)), np.empty((len(u), 3))
    missing = kernels.scattered_normals(
        _net(surface), u, surface.knots_u, v, surface.knots_v, *_unrolled(surface),
        points, normals, _suspect_length(surface),
    )  # fmt: skip
    if missing:
        rows = np.flatnonzero(~normals.any(axis=1))
        normals[rows] = _careful_normals(surface, u[rows], v[rows])
    return _exact_at_ends(surface, u, v, points), normals


def points_and_tangents_at(
    surface: Surface, u: ArrayLike, v: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points and both first derivatives S, S_u, S_v at scattered parameters; (m, 3) each."""
    u, v = _pairs(surface, u, v)
    frames = np.empty((3, len(u), 3))
    parts = frames[0], frames[1], frames[2]
    kernels.scattered_tangents(
        _net(surface), u, surface.knots_u, v, surface.knots_v, *_unrolled(surface), parts
    )
    return _exact_at_ends(surface, u, v, parts[0]), parts[1], parts[2]


@dataclass(frozen=True, slots=True, eq=False)
class Curvatures:
    """Of a surface at m places; positive where it bends towards its normal S_u x S_v."""

    gaussian_per_mm2: FloatArray  # (m,)
    mean_per_mm: FloatArray  # (m,)
    principal_per_mm: FloatArray  # (m, 2), the larger first

    def __post_init__(self) -> None:
        for name in ("gaussian_per_mm2", "mean_per_mm", "principal_per_mm"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def surface_curvatures_at(surface: Surface, u: ArrayLike, v: ArrayLike) -> Curvatures:
    """Curvatures at scattered parameters u (m,), v (m,).

    Where S_u x S_v vanishes, as at a pole, they are NaN. On a knot so multiple that the surface
    bends abruptly they are those behind it, at the domain's end those before it.
    """
    u, v = _pairs(surface, u, v)
    found = _curvatures(surface, u, v, _suspect_length(surface))
    rows = np.flatnonzero(np.isnan(found[:, 0]))
    if len(rows):
        sound = rows[_are_regular(surface, u[rows], v[rows])]
        found[sound] = _curvatures(surface, u[sound], v[sound], 0.0)
    return Curvatures(found[:, 0], found[:, 1], found[:, 2:])


def surface_normals_at(surface: Surface, u: ArrayLike, v: ArrayLike) -> FloatArray:
    """Return unit normals at scattered parameters, (m, 3); see `surface_normals`."""
    return points_and_normals_at(surface, u, v)[1]


def surface_derivatives(surface: Surface, u: ArrayLike, v: ArrayLike, order: int = 1) -> FloatArray:
    """Mixed derivatives at scattered parameters u (m,), v (m,).

    Returns
    -------
    Array of shape (order + 1, order + 1, m, 3): ``[k, l]`` is the k-th derivative in u and the
    l-th in v, ``[0, 0]`` the point. All k, l <= order are given, also those with k + l > order.

    References
    ----------
    The NURBS Book, A3.6 and eq. 4.20.
    """
    u, v = _pairs(surface, u, v)
    spans_u, basis_u = basis_derivatives(u, surface.degree_u, surface.knots_u, order)
    spans_v, basis_v = basis_derivatives(v, surface.degree_v, surface.knots_v, order)
    net = _net(surface)
    sums = np.empty((order + 1, order + 1, len(u), 4))
    for k in range(order + 1):
        for m in range(order + 1):
            sums[k, m] = kernels.combined_scattered(basis_u[k], spans_u, basis_v[m], spans_v, net)
    return _projected(sums)


def _curvatures(surface: Surface, u: FloatArray, v: FloatArray, least: float) -> FloatArray:
    found = np.empty((len(u), 4))
    kernels.scattered_curvatures(
        _net(surface), u, surface.knots_u, v, surface.knots_v, *_unrolled(surface), found, least
    )
    return found


def _projected(sums: FloatArray) -> FloatArray:
    weights = sums[..., 3:]
    out = np.empty((*sums.shape[:-1], 3))
    for k, m in np.ndindex(sums.shape[:2]):
        rest = sums[k, m, :, :3].copy()
        for i, j in np.ndindex(k + 1, m + 1):
            if i or j:
                rest -= comb(k, i) * comb(m, j) * weights[i, j] * out[k - i, m - j]
        out[k, m] = rest / weights[0, 0]
    return out


def _careful_normals(surface: Surface, u: FloatArray, v: FloatArray) -> FloatArray:
    derivatives, steps = surface_derivatives(surface, u, v, 1), _steps(surface, u, v)
    return replaced_normals(derivatives, u, v, surface.domain, steps)


def _are_regular(surface: Surface, u: FloatArray, v: FloatArray) -> BoolArray:
    return are_regular(surface_derivatives(surface, u, v, 1), _steps(surface, u, v))


def _steps(surface: Surface, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (
        _span_lengths(u, surface.degree_u, surface.knots_u),
        _span_lengths(v, surface.degree_v, surface.knots_v),
    )


def _span_lengths(u: FloatArray, degree: int, knots: FloatArray) -> FloatArray:
    spans = find_spans(u, degree, knots)
    return np.asarray(knots[spans + 1] - knots[spans])


def _exact_at_ends(
    surface: Surface, u: FloatArray, v: FloatArray, points: FloatArray
) -> FloatArray:
    """Redo the points on the domain's border, where the fast basis may be one rounding off."""
    (u0, u1), (v0, v1) = surface.domain
    if not len(u) or (u0 < u.min() and u.max() < u1 and v0 < v.min() and v.max() < v1):
        return points
    ends = np.flatnonzero((u == u0) | (u == u1) | (v == v0) | (v == v1))
    if len(ends):
        points[ends] = surface_derivatives(surface, u[ends], v[ends], 0)[0, 0]
    return points


def _suspect_length(surface: Surface) -> float:
    (u0, u1), (v0, v1) = surface.domain
    extent = np.linalg.norm(np.ptp(surface.control_points_mm, axis=(0, 1)))
    return _SUSPECT * float(extent**2) / ((u1 - u0) * (v1 - v0))


def _grid_bases(surface: Surface, u: FloatArray, v: FloatArray) -> tuple[_Bases, _Bases]:
    return (
        _first_and_bases(u, surface.degree_u, surface.knots_u),
        _first_and_bases(v, surface.degree_v, surface.knots_v),
    )


def _first_and_bases(u: FloatArray, degree: int, knots: FloatArray) -> _Bases:
    spans = find_spans(u, degree, knots)
    return spans - degree, kernels.basis_rows(u, spans, knots, degree)


def _unrolled(surface: Surface) -> tuple[kernels.Unroll, kernels.Unroll]:
    """Choose the compiled form: one of its own for bicubic surfaces, one for all others."""
    if surface.degree_u == surface.degree_v == 3:
        return (0, 0, 0, 0), (0, 0, 0, 0)
    return np.zeros(surface.degree_u + 1), np.zeros(surface.degree_v + 1)


def _net(surface: Surface) -> FloatArray:
    net = homogeneous(surface.control_points_mm, surface.weights)
    net = wrapped(net, surface.degree_u, periodic=surface.periodic_u)
    net = wrapped(net.swapaxes(0, 1), surface.degree_v, periodic=surface.periodic_v)
    return np.ascontiguousarray(net.swapaxes(0, 1))


def _inside(surface: Surface, u: ArrayLike, v: ArrayLike) -> tuple[FloatArray, FloatArray]:
    return (
        in_domain(u, surface.degree_u, surface.knots_u, periodic=surface.periodic_u),
        in_domain(v, surface.degree_v, surface.knots_v, periodic=surface.periodic_v),
    )


def _pairs(surface: Surface, u: ArrayLike, v: ArrayLike) -> tuple[FloatArray, FloatArray]:
    u, v = _inside(surface, u, v)
    if len(u) != len(v):
        raise ValueError(f"scattered parameters come in pairs: {len(u)} u, {len(v)} v")
    return u, v
