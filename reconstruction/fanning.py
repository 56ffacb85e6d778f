r"""A cloud becomes meridians: slices that stand about an axis, each the points near a half plane.

The cloud is unrolled about the axis and cut as any other (`slicing`)::

                 axis                 distance
        \ | /    |                       |  : : : :      each column of points is a meridian
         \|/     o-- distance    ->      |  : : : :
        --o--    height                  +------------ angle, as a length far from the axis

Every point keeps its own place: a wedge that is flattened would draw walls to the inside.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import TooFewPoints
from reconstruction.reduction import Box
from reconstruction.setting_aside import Aside, find_part
from reconstruction.slices import Frame, Slice
from reconstruction.slicing import Cutting, cropped, cut_cloud
from reconstruction.survey import Axis, Pass, Spacing, Survey, choose_spacing, survey_cloud

_FAR = 0.9  # quantile of the distances from the axis at which an angle is told as a length
_WHOLE = 0.1  # of a step: so near to a whole number of steps a turn are rows that go all round
_LEAST = 3  # meridians
_SOME = 64  # pieces, and points of each, of the plate are drawn
FAN_PASSES = 3  # over the points, besides those of the cut: survey, plate, spacing


@dataclass(frozen=True, slots=True, eq=False)
class FanCutting:
    """What the cut did with every point of the cloud: as `slicing.Cutting`."""

    survey: Survey
    axis: Axis
    place_mm: tuple[float, float]  # of the axis, in the two coordinates across it, in cyclic order
    far_mm: float  # where an angle is a length
    first_rad: float  # at which angles begin
    cutting: Cutting  # of the unrolled cloud
    plate: int  # points of the table plate
    plate_mm: FloatArray  # some of them

    @property
    def spacing(self) -> Spacing:
        """The way from slice to slice far from the axis."""
        return self.cutting.spacing

    @property
    def counts(self) -> IntArray:
        """Points in each slice, (slices,)."""
        return self.cutting.counts

    @property
    def aside(self) -> Mapping[Aside, int]:
        """How many points were set aside, by reason."""
        return {**self.cutting.aside, Aside.PLATE: self.plate}

    @property
    def aside_mm(self) -> Mapping[Aside, FloatArray]:
        """Some of them, to be drawn."""
        rolled = {reason: self._rolled(some) for reason, some in self.cutting.aside_mm.items()}
        return {**rolled, Aside.PLATE: self.plate_mm}

    @property
    def box(self) -> Box:
        """Of the cloud."""
        return self.survey.box

    def slices(self) -> Iterator[Slice]:
        """The meridians by angle, empty ones too; may be called again."""
        for piece in self.cutting.slices():
            yield self._turned(piece)

    def slice_at(self, index: int) -> Slice:
        """One slice by its number."""
        return self._turned(self.cutting.slice_at(index))

    def _turned(self, piece: Slice) -> Slice:
        angle = self.first_rad + float(piece.frame.origin_mm[2]) / self.far_mm
        x, y, axis = np.eye(3)[list(self.axis.planar)]
        way = math.cos(angle) * x + math.sin(angle) * y
        origin = self.place_mm[0] * x + self.place_mm[1] * y
        frame = Frame(origin, np.stack([way, axis, np.cross(way, axis)]))
        return Slice(piece.index, self._rolled(piece.points_mm), frame)

    def _rolled(self, points_mm: FloatArray) -> FloatArray:
        """Unrolled points (n, 3) back in their places."""
        first, second, along = self.axis.planar
        angles = self.first_rad + points_mm[:, 2] / self.far_mm
        rolled = np.empty_like(points_mm)
        rolled[:, first] = self.place_mm[0] + points_mm[:, 0] * np.cos(angles)
        rolled[:, second] = self.place_mm[1] + points_mm[:, 0] * np.sin(angles)
        rolled[:, along] = points_mm[:, 1]
        return rolled


def fan_cloud(
    points: Pass,
    axis: Axis,
    *,
    place_mm: tuple[float, float] | None = None,
    spacing_mm: float | None = None,
    crop: Box | None = None,
) -> FanCutting:
    """Cut a cloud into meridians about an axis.

    Parameters
    ----------
    points
        Yields the finite points of the cloud in mm, (k, 3) at a time; called some times.
    axis
        Which way the axis runs.
    place_mm
        Where it stands, in the two coordinates across it in cyclic order (of z: x, y). By default
        at 0, 0, where a table's axis is, if the cloud lies around that; else in the middle of it.
    spacing_mm
        Distance between meridians far from the axis; by default found.

    Raises
    ------
    TooFewPoints
        Where nothing is left, or too few meridians.
    """
    inside = points if crop is None else cropped(points, crop)
    survey = survey_cloud(inside, axis)
    place = _place(survey.box, axis) if place_mm is None else place_mm
    top_mm = find_part(inside, survey, axis).plate_top_mm
    arms = survey.sample_mm[:, axis.planar[:2]] - np.array(place)
    far_mm = float(np.quantile(np.hypot(*arms.T), _FAR))
    if not far_mm > 0.0:
        raise TooFewPoints("all points lie on the axis: name another by --axis-at")
    plate = _Plate(axis, top_mm)

    def unrolled(first_rad: float) -> Pass:
        def passing() -> Iterator[FloatArray]:
            plate.begin()
            for chunk in inside():
                yield _unrolled(plate.without(chunk), axis, place, far_mm, first_rad)

        return passing

    turn_mm = math.tau * far_mm
    spacing = choose_spacing(survey_cloud(unrolled(0.0), Axis.Z), Axis.Z, given_mm=spacing_mm)
    count = turn_mm / spacing.step_mm
    if count < _LEAST:
        raise TooFewPoints(
            f"{count:.2g} meridians a turn: {_LEAST} are needed; choose a smaller --spacing-mm"
        )
    # Rows that go all round divide the turn evenly, the first of them in the middle of a slice.
    step_mm = turn_mm / round(count) if abs(count - round(count)) < _WHOLE else spacing.step_mm
    first_rad = (spacing.middle_mm - 0.5 * step_mm) / far_mm
    cutting = cut_cloud(unrolled(first_rad), Axis.Z, spacing_mm=step_mm)
    return FanCutting(survey, axis, place, far_mm, first_rad, cutting, plate.count, plate.points_mm)


def _place(box: Box, axis: Axis) -> tuple[float, float]:
    across = list(axis.planar[:2])
    low, high = box.low_mm[across], box.high_mm[across]
    place = np.zeros(2) if ((low < 0.0) & (high > 0.0)).all() else 0.5 * (low + high)
    return float(place[0]), float(place[1])


def _unrolled(
    points_mm: FloatArray, axis: Axis, place_mm: tuple[float, float], far_mm: float, first: float
) -> FloatArray:
    """Distance from the axis, height, and angle as a length, (n, 3)."""
    a, b = (points_mm[:, axis.planar[k]] - place_mm[k] for k in range(2))
    angles = np.mod(np.arctan2(b, a) - first, math.tau)
    return np.column_stack([np.hypot(a, b), points_mm[:, axis.column], angles * far_mm])


class _Plate:
    """Takes the points of the table plate out of a pass, and counts them."""

    def __init__(self, axis: Axis, top_mm: float) -> None:
        self._axis, self._top_mm = axis, top_mm
        self._some: list[FloatArray] = []
        self.count = 0

    def begin(self) -> None:
        """Count anew: every pass has all points."""
        self._some, self.count = [], 0

    def without(self, points_mm: FloatArray) -> FloatArray:
        """The points (n, 3) that are not of the plate."""
        of_plate = points_mm[:, self._axis.column] <= self._top_mm
        if not of_plate.any():
            return points_mm
        self.count += int(of_plate.sum())
        if len(self._some) < _SOME:
            self._some.append(points_mm[of_plate][:_SOME].copy())
        return points_mm[~of_plate]

    @property
    def points_mm(self) -> FloatArray:
        """Some of those of the plate."""
        return np.concatenate([np.empty((0, 3)), *self._some])
