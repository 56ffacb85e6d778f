"""Topology: how often the right loops and runs are found, judged by those who know the outlines.

    python benchmarks/topology.py [loops] [outliers] [sets] [foreign] [speed] [--seeds N] [--jobs J]

Points at random places of an outline, uniform across it over the full band, shuffled. A chain is
right if it is the only one of its outline, closed where that is, and runs along it once within a
band (tests/reconstruction/topology_judge.py). "Sure" are the right ones that are not said to be
ambiguous; "unsure" could not tell, and said nothing that is wrong. The outlines blob2 and simple are read from LOFTSCAN_DATA.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from reconstruction.fitting.topology import find_chains
from tests.reconstruction.topology_cases import (
    Outline,
    arc,
    campaign_shapes,
    corner,
    ellipse,
    letter_s,
    overlapping,
    scene,
)
from tests.reconstruction.topology_judge import Answer, Verdict, judge

SETTINGS = list(product((0.5, 2.0), (5.0, 40.0)))  # full band in mm, points per mm
SIXTH = ("circle", "ellipse", "simple")  # of which even 60 degrees may be missing


@dataclass(frozen=True, slots=True)
class Case:
    """A row of the table, but for the seeds."""

    name: str
    outlines: Sequence[Outline]
    band_mm: float
    per_mm: float
    gap_degrees: float = 0.0
    outliers: float = 0.0


def run(case: Case, seed: int) -> Verdict:
    rng = np.random.default_rng(seed)
    made = scene(case.outlines, rng, per_mm=case.per_mm, band_mm=case.band_mm,
                 gap_degrees=case.gap_degrees, outliers=case.outliers)  # fmt: skip
    return judge(find_chains(made.points_mm), made)
