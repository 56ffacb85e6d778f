"""The surface of one branch: outlines aligned, a net laid along them and fitted to their points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.errors import Unfittable
from reconstruction.nurbs import Surface, evaluate_surface_at, points_and_tangents_at
from reconstruction.skinning.aligning import Stations, align, align_between, tabled
from reconstruction.skinning.branch import Branch
from reconstruction.skinning.creases import find_creases
from reconstruction.skinning.ends import Apex, Brim, brim_or_apex
from reconstruction.skinning.feet import nearby
from reconstruction.skinning.interpolating import follows, interpolating, keeps_near
from reconstruction.skinning.laying import Laid, lay_net
from reconstruction.skinning.merging import Cells
from reconstruction.skinning.net import basis_at, unit_normals
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.rounds import Rim
from reconstruction.skinning.tensor_fit import FREE, TensorFit, fit_net
from reconstruction.skinning.unseen import lies_in, unseen_bands
from reconstruction.skinning.variances import variances_across

_SPANS_A_FREEDOM = 2.5
_MORE_SPANS = 10
_LEAST_SPANS_U, _WIDE_SPANS_U = 12, 240  # half of what their own sections use at least
_MOST_SPANS = 240
_ROUND_SPANS = 48  # an exact ellipse is told by five numbers, but takes so many spans to follow
_LEAST_SPANS_V, _WIDE_SPANS_V = 6, 32
_MOST_SPANS_V = 160
_FEW, _MANY = 20, 80  # outlines; of more, the way between two of them is short
_SPANS_A_ROW = 2  # of a spline through few outlines
_STATIONS_A_SPAN = 3
_LEAST_STATIONS = 96
_REACH = 6.0  # standard deviations from the first net: loose cells farther off are not its
_NEAR_END = 4  # outlines
_FEWEST = 8  # outlines
_WILD = 4.0  # times as far as those nearby from the middle between its neighbours
_WILD_STEPS = 0.3  # and of the usual way to the next outline
_BESIDE = 1e-6  # spans, beside an edge
_EXACT = 1e-7  # of a part's size: scatter below it is none


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A branch and the surface fitted to it."""

    branch: Branch
    brims: tuple[Brim | Apex, Brim | Apex] | None  # None: it closes in v, or is open
    fit: TensorFit
    stations: Stations | None = None  # of closed outlines
    seen: tuple[bool, bool] = (False, False)  # whether points reach a pointed end

    @property
    def moments(self) -> Moments:
        """The cells that the surface was fitted to, those of `fit.feet`."""
        return self.fit.moments

    @property
    def open(self) -> bool:
        """Whether it has borders, so that it encloses nothing."""
        net = self.fit.net
        return not net.closed_u or (self.brims is None and not net.closed_v)

    @property
    def shape(self) -> None:
        """No exact one: see `exact_skins`."""
        return None

    @property
    def surface(self) -> Surface:
        """The fitted surface, open ends clamped."""
        return self.fit.net.surface()

    @property
    def noise(self) -> Noise:
        """The scatter of a point about the surface."""
        return self.fit.noise

    def deviation_mm(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Posterior standard deviation across the surface at (m,), (m,)."""
        net = self.fit.net
        u = self._beside_walls(u)
        _, first_u, first_v = points_and_tangents_at(net.surface(), u, v)
        at = (
            basis_at(u, net.knots_u, 0, closed=net.closed_u),
            basis_at(v, net.knots_v, 0, closed=net.closed_v),
        )
        normals = unit_normals(first_u, first_v)
        return np.sqrt(variances_across(self.fit.inverse, net, self.fit.unknowns, at, normals))

    @property
    def apex_deviations_mm(self) -> tuple[float, float]:
        """Posterior standard deviation of an apex's height, of either end; nan without one."""
        net, axis = self.fit.net, self.branch.axes[2]
        found = [math.nan, math.nan]
        for last in (0, 1):
            if not net.apex[-last]:
                continue
            at = (
                basis_at(np.zeros(1), net.knots_u, 0, closed=net.closed_u),
                basis_at(np.full(1, last * net.spans[1]), net.knots_v, 0, closed=net.closed_v),
            )
            fit = self.fit
            variance = variances_across(fit.inverse, net, fit.unknowns, at, axis[None])
            found[last] = float(np.sqrt(variance[0]))
        return found[0], found[1]

    def synthetic(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether no measured point stands near parameters of any shape."""
        counts = self.support
        end_u, end_v = self.fit.net.spans
        column = np.minimum((u / end_u * counts.shape[0]).astype(np.int64), counts.shape[0] - 1)
        row = np.minimum((v / end_v * counts.shape[1]).astype(np.int64), counts.shape[1] - 1)
        places = evaluate_surface_at(self.surface, np.ravel(u), np.ravel(v))
        heights = (places @ self.branch.axes[2]).reshape(np.shape(u))
        missing = lies_in(heights, unseen_bands(self.branch, self.moments))
        return np.asarray((counts[column, row] == 0) | missing | self._in_walls(u))

    def _beside_walls(self, u: FloatArray) -> FloatArray:
        """Parameters (m,), those in the walls of steps at the nearer edge: all that is known."""
        if not len(self.fit.net.walls):
            return u
        low, high = (self.fit.net.creases.astype(np.float64)[k::2] for k in (0, 1))
        wall = np.clip(np.searchsorted(low, u, "right") - 1, 0, None)
        nearer = np.where(u - low[wall] < high[wall] - u, low[wall] - _BESIDE, high[wall] + _BESIDE)
        return np.where((u >= low[wall]) & (u <= high[wall]), nearer, u)

    def _in_walls(self, u: FloatArray) -> BoolArray:
        """Whether parameters lie in the walls of steps across stripes, which no slice sees."""
        creases = self.fit.net.creases
        if not len(self.fit.net.walls):
            return np.zeros(np.shape(u), np.bool_)
        return np.asarray((np.searchsorted(creases, u) % 2 == 1) & ~np.isin(u, creases))

    @property
    def support(self) -> IntArray:
        """Cells beside each box of a lattice over (u, v), a gap's width apart."""
        end_u, end_v = self.fit.net.spans
        held = self.fit.weights > 0.0
        shape = self.branch.boxes(int(held.sum()))
        feet = self.fit.feet
        counts = np.zeros(shape, np.int64)
        column = np.minimum((feet.u[held] / end_u * shape[0]).astype(np.int64), shape[0] - 1)
        row = np.minimum((feet.v[held] / end_v * shape[1]).astype(np.int64), shape[1] - 1)
        np.add.at(counts, (column, row), 1)
        return counts


def skin_branch(branch: Branch, loose: Moments | None = None) -> Skin:
    """Fit one tensor surface to a branch of at least two outlines.

    Parameters
    ----------
    loose
        Cells that lie on no outline; those near the surface are used, the others left alone.
    """
    branch, stations, wild = _aligned(branch)
    loose = Moments.together([each for each in (loose, *wild) if each is not None])
    sure, likely = find_creases(branch.outlines, stations)
    skin = _skin(branch, stations, loose, sure)
    if likely.shape[1] == sure.shape[1]:
        return skin
    other = _skin(branch, stations, loose, likely)
    return other if _dear(other) < _dear(skin) else skin


def _skin(branch: Branch, stations: Stations, loose: Moments, creases: FloatArray) -> Skin:
    """The same with known creases (k, c); a spline through few outlines, if no fit follows them."""
    count, noise = len(branch.outlines), noise_of(branch)
    try:
        skin = _fitted_skin(branch, stations, loose, creases)
    except Unfittable:
        spline = _through(branch, stations, loose, creases)
        if spline is None:
            raise
        return spline
    if count > _MANY or (count > _FEW and follows(skin.fit, noise)):
        return skin
    spline = _through(branch, stations, loose, creases)
    if spline is None or (
        follows(skin.fit, noise) and keeps_near(skin.fit, spline.fit.net, stations.places_mm, noise)
    ):
        return skin
    return spline


def _fitted_skin(branch: Branch, stations: Stations, loose: Moments, creases: FloatArray) -> Skin:
    """A fit: few spans to begin with, where they may do."""
    spans = (_spans_around(branch), _spans_along(branch))
    times = (
        halvings(spans[0], _LEAST_SPANS_U, _WIDE_SPANS_U),
        halvings(spans[1], _LEAST_SPANS_V, _WIDE_SPANS_V),
    )
    if any(times):
        wide = (-(-spans[0] // 2 ** times[0]), -(-spans[1] // 2 ** times[1]))
        try:
            laid = _between(branch, stations, creases, wide[0])
            return _fitted(branch, laid, loose, wide, times)
        except Unfittable:  # too wide to find the points: narrow from the beginning
            pass
    laid = _between(branch, stations, creases, spans[0])
    return _fitted(branch, laid, loose, spans, (0, 0))


def _between(branch: Branch, stations: Stations, creases: FloatArray, spans: int) -> Stations:
    """Stations laid anew between edges (k, c), if there are any, for about so many spans."""
    if not creases.shape[1]:
        return stations
    a_span = -(-stations.shares.shape[1] // spans)
    return align_between(branch.outlines, creases, spans, a_span, cyclic=branch.cyclic)


def _fitted(
    branch: Branch,
    stations: Stations,
    loose: Moments,
    spans: tuple[int, int],
    halvings: tuple[int, int],
) -> Skin:
    """A net of so many spans laid through the stations, and fitted; it may halve them."""
    brims, noise = brims_of(branch), noise_of(branch)
    laid = lay_net(branch.outlines, stations, brims, (stations.spans or spans[0], spans[1]))
    cells = _cells(branch, laid, loose, noise)
    fit = fit_net(laid.net, cells, noise, rims=rims_of(brims), halvings=halvings)
    return Skin(branch, brims, fit, stations)


def _through(
    branch: Branch, stations: Stations, loose: Moments, creases: FloatArray
) -> Skin | None:
    """The surface through the outlines as they are; None if they are many, or of few points."""
    if len(branch.outlines) > _MANY:
        return None
    spans = (_spans_around(branch), max(_SPANS_A_ROW * len(branch.outlines), _LEAST_SPANS_V))
    stations = _between(branch, stations, creases, spans[0])
    brims, noise = brims_of(branch), noise_of(branch)
    spans = (stations.spans or spans[0], spans[1])
    laid = lay_net(branch.outlines, stations, brims, spans, through=True)
    fit = interpolating(laid.net, _cells(branch, laid, loose, noise), noise, rims_of(brims))
    return None if fit is None else Skin(branch, brims, fit, stations)


def _cells(branch: Branch, laid: Laid, loose: Moments, noise: Noise) -> Cells:
    """Of the outlines, and loose ones that are near the net."""
    cells = Cells(tuple(outline.moments for outline in branch.outlines), laid.u, laid.v)
    if len(loose):
        near, u, v = nearby(laid.net, loose, _REACH * math.sqrt(noise.level_mm2))
        cells = Cells(
            (*cells.parts, near), np.concatenate([cells.u, u]), np.concatenate([cells.v, v])
        )
    return cells


def _dear(skin: Skin) -> float:
    """What a fit costs: its misfit, and its freedom at the price of Schwarz (1978)."""
    noise = skin.fit.noise
    held = max(skin.moments.total / noise.inflation, 2.0)
    return held * math.log(noise.level_mm2) + math.log(held) * skin.fit.edf


def _aligned(branch: Branch) -> tuple[Branch, Stations, list[Moments]]:
    """Align outlines; those that stand out from both neighbours are left out, their cells kept."""
    wild: list[Moments] = []
    tables = tabled(branch.outlines)
    while True:
        count = max(_STATIONS_A_SPAN * _spans_around(branch), _LEAST_STATIONS)
        stations = align(branch.outlines, count, cyclic=branch.cyclic, tables_of=tables)
        if len(branch.outlines) <= _FEWEST:
            return branch, stations, wild
        worst = standing_out(stations.places_mm, cyclic=branch.cyclic)
        if worst is None:
            return branch, stations, wild
        wild.append(branch.outlines[worst].moments)
        kept = branch.outlines[:worst] + branch.outlines[worst + 1 :]
        branch, tables = replace(branch, outlines=kept), tables.without(worst)


def standing_out(places: FloatArray, *, cyclic: bool) -> int | None:
    """Which of rows (k, m, 3) is farthest from where its neighbours would have it, if far."""
    strides = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=2)
    below = np.sqrt((strides**2).mean(axis=1)) + 1e-300
    above = np.roll(below, -1)
    share = (below / (below + above))[:, None, None]
    middles = (1.0 - share) * np.roll(places, 1, axis=0) + share * np.roll(places, -1, axis=0)
    off = np.linalg.norm(places - middles, axis=2).max(axis=1)
    if not cyclic:  # towards an end outlines may shrink fast
        off[:_NEAR_END] = off[-_NEAR_END:] = 0.0
    steps = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)
    # Beside an outline that stands out its neighbours do, half as much; the next ones tell.
    around = np.stack([np.roll(off, shift) for shift in (-3, -2, 2, 3)]).max(axis=0)
    excess = off - _WILD * around - _WILD_STEPS * float(np.median(steps))
    worst = int(np.argmax(excess))
    return worst if excess[worst] > 0.0 else None


def _spans_around(branch: Branch) -> int:
    """Spans enough for the liveliest of the outlines; the stiffness does the rest."""
    edf = float(np.quantile([outline.fitted.edf for outline in branch.outlines], 0.9))
    return int(min(max(_SPANS_A_FREEDOM * edf + _MORE_SPANS, _ROUND_SPANS), _MOST_SPANS))


def _spans_along(branch: Branch) -> int:
    """Three spans to four outlines, within bounds.

    One to one, outlines would lie in the middle of spans, where they do not see a net that wavers
    from row to row.
    """
    return int(min(max(0.75 * len(branch.outlines), _LEAST_SPANS_V), _MOST_SPANS_V))


def halvings(spans: int, least: int, wide: int) -> int:
    """How often spans to begin with are doubled: at least once, if that leaves enough of them."""
    times = 0
    while spans >= 2 ** (times + 1) * least and (times == 0 or spans > 2**times * wide):
        times += 1
    return times


def brims_of(branch: Branch) -> tuple[Brim | Apex, Brim | Apex] | None:
    """How a branch ends, low and high; None: it closes in v."""
    if branch.ends is None:
        return None
    low, high = branch.ends
    return (
        brim_or_apex(branch.outlines, low, last=False),
        brim_or_apex(branch.outlines, high, last=True),
    )


def rims_of(brims: tuple[Brim | Apex, Brim | Apex] | None) -> tuple[Rim, Rim]:
    """What the first and the last row of a net must keep."""
    if brims is None:
        return FREE
    low, high = (
        Rim(level=brim.axis) if isinstance(brim, Brim) else Rim(smooth=not brim.sharp)
        for brim in brims
    )
    return low, high


def noise_of(branch: Branch) -> Noise:
    """Scatter and kinship as the sections saw them; the fit looks at the scatter again."""
    sigma = float(np.median([outline.fitted.sigma_mm for outline in branch.outlines]))
    inflation = float(np.median([outline.fitted.inflation for outline in branch.outlines]))
    size = max(float(np.ptp(outline.moments.means_mm, axis=0).max()) for outline in branch.outlines)
    variance = max(sigma, _EXACT * size) ** 2
    axis = branch.axes[2]
    return Noise(variance, variance, axis, max(inflation, 1.0))
