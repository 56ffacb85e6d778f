"""One slice, fitted: the verb `fit_section`, and what `loftscan section` reads, tells and keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from reconstruction.errors import UnreadableCloud
from reconstruction.exporting import SectionRecord, write_sections_json
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section import SectionFit
from reconstruction.fitting.section import fit_section as _fit_section
from reconstruction.slices import Frame

EXTENSIONS = (".npy", ".txt", ".csv", ".xyz", ".pts")
_HEAD_LINES = 64  # within which the numbers must begin
_LEVEL = 0.2  # of a slice's width: what is higher is no slice
_SAMPLES = 4001  # of a curve, for its length ...
_CROSSING_SAMPLES = 1000  # ... and for its crossings


def fit_section(
    points_mm: ArrayLike, *, exact: Literal["auto", "never"] = "auto"
) -> list[FittedCurve]:
    """Fit NURBS curves to the points of one slice.

    Parameters
    ----------
    points_mm
        (n, 2), in any order.
    exact
        Whether circles, ellipses, arcs and lines are returned as such where the points prefer one.

    Returns
    -------
    Loops first, counter-clockwise and holes clockwise, then open runs, the largest of each first:
    ``curve(u)`` for u in ``curve.domain``, ``curve.closed``, ``curve.covariance(u)``.

    Raises
    ------
    reconstruction.errors.ReconstructionError
        There is no curve in the points; the message says why.
    ValueError
        For an argument that cannot be meant.
    """
    try:
        wanted = Exact(exact)
    except ValueError as unknown:
        raise ValueError(f"exact {exact!r}: 'auto' or 'never' expected") from unknown
    return _fit_section(points_mm, exact=wanted)


@dataclass(frozen=True, slots=True, eq=False)
class PlanarSlice:
    """The points of one slice in its plane."""

    name: str
    index: int
    points_mm: FloatArray  # (n, 2), finite
    frame: Frame
    height_mm: float
    lost: int  # rows without a finite number, set aside


def read_slice(source: Path, index: int | None = None) -> PlanarSlice:
    """Read points (n, 2), or (n, 3) at one height, from a file, or a slice of a .scan folder.

    Raises
    ------
    UnreadableCloud, NotAScan
        Missing, damaged, or of another kind.
    ValueError
        A file with an index, a folder without one, or points that are no slice.
    """
    from loftscan.scans import is_scan

    if is_scan(source) or source.is_dir():
        return _scanned(source, index)
    if index is not None:
        raise ValueError(f"--slice {index}: only a .scan folder has slices, {source} is none")
    return _planar(source.name, _numbers(source))


def _scanned(source: Path, index: int | None) -> PlanarSlice:
    from acquisition.scanfile import ScanFolder
    from loftscan.following import read_piece
    from loftscan.scans import Absent

    folder = ScanFolder.open(source)
    record = folder.record()
    first, last = min(record.indices), max(record.indices)
    if index is None or not first <= index <= last:
        raise ValueError(f"{source}: name a slice by --slice {first} to {last}")
    found = read_piece(folder, index, record)
    if isinstance(found, Absent):
        why = found.damage or "it is not there; resume the scan to take it"
        raise UnreadableCloud(f"{source}: slice {index}: {why}")
    piece = found.piece
    points_mm = np.ascontiguousarray(piece.frame.to_plane(piece.points_mm)[:, :2])
    height_mm = float(piece.frame.origin_mm @ piece.frame.axes[2])
    return PlanarSlice(f"{source.name}, slice {index}", index, points_mm, piece.frame, height_mm, 0)


def _planar(name: str, rows: FloatArray) -> PlanarSlice:
    """Lay rows (n, 2) or (n, 3) into the plane across the coordinate that hardly varies."""
    finite = np.isfinite(rows).all(axis=1)
    kept = rows if finite.all() else rows[finite]
    if not len(kept):
        raise UnreadableCloud(f"{name}: it holds no point with finite numbers")
    lost = len(rows) - len(kept)
    if kept.shape[1] == 2:
        return PlanarSlice(name, 0, kept, Frame(np.zeros(3), np.eye(3)), 0.0, lost)
    sides = np.ptp(kept, axis=0)
    upward = 2 - int(np.argmin(sides[::-1]))  # z, if several are as low
    if not sides[upward] <= _LEVEL * sides.max():
        size = " x ".join(f"{side:.4g}" for side in sides)
        raise ValueError(
            f"{name}: points of {size} mm are no slice at one height; for a whole cloud use"
            " `loftscan reconstruct`"
        )
    axes = np.eye(3)[[(upward + 1) % 3, (upward + 2) % 3, upward]]
    height_mm = float(np.median(kept[:, upward]))
    frame = Frame(height_mm * axes[2], axes)
    points_mm = np.ascontiguousarray(frame.to_plane(kept)[:, :2])
    return PlanarSlice(name, 0, points_mm, frame, height_mm, lost)


def _numbers(path: Path) -> FloatArray:
    """Rows of two or three numbers."""
    if path.suffix.lower() not in EXTENSIONS:
        raise UnreadableCloud(
            f"{path}: unknown extension {path.suffix!r}; convert it to one of"
            f" {' '.join(EXTENSIONS)}"
        )
    try:
        rows = _stored(path) if path.suffix.lower() == ".npy" else _typed(path)
    except UnreadableCloud:
        raise
    except OSError as lost:
        raise UnreadableCloud(f"{path}: {lost.strerror or lost}") from lost
    except (ValueError, EOFError) as damaged:
        raise UnreadableCloud(f"{path}: {damaged}") from damaged
    if rows.ndim != 2 or rows.shape[1] not in (2, 3) or rows.dtype.kind not in "iuf":
        raise UnreadableCloud(
            f"{path}: {rows.dtype} of shape {rows.shape}; numbers (n, 2) or (n, 3) expected"
        )
    return np.asarray(rows, dtype=np.float64)


def _stored(path: Path) -> FloatArray:
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except ValueError as damaged:
        raise UnreadableCloud(
            f"{path}: no .npy file of numbers, or a damaged one; save it again"
        ) from damaged


def _typed(path: Path) -> FloatArray:
    """Text: rows after any heading, separated as the first row is; more columns are passed over."""
    with path.open(encoding="utf-8-sig") as file:
        for skipped, line in enumerate(file):
            delimiter = next((mark for mark in ";," if mark in line), None)
            width = _width(line, delimiter)
            if width >= 2:
                break
            if skipped >= _HEAD_LINES:
                raise UnreadableCloud(f"{path}: no numbers in its first {_HEAD_LINES} lines")
        else:
            raise UnreadableCloud(f"{path}: it holds no row of two or three numbers")
    return np.loadtxt(
        path, delimiter=delimiter, skiprows=skipped, usecols=range(min(width, 3)), ndmin=2,
        encoding="utf-8-sig",
    )  # fmt: skip


def _width(line: str, delimiter: str | None) -> int:
    """How many numbers a row holds; 0 if anything else is among them."""
    words = line.partition("#")[0].split(delimiter)
    try:
        return len([float(word) for word in words])
    except ValueError:
        return 0


def describe(curve: FittedCurve, depth: int) -> dict[str, object]:
    """What there is to say of a curve, as JSON can say it."""
    grid = np.linspace(*curve.domain, _SAMPLES)
    places = curve(grid)
    half_mm = 1.96 * curve.deviation_mm(grid)
    return {
        "kind": curve.kind,
        "closed": curve.closed,
        "ambiguous": curve.ambiguous,
        "hole": curve.closed and depth % 2 == 1,
        "crosses_itself": _crosses(places[:: _SAMPLES // _CROSSING_SAMPLES], closed=curve.closed),
        "length_mm": float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()),
        **_dimensions(curve),
        "control_points": len(curve.curve.control_points_mm),
        "sigma_mm": curve.sigma_mm,
        "least_radius_mm": _least_radius_mm(curve, grid),
        "residual_rms_mm": curve.residual_rms_mm,
        "residual_max_mm": curve.residual_max_mm,
        "points": curve.points_used,
        "outliers": curve.outliers,
        "band_95_median_mm": float(np.median(half_mm)),
        "band_95_max_mm": float(half_mm.max()),
        "gaps": [list(gap) for gap in curve.gap_intervals],
        "creases": list(curve.creases),
    }


def _crosses(places: FloatArray, *, closed: bool) -> bool:
    """Whether a row of places (m, 2) crosses itself; the outline of a part never does."""
    starts, ways = places[:-1], np.diff(places, axis=0)
    arms = places[None, :, :] - starts[:, None, :]
    sides = np.sign(ways[:, None, 0] * arms[..., 1] - ways[:, None, 1] * arms[..., 0])
    parted = sides[:, :-1] * sides[:, 1:] < 0  # the ends of way j lie on both sides of way i
    apart = np.abs(np.arange(len(ways))[:, None] - np.arange(len(ways)))
    if closed:
        apart = np.minimum(apart, len(ways) - apart)
    return bool((parted & parted.T & (apart > 1)).any())


def _least_radius_mm(curve: FittedCurve, grid: FloatArray) -> float | None:
    """Of curvature; none of a line."""
    sharpest = float(np.abs(curve.curvature(grid)).max())
    return 1.0 / sharpest if sharpest > 0.0 else None


def _dimensions(curve: FittedCurve) -> dict[str, object]:
    """Centre and radius, or half axes, of an exact shape."""
    if curve.kind not in ("circle", "ellipse", "arc"):
        return {}
    start, end = curve.domain
    if curve.kind == "arc":
        centre = _centre(curve(np.linspace(start, end, 3)))
        radius = float(np.hypot(*(curve(start) - centre)))
        return {"centre_mm": centre.tolist(), "radius_mm": radius}
    a, b, c = curve(start + (end - start) * np.array([0.0, 0.25, 0.5]))  # ends of the half axes
    centre = (a + c) / 2
    axes = sorted((float(np.hypot(*(each - centre))) for each in (a, b)), reverse=True)
    sizes = {"radius_mm": axes[0]} if curve.kind == "circle" else {"half_axes_mm": axes}
    return {"centre_mm": centre.tolist(), **sizes}


def _centre(three: FloatArray) -> FloatArray:
    """Of the circle through three points."""
    arms = three[1:] - three[0]
    return np.asarray(three[0] + np.linalg.solve(2 * arms, (arms**2).sum(axis=1)))


def write_section(path: Path, piece: PlanarSlice, found: SectionFit, exact: Exact) -> None:
    """Write the curves in the format of sections.json, what is known of them as provenance."""
    records = [
        SectionRecord(
            index=piece.index,
            height_mm=piece.height_mm,
            frame=piece.frame,
            curve=curve.curve,
            gaps=curve.gap_intervals,
            residual_rms_mm=curve.residual_rms_mm,
            residual_max_mm=curve.residual_max_mm,
            points=curve.points_used,
        )
        for curve in found.curves
    ]
    said = {"method": "fit", "exact": exact.value, **summary(piece, found),
            "curves": descriptions(found)}  # fmt: skip
    write_sections_json(path, records, name=piece.name, provenance=said)


def descriptions(found: SectionFit) -> list[dict[str, object]]:
    """Every curve's description, in order."""
    return [describe(*each) for each in zip(found.curves, found.depths, strict=True)]


def summary(piece: PlanarSlice, found: SectionFit) -> Mapping[str, object]:
    """What became of the points of a slice."""
    return {
        "points_in": len(piece.points_mm),
        "lost": piece.lost,
        "strays": len(found.strays),
        "unordered": len(found.unordered),
        "sigma_mm": found.sigma_mm,
        "thickness_mm": found.width_mm,
        "band_mm": found.band_mm,
        "spacing_mm": found.spacing_mm if found.chains else None,
        "failures": list(found.failures),
    }
