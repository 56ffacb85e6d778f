"""A doubt about one slice, said with the quantity."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Doubt:
    """Something about one slice that the operator should look at."""

    slice_index: int
    what: str

    def __str__(self) -> str:
        return f"slice {self.slice_index}: {self.what}"
