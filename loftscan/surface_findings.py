"""Where the surface of `--method fit` is not where the points are, slice by slice.

One smooth surface a branch cannot follow what changes at once from slice to slice on one side, such
as a bulge that begins between two. The curves of the slices are right there and their residuals
small, so only the distances of the points from the mesh can tell.
"""

from __future__ import annotations

import math

import numpy as np

from loftscan.methods import AnyReconstruction
from loftscan.sliced import Sliced
from loftscan.spans import spans
from reconstruction.arrays import FloatArray, IntArray
from reconstruction.cleanup import CleanupSettings
from reconstruction.comparison import Deviation
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.skinning.layout import Layout, fan_of
from reconstruction.slices import Frame

_FAR_SIGMAS = 3.0  # half the points of a slice on the surface are within 0.67
_FAR_TOLERANCES = 3.0  # of the mesh, where there is next to no noise


def judge_surface(
    cutting: Sliced,
    done: AnyReconstruction,
    sample_mm: FloatArray,
    deviation: Deviation,
    cleanup: CleanupSettings,
) -> tuple[str, ...]:
    """Name the slices from whose points the surface keeps away; empty when there are none.

    Parameters
    ----------
    sample_mm
        (n, 3), an even sample of the points, with their `deviation` from the mesh.
    """
    if not isinstance(done, FittedReconstruction) or not len(sample_mm):
        return ()
    sections = done.sections
    frames = [each.frame for each in sections]
    if done.skinned.layout is Layout.MERIDIANS:
        nearest = _nearest_meridian(sample_mm, frames)
    else:
        column = cutting.axis.column
        heights_mm = np.array([frame.origin_mm[column] for frame in frames])
        nearest = _nearest(sample_mm[:, column], heights_mm)
    least_mm = _FAR_TOLERANCES * done.skinned.tolerance_mm
    away_mm = {
        section.index: median_mm
        for place, section in enumerate(sections)
        if (median_mm := _median(np.abs(deviation.distances_mm[nearest == place])))
        > max(_FAR_SIGMAS * section.width_mm / 4.0, least_mm)
    }
    return (_sentence(away_mm, cleanup),) if away_mm else ()


def _nearest(places_mm: FloatArray, heights_mm: FloatArray) -> IntArray:
    """Number of the nearest of some heights (k,) of each place (n,) -> (n,)."""
    order = np.argsort(heights_mm)
    ascending = heights_mm[order]
    borders = 0.5 * (ascending[1:] + ascending[:-1])
    return np.asarray(order[np.searchsorted(borders, places_mm)], dtype=np.int64)


def _nearest_meridian(places_mm: FloatArray, frames: list[Frame]) -> IntArray:
    """Number of the half plane, of some about an axis, that each place (n, 3) is nearest to."""
    fan = fan_of(frames)
    assert fan is not None, "meridians stand about an axis"
    angles = np.array([fan.angle_of(frame) for frame in frames])
    order = np.argsort(angles)
    around = np.concatenate([order[-1:], order, order[:1]])
    ascending = angles[around] + np.concatenate([[-math.tau], np.zeros(len(order)), [math.tau]])
    x, y = fan.frame.axes[:2] @ (places_mm - fan.frame.origin_mm).T
    own = np.mod(np.arctan2(y, x), math.tau)
    borders = 0.5 * (ascending[1:] + ascending[:-1])
    return np.asarray(around[np.searchsorted(borders, own)], dtype=np.int64)


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _sentence(away_mm: dict[int, float], cleanup: CleanupSettings) -> str:
    many = "s" if len(away_mm) > 1 else ""
    worst = max(away_mm, key=lambda index: away_mm[index])
    where = (
        f"slice{many} {spans(away_mm)}: half of the points lie far beyond their noise from the mesh"
        f" (median of slice {worst}: {away_mm[worst]:.3g} mm)"
    )
    if cleanup.decimate_to_faces is not None or cleanup.remesh_edge_mm is not None:
        return f"{where}: a mesh so coarse does not follow the surface; ask for more faces"
    return (
        f"{where}: the surface is smoother than the part, as where a bulge of one side begins"
        " between two slices; do not measure there; scan more densely, or choose --method paper"
    )
