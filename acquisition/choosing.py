"""The slices of an adaptive scan, one by one: the coarse ones, then those that are asked for.

::

    coarse slices --> folder --> reconstruction --> NAME.next.json --> the next slice --> folder ...
                                   (does not answer: the widest span is halved, and that is said)

Nothing here waits for longer than the plan says. A reconstruction that missed its time is waited
for again once its file has changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from acquisition.adaptive_plan import Adaptive
from acquisition.choices import Chosen, ChosenBy, is_ended, write_choice
from acquisition.plan import Plan
from acquisition.scanfile import POLL_S, ScanFolder
from acquisition.slice_request import SliceRequest, decode_request, request_file

Pause = Callable[[float], None]
_BUDGET = "the budget"


@dataclass(slots=True, eq=False)
class NextSlices:
    """Chooses for one run of a scan; called with what waits, it gives the indices in order."""

    plan: Plan
    folder: ScanFolder
    interrupted: Callable[[], bool]  # somebody wants the scan to pause: no more choices
    tell: Callable[[str], None] = lambda _: None
    clock: Callable[[], float] = time.monotonic
    _awake: bool = field(default=True, init=False)  # reconstruction, as far as is known
    _last_seen: tuple[int, int] | None = field(default=None, init=False)

    @property
    def adaptive(self) -> Adaptive:
        """The plan's table."""
        assert self.plan.adaptive is not None  # of a plan that has one
        return self.plan.adaptive

    def __call__(self, pause: Pause) -> Iterator[int]:
        """Give the next slice when the one before is in the folder."""
        begun_s = self.clock()
        while not self.interrupted():
            missing = self.folder.missing()
            if missing:
                yield missing[0]
                continue
            if is_ended(self.folder.path):
                return  # a slice that was damaged was taken again
            chosen = self._chosen(pause, self.clock() - begun_s)
            if chosen is None:
                return
            write_choice(self.folder.path, chosen)
            if chosen.index is None:
                self.tell(f"no more slices: {chosen.why}")
                return
            yield chosen.index

    def _chosen(self, pause: Pause, seconds: float) -> Chosen | None:
        """What comes next; None where somebody interrupted the waiting."""
        there = self.folder.indices()
        adaptive = self.adaptive
        if len(there) >= adaptive.most_slices:
            why = f"there are {len(there)}, and most_slices is {adaptive.most_slices}"
            return Chosen(None, why, _BUDGET, slices=len(there))
        if adaptive.most_s is not None and seconds >= adaptive.most_s:
            why = f"{seconds:.0f} s have gone, and most_s is {adaptive.most_s:g}"
            return Chosen(None, why, _BUDGET, slices=len(there))
        asked = self._asked(there, pause)
        if self.interrupted():
            return None
        if asked is None:
            return self._widest(there)
        by = ChosenBy.RECONSTRUCTION.value
        return Chosen(asked.index, asked.why, by, asked.expected_mm, len(there))

    def _asked(self, there: tuple[int, ...], pause: Pause) -> SliceRequest | None:
        """What reconstruction answers to just these slices, if it does in time."""
        patience_s = self.adaptive.answer_within_s
        deadline_s = self.clock() + patience_s
        while True:
            found = self._read()
            if isinstance(found, SliceRequest) and found.seen == there:
                self._awake = True
                return self._possible(found, there)
            if self.interrupted() or not self._awake or self.clock() >= deadline_s:
                break
            pause(POLL_S)
        if self._awake and not self.interrupted():
            wrong = f" ({found})" if isinstance(found, str) else ""
            self.tell(
                f"reconstruction did not answer within {patience_s:g} s{wrong}: the widest span is"
                " halved until it does; does `loftscan reconstruct"
                f" {self.folder.path.name} --out DIR --follow` run?"
            )
            self._awake = False
        return None

    def _read(self) -> SliceRequest | str | None:
        """The request that is there, or what is wrong with it; None without one."""
        file = request_file(self.folder.path)
        try:
            stamp = file.stat()
            data = file.read_bytes()
        except OSError:
            return None
        seen = (stamp.st_ino, stamp.st_mtime_ns)
        if self._last_seen not in (None, seen):
            self._awake = True  # somebody writes there
        self._last_seen = seen
        try:
            return decode_request(data)
        except ValueError as bad:
            return f"{file.name}: {bad}"

    def _possible(self, asked: SliceRequest, there: tuple[int, ...]) -> SliceRequest | None:
        """The request, if the plan has such a slice and it is not there."""
        if asked.index is None or (asked.index < self.plan.count and asked.index not in there):
            return asked
        self.tell(
            f"reconstruction asks for slice {asked.index}, which is there or not in the plan: the"
            " widest span is halved instead"
        )
        return None

    def _widest(self, there: tuple[int, ...]) -> Chosen:
        """Halve the widest span between two slices."""
        low, high = max(pairwise(there), key=lambda span: span[1] - span[0], default=(0, 0))
        by = ChosenBy.WIDEST.value
        if high - low < 2:
            return Chosen(None, "every place of the plan has its slice", by, slices=len(there))
        assert self.plan.ring is not None  # of an adaptive plan
        step_mm = self.plan.ring.step_mm
        why = f"reconstruction does not answer; a span of {(high - low) * step_mm:g} mm is halved"
        return Chosen((low + high) // 2, why, by, slices=len(there))
