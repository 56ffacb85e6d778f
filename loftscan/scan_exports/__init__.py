"""Scans in the formats that others read: HDF5/NeXus, PLY, E57, XYZ, LAS.

Points are measured points in the part frame, calibrated as scan.json says, slice after slice; a
place without a measurement is no point. Every file says its unit, its frame and where it came from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from acquisition.scanfile import ScanFolder
from loftscan.scan_exports import e57, las, nexus, text
from loftscan.scan_exports.measured import MeasuredScan
from reconstruction.exporting.atomic import replacing

_WRITERS: dict[str, tuple[Callable[[BinaryIO, MeasuredScan], int], str]] = {
    ".nxs": (nexus.write, "mm"),
    ".h5": (nexus.write, "mm"),
    ".ply": (text.write_ply, "mm"),
    ".e57": (e57.write, "m"),  # the standard knows no other
    ".xyz": (text.write_xyz, "mm"),
    ".las": (las.write, "mm"),
}


@dataclass(frozen=True, slots=True)
class Exported:
    """What is in the file."""

    points: int
    slices: int
    unit: str
    left_out: tuple[tuple[int, str], ...]  # damaged slices, and why


def export_scan(scan: Path, out: Path, *, overwrite: bool = False) -> Exported:
    """Write a scan in the format that the ending of `out` names; whole, or not at all.

    Raises
    ------
    ValueError
        An ending that is not known, a format whose library is not installed, nothing to write.
    FileExistsError, NotAScan, OSError
    """
    ending = out.suffix.lower()
    if ending not in _WRITERS:
        raise ValueError(f"{out}: ends in none of {', '.join(_WRITERS)}; name the format by it")
    if out.exists() and not overwrite:
        raise ValueError(f"{out}: is there already; name another file, or add --overwrite")
    write, unit = _WRITERS[ending]
    measured = MeasuredScan(ScanFolder.open(scan))
    with replacing(out) as file:
        points = write(file, measured)
        if not points:
            raise ValueError(f"{scan}: no slice of it has a measured point; nothing was written")
    return Exported(points, measured.slices, unit, tuple(measured.left_out))
