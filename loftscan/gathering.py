"""Slices on their way to sections: cropped, strays set aside, counted; what is kept is bounded.

Of a slice's points only a sample stays: a few thousand to draw it, and its share of the sample from
which the deviation of the finished mesh is measured. Memory grows with the sections, not with the
points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.profiler import Reason
from loftscan.coverage import share_of_turn
from loftscan.scans import Absent, Arrival, corners_of
from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.reduction import Box
from reconstruction.setting_aside import Aside, find_part
from reconstruction.skinning.layout import Fan, fan_of, is_turned
from reconstruction.slices import Frame, Slice
from reconstruction.survey import Axis, Spacing, SpacingRule, survey_cloud

_SAMPLE = 200_000  # points for the deviation, of all slices together
_DRAWN_A_SLICE = 3_000  # as many bytes as the histograms of its section
_DRAWN_ASIDE = 30_000  # points of each reason
_FEWEST = 8  # points that a slice needs before strays can be told from it


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """What became of every point of the slices that came."""

    indices: tuple[int, ...]  # of the slices, in the order they came
    counts: IntArray  # (slices,) points in each, after setting aside
    samples: Mapping[int, Slice]  # some points of each, to be drawn
    sample_mm: FloatArray  # (k, 3) an even sample of all points in the slices
    aside: Mapping[Aside, int]
    aside_mm: Mapping[Aside, FloatArray]
    box: Box
    axis: Axis
    spacing: Spacing
    absent: tuple[Absent, ...]
    reasons: IntArray  # (6,) places of all profiles by `Reason`
    profiles: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "counts", frozen(self.counts, np.int64))
        object.__setattr__(self, "sample_mm", frozen(self.sample_mm))
        object.__setattr__(self, "reasons", frozen(self.reasons, np.int64))

    @property
    def points(self) -> int:
        """Measured points that came."""
        return int(self.counts.sum()) + sum(self.aside.values())

    @property
    def invalid(self) -> int:
        """Places of profiles without a point."""
        return int(self.reasons.sum() - self.reasons[Reason.MEASURED])

    def slice_at(self, index: int) -> Slice:
        """A sample of one slice by its index."""
        return self.samples[index]


class Intake:
    """Takes slices in and gives them on; `gathered` tells at the end."""

    def __init__(self, crop: Box | None) -> None:
        self._crop = crop
        self._pieces: list[_Kept] = []
        self._absent: list[Absent] = []
        self._aside = {reason: _Remembered() for reason in Aside}
        self._even = EvenSample(_SAMPLE)
        self._reasons = np.zeros(len(Reason), np.int64)
        self._profiles = 0

    def take(self, arrival: Arrival) -> Slice:
        """Count a slice; give what of it belongs to the part.

        Raises
        ------
        ValueError
            It does not lie above the one before it, seen along its normal, or a point of it is not
            finite.
        """
        piece = _with_corners(arrival.piece)
        self._check_order(piece)
        self._reasons += arrival.reasons
        self._profiles += arrival.profiles
        piece = self._without(piece, Aside.CROPPED, self._outside(piece))
        piece = self._without(piece, Aside.STRAY, find_strays(piece))
        self._pieces.append(_Kept(thinned(piece), len(piece.points_mm), piece.corners_mm))
        self._even.add(piece.points_mm, seed=piece.index)
        return piece

    def miss(self, absent: Absent) -> None:
        """Count a slice that does not come."""
        self._absent.append(absent)

    @property
    def empty(self) -> bool:
        """Whether no slice came yet."""
        return not self._pieces

    def gathered(self) -> Gathered:
        """Sum up.

        Raises
        ------
        TooFewPoints
            No point came.
        """
        corners = [kept.corners_mm for kept in self._pieces if kept.corners_mm is not None]
        if not corners:
            raise TooFewPoints(
                f"{len(self._pieces)} slices without a point in them: did the sensor see the part?"
            )
        box = Box(np.min(corners, axis=0)[0], np.max(corners, axis=0)[1])
        fan = _fan([kept.sample.frame for kept in self._pieces])
        first = self._pieces[0].sample.frame.axes[2]
        pieces = [kept.sample for kept in self._pieces]
        return Gathered(
            indices=tuple(kept.sample.index for kept in self._pieces),
            counts=np.array([kept.count for kept in self._pieces]),
            samples={kept.sample.index: kept.sample for kept in self._pieces},
            sample_mm=self._even.points,
            aside={reason: some.count for reason, some in self._aside.items()},
            aside_mm={reason: some.points for reason, some in self._aside.items()},
            box=box,
            axis=nearest_axis(first if fan is None else fan.frame.axes[2]),
            spacing=_spacing(pieces) if fan is None else _turned_spacing(pieces, fan, box),
            absent=tuple(self._absent),
            reasons=self._reasons,
            profiles=self._profiles,
        )

    def _check_order(self, piece: Slice) -> None:
        if not self._pieces:
            return
        before = self._pieces[-1].sample
        here_mm, there_mm = height_mm(piece.frame), height_mm(before.frame)
        first = self._pieces[0].sample
        turned = is_turned(piece.frame, before.frame) or is_turned(piece.frame, first.frame)
        # A slice without a point has no place of its own where the sheet is pitched.
        placed = len(piece.points_mm) > 0 and len(before.points_mm) > 0
        low = here_mm <= there_mm and placed and not turned
        if piece.index <= before.index or low:
            raise ValueError(
                f"slice {piece.index} at {here_mm:.4g} mm follows slice {before.index} at"
                f" {there_mm:.4g} mm: indices and heights along the normal must both increase"
            )

    def _outside(self, piece: Slice) -> BoolArray:
        points, crop = piece.points_mm, self._crop
        if crop is None:
            return np.zeros(len(points), np.bool_)
        return np.asarray(~((points >= crop.low_mm) & (points <= crop.high_mm)).all(axis=1))

    def _without(self, piece: Slice, reason: Aside, which: BoolArray) -> Slice:
        if not which.any():
            return piece
        self._aside[reason].add(piece.points_mm[which])
        kept_mm = piece.points_mm[~which]
        kept_mm.flags.writeable = False
        return _with_corners(replace(piece, points_mm=kept_mm, corners_mm=None))


def _with_corners(piece: Slice) -> Slice:
    """Note between which corners the points lie, for all who come after."""
    if piece.corners_mm is not None:
        return piece
    try:
        return replace(piece, corners_mm=corners_of(piece.points_mm))
    except ValueError as wrong:
        raise ValueError(f"slice {piece.index}: {wrong}") from wrong


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    sample: Slice
    count: int
    corners_mm: FloatArray | None


@dataclass(slots=True)
class _Remembered:
    """How many points were set aside, and the first of them."""

    count: int = 0
    chunks: list[FloatArray] = field(default_factory=list)

    def add(self, points_mm: FloatArray) -> None:
        room = _DRAWN_ASIDE - min(self.count, _DRAWN_ASIDE)
        if room:
            self.chunks.append(points_mm[:room].copy())
        self.count += len(points_mm)

    @property
    def points(self) -> FloatArray:
        return np.concatenate([np.empty((0, 3)), *self.chunks])


class EvenSample:
    """Points of a stream of unknown length, each as likely as any other, at most `most` of them.

    By chance, not every k-th: a stride could fall in step with the points of a profile, and then
    the sample would be of a few beams. The chance has a seed, so that a replay takes the same.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._share = 1.0
        self._chunks: list[FloatArray] = []
        self._held = 0

    def add(self, points_mm: FloatArray, *, seed: int) -> None:
        """Take some of the points (n, 3)."""
        lucky = np.random.default_rng(seed).random(len(points_mm)) < self._share
        self._chunks.append(points_mm[lucky])
        self._held += int(lucky.sum())
        while self._held > self._most:
            self._chunks = [np.concatenate(self._chunks)[::2].copy()]
            self._held = len(self._chunks[0])
            self._share /= 2.0

    @property
    def points(self) -> FloatArray:
        """The sample, (k, 3)."""
        return np.concatenate([np.empty((0, 3)), *self._chunks])


def find_strays(piece: Slice) -> BoolArray:
    """Which points of a slice (n,) stand in small clusters apart from the others, or far away.

    The same rule as for a cloud, in the slice's plane: a cluster of less than 1 % of the largest
    one's points. A sheet of light along the table sees no plate.
    """
    none = np.zeros(len(piece.points_mm), np.bool_)
    if len(none) < _FEWEST:
        return none
    flat = piece.frame.to_plane(piece.points_mm)
    flat[:, 2] = 0.0
    try:
        keep = find_part(lambda: [flat], survey_cloud(lambda: [flat], Axis.Z), Axis.Z)
    except TooFewPoints:  # all in one place: the section will say so
        return none
    # Multiplied, as the boxes were counted: the flat slice lies on a border of boxes, and divided
    # it could round to the other side of it.
    cells = np.floor((flat - keep.corner_mm) * (1.0 / keep.edge_mm)).astype(np.int64)
    known = ((cells >= 0) & (cells < keep.boxes.shape)).all(axis=1)
    belongs = none.copy()
    belongs[known] = keep.boxes[tuple(cells[known].T)]
    return ~belongs if belongs.any() else none


def thinned(piece: Slice) -> Slice:
    """A slice with a few thousand of its points, chosen by a chance that its index decides."""
    count = len(piece.points_mm)
    if count <= _DRAWN_A_SLICE:
        return piece
    rng = np.random.default_rng(piece.index)
    chosen = np.sort(rng.choice(count, _DRAWN_A_SLICE, replace=False))
    return Slice(piece.index, piece.points_mm[chosen], piece.frame)


def coverage(piece: Slice) -> float:
    """Share of the degrees of a turn in which a slice has a point, seen from its plane's origin."""
    return share_of_turn(piece.frame.to_plane(piece.points_mm))


def height_mm(frame: Frame) -> float:
    """Height of a plane along its own normal."""
    return float(frame.origin_mm @ frame.axes[2])


def nearest_axis(direction: FloatArray) -> Axis:
    """The axis of the part frame that is nearest to a direction (3,)."""
    return list(Axis)[int(np.abs(direction).argmax())]


def _fan(frames: list[Frame]) -> Fan | None:
    try:
        return fan_of(frames)
    except NotLoftable:  # the surface will say so
        return None


def _turned_spacing(pieces: list[Slice], fan: Fan, box: Box) -> Spacing:
    """The way from meridian to meridian where the part is farthest from their axis."""
    angles = np.unwrap([fan.angle_of(piece.frame) for piece in pieces])
    steps = np.abs(np.diff(angles) / np.diff([piece.index for piece in pieces]))
    across = np.delete(np.arange(3), int(np.abs(fan.frame.axes[2]).argmax()))
    arms = np.stack([box.low_mm, box.high_mm])[:, across] - fan.frame.origin_mm[across]
    far_mm = float(np.abs(arms).max())
    step = float(np.median(steps)) if len(steps) else 0.0
    return Spacing(step * far_mm, float(angles[0]) * far_mm, SpacingRule.ROWS)


def _spacing(pieces: list[Slice]) -> Spacing:
    heights = np.array([height_mm(piece.frame) for piece in pieces])
    steps = np.diff(heights) / np.diff([piece.index for piece in pieces])
    step = float(np.median(steps)) if len(steps) else 0.0
    return Spacing(step, float(heights[0]), SpacingRule.ROWS)
