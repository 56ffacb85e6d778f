"""Ctrl-C that compiled code cannot lose.

Python raises KeyboardInterrupt between two bytecodes. Where the next step is a call of compiled
code, numba's dispatcher may meet the exception half-way: it then gives a SystemError instead, or
clears it and goes on as if nobody had pressed a key. So the key is noted as well, and whoever waits
or tells of progress looks.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from loftscan.progress import Progress
from loftscan.signals import heeding


class Interruption:
    """Whether the operator pressed Ctrl-C."""

    def __init__(self) -> None:
        self._came = False

    def hear(self, *_signal: object) -> None:
        """Take note and interrupt, as Python's own handler does; raises KeyboardInterrupt."""
        self._came = True
        raise KeyboardInterrupt

    def look(self) -> None:
        """Interrupt if the key was pressed and nothing came of it; raises KeyboardInterrupt."""
        if self._came:
            raise KeyboardInterrupt

    def pausing(self, pause: Callable[[float], None] = time.sleep) -> Callable[[float], None]:
        """Look before each pause of somebody who waits."""

        def paused(seconds: float) -> None:
            self.look()
            pause(seconds)

        return paused

    def heeding(self, progress: Progress) -> Progress:
        """Look at every step that is told."""

        def told(stage: str, done: int, total: int) -> None:
            self.look()
            progress(stage, done, total)

        return told


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Note Ctrl-C while the block lasts, unless somebody else hears or ignores it.

    What compiled code makes of a key that was pressed leaves the block as KeyboardInterrupt, for
    whoever catches that.
    """
    interruption = Interruption()
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield interruption
        return
    with heeding({signal.SIGINT: interruption.hear}):
        try:
            yield interruption
        except SystemError:
            interruption.look()
            raise
