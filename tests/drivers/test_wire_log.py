"""A wire log holds every byte, can be read back, and replays as a test."""

from __future__ import annotations

import io
import itertools
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import LinkLost
from drivers.loopback import loopback
from drivers.modbus import ModbusBus
from drivers.wire_log import (
    Direction,
    TranscriptDiffers,
    WireRecord,
    logged,
    parse_wire_log,
    read_wire_log,
    replayed,
)

# A read of the Leadshine motion status 0x1003, idle after a move (hardware.md 3.1): the request and
# its reply written by hand from the register table, the CRC by the specification's loop.
GOLDEN = """\
# loftscan wire log: serial:///dev/ttyUSB0
1.000000 > 07 03 10 03 00 01 70 ac  # ....p.
1.004200 < 07 03 02  # ...

1.004900 < 00 32 b1 91  # .2..
"""

repeatable = settings(deadline=None, derandomize=True)
chunks = st.lists(st.tuples(st.booleans(), st.binary(min_size=1, max_size=12)), max_size=20)


class OnlyWhenWaited:
    """A clock that a replay's wait advances."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s

    def wait(self, seconds: float) -> None:
        self.now_s += seconds


@repeatable
@given(chunks)
def test_what_passes_is_in_the_log_in_order(passing: list[tuple[bool, bytes]]) -> None:
    near, far = loopback(wait=lambda _: None)
    times = itertools.count(1)
    text = io.StringIO()
    link = logged(near, text, lambda: float(next(times)))
    for sent, data in passing:
        if sent:
            link.write(data)
            assert far.read(0.0) == data
        else:
            far.write(data)
            assert link.read(0.0) == data
        assert link.read(0.0) == b""
    directions = {True: Direction.SENT, False: Direction.CAME}
    assert parse_wire_log(text.getvalue()) == tuple(
        WireRecord(float(k), directions[sent], data)
        for k, (sent, data) in enumerate(passing, start=1)
    )
    assert text.getvalue().startswith("# loftscan wire log: loopback:near\n")


def test_a_line_is_in_the_file_before_the_next_byte_moves(tmp_path: Path) -> None:
    near, far = loopback(wait=lambda _: None)
    file = tmp_path / "station.log"
    first = logged(near, file, lambda: 1.5)
    first.write(b"?\n")
    assert "1.500000 > 3f 0a  # ?." in file.read_text(encoding="ascii").splitlines()
    first.close()
    with pytest.raises(LinkLost):
        far.write(b"!")
    again = logged(loopback(wait=lambda _: None)[0], file, lambda: 2.5)
    again.write(b"!")
    again.close()
    assert [record.data for record in read_wire_log(file)] == [b"?\n", b"!"]


def test_a_full_disk_ends_the_log_and_not_the_work() -> None:
    class FullDisk(io.StringIO):
        def flush(self) -> None:
            raise OSError(28, "No space left on device")

    near, far = loopback(wait=lambda _: None)
    link = logged(near, FullDisk(), lambda: 0.0)
    link.write(b"laser off")
    assert far.read(0.0) == b"laser off"
    assert "No space" in link.failure


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("1.0 > 3g", "line 2"),
        ("1.0 = 3f", "line 2"),
        ("soon > 3f", "line 2"),
        ("nan > 3f", "no time"),
        ("1.0 >", "line 2"),
        ("1.0 > 3", "line 2"),
    ],
)
def test_a_line_that_is_none_is_named(line: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_wire_log(f"# fine\n{line}\n")


def test_a_torn_last_line_is_not_taken_for_a_shorter_one() -> None:
    with pytest.raises(ValueError, match="torn"):
        parse_wire_log("1.0 > 3f 0a\n2.0 < 3c 49")


def test_a_golden_log_replays_to_the_driver_that_made_it() -> None:
    clock = OnlyWhenWaited()
    with replayed(parse_wire_log(GOLDEN), wait=clock.wait) as link:
        bus = ModbusBus(link, timeout_s=0.1, slowest_reply_s=0.2, clock=clock, sleep=clock.wait)
        assert bus.read_holding(7, 0x1003, 1) == (0x0032,)


def test_a_replay_fails_on_another_write_and_says_both() -> None:
    with replayed(parse_wire_log("1.0 > 3f 0a\n")) as link:
        with pytest.raises(TranscriptDiffers, match=r"wrote 3f 0d, the log has 1.000000 > 3f 0a"):
            link.write(b"?\r")
        link.write(b"?\n")


def test_a_replay_fails_on_a_write_before_what_came_was_read() -> None:
    with replayed(parse_wire_log("1.0 > 41\n2.0 < 42\n3.0 > 43\n")) as link:
        link.write(b"A")
        for early in (b"B", b"C"):
            with pytest.raises(TranscriptDiffers, match=r"the log has 2.000000 < 42"):
                link.write(early)
        assert link.read(0.0) == b"B"
        assert link.read(0.0) == b""
        link.write(b"C")
        with pytest.raises(TranscriptDiffers, match="has None"):
            link.write(b"D")


def test_a_replay_fails_on_unused_lines() -> None:
    with (
        pytest.raises(TranscriptDiffers, match=r"2 lines unused, the next is 2.000000 < 42"),
        replayed(parse_wire_log("1.0 > 41\n2.0 < 42\n3.0 > 43\n")) as link,
    ):
        link.write(b"A")


@repeatable
@given(st.binary(min_size=2, max_size=20), st.data())
def test_a_replay_does_not_mind_how_writes_are_cut(data: bytes, draw: st.DataObject) -> None:
    logged_at, written_at = (draw.draw(st.integers(1, len(data) - 1)) for _ in range(2))
    records = [
        WireRecord(1.0, Direction.SENT, data[:logged_at]),
        WireRecord(2.0, Direction.SENT, data[logged_at:]),
    ]
    with replayed(records) as link:
        link.write(data[:written_at])
        link.write(data[written_at:])


def test_the_drivers_own_error_is_not_masked_by_unused_lines() -> None:
    with (
        pytest.raises(LinkLost, match="the cable"),
        replayed(parse_wire_log("1.0 > 41\n")),
    ):
        raise LinkLost("the cable")
