"""How far each device family was checked; docs/protocols/README.md says it at length."""

from __future__ import annotations

from enum import Enum


class Tier(Enum):
    """What was on the other end, best first."""

    HARDWARE = "verified on hardware"
    THIRD_PARTY_CODE = "against vendor or third-party code"
    MANUAL_FRAMES = "against frames of the manual"
    INFERRED = "inferred"


# By the folder of drivers/: a family has the tier of what a scan stands on.
TIERS = {
    "grbl": Tier.THIRD_PARTY_CODE,
    "leadshine": Tier.MANUAL_FRAMES,
    "oriental": Tier.MANUAL_FRAMES,
    "zaber": Tier.THIRD_PARTY_CODE,
    "baumer_ox": Tier.MANUAL_FRAMES,
    "hokuyo": Tier.MANUAL_FRAMES,
    "sick": Tier.INFERRED,
    "relay": Tier.INFERRED,
}
