"""One section: our fit beside the best fixed number of control points, the paper and the peers.

    python benchmarks/sections.py [floor] [recognised] [paper] [peers] [corners] [noise]
                                     [honesty] [speed] [--seeds N]

Every table but where it says "told" goes from shuffled points to curves: which points belong
together, their order and the parametrisation are found by the program. Points lie at arc-uniform
random places of the true outline with isotropic Gaussian noise. Each column says what it must not
exceed. Peers' outlines are read from LOFTSCAN_DATA. What they printed: docs/sections/figures.md.
"""

from __future__ import annotations

import argparse

from section_tables.corners import corners_table, noise_table
from section_tables.floor import floor_table, paper_table, recognised_table
from section_tables.honesty import honesty_table
from section_tables.outlines import outlines
from section_tables.peers import peers_table
from section_tables.speed import speed_table

TABLES = {
    "floor": floor_table,
    "recognised": recognised_table,
    "paper": paper_table,
    "peers": peers_table,
    "corners": corners_table,
    "noise": noise_table,
    "honesty": honesty_table,
    "speed": speed_table,
}


def main() -> None:
    """Print the tables asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", help=f"some of {' '.join(TABLES)}; by default all")
    parser.add_argument("--seeds", type=int, help="instead of each table's own number")
    asked = parser.parse_args()
    unknown = [name for name in asked.tables if name not in TABLES]
    if unknown:
        parser.error(f"no table {', '.join(unknown)}; there are {', '.join(TABLES)}")
    shapes = outlines()
    for name in asked.tables or TABLES:
        for line in TABLES[name](shapes, asked.seeds):
            print(line, flush=True)
        print()


if __name__ == "__main__":
    main()
