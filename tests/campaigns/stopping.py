"""Every way to stop a scan, at random instants, judged by the witness log.

    python -m tests.campaigns.stopping [--runs 20] [--seed 1] [--scale 8] [--kinds NAME,NAME]
                                       [--owners 300] [--devices NAME,NAME] [--jobs 3]

A simulated station runs as a process, and so does each scan. Each kind strikes scans of its own:
what one stop leaves is resumed, and that is struck, too, until the scan is whole. The table has the
worst of each kind: how long after the stop the laser was on and an axis moved, and what became of
the slices. Then programs that only hold a station are struck, at rest, in motion and with the laser
on, in every way that a program ends (`tests.campaigns.deaths`): so many of each at the first of the
devices that switch a laser, a tenth of that at the others. It exits 1 when a bound is broken.
docs/safety.md says what the bounds are.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from acquisition.plan import Plan, Ring, StepAndShoot
from loftscan import simulate
from loftscan.simulation import Simulated
from tests.campaigns.death_table import DEVICES, all_deaths
from tests.campaigns.kinds import KINDS, Kind
from tests.campaigns.struck_scan import Outcome, StruckScan
from tests.campaigns.victims import instants

PLAN = Plan(
    ring=Ring(first_mm=6.0, last_mm=10.0, step_mm=2.0, profiles_per_turn=4),
    step_and_shoot=StepAndShoot(settle_s=0.05),
)
_MOST_UNSTRUCK = 10  # scans that are over before their instant, beside as many as are struck
_HEAD = (
    "kind", "N", "lit", "moving", "laser ms", "bound", "axes ms", "bound", "lost", "twice", "exits"
)  # fmt: skip
_WIDTHS = (14, 4, 5, 8, 10, 7, 9, 7, 6, 7, 12)


def strike_often(
    kind: Kind, station: Simulated, folder: Path, *, runs: int, seed: int
) -> tuple[list[Outcome], list[str]]:
    """Strike so many scans; what came of each, and what was wrong with whole ones."""
    drawn = instants([seed, *kind.name.encode()])
    outcomes: list[Outcome] = []
    broken: list[str] = []
    scan = StruckScan(station, PLAN, folder / "0")
    for number in range(1, 2 * runs + _MOST_UNSTRUCK):
        outcome = scan.strike(kind, next(drawn))
        outcomes += [] if outcome is None else [outcome]
        if len(outcomes) == runs:
            break
        if scan.failed or not scan.missing:
            broken += scan.finish()
            scan = StruckScan(station, PLAN, folder / str(number))
    else:
        broken.append(f"only {len(outcomes)} of {runs} instants were met")
    broken += scan.finish()
    return outcomes, [f"{kind.name}: {what}" for what in broken]


def row(kind: Kind, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    """One line of the table: the worst of a kind."""
    codes = [outcome.code for outcome in outcomes]
    return (
        kind.name,
        str(len(outcomes)),
        str(sum(outcome.was_lit for outcome in outcomes)),
        str(sum(outcome.was_moving for outcome in outcomes)),
        _in_ms(max((outcome.laser_s for outcome in outcomes), default=None)),
        _in_ms(kind.laser_s),
        _in_ms(max((outcome.axes_s for outcome in outcomes), default=None)),
        _in_ms(kind.axes_s),
        str(sum(len(outcome.lost) for outcome in outcomes)),
        str(sum(len(outcome.twice) for outcome in outcomes)),
        " ".join(f"{code}:{codes.count(code)}" for code in sorted(set(codes))),
    )


def _in_ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1000.0 * seconds:.0f}"


def _tell(cells: Sequence[str]) -> None:
    first, *rest = (cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    sys.stdout.write(" ".join((first.strip().ljust(_WIDTHS[0]), *rest)) + "\n")
    sys.stdout.flush()


def main(words: Sequence[str] | None = None) -> int:
    """Run the campaign; 1 when a bound was broken."""
    parser = _parser()
    wanted = parser.parse_args(words)
    kinds = [kind for kind in KINDS if not wanted.kinds or kind.name in wanted.kinds.split(",")]
    if wanted.runs <= 0:
        kinds = []
    elif wanted.kinds and len(kinds) != len(wanted.kinds.split(",")):
        parser.error(f"--kinds: known are {', '.join(kind.name for kind in KINDS)}")
    with suppress(PermissionError):
        os.nice(-5)  # so that what is measured is the program, not its neighbours
    sys.stdout.write(
        f"{wanted.runs} instants each, seed {wanted.seed}, {wanted.scale:g} times real time,"
        f" load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n"
    )
    if kinds:
        _tell(_HEAD)
    found: list[str] = []
    for kind in kinds:
        found += _one_kind(kind, wanted)
    if wanted.owners:
        found += all_deaths(
            wanted.devices.split(","),
            wanted.owners,
            ways=wanted.ways.split(",") if wanted.ways else (),
            seed=wanted.seed,
            jobs=wanted.jobs,
        )
    sys.stdout.write("".join(f"broken: {each}\n" for each in found))
    sys.stdout.write(f"load {os.getloadavg()[0]:.1f}; {len(found)} bounds broken\n")
    return 1 if found else 0


def _one_kind(kind: Kind, wanted: argparse.Namespace) -> list[str]:
    """Run one kind against a station of its own, tell its row; what was broken."""
    with (
        tempfile.TemporaryDirectory(prefix="loftscan-safety-") as folder,
        simulate("cylinder", scale=wanted.scale, seed=wanted.seed, faults=wanted.faults) as station,
    ):
        outcomes, broken = strike_often(
            kind, station, Path(folder), runs=wanted.runs, seed=wanted.seed
        )
    _tell(row(kind, outcomes))
    return [what for outcome in outcomes for what in outcome.complaints()] + broken


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="stopping", description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=20, help="instants of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=8.0, help="of the station's time")
    parser.add_argument("--faults", default="", help="of the station, as `python -m sim` has them")
    parser.add_argument("--owners", type=int, default=300, help="deaths of each kind; 0: none")
    parser.add_argument("--devices", default=DEVICES, help="that switch the laser, a comma list")
    parser.add_argument("--ways", default="", help="only these deaths, by name, a comma list")
    parser.add_argument("--jobs", type=int, default=3, help="stations at a time")
    parser.add_argument("--kinds", default="", help="only these, by name, a comma list")
    return parser


if __name__ == "__main__":
    sys.exit(main())
