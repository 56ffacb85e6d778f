"""Where a contour begins and which way it runs (the paper's section 2.4, Fig. 4).

"We have chosen a line which passes by the axis x = 0; at each cross-section the first CM is the
nearest of this reference line, no matter if the CM is before or after it. The CM numbering has
been adopted counterclockwise."

::

              | reference line x = x0
            1 *
          2 *   * m          the line meets a closed contour twice:
           *     *           the half with y above the contour's middle counts
            * . *
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.ordering import Contour


def number_contour(contour: Contour, *, reference_x_mm: float) -> Contour:
    """Turn a contour counter-clockwise and let it begin nearest to the reference line."""
    order = np.arange(len(contour.points_mm))
    bridged = contour.bridged
    if signed_area(contour.points_mm) < 0.0:
        order = order[::-1]
        # Segment k led from k to k + 1; read backwards it is the one that leads to k.
        bridged = np.roll(bridged[::-1], -1)
    points = contour.points_mm[order]
    from_line = np.abs(points[:, 0] - reference_x_mm)
    upper = points[:, 1] >= points[:, 1].mean()
    first = int(np.argmin(np.where(upper, from_line, np.inf)))
    order = np.roll(order, -first)
    return Contour(
        contour.points_mm[order],
        contour.counts[order],
        np.roll(bridged, -first),
        contour.closed,
        contour.cells[order],
        contour.visited,
    )


def signed_area(polygon_mm: FloatArray) -> float:
    """Area of a closed polygon (n, 2) in mm², positive counter-clockwise (shoelace)."""
    x, y = polygon_mm[:, 0], polygon_mm[:, 1]
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
