"""Topology: how often the right loops and runs are found, judged by who knows the outlines.

    python benchmarks/topology.py [loops] [outliers] [sets] [foreign] [speed] [--seeds N] [--jobs J]

Points at random places of an outline, uniform across it over the full band, shuffled. A chain is
right if it is the only one of its outline, is closed where that is, and runs along it once within a
band (tests/reconstruction/topology_judge.py). "Sure" are the right ones that are not said to be
ambiguous; "unsure" are those that could not tell, and said nothing that is wrong. The outlines
blob2 and simple are read from LOFTSCAN_DATA.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from reconstruction.fitting.topology import find_chains
from tests.reconstruction import topology_shapes as shapes
from tests.reconstruction.topology_cases import (
    EVEN,
    Outline,
    Uneven,
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
SIXTH = ("circle", "ellipse", "simple")  # of which a loop is asked for even without 60 degrees
HEAD = (f"{'':24}{'band':>5}{'pts/mm':>7}{'gap':>5}{'N':>5}"
        f"{'right':>7}{'sure':>6}{'unsure':>7}{'wrong':>6}  %")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Case:
    """A row of a table."""

    name: str
    outlines: Outline | Sequence[Outline]
    band_mm: float
    per_mm: float
    gap_degrees: float = 0.0
    outliers: float = 0.0
    uneven: Uneven = EVEN
    bound: float = 0.0  # share that is asked for; 0: nothing is
    unsure: bool = False  # whether it will do not to be able to tell


def tried(case: Case, seed: int) -> Verdict:
    """The verdict on one cloud."""
    made = scene(case.outlines, np.random.default_rng(seed), per_mm=case.per_mm,
                 band_mm=case.band_mm, gap_degrees=case.gap_degrees, outliers=case.outliers,
                 uneven=case.uneven)  # fmt: skip
    return judge(find_chains(made.points_mm), made)


def rows(cases: Sequence[Case], seeds: int, pool: Executor) -> Iterator[str]:
    """Lines of a table, and at last how many rows keep their bound."""
    yield HEAD
    kept = asked = 0
    totals: Counter[Answer] = Counter()
    for case in cases:
        verdicts = list(pool.map(partial(tried, case), range(seeds), chunksize=5))
        answers = Counter(verdict.answer for verdict in verdicts)
        totals += answers
        good = answers[Answer.RIGHT] + (answers[Answer.AMBIGUOUS] if case.unsure else 0)
        asked += case.bound > 0.0
        kept += case.bound > 0.0 and good >= case.bound * seeds
        yield row(case, verdicts, answers, good)
    line = f"{'all':41}{sum(totals.values()):5}{totals[Answer.RIGHT]:7}" + " " * 6
    line += f"{totals[Answer.AMBIGUOUS]:7}{totals[Answer.WRONG]:6}"
    yield f"{line}   {kept} of {asked} rows keep their bound"


def row(case: Case, verdicts: list[Verdict], answers: Counter[Answer], good: int) -> str:
    """A line of a table."""
    seeds = len(verdicts)
    sure = sum(verdict.answer is Answer.RIGHT and not verdict.doubted for verdict in verdicts)
    line = f"{case.name:24}{case.band_mm:5}{case.per_mm:7.0f}{case.gap_degrees:5.0f}{seeds:5}"
    line += (
        f"{answers[Answer.RIGHT]:7}{sure:6}{answers[Answer.AMBIGUOUS]:7}{answers[Answer.WRONG]:6}"
    )
    if case.bound:
        line += f"  {100 * good / seeds:.1f} (at least {100 * case.bound:.0f})"
    return line + "".join(
        f"  [{seed}: {verdict.why}]"
        for seed, verdict in enumerate(verdicts) if verdict.answer is Answer.WRONG
    )[:90]  # fmt: skip


def loops() -> list[Case]:
    """The five outlines with and without gaps."""
    return [
        Case(name, outline, band, per, gap, bound=0.99, unsure=gap > 30 and name not in SIXTH)
        for gap in (0.0, 20.0, 60.0)
        for name, outline in campaign_shapes().items()
        for band, per in SETTINGS
    ]


def outliers() -> list[Case]:
    """The same with 2 % of the points anywhere in twice the bounding box."""
    return [replace(case, outliers=0.02, bound=0.98) for case in loops()]


def sets() -> list[Case]:
    """Several loops, and runs that are none."""
    found = []
    for band, per in SETTINGS:
        found += [
            Case("annulus", [ellipse(50, 50), ellipse(30, 30)], band, per, bound=0.99),
            Case("tube and handle", [ellipse(40, 40), ellipse(9, 6, (58, 0))], band, per,
                 bound=0.99),
            Case("three discs",
                 [ellipse(25, 25), ellipse(15, 15, (60, 0)), ellipse(20, 10, (10, 60))],
                 band, per, bound=0.99),
            Case("open L", corner(), band, per, bound=0.99),
            Case("open S", letter_s(20), band, per, bound=0.99),
            Case("ends past each other", overlapping(5 * band), band, per, bound=0.99),
            Case("S round its own middle", shapes.tight_s(band), band, per, bound=0.99),
            Case("arc of 300 degrees", arc(50, 300), band, per, bound=0.99, unsure=True),
        ]  # fmt: skip
    return sorted(found, key=lambda case: case.name)


def foreign() -> list[Case]:
    """Outlines and scanners that nobody asked about: no bound, only the figures."""
    found = []
    for band, per in SETTINGS:
        for times in (3, 4, 6):
            apart = times * band
            found += [
                Case(f"concentric, {times} bands", shapes.concentric(apart), band, per),
                Case(f"side by side, {times} bands", shapes.side_by_side(apart), band, per),
                Case(f"spiral, {times} bands", shapes.spiral(apart), band, per),
                Case(f"slot, {times} bands", shapes.slot(apart), band, per),
                Case(f"clamp, {times} bands", shapes.clamp(apart), band, per),
                Case(f"fins, {times} bands", shapes.fins(2 * apart), band, per),
            ]
        plain = (shapes.gear, shapes.rosette, shapes.beam, shapes.box, shapes.star, shapes.heart,
                 shapes.airfoil, shapes.plate)  # fmt: skip
        found += [Case(make.__name__, make(), band, per) for make in plain]
        for name in ("circle", "superformula"):
            outline = campaign_shapes()[name]
            found += [Case(f"{name}, {words}", outline, band, per, uneven=uneven)
                      for words, uneven in UNEVEN.items()]  # fmt: skip
        found += [
            Case(
                "gear, dropouts", shapes.gear(), band, per, uneven=Uneven(dropouts=20, dropout_mm=4)
            ),
            Case("star", shapes.star(), band, per, 20.0),
            Case(
                "annulus, 5 % outliers",
                [ellipse(50, 50), ellipse(30, 30)],
                band,
                per,
                outliers=0.05,
            ),
        ]
    return sorted(found, key=lambda case: case.name)


UNEVEN = {
    "density 1:10": Uneven(sparsest=0.1),
    "one half 1:10": Uneven(sparsest=0.1, stepped=True),
    "band 1:4": Uneven(narrowest=0.25),
    "20 dropouts": Uneven(dropouts=20, dropout_mm=5.0),
    "6 long dropouts": Uneven(dropouts=6, dropout_mm=15.0),
}


def speed(_seeds: int, _pool: Executor) -> Iterator[str]:
    """Processor time of one slice of 360 profiles of 1280 points."""
    yield "460 800 shuffled points to chains, processor time of one core after warm-up, of 15, ms"
    yield f"{'':24}{'band':>5}{'median':>8}{'best':>8}  (the whole section: 65)"
    for name, outline in campaign_shapes().items():
        for band in (0.5, 2.0):
            made = scene(outline, np.random.default_rng(0), per_mm=460_800 / outline.length_mm,
                         band_mm=band)  # fmt: skip
            times = [seconds(lambda points=made.points_mm: find_chains(points)) for _ in range(16)]
            yield f"{name:24}{band:5}{1e3 * np.median(times[1:]):8.1f}{1e3 * min(times[1:]):8.1f}"


def seconds(work: Callable[[], object]) -> float:
    """Processor time."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def table(cases: Callable[[], list[Case]], seeds: int, pool: Executor) -> Iterator[str]:
    """Title and lines."""
    yield f"{cases.__name__}: {cases.__doc__}"
    yield from rows(cases(), seeds, pool)


TABLES = {"speed": speed} | {
    cases.__name__: partial(table, cases) for cases in (loops, outliers, sets, foreign)
}


def main() -> None:
    """Print the tables asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=list(TABLES))
    parser.add_argument("--seeds", type=int, default=20, help="clouds of each kind (campaign: 200)")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.jobs) as pool:
        for name in asked.tables:
            for line in TABLES[name](asked.seeds, pool):
                print(line, flush=True)
            print()


if __name__ == "__main__":
    main()
