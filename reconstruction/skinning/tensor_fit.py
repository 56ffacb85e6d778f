"""The penalised tensor fit: normal moves of a net, stiffness in both directions by likelihood.

The data are cells of raw points of all slices (`outlines`); parameters are their foot points on the
surface itself. What is penalised are changes of curvature along u and along v (`bending`), each
with a stiffness of its own that follows from the data (`rounds`), and that may vary over the
surface, log-linearly between stations tied to their neighbours.

A net begins with wide spans, where rounds are cheap; those are halved along u, v or both where the
data determine waves that wide spans cannot follow well::

    wide spans:  rounds until nothing is learnt  ->  halved, stiffness carried over  ->  few rounds

Gaps are filled by the penalty alone, from all sides at once, and the covariance says how well.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray, frozen
from reconstruction.errors import Unfittable
from reconstruction.skinning.bending import stiffness_rows
from reconstruction.skinning.blocks import Blocks, Factor, inverse_blocks
from reconstruction.skinning.feet import Feet
from reconstruction.skinning.laying import relaid
from reconstruction.skinning.merging import Cells, merged_for, moved_along
from reconstruction.skinning.net import Net
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.refining import refined
from reconstruction.skinning.rounds import Manner, Rim, Round, State, do_round
from reconstruction.skinning.stiffness import Lattice
from reconstruction.skinning.unknowns import Unknowns, unknowns_of

_ROUNDS = 25
_ASTRAY = 4.0  # times the first round's scatter: the fit has lost its points
_RELAID = (2, 4)  # rounds after which v is made to run evenly again
_LEARNT = (0.25, 2e-3)  # log likelihood, and of it a degree of freedom: less is not worth a round
_WIDE_LEARNT = 1e-2  # the same of a net whose spans will be halved
_RESTING, _STIRRED = 0.05, 4.0  # of a degree of freedom; times what the calmest round has gained
_STILL = 0.05  # standard deviations: a surface that moves less stands still
_CALMING = 4  # rounds at most once nothing is learnt
_LIVELY = 0.6  # of the waves that a net has: data that determine more get narrower spans
_SOFTER, _STIFFER = 9.0, 6.0  # logarithms, to begin with, than what points can just resist
_BLIND = 0.8  # the same: a net that is so much too wide learns nothing true of the stiffness
_NEAR = 0.5  # of the liveliness of the other direction
_LEAST_ROUNDS = 2  # of any width
_MODEL = 0.3  # of a point's standard deviation: what sections may be wrong by, for outliers only
_WIDE_MODEL = 2.0  # the same while spans are wide

FREE = (Rim(), Rim())


class Posterior:
    """Covariance of the moves, inverted when it is first asked for.

    Parameters
    ----------
    again
        Does once more the round whose factor and inverse are not there any more: while a wide net
        is fitted, those of every round together would take more memory than a long scan.
    """

    def __init__(
        self,
        factor: Factor | None,
        inverse: Blocks | None,
        again: Callable[[], Factor] | None = None,
    ) -> None:
        self._factor, self._inverse, self._again = factor, inverse, again

    @property
    def inverse(self) -> Blocks:
        """Inside the band of the system."""
        if self._inverse is None:
            with threadpool_limits(1, "blas"):
                if self._factor is None:
                    assert self._again is not None, "one of the three is there"
                    self._factor = self._again()
                self._inverse = inverse_blocks(self._factor)
            self._factor = self._again = None
        return self._inverse


@dataclass(frozen=True, slots=True, eq=False)
class TensorFit:
    """A surface at rest among its cells."""

    net: Net
    unknowns: Unknowns
    moments: Moments  # the cells, merged where there were far more than the net can use
    feet: Feet
    weights: FloatArray  # (m,), robust, 0 .. 1
    noise: Noise
    stiffness: tuple[FloatArray, FloatArray]  # logarithms, at stations
    edf: float  # degrees of freedom spent
    posterior: Posterior
    misfit: float  # weighted sum of squares, in units of the noise
    rounds: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", frozen(self.weights))

    @property
    def inverse(self) -> Blocks:
        """Posterior covariance of the moves."""
        return self.posterior.inverse


def fit_net(
    net: Net,
    cells: Cells,
    noise: Noise,
    *,
    rims: tuple[Rim, Rim],
    halvings: tuple[int, int] = (0, 0),
) -> TensorFit:
    """Fit a net to cells from a surface nearby, until it is still.

    Parameters
    ----------
    cells
        With rough foot points.
    rims
        Of the first and the last row.
    halvings
        Along u and v: how often spans may be halved where the data ask for it.

    Raises
    ------
    Unfittable
        The cells do not hold the net, or one whose spans may be halved has lost them.
    """
    lattice = Lattice.over(net, halvings)
    merged = merged_for(net, cells)
    logs = log_stiffness(net, cells, noise)
    starts = (np.full(lattice.count, logs[0]), np.full(lattice.count, logs[1]))
    state = State(net, net.control_mm, merged.u, merged.v, noise, starts)
    done = _at_rest(state, merged.moments, lattice, rims, _may(halvings), begun=0)
    if done is None:
        raise Unfittable(
            f"{cells.total} points do not hold a surface of {net.control_mm.shape[:2]} control"
            " points; are the slices those of one part?"
        )
    used = merged.moments
    while any(along := _too_wide(done.found, _may(halvings))):
        done = done.lighter()
        state, rounds = done.after, done.rounds
        cells = moved_along(cells, merged, state.u, state.v, state.net)
        lattice, state = lattice.refined(along), _refined(state, along)
        halvings = (halvings[0] - along[0], halvings[1] - along[1])
        cells = Cells(cells.parts, cells.u * (1 + along[0]), cells.v * (1 + along[1]))
        merged = merged_for(state.net, cells)
        state = replace(state, u=merged.u, v=merged.v)
        narrow = _at_rest(state, merged.moments, lattice, rims, _may(halvings), begun=rounds)
        if narrow is None:
            break
        done, used = narrow, merged.moments
    found, state, rounds, again = done.found, done.after, done.rounds, done.again
    return TensorFit(
        found.net, found.unknowns, used, found.feet, found.weights, found.noise, state.stiffness,
        found.edf, Posterior(found.factor, found.inverse, again), found.misfit, rounds,
    )  # fmt: skip


def _may(halvings: tuple[int, int]) -> tuple[bool, bool]:
    return halvings[0] > 0, halvings[1] > 0


def log_stiffness(net: Net, cells: Cells, noise: Noise) -> list[float]:
    """Along u and v, what likelihood would say of the net's own bends if half of them were free.

    Not far from what the points can just resist, though: the net may be exactly round, or not yet
    smooth.
    """
    unknowns = net.control_mm.shape[0] * net.control_mm.shape[1]
    usual = math.log(cells.total / unknowns / (noise.level_mm2 * noise.inflation))
    rows = stiffness_rows(net, unknowns_of(net, (None, None)))
    squares = [float((each.values_mm**2).mean()) for each in rows]
    return [
        min(max(-math.log(2.0 * max(square, 1e-300)), usual - _SOFTER), usual + _STIFFER)
        for square in squares
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Done:
    """A round that was done, and what is needed to do it again."""

    found: Round
    after: State
    rounds: int  # so many until now
    again: Callable[[], Factor]

    def lighter(self) -> _Done:
        """Without what takes by far the most memory."""
        return replace(self, found=replace(self.found, factor=None, inverse=None))


def _at_rest(
    state: State,
    moments: Moments,
    lattice: Lattice,
    rims: tuple[Rim, Rim],
    finer: tuple[bool, bool],
    *,
    begun: int,
) -> _Done | None:
    """Rounds until nothing is learnt and the surface stands still; None if there is not one.

    Wide spans that may be halved are given up, too, where the fit goes astray.
    """
    first: _Done | None = None
    last: _Done | None = None
    calmest: _Done | None = None
    learning, calming = True, 0
    for turn in range(begun, begun + _ROUNDS):
        manner = Manner(learning, _WIDE_MODEL if any(finer) else _MODEL, 3 if turn == begun else 1)
        first, last, calmest = (each and each.lighter() for each in (first, last, calmest))
        done = _once(state, moments, lattice, rims, manner, turn)
        if done is None:
            break
        last, state = done, done.after
        first = first or last
        del done  # the next round has no room for what this one found
        if last.found.noise.level_mm2 > _ASTRAY * first.found.noise.level_mm2:
            return None if any(finer) else first
        if turn in _RELAID:
            even, v = relaid(state.net, state.v)
            state = replace(state, net=even, start_mm=even.control_mm, v=v)
        if calmest is None or last.found.gained <= calmest.found.gained:
            calmest = last
        elif _stirred(last.found, calmest.found):
            return calmest
        if turn >= begun + _LEAST_ROUNDS and _nothing_more(last.found, finer):
            break
        if turn <= _RELAID[-1]:
            continue
        learning = learning and last.found.gained > _LEARNT[0] + _LEARNT[1] * last.found.edf
        calming += not learning
        if not learning and (last.found.moved < _STILL or calming > _CALMING):
            break
    return last


def _once(
    state: State,
    moments: Moments,
    lattice: Lattice,
    rims: tuple[Rim, Rim],
    manner: Manner,
    turn: int,
) -> _Done | None:
    with threadpool_limits(1, "blas"):  # blocks are small: threads would only wait
        done = do_round(state, moments, lattice, rims, manner)
    if done is None:
        return None
    again = partial(_factor_again, state, moments, lattice, rims, manner)
    return _Done(*done, turn + 1, again)


def _factor_again(
    state: State, moments: Moments, lattice: Lattice, rims: tuple[Rim, Rim], manner: Manner
) -> Factor:
    """The factor of a round that was done from this state."""
    done = do_round(state, moments, lattice, rims, replace(manner, learning=False))
    assert done is not None, "it was done before"
    assert done[0].factor is not None, "it does not learn"
    return done[0].factor


def _stirred(found: Round, calmest: Round) -> bool:
    """Whether a stiffness that had nearly come to rest runs away, as it does on a ball."""
    near = math.isfinite(found.gained) and calmest.gained < 1.0 + _RESTING * calmest.edf
    return near and found.gained > _STIRRED * calmest.gained + 1.0


def _nothing_more(found: Round, finer: tuple[bool, bool]) -> bool:
    """Whether spans that will be halved have told what they can."""
    if not any(_too_wide(found, finer)):
        return False
    lively = max(each for each, may in zip(found.lively, finer, strict=True) if may)
    return lively > _BLIND or found.gained < _WIDE_LEARNT * found.edf


def _too_wide(found: Round, finer: tuple[bool, bool]) -> tuple[bool, bool]:
    """In which directions spans are to be halved, of those in which they may be.

    What is far from the liveliest direction waits: what that one lacks, the other pretends.
    """
    most = max((each for each, may in zip(found.lively, finer, strict=True) if may), default=0.0)
    along_u, along_v = (
        may and lively > max(_LIVELY, _NEAR * most)
        for may, lively in zip(finer, found.lively, strict=True)
    )
    return along_u, along_v


def _refined(state: State, along: tuple[bool, bool]) -> State:
    """The same surface and stiffness with spans halved."""
    net = refined(state.net, along)
    # A row's value falls with the cube of its span; there are twice the rows, along and beside.
    fifths = [(5.0 if own else 0.0) - (1.0 if other else 0.0)
              for own, other in (along, along[::-1])]  # fmt: skip
    logs = [log + fifth * math.log(2.0) for log, fifth in zip(state.stiffness, fifths, strict=True)]
    return replace(state, net=net, start_mm=net.control_mm, stiffness=(logs[0], logs[1]))
