"""Fit slices of the real scans and draw them.

    python docs/sections/draw.py           ten pictures beside this script
    python docs/sections/draw.py --all     every slice of every scan is fitted, and counted

The scans are read from LOFTSCAN_DATA, else from ../shared/data beside the checkout.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from loftscan.figures import png
from loftscan.inputs import Unit, open_input
from loftscan.section_view import fitted_figure, view_fit
from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import FittedCurve
from reconstruction.fitting.section import resolve_section
from reconstruction.slices import Slice
from reconstruction.slicing import Cutting, cut_cloud
from reconstruction.survey import Axis

HERE = Path(__file__).resolve().parent
SCANS = HERE.parents[2] / "shared" / "data"
UNITS = {
    "cup.pcd": Unit.CM,
    "UHU.pcd": Unit.CM,
    "bigCub.pts": Unit.CM,
    "fabscanpi_duck.ply": Unit.MM,
}
DRAWN = (
    ("cup.pcd", 8),
    ("cup.pcd", 40),
    ("cup.pcd", 53),
    ("UHU.pcd", 30),
    ("UHU.pcd", 96),
    ("bigCub.pts", 10),
    ("bigCub.pts", 28),
    ("fabscanpi_duck.ply", 50),
    ("fabscanpi_duck.ply", 69),
    ("fabscanpi_duck.ply", 85),
)
DOTS_PER_INCH = 110


def main() -> None:
    """Draw, or count."""
    parser = argparse.ArgumentParser(description="Fit slices of the real scans.")
    parser.add_argument("--all", action="store_true", help="fit every slice, draw none")
    every = parser.parse_args().all
    folder = Path(os.environ.get("LOFTSCAN_DATA", SCANS)) / "scans"
    if not folder.is_dir():
        sys.exit("no scans: set LOFTSCAN_DATA to the folder of test data")
    for name, unit in UNITS.items():
        with open_input(folder / name, unit) as given:
            cutting = cut_cloud(given.chunks, Axis.Y)
        (count if every else draw)(name, cutting)


def draw(name: str, cutting: Cutting) -> None:
    """Write the pictures of one scan."""
    for index in (index for scan, index in DRAWN if scan == name):
        points = planar(cutting.slice_at(index))
        found = resolve_section(points)
        title = f"{name}, slice {index}: {tally(found.curves)}"
        picture = png(
            fitted_figure(view_fit(points, found), title=title), dots_per_inch=DOTS_PER_INCH
        )
        (HERE / f"{Path(name).stem}-{index:03d}.png").write_bytes(picture)
        sys.stdout.write(f"{title}, {len(found.strays)} of {len(points)} points stray\n")


def count(name: str, cutting: Cutting) -> None:
    """Fit every slice; whatever it raises ends the program."""
    kinds: Counter[str] = Counter()
    totals = Counter[str]()
    for piece in cutting.slices():
        found = resolve_section(planar(piece))
        kinds.update(kind(curve) for curve in found.curves)
        totals.update(
            slices=1,
            empty=not found.curves,
            points=len(piece.points_mm),
            strays=len(found.strays),
            unordered=len(found.unordered),
            failures=len(found.failures),
        )
    sys.stdout.write(f"{name}: {dict(totals)}\n    {dict(kinds)}\n")


def planar(piece: Slice) -> FloatArray:
    """The points of a slice in its plane."""
    return np.ascontiguousarray(piece.frame.to_plane(piece.points_mm)[:, :2])


def tally(curves: tuple[FittedCurve, ...]) -> str:
    """How many of which kind."""
    kinds = Counter(kind(curve) for curve in curves)
    return ", ".join(f"{number} {words}" for words, number in kinds.items())


def kind(curve: FittedCurve) -> str:
    """A curve in two words; a question mark where the points cannot tell whether it is closed."""
    ends = "closed" if curve.closed else "open"
    return f"{ends}{'?' if curve.ambiguous else ''} {curve.kind}"


if __name__ == "__main__":
    main()
