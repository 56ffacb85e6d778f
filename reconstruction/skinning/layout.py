r"""How the slices of a scan stand to each other: over one another, side by side, or about an axis.

::

    rings    _______     stripes   | | | |     meridians    \ | /
             _______               | | | |                  - o -   o: the axis of the table
             _______               | | | |                  / | \

    planes   parallel              parallel                 through one axis
    sections closed                open                     open, or closed off the axis
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Sized
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.errors import NotLoftable
from reconstruction.slices import Frame

_FEWEST_CLOSED, _FEW_CLOSED = 2, 0.05  # closed sections, and of the open ones
_FEWEST_OPEN = 2
_PARALLEL = math.radians(0.5)  # normals that differ by less are one
_ALONG = math.radians(2.0)  # a plane may lean so much against the axis ...
_BESIDE = 0.02  # ... and pass it by so much of the distances of the planes' origins, ...
_BESIDE_MM = 1.0  # ... or that


class Layout(Enum):
    """What slices are sections of."""

    AUTO = "auto"  # as they show themselves
    RINGS = "rings"
    STRIPES = "stripes"
    MERIDIANS = "meridians"


class Sectioned(Protocol):
    """What is known of a slice's sections: `drawing.SliceOutlines`."""

    @property
    def frame(self) -> Frame:
        """Of its plane."""
        ...

    @property
    def outlines(self) -> Sized:
        """Closed ones."""
        ...

    @property
    def runs(self) -> Sized:
        """Open ones."""
        ...


def layout_of(slices: Sequence[Sectioned], wanted: Layout = Layout.AUTO) -> Layout:
    """What slices are sections of: as wanted, or as they show themselves.

    Sections that are open nearly all are stripes: of a part that is seen all round, a slice now
    and then is closed.
    """
    if wanted is not Layout.AUTO:
        return wanted
    if fan_of([piece.frame for piece in slices]) is not None:
        return Layout.MERIDIANS
    closed = sum(len(piece.outlines) > 0 for piece in slices)
    only_open = sum(not piece.outlines and len(piece.runs) > 0 for piece in slices)
    few = closed < _FEWEST_CLOSED or closed < _FEW_CLOSED * only_open
    return Layout.STRIPES if few and only_open >= _FEWEST_OPEN else Layout.RINGS


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Planes through one axis; angles count about it, from the first plane's own direction."""

    frame: Frame  # origin on the axis, rows x, y across it, normal along it

    def places_of(self, places_mm: FloatArray, plane: Frame) -> FloatArray:
        """Distance from the axis along the plane, and height along it, (n, 3) -> (n, 2)."""
        arms = places_mm - self.frame.origin_mm
        return np.stack([arms @ self.way_of(plane), arms @ self.frame.axes[2]], axis=1)

    def way_of(self, plane: Frame) -> FloatArray:
        """The direction in a plane that leads away from the axis, (3,): its own x where it can."""
        axis = self.frame.axes[2]
        way = np.cross(axis, plane.axes[2])
        way /= np.linalg.norm(way)
        own = plane.axes[0] if abs(plane.axes[0] @ way) > 0.5 else plane.axes[1]
        return np.asarray(way if own @ way > 0.0 else -way)

    def angle_of(self, plane: Frame) -> float:
        """Of a plane's own direction, in [0, 2 pi)."""
        x, y = self.frame.axes[:2] @ self.way_of(plane)
        return math.atan2(y, x) % math.tau


def is_turned(one: Frame, other: Frame) -> bool:
    """Whether the normals of two planes differ."""
    a, b = one.axes[2], other.axes[2]
    return bool(np.linalg.norm(np.cross(a, b)) >= math.sin(_PARALLEL) or a @ b < 0.0)


def fan_of(frames: Sequence[Frame]) -> Fan | None:
    """The axis that planes share; None: they are parallel.

    Raises
    ------
    NotLoftable
        They are neither.
    """
    normals = np.array([frame.axes[2] for frame in frames]).reshape(-1, 3)
    turned = np.linalg.norm(np.cross(normals, normals[:1]), axis=1)
    if float(turned.max(initial=0.0)) < math.sin(_PARALLEL):
        return None
    axis = np.linalg.svd(normals)[2][-1]
    axis = _upright(axis, frames)
    if float(np.abs(normals @ axis).max()) > math.sin(_ALONG):
        raise NotLoftable(
            "the slices' planes are neither parallel nor do they share an axis: scan rings, stripes"
            " or meridians"
        )
    origins = np.array([frame.origin_mm for frame in frames])
    offsets = (normals * origins).sum(axis=1)
    middle = origins.mean(axis=0)
    flat = np.eye(3) - np.outer(axis, axis)
    # The place nearest to all planes; along the axis it stays where the origins are.
    place = middle + flat @ np.linalg.lstsq(normals @ flat, offsets - normals @ middle)[0]
    beside = np.abs(normals @ place - offsets)
    size = float(np.linalg.norm(origins - place, axis=1).max())
    if float(beside.max()) > max(_BESIDE * size, _BESIDE_MM):
        raise NotLoftable(
            f"the slices' planes pass their common axis by up to {beside.max():.3g} mm: correct the"
            " calibration of table and sensor"
        )
    return Fan(_about(place, axis, frames[0]))


def _upright(axis: FloatArray, frames: Sequence[Frame]) -> FloatArray:
    """Up is where the planes' own y points, or x, whichever runs along the axis."""
    along = np.array([frame.axes[:2] @ axis for frame in frames])
    own = along[:, int(np.argmax(np.abs(along).sum(axis=0)))]
    return np.asarray(-axis if own.sum() < 0.0 else axis)


def _about(place: FloatArray, axis: FloatArray, first: Frame) -> Frame:
    way = first.axes[0] if abs(first.axes[0] @ axis) < abs(first.axes[1] @ axis) else first.axes[1]
    x = way - (way @ axis) * axis
    x /= np.linalg.norm(x)
    return Frame(frozen(place), np.stack([x, np.cross(axis, x), axis]))
