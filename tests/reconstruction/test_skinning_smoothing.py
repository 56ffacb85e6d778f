"""How smooth a surface becomes by itself, held against every stiffness that could be prescribed."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.net import Net, derivatives_at
from reconstruction.skinning.rounds import Manner, Rim, State, do_round
from reconstruction.skinning.skin import Skin, skin_branch
from reconstruction.skinning.stiffness import Lattice
from tests.reconstruction.skinning_parts import drawn, only_branch, ring_slices

HEIGHT_MM, SLICES, COUNT = 120.0, 60, 500
SIGMA_MM = 0.54  # 0.3 % of the vase's diagonal
TWIST_RAD = 0.4 * math.pi
STEPS = np.arange(-3.0, 3.1, 1.5)  # logarithms about what the fit has found on average
ROUNDS = 3  # with what is prescribed, from a surface nearby


def vase(turn: FloatArray, height: float | FloatArray) -> FloatArray:
    """The vase of the benchmarks of surfaces: five lobes of a superformula, twisted, swelling."""
    share = np.asarray(height) / HEIGHT_MM
    own = 1.25 * (turn - TWIST_RAD * share)
    lobes = (np.abs(np.cos(own)) ** 6 + np.abs(np.sin(own)) ** 6) ** (-1 / 6)
    return np.asarray((32.0 + 10.0 * np.sin(math.tau * share) + 4.0 * share) * lobes)


def rms_mm(net: Net) -> float:
    """Along radii; the same for every stiffness, so that the slope of the wall cancels."""
    u, v = np.meshgrid(
        np.linspace(0.0, net.spans[0], 150, endpoint=False),
        np.linspace(0.5, net.spans[1] - 0.5, 90),
    )
    x, y, z = derivatives_at(net, u.ravel(), v.ravel())[:, 0].T
    turn = np.arctan2(y, x)
    return float(np.sqrt(np.mean((np.hypot(x, y) - vase(turn, z)) ** 2)))


def prescribed(skin: Skin, logs: tuple[float, float]) -> Net:
    """The surface at rest with one stiffness along u and one along v, everywhere."""
    fit = skin.fit
    lattice = Lattice.over(fit.net)
    state = State(
        fit.net, fit.net.control_mm, fit.feet.u, fit.feet.v, fit.noise,
        (np.full(lattice.count, logs[0]), np.full(lattice.count, logs[1])), fit.edf,
    )  # fmt: skip
    assert skin.brims is not None
    low, high = (Rim(level=brim.axis) for brim in skin.brims)  # type: ignore[union-attr]
    for _ in range(ROUNDS):
        done = do_round(
            state, fit.moments, lattice, (low, high), Manner(learning=False, model=0.3, steps=1)
        )
        assert done is not None
        state = replace(done[1], noise=fit.noise)
    return state.net


def test_a_vase_is_as_smooth_as_the_best_stiffness_would_make_it() -> None:
    """Within 1.1 times the rms of the best that could be prescribed."""
    slices = ring_slices(
        ((np.arange(SLICES) + 0.5) * (HEIGHT_MM / SLICES)).tolist(),
        vase,
        count=COUNT,
        sigma_mm=SIGMA_MM,
        seed=21,
    )
    skin = skin_branch(only_branch(drawn(slices)))
    means = [float(logs.mean()) for logs in skin.fit.stiffness]
    tried = {
        (a, b): rms_mm(prescribed(skin, (means[0] + a, means[1] + b)))
        for a, b in itertools.product(STEPS, STEPS)
    }
    best = min(tried, key=lambda each: tried[each])
    # The best lies inside of what was tried.
    assert max(abs(each) for each in best) < STEPS[-1]
    assert rms_mm(skin.fit.net) < 1.1 * tried[best]
