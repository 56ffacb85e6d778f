"""What our curve is held against: the best fixed number of control points, and the paper's method.

The first is told the truth (the points' places along the outline, and which number is best); the
second finds its order itself, as ours does.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from reconstruction.errors import TooFewPoints
from reconstruction.fitting.bands import factorise, solve
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.preliminary import normal_equations
from reconstruction.paper import PaperSettings, draw_section
from reconstruction.slices import Frame, Slice
from section_tables.outlines import EVEN, Array, Outline, weights_of

PIECES = 120
_FRAME = Frame(np.zeros(3), np.eye(3))


def oracle_mm(points: Array, share: Array, count: int, outline: Outline) -> float:
    """Periodic least squares with `count` control points at the true arc length."""
    band, right = normal_equations(share * count, points, count, closed=True)
    control = solve(*factorise(band), right)
    spline = BSpline(np.arange(-3.0, count + 4), np.vstack([control, control[:3]]), 3)
    places = spline(EVEN * count)
    return float(np.sqrt((weights_of(places) * outline.distances_mm(places) ** 2).sum()))


def paper_mm(points: Array, outline: Outline, *, cell_mm: float | None = None) -> float:
    """Rms to the truth of the paper's curve (`reconstruction.paper`); nan: it found none."""
    piece = Slice(0, np.column_stack([points, np.zeros(len(points))]), _FRAME)
    try:
        section, _ = draw_section(piece, PaperSettings(resolution_mm=cell_mm), None)
    except TooFewPoints:
        return float("nan")
    places = section.curve(np.linspace(*section.curve.domain, len(EVEN), endpoint=False))[:, :2]
    return float(np.sqrt((weights_of(places) * outline.distances_mm(places) ** 2).sum()))


def told_chain(points: Array, share: Array, sigma_mm: float) -> Chain:
    """The order told: means of the points in even pieces of the true length; an empty one a gap."""
    at = np.minimum((share * PIECES).astype(np.int64), PIECES - 1)
    filled = np.unique(at)
    nodes = np.array([points[at == piece].mean(axis=0) for piece in filled])
    gaps = np.flatnonzero(np.diff(filled, append=filled[0] + PIECES) > 1)
    sigmas = np.full(len(nodes), sigma_mm)
    return Chain(nodes, sigmas, closed=True, gaps=tuple(int(i) for i in gaps))
