"""Frames of the SICK Profiler 2: those of the manual that verify, and anything a wire can bring."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.sick.wire import Decoder, Frame, Size, check_of, encoded, memory_read

# The manual's request examples, byte for byte; its other published frames break its own rules.
PRINTED = [
    ("02 00 40 0B 03 4B", Frame(0x400B)),
    ("02 02 40 0B 03 06 20 00 03 6C", Frame(0x400B, bytes.fromhex("03062000"))),
    ("02 03 00 02 03 06 20 00 01 11 03 34", memory_read(0x03062000, 1, Size.WORD)),
    ("02 03 00 02 03 06 20 04 7E 21 03 7F", memory_read(0x03062004, 126, Size.POINT)),
    ("02 03 00 02 03 06 20 04 7E 22 03 7C", memory_read(0x03062004, 126, Size.POINT, 2)),
]


@pytest.mark.parametrize(("text", "frame"), PRINTED)
def test_the_manuals_frames_are_written_and_read_byte_for_byte(text: str, frame: Frame) -> None:
    data = bytes.fromhex(text)
    assert encoded(frame) == data
    assert list(Decoder().feed(data)) == [frame]


@pytest.mark.parametrize("text", ["02 01 00 05 03 04", "02 01 00 02 68 00 10 0E 03 4C"])
def test_published_frames_that_break_the_manuals_rules_are_not_taken(text: str) -> None:
    decoder = Decoder()
    data = bytes.fromhex(text)
    assert [*decoder.feed(data), *decoder.flush()] == []
    assert decoder.dropped == len(data)


def test_what_no_frame_holds_is_the_callers_mistake() -> None:
    for bad in ((0x10000, b""), (1, b"odd"), (1, bytes(512))):
        with pytest.raises(ValueError, match="sick"):
            Frame(*bad)
    for bad in ((-1, 1, Size.WORD, 1), (0, 127, Size.POINT, 1), (0, 1, Size.POINT, 16)):
        with pytest.raises(ValueError, match="sick"):
            memory_read(*bad)


frames = st.builds(
    Frame, st.integers(0, 0xFFFF), st.binary(max_size=40).map(lambda b: b[: len(b) // 2 * 2])
)


@given(frames, st.integers(0, 10_000))
def test_one_wrong_bit_is_never_another_frame(frame: Frame, at: int) -> None:
    """A wrong bit shows in the check or moves ETX; a shorter frame within would need both again."""
    bad = bytearray(encoded(frame))
    bad[at // 8 % len(bad)] ^= 1 << at % 8
    decoder = Decoder()
    found = [*decoder.feed(bytes(bad)), *decoder.flush()]
    assert all(len(encoded(each)) < len(bad) for each in found)  # within its data, no other whole


def test_random_frames_pass_once_in_65536() -> None:
    """N = 2 000 000 random tails behind STX, length 0: ETX and check must both be right, so that
    30.5 are due, sigma is 5.5; five sigma either way."""
    dice = random.Random(22)
    decoder, passed = Decoder(), 0
    for _ in range(20):
        tails = dice.randbytes(400_000)
        for k in range(0, len(tails), 4):
            tail = tails[k : k + 4]
            passed += tail[2] == 3 and check_of(b"\0" + tail[:2]) == tail[3]
    assert 3 <= passed <= 58
    assert list(decoder.feed(b"\x02\x00\x40\x0b\x03\x4b")) == [Frame(0x400B)]


def test_of_random_bytes_few_are_frames_and_none_answers_a_question() -> None:
    """N = 3 000 000 bytes: an STX comes in 256, its ETX and check in 65536: 0.18 frames are due,
    and 5 or more by a chance below 1e-5. With the right command and length: 2**-24 of those."""
    dice = random.Random(23)
    decoder = Decoder()
    found = [
        frame for _ in range(300) for frame in decoder.feed(dice.randbytes(10_000))
    ]  # fmt: skip
    assert len(found) < 5
    assert not [each for each in found if each.command == 0x0002 and len(each.data) == 504]


chunks = st.lists(st.integers(1, 9), min_size=1, max_size=20)
noise = st.binary(max_size=16).map(lambda data: data.replace(b"\x02", b"\x00"))


class Hearing(RuleBasedStateMachine):
    """Frames between noise, in any chunks: every whole one is heard, in order, and no other.

    Noise without an STX costs nothing at once; noise with one holds back until the line is quiet.
    """

    def __init__(self) -> None:
        super().__init__()
        self.decoder = Decoder()
        self.sent: list[Frame] = []
        self.heard: list[Frame] = []

    def say(self, data: bytes, sizes: list[int]) -> None:
        while data:
            size = sizes[0]
            sizes = [*sizes[1:], size]
            self.heard += self.decoder.feed(data[:size])
            data = data[size:]

    @rule(before=noise, frame=frames, after=noise, cut=chunks)
    def a_frame(self, before: bytes, frame: Frame, after: bytes, cut: list[int]) -> None:
        self.sent.append(frame)
        self.say(before + encoded(frame) + after, cut)

    @rule(data=noise, cut=chunks)
    def garbage(self, data: bytes, cut: list[int]) -> None:
        self.say(data, cut)

    @rule(claims=st.integers(1, 255), data=noise, frame=frames, cut=chunks)
    def a_false_beginning(self, claims: int, data: bytes, frame: Frame, cut: list[int]) -> None:
        """An STX that is none, then a whole frame, then silence."""
        self.sent.append(frame)
        self.say(bytes([2, claims]) + data + encoded(frame), cut)
        self.heard += self.decoder.flush()

    @rule(frame=frames, kept=st.integers(1, 100), cut=chunks)
    def torn(self, frame: Frame, kept: int, cut: list[int]) -> None:
        """A frame that breaks off, then silence."""
        whole = encoded(frame)
        within = Decoder()
        part = whole[: min(kept, len(whole) - 1)]
        self.sent += [*within.feed(part), *within.flush()]  # frames in its data
        self.say(part, cut)
        self.heard += self.decoder.flush()

    @invariant()
    def nothing_lost_and_nothing_made_up(self) -> None:
        assert self.heard == self.sent


TestHearing = Hearing.TestCase
TestHearing.settings = settings(max_examples=80, stateful_step_count=25, deadline=None)
