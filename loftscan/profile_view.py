"""One profile for a person: a sentence of numbers, a picture in text, a table, a plot."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from drivers.profiler import Profile, Reason

_BRAILLE = 0x2800
# Bit of each dot of a braille cell, by its row and column.
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


class Glyphs(Enum):
    """What a picture is made of."""

    ASCII = "one star a cell"
    BRAILLE = "eight dots a cell"


@dataclass(frozen=True, slots=True)
class Numbers:
    """What a profile amounts to."""

    frame: int
    points: int
    measured: int
    reasons: dict[str, int]  # of the points without a measurement
    x_mm: tuple[float, float] | None
    z_mm: tuple[float, float] | None  # nearest and farthest in the sensor's sense
    intensity: tuple[int, int, int] | None  # least, median, most; None where it sends none


def numbers(profile: Profile) -> Numbers:
    """Count a profile."""
    points_mm = profile.points_mm
    counted = {
        reason.name.lower().replace("_", " "): int(np.count_nonzero(profile.reasons == reason))
        for reason in Reason
        if reason is not Reason.MEASURED
    }
    light = profile.intensity[profile.reasons == Reason.MEASURED] if profile.intensity.size else ()
    return Numbers(
        frame=profile.frame,
        points=len(profile.reasons),
        measured=len(points_mm),
        reasons={reason: count for reason, count in counted.items() if count},
        x_mm=_span(points_mm[:, 0]) if len(points_mm) else None,
        z_mm=_span(points_mm[:, 1]) if len(points_mm) else None,
        intensity=(int(np.min(light)), int(np.median(light)), int(np.max(light)))
        if len(light)
        else None,
    )


def sentence(of: Numbers) -> str:
    """Say the numbers in a line."""
    share = of.measured / of.points if of.points else 0.0
    told = [f"profile {of.frame}: {of.measured} of {of.points} points measured ({share:.1%})"]
    told += [f"{count} {reason}" for reason, count in of.reasons.items()]
    if of.x_mm is not None and of.z_mm is not None:
        told.append(f"x {of.x_mm[0]:.2f} to {of.x_mm[1]:.2f} mm")
        told.append(f"z {of.z_mm[0]:.2f} to {of.z_mm[1]:.2f} mm")
    if of.intensity is not None:
        low, middle, high = of.intensity
        told.append(f"intensity {low} to {high}, median {middle}")
    return ", ".join(told)


def picture(points_mm: FloatArray, columns: int, rows: int, glyphs: Glyphs) -> list[str]:
    """Draw points x, z (n, 2) so that the sensor is above: the nearest points in the first row."""
    if glyphs is Glyphs.ASCII:
        dots = _raster(points_mm, columns, rows)
        return ["".join(" *"[dot] for dot in row).rstrip() for row in dots]
    dots = _raster(points_mm, 2 * columns, 4 * rows)
    cells = dots.reshape(rows, 4, columns, 2) * _DOTS[None, :, None, :]
    return ["".join(chr(_BRAILLE + int(cell)) for cell in row) for row in cells.sum(axis=(1, 3))]


def table(profiles: Sequence[Profile]) -> str:
    """Write every point as CSV, the measured ones with their millimetres."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["frame", "point", "x_mm", "z_mm", "reason", "intensity"])
    for profile in profiles:
        places = profile.counts * np.array(profile.scale_mm) + np.array(profile.offset_mm)
        for point, ((x_mm, z_mm), reason) in enumerate(zip(places, profile.reasons, strict=True)):
            measured = reason == Reason.MEASURED
            light = profile.intensity[point] if profile.intensity.size else ""
            where = (f"{x_mm:.6g}", f"{z_mm:.6g}") if measured else ("", "")
            rows.writerow([profile.frame, point, *where, Reason(reason).name.lower(), light])
    return text.getvalue()


def plot(profile: Profile) -> bytes:
    """Draw a profile as a PNG, the sensor above, both axes in the same scale."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), dpi=130, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*profile.points_mm.T, ".", markersize=2.5, color="#0072b2")
    axes.set(
        xlabel="x in mm", ylabel="z in mm, away from the sensor", title=sentence(numbers(profile))
    )
    axes.title.set_fontsize(8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.grid(visible=True, color="#d9dee3", linewidth=0.6)
    made = io.BytesIO()
    figure.savefig(made, format="png")
    return made.getvalue()


def _raster(points_mm: FloatArray, columns: int, rows: int) -> NDArray[np.int64]:
    dots = np.zeros((rows, columns), dtype=np.int64)
    if len(points_mm):
        low, high = points_mm.min(axis=0), points_mm.max(axis=0)
        span = np.where(high > low, high - low, 1.0)
        size = np.array([columns, rows])
        place = np.minimum(((points_mm - low) / span * size).astype(np.int64), size - 1)
        dots[place[:, 1], place[:, 0]] = 1
    return dots


def _span(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())
