"""A cone with its apex and a twisted vase, as closed meshes fine enough to be the truth.

::

    cone    radius 40 mm at z = 0, apex at z = 100 mm, flat base
    vase    superformula of five lobes (m = 5, n = 6, 6, 6) about a mean radius that swells and
            narrows with the height, turned by 72 degrees from bottom to top, two flat ends

1080 columns leave a sagitta of r (2 pi / 1080)^2 / 8 < 3e-4 mm at r = 60 mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
COLUMNS, VASE_ROWS, CONE_ROWS = 1080, 241, 41
VASE_MM, TWIST_RAD = 120.0, 0.4 * np.pi


def cone() -> tuple[Array, Faces]:
    """Vertices and faces of the cone, its apex the highest vertex."""
    turn = np.arange(COLUMNS) * (2.0 * np.pi / COLUMNS)
    share = np.arange(CONE_ROWS) / CONE_ROWS  # the row at 1 would be the apex
    radius = 40.0 * (1.0 - share)[:, None]
    rows = _rows(radius * np.cos(turn), radius * np.sin(turn), 100.0 * share)
    return closed(rows, bottom=np.zeros(3), top=np.array([0.0, 0.0, 100.0]))


def vase() -> tuple[Array, Faces]:
    """Vertices and faces of the vase."""
    turn = np.arange(COLUMNS) * (2.0 * np.pi / COLUMNS)
    share = np.linspace(0.0, 1.0, VASE_ROWS)[:, None]
    radius = vase_radius_mm(turn - TWIST_RAD * share, share)
    height = VASE_MM * share[:, 0]
    rows = _rows(radius * np.cos(turn), radius * np.sin(turn), height)
    return closed(rows, bottom=np.zeros(3), top=np.array([0.0, 0.0, VASE_MM]))


def vase_radius_mm(turn_rad: Array, share: Array) -> Array:
    """Radius at an angle of the untwisted outline and a share of the height."""
    lobes = (np.abs(np.cos(1.25 * turn_rad)) ** 6 + np.abs(np.sin(1.25 * turn_rad)) ** 6) ** (
        -1 / 6
    )
    mean = 32.0 + 10.0 * np.sin(2.0 * np.pi * share) + 4.0 * share
    return np.asarray(mean * lobes)


def closed(rows: Array, *, bottom: Array, top: Array) -> tuple[Array, Faces]:
    """Join rings (r, c, 3) by triangles and close them with fans to two centres."""
    count, columns = rows.shape[:2]
    here = np.arange(columns)
    there = np.roll(here, -1)
    base = np.arange(count - 1)[:, None] * columns
    one = np.stack([base + here, base + there, base + columns + there], axis=-1)
    two = np.stack([base + here, base + columns + there, base + columns + here], axis=-1)
    last, crown = count * columns, (count - 1) * columns
    low = np.stack([np.full(columns, last), there, here], axis=1)
    high = np.stack([np.full(columns, last + 1), crown + here, crown + there], axis=1)
    faces = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3), low, high])
    return np.concatenate([rows.reshape(-1, 3), [bottom, top]]), faces


def _rows(x: Array, y: Array, height: Array) -> Array:
    z = np.broadcast_to(height[:, None], x.shape)
    return np.stack([x, y, z], axis=-1)
