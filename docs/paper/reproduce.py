"""Make the paper's figures again, and the page that compares them.

    python docs/paper/reproduce.py

Everything is seeded: the same program makes the same bytes. The exit code is 1 where a bound that
must hold does not.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import circles
import page
import plates
import solids
import views
from matplotlib.figure import Figure

from loftscan.figures import png

_SCATTERED_POINTS = 20_000


def main() -> int:
    """Write the pictures and README.md beside this file, or where `--out` says."""
    here = Path(__file__).parent
    parser = argparse.ArgumentParser(description="Make the paper's figures and their page.")
    parser.add_argument("--out", type=Path, default=here, help="folder to write to")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    found = measure()
    for number, figure in draw(found):
        (out / f"figure-{number:02d}.png").write_bytes(png(figure))
        print(f"figure {number}")
    (out / "README.md").write_text(page.compose(found), encoding="utf-8")
    bounds = page.check(found)
    for words, holds in bounds:
        print("holds:" if holds else "DOES NOT HOLD:", words)
    return 0 if all(holds for _, holds in bounds) else 1


def measure() -> page.Findings:
    """Run every case."""
    cylinder = solids.reconstruct_cylinder()
    cone = solids.reconstruct_cone(solids.make_cone())
    scattered = solids.reconstruct_cone(solids.make_scattered_cone(_SCATTERED_POINTS))
    return page.Findings(
        walks=circles.study_walks(),
        shown=plates.figure_6_trials(),
        pairs=plates.count_pairs(),
        cylinder=cylinder,
        cylinder_rows=solids.tabulate_cylinder(cylinder),
        cone=cone,
        cone_rows=solids.tabulate_cone(cone),
        scattered=scattered,
        scattered_rows=solids.tabulate_cone(scattered),
    )


def draw(found: page.Findings) -> Iterator[tuple[int, Figure]]:
    """Draw the figures under the paper's numbers."""
    yield 1, plates.figure_1()
    yield 2, plates.figure_2()
    yield 3, plates.figure_3()
    yield 5, plates.figure_5()
    yield 6, plates.figure_6(*found.shown)
    yield 7, views.figure_7(found.cylinder)
    yield 8, views.figure_8(found.cylinder)
    yield 9, views.figure_9(found.cone)
    yield 10, views.figure_10(found.cone)
    yield 11, views.figure_11(found.cone)


if __name__ == "__main__":
    raise SystemExit(main())
