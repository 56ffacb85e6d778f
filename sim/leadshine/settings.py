"""What a drive is installed with: the screw on its shaft, and the switches along its way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sim.leadshine.registers import Family


@dataclass(frozen=True, slots=True, kw_only=True)
class LeadshineSettings:
    """The drive and its surroundings, in the world's millimetres."""

    family: Family = Family.CS2RS
    pulses_per_turn: int = 10_000
    screw_lead_mm: float = 5.0
    travel_mm: tuple[float, float] = (-10.0, 400.0)  # where the limit switches and the stops are
    home_switch_mm: float = 0.0
    trigger_delay_s: float = 0.002  # of the firmware, so of wall time
    lag_s: float = 0.03  # of wall time, by which the shaft is behind the command
    stored: Mapping[int, int] = field(default_factory=dict)  # registers, as once saved

    def __post_init__(self) -> None:
        low_mm, high_mm = self.travel_mm
        if not low_mm <= self.home_switch_mm <= high_mm:
            raise ValueError(
                f"leadshine: a home switch at {self.home_switch_mm} mm; "
                f"it must be on the way, from {low_mm} to {high_mm} mm"
            )
        if self.screw_lead_mm <= 0.0:
            raise ValueError(f"leadshine: a screw lead of {self.screw_lead_mm} mm; it is above 0")
