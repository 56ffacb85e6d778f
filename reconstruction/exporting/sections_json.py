"""sections.json: the fitted section curves, where they stand, how well they fit, what is bridged.

The format is described in docs/surface-json.md and by sections.schema.json beside this module.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.exporting.documents import Field, checked, read_document, write_document
from reconstruction.exporting.provenance import plain
from reconstruction.nurbs.values import Curve
from reconstruction.slices import Frame

FORMAT = "loftscan.sections"
VERSION = 1


@dataclass(frozen=True, slots=True, eq=False)
class SectionRecord:
    """One section as it is handed over.

    A gap is an interval [u0, u1] of the curve's parameter that stands on no measured point; across
    the seam of a periodic curve u1 lies beyond the domain, by less than a period. The residuals are
    distances of the unreduced points to the curve; a section without points has none.
    """

    index: int
    height_mm: float  # along the stacking axis
    frame: Frame
    curve: Curve  # 2D: in the frame's x, y; 3D: in the part frame
    gaps: tuple[tuple[float, float], ...]
    residual_rms_mm: float | None
    residual_max_mm: float | None
    points: int  # how many unreduced points the residuals are of

    def __post_init__(self) -> None:
        if (self.residual_rms_mm is None) != (self.points == 0):
            raise ValueError(f"section {self.index}: residuals of {self.points} points")
        if (self.residual_rms_mm is None) != (self.residual_max_mm is None):
            raise ValueError(f"section {self.index}: rms and largest residual go together")
        for start, end in self.gaps:
            if not start < end:
                raise ValueError(f"section {self.index}: the gap [{start}, {end}] is empty")


def sections_document(
    sections: Sequence[SectionRecord], *, name: str, provenance: Mapping[str, object]
) -> dict[str, object]:
    """Every section as lists and numbers that JSON can say."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "unit": "mm",
        "name": name,
        "provenance": plain(provenance),
        "sections": [_entry(section) for section in sections],
    }


def write_sections_json(
    path: Path | str,
    sections: Sequence[SectionRecord],
    *,
    name: str,
    provenance: Mapping[str, object],
) -> None:
    """Write `sections_document`; the file appears whole or not at all."""
    write_document(path, sections_document(sections, name=name, provenance=provenance))


def read_sections_json(path: Path | str) -> tuple[SectionRecord, ...]:
    """Read the sections of a sections.json, bit for bit as they were written.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        One line that names the file, the field, and what is wrong with it.
    """
    document = read_document(path, format_name=FORMAT, version=VERSION)
    return tuple(_section(entry) for entry in document.child("sections").items())


def _entry(section: SectionRecord) -> dict[str, object]:
    curve, frame = section.curve, section.frame
    return {
        "index": section.index,
        "height_mm": float(section.height_mm),
        "frame": {"origin_mm": frame.origin_mm.tolist(), "axes": frame.axes.tolist()},
        "curve": {
            "degree": curve.degree,
            "periodic": curve.periodic,
            "knots": curve.knots.tolist(),
            "control_points_mm": curve.control_points_mm.tolist(),
            "weights": curve.weights.tolist(),
        },
        "gaps": np.reshape(np.asarray(section.gaps, dtype=np.float64), (-1, 2)).tolist(),
        "residual": {
            "rms_mm": plain(section.residual_rms_mm),
            "max_mm": plain(section.residual_max_mm),
            "points": section.points,
        },
    }


def _section(entry: Field) -> SectionRecord:
    frame, residual = entry.child("frame"), entry.child("residual")
    fields = {
        "index": entry.child("index").integer(),
        "height_mm": entry.child("height_mm").number(),
        "frame": Frame(frame.child("origin_mm").array((3,)), frame.child("axes").array((3, 3))),
        "curve": _curve(entry.child("curve")),
        "gaps": tuple(_gap(gap) for gap in entry.child("gaps").items()),
        "residual_rms_mm": _number_or_none(residual.child("rms_mm")),
        "residual_max_mm": _number_or_none(residual.child("max_mm")),
        "points": residual.child("points").integer(),
    }
    return checked(entry, lambda: SectionRecord(**fields))  # type: ignore[arg-type]


def _curve(field: Field) -> Curve:
    degree, periodic = field.child("degree").integer(), field.child("periodic").flag()
    knots = field.child("knots").array((None,))
    points = field.child("control_points_mm").array((None, None))
    weights = field.child("weights").array((None,))
    if points.shape[1] not in (2, 3):
        field.child("control_points_mm").refuse("two or three coordinates a point expected")
    return checked(field, lambda: Curve(degree, knots, points, weights, periodic))


def _gap(field: Field) -> tuple[float, float]:
    start, end = field.array((2,))
    return float(start), float(end)


def _number_or_none(field: Field) -> float | None:
    return None if field.value is None else field.number()
