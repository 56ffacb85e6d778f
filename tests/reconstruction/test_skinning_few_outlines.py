"""Few outlines far apart: the surface is no worse than a spline through them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import Exact
from reconstruction.nurbs import evaluate_surface
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.skinning.skin import Skin
from reconstruction.skinning.surfacing import skin_slices
from tests.reconstruction.skinning_parts import ring_slices

STEP, SIGMA = 10.0, 0.05

# Radii of rings: much change from one to the next, and noise far below it.
STEEP = (60.0, 30.0, 14.0, 6.0)
WAIST = (30.0, 22.0, 20.0, 21.0, 26.0, 34.0)
BELLY = (30.0, 33.0, 36.0, 32.0, 30.0, 24.0)
VASE = (30.0, 33.0, 36.0, 32.0, 30.0, 24.0, 25.0, 28.0, 33.0, 35.0, 32.0, 30.0)
LIVELY = tuple(30.0 + 6.0 * math.sin(1.1 * k) + 3.0 * math.sin(0.37 * k) for k in range(30))
STILL = (20.0, 20.1, 20.0, 19.9)


def profile(skin: Skin, heights: FloatArray) -> FloatArray:
    """Mean radius of a surface about z at heights."""
    (start, end), (low, high) = skin.surface.domain
    u = np.linspace(start, end, 24, endpoint=False)
    lines = evaluate_surface(skin.surface, u, np.linspace(low, high, 4000))
    found = []
    for line in lines:
        assert (np.diff(line[:, 2]) > -1e-9).all(), "it goes up and down again"
        found.append(np.interp(heights, line[:, 2], np.hypot(line[:, 0], line[:, 1])))
    return np.asarray(np.mean(found, axis=0))


@pytest.mark.parametrize("radii", [STEEP, WAIST, BELLY, VASE, LIVELY, STILL])
def test_the_surface_is_no_worse_than_a_spline_through_the_outlines(
    radii: tuple[float, ...],
) -> None:
    heights = STEP * np.arange(len(radii))
    known = dict(zip(heights.tolist(), radii, strict=True))
    slices = ring_slices(
        heights.tolist(), lambda turn, at: np.full_like(turn, known[at]), count=3000, sigma_mm=SIGMA
    )
    skins = skin_slices([draw_outlines(each) for each in slices], exact=Exact.NEVER).skins
    (skin,) = skins
    assert isinstance(skin, Skin)
    # An outline's radius is known to SIGMA / sqrt(3000), its 24 places to about a tenth of SIGMA.
    assert np.abs(profile(skin, heights) - radii).max() < 0.5 * SIGMA
    # Between, two splines through the same radii that end otherwise differ by a share of how
    # much these bend; the ends' own intervals by more.
    spline = CubicSpline(heights, radii, bc_type="natural")
    middles = heights[1:-2] + 0.5 * STEP
    bend = float(np.abs(np.diff(radii, 2)).max())
    assert np.abs(profile(skin, middles) - spline(middles)).max() < 0.1 * bend + 0.5 * SIGMA
