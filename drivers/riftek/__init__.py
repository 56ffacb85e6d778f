"""RIFTEK RF62X line profilers: profiles by UDP, settings and trigger over HTTP."""

from drivers.riftek.profiler import (
    EXPOSURES_US,
    RATES_HZ,
    Loss,
    Riftek,
    Settings,
    Sync,
    profile_of,
)
from drivers.riftek.web import WebApi

__all__ = [
    "EXPOSURES_US",
    "RATES_HZ",
    "Loss",
    "Riftek",
    "Settings",
    "Sync",
    "WebApi",
    "profile_of",
]
