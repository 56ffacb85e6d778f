r"""Whether a fit winds about its chain, and which points to believe less where it does.

In a thick band a curve may wind from side to side: every point then lies near some stretch of it,
the noise looks small, and points that err together make it look likelier still. The chain, whose
nodes are means across the band, is as long as the curve should be. A fit that is much longer
somewhere is made again, with the points there worth fewer independent ones. ::

      . . _ . . . _ .              where it winds: doubt * 4, and from a stiff start
     . ./ .\ . ./ .\ .    ---->    . . . . . . .
    ===/ . .\ ./ . .\====          ===============
     . . . . \_/. . . .             . . . . . .
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.smoothing import Fit
from reconstruction.fitting.spline import evaluate

# Lengths of the chain: sound fits of six outlines with lobes, corners and bends, of 300 to 12 000
# points and noise of 0.05 to 2 mm, have 1.09 at most, and those that visibly wind 1.3 at least.
WINDING = 1.25
_DOUBTFUL = 1.1  # lengths: so wound, points are believed less, once some place winds ...
_BESIDE = 2  # ... and these spans to either side of them
_TIMES = 4.0
_A_WAY = 4  # places on a way of the chain, and at least half as many on the fit
_A_SPAN = 3  # places on the fit
_WINDOW = 9  # ways


def windings(fit: Fit, chain: Chain) -> FloatArray:
    """Length of the fit over that of the chain beside it, by span, (spans,); 0 in gaps."""
    ways = len(chain.nodes_mm) if chain.closed else len(chain.nodes_mm) - 1
    each = max(_A_SPAN, -(-_A_WAY // 2 * ways // fit.spans))  # places a span
    t = (np.arange(each * fit.spans) + 0.5) / each
    places, tangents, _ = evaluate(fit.control_mm, t)
    nodes = chain.nodes_mm[[*range(len(chain.nodes_mm)), *([0] if chain.closed else [])]]
    lengths = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    stops = np.arange(_A_WAY * ways + 1) / _A_WAY
    along = np.column_stack([np.interp(stops, np.arange(ways + 1), axis) for axis in nodes.T])
    nearest = np.asarray(cKDTree(along).query(places)[1])
    # Beyond the ends of an open chain and in gaps there is nothing to compare with.
    beyond = (nearest == 0) | (nearest == len(along) - 1) if not chain.closed else nearest < 0
    counted = ~(beyond | _bridged(t, places, fit, chain))
    way = np.minimum(nearest // _A_WAY, ways - 1)
    own = np.bincount(way, np.linalg.norm(tangents, axis=1) / each * counted, ways)
    lengths[list(chain.gaps)] = 0.0
    sums = [
        uniform_filter1d(each_way, _WINDOW, mode="wrap" if chain.closed else "constant")
        for each_way in (own, lengths)
    ]
    sound = sums[1] > 0.3 * np.median(sums[1])
    ratios = np.where(sound, sums[0] / np.maximum(sums[1], 1e-300), 0.0)
    return np.asarray((ratios[way] * counted).reshape(fit.spans, each).max(axis=1))


def _bridged(t: FloatArray, places: FloatArray, fit: Fit, chain: Chain) -> BoolArray:
    """Which places of the fit lie in a gap, or a span beside one: nothing was measured there."""
    inside = np.zeros(len(t), np.bool_)
    tree = cKDTree(places)
    for gap in chain.gaps:
        ends = chain.nodes_mm[[gap, (gap + 1) % len(chain.nodes_mm)]]
        start, end = t[np.asarray(tree.query(ends)[1])] + [-1.0, 1.0]
        inside |= np.mod(t - start, fit.spans) <= np.mod(end - start, fit.spans)
    return inside


def doubted(fit: Fit, wound: FloatArray) -> FloatArray:
    """How many times fewer independent points each cell's are worth next time, (m,)."""
    doubtful = wound > _DOUBTFUL
    for _ in range(_BESIDE):
        doubtful = doubtful | np.roll(doubtful, 1) | np.roll(doubtful, -1)
    spans = np.minimum(fit.t.astype(np.int64), fit.spans - 1)
    return np.where(doubtful[spans], _TIMES, 1.0)
