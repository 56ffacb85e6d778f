"""The laws of the one buffer and its one thread. No test waits for a time to pass."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Generator, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.stream import buffered

DEADLINE_S = 20.0  # of waits that end at once unless a law is broken


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    yield
    assert [each.name for each in threading.enumerate() if each.name == "buffered"] == []


def counting(until: int) -> Generator[int]:
    yield from range(until)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers() | st.none()), st.integers(1, 8))
def test_everything_comes_once_and_in_order(items: list[int | None], capacity: int) -> None:
    assert list(buffered((item for item in items), capacity)) == items


@pytest.mark.parametrize("capacity", [1, 3])
def test_the_source_is_never_more_than_the_capacity_ahead(capacity: int) -> None:
    asked = 0
    full = threading.Event()

    def source() -> Generator[int]:
        nonlocal asked
        for number in range(20):
            asked = number + 1
            if asked == capacity + 1:
                full.set()
            yield number

    taken = 0
    for _ in buffered(source(), capacity):
        taken += 1
        assert full.wait(DEADLINE_S)  # it does run ahead, while this loop stands still
        assert asked <= taken + capacity
    assert taken == 20


def test_an_error_of_the_source_comes_after_the_items_before_it() -> None:
    def source() -> Generator[int]:
        yield 1
        yield 2
        raise OSError("the cable is out")

    seen = []
    with pytest.raises(OSError, match="cable"):  # noqa: PT012 (what came before is the point)
        for item in buffered(source(), 8):
            seen.append(item)
    assert seen == [1, 2]


def test_an_error_before_the_first_item_comes_too() -> None:
    def source() -> Generator[int]:
        raise ZeroDivisionError
        yield 1

    with pytest.raises(ZeroDivisionError):
        list(buffered(source(), 2))


def test_leaving_the_loop_closes_the_source_in_its_own_thread() -> None:
    closed_in: list[str] = []

    def source() -> Generator[int]:
        try:
            yield from itertools.count()  # only leaving ends it
        finally:
            closed_in.append(threading.current_thread().name)

    for _ in buffered(source(), 2):
        break
    assert closed_in == ["buffered"]


def test_an_error_of_the_consumer_closes_the_source_and_is_the_one_that_is_raised() -> None:
    closed = threading.Event()

    def source() -> Generator[int]:
        try:
            yield from counting(1000)
        finally:
            closed.set()

    with pytest.raises(KeyError):  # noqa: PT012
        for _ in buffered(source(), 1):
            raise KeyError
    assert closed.is_set()


def test_a_source_amid_a_long_item_hears_that_the_consumer_leaves() -> None:
    left = threading.Event()

    def source() -> Generator[int]:
        yield 1
        assert left.wait(DEADLINE_S)
        raise InterruptedError("gave up, as it was told to")

    for _ in buffered(source(), 1, leaving=left.set):
        break
    assert left.is_set()


def test_nobody_is_told_of_leaving_at_the_end() -> None:
    left = threading.Event()
    assert list(buffered(counting(3), 1, leaving=left.set)) == [0, 1, 2]
    assert not left.is_set()


def test_nothing_runs_before_the_first_item_is_asked_for() -> None:
    started = threading.Event()

    def source() -> Generator[int]:
        started.set()
        yield 1

    stream = buffered(source(), 1)
    assert not started.is_set()
    assert list(stream) == [1]


def test_a_capacity_below_one_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match="1 or more"):
        buffered(counting(1), 0)
