"""``--wire-log FILE``: every byte both ways, a file for each link, so that each replays as a test.

::

    --wire-log wire.log     wire-dev-ttyUSB0.log   wire-192.0.2.7-502.log   wire-9009.log
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

from drivers.links import ByteLink, open_link
from drivers.wire_log import LoggedLink, logged


class WireLogs:
    """Opens links that are logged; give `open` to `open_station`."""

    def __init__(
        self,
        file: Path,
        *,
        clock: Callable[[], float] = time.monotonic,
        links: Callable[[str], ByteLink] = open_link,
    ) -> None:
        if not file.parent.is_dir():
            raise ValueError(f"--wire-log {file}: there is no folder {file.parent}; make it first")
        self._file = file
        self._clock = clock
        self._links = links
        self._logs: dict[Path, LoggedLink] = {}

    def open(self, address: str) -> ByteLink:
        """Open a link and append what passes to the log of its address."""
        link = self._links(address)
        file = log_of(self._file, address)
        try:
            self._logs[file] = logged(link, file, self._clock)
        except OSError:
            link.close()
            raise
        return self._logs[file]

    @property
    def files(self) -> tuple[Path, ...]:
        """The logs that were opened."""
        return tuple(self._logs)

    @property
    def failures(self) -> tuple[str, ...]:
        """Which logs end early, and why."""
        return tuple(
            f"{file}: {log.failure}; the log ends early"
            for file, log in self._logs.items()
            if log.failure
        )


def log_of(file: Path, address: str) -> Path:
    """Name the log of an address: what follows the scheme, without options, as a file's name."""
    place = address.partition("://")[2].partition("?")[0]
    name = re.sub(r"[^A-Za-z0-9.]+", "-", place).strip("-")
    return file.with_name(f"{file.stem}-{name}{file.suffix}")
