"""Writes a .scan folder as a scan would, from the slices of another; run as a program.

``slow_writer.py SOURCE TARGET PAUSE_S [KEPT]`` waits, appends a slice, and so on. With KEPT it
writes so many and then waits to be killed, its lock held, as a program does amid a slice. Each
acknowledged slice is a line on stdout.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder

_UNTIL_KILLED_S = 120.0


def write(source: ScanFolder, target: Path, pause_s: float, kept: int | None) -> None:
    record = replace(source.record(), state=State.SCANNING)
    with ScanFolder.create(target, record) as writer:
        for index in record.indices:
            if index == kept:
                time.sleep(_UNTIL_KILLED_S)
            time.sleep(pause_s)
            writer.append(source.read(index))
            print(index, flush=True)  # noqa: T201
        writer.finish(State.COMPLETE)


if __name__ == "__main__":
    write(
        ScanFolder.open(Path(sys.argv[1])),
        Path(sys.argv[2]),
        float(sys.argv[3]),
        int(sys.argv[4]) if len(sys.argv) > 4 else None,
    )
