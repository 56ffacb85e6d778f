"""What can go wrong in reconstruction.

    ReconstructionError            root: the work failed; the message says what and what to do
    ├── TooFewPoints               a section, a slice or a whole cloud has not enough points
    ├── Unfittable                 points that no curve can be laid through
    ├── NotLoftable                sections that cannot be joined to one surface
    ├── UnreadableCloud(OSError)   the input file is missing, damaged or of no known format
    ├── NotRegistered              two views that cannot be laid onto each other, or in many ways
    ├── CleanupFailed              the mesh child died, ran out of time or memory, broke a promise
    └── MissingExtra(ImportError)  an optional library, or a system library, is not installed

Wrong arguments of a caller stay ``ValueError``: the split is by who is at fault.
"""

from __future__ import annotations


class ReconstructionError(Exception):
    """Root of what this package raises on purpose."""


class TooFewPoints(ReconstructionError):  # noqa: N818 (the house names errors after the fact)
    """Not enough points, for example a section of 3 points, or slices that are all empty."""


class Unfittable(ReconstructionError):  # noqa: N818
    """Points in which no curve is to be found, for example NaN, or a heap without an order."""


class NotLoftable(ReconstructionError):  # noqa: N818
    """Sections that cannot be joined, for example a single one; `indices` names them."""

    def __init__(self, message: str, *, indices: tuple[int, ...] = ()) -> None:
        super().__init__(message)
        self.indices = indices


class NotRegistered(ReconstructionError):  # noqa: N818
    """Two views that share too little, or whose shape leaves open how one lies to the other."""


class UnreadableCloud(ReconstructionError, OSError):  # noqa: N818
    """A cloud file that is missing, empty, truncated, not numeric, or of an unknown format."""


class CleanupFailed(ReconstructionError):  # noqa: N818
    """The mesh cleanup did not keep what it promises, or its process died."""


class MissingExtra(ReconstructionError, ImportError):  # noqa: N818
    """An optional package or a system library is missing; the message has the command."""
