"""Compiled code is loaded before it is needed: the first slice must not wait for it.

numba keeps what it compiled in a cache on disk, but even from there the kernels take a second, and
on a fresh machine half a minute. Waiting for the first slice is the time to do it.
"""

from __future__ import annotations

import numpy as np

from loftscan.gathering import Intake, coverage
from loftscan.scans import Arrival, corners_of
from reconstruction.cleanup import CleanupSettings
from reconstruction.paper import PaperSettings
from reconstruction.pipeline import reconstruct_paper
from reconstruction.slices import Frame, Slice

_POINTS = 600
_GAP = 40  # points left out, so that a gap is walked over


def warm_up() -> None:
    """Take a made ring the whole way, twice."""
    intake = Intake(None)
    pieces = [intake.take(Arrival(_ring(index), np.zeros(6, np.int64))) for index in range(2)]
    coverage(pieces[0])
    for _ in reconstruct_paper(pieces, PaperSettings(), CleanupSettings()):
        pass


def _ring(index: int) -> Slice:
    rng = np.random.default_rng(index)
    angle = np.linspace(0.0, 2.0 * np.pi, _POINTS, endpoint=False)[_GAP:]
    radius = 20.0 + rng.normal(0.0, 0.05, len(angle))
    height = np.full(len(angle), float(index))
    points_mm = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    points_mm.flags.writeable = False
    frame = Frame(np.array([0.0, 0.0, float(index)]), np.eye(3))
    return Slice(index, points_mm, frame, corners_of(points_mm))
