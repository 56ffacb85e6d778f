"""The station: what moves when, where the sensor stands, and what is kept.

Imports the drivers' values and numpy, nothing of reconstruction and no scipy: the process that
owns the laser stays small. `acquisition.scan.scan` yields slices; a `ScanWriter` keeps them in a
.scan folder, which others follow.
"""

from acquisition.errors import (
    AcquisitionError,
    AlreadyKept,
    DamagedSlice,
    NotAScan,
    ScanInUse,
    StorageFailed,
)
from acquisition.frames import Kinematics, part_points, ring_plane
from acquisition.lease import Lease, lasing
from acquisition.opening import OpenStation, open_station
from acquisition.plan import Plan, Target, check_plan, estimate, read_plan, ring, targets
from acquisition.poses import Pose, Sweep
from acquisition.scan_record import ScanRecord, State
from acquisition.scanfile import ScanFolder, ScanWriter, Verification
from acquisition.station import Station, read_station, write_station

__all__ = [
    "AcquisitionError",
    "AlreadyKept",
    "DamagedSlice",
    "Kinematics",
    "Lease",
    "NotAScan",
    "OpenStation",
    "Plan",
    "Pose",
    "ScanFolder",
    "ScanInUse",
    "ScanRecord",
    "ScanWriter",
    "State",
    "Station",
    "StorageFailed",
    "Sweep",
    "Target",
    "Verification",
    "check_plan",
    "estimate",
    "lasing",
    "open_station",
    "part_points",
    "read_plan",
    "read_station",
    "ring",
    "ring_plane",
    "targets",
    "write_station",
]
