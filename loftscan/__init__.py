"""Turn the slices of a scanning station into one watertight NURBS surface.

    >>> from loftscan import reconstruct
    >>> result = reconstruct("scan.pcd", axis="y", unit="cm")
    >>> result.save("out/")

The verbs are imported when they are first used, so that ``loftscan --help`` answers at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from loftscan.comparing import Comparison
    from loftscan.registering import Merged, register
    from loftscan.result import Result
    from loftscan.scanning import scan
    from loftscan.sectioning import fit_section
    from loftscan.simulation import simulate
    from loftscan.station import Station
    from loftscan.updates import Finished, Fitted, Missed
    from loftscan.verbs import compare, reconstruct, reconstruct_stream

__all__ = [
    "Comparison",
    "Finished",
    "Fitted",
    "Merged",
    "Missed",
    "Result",
    "Station",
    "compare",
    "fit_section",
    "reconstruct",
    "reconstruct_stream",
    "register",
    "scan",
    "simulate",
]

_HOMES = {
    "Comparison": "loftscan.comparing",
    "Finished": "loftscan.updates",
    "Fitted": "loftscan.updates",
    "Merged": "loftscan.registering",
    "Missed": "loftscan.updates",
    "Result": "loftscan.result",
    "Station": "loftscan.station",
    "compare": "loftscan.verbs",
    "fit_section": "loftscan.sectioning",
    "reconstruct": "loftscan.verbs",
    "reconstruct_stream": "loftscan.verbs",
    "register": "loftscan.registering",
    "scan": "loftscan.scanning",
    "simulate": "loftscan.simulation",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'loftscan' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
