"""What can go wrong between the station's plan and the .scan folder.

    AcquisitionError              root of what this package raises on purpose
    ├── NotAScan(OSError)         no .scan folder there, or a scan.json that cannot be read
    ├── ScanInUse(OSError)        another program is appending to the folder; says which
    ├── StorageFailed(OSError)    the disk is full, read-only or broken; what was kept stays kept
    ├── DamagedSlice(OSError)     a slice file is not what was written; it is never deleted
    ├── AlreadyKept               the slice is in the folder: nothing is taken twice
    ├── Stopped                   the operator stopped amid a slice
    ├── NotNow                    the station's state does not allow it; nothing was begun
    ├── InputTripped              emergency stop, interlock or key: a person leads out of it
    ├── GuardLost                 the process that would turn the laser off is gone: nothing is lit
    ├── NotAsKept                 a slice taken again is not the kept one: another part, a lost axis
    ├── ZeroLost                  only a person can find the table's angle again
    └── LeaseLapsed               the laser was on and nobody renewed: it is off again

Files that a person wrote (station.toml, plan.toml) and wrong arguments are ``ValueError``.
"""

from __future__ import annotations


class AcquisitionError(Exception):
    """Root of what this package raises on purpose."""


class NotAScan(AcquisitionError, OSError):  # noqa: N818 (the house names errors after the fact)
    """The folder is missing, is no .scan folder, or its scan.json cannot be read."""


class ScanInUse(AcquisitionError, OSError):  # noqa: N818
    """Another program holds the folder's lock."""


class StorageFailed(AcquisitionError, OSError):  # noqa: N818
    """The disk did not take it; every slice that was acknowledged before is still there."""


class DamagedSlice(AcquisitionError, OSError):  # noqa: N818
    """A slice file that does not hold what was written."""


class AlreadyKept(AcquisitionError):  # noqa: N818
    """A slice of this index is in the folder and stays as it is."""


class Stopped(AcquisitionError):  # noqa: N818
    """The operator stopped amid a slice; it is not kept, those before it are."""


class ZeroLost(AcquisitionError):  # noqa: N818
    """The angles of the slices that are kept cannot be found again without a person."""


class NotAsKept(AcquisitionError):  # noqa: N818
    """A kept slice was taken again and differs: another part, or an axis lost its place."""


class NotNow(AcquisitionError):  # noqa: N818
    """The station's state does not allow it; nothing was begun."""


class InputTripped(AcquisitionError):  # noqa: N818
    """The hardware's safety chain is open; `event` names what of it."""

    def __init__(self, message: str, event: str) -> None:
        super().__init__(message)
        self.event = event


class GuardLost(AcquisitionError):  # noqa: N818
    """The guard did not start, or is gone: without it nothing is lit."""


class LeaseLapsed(AcquisitionError):  # noqa: N818
    """Nobody renewed in time while the laser was on; it is off again."""
