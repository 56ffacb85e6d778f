"""A first net along aligned outlines, and a first place on it for every cell.

v follows the distance from outline to outline, averaged around; so does every station. The net runs
on beyond the first and the last outline as far as the ends are said to lie.

::

    v = spans    end: a level row, or an apex
      |          outline k
      |          ...
    v = 0        end
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.nurbs import evaluate_surface
from reconstruction.skinning.aligning import Stations
from reconstruction.skinning.ends import Apex, Brim
from reconstruction.skinning.net import Net, basis_at, knots_of
from reconstruction.skinning.outlines import Outline

_STIFFNESSES = np.arange(-4.0, 5.0)  # powers of ten, of third differences beside the data
_FINE = 4  # places a span when lengths are told anew
_AROUND = 64  # lines along which they are
_FAINT = 1e-6
_NEXT_TO_NOTHING = 1e-8
_NONE = np.empty(0, np.int64)
_CROWDED_SPANS = 0.5
_FIRM = 1e3  # weight of an end's own row


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """A net near the outlines, and where on it their cells are."""

    net: Net
    u: FloatArray  # (cells of all outlines,)
    v: FloatArray
    rows_v: FloatArray  # (k,), of each outline

    def __post_init__(self) -> None:
        for name in ("u", "v", "rows_v"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def lay_net(
    outlines: tuple[Outline, ...],
    stations: Stations,
    brims: tuple[Brim | Apex, Brim | Apex] | None,
    spans: tuple[int, int],
    *,
    through: bool = False,
) -> Laid:
    """Lay a net of (u, v) spans through stations.

    Parameters
    ----------
    brims
        How the surface ends before the first and after the last outline; None: it closes in v.
    through
        Along v, natural splines through all rows, not smooth curves near them.
    """
    columns = stations.shares.shape[1]
    if brims is None:
        rows, places = _closing_rows(stations, spans[1])
    else:
        rows, places = _open_rows(stations, brims, spans[1])
    creases = np.array(stations.creases, dtype=np.int64) * spans[0] // columns
    along = np.arange(columns) / columns * spans[0]
    kept = _spread(rows) if through and brims is not None else np.arange(len(rows))
    net = net_through(
        places[kept], rows[kept], along, spans, brims, creases,
        closed=(True, brims is None), through=through,
    )  # fmt: skip
    own = rows if brims is None else rows[1:-1]
    u = np.concatenate(stations.columns_of_cells()) * (spans[0] / columns)
    v = np.concatenate(_rows_of_cells(outlines, own, spans[1], closed=brims is None))
    return Laid(net, np.mod(u, spans[0]), v, own)


def relaid(net: Net, v: FloatArray) -> tuple[Net, FloatArray]:
    """The same surface with v running evenly, and where parameters (m,) went.

    Over a gap the first net follows the chord; once the surface is known to bend there, its own
    length tells better how far it is across.
    """
    end_u, end_v = net.spans
    fine = np.linspace(0.0, end_v, _FINE * int(end_v) + 1)
    columns = np.arange(_AROUND) / _AROUND * end_u
    places = evaluate_surface(net.surface(), columns, fine).swapaxes(0, 1)
    along = np.concatenate([[0.0], strides(places).cumsum()])
    along *= end_v / along[-1]
    along[-1] = end_v  # exactly
    wanted = np.linspace(0.0, end_v, _FINE * int(end_v) + 1)
    back = np.interp(wanted, along, fine)
    # S = sum over i of B_i(u) c_i(v): each c_i is a curve of its own and is told anew.
    design, bends = _design(wanted, net.knots_v, closed=net.closed_v)
    lines = _design(back, net.knots_v, closed=net.closed_v)[0] @ net.control_mm
    normal = design.T @ design
    normal += _FAINT * float(np.trace(normal)) / len(normal) * bends
    right = np.einsum("mj,imd->jid", design, lines)
    count_u, count_v = net.control_mm.shape[:2]
    solved = np.linalg.solve(normal, right.reshape(count_v, -1)).reshape(count_v, count_u, 3)
    control = np.array(solved.swapaxes(0, 1))
    if not net.closed_v:
        control[:, [0, -1]] = net.control_mm[:, [0, -1]]
    return net.moved(control), np.asarray(np.interp(v, fine, along))


def strides(places: FloatArray) -> FloatArray:
    """Root mean square distance from row to row, (k - 1,)."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=2)
    return np.asarray(np.sqrt((steps**2).mean(axis=1)))


def _open_rows(
    stations: Stations, brims: tuple[Brim | Apex, Brim | Apex], spans: int
) -> tuple[FloatArray, FloatArray]:
    """V of every row, an end's row at either end, and the rows' places."""
    low, high = (brim.row_mm(stations.places_mm, last=last) for last, brim in enumerate(brims))
    places = np.concatenate([low[None], stations.places_mm, high[None]])
    along = np.concatenate([[0.0], strides(places).cumsum()])
    return along / along[-1] * spans, places


def _spread(rows: FloatArray) -> IntArray:
    """Which rows at v (k,) a spline is led through: both ends, and no three in one span and a half.

    Several in one span decide its cubic by their noise, and it sways over the rest of the span. An
    end is half a slice's distance, and so half as far as the others are, from its row.
    """
    kept = [0]
    for row in range(1, len(rows) - 1):
        before = rows[kept[-2]] if len(kept) > 1 else -math.inf
        alone = min(rows[row] - rows[kept[-1]], rows[-1] - rows[row]) >= _CROWDED_SPANS
        if alone and min(rows[row] - before, rows[-1] - rows[kept[-1]]) >= 3.0 * _CROWDED_SPANS:
            kept.append(row)
    return np.array([*kept, len(rows) - 1])


def _closing_rows(stations: Stations, spans: int) -> tuple[FloatArray, FloatArray]:
    """The same where the last row is followed by the first."""
    places = stations.places_mm
    around = np.concatenate([places, places[:1]])
    along = np.concatenate([[0.0], strides(around).cumsum()])
    return along[:-1] / along[-1] * spans, places


def net_through(
    places: FloatArray,
    rows: FloatArray,
    columns: FloatArray,
    spans: tuple[int, int],
    ends: Sequence[Brim | Apex] | None,
    creases: IntArray = _NONE,
    *,
    closed: tuple[bool, bool],
    through: bool = False,
) -> Net:
    """Control points by penalised least squares, first around, then along.

    Parameters
    ----------
    places
        (k, m, 3), row by row.
    rows, columns
        (k,), (m,), their v and u.
    ends
        What the first and the last row are; None: places like others.
    closed
        In u and v.
    """
    knots_u = knots_of(spans[0], closed=closed[0], creases=creases)
    knots_v = knots_of(spans[1], closed=closed[1])
    sides = places.swapaxes(0, 1)
    around = _smoother(columns, knots_u, np.ones(len(columns)), sides, closed=closed[0])
    weights = np.ones(len(rows))
    if ends is not None:
        weights[[0, -1]] = _FIRM
    if through:
        along = _interpolator(rows, knots_v, closed=closed[1])
    else:
        along = _smoother(rows, knots_v, weights, places, closed=closed[1])
    control = np.tensordot(around, np.tensordot(along, places, (1, 0)), (1, 1))
    apex = np.zeros(control.shape[1], np.bool_)
    for last, end in enumerate(ends or ()):
        row = -last
        if isinstance(end, Apex):
            apex[row], control[:, row] = True, end.point_mm
        else:
            end.press(control[:, row])
    net = Net(control, knots_u, knots_v, closed_u=closed[0], closed_v=closed[1], apex=apex)
    return net.cut_at(creases)


def _smoother(
    t: FloatArray, knots: FloatArray, weights: FloatArray, places: FloatArray, *, closed: bool
) -> FloatArray:
    """The matrix (n, m) that makes n control points of m places at parameters t.

    Third differences are penalised as far as leaves the least generalised cross-validation, of all
    columns of places (m, c, 3) together: the ways over gaps hang on how smooth their edges are.
    """
    design, bends = _design(t, knots, closed=closed)
    normal = design.T @ (weights[:, None] * design)
    scale = float(np.trace(normal)) / len(normal)
    best, least = np.empty(0), np.inf
    basis, root = np.linalg.qr(np.sqrt(weights)[:, None] * design)
    beyond, within = _compressed(basis, weights, places)
    unit = np.eye(len(root))
    for log in _STIFFNESSES:
        solver = np.linalg.solve(normal + scale * 10.0**log * bends, root.T)
        hat = root @ solver
        misfit = beyond + float((((unit - hat) @ within) ** 2).sum())
        score = misfit / (len(t) - float(np.trace(hat)) + 1e-9) ** 2
        if score < least:
            best, least = solver, score
    return np.asarray(best @ basis.T * np.sqrt(weights))


def _compressed(
    basis: FloatArray, weights: FloatArray, places: FloatArray
) -> tuple[float, FloatArray]:
    """What of the places (m, c, 3) no spline can follow, squared; of the rest a root, (n, n).

    Misfits are then told from n x n numbers, however many columns there are: hats (m, m) on every
    column of a long scan took a second.
    """
    spectrum = places.reshape(len(places), -1)
    spectrum = np.sqrt(weights)[:, None] * (spectrum - spectrum.mean(axis=0))
    within = basis.T @ spectrum
    beyond = float(((spectrum - basis @ within) ** 2).sum())
    return beyond, np.asarray(np.linalg.qr(within.T, mode="r")).T


def _interpolator(t: FloatArray, knots: FloatArray, *, closed: bool) -> FloatArray:
    """The matrix (n, m) that makes n control points of a natural spline through m places."""
    design, _ = _design(t, knots, closed=closed)
    count = design.shape[1]
    at = np.arange(float(knots[-4]) + (not closed))
    seconds = basis_at(at, knots, 2, closed=closed)
    bends = np.zeros((len(at), count))
    for k in range(4):
        np.add.at(bends, (np.arange(len(at)), (seconds.first + k) % count), seconds.values[:, 2, k])
    normal = design.T @ design + _NEXT_TO_NOTHING * bends.T @ bends
    return np.asarray(np.linalg.solve(normal, design.T))


def _design(t: FloatArray, knots: FloatArray, *, closed: bool) -> tuple[FloatArray, FloatArray]:
    """Basis functions at parameters (m, n), and what penalises third differences, (n, n)."""
    basis = basis_at(t, knots, 0, closed=closed)
    spans = int(knots[-4])
    count = len(knots) - (7 if closed else 4)
    design = np.zeros((len(t), count))
    for k in range(4):
        np.add.at(design, (np.arange(len(t)), (basis.first + k) % count), basis.values[:, 0, k])
    middles = np.arange(spans, dtype=np.float64) + 0.5
    thirds = basis_at(middles, knots, 3, closed=closed)
    bends = np.zeros((spans, count))
    for k in range(4):
        np.add.at(bends, (np.arange(spans), (thirds.first + k) % count), thirds.values[:, 3, k])
    return design, bends.T @ bends


def _rows_of_cells(
    outlines: tuple[Outline, ...], rows: FloatArray, spans: int, *, closed: bool
) -> list[FloatArray]:
    """V of every cell: its outline's, moved by the cell's own height above the cutting plane."""
    heights = np.array([outline.height_mm for outline in outlines])
    slopes = _slopes(heights, rows, spans, closed=closed)
    found = []
    for outline, row, slope in zip(outlines, rows, slopes, strict=True):
        means = outline.moments.means_mm
        above = (means - outline.frame.origin_mm) @ outline.frame.axes[2]
        v = row + slope * above
        found.append(np.mod(v, spans) if closed else np.clip(v, 0.0, spans))
    return found


def _slopes(heights: FloatArray, rows: FloatArray, spans: int, *, closed: bool) -> FloatArray:
    """Change of v a millimetre of height at each outline; 0 where a branch turns over."""
    if len(heights) < 2:
        return np.zeros(len(heights))
    ways = [
        (b - a) / (high - low) if abs(high - low) > 0.0 else 0.0
        for (a, b), (low, high) in zip(pairwise(rows), pairwise(heights), strict=True)
    ]
    before, after = np.array([ways[0], *ways]), np.array([*ways, ways[-1]])
    if closed:
        rise = heights[0] - heights[-1]
        seam = (rows[0] + spans - rows[-1]) / rise if abs(rise) > 0.0 else 0.0
        before[0] = after[-1] = seam
    return np.asarray(np.where(before * after > 0.0, 0.5 * (before + after), 0.0))
