"""A trial that runs away is an error that its caller can drop, and no overflow."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.errors import ReconstructionError
from reconstruction.fitting.moments import cells_of_points
from reconstruction.fitting.smoothing import feet


@pytest.mark.parametrize("size_mm", [1e200, np.inf, np.nan])
def test_a_curve_that_has_run_away_is_refused(size_mm: float) -> None:
    control_mm = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [3.0, size_mm], [4.0, 0.0]])
    cells = cells_of_points(np.array([[1.0, 0.5], [2.0, 0.5]]))
    with pytest.raises(ReconstructionError, match="a trial curve has run away"):
        feet(control_mm, cells, np.array([0.5, 1.0]), closed=False)
