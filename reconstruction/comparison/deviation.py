"""What a comparison says: a distance for every point, numbers, and a verdict with its rule.

A range means nothing without the number of points and the rule of what was left out: of Gaussian
noise, 1000 points span 6.5 sigma and a million 9.7. So both are part of every value here.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen


class Method(Enum):
    """How a distance was taken."""

    POINT_TO_TRIANGLE = "signed distance to the nearest triangle, positive outside"
    POINT_TO_POINT = "unsigned distance to the nearest point; above the distance to the surface"


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Numbers over the `count` points that were used; `set_aside` were farther than allowed."""

    count: int
    set_aside: int
    on_border: int  # of `count`: their sign is a guess
    mean_mm: float
    rms_mm: float
    std_mm: float
    median_mm: float
    absolute_95_mm: float  # 95 % of the points are not farther off than this
    min_mm: float
    max_mm: float
    histogram_edges_mm: FloatArray  # (bins + 1,)
    histogram_counts: IntArray  # (bins,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "histogram_edges_mm", frozen(self.histogram_edges_mm))
        object.__setattr__(self, "histogram_counts", frozen(self.histogram_counts, np.int64))


@dataclass(frozen=True, slots=True)
class Verdict:
    """In or out of tolerance, and by which rule."""

    within: bool
    tolerance_mm: float
    share_within: float  # of the points used
    required_share: float
    rule: str


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The rigid motion that was applied before comparing: x -> rotation x + translation."""

    transform: FloatArray  # (4, 4)
    rotation_rad: float
    translation_mm: float  # how far the centroid of the points moved
    iterations: int
    converged: bool
    held_freedoms: int  # of 6; fewer when the part can slide along itself, as a cylinder can
    rms_mm: float  # of the points that kept weight
    points: int  # used to find it

    def __post_init__(self) -> None:
        object.__setattr__(self, "transform", frozen(self.transform))


@dataclass(frozen=True, slots=True, eq=False)
class Deviation:
    """A distance for every point, in the order of the points."""

    method: Method
    distances_mm: FloatArray  # (n,)
    on_border: BoolArray  # (n,), nearest to an open border: the sign is undefined
    beyond: BoolArray  # (n,), farther than the largest distance asked for
    nearest: IntArray  # (n,), the nearest face, or the nearest point
    statistics: Statistics
    verdict: Verdict | None
    alignment: Alignment | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "distances_mm", frozen(self.distances_mm))
        object.__setattr__(self, "on_border", frozen(self.on_border, np.bool_))
        object.__setattr__(self, "beyond", frozen(self.beyond, np.bool_))
        object.__setattr__(self, "nearest", frozen(self.nearest, np.int64))


def statistics(
    distances_mm: FloatArray, on_border: BoolArray, beyond: BoolArray, *, bins: int = 64
) -> Statistics:
    """Summarise the distances (n,) that are not `beyond`; all nan when none is left."""
    used = distances_mm[~beyond]
    empty = len(used) == 0
    numbers = np.full(1, np.nan) if empty else used
    counts, edges = np.histogram(used, bins=bins)
    return Statistics(
        count=len(used),
        set_aside=int(beyond.sum()),
        on_border=int(np.sum(on_border & ~beyond)),
        mean_mm=float(numbers.mean()),
        rms_mm=float(np.sqrt(np.mean(numbers**2))),
        std_mm=float(numbers.std()),
        median_mm=float(np.median(numbers)),
        absolute_95_mm=float(np.quantile(np.abs(numbers), 0.95)),
        min_mm=float(numbers.min()),
        max_mm=float(numbers.max()),
        histogram_edges_mm=edges,
        histogram_counts=counts.astype(np.int64),
    )


def judge(
    distances_mm: FloatArray, beyond: BoolArray, *, tolerance_mm: float, required_share: float = 1.0
) -> Verdict:
    """Decide whether enough points lie within the tolerance.

    Parameters
    ----------
    tolerance_mm
        Largest allowed distance to either side.
    required_share
        How many of the points have to keep it, in (0, 1]; 1.0 is all.
    """
    if not tolerance_mm > 0:
        raise ValueError(f"the tolerance must be above 0 mm, got {tolerance_mm}")
    if not 0 < required_share <= 1:
        raise ValueError(f"the required share must be in (0, 1], got {required_share}")
    used = np.abs(distances_mm[~beyond])
    inside = int(np.sum(used <= tolerance_mm))
    which = "all" if required_share == 1.0 else f"at least {100 * required_share:g} % of"
    rule = f"{which} {len(used)} points within +-{tolerance_mm:g} mm"
    if np.any(beyond):
        rule += f"; {int(beyond.sum())} points farther off than asked for were set aside"
    within = len(used) > 0 and inside >= required_share * len(used)
    share = inside / len(used) if len(used) else float("nan")
    return Verdict(within, tolerance_mm, share, required_share, rule)
