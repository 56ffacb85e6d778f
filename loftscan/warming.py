"""Compiled code is loaded before it is needed: the first slice must not wait for it.

numba keeps what it compiled in a cache on disk, but even from there the kernels take a second, and
on a fresh machine half a minute. Waiting for the first slice is the time to do it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loftscan.gathering import Intake, coverage
from loftscan.reconstructing import Settings
from loftscan.scans import Arrival, corners_of
from reconstruction.course import OF_A_CLOUD, run_course
from reconstruction.skinning.layout import Layout
from reconstruction.slices import Frame, Slice

_RINGS = 3  # a surface of two has no net to lay over the one between
_POINTS = 6000  # so many are looked at by cells
_GAP = 400  # points left out, so that a gap is walked over
_WALL_MM = 6.0  # between the outside and a hole
_SPARSE, _ASTRAY_MM = 601, 1.0  # a few points belong to nothing


def warm_up(settings: Settings | None = None) -> None:
    """Take made rings the whole way, by the method of the settings."""
    intake = Intake(None)
    pieces = [intake.take(Arrival(_ring(index), np.zeros(6, np.int64))) for index in range(_RINGS)]
    coverage(pieces[0])
    course = replace(settings or Settings(), layout=Layout.AUTO).course()  # rings are rings
    for _ in run_course(pieces, course, OF_A_CLOUD):
        pass


def _ring(index: int) -> Slice:
    rng = np.random.default_rng(index)
    angle = np.linspace(0.0, 2.0 * np.pi, _POINTS, endpoint=False)[_GAP:]
    radius = 20.0 + rng.normal(0.0, 0.05, len(angle))
    radius[::3] -= _WALL_MM  # a hole: two curves a slice
    radius[1::_SPARSE] += _ASTRAY_MM
    height = np.full(len(angle), float(index))
    points_mm = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    points_mm.flags.writeable = False
    frame = Frame(np.array([0.0, 0.0, float(index)]), np.eye(3))
    return Slice(index, points_mm, frame, corners_of(points_mm))
