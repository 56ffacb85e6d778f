"""What truly happened at the station, a line an event, for whoever judges the program under test.

::

    {"time_s": 5021.443, "what": "laser", "on": true, "why": "coil 0"}
    {"time_s": 5021.451, "what": "profile", "frame": 17, "table_rad": 0.5236, "stage_mm": 12.0}
    {"time_s": 5021.460, "what": "move", "axis": "table", "start": 0.52, "target": 1.05,
     "ends_s": 5021.71}
    {"time_s": 5021.502, "what": "stop", "axis": "table", "target": 0.71, "ends_s": 5021.55}

Times are the monotonic clock's, which all processes of one machine share: a test that kills the
program notes the same clock. ``ends_s`` is when the axis stands.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self


class Witness(Protocol):
    """Takes note of what happened."""

    def note(self, time_s: float, what: str, **told: object) -> None:
        """Take note of one event."""
        ...


class Memory:
    """Keeps the events in memory, for tests in one process."""

    def __init__(self) -> None:
        self.events: list[dict[str, object]] = []

    def note(self, time_s: float, what: str, **told: object) -> None:
        """Keep one event."""
        self.events.append({"time_s": time_s, "what": what, **told})


class WitnessLog:
    """Appends to a file, each line at once: nothing is lost when the simulator is killed."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("ab", buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def note(self, time_s: float, what: str, **told: object) -> None:
        """Write one event."""
        line = json.dumps({"time_s": round(time_s, 6), "what": what, **told})
        self._file.write(line.encode() + b"\n")


def read_witness(path: Path) -> list[dict[str, object]]:
    """Read the events of a log; a last line that was cut short is left out."""
    whole = path.read_bytes().rpartition(b"\n")[0]
    return [json.loads(line) for line in whole.splitlines()]
