"""Surfaces through slices that are unevenly spaced, as an adaptive scan leaves them."""

from __future__ import annotations

import numpy as np

from reconstruction.cleanup import CleanupSettings
from reconstruction.course import OF_A_CLOUD, run_course
from reconstruction.fit_pipeline import FitCourse, FittedReconstruction
from reconstruction.fitting.curve import Exact
from reconstruction.skinning.laying import _spread
from reconstruction.skinning.patches import Patches
from sim.judging import Surface
from sim.parts import vase
from tests.campaigns.adaptive import Truth, noisy_slice


def test_rows_that_crowd_in_one_span_do_not_make_the_rest_of_it_sway() -> None:
    # Where an adaptive scan of the vase bisected its top. Led through all five rows of the last
    # span, the natural spline swayed: 0.18 mm rms, 2 mm at most, from noise of 0.02 mm.
    even = [0.05, 7.85, 11.75, 15.75, 23.55, 31.45, 39.25, 47.05, 55.05, 63.05, 70.75, 78.65, 86.45]
    truth = Truth(vase())
    heights = [*even, 94.35, 98.25, 99.15, 99.65, 99.85, 99.95]
    slices = (noisy_slice(truth, round(10 * each), each, seed=1) for each in heights)
    course = FitCourse(Exact.NEVER, CleanupSettings())
    *_, done = run_course(slices, course, OF_A_CLOUD)
    assert isinstance(done, FittedReconstruction)
    corners = done.mesh.vertices_mm
    walls = corners[(corners[:, 2] > 0.1) & (corners[:, 2] < 99.5)]
    away = Surface(vase().vertices_mm, vase().faces).signed_distances_mm(walls[::40])
    # 0.003 mm rms where rows are spread evenly, too.
    assert float(np.sqrt(np.mean(away**2))) < 0.006


def test_a_spline_keeps_its_ends_and_leaves_out_what_crowds() -> None:
    rows = np.array([0.0, 0.2, 0.9, 1.1, 2.0, 3.5, 4.2, 4.9, 5.0])
    assert rows[_spread(rows)].tolist() == [0.0, 0.9, 2.0, 3.5, 4.2, 5.0]


def test_a_spline_through_even_rows_leaves_out_none() -> None:
    rows = np.array([0.0, 0.75, 2.25, 3.75, 5.25, 6.0])  # ends half a slice's distance away
    assert len(_spread(rows)) == 6


def test_a_shape_that_threw_out_every_cell_has_no_derivative_and_is_no_error() -> None:
    nothing = Patches(
        np.empty(0, np.int64), np.empty(0), np.empty((0, 3)), np.empty((0, 2), np.int64)
    )
    found = nothing.along(lambda places: np.zeros((len(places), 4)), np.empty((0, 3)))
    assert found.shape == (0, 4)
