"""scan.json: what was scanned, with which station, plan, calibration and program. Pure."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from acquisition.frames import Kinematics
from acquisition.plan import Plan
from acquisition.settings import as_table, read_table
from acquisition.station import Station

_FORMAT = "loftscan.scan"
_VERSION = 1
_FRAME = "part: origin on the table's axis at the plate, z up the axis, right-handed"
_KEYS = ("software", "created", "state", "station", "plan", "calibration")


class State(Enum):
    """How far a scan has come."""

    SCANNING = "scanning"  # or its program died: then it can be resumed
    COMPLETE = "complete"
    ABORTED = "aborted"  # stopped with slices missing; can be resumed


@dataclass(frozen=True, slots=True)
class ScanRecord:
    """Everything about a scan that is not a slice."""

    station: Station
    plan: Plan
    calibration: Kinematics  # in force when the scan was made
    software: str  # such as "loftscan 0.1.0"
    created: str  # ISO 8601, an argument like every time
    state: State = State.SCANNING
    calibrated_by: str = "station.toml"  # or the calibration's file
    calibration_file_sha256: str = ""
    override: str = ""  # the operator's words, where the calibration was refused and used

    @property
    def indices(self) -> range:
        """The indices of a complete scan."""
        return range(self.plan.count)


def calibration_hash(calibration: Kinematics) -> str:
    """SHA-256 of a calibration's canonical JSON, in hex."""
    return _hash(as_table(calibration))


def encode_record(record: ScanRecord) -> bytes:
    """Give the bytes of scan.json."""
    document: dict[str, object] = {
        "format": _FORMAT,
        "version": _VERSION,
        "unit": "mm",
        "frame": _FRAME,
        "software": record.software,
        "created": record.created,
        "state": record.state.value,
        "slices": len(record.indices),
        "calibration": {
            "sha256": calibration_hash(record.calibration),
            "values": as_table(record.calibration),
            "from": record.calibrated_by,
            "file_sha256": record.calibration_file_sha256,
            "override": record.override,
        },
        "plan": as_table(record.plan),
        "station": as_table(record.station),
    }
    document["sha256"] = _hash(document)
    return (json.dumps(document, indent=2, ensure_ascii=False) + "\n").encode()


def decode_record(data: bytes) -> ScanRecord:
    """Give back the record of a scan.json.

    Raises
    ------
    ValueError
        Not JSON, of another format or version, a key missing or wrong; it or its calibration does
        not have its hash. Older files have no hash of the whole.
    """
    try:
        document = json.loads(data)
    except ValueError as bad:
        raise ValueError(f"scan.json: no JSON: {bad}") from bad
    _check_head(document)
    kept: Mapping[str, Any] = document["calibration"]
    calibration = read_table(Kinematics, kept["values"], "scan.json", "calibration.values")
    if calibration_hash(calibration) != kept["sha256"]:
        raise ValueError("scan.json: calibration.values: do not have the hash beside them")
    record = ScanRecord(
        station=read_table(Station, document["station"], "scan.json", "station"),
        plan=read_table(Plan, document["plan"], "scan.json", "plan"),
        calibration=calibration,
        software=str(document["software"]),
        created=str(document["created"]),
        state=State(document["state"]),
        calibrated_by=str(kept.get("from", "station.toml")),  # absent from older scans
        calibration_file_sha256=str(kept.get("file_sha256", "")),
        override=str(kept.get("override", "")),
    )
    rest = {key: value for key, value in document.items() if key != "sha256"}
    if document.get("sha256", _hash(rest)) != _hash(rest):
        raise ValueError("scan.json: it does not have the sha256 that it was written with")
    return record


def _hash(table: Mapping[str, object]) -> str:
    """SHA-256 of a table's canonical JSON, in hex."""
    text = json.dumps(table, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _check_head(document: object) -> None:
    if not isinstance(document, Mapping) or document.get("format") != _FORMAT:
        raise ValueError(f'scan.json: format is not "{_FORMAT}"')
    if (document.get("version"), document.get("unit")) != (_VERSION, "mm"):
        raise ValueError(
            f"scan.json: version {document.get('version')!r} in {document.get('unit')!r};"
            f" this program knows version {_VERSION} in mm"
        )
    if document.get("state") not in [state.value for state in State]:
        raise ValueError(f"scan.json: state: {document.get('state')!r} is not known")
    missing = [key for key in _KEYS if key not in document]
    if missing:
        raise ValueError(f"scan.json: {missing[0]} is missing")
    tables = [document[key] for key in ("station", "plan", "calibration")]
    if not all(isinstance(table, Mapping) for table in tables):
        raise ValueError("scan.json: station, plan and calibration must be objects")
    kept = document["calibration"]
    if not isinstance(kept.get("values"), Mapping) or "sha256" not in kept:
        raise ValueError("scan.json: calibration needs values and sha256")
