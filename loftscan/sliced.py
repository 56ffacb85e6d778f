"""What every result can say of its slices, whether a cloud was cut or a scan delivered them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.reduction import Box
from reconstruction.setting_aside import Aside
from reconstruction.slices import Slice
from reconstruction.survey import Axis, Spacing


class Counted(Protocol):
    """How many points an input had."""

    @property
    def points(self) -> int:
        """Finite, measured points."""
        ...

    @property
    def invalid(self) -> int:
        """Places that held none."""
        ...


class Sliced(Protocol):
    """What became of every point before it was in a section: a `Cutting`, or `Gathered`."""

    @property
    def axis(self) -> Axis:
        """The stacking axis."""
        ...

    @property
    def spacing(self) -> Spacing:
        """Distance between slices."""
        ...

    @property
    def counts(self) -> IntArray:
        """Points of each slice, (slices,)."""
        ...

    @property
    def aside(self) -> Mapping[Aside, int]:
        """How many points were set aside, by reason."""
        ...

    @property
    def aside_mm(self) -> Mapping[Aside, FloatArray]:
        """Some of them, to be drawn."""
        ...

    @property
    def box(self) -> Box:
        """Of what was kept."""
        ...

    def slice_at(self, index: int) -> Slice:
        """One slice by its index, thinned perhaps, to be drawn."""
        ...
