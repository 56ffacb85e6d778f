"""The verb `register`: two views of one part, as before and after it was turned over, become one.

>>> merged = register("upright.scan", "turned.scan")
>>> merged.transform, merged.registration.sd
>>> merged.save("merged")                       # merged.ply, registration.json, report.html
>>> reconstruct("merged/merged.ply", spacing_mm=merged.spacing_mm).save("part")
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from acquisition.errors import DamagedSlice
from acquisition.frames import part_points, sensor_to_station, station_to_part
from acquisition.scanfile import ScanFolder
from loftscan.inputs import Unit, hash_file, open_input
from loftscan.progress import Progress, silent
from loftscan.result import appearing_whole
from loftscan.scans import is_scan
from reconstruction.arrays import FloatArray
from reconstruction.registration import Registration, View, register_views
from reconstruction.registration.searching import small_turns

MARKS = ("registration.json", "merged.ply")  # files that tell the folder of a registration
_STEPS = ("patches", "search", "settle")
_FRAME = "that of the first view"


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """One view and where it came from."""

    name: str
    view: View
    sha256: str | None  # of a cloud's file; a scan's slices have their own
    spacing_mm: float | None = None  # of a scan's rings


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """What `register` returns: both views in the frame of the first."""

    first: Named
    second: Named
    registration: Registration

    @property
    def transform(self) -> FloatArray:
        """(4, 4), from the second view's frame to the first's."""
        return self.registration.transform

    @property
    def spacing_mm(self) -> float:
        """Of the slices to reconstruct it in: rows of both views lie too close for one's own."""
        rings = [each.spacing_mm for each in (self.first, self.second) if each.spacing_mm]
        return max(rings) if rings else round(self.registration.radius_mm, 3)

    @property
    def points_mm(self) -> FloatArray:
        """All points of both, (n, 3), the first's before the second's."""
        moved = self.registration.moved(self.second.view.points_mm)
        return np.concatenate([self.first.view.points_mm, moved])

    @property
    def metrics(self) -> dict[str, object]:
        """What registration.json says."""
        found = self.registration
        turn = found.transform[:3, :3]
        sd = found.sd
        return {
            "format": "loftscan.registration",
            "version": 1,
            "unit": "mm",
            "frame": _FRAME,
            "software": f"loftscan {version('loftscan')}",
            "first": {"name": self.first.name, "points": len(self.first.view.points_mm),
                      "sha256": self.first.sha256},
            "second": {"name": self.second.name, "points": len(self.second.view.points_mm),
                       "sha256": self.second.sha256},
            "transform": found.transform.tolist(),
            "turn_deg": math.degrees(math.acos(min(1.0, max(-1.0, (np.trace(turn) - 1.0) / 2.0)))),
            "about_mm": found.middle_mm.tolist(),
            "covariance_of": "rotation vector in rad about about_mm, then shift in mm",
            "covariance": found.covariance.tolist(),
            "sd_turn_deg": np.degrees(sd[:3]).tolist(),
            "sd_shift_mm": sd[3:].tolist(),
            "residual_rms_mm": found.rms_mm,
            "residual_max_mm": float(np.abs(found.residuals_mm[found.counted]).max()),
            "places": len(found.residuals_mm),
            "places_left_out": int((~found.counted).sum()),
            "patch_radius_mm": found.radius_mm,
            "overlap_of_first": found.overlap[0],
            "overlap_of_second": found.overlap[1],
            "spacing_mm": self.spacing_mm,
        }  # fmt: skip

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write merged.ply (points and their view), registration.json and report.html."""
        from loftscan.registration_report import write_registration_report

        target = Path(folder)
        with appearing_whole(target, overwrite=overwrite, marks=MARKS) as partial:
            text = json.dumps(self.metrics, indent=2) + "\n"
            (partial / "registration.json").write_text(text, encoding="utf-8")
            _write_merged(partial / "merged.ply", self)
            write_registration_report(partial / "report.html", self)
        return target


def register(
    a: Path | str | ArrayLike,
    b: Path | str | ArrayLike,
    *,
    near_deg: tuple[float, float, float] | None = None,
    unit: str = "mm",
    progress: Progress = silent,
) -> Merged:
    """Lay the second of two views of a part onto the first.

    Parameters
    ----------
    a, b
        .scan folders, cloud files, or (n, 3) arrays; the part is the same, and stood otherwise.
    near_deg
        Roughly how `b` is to be turned to lie as `a`, as a rotation vector in degrees: (180, 0, 0)
        is half a turn about x. Needed where a symmetric part fits in several ways.
    unit
        Of clouds.
    progress
        Called with (stage, done, total).

    Raises
    ------
    reconstruction.errors.NotRegistered
        The views share too little, or the shape leaves open how one lies to the other; says what.
    reconstruction.errors.TooFewPoints, UnreadableCloud
        An input is none.
    """
    first, second = open_view(a, Unit(unit)), open_view(b, Unit(unit))
    near = None if near_deg is None else small_turns(np.radians([near_deg]))[0]

    def begun(step: str) -> None:
        progress(step, _STEPS.index(step), len(_STEPS))

    return Merged(first, second, register_views(first.view, second.view, near=near, progress=begun))


def open_view(source: Path | str | ArrayLike, unit: Unit) -> Named:
    """Read all points of a scan, with the ways to the sensor, or of a cloud."""
    if is_scan(source):
        return _scanned(Path(source))  # type: ignore[arg-type] # a path, says is_scan
    with open_input(source, unit) as opened:
        points_mm = np.concatenate([np.empty((0, 3)), *opened.chunks()])
        path = opened.cloud.path
        return Named(opened.name, View(points_mm), None if path is None else hash_file(path))


def parse_near(text: str) -> tuple[float, float, float]:
    """Read --near RX,RY,RZ.

    Raises
    ------
    ValueError
    """
    try:
        x, y, z = (float(word) for word in text.split(","))
    except ValueError as wrong:
        raise ValueError(
            f"--near {text!r}: three numbers in degrees expected, a rotation vector: 180,0,0 is"
            " half a turn about x"
        ) from wrong
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"--near {text!r}: finite numbers in degrees expected")
    return x, y, z


def _scanned(path: Path) -> Named:
    """Every slice that can be read; the others are missing in it as in the scan."""
    folder = ScanFolder.open(path)
    record = folder.record()
    kinematics, rings = record.calibration, record.plan.ring
    points, towards = [np.empty((0, 3))], [np.empty((0, 3))]
    for index in folder.indices():
        try:
            sweep = folder.read(index)
        except DamagedSlice:
            continue
        counts = [len(each.points_mm) for each in sweep.profiles]
        stage_mm = np.array([pose.stage_mm for pose in sweep.poses])
        table_rad = np.array([pose.table_rad for pose in sweep.poses])
        sensor_mm = sensor_to_station(np.zeros((len(stage_mm), 2)), stage_mm, kinematics)
        eyes_mm = np.repeat(station_to_part(sensor_mm, table_rad, kinematics), counts, axis=0)
        here_mm = part_points(sweep, kinematics)
        ways = eyes_mm - here_mm
        points.append(here_mm)
        towards.append(ways / np.linalg.norm(ways, axis=1, keepdims=True))
    view = View(np.concatenate(points), np.concatenate(towards))
    lifted_mm = abs(kinematics.stage_z_mm)
    return Named(path.name, view, None, rings.step_mm * lifted_mm if rings else None)


def _write_merged(path: Path, merged: Merged) -> None:
    points_mm = merged.points_mm
    rows = np.empty(len(points_mm), dtype=[("p", "<f8", 3), ("view", "u1")])
    rows["p"], rows["view"] = points_mm, 1
    rows["view"][: len(merged.first.view.points_mm)] = 0
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment loftscan merged views, unit: mm\n"
        f"comment frame: {_FRAME}; view 0 and view 1\nelement vertex {len(points_mm)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty uchar view\n"
        "end_header\n"
    )
    with path.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(rows.data)
