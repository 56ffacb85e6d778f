"""How far each device family was checked; docs/protocols/README.md says it at length."""

from __future__ import annotations

from enum import Enum


class Tier(Enum):
    """What was on the other end, best first."""

    HARDWARE = "verified on hardware"
    THIRD_PARTY_CODE = "against vendor or third-party code"
    MANUAL_FRAMES = "against frames of the manual"
    INFERRED = "inferred"


_MEMBERS = {"registers": "register_profiler", "banner_ez_array": "register_profiler"}

# By the folder of drivers/: a family has the tier of what a scan stands on.
TIERS = {
    "grbl": Tier.THIRD_PARTY_CODE,
    "leadshine": Tier.MANUAL_FRAMES,
    "oriental": Tier.MANUAL_FRAMES,
    "zaber": Tier.THIRD_PARTY_CODE,
    "baumer_ox": Tier.MANUAL_FRAMES,
    "riftek": Tier.THIRD_PARTY_CODE,
    "register_profiler": Tier.INFERRED,
    "hokuyo": Tier.MANUAL_FRAMES,
    "sick": Tier.INFERRED,
    "relay": Tier.INFERRED,
}


def tier_of(family: str) -> Tier:
    """Tier of a family as station.toml names it."""
    return TIERS[_MEMBERS.get(family, family)]


def tier_of_switch(switch: str) -> Tier:
    """Tier of a laser switch; a Grbl board's output was tried on our own board only."""
    return Tier.INFERRED if switch == "grbl" else tier_of(switch)
