"""Moves, as the parser asks for them and as the planner queues them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Pace(Enum):
    """What sets a move's speed."""

    RAPID = "the axis, G0"
    FEED = "its feed rate, G1"
    JOG = "its feed rate, and no override"


@dataclass(frozen=True, slots=True)
class Motion:
    """Where to, in machine coordinates."""

    target_deg: float
    feed_deg_min: float
    pace: Pace


@dataclass(frozen=True, slots=True)
class Move:
    """One block of the planner."""

    target: int  # the count at its end
    feed_deg_min: float
    pace: Pace
