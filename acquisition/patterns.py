r"""Where the slices of a plan lie that are not rings: meridians about the table's axis, stripes.

::

    meridian    \ | /  seen from above: the sheet stands upright through the axis; the table turns
                - o -  from slice to slice, and within one the stage may come to some places, so
                / | \  that a part higher than the sheet is wide is seen whole

    stripe     | | | |  the stage carries the sheet along the part, or the part through the sheet;
               | | | |  the table stands
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from acquisition.settings import Key

GRID_SLACK = 1e-6  # of a step: 0.1 + 0.1 + 0.1 still reaches 0.3
MOST_SLICES = 1_000_000
_MOST_POSITIONS = 1000  # of the stage in one meridian: a slice is kept whole


class SliceKind(Enum):
    """What a slice is a section of."""

    RING = "ring"  # closed, at one height
    MERIDIAN = "meridian"  # open, in a half plane at the table's axis
    STRIPE = "stripe"  # open, beside others


@dataclass(frozen=True, slots=True)
class Reach:
    """How far the axes go; positions are the axes' own."""

    lowest_mm: float
    highest_mm: float
    lowest_deg: float
    highest_deg: float
    turned_deg: float  # the table's whole way, in all slices together
    lifted_mm: float  # the stage's


@dataclass(frozen=True, slots=True, kw_only=True)
class Meridian:
    """One profile a table angle, in each of one or more stage positions; the sheet is upright."""

    per_turn: Annotated[
        int, Key("meridians in a whole turn, evenly spaced", at_least=3, at_most=1e6)
    ]
    first_deg: Annotated[float, Key("table angle of the first one")] = 0.0
    last_deg: Annotated[
        float | None, Key("none is beyond it; absent: once around, without the first again")
    ] = None
    first_mm: Annotated[float, Key("stage position")]
    last_mm: Annotated[
        float | None, Key("more stage positions up to here; absent: first_mm is the only one")
    ] = None
    step_mm: Annotated[float | None, Key("from stage position to stage position", above=0.0)] = None

    def __post_init__(self) -> None:
        if self.last_deg is not None and not (0.0 <= self.last_deg - self.first_deg < 360.0):
            raise ValueError(
                f"last_deg: {self.last_deg} is not within a turn above first_deg {self.first_deg};"
                " leave it out for all the way round"
            )
        if (self.last_mm is None) != (self.step_mm is None):
            absent = "step_mm" if self.step_mm is None else "last_mm"
            raise ValueError(
                f"{absent}: is missing; more than one stage position needs last_mm and step_mm"
            )
        if self.last_mm is not None and self.step_mm is not None:
            must_climb(self.first_mm, self.last_mm, self.step_mm, _MOST_POSITIONS)

    @property
    def count(self) -> int:
        """How many meridians."""
        if self.last_deg is None:
            return self.per_turn
        return math.floor((self.last_deg - self.first_deg) / self._step_deg + GRID_SLACK) + 1

    @property
    def stops(self) -> int:
        """Profiles of a slice, one a stop."""
        return len(self.positions_mm)

    @property
    def positions_mm(self) -> tuple[float, ...]:
        """Where the stage stands, upward, in each meridian."""
        if self.last_mm is None or self.step_mm is None:
            return (self.first_mm,)
        count = steps_in(self.first_mm, self.last_mm, self.step_mm)
        return tuple(self.first_mm + number * self.step_mm for number in range(count))

    def angle_deg(self, index: int) -> float:
        """Where the table stands in a meridian."""
        return self.first_deg + index * self._step_deg

    @property
    def reach(self) -> Reach:
        """The table goes round once, and back at the end."""
        low_mm, high_mm = self.positions_mm[0], self.positions_mm[-1]
        last_deg = self.angle_deg(self.count - 1)
        turned_deg = abs(self.first_deg) + last_deg - self.first_deg + abs(last_deg)
        lifted_mm = (2 * self.count - 1) * (high_mm - low_mm)
        return Reach(low_mm, high_mm, self.first_deg, last_deg, turned_deg, lifted_mm)

    @property
    def _step_deg(self) -> float:
        return 360.0 / self.per_turn


@dataclass(frozen=True, slots=True, kw_only=True)
class Stripe:
    """Open sections side by side: one stop of the stage each, and the table stands."""

    first_mm: Annotated[float, Key("stage position of the first stripe")]
    last_mm: Annotated[
        float, Key("no stripe is above; the last one is there when the steps reach it")
    ]
    step_mm: Annotated[float, Key("from stripe to stripe", above=0.0)]
    table_deg: Annotated[float, Key("where the table stands meanwhile")] = 0.0

    def __post_init__(self) -> None:
        must_climb(self.first_mm, self.last_mm, self.step_mm, MOST_SLICES)

    @property
    def count(self) -> int:
        """How many stripes."""
        return steps_in(self.first_mm, self.last_mm, self.step_mm)

    @property
    def stops(self) -> int:
        """Profiles of a slice, one a stop."""
        return 1

    @property
    def reach(self) -> Reach:
        """The stage goes up once."""
        top_mm = self.first_mm + (self.count - 1) * self.step_mm
        turned_deg, lifted_mm = abs(self.table_deg), top_mm - self.first_mm
        return Reach(self.first_mm, top_mm, self.table_deg, self.table_deg, turned_deg, lifted_mm)


def steps_in(first_mm: float, last_mm: float, step_mm: float) -> int:
    """How many positions from first to last, both of them counted."""
    return math.floor((last_mm - first_mm) / step_mm + GRID_SLACK) + 1


def must_climb(first_mm: float, last_mm: float, step_mm: float, most: int) -> None:
    """Refuse positions that fall, or are too many.

    Raises
    ------
    ValueError
        Begins with the key.
    """
    if last_mm < first_mm:
        raise ValueError(f"last_mm: {last_mm} is below first_mm {first_mm}; swap them")
    if not (last_mm - first_mm) / step_mm < most:
        raise ValueError(f"step_mm: {step_mm} makes over {most} positions; widen it")
