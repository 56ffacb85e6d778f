"""Where slices come from one by one: sweeps of a scan under way, or slices that a script made.

::

    Sweep --- kinematics ---> Slice      each in its own plane (ring, meridian or stripe), and index

A .scan folder is a source as well: `loftscan.following`.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from acquisition.frames import Kinematics, part_points
from acquisition.patterns import SliceKind
from acquisition.planes import slice_plane
from acquisition.poses import Sweep
from acquisition.scan_record import calibration_hash
from drivers.profiler import Reason
from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.reduction import bounding_box
from reconstruction.skinning.layout import Layout
from reconstruction.slices import Frame, Slice

T = TypeVar("T")

_LAYOUTS = {SliceKind.MERIDIAN: Layout.MERIDIANS, SliceKind.STRIPE: Layout.STRIPES}


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A slice, and what is known of how it came."""

    piece: Slice
    reasons: IntArray  # (6,) places of its profiles by `Reason`; zeros where nobody counted
    profiles: int = 0
    appeared_s: float | None = None  # wall time when its file was there, if it was waited for

    def __post_init__(self) -> None:
        object.__setattr__(self, "reasons", frozen(self.reasons, np.int64))


@dataclass(frozen=True, slots=True)
class Absent:
    """A slice of the plan that does not come."""

    index: int
    damage: str | None = None  # what is wrong with its file; None: there is no file


Piece = Arrival | Absent


class Source(Protocol):
    """Slices in order, and what is to be told of where they came from."""

    @property
    def name(self) -> str:
        """What it is called in reports."""
        ...

    @property
    def total(self) -> int | None:
        """How many pieces there will be, if that is known."""
        ...

    def pieces(self) -> Generator[Piece]:
        """The slices, lowest index first; closing this ends what delivers them."""
        ...

    def layout(self) -> Layout:
        """How the slices lie, as who took them says; asked for after the first of them."""
        ...

    def origin(self) -> Mapping[str, object]:
        """What provenance.json says of it; asked for at the end."""
        ...

    def remarks(self) -> tuple[str, ...]:
        """What a person should know of its end; asked for at the end."""
        ...


@runtime_checkable
class Sweeps(Protocol):
    """Sweeps with their calibration, as the verb `scan` gives them."""

    @property
    def kinematics(self) -> Kinematics:
        """How axes and sensor stand."""
        ...

    @property
    def total(self) -> int | None:
        """How many sweeps there will be, if that is known."""
        ...

    def __iter__(self) -> Iterator[Sweep]: ...


def given_sweeps(source: Sweeps) -> GivenSweeps:
    """Sweeps as a source; they are rings where they do not say otherwise by a `kind`."""
    kind: SliceKind = getattr(source, "kind", SliceKind.RING)
    return GivenSweeps(source, source.kinematics, source.total, kind=kind)


def layout_of_kind(kind: SliceKind) -> Layout:
    """How slices lie that a plan had taken; rings of a part seen from one side are stripes."""
    return _LAYOUTS.get(kind, Layout.AUTO)


def kind_of_layout(layout: Layout) -> SliceKind:
    """What sweeps are that somebody gives without their plan."""
    return next((kind for kind, each in _LAYOUTS.items() if each is layout), SliceKind.RING)


def slice_of(sweep: Sweep, kinematics: Kinematics, kind: SliceKind = SliceKind.RING) -> Slice:
    """Lay a sweep into the part frame, at its own read-back place.

    Raises
    ------
    ValueError
        A sweep without a profile has no place.
    """
    origin_mm, axes = slice_plane(sweep, kinematics, kind)
    points_mm = part_points(sweep, kinematics)
    points_mm.flags.writeable = False
    return Slice(sweep.index, points_mm, Frame(origin_mm, axes), corners_of(points_mm))


def corners_of(points_mm: FloatArray) -> FloatArray | None:
    """Lowest and highest coordinates (2, 3) of points (n, 3); None for none."""
    if not len(points_mm):
        return None
    box = bounding_box(points_mm)
    return np.stack([box.low_mm, box.high_mm])


def arrival_of(sweep: Sweep, kinematics: Kinematics, kind: SliceKind = SliceKind.RING) -> Arrival:
    """A sweep's slice with what its profiles say of the places without a point."""
    reasons = np.zeros(len(Reason), np.int64)
    for profile in sweep.profiles:
        reasons += np.bincount(profile.reasons, minlength=len(Reason))
    return Arrival(slice_of(sweep, kinematics, kind), reasons, len(sweep.profiles))


@dataclass(frozen=True, slots=True, eq=False)
class GivenSweeps:
    """The sweeps of a scan under way, or of a list."""

    sweeps: Iterable[Sweep]
    kinematics: Kinematics
    total: int | None = None
    name: str = "scan"
    kind: SliceKind = SliceKind.RING

    def pieces(self) -> Generator[Piece]:
        """Each sweep as it is taken; the scan ends when this is closed."""
        with closing(_passing(self.sweeps)) as passing:
            for sweep in passing:
                yield arrival_of(sweep, self.kinematics, self.kind)

    def layout(self) -> Layout:
        """As their plan had them taken."""
        return layout_of_kind(self.kind)

    def origin(self) -> Mapping[str, object]:
        """Only the calibration can be told: nothing is on a disk."""
        return {
            "name": self.name,
            "format": "sweeps",
            "unit": "mm",
            "calibration_sha256": calibration_hash(self.kinematics),
        }

    def remarks(self) -> tuple[str, ...]:
        """Nothing: whoever gives the sweeps knows how they ended."""
        return ()


@dataclass(frozen=True, slots=True, eq=False)
class GivenSlices:
    """Slices that a script made."""

    slices: Iterable[Slice]
    total: int | None = None
    name: str = "slices"

    def pieces(self) -> Generator[Piece]:
        """Each slice as it comes."""
        with closing(_passing(self.slices)) as passing:
            for piece in passing:
                if not isinstance(piece, Slice):
                    raise TypeError(
                        f"{type(piece).__name__} among the slices: Slice expected; sweeps need"
                        " their kinematics"
                    )
                reasons = np.zeros(len(Reason), np.int64)
                reasons[Reason.MEASURED] = len(piece.points_mm)
                yield Arrival(piece, reasons)

    def layout(self) -> Layout:
        """Nobody said; their planes do."""
        return Layout.AUTO

    def origin(self) -> Mapping[str, object]:
        """Nothing but the kind of it is known."""
        return {"name": self.name, "format": "slices", "unit": "mm"}

    def remarks(self) -> tuple[str, ...]:
        """Nothing: whoever gives the slices knows how they ended."""
        return ()


def is_scan(source: object) -> bool:
    """Whether a path means a .scan folder, by its name or by what is in it."""
    if not isinstance(source, (str, Path)):
        return False
    path = Path(source)
    return path.suffix == ".scan" or (path / "scan.json").is_file()


def _passing(things: Iterable[T]) -> Generator[T]:
    """Pass things on, and close what they come from however this ends."""
    given = iter(things)
    try:
        yield from given
    finally:
        close = getattr(given, "close", None)
        if close is not None:
            close()
