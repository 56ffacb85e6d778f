"""E57 (ASTM E2807) by libE57Format, float64, in metres as the standard wants it.

One scan of it holds all slices: rowIndex is the slice, columnIndex the profile. Its description
says frame and provenance, and that the points were millimetres.
"""

from __future__ import annotations

import json
import uuid
from datetime import datetime
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from loftscan.scan_exports.measured import MeasuredScan, MeasuredSlice, library
from reconstruction.arrays import FloatArray

_M = 1e-3  # of a millimetre
_GPS_EPOCH = datetime.fromisoformat("1980-01-06T00:00:00+00:00")
_MOST = 2**31 - 1
_CHUNK = 65_536
_COLUMNS = {
    **dict.fromkeys(("cartesianX", "cartesianY", "cartesianZ", "intensity"), np.float64),
    **dict.fromkeys(("rowIndex", "columnIndex"), np.longlong),  # an int64 is taken for 32 bits
}


def write(file: BinaryIO, scan: MeasuredScan) -> int:
    """Write an E57 file; give the number of points."""
    pye57 = library("pye57", ".e57")
    with pye57.E57(file.name, mode="w") as made:
        return _Writer(pye57.libe57, made).write(scan)


class _Writer:
    """The nodes of one file; libe57's names are its own."""

    def __init__(self, lib: Any, made: Any) -> None:
        self._lib, self._made, self._file = lib, made, made.image_file

    def write(self, scan: MeasuredScan) -> int:
        node = self._scan_node(scan)
        writer, arrays = self._points(node)
        low_mm, high_mm, points = np.full(3, np.inf), np.full(3, -np.inf), 0
        for piece in scan:
            if len(piece.points_mm):
                low_mm = np.minimum(low_mm, piece.points_mm.min(axis=0))
                high_mm = np.maximum(high_mm, piece.points_mm.max(axis=0))
            points += _write_slice(writer, arrays, piece)
        writer.close()
        if points:
            node.set("cartesianBounds", self._bounds(low_mm * _M, high_mm * _M))
        return points

    def _scan_node(self, scan: MeasuredScan) -> Any:
        began = (datetime.fromisoformat(scan.record.created) - _GPS_EPOCH).total_seconds()
        about = scan.provenance("m") | {"frame": scan.frame, "scanned_unit": "mm"}
        limits = {"intensityMinimum": 0.0, "intensityMaximum": 65_535.0}
        start = {"dateTimeValue": began, "isAtomicClockReferenced": 0}
        return self._structure(
            {
                "guid": f"{{{uuid.uuid4()}}}",
                "name": scan.name,
                "description": json.dumps(about),
                "sensorModel": scan.record.station.name,
                "acquisitionStart": start,
                "intensityLimits": limits,
            }
        )

    def _structure(self, values: dict[str, Any]) -> Any:
        node = self._lib.StructureNode(self._file)
        kinds = {str: self._lib.StringNode, float: self._lib.FloatNode, int: self._lib.IntegerNode}
        for name, value in values.items():
            made = (
                self._structure(value)
                if isinstance(value, dict)
                else kinds[type(value)](self._file, value)
            )
            node.set(name, made)
        return node

    def _bounds(self, low_m: FloatArray, high_m: FloatArray) -> Any:
        ends = (("Minimum", low_m), ("Maximum", high_m))
        return self._structure(
            {
                f"{axis}{end}": float(values[k])
                for k, axis in enumerate("xyz")
                for end, values in ends
            }
        )

    def _points(self, node: Any) -> tuple[Any, dict[str, NDArray[Any]]]:
        lib = self._lib
        prototype = lib.StructureNode(self._file)
        arrays = {name: np.zeros(_CHUNK, kind) for name, kind in _COLUMNS.items()}
        buffers = lib.VectorSourceDestBuffer()
        for name, array in arrays.items():
            whole = array.dtype.kind == "i"
            column = (
                lib.IntegerNode(self._file, 0, 0, _MOST)
                if whole
                else lib.FloatNode(self._file, 0.0, lib.E57_DOUBLE)
            )
            prototype.set(name, column)
            buffers.append(lib.SourceDestBuffer(self._file, name, array, _CHUNK, True, True))  # noqa: FBT003 (its own signature)
        codecs = lib.VectorNode(self._file, True)  # noqa: FBT003
        points = lib.CompressedVectorNode(self._file, prototype, codecs)
        node.set("points", points)
        self._made.data3d.append(node)
        return points.writer(buffers), arrays


def _write_slice(writer: Any, arrays: dict[str, NDArray[Any]], piece: MeasuredSlice) -> int:
    count = len(piece.points_mm)
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        taken = part.stop - start
        for axis, values_mm in zip("XYZ", piece.points_mm[part].T, strict=True):
            arrays[f"cartesian{axis}"][:taken] = values_mm * _M
        arrays["intensity"][:taken] = piece.intensity[part]
        arrays["rowIndex"][:taken] = piece.sweep.index
        arrays["columnIndex"][:taken] = piece.profile[part]
        writer.write(taken)
    return count
