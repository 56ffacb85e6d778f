"""Signals, heard where a station can be brought to rest, never amid a word to a device.

A handler that raises does so between any two bytecodes: in the middle of "laser off" as well. So
handlers here take note, and whoever waits looks (every 50 ms at most)::

    a command   `heeding`: SIGINT asks, SIGTERM and SIGHUP stop; nothing is raised at all
    a script    `Attention`: at work the signal waits for the rest, between works it acts at once

Only Python's main thread hears signals; elsewhere both change nothing.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from signal import SIGHUP, SIGINT, SIGTERM, Signals
from threading import current_thread, get_ident, main_thread
from types import FrameType
from typing import TypeVar

from acquisition.errors import Stopped
from acquisition.scan import StopRequest

ENDING = (SIGINT, SIGTERM, SIGHUP)

Value = TypeVar("Value")
Handler = Callable[[int, FrameType | None], object]
_Former = Handler | int | None


@contextmanager
def heeding(handlers: Mapping[Signals, Handler]) -> Iterator[None]:
    """Have these handlers while the block lasts; a SIGHUP that `nohup` ignores stays ignored."""
    wanted = {
        number: handler
        for number, handler in handlers.items()
        if number is not SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    with _installed(wanted):
        yield


@contextmanager
def _installed(handlers: Mapping[Signals, Handler]) -> Iterator[None]:
    former: dict[Signals, _Former] = {}
    try:
        if current_thread() is main_thread():
            for number, handler in handlers.items():
                former[number] = signal.signal(number, handler)
        yield
    finally:
        for number, before in former.items():
            # None: not installed by Python, which cannot bring it back.
            signal.signal(number, signal.SIG_DFL if before is None else before)


class Attention:
    """Keeps signals back while a script's station is at work, and passes them on afterwards.

    Passing on is what the script would have had without us: its own handler is called, Python's
    raises KeyboardInterrupt; where nothing but death was in store, SystemExit lets the blocks end.
    """

    def __init__(self) -> None:
        self._work: StopRequest | None = None
        self._worker = 0
        self._heard: Signals | None = None
        self._former: dict[Signals, Handler | None] = {}

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Hear signals while the block lasts, except those that are ignored."""
        for number in ENDING:
            before = signal.getsignal(number)
            if callable(before) or before is signal.SIG_DFL:
                self._former[number] = before if callable(before) else None
        with _installed(dict.fromkeys(self._former, self._hear)):
            yield

    @contextmanager
    def at_work(self, stop: StopRequest) -> Iterator[None]:
        """While the block lasts a signal only asks `stop`; it is passed on at the block's end.

        What a device had to complain of comes first: then the signal is but a note of it.
        """
        self._begin(stop)
        try:
            yield
        except Stopped:
            self._end()
            raise
        except BaseException as failed:
            self._work = None
            if self._heard:
                failed.add_note(f"{self._heard.name} came meanwhile")
            self._heard = None
            raise
        self._end()

    @contextmanager
    def shielding(self, context: AbstractContextManager[Value]) -> Iterator[Value]:
        """Enter and leave a context whole: a signal meanwhile waits until that is done."""
        nobody = StopRequest()
        with self.at_work(nobody), context as value:
            try:
                self._end()
                yield value
            finally:
                self._begin(nobody)

    def _begin(self, stop: StopRequest) -> None:
        self._worker = get_ident()
        self._work = stop

    def _end(self) -> None:
        self._work = None
        heard, self._heard = self._heard, None
        if heard is not None:
            self._pass_on(heard, None)

    def _hear(self, number: int, frame: FrameType | None) -> None:
        if self._work is not None:
            self._work.now()
            if self._worker == get_ident():
                self._heard = Signals(number)
                return
        self._pass_on(Signals(number), frame)

    def _pass_on(self, number: Signals, frame: FrameType | None) -> None:
        handler = self._former[number]
        if handler is None:
            raise SystemExit(128 + number)
        handler(number, frame)
