r"""What a witness log says of a stop. Pure: its events in, seconds and counts out.

::

    lit      ___/~~~~\_____________________/~~~~\___        from a laser's on to its off
    moving   __________/~~~~~~~~\__________________/~~~~    from a move to its end, or its stop's
                           |<-->|  what a signal here had to wait for

A stop that is sent to an axis at rest is no motion.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Event = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Span:
    """A time in which something lasted."""

    begun_s: float
    ended_s: float = math.inf

    def overlaps(self, other: Span) -> bool:
        return self.begun_s < other.ended_s and other.begun_s < self.ended_s


class Witnessed:
    """The events of a log from a place in it on, read as they are written."""

    def __init__(self, log: Path, *, from_byte: int | None = None) -> None:
        self._log = log
        self._read_bytes = log.stat().st_size if from_byte is None else from_byte
        self.events: list[Event] = []

    def listen(self) -> list[Event]:
        """Take in what is new; all events so far."""
        with self._log.open("rb") as file:
            file.seek(self._read_bytes)
            lines = file.read().rpartition(b"\n")
        self._read_bytes += len(lines[0]) + len(lines[1])
        self.events += [json.loads(line) for line in lines[0].splitlines()]
        return self.events


def read_all(log: Path) -> list[Event]:
    """All events of a log."""
    return Witnessed(log, from_byte=0).listen()


def lit(events: Iterable[Event]) -> list[Span]:
    """When the laser was on; to no end if it still is."""
    spans: list[Span] = []
    for event in events:
        if event["what"] == "laser":
            if event["on"]:
                spans.append(Span(event["time_s"]))
            else:
                spans[-1:] = [Span(spans[-1].begun_s, event["time_s"])] if spans else []
    return spans


def moving(events: Iterable[Event], *axes: str) -> list[Span]:
    """When one of these axes moved."""
    spans: list[Span] = []
    last: dict[str, int] = {}
    for event in events:
        axis = event.get("axis")
        if axis not in axes:
            continue
        if event["what"] == "move":
            last[axis] = len(spans)
            spans.append(Span(event["time_s"], event["ends_s"]))
        elif axis in last and event["time_s"] < spans[last[axis]].ended_s:
            spans[last[axis]] = Span(spans[last[axis]].begun_s, event["ends_s"])
    return spans


def over_after_s(spans: Iterable[Span], since_s: float) -> float:
    """How long after a time the last of the spans was over; 0 if all were."""
    return max([0.0, *(span.ended_s - since_s for span in spans)])


def lasted_at(spans: Iterable[Span], time_s: float) -> bool:
    return any(span.begun_s <= time_s < span.ended_s for span in spans)


def cut_from_the_laser(events: Iterable[Event]) -> list[float]:
    """When the cable of the laser's switch was pulled."""
    return [
        event["time_s"]
        for event in events
        if event["what"] == "wire" and event["fault"] == "unplug" and event["wire"] == "relay"
    ]


def lit_in_motion(events: Sequence[Event]) -> list[Span]:
    """Motions under a laser that was on: step and shoot has none."""
    lights = lit(events)
    both = moving(events, "table", "stage")
    return [span for span in both if any(span.overlaps(light) for light in lights)]


def begun_by_nobody(events: Sequence[Event], dead_s: float, *, heard_s: float) -> list[Event]:
    """Moves that begin after a dead program's last word was heard, or beside that one word.

    A device goes on by itself with its search for home: the axis that moved last may.
    """
    alone_s = dead_s + heard_s
    moves = [event for event in events if event["what"] == "move"]
    before = [event for event in moves if event["time_s"] <= alone_s]
    homing = not any(event["what"] == "laser" for event in events if event["time_s"] <= dead_s)
    own = {before[-1]["axis"]} if homing and before else set()
    heard = [e for e in before if e["time_s"] > dead_s and e["axis"] not in own]
    return heard[1:] + [e for e in moves if e["time_s"] > alone_s and e["axis"] not in own]
