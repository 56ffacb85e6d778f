"""HDF5 in the NeXus way (manual.nexusformat.org): the whole scan, not its points alone.

::

    /entry                     NXentry       title, start_time, program_name, provenance
      instrument/profiler      NXdetector    the sensor's own counts, reasons, times, per profile
        transformations        sheet -> stage -> origin -> .     from the laser plane to the station
      sample                   NXsample
        transformations        table -> .                        from the part to the station
      points                   NXdata        measured points in the part frame, and in_plane

A point ``(u, 0, v)`` of `in_plane`, of profile k, stands in the part at
``table(k)^-1 . origin . stage(k) . sheet . (u, 0, v)``. The steps are found from what
`acquisition.frames` does, so that whatever a calibration corrects is in them; what is no rigid
motion (the sensor's scales) is in `in_plane` already.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from acquisition.frames import Kinematics, sensor_to_station, station_to_part
from loftscan.scan_exports.measured import MeasuredScan, MeasuredSlice, library
from reconstruction.arrays import FloatArray

_PROFILE_FIELDS = {
    "slice": ("i4", None), "frame": ("i8", None), "encoder": ("i8", None),
    "sensor_time": ("f8", "s"), "time": ("f8", "s"), "lengths": ("i4", None),
    "scale": ("f8", "mm"), "offset": ("f8", "mm"),
}  # fmt: skip
_PLACE_FIELDS = {"counts": "i4", "reasons": "u1"}
_POINT_FIELDS = {
    "points": ("f8", "mm"), "in_plane": ("f8", "mm"),
    "profile": ("i8", None), "intensity": ("u2", None),
}  # fmt: skip
_WIDTHS = {"points": 3, "in_plane": 2, "counts": 2, "scale": 2, "offset": 2}


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The rigid steps between the laser plane, the station and the part."""

    in_plane: FloatArray  # (2, 2): counts' mm (x, z) @ this -> orthonormal (u, v)
    sheet: FloatArray  # (3, 3): columns are u, the normal, v in the station
    origin_mm: FloatArray  # (3,): of the sensor's x = z = 0, stage at 0
    stage: FloatArray  # (3,): step for a reported mm
    turn: float  # radians of the part, counter-clockwise, for a reported one


def chain_of(kinematics: Kinematics) -> Chain:
    """Find the steps by asking where four points go."""
    asked = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    origin, *ends = sensor_to_station(asked, np.array([0.0, 0.0, 0.0, 1.0]), kinematics)
    along_x, along_z, stage = (end - origin for end in ends)
    v = along_z / np.linalg.norm(along_z)
    u = along_x - (along_x @ v) * v
    u /= np.linalg.norm(u)
    in_plane = np.array([[along_x @ u, along_x @ v], [along_z @ u, along_z @ v]])
    asked_rad = 0.1
    (turned,) = station_to_part(np.array([[1.0, 0.0, 0.0]]), np.array([asked_rad]), kinematics)
    turn = -math.atan2(turned[1], turned[0]) / asked_rad
    sheet = np.column_stack([u, np.cross(v, u), v])
    return Chain(in_plane, sheet, origin, stage, turn)


def axis_angle(rotation: FloatArray) -> tuple[FloatArray, float]:
    """Axis (3,) and angle in radians of a rotation matrix (3, 3); its sense the right hand's."""
    _, _, rows = np.linalg.svd(rotation - np.eye(3))
    axis = rows[2]  # what the rotation leaves where it is
    side = np.cross(axis, rows[0])  # rows[0] and this span the plane that turns
    angle = math.atan2(side @ rotation @ rows[0], rows[0] @ rotation @ rows[0])
    return axis, angle


def write(file: BinaryIO, scan: MeasuredScan) -> int:
    """Write a NeXus file; give the number of points."""
    h5py = library("h5py", ".nxs")
    chain = chain_of(scan.record.calibration)
    with h5py.File(file.name, "w") as root:
        root.attrs["NX_class"], root.attrs["default"] = "NXroot", "entry"
        entry = _entry(root, scan)
        columns = _columns(entry, scan.record.station.name, scan.name)
        points = profiles = 0
        for piece in scan:
            _append(columns, piece, chain, profiles)
            profiles += len(piece.sweep.profiles)
            points += len(piece.points_mm)
        _place(entry, chain)
    return points


def _entry(root: Any, scan: MeasuredScan) -> Any:
    entry = _group(root, "entry", "NXentry")
    entry.attrs["default"] = "points"
    entry["title"], entry["start_time"] = scan.name, scan.record.created
    entry["program_name"] = "loftscan"
    about = scan.provenance("mm")
    entry["program_name"].attrs["version"] = str(about["version"])
    note = _group(entry, "provenance", "NXnote")
    note["type"], note["data"] = "application/json", json.dumps(about)
    note["description"] = f"unit mm; frame {scan.frame}"
    return entry


def _columns(entry: Any, station: str, part: str) -> dict[str, Any]:
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = station
    profiler = _group(instrument, "profiler", "NXdetector")
    sample, points = _group(entry, "sample", "NXsample"), _group(entry, "points", "NXdata")
    sample["name"] = part
    points.attrs["signal"] = "points"
    made = {
        "table": _growing(_group(sample, "transformations", "NXtransformations"), "table", "f8"),
        "stage": _growing(_group(profiler, "transformations", "NXtransformations"), "stage", "f8"),
    }
    for name, (kind, unit) in _PROFILE_FIELDS.items():
        made[name] = _growing(profiler, name, kind, unit)
    for name, kind in _PLACE_FIELDS.items():
        made[name] = _growing(profiler, name, kind)
    made["bright"] = _growing(profiler, "intensity", "u2")
    for name, (kind, unit) in _POINT_FIELDS.items():
        made[name] = _growing(points, name, kind, unit)
    return made


def _append(columns: Mapping[str, Any], piece: MeasuredSlice, chain: Chain, before: int) -> None:
    profiles, poses = piece.sweep.profiles, piece.sweep.poses
    flat_mm = np.concatenate([np.empty((0, 2)), *(each.points_mm for each in profiles)])
    new: dict[str, Any] = {
        "table": [chain.turn * each.table_rad for each in poses],
        "stage": [float(np.linalg.norm(chain.stage)) * each.stage_mm for each in poses],
        "slice": [piece.sweep.index] * len(poses),
        "frame": [each.frame for each in profiles],
        "encoder": [each.encoder for each in profiles],
        "sensor_time": [each.sensor_time_s for each in profiles],
        "time": [each.time_s for each in poses],
        "lengths": [len(each.reasons) for each in profiles],
        "scale": np.array([each.scale_mm for each in profiles]).reshape(-1, 2),
        "offset": np.array([each.offset_mm for each in profiles]).reshape(-1, 2),
        "counts": np.concatenate([np.empty((0, 2), "i4"), *(each.counts for each in profiles)]),
        "reasons": np.concatenate([np.empty(0, "u1"), *(each.reasons for each in profiles)]),
        "bright": np.concatenate([np.empty(0, "u2"), *(each.intensity for each in profiles)]),
        "points": piece.points_mm,
        "in_plane": flat_mm @ chain.in_plane,
        "profile": before + piece.profile.astype("i8"),
        "intensity": piece.intensity,
    }
    for name, values in new.items():
        column = columns[name]
        start = len(column)
        column.resize(start + len(values), axis=0)
        column[start:] = values


def _place(entry: Any, chain: Chain) -> None:
    """Say how the steps depend on each other, and their vectors."""
    length = float(np.linalg.norm(chain.stage))
    steps = entry["instrument/profiler/transformations"]
    axis, angle = axis_angle(chain.sheet)
    distance = float(np.linalg.norm(chain.origin_mm))
    steps["sheet"], steps["origin"] = angle, distance
    _step(steps["sheet"], "rotation", axis, "rad", "stage")
    _step(steps["stage"], "translation", chain.stage / length, "mm", "origin")
    direction = chain.origin_mm / distance if distance else np.array([1.0, 0.0, 0.0])
    _step(steps["origin"], "translation", direction, "mm", ".")
    entry["instrument/profiler/depends_on"] = "transformations/sheet"
    table = entry["sample/transformations/table"]
    _step(table, "rotation", np.array([0.0, 0.0, 1.0]), "rad", ".")
    entry["sample/depends_on"] = "transformations/table"


def _step(field: Any, kind: str, vector: FloatArray, units: str, before: str) -> None:
    said = {"transformation_type": kind, "vector": vector, "units": units, "depends_on": before}
    field.attrs.update(said)


def _group(parent: Any, name: str, kind: str) -> Any:
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    return group


def _growing(parent: Any, name: str, kind: str, unit: str | None = None) -> Any:
    width = _WIDTHS.get(name)
    tail = () if width is None else (width,)
    field = parent.create_dataset(
        name, (0, *tail), kind, maxshape=(None, *tail), chunks=(16_384, *tail),
        compression="gzip", compression_opts=1, shuffle=True, fletcher32=True,
    )  # fmt: skip
    if unit is not None:
        field.attrs["units"] = unit
    return field
