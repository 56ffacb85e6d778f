"""An operator's script that fails: as if its own code raised while the laser is on.

    python -m tests.campaigns.verbs_script STATION PLAN OUT READS

The profiles' link raises at the read of that number, 0 never; every read of it is inside an
exposure. What is kept is told, and the moment of the failure, a JSON object a line.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from drivers.links import ByteLink, open_link
from loftscan import Station, scan


class PlannedFailureError(Exception):
    """Of no kind that any package knows."""


class FailingLink:
    """A link that fails the reader with an error that is not its own."""

    def __init__(self, link: ByteLink, reads: int) -> None:
        self._link = link
        self._left = reads
        self.address = link.address
        self.write = link.write
        self.close = link.close

    def read(self, timeout_s: float) -> bytes:
        self._left -= 1
        if self._left == 0:
            tell(event="raised", time_s=time.monotonic())
            raise PlannedFailureError
        return self._link.read(timeout_s)


def tell(**fields: object) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def main(station_file: str, plan_file: str, out: str, reads: str) -> None:
    def links(address: str) -> ByteLink:
        link = open_link(address)
        return FailingLink(link, int(reads)) if address.startswith("udp:") else link

    tell(event="estimate")
    resume = (Path(out) / "scan.json").exists()
    with Station.open(station_file, links=links) as station:
        for sweep in scan(station, plan_file, out=out, resume=resume):
            tell(event="slice", index=sweep.index)


if __name__ == "__main__":
    main(*sys.argv[1:])
