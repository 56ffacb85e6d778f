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
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray, frozen
from reconstruction.errors import Unfittable
from reconstruction.skinning.blocks import Blocks, Factor, inverse_blocks
from reconstruction.skinning.feet import Feet
from reconstruction.skinning.laying import relaid
from reconstruction.skinning.net import Net
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.refining import refined
from reconstruction.skinning.rounds import Manner, Rim, Round, State, do_round
from reconstruction.skinning.stiffness import Lattice
from reconstruction.skinning.unknowns import Unknowns

_ROUNDS = 25
_ASTRAY = 4.0  # times the first round's scatter: the fit has lost its points
_RELAID = (2, 4)  # rounds after which v is made to run evenly again
_LEARNT = (0.25, 1e-3)  # log likelihood, and of it a degree of freedom: less is not worth a round
_WIDE_LEARNT = 1e-2  # the same of a net whose spans will be halved
_STILL = 0.05  # standard deviations: a surface that moves less stands still
_CALMING = 4  # rounds at most once nothing is learnt
_LIVELY = 0.4  # of the waves that a net has: data that determine more get narrower spans
_MODEL = 0.3  # of a point's standard deviation: what sections may be wrong by, for outliers only
_WIDE_MODEL = 1.0  # the same while spans are wide

FREE = (Rim(), Rim())


class Posterior:
    """Covariance of the moves, inverted when it is first asked for."""

    def __init__(self, factor: Factor | None, inverse: Blocks | None) -> None:
        self._factor, self._inverse = factor, inverse

    @property
    def inverse(self) -> Blocks:
        """Inside the band of the system."""
        if self._inverse is None:
            assert self._factor is not None, "one of the two is there"
            with threadpool_limits(1, "blas"):
                self._inverse = inverse_blocks(self._factor)
            self._factor = None
        return self._inverse


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
    moments: Moments,
    u: FloatArray,
    v: FloatArray,
    noise: Noise,
    *,
    rims: tuple[Rim, Rim],
    finer: tuple[bool, bool] = (False, False),
) -> TensorFit:
    """Fit a net to cells from a surface nearby, until it is still.

    Parameters
    ----------
    u, v
        (m,), rough foot points of the cells.
    rims
        Of the first and the last row.
    finer
        Along u and v: whether spans may be halved where the data ask for it.

    Raises
    ------
    Unfittable
        The cells do not hold the net, or one whose spans may be halved has lost them.
    """
    lattice = Lattice.over(net, finer)
    usual = _usual_log_stiffness(net, moments, noise)
    start = np.full(lattice.count, usual)
    state = State(net, net.control_mm, u, v, noise, (start, start))
    done = _at_rest(state, moments, lattice, rims, finer, begun=0)
    if done is None:
        raise Unfittable(
            f"{moments.total} points do not hold a surface of {net.control_mm.shape[:2]} control"
            " points; are the slices those of one part?"
        )
    along = _too_wide(done[0], finer)
    if any(along):
        lattice, state = lattice.refined(along), _refined(done[1], along)
        done = _at_rest(state, moments, lattice, rims, (False, False), begun=done[2]) or done
    found, state, rounds = done
    return TensorFit(
        found.net, found.unknowns, found.feet, found.weights, found.noise, state.stiffness,
        found.edf, Posterior(found.factor, found.inverse), found.misfit, rounds,
    )  # fmt: skip


def _usual_log_stiffness(net: Net, moments: Moments, noise: Noise) -> float:
    """A stiffness that the points can just resist."""
    unknowns = net.control_mm.shape[0] * net.control_mm.shape[1]
    return math.log(moments.total / unknowns / (noise.level_mm2 * noise.inflation))


def _at_rest(
    state: State,
    moments: Moments,
    lattice: Lattice,
    rims: tuple[Rim, Rim],
    finer: tuple[bool, bool],
    *,
    begun: int,
) -> tuple[Round, State, int] | None:
    """Rounds until nothing is learnt and the surface stands still; None if there is not one.

    Wide spans that may be halved are given up, too, where the fit goes astray.
    """
    first: tuple[Round, State, int] | None = None
    last: tuple[Round, State, int] | None = None
    learning, calming = True, 0
    for turn in range(begun, begun + _ROUNDS):
        manner = Manner(learning, _WIDE_MODEL if any(finer) else _MODEL, 3 if turn == 0 else 1)
        with threadpool_limits(1, "blas"):  # blocks are small: threads would only wait
            done = do_round(state, moments, lattice, rims, manner)
        if done is None:
            break
        found, state = done
        last = found, state, turn + 1
        first = first or last
        if found.noise.level_mm2 > _ASTRAY * first[0].noise.level_mm2:
            return None if any(finer) else first
        if turn in _RELAID:
            again, v = relaid(state.net, state.v)
            state = replace(state, net=again, start_mm=again.control_mm, v=v)
        if turn <= _RELAID[-1]:
            continue
        if any(_too_wide(found, finer)) and found.gained < _WIDE_LEARNT * found.edf:
            break
        learning = learning and found.gained > _LEARNT[0] + _LEARNT[1] * found.edf
        calming += not learning
        if not learning and (found.moved < _STILL or calming > _CALMING):
            break
    return last


def _too_wide(found: Round, finer: tuple[bool, bool]) -> tuple[bool, bool]:
    """In which directions spans are to be halved, of those in which they may be."""
    along_u, along_v = (
        may and lively > _LIVELY for may, lively in zip(finer, found.lively, strict=True)
    )
    return along_u, along_v


def _refined(state: State, along: tuple[bool, bool]) -> State:
    """The same surface, feet and stiffness with spans halved."""
    net = refined(state.net, along)
    u, v = (t * 2.0 if half else t for t, half in zip((state.u, state.v), along, strict=True))
    # A row's value falls with the cube of its span; there are twice the rows, along and beside.
    fifths = [(5.0 if own else 0.0) - (1.0 if other else 0.0)
              for own, other in (along, along[::-1])]  # fmt: skip
    logs = [log + fifth * math.log(2.0) for log, fifth in zip(state.stiffness, fifths, strict=True)]
    return replace(state, net=net, start_mm=net.control_mm, u=u, v=v, stiffness=(logs[0], logs[1]))
