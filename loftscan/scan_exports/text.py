"""PLY (binary, float64) and XYZ: what every program reads.

Neither has a place for the unit; both say it in comments, with the frame and the provenance. A PLY
gives its number of points before the points: the line is rewritten at the end, its length kept by
a comment.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from loftscan.scan_exports.measured import MeasuredScan, MeasuredSlice
from reconstruction.exporting.provenance import lines

_DIGITS = 12
_ROW = np.dtype(
    [
        *((axis, "<f8") for axis in "xyz"),
        ("intensity", "<u2"),
        ("slice", "<i4"),
        ("profile", "<i4"),
    ]
)
_PLY_TYPES = {"<f8": "double", "<u2": "ushort", "<i4": "int"}


def write_ply(file: BinaryIO, scan: MeasuredScan) -> int:
    """Write a PLY; give the number of points."""
    about = "".join(f"comment {line}\n" for line in _about(scan))
    head = f"ply\nformat binary_little_endian 1.0\n{about}".encode("ascii")
    properties = "".join(
        f"property {_PLY_TYPES[str(_ROW[name].str)]} {name}\n" for name in _ROW.names or ()
    )
    file.write(head + _count(0) + f"{properties}end_header\n".encode("ascii"))
    points = 0
    for piece in scan:
        file.write(_rows(piece).tobytes())
        points += len(piece.points_mm)
    file.seek(len(head))
    file.write(_count(points))
    return points


def write_xyz(file: BinaryIO, scan: MeasuredScan) -> int:
    """Write rows of text, rounded to 1e-6 mm; give the number of points."""
    about = "".join(f"# {line}\n" for line in _about(scan))
    file.write(f"{about}# x_mm y_mm z_mm intensity slice profile\n".encode())
    points = 0
    for piece in scan:
        rows = _rows(piece)
        np.savetxt(file, rows, fmt="%.6f %.6f %.6f %d %d %d")
        points += len(rows)
    return points


def _about(scan: MeasuredScan) -> list[str]:
    said = ["unit: mm", f"frame: {scan.frame}", *lines(scan.provenance("mm"))]
    return [line.encode("ascii", "replace").decode() for line in said]


def _count(points: int) -> bytes:
    digits = str(points)
    return f"element vertex {digits}\ncomment {'-' * (_DIGITS - len(digits))}\n".encode()


def _rows(piece: MeasuredSlice) -> NDArray[Any]:
    rows = np.empty(len(piece.points_mm), _ROW)
    rows["x"], rows["y"], rows["z"] = piece.points_mm.T
    rows["intensity"], rows["profile"] = piece.intensity, piece.profile
    rows["slice"] = piece.sweep.index
    return rows
