"""LZF: the streaming kernel against the format's description, executed naively."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.clouds.lzf import unpacked
from reconstruction.clouds.source import Damaged


def naive_unpack(packed: bytes) -> bytes:
    """The table of the module's docstring, byte by byte."""
    out = bytearray()
    stream = iter(packed)
    for control in stream:
        if control < 0b00100000:
            out.extend(next(stream) for _ in range(control + 1))
            continue
        length = control >> 5
        if length == 7:
            length += next(stream)
        back = ((control & 0b11111) << 8) + next(stream) + 1
        for _ in range(length + 2):
            out.append(out[-back])
    return bytes(out)


def lzf_pack(data: bytes) -> bytes:
    """A greedy compressor: the last place of each three bytes, if it is near enough."""
    out, literals, at = bytearray(), bytearray(), 0
    places: dict[bytes, int] = {}

    def flush() -> None:
        for first in range(0, len(literals), 32):
            run = literals[first : first + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    while at < len(data):
        key = data[at : at + 3]
        place = places.get(key)
        places[key] = at
        if len(key) < 3 or place is None or at - place > 8192:
            literals.append(data[at])
            at += 1
            continue
        flush()
        length = 3
        while (
            length < 264 and at + length < len(data) and data[place + length] == data[at + length]
        ):
            length += 1
        back = at - place - 1
        if length < 9:
            out.extend([(length - 2) << 5 | back >> 8, back & 255])
        else:
            out.extend([7 << 5 | back >> 8, length - 9, back & 255])
        at += length
    flush()
    return bytes(out)


def streamed(packed: bytes, sizes: list[int]) -> bytes:
    def blocks() -> Iterator[bytes]:
        at = turn = 0
        while at < len(packed):
            size = sizes[turn % len(sizes)]
            yield packed[at : at + size]
            at, turn = at + size, turn + 1

    return b"".join(piece.tobytes() for piece in unpacked(blocks()))


repetitive = st.lists(
    st.tuples(st.binary(min_size=1, max_size=40), st.integers(1, 60)), max_size=12
).map(lambda parts: b"".join(text * times for text, times in parts))
block_sizes = st.lists(st.integers(1, 400), min_size=1, max_size=5)


@given(repetitive, block_sizes)
@settings(max_examples=80, deadline=None)
def test_what_was_packed_comes_back_however_the_stream_is_cut(
    data: bytes, sizes: list[int]
) -> None:
    packed = lzf_pack(data)
    assert naive_unpack(packed) == data
    assert streamed(packed, sizes) == data


def test_a_long_stream_with_far_references_comes_back() -> None:
    rng = np.random.default_rng(3)
    words = [rng.bytes(40) for _ in range(210)]  # 8400 bytes: some are out of reach, some are not
    data = b"".join(words[choice] for choice in rng.integers(0, 210, 20_000))
    packed = lzf_pack(data)
    assert len(packed) < 0.7 * len(data)
    assert streamed(packed, [70_001]) == data == naive_unpack(packed)


@given(st.binary(max_size=300), block_sizes)
@settings(max_examples=200, deadline=None)
def test_any_bytes_unpack_as_the_naive_twin_says_or_are_damaged(
    packed: bytes, sizes: list[int]
) -> None:
    try:
        expected = naive_unpack(packed)
    except (IndexError, RuntimeError):  # before the start; or next() at the stream's end
        expected = None
    except StopIteration:
        expected = None
    if expected is None:
        with pytest.raises(Damaged, match="packed data"):
            streamed(packed, sizes)
    else:
        assert streamed(packed, sizes) == expected


def test_a_reference_to_before_the_start_is_damage() -> None:
    with pytest.raises(Damaged, match="damaged"):
        streamed(bytes([0, 65, 1 << 5, 1]), [100])
