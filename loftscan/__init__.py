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
    from loftscan.result import Result
    from loftscan.verbs import compare, reconstruct

__all__ = ["Comparison", "Result", "compare", "reconstruct"]

_HOMES = {
    "Comparison": "loftscan.comparing",
    "Result": "loftscan.result",
    "compare": "loftscan.verbs",
    "reconstruct": "loftscan.verbs",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'loftscan' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
