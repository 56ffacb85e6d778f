"""LAS 1.4 (ASPRS, R15), point format 6, by laspy.

Coordinates are integers of 0.1 um. The unit stands in the coordinate system (WKT): a local one in
millimetres. Unit, frame and provenance stand as JSON in a text record, too.
"""

from __future__ import annotations

import json
from datetime import date
from typing import BinaryIO

import numpy as np

from loftscan.scan_exports.measured import MeasuredScan, library

_QUANTUM_MM = 1e-4
_WKT = (
    'LOCAL_CS["loftscan part frame",LOCAL_DATUM["part: on the table\'s axis at the plate",0],'
    'UNIT["millimetre",0.001],AXIS["X",OTHER],AXIS["Y",OTHER],AXIS["Z",UP]]'
)
_TEXT_RECORD = 3  # "text area description" of user LASF_Spec
_LONGEST = 65_535  # bytes of a variable length record


def write(file: BinaryIO, scan: MeasuredScan) -> int:
    """Write a LAS file; give the number of points."""
    laspy = library("laspy", ".las")
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, _QUANTUM_MM), np.zeros(3)
    header.system_identifier = _short(scan.record.station.name)
    header.generating_software = _short(str(scan.provenance("mm")["program"]))
    header.creation_date = date.fromisoformat(scan.record.created[:10])
    header.add_extra_dims(
        [laspy.ExtraBytesParams("slice", "int32"), laspy.ExtraBytesParams("profile", "int32")]
    )
    header.global_encoding.wkt = True
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(_WKT))
    about = json.dumps(scan.provenance("mm") | {"frame": scan.frame}).encode()
    header.vlrs.append(
        laspy.VLR("LASF_Spec", _TEXT_RECORD, "unit, frame, provenance", about[:_LONGEST])
    )
    with laspy.open(file.name, "w", header=header) as writer:
        for piece in scan:
            rows = laspy.ScaleAwarePointRecord.zeros(len(piece.points_mm), header=header)
            rows.x, rows.y, rows.z = piece.points_mm.T
            rows.intensity, rows.gps_time = piece.intensity, piece.time_s
            rows.return_number[:], rows.number_of_returns[:] = 1, 1
            rows["profile"] = piece.profile
            rows["slice"] = np.full(len(rows), piece.sweep.index, np.int32)
            writer.write_points(rows)
        return int(writer.header.point_count)


def _short(text: str) -> str:
    return text.encode("ascii", "replace").decode()[:32]
