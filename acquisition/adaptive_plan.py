"""What plan.toml says of a scan that chooses its slices on the way.

::

    stage_mm   the rings of [ring] are a grid of places: step_mm is the least way between two slices
       |   o   of coarse_step_mm, lowest first, before anything is known
       |   x   where reconstruction asks for one; each on the grid
       +---
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from acquisition.settings import Key

_GRID_SLACK = 1e-6  # of a step


@dataclass(frozen=True, slots=True, kw_only=True)
class Adaptive:
    """Slices where reconstruction says that they are worth most."""

    tolerance_mm: Annotated[
        float, Key("the surface between slices is to be foretold within this", above=0.0)
    ]
    coarse_step_mm: Annotated[
        float, Key("between the slices that are taken first, lowest first", above=0.0)
    ]
    most_slices: Annotated[int, Key("no more are taken, all in all", at_least=2)]
    most_s: Annotated[float | None, Key("no slice is begun later in a run", above=0.0)] = None
    answer_within_s: Annotated[
        float,
        Key("then a scan goes on without reconstruction's answer", at_least=0.0, at_most=3600.0),
    ] = 10.0

    def coarse(self, count: int, step_mm: float) -> tuple[int, ...]:
        """Which of so many places on the grid are taken first: the first and the last among them.

        Raises
        ------
        ValueError
            The plan contradicts itself; one line, which begins with the key.
        """
        if self.coarse_step_mm < step_mm * (1.0 - _GRID_SLACK):
            raise ValueError(
                f"coarse_step_mm: {self.coarse_step_mm:g} is less than ring.step_mm {step_mm:g},"
                " the least way between two slices; widen it"
            )
        each = math.floor(self.coarse_step_mm / step_mm + _GRID_SLACK)
        last = count - 1
        spans = max(1, -(-last // each))
        if spans + 1 > self.most_slices:
            raise ValueError(
                f"most_slices: {self.most_slices} do not even make the {spans + 1} of"
                " coarse_step_mm; raise it, or widen coarse_step_mm"
            )
        return tuple(sorted({round(last * k / spans) for k in range(spans + 1)}))
