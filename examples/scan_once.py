"""Scan one part, slice by slice.

    python scan_once.py STATION.toml PLAN.toml NAME.scan

Ctrl-C ends it with the laser off and the axes stopped; what was kept can be resumed.
"""

import sys

from loftscan import Station, scan


def scan_once(station_file: str, plan_file: str, out: str) -> None:
    """Scan a plan into a new folder, which grows slice by slice."""
    with Station.open(station_file) as station:  # laser off, axes stopped on every way out
        sweeps = scan(station, plan_file, out=out)
        for sweep in sweeps:  # each is safe on the disk before it comes here
            points = sum(len(profile.points_mm) for profile in sweep.profiles)
            print(f"slice {sweep.index + 1} of {sweeps.total}: {points} points")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    scan_once(*sys.argv[1:])
