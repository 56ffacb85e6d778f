"""Calibrations of crooked stations, many seeds: are the standard deviations what they say.

    python -m tests.campaigns.calibrating [--seeds 100] [--first 0]

Each seed is another noise (sigma 10 um) on the scan of three balls and a plate, and another error
of the certificate (1 um on each spacing), by a station with
its axis tilted 1 degree and 2 mm aside, the table's scale 3 % off and the sheet yawed 1 degree. A
pull is (found - true) / its standard deviation. It exits 1 when, pooled over the parameters, more
than 1 % of the pulls lie beyond 3 or their mean square is not within 0.8 to 1.2, or when a
calibration fails.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from acquisition.errors import AcquisitionError
from loftscan.calibrating.joint import calibrate
from loftscan.calibrating.model import PARAMETERS
from tests.loftscan.calibration_cases import NOMINAL, balls, balls_seen
from tests.loftscan.naive_station import Crooked


def pulls_of(seed: int) -> tuple[np.ndarray, list[float]]:
    """Pulls of all parameters, and those of the held-out spacings."""
    station = Crooked()
    found = calibrate(balls_seen(station, seed), NOMINAL, balls(certificate_seed=seed))
    truth = station.truth()
    sd = np.sqrt(np.diag(found.solution.covariance))
    assert found.verdict.observable
    pulls = [(found.solution.at[k] - truth[name]) / sd[k] for k, name in enumerate(PARAMETERS)]
    return np.array(pulls), [(c.found_mm - c.certified_mm) / c.sd_mm for c in found.checks]


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="calibrating")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    wanted = parser.parse_args(words)
    pulls, held, failed = [], [], 0
    for seed in range(wanted.first, wanted.first + wanted.seeds):
        try:
            own, checks = pulls_of(seed)
        except AcquisitionError as refused:
            sys.stdout.write(f"seed {seed}: {refused}\n")
            failed += 1
            continue
        pulls.append(own)
        held += checks
        sys.stdout.write(f"seed {seed}: largest pull {np.abs(own).max():.2f}\n")
        sys.stdout.flush()
    table = np.array(pulls)
    for name, column in zip(PARAMETERS, table.T, strict=True):
        sys.stdout.write(
            f"{name:20s} mean {column.mean():+.2f} mean square {np.mean(column**2):.2f}\n"
        )
    square, beyond = float(np.mean(table**2)), float(np.mean(np.abs(table) > 3.0))
    sys.stdout.write(
        f"{len(table)} seeds, {failed} failed; mean square {square:.3f}, beyond 3 sd {beyond:.2%},"
        f" held out: mean square {np.mean(np.square(held)):.2f} of {len(held)}\n"
    )
    return int(failed > 0 or beyond > 0.01 or not 0.8 <= square <= 1.2)


if __name__ == "__main__":
    sys.exit(main())
