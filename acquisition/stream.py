"""A buffer between two stages of a stream: the one thread of the scan process.

So that fitting or a slow disk never stalls the profiler. The laws, each with its test: no more than
`capacity` items wait; order is kept; an error of the source crosses in order, after the items
before it; leaving the loop stops the source at its next item; the thread never outlives its block.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from threading import Condition, Thread
from typing import Generic, TypeVar

T = TypeVar("T")


def buffered(
    source: Generator[T], capacity: int, *, leaving: Callable[[], None] = lambda: None
) -> Iterator[T]:
    """Run `source` in a thread, at most `capacity` items ahead.

    Parameters
    ----------
    leaving
        Called when the consumer leaves before the end, so that a source amid a long item gives it
        up: for a scan, its `StopRequest.now`. What the source raises after that, nobody hears.

    Raises
    ------
    Exception
        Whatever the source raised, after the items that it gave before.
    """
    if capacity < 1:
        raise ValueError(f"buffered: a capacity of {capacity}; it must be 1 or more")
    return _buffered(source, _Channel[T](capacity), leaving)


def _buffered(
    source: Generator[T], channel: _Channel[T], leaving: Callable[[], None]
) -> Iterator[T]:
    failure: list[Exception] = []

    def pump() -> None:
        try:
            with closing(source):
                while channel.has_room():
                    try:
                        item = next(source)
                    except StopIteration:
                        break
                    channel.put(item)
        # The one broad except of this repository: whatever it is, the consumer raises it.
        except Exception as error:  # noqa: BLE001
            failure.append(error)
        finally:
            channel.end()

    thread = Thread(target=pump, name="buffered")
    thread.start()
    try:
        yield from channel.items()
    except BaseException:
        leaving()
        raise
    finally:
        channel.leave()
        thread.join()
    if failure:
        raise failure[0]


class _Channel(Generic[T]):
    """What waits between the two; either end may say that it is done."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[T] = deque()
        self._changed = Condition()
        self._ended = False
        self._left = False

    def has_room(self) -> bool:
        """Wait until one more may be put; no, when the consumer has left."""
        with self._changed:
            self._changed.wait_for(lambda: self._left or len(self._items) < self._capacity)
            return not self._left

    def put(self, item: T) -> None:
        with self._changed:
            self._items.append(item)
            self._changed.notify_all()

    def items(self) -> Iterator[T]:
        """Give what is put, until the source has ended and nothing waits."""
        while self._has_items():
            with self._changed:
                item = self._items.popleft()
                self._changed.notify_all()
            yield item

    def end(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def leave(self) -> None:
        with self._changed:
            self._left = True
            self._changed.notify_all()

    def _has_items(self) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self._ended or bool(self._items))
            return bool(self._items)
