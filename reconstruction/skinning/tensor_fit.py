"""The penalised tensor fit: normal moves of a net, stiffness in both directions by likelihood.

The data are cells of raw points of all slices (`outlines`); parameters are their foot points on the
surface itself. What is penalised are third differences of the net across the surface: along u and
along v, each with a stiffness of its own that follows from the data by restricted maximum
likelihood (the generalised Fellner-Schall step; Wood, Fasiolo 2017, doi:10.1111/biom.12666), and
that may vary over the surface, log-linearly between stations tied to their neighbours.

Gaps are filled by the penalty alone, from all sides at once, and the covariance says how well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray, frozen
from reconstruction.errors import Unfittable
from reconstruction.skinning.assembly import (
    Rows,
    Unknowns,
    add_data,
    add_stiffness,
    add_tangency,
    applied,
    empty_system,
    row_values,
    row_variances,
    stiffness_rows,
    unknowns_of,
)
from reconstruction.skinning.blocks import Blocks, factorise, inverse_blocks, solve
from reconstruction.skinning.feet import Feet, find_feet
from reconstruction.skinning.laying import relaid
from reconstruction.skinning.net import Net, basis_at
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.stiffness import Lattice

_ROUNDS = 25
_ASTRAY = 4.0  # times the first round's scatter: the fit has lost its points
_AT_REST = 0.15  # of a logarithm
_RELAID = (2, 5)  # rounds after which v is made to run evenly again
_LEAST_POINTS = 12.0
_STILL = 0.05  # standard deviations: a surface that moves less stands still
_LEASH = 9.0  # variances of a point, and a span, that a control point may well go from its start
_FREE = 1e-8  # of the largest pivot, for what the stiffness leaves free
_RIDGE = 1e-12  # of the largest pivot
_FULL = 4.0  # standard deviations up to which a cell counts in full ...
_NONE = 8.0  # ... and from which it does not count
_MODEL = 0.3  # of a point's standard deviation: what sections may be wrong by, for outliers only


@dataclass(frozen=True, slots=True, eq=False)
class Rim:
    """What the first or the last row of a net must keep."""

    level: FloatArray | None = None  # (3,), normal of the plane that it stays in
    smooth: bool = False  # an apex without a tip


FREE = (Rim(), Rim())


@dataclass(frozen=True, slots=True, eq=False)
class TensorFit:
    """A surface at rest among its cells."""

    net: Net
    unknowns: Unknowns
    feet: Feet
    weights: FloatArray  # (m,), robust, 0 .. 1
    noise: Noise
    stiffness: tuple[FloatArray, FloatArray]  # logarithms, at stations
    edf: float  # degrees of freedom spent
    inverse: Blocks  # posterior covariance of the moves
    misfit: float  # weighted sum of squares, in units of the noise
    rounds: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", frozen(self.weights))


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    net: Net
    start_mm: FloatArray  # control points that the first round began with
    u: FloatArray
    v: FloatArray
    noise: Noise
    stiffness: tuple[FloatArray, FloatArray]
    steps: tuple[FloatArray, FloatArray]  # of the stiffness, in the round before


def fit_net(
    net: Net, moments: Moments, u: FloatArray, v: FloatArray, noise: Noise, *, rims: tuple[Rim, Rim]
) -> TensorFit:
    """Fit a net to cells from a surface nearby, until it is still.

    Parameters
    ----------
    u, v
        (m,), rough foot points of the cells.
    rims
        Of the first and the last row.

    Raises
    ------
    Unfittable
        The cells do not hold the net.
    """
    lattice = Lattice.over(net)
    usual = _usual_log_stiffness(net, moments, noise)
    start = np.full(lattice.count, usual)
    state = _State(net, net.control_mm, u, v, noise, (start, start), (0.0 * start, 0.0 * start))
    fit: TensorFit | None = None
    first: TensorFit | None = None
    for turn in range(_ROUNDS):
        with threadpool_limits(1, "blas"):  # blocks are small: threads would only wait
            found = _round(state, moments, lattice, rims, turn)
        if found is None:
            break
        fit, state, moved = found
        first = first or fit
        if fit.noise.level_mm2 > _ASTRAY * first.noise.level_mm2:
            return first
        if turn in _RELAID:
            again, v = relaid(state.net, state.v)
            state = replace(state, net=again, start_mm=again.control_mm, v=v)
        if moved < _STILL and _settled(state) and turn > _RELAID[-1]:
            break
    if fit is None:
        raise Unfittable(
            f"{moments.total} points do not hold a surface of {net.control_mm.shape[:2]} control"
            " points; are the slices those of one part?"
        )
    return fit


def _usual_log_stiffness(net: Net, moments: Moments, noise: Noise) -> float:
    """A stiffness that the points can just resist."""
    unknowns = net.control_mm.shape[0] * net.control_mm.shape[1]
    return math.log(moments.total / unknowns / (noise.level_mm2 * noise.inflation))


def _round(
    state: _State, moments: Moments, lattice: Lattice, rims: tuple[Rim, Rim], turn: int
) -> tuple[TensorFit, _State, float] | None:
    """One linearisation, one solve, one step of stiffness and noise; None if it fails."""
    net, noise = state.net, state.noise
    first = 3 if turn == 0 else 1
    feet = find_feet(net, moments, state.u, state.v, noise.covariance_mm2, rounds=first)
    variances = noise.across(feet.normals)
    weights = _robust(feet, moments, noise, variances)
    unknowns = unknowns_of(net, (rims[0].level, rims[1].level))
    system = empty_system(unknowns)
    at = (
        basis_at(feet.u, net.knots_u, 0, closed=net.closed_u),
        basis_at(feet.v, net.knots_v, 0, closed=net.closed_v),
    )
    held = moments.counts * weights
    if not float(held.sum()) > _LEAST_POINTS:
        return None
    data = held / (variances * noise.inflation)
    add_data(system, net, unknowns, at, feet.normals, feet.distances_mm, data)
    rows = stiffness_rows(net, unknowns)
    laid = [lattice.values(each, logs) for each, logs in zip(rows, state.stiffness, strict=True)]
    for each, values in zip(rows, laid, strict=True):
        add_stiffness(system, each, np.exp(values))
    for last, rim in enumerate(rims):
        if rim.smooth:
            add_tangency(system, net, unknowns, last=bool(last))
    _leash(system, net, unknowns, state.start_mm, _LEASH * noise.level_mm2 + _span_mm(net) ** 2)
    _hold_the_rest(system[0])
    factor = factorise(system[0])
    if factor is None:
        return None
    moves = solve(factor, system[1]).reshape(-1)
    inverse = inverse_blocks(factor)
    prior = _prior(unknowns, rows, laid)
    learnt, spent = _learnt(lattice, rows, laid, state.stiffness, moves, (prior, inverse))
    free = _free_unknowns(net)
    edf = free - spent
    squares = feet.distances_mm**2 + feet.scatters_mm2
    fresh = noise.looked_at_again(feet.normals, squares, held, edf)
    still = float((np.abs(moves) / np.sqrt(np.maximum(_diagonal(inverse), 1e-300))).max())
    far = _span_mm(net)  # as far as a linearisation is good
    control = applied(net, unknowns, np.clip(moves, -far, far))
    if not np.isfinite(control).all():
        return None
    fit = TensorFit(
        net.moved(control), unknowns, feet, weights, fresh, state.stiffness, edf, inverse,
        float((data * squares).sum()), turn + 1,
    )  # fmt: skip
    steps = (learnt[0] - state.stiffness[0], learnt[1] - state.stiffness[1])
    after = replace(
        state, net=fit.net, u=feet.u, v=feet.v, noise=fresh, stiffness=learnt, steps=steps
    )
    return fit, after, still


def _settled(state: _State) -> bool:
    """Whether the stiffness has come to rest."""
    return max(float(np.abs(step).max()) for step in state.steps) < _AT_REST


def _robust(feet: Feet, moments: Moments, noise: Noise, variances: FloatArray) -> FloatArray:
    """Weight of every cell: those far off are of something else."""
    spread = np.sqrt(variances * noise.inflation / moments.counts + _MODEL**2 * noise.level_mm2)
    z = np.abs(feet.distances_mm) / np.maximum(spread, 1e-300)
    share = np.clip((_NONE - z) / (_NONE - _FULL), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _leash(
    system: tuple[Blocks, FloatArray],
    net: Net,
    unknowns: Unknowns,
    start_mm: FloatArray,
    variance_mm2: float,
) -> None:
    """A weak prior about where the control points began: what nothing else holds stays there."""
    matrix, right = system
    blocks, size = matrix.diagonal.shape[:2]
    flat = matrix.diagonal.reshape(blocks, size * size)[:, :: size + 1]
    flat[flat > 0.0] += 1.0 / variance_mm2
    away = ((net.control_mm - start_mm) * unknowns.directions).sum(axis=2)
    numbers = unknowns.place[None, :] * unknowns.width + np.arange(unknowns.width)[:, None]
    np.add.at(right.reshape(-1), numbers.ravel(), -away.ravel() / variance_mm2)


def _prior(unknowns: Unknowns, rows: tuple[Rows, Rows], laid: list[FloatArray]) -> Blocks:
    """Covariance of the moves by the stiffness alone; what it leaves free is nearly so."""
    system = empty_system(unknowns)
    for each, values in zip(rows, laid, strict=True):
        add_stiffness(system, each, np.exp(values))
    matrix = system[0]
    blocks, size = matrix.diagonal.shape[:2]
    flat = matrix.diagonal.reshape(blocks, size * size)[:, :: size + 1]
    flat += _FREE * float(flat.max())
    factor = factorise(matrix)
    assert factor is not None, "a ridge makes it positive"
    return inverse_blocks(factor)


def _hold_the_rest(matrix: Blocks) -> None:
    """Ones where nothing stands: unused places of the system, and a ridge against rounding."""
    blocks, size = matrix.diagonal.shape[:2]
    flat = matrix.diagonal.reshape(blocks, size * size)[:, :: size + 1]
    largest = float(flat.max())
    flat[flat == 0.0] = largest
    flat += _RIDGE * largest


def _free_unknowns(net: Net) -> int:
    """How many unknowns a net has."""
    count_u, count_v = net.control_mm.shape[:2]
    apexes = int(net.apex.sum())
    return int(count_u * (count_v - apexes) + 3 * apexes)


def _diagonal(inverse: Blocks) -> FloatArray:
    return np.concatenate([block.diagonal() for block in inverse.diagonal])


def _span_mm(net: Net) -> float:
    """Typical distance of neighbouring control points: how far a linearisation is good."""
    return float(np.median(np.linalg.norm(np.diff(net.control_mm, axis=1), axis=2)))


def _learnt(
    lattice: Lattice,
    rows: tuple[Rows, Rows],
    laid: list[FloatArray],
    logs: tuple[FloatArray, FloatArray],
    moves: FloatArray,
    inverses: tuple[Blocks, Blocks],
) -> tuple[tuple[FloatArray, FloatArray], float]:
    """Both stiffnesses after one step of restricted likelihood; what the stiffness took up.

    `inverses` are those of the prior alone, and with the data: the freedom that a row has lost to
    the data is what the one gives it more than the other.
    """
    spent, fresh = 0.0, []
    for each, values, log, other in zip(rows, laid, logs, logs[::-1], strict=True):
        rank, share = (np.exp(values) * row_variances(each, inverse) for inverse in inverses)
        forms = np.exp(values) * (each.values_mm + row_values(each, moves)) ** 2
        spent += float(share.sum())
        fresh.append(lattice.stepped(each, log, other, rank - share, forms))
    return (fresh[0], fresh[1]), spent
