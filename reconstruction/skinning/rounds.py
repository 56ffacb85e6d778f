"""One round of the penalised tensor fit: feet, a linear system, moves, and what was learnt.

Both stiffnesses and the noise follow from the data by restricted maximum likelihood (the
generalised Fellner-Schall step; Wood, Fasiolo 2017, doi:10.1111/biom.12666). A step needs the
inverse of the system, with and without data; once there is nothing left to learn, a round is a
factorisation and a solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.assembly import add_data, add_stiffness, add_tangency, empty_system
from reconstruction.skinning.bending import Rows, row_values, stiffness_rows
from reconstruction.skinning.blocks import Blocks, Factor, factorise, inverse_blocks, solve
from reconstruction.skinning.feet import Feet, find_feet
from reconstruction.skinning.net import Net, basis_at
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.stiffness import Lattice
from reconstruction.skinning.unknowns import Unknowns, applied, free_unknowns, unknowns_of
from reconstruction.skinning.variances import row_variances

_LEAST_POINTS = 12.0
_LEASH = 9.0  # variances of a point, and a span, that a control point may well go from its start
_FREE = 1e-10  # of its own pivot, for what the stiffness leaves free
_APART = 14.0  # logarithms: a stiffness beside one so much greater would be less than that
_RIDGE = 1e-12  # of the largest pivot
_FULL = 4.0  # standard deviations up to which a cell counts in full ...
_NONE = 8.0  # ... and from which it does not count
_MOST = 0.95  # of the control points, when their moves and their liveliness are told
# Diagonals to densities: a cubic's squares, third differences' squares, per control point.
_DATA_DIAGONAL, _BEND_DIAGONAL = (151.0 / 315.0) ** 2, 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Rim:
    """What the first or the last row of a net must keep."""

    level: FloatArray | None = None  # (3,), normal of the plane that it stays in
    smooth: bool = False  # an apex without a tip


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Between two rounds."""

    net: Net
    start_mm: FloatArray  # control points that the first round began with
    u: FloatArray
    v: FloatArray
    noise: Noise
    stiffness: tuple[FloatArray, FloatArray]  # logarithms, at stations
    edf: float = 0.0  # as the last round that learnt has told it


@dataclass(frozen=True, slots=True)
class Manner:
    """How a round is done."""

    learning: bool  # the stiffness
    model: float  # of a point's standard deviation: what the surface may be wrong by, for outliers
    steps: int  # towards the feet


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """What a round has found."""

    net: Net  # moved
    unknowns: Unknowns
    feet: Feet  # before the moves
    weights: FloatArray  # (m,), robust, 0 .. 1
    noise: Noise
    edf: float
    factor: Factor | None  # of the system, unless the inverse has taken its place
    inverse: Blocks | None
    misfit: float  # weighted sum of squares, in units of the noise
    gained: float  # log likelihood by the step of the stiffness; infinite where none was learnt
    moved: float  # nineteen of twenty control points by less, in standard deviations
    lively: tuple[float, float]  # shares of the waves that a net has, which the data use


def do_round(
    state: State, moments: Moments, lattice: Lattice, rims: tuple[Rim, Rim], manner: Manner
) -> tuple[Round, State] | None:
    """One linearisation, one solution, one step of stiffness and noise; None if it fails."""
    net, noise = state.net, state.noise
    feet = find_feet(net, moments, state.u, state.v, noise.covariance_mm2, rounds=manner.steps)
    variances = noise.across(feet.normals)
    weights = _robust(feet, moments, noise, variances, manner.model)
    held = moments.counts * weights
    if not float(held.sum()) > _LEAST_POINTS:
        return None
    unknowns = unknowns_of(net, (rims[0].level, rims[1].level))
    rows = stiffness_rows(net, unknowns)
    laid = [
        np.exp(lattice.values(each, logs)) for each, logs in zip(rows, state.stiffness, strict=True)
    ]
    ranks = _ranks(unknowns, rows, laid) if manner.learning else None
    data = held / (variances * noise.inflation)
    system, lively = _system(state, unknowns, feet, data, rows, laid)
    for last, rim in enumerate(rims):
        if rim.smooth:
            add_tangency(system, net, unknowns, last=bool(last))
    _leash(system, net, unknowns, state.start_mm, _LEASH * noise.level_mm2 + span_mm(net) ** 2)
    _hold_the_rest(system[0])
    factor: Factor | None = factorise(system[0])
    if factor is None:
        return None
    moves = solve(factor, system[1]).reshape(-1)
    inverse, stiffness, edf, gained = None, state.stiffness, state.edf, math.inf
    if ranks is not None:
        inverse, factor = inverse_blocks(factor), None
        stiffness, spent, gained = _learnt(
            lattice, rows, laid, state.stiffness, moves, ranks, inverse
        )
        edf = free_unknowns(net) - spent
    moved = float(np.quantile(np.abs(moves), _MOST)) / _usual_deviation_mm(noise, held, edf)
    squares = feet.distances_mm**2 + feet.scatters_mm2
    fresh = noise.looked_at_again(feet.normals, squares, held, edf)
    far = span_mm(net)  # as far as a linearisation is good
    control = applied(net, unknowns, np.clip(moves, -far, far))
    if not np.isfinite(control).all():
        return None
    found = Round(
        net.moved(control), unknowns, feet, weights, fresh, edf, factor, inverse,
        float((data * squares).sum()), gained, moved, lively,
    )  # fmt: skip
    after = replace(
        state, net=found.net, u=feet.u, v=feet.v, noise=fresh, stiffness=stiffness, edf=edf
    )
    return found, after


def span_mm(net: Net) -> float:
    """Typical distance of neighbouring control points: how far a linearisation is good."""
    return float(np.median(np.linalg.norm(np.diff(net.control_mm, axis=1), axis=2)))


def _usual_deviation_mm(noise: Noise, held: FloatArray, edf: float) -> float:
    """Standard deviation of the surface where there are points, on average."""
    freedom = max(edf, 1.0) / float(held.sum())
    return math.sqrt(noise.level_mm2 * noise.inflation * freedom)


def _robust(
    feet: Feet, moments: Moments, noise: Noise, variances: FloatArray, model: float
) -> FloatArray:
    """Weight of every cell: those far off are of something else."""
    spread = np.sqrt(variances * noise.inflation / moments.counts + model**2 * noise.level_mm2)
    z = np.abs(feet.distances_mm) / np.maximum(spread, 1e-300)
    share = np.clip((_NONE - z) / (_NONE - _FULL), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _system(
    state: State, unknowns: Unknowns, feet: Feet, data: FloatArray, rows: tuple[Rows, Rows],
    laid: list[FloatArray],
) -> tuple[tuple[Blocks, FloatArray], tuple[float, float]]:  # fmt: skip
    """Data and stiffness; how lively the surface is along u and v, from their shares in it."""
    net, system = state.net, empty_system(unknowns)
    at = (
        basis_at(feet.u, net.knots_u, 0, closed=net.closed_u),
        basis_at(feet.v, net.knots_v, 0, closed=net.closed_v),
    )
    add_data(system, net, unknowns, at, feet.normals, feet.distances_mm, data)
    diagonals = [system[0].diagonal.copy()]
    for each, values in zip(rows, laid, strict=True):
        add_stiffness(system, each, values)
        diagonals.append(system[0].diagonal.copy())
    density = diagonals[0] / _DATA_DIAGONAL
    along_u, along_v = (
        _liveliness(density, (after - before) / _BEND_DIAGONAL)
        for before, after in pairwise(diagonals)
    )
    return system, (along_u, along_v)


def _liveliness(density: FloatArray, bend: FloatArray) -> float:
    """Share of the waves that the data determine, where the surface is liveliest.

    Data of a density d and third differences of stiffness p weigh alike in a wave of w rad a
    control point with p w^6 = d; what is shorter is smoothed away. The shortest has w = pi.
    """
    used = (density > 0.0) & (bend > 0.0)
    if not used.any():
        return 0.0
    shares = (density[used] / bend[used]) ** (1.0 / 6.0) / math.pi
    return float(np.quantile(shares, _MOST))


def _leash(
    system: tuple[Blocks, FloatArray],
    net: Net,
    unknowns: Unknowns,
    start_mm: FloatArray,
    variance_mm2: float,
) -> None:
    """A weak prior about where the control points began: what nothing else holds stays there."""
    matrix, right = system
    diagonal = matrix.diagonal
    diagonal[diagonal > 0.0] += 1.0 / variance_mm2
    away = ((net.control_mm - start_mm) * unknowns.directions).sum(axis=2)
    right.reshape(-1)[unknowns.numbers] -= away / variance_mm2


def _hold_the_rest(matrix: Blocks) -> None:
    """Ones where nothing stands: unused places of the system, and a ridge against rounding."""
    diagonal = matrix.diagonal
    largest = float(diagonal.max())
    diagonal[diagonal == 0.0] = largest
    diagonal += _RIDGE * largest


def _ranks(unknowns: Unknowns, rows: tuple[Rows, Rows], laid: list[FloatArray]) -> list[FloatArray]:
    """Freedom that the stiffness alone gives each row; what it leaves free is nearly so."""
    matrix = empty_system(unknowns)
    for each, values in zip(rows, laid, strict=True):
        add_stiffness(matrix, each, values)
    diagonal = matrix[0].diagonal
    # Each by its own: where the surface is soft, the largest one's share would stiffen it.
    diagonal[diagonal == 0.0] = float(diagonal.max())
    diagonal *= 1.0 + _FREE
    factor = factorise(matrix[0])
    assert factor is not None, "a ridge makes it positive"
    inverse = inverse_blocks(factor)
    return [values * row_variances(each, inverse) for each, values in zip(rows, laid, strict=True)]


def _learnt(
    lattice: Lattice,
    rows: tuple[Rows, Rows],
    laid: list[FloatArray],
    logs: tuple[FloatArray, FloatArray],
    moves: FloatArray,
    ranks: list[FloatArray],
    inverse: Blocks,
) -> tuple[tuple[FloatArray, FloatArray], float, float]:
    """Both stiffnesses after one step of restricted likelihood; what the stiffness took up; gain.

    The freedom that a row has lost to the data is what the stiffness alone gives it more than
    stiffness and data together.
    """
    spent, gained, fresh = 0.0, 0.0, []
    for each, values, log, other, rank in zip(rows, laid, logs, logs[::-1], ranks, strict=True):
        share = values * row_variances(each, inverse)
        forms = values * (each.values_mm + row_values(each, moves)) ** 2
        spent += float(share.sum())
        found, gain = lattice.stepped(each, log, other, rank - share, forms)
        fresh.append(found)
        gained += gain
    most = np.minimum(fresh[0], fresh[1]) + _APART
    return (np.minimum(fresh[0], most), np.minimum(fresh[1], most)), spent, gained
