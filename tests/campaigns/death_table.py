"""The campaign of deaths: every device, every way, so many owners each; a line a way."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path

import numpy as np

from loftscan import simulate
from tests.campaigns.deaths import (
    DEATHS,
    OF_THE_HARDWARE,
    Death,
    End,
    failure_bound,
    instants,
    owners,
    strike,
)

DEVICES = "plain,grbl,plain-tcp,turck,timed,plain-9600,hokuyo"
_OTHERS, _FEWEST = 10, 30  # of the devices after the first: a tenth, and at least so many
_OF_THE_HARDWARE = 30  # they wait for time-outs of seconds
SCALE = 8.0
_HEAD = (
    "device", "way", "N", "lit", "laser max", "p99", "bound", "axes max", "stalled", "failed",
    "rate below",
)  # fmt: skip
_WIDTHS = (11, 17, 5, 5, 10, 7, 7, 9, 8, 7, 11)


def all_deaths(
    devices: Sequence[str], runs: int, *, ways: Sequence[str], seed: int, jobs: int
) -> list[str]:
    """Let owners die at every device, in all ways or those named; tell a table; what was broken."""
    _tell(_HEAD)
    found: list[str] = []
    for number, device in enumerate(devices):
        count = runs if number == 0 else min(runs, max(_FEWEST, runs // _OTHERS))
        found += _one_device(device, count, ways, seed, jobs)
    return found


def _one_device(device: str, count: int, ways: Sequence[str], seed: int, jobs: int) -> list[str]:
    """Deal the owners out to stations of their own."""
    wished = [(death, count) for death in DEATHS]
    if device == "turck":
        wished += [(death, min(count, _OF_THE_HARDWARE)) for death in OF_THE_HARDWARE]
    wished = [(death, number) for death, number in wished if not ways or death.name in ways]
    cards = [
        (death, phase, delay_s)
        for death, number in wished
        for phase, delay_s in islice(instants([seed, *death.name.encode()]), number)
    ]
    with ThreadPoolExecutor(jobs) as pool:
        hands = [cards[job::jobs] for job in range(jobs)]
        ends = [end for dealt in pool.map(lambda hand: _play(device, hand), hands) for end in dealt]
    for death, _ in wished:
        _tell(_row(device, death, [end for end in ends if end.death is death]))
    return [f"{device}: {what}" for end in ends for what in end.complaints()]


def _play(device: str, cards: Sequence[tuple[Death, str, float]]) -> list[End]:
    own = "hokuyo" if device == "hokuyo" else None  # a scanner lights its own laser
    with (
        tempfile.TemporaryDirectory(prefix="loftscan-safety-") as folder,
        simulate("cylinder", scale=SCALE, seed=1, laser=device, profiler=own) as station,
        owners(Path(folder)) as by,
    ):
        # A simulator compiles with its first picture, and hears nobody meanwhile.
        strike(DEATHS[0], "exposing", 0.5, station, by)
        return [strike(*card, station, by) for card in cards]


def _row(device: str, death: Death, ends: Sequence[End]) -> tuple[str, ...]:
    dark_ms = [1000.0 * end.laser_s for end in ends if end.was_lit]
    axes_ms = max((1000.0 * end.axes_s for end in ends), default=0.0)
    failed = sum(bool(end.broken) for end in ends)
    return (
        device,
        death.name,
        str(len(ends)),
        str(len(dark_ms)),
        *_of_those(dark_ms),
        f"{1000.0 * max((end.bound_s for end in ends), default=0.0):.0f}",
        f"{axes_ms:.0f}",
        str(sum(end.stalled for end in ends)),
        str(failed),
        f"{100.0 * failure_bound(failed, len(ends)):.1f} %",
    )


def _of_those(dark_ms: Sequence[float]) -> Iterator[str]:
    """The worst, and what all but a hundredth keep, of those that were lit when struck."""
    yield f"{max(dark_ms):.0f}" if dark_ms else "-"
    yield f"{np.percentile(dark_ms, 99):.0f}" if dark_ms else "-"


def _tell(cells: Sequence[str]) -> None:
    words = (cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    sys.stdout.write(" ".join(words) + "\n")
    sys.stdout.flush()
