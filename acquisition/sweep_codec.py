"""A sweep as the bytes of one slice file, and back: a zip of .npy columns. Pure.

The sensor's integers stay integers: x and z of all profiles end to end, as int16 where they fit,
else uint16 or int32, with the length of each profile beside them::

    profile   0        1     2             lengths       [4, 2, 5]
    x         x x x x  x x   x x x x x     x, z, reasons (sum of lengths,)

A slice of a table that turned has the columns of `acquisition.poses.Timing` after them.

Nothing is pickled, nothing compressed; the same sweep gives the same bytes (the zip's dates are
fixed). The zip's CRC covers every column, its comment is the SHA-256 of all bytes before it, and
counts are checked against each other: what decodes is what was written. Files of before there was
that comment decode still; `has_checksum` tells them.
"""

from __future__ import annotations

import hashlib
import io
import struct
import zipfile
import zlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from acquisition.poses import Pose, Sweep, Timing
from drivers.profiler import Profile

Columns = Mapping[str, NDArray[Any]]

_VERSION = 1
_TURNED_VERSION = 2  # has the columns of `Timing`: without them it is not whole
_HEAD = ("version", "index")
_EACH_PROFILE = {
    "lengths": "<i4",
    "intensity_lengths": "<i4",
    "sensor_time_s": "<f8",
    "encoder": "<i8",
    "frame": "<i8",
    "table_rad": "<f8",
    "stage_mm": "<f8",
    "time_s": "<f8",
}
_EACH_AXIS = ("scale_mm", "offset_mm")  # (profiles, 2) of x and z
_COUNTS = ("<i2", "<u2", "<i4")  # the first that holds them all
_TYPES = {
    **dict.fromkeys(_HEAD, ("<i8",)),
    **{name: (dtype,) for name, dtype in _EACH_PROFILE.items()},
    **dict.fromkeys(_EACH_AXIS, ("<f8",)),
    **dict.fromkeys(("x", "z"), _COUNTS),
    "reasons": ("|u1",),
    "intensity": ("<u2",),
}
COLUMNS = tuple(_TYPES)
# Of a table that turned, after those: names and types of `Timing`.
_TIMES = ("arrived_s", "asked_s", "asked_rad")
_TIMING = {
    **dict.fromkeys(
        (*_TIMES, "speed_rad_s", "latency_s", "latency_sd_s", "drift_ppm", "clock_late_s"), ("<f8",)
    ),
    **dict.fromkeys(("table_rms_rad", "apart_mm", "noise_mm"), ("<f8",)),
    "lost": ("<i8",),
}
TIMING_COLUMNS = tuple(_TIMING)
_CHECKSUM = b"sha256:"  # and 64 hexadecimal digits: the zip's comment, the last bytes of the file
_CHECKSUM_BYTES = len(_CHECKSUM) + 64
# The archive by hand, in one piece: `zipfile` copies all four times and takes twice as long.
_LOCAL, _CENTRAL = struct.Struct("<4s5H3L2H"), struct.Struct("<4s6H3L5H2L")
_END = struct.Struct("<4s4H2LH")
_VERSION_NEEDED, _MADE_BY, _DAY = 20, 0x0314, 0x21  # 2.0; by Unix; 1980-01-01
_MODE = 0o600 << 16  # of a file that is unpacked
_DIRECTORY_END = b"PK\x05\x06"  # 22 bytes before the end of a zip without a comment
BROKEN = (
    zipfile.BadZipFile,
    NotImplementedError,  # a flag of the zip says a method that we never write
    struct.error,
    EOFError,
    KeyError,
    OverflowError,
    TypeError,  # a damaged .npy header
)


def encode_sweep(sweep: Sweep) -> bytes:
    """Give the bytes of a slice file; equal sweeps give equal bytes."""
    parts: list[bytes | memoryview] = []
    directory: list[bytes] = []
    place = 0
    for name, column in _columns(sweep).items():
        file = f"{name}.npy".encode()
        head = _npy_head(column.dtype.str, column.shape)
        body = memoryview(np.ascontiguousarray(column).reshape(-1).view(np.uint8))  # type: ignore[arg-type]
        size, crc = len(head) + len(body), zlib.crc32(body, zlib.crc32(head))
        told = (_VERSION_NEEDED, 0, 0, 0, _DAY, crc, size, size, len(file), 0)
        parts += [_LOCAL.pack(b"PK\x03\x04", *told), file, head, body]
        directory += [_CENTRAL.pack(b"PK\x01\x02", _MADE_BY, *told, 0, 0, 0, _MODE, place), file]
        place += _LOCAL.size + len(file) + size
    length = sum(len(each) for each in directory)
    count = len(directory) // 2
    end = _END.pack(_DIRECTORY_END, 0, 0, count, count, length, place, _CHECKSUM_BYTES)
    return b"".join([*parts, *directory, end, _checksum(*parts, *directory, end)])


def has_checksum(data: bytes) -> bool:
    """Whether a slice file ends with its SHA-256; older ones do not."""
    return data[-_CHECKSUM_BYTES:].startswith(_CHECKSUM)


def decode_sweep(data: bytes) -> Sweep:
    """Give back the sweep of a slice file's bytes.

    Raises
    ------
    ValueError
        The bytes are not what was written: checksum, columns, counts or values are wrong.
    """
    try:
        columns = _unpacked(data)
    except BROKEN as broken:
        raise ValueError(f"damaged archive: {broken}") from broken
    except ValueError:
        _check_checksum(data)  # of damage and a strange column the damage is told
        raise
    _check_checksum(data)
    return sweep_of(columns)


def sweep_of(columns: Columns) -> Sweep:
    """Make a sweep of columns whose bytes are proven; raises as `decode_sweep`."""
    due = _TURNED_VERSION if "arrived_s" in columns else _VERSION
    if columns["version"].tolist() != due:
        raise ValueError(
            f"version {columns['version'].tolist()}, this program knows {due} of such columns"
        )
    _check_types(columns)
    _check_counts(columns)
    return Sweep(int(columns["index"]), _profiles(columns), _poses(columns), _timing(columns))


@lru_cache(maxsize=256)
def _npy_head(dtype: str, shape: tuple[int, ...]) -> bytes:
    head = io.BytesIO()
    npy.write_array_header_1_0(head, {"descr": dtype, "fortran_order": False, "shape": shape})
    return head.getvalue()


def _checksum(*parts: bytes | memoryview) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return _CHECKSUM + digest.hexdigest().encode()


def _check_checksum(data: bytes) -> None:
    if has_checksum(data):
        if _checksum(data[:-_CHECKSUM_BYTES]) != data[-_CHECKSUM_BYTES:]:
            raise ValueError("damaged archive: its bytes do not have the SHA-256 at its end")
    elif data[-22:-18] != _DIRECTORY_END or data[-2:] != bytes(2):  # its comment's length
        raise ValueError("damaged archive: it ends with neither a checksum nor the directory")


def _columns(sweep: Sweep) -> Columns:
    profiles, poses = sweep.profiles, sweep.poses
    counts = np.concatenate([np.empty((0, 2), np.int32), *(each.counts for each in profiles)])
    values: dict[str, Any] = {
        "version": np.array(_VERSION if sweep.timing is None else _TURNED_VERSION, "<i8"),
        "index": np.array(sweep.index, "<i8"),
        "lengths": [len(each.reasons) for each in profiles],
        "intensity_lengths": [len(each.intensity) for each in profiles],
        "sensor_time_s": [each.sensor_time_s for each in profiles],
        "encoder": [each.encoder for each in profiles],
        "frame": [each.frame for each in profiles],
        "table_rad": [each.table_rad for each in poses],
        "stage_mm": [each.stage_mm for each in poses],
        "time_s": [each.time_s for each in poses],
        "x": _narrowed(counts[:, 0]),
        "z": _narrowed(counts[:, 1]),
        "reasons": np.concatenate([np.empty(0, "u1"), *(each.reasons for each in profiles)]),
        "intensity": np.concatenate([np.empty(0, "<u2"), *(each.intensity for each in profiles)]),
    }
    typed = {name: np.array(values[name], dtype) for name, dtype in _EACH_PROFILE.items()}
    pairs = {
        name: np.array([getattr(each, name) for each in profiles], "<f8").reshape(-1, 2)
        for name in _EACH_AXIS
    }
    together = values | typed | pairs
    return {name: together[name] for name in COLUMNS} | dict(_timing_columns(sweep.timing))


def _timing_columns(timing: Timing | None) -> Columns:
    if timing is None:
        return {}
    return {name: np.array(getattr(timing, name), _TIMING[name][0]) for name in TIMING_COLUMNS}


def _narrowed(counts: NDArray[np.int32]) -> NDArray[Any]:
    low, high = (int(counts.min()), int(counts.max())) if counts.size else (0, 0)
    holds = (each for each in _COUNTS if np.iinfo(each).min <= low <= high <= np.iinfo(each).max)
    return counts.astype(next(holds))


def _unpacked(data: bytes) -> Columns:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        names = [each.filename.removesuffix(".npy") for each in members]
        if names not in ([*COLUMNS], [*COLUMNS, *TIMING_COLUMNS]):
            raise ValueError("the columns are not those of a slice")
        if any(each.compress_type != zipfile.ZIP_STORED or each.flag_bits & 1 for each in members):
            raise ValueError("damaged archive: a column is compressed or encrypted")
        if any(each.file_size > len(data) for each in members):
            raise ValueError("damaged archive: a column is longer than the file")
        return {name: column_of(archive.read(f"{name}.npy")) for name in names}


def column_of(data: bytes) -> NDArray[Any]:
    """View the proven bytes of one .npy as its array, read-only; raises as `decode_sweep`."""
    stream = io.BytesIO(data)
    if npy.read_magic(stream) != (1, 0):
        raise ValueError("a column is no .npy of version 1.0")
    shape, _, dtype = npy.read_array_header_1_0(stream)
    return np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape)


def _check_types(columns: Columns) -> None:
    for name in columns:
        allowed = (_TYPES | _TIMING)[name]
        if columns[name].dtype not in [np.dtype(each) for each in allowed]:
            raise ValueError(f"column {name} is of {columns[name].dtype}, not {allowed[0]}")


def _check_counts(columns: Columns) -> None:
    profiles = columns["lengths"].size
    points, bright = (int(columns[n].sum()) for n in ("lengths", "intensity_lengths"))
    promised: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(_HEAD, ()),
        **dict.fromkeys(_EACH_PROFILE, (profiles,)),
        **dict.fromkeys(_EACH_AXIS, (profiles, 2)),
        **dict.fromkeys(("x", "z", "reasons"), (points,)),
        "intensity": (bright,),
    }
    if "arrived_s" in columns:
        promised |= dict.fromkeys(TIMING_COLUMNS, ())
        asked = columns["asked_s"].size
        promised |= {"arrived_s": (profiles,), "asked_s": (asked,), "asked_rad": (asked,)}
    for name, shape in promised.items():
        if columns[name].shape != shape:
            raise ValueError(f"column {name} is {columns[name].shape}, the others promise {shape}")
    if min(columns["lengths"], default=0) < 0 or min(columns["intensity_lengths"], default=0) < 0:
        raise ValueError("a profile of negative length")


def _profiles(columns: Columns) -> tuple[Profile, ...]:
    counts = np.column_stack([columns["x"], columns["z"]]).astype(np.int32, order="C")
    counts.flags.writeable = False
    ends, bright_ends = (columns[n].cumsum() for n in ("lengths", "intensity_lengths"))
    scalars = {name: columns[name].tolist() for name in _EACH_PROFILE}
    scales, offsets = (columns[name].tolist() for name in _EACH_AXIS)
    return tuple(
        Profile(
            counts=counts[end - length : end],
            scale_mm=(scales[k][0], scales[k][1]),
            offset_mm=(offsets[k][0], offsets[k][1]),
            reasons=columns["reasons"][end - length : end],
            intensity=columns["intensity"][bright_end - bright : bright_end],
            sensor_time_s=scalars["sensor_time_s"][k],
            encoder=scalars["encoder"][k],
            frame=scalars["frame"][k],
        )
        for k, (end, length, bright_end, bright) in enumerate(
            zip(ends, columns["lengths"], bright_ends, columns["intensity_lengths"], strict=True)
        )
    )


def _poses(columns: Columns) -> tuple[Pose, ...]:
    table_rad, stage_mm, time_s = (columns[n].tolist() for n in ("table_rad", "stage_mm", "time_s"))
    return tuple(map(Pose, table_rad, stage_mm, time_s))


def _timing(columns: Columns) -> Timing | None:
    if "arrived_s" not in columns:
        return None
    told: dict[str, Any] = {name: columns[name] for name in _TIMES}
    told |= {name: columns[name].item() for name in TIMING_COLUMNS if name not in _TIMES}
    return Timing(**told)
