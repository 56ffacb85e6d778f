r"""How an exact surface ends: at the level brims of its branch, or in a tip or pole of its own.

An exact shape knows where it runs out. If that is before the next slice would have met it, there is
the apex, whatever the outlines' areas seemed to say; if it is not, the wall ends at a level brim.
Towards a tip slices become heaps, of which no outline can be drawn: they are slices that met it. ::

      tip         . x .      heap      the tip may lie up to the first slice beyond that holds
                 . x x .     heap      nothing, and no heap may lie beyond the tip
      edge       /     \     outline
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, frozen
from reconstruction.errors import Unfittable
from reconstruction.nurbs import Surface
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.branching import is_ring_ended
from reconstruction.skinning.ends import Apex, Brim, brim_or_apex
from reconstruction.skinning.exact_shapes import Shape
from reconstruction.skinning.exact_surfaces import surface_of
from reconstruction.skinning.primitives import Cone, Cylinder, Plane, Sphere
from reconstruction.skinning.revolution import Revolution

_SLACK = 1.15  # times the way to the next slice: heights and figures have noise
_REACH = 6.0  # standard deviations that noise carries points beyond a tip
_POINT = 1e-9  # of the surface's size: a row no wider is one point

Ends = tuple[Brim | Apex, Brim | Apex]


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """The slices of a scan, whatever became of them."""

    heights_mm: FloatArray  # (s,), rising
    heaps: BoolArray  # (s,), points hang together there in no outline

    def __post_init__(self) -> None:
        object.__setattr__(self, "heights_mm", frozen(self.heights_mm))
        object.__setattr__(self, "heaps", frozen(self.heaps, np.bool_))

    def heaps_beyond(self, height_mm: float, *, last: bool) -> FloatArray:
        """Heights of the heaps that follow on a level, one slice after the other."""
        order = slice(None) if last else slice(None, None, -1)
        heights, heaps = self.heights_mm[order], self.heaps[order]
        beyond = heights > height_mm if last else heights < height_mm
        heights, heaps = heights[beyond], heaps[beyond]
        return np.asarray(heights[np.cumprod(heaps, dtype=np.bool_)])


@dataclass(frozen=True, slots=True, eq=False)
class Ended:
    """An exact surface and how it ends."""

    surface: Surface
    brims: Ends | None  # None: it closes in v


def ended(branch: Branch, shape: Shape, levels: Levels) -> Ended | None:
    """The surface of a shape between the ends of a branch; None where it cannot end as that does.

    That is a plane, a shape that leans too far, a branch that turns over, a dome of revolution,
    whose top no profile of slices tells, and a leaning surface of revolution where branches meet,
    whose end is level only if it does not lean.
    """
    form = shape.form
    loop = isinstance(form, Revolution) and form.closed
    if isinstance(form, Plane) or is_ring_ended(branch) or loop != (branch.ends is None):
        return None
    if len({outline.hole for outline in branch.outlines}) > 1 and not loop:
        return None
    if branch.ends is None:
        return ended_at(branch, shape, None)
    try:
        low, high = (_end(branch, shape, levels, last=last) for last in (False, True))
    except Unfittable:
        return None
    return ended_at(branch, shape, (low, high))


def ended_at(branch: Branch, shape: Shape, brims: Ends | None) -> Ended | None:
    """The surface of a shape between ends that are known; None where it cannot end so."""
    heights = (-math.inf, math.inf)
    if brims is not None:
        heights = (_height(brims[0], last=False), _height(brims[1], last=True))
    try:
        surface = surface_of(
            shape.form, heights, branch.axes[0], along=branch.axes[2],
            places_mm=shape.moments.means_mm,
        )  # fmt: skip
    except Unfittable:
        return None
    return Ended(surface, brims) if _ends_so(surface, brims) else None


def ended_as(branch: Branch, shape: Shape, brims: Ends) -> Ended | None:
    """The same for meridians, which have seen where they end: poles go where the shape has its own.

    A surface of revolution is not ended in a pole: its profile says nothing beyond its points.
    """
    form, found = shape.form, []
    if isinstance(form, Plane):
        return None
    for last, brim in zip((False, True), brims, strict=True):
        tip = _tip(shape, branch.axes[2], last=last) if isinstance(brim, Apex) else None
        if isinstance(brim, Apex) and tip is None:
            return None
        found.append(brim if tip is None else Apex(tip, sharp=isinstance(form, Cone)))
    return ended_at(branch, shape, (found[0], found[1]))


def _end(branch: Branch, shape: Shape, levels: Levels, *, last: bool) -> Brim | Apex:
    assert branch.ends is not None, "an open branch has ends"
    end, form = branch.ends[last], shape.form
    usual = brim_or_apex(branch.outlines, end, last=last)
    if isinstance(form, Revolution) and (end.ending is Ending.JOINED or isinstance(usual, Apex)):
        raise Unfittable("revolution: its end may not be level, its top is not told by slices")
    if end.ending is Ending.JOINED or isinstance(form, Cylinder | Revolution):
        edge, reach = _reach(branch, end, last=last)
        return usual if isinstance(usual, Brim) else Brim(edge + 0.5 * reach, _axis(branch))
    return _brim_or_tip(branch, shape, levels, usual, last=last)


def _brim_or_tip(
    branch: Branch, shape: Shape, levels: Levels, usual: Brim | Apex, *, last: bool
) -> Brim | Apex:
    """Where a cone or a sphere runs out, if that is before the next slice."""
    assert branch.ends is not None, "an open branch has ends"
    edge, reach = _reach(branch, branch.ends[last], last=last)
    tip, axis = _tip(shape, _axis(branch), last=last), _axis(branch)
    way, step = math.copysign(1.0, reach), abs(reach)
    if tip is not None:
        climb = way * (float(tip @ axis) - edge)
        heaps = way * (levels.heaps_beyond(edge, last=last) - edge)
        held = float(heaps.max(initial=0.0))
        noise = _REACH * math.sqrt(float(shape.scatters_mm2.mean()))
        if held - noise < climb < held + _SLACK * step:
            return Apex(tip, sharp=isinstance(shape.form, Cone))
    return usual if isinstance(usual, Brim) else Brim(edge + 0.5 * reach, axis)


def _reach(branch: Branch, end: End, *, last: bool) -> tuple[float, float]:
    """Height of the outermost outline, and the way from it to where the next slice would be."""
    near = branch.outlines[:-3:-1] if last else branch.outlines[:2]
    edge = near[0].height_mm
    step = edge - near[1].height_mm
    return edge, end.height_mm - edge if end.ending is Ending.CLOSED else step


def _tip(shape: Shape, axis: FloatArray, *, last: bool) -> FloatArray | None:
    """Where a form runs out towards an end, (3,); None: it does not."""
    form, way = shape.form, 1.0 if last else -1.0
    if isinstance(form, Sphere):
        return np.asarray(form.centre_mm + way * form.radius_mm * axis)
    if isinstance(form, Cone) and way * float(form.frame.axes[2] @ axis) < 0.0:
        return form.apex_mm
    return None


def _axis(branch: Branch) -> FloatArray:
    return np.asarray(branch.axes[2])


def _height(brim: Brim | Apex, *, last: bool) -> float:
    """Of an end along the axis; beyond a tip, which ends the surface by itself."""
    if isinstance(brim, Brim):
        return brim.height_mm
    return math.inf if last else -math.inf


def _ends_so(surface: Surface, brims: Ends | None) -> bool:
    """Whether a surface ends in points where it should, and nowhere else."""
    if brims is None:
        return surface.periodic_v
    size = float(np.ptp(surface.control_points_mm.reshape(-1, 3), axis=0).max())
    widths = np.ptp(surface.control_points_mm[:, [0, -1]], axis=0).max(axis=1)
    pointed = widths < _POINT * size
    return bool((pointed == [isinstance(brim, Apex) for brim in brims]).all())
