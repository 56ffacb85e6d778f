"""A program that records a scan of made sweeps, to be killed, starved and cut off.

``... recorder FOLDER SLICES careful|careless AHEAD`` begins the scan or goes on
with it, and says ``kept N`` on stdout when slice N is acknowledged, in one write. The careless one
is without fsync: the campaigns must catch it. AHEAD is how many names are made to last at once.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from acquisition import scanfile
from acquisition.errors import AcquisitionError
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from tests.acquisition.scan_cases import record, sweep


def main(path: Path, slices: int, manner: str, ahead: int) -> None:
    scanfile.AHEAD = ahead
    if manner == "careless":
        os.fsync = lambda _: None
    begun = (path / "scan.json").exists()
    opened = ScanFolder(path).resume() if begun else ScanFolder.create(path, record(slices))
    with opened as writer:
        for index in writer.folder.missing():
            writer.append(sweep(index))
            os.write(1, b"kept %d\n" % index)
        writer.finish(State.COMPLETE)


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    try:
        main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
    except AcquisitionError as failed:
        sys.exit(str(failed))
