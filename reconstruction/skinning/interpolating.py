"""A surface through the outlines themselves, where the fit of one does not come to rest near them.

Few outlines far apart hold a fit only at their own heights: between them it is the stiffness alone
that decides, and where the part changes much from one to the next, likelihood cannot tell that from
noise, or the fit never stands still. But each outline is known far better than a point. So the
surface is the natural cubic spline, along v, of what every station shows.
"""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import evaluate_surface
from reconstruction.skinning.feet import nearby
from reconstruction.skinning.merging import Cells, merged_for
from reconstruction.skinning.net import Net, derivatives_at
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.rounds import Manner, Rim, State, do_round
from reconstruction.skinning.stiffness import Lattice
from reconstruction.skinning.tensor_fit import Posterior, TensorFit, log_stiffness

_COLUMNS = 64
_LINES = 4  # a span's, along v
_NOISE = 3.0  # standard deviations of a point ...
_BENDS = 0.25  # ... and of the bend from outline to outline, that a fit may lie off between them
_SCATTER = 4.0  # times the outlines' own, as a variance: the fit has lost them
_HELD = 0.9  # of the points, by their weights: likewise
_ALL = 1e6  # standard deviations: every cell counts


def follows(fit: TensorFit, noise: Noise) -> bool:
    """Whether a fit keeps near its outlines, whose scatter is known."""
    held = float(fit.moments.counts @ fit.weights) / float(fit.moments.counts.sum())
    return held > _HELD and fit.noise.level_mm2 < _SCATTER * noise.level_mm2


def keeps_near(fit: TensorFit, spline: Net, rows_mm: FloatArray, noise: Noise) -> bool:
    """Whether a fit keeps near the spline through its outlines between them, too.

    Parameters
    ----------
    spline
        Of any number of spans.
    rows_mm
        (k, m, 3), what the stations show of every outline.
    noise
        As the outlines saw it.
    """
    off = np.median(_apart(spline, fit.net), axis=1)
    bends = np.linalg.norm(rows_mm[2:] - 2.0 * rows_mm[1:-1] + rows_mm[:-2], axis=2)
    bend = float(np.median(bends, axis=1).max(initial=0.0))
    return bool(off.max() < _NOISE * np.sqrt(noise.level_mm2) + _BENDS * bend)


def _apart(one: Net, other: Net) -> FloatArray:
    """How far lines of v of one surface lie from the other, (lines, columns).

    From its nearest place: their parameters need not agree, least of all between edges.
    """
    lines = _lines(one)
    places = lines.reshape(-1, 3)
    points = Moments(np.ones(len(places)), places, np.zeros((len(places), 3, 3)))
    _, u, v = nearby(other, points, np.inf)
    feet = derivatives_at(other, u, v)[:, 0]
    return np.asarray(np.linalg.norm(places - feet, axis=1).reshape(lines.shape[:2]))


def _lines(net: Net) -> FloatArray:
    end_u, end_v = net.spans
    u = np.arange(_COLUMNS) / _COLUMNS * end_u
    v = np.linspace(0.0, end_v, _LINES * int(end_v) + 1)
    return np.asarray(evaluate_surface(net.surface(), u, v).swapaxes(0, 1))


def interpolating(net: Net, cells: Cells, noise: Noise, rims: tuple[Rim, Rim]) -> TensorFit | None:
    """A laid net as it is, with what its cells say of it; None if they are too few."""
    lattice, merged = Lattice.over(net), merged_for(net, cells)
    logs = log_stiffness(net, cells, noise)
    stiffness = np.full(lattice.count, logs[0]), np.full(lattice.count, logs[1])
    state = State(net, net.control_mm, merged.u, merged.v, noise, stiffness)
    manner = Manner(learning=True, model=_ALL, steps=3)
    with threadpool_limits(1, "blas"):
        done = do_round(state, merged.moments, lattice, rims, manner)
    if done is None:
        return None
    found = done[0]
    return TensorFit(
        net, found.unknowns, merged.moments, found.feet, found.weights, found.noise, stiffness,
        found.edf, Posterior(found.factor, found.inverse), found.misfit, 0,
    )  # fmt: skip
