"""A job for CI: scan a part on simulated hardware, reconstruct it, and hold it against its truth.

    python ci_job.py [PART] [OUT]

PART is a name such as vase, or a mesh file. The station's wires, protocols and timing are those of
hardware, so what changes in a plan or in a control script is tried before it meets the station.
Exit code 1: the result lies farther from the part than LIMIT_MM, as a root mean square.
"""

from __future__ import annotations

import sys

from loftscan import Finished, Station, compare, reconstruct_stream, scan, simulate

LIMIT_MM = 0.2
RINGS, STOPS = 12, 8
FASTER = 40.0  # than real time


def ci_job(part: str, out: str) -> float:
    """Scan, reconstruct while it scans, save; give how far the mesh lies from the truth, rms."""
    with (
        simulate(part, scale=FASTER, rings=RINGS, stops=STOPS) as simulated,
        Station.open(simulated) as station,
    ):
        for update in reconstruct_stream(scan(station, simulated.plan)):
            if isinstance(update, Finished):
                update.result.save(out, overwrite=True)
                wall = update.result.mesh.vertices_mm
        told = compare(wall, simulated.truth)
    rms_mm = told.metrics["rms_mm"]
    assert isinstance(rms_mm, float)
    return rms_mm


if __name__ == "__main__":
    part, out = (*sys.argv[1:3], *["vase", "ci-out"][len(sys.argv[1:3]) :])
    off_mm = ci_job(part, out)
    print(f"{part}: {off_mm:.3f} mm rms from the truth, {LIMIT_MM:g} are allowed")
    sys.exit(0 if off_mm <= LIMIT_MM else 1)
