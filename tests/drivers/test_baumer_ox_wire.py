"""The OX200's UDP grammar and register map, against frames laid out by hand from the manual."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from functools import cache
from itertools import chain, pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from drivers.baumer_ox import registers
from drivers.baumer_ox.registers import Device, Quality, Readings
from drivers.baumer_ox.wire import (
    Assembler,
    BadFrame,
    Content,
    Event,
    Gap,
    MeasurementMessage,
    ProfileMessage,
    State,
    encode_measurement,
    encode_profile,
)
from drivers.errors import FrameError

# Laid out by hand from the manual's tables (OX200 V2 pages 35-37), not by our encoder.
Z_SINGLE = bytes.fromhex(
    "0D000000 00 00 0000"  # 0 block 13, 4 single frame, 5 reserved, 6 no count
    "01 00 01 01 00 01"  # 8 Z profile, 9 parametrising, 10 NTP, 11 valid, 12 alarm, 13 weak
    "0000FA43"  # 14 rate 500.0 Hz = 0x43FA0000
    "00F15365 90D00300"  # 18 1 700 000 000 s = 0x6553F100, 22 250 000 us = 0x0003D090
    "3412 03000000"  # 26 encoder 0x1234, 28 three points
    "9CFF A861"  # 32 x -100, z 25 000
    "0000 0000"  # 36 x 0, z 0
    "6400 409C"  # 40 x 100, z 40 000: above 32 767, so z is unsigned
)
# By hand from page 39: content 3, six bytes a point.
Z_I_SINGLE = bytes.fromhex(
    "FFFFFFFF 00 00 0000"  # the last block before the numbers wrap
    "03 01 00 00 01 02"  # Z-I, parametrising, not valid, alarm, no signal
    "0000003F 01000000 3F420F00 FFFF 02000000"  # 0.5 Hz, 1 s, 999 999 us, encoder 65 535, 2
    "0080 0100 E803"  # x -32 768, z 1, intensity 1 000
    "FF7F FFFF 0080"  # x 32 767, z 65 535, intensity 32 768
)
# By hand from page 38: content 2, x and intensity.
I_SINGLE = bytes.fromhex(
    "00000000 00 00 0000"
    "02 00 00 01 00 00 0000FA43 00000000 00000000 0000 01000000"
    "FFFF 00FF"  # x -1, intensity 65 280
)
# By hand after the framing picture on page 35 (block 10, four frames, the later ones 1, 2, 3).
Z_FOUR_FRAMES = [
    bytes.fromhex(text)
    for text in (
        "0A000000 01 00 0400"
        "01 00 00 01 00 00 0000FA43 00000000 00000000 0000 05000000"  # five points
        "F6FF 6400",  # x -10, z 100
        "0A000000 02 00 0100 FBFF C800 0000 2C01",  # x -5, z 200; x 0, z 300
        "0A000000 02 00 0200 0500 90",  # x 5 and the low byte of z 400
        "0A000000 02 00 0300 01 0A00 F401",  # its high byte; x 10, z 500
    )
]
# By hand from page 36: 8 + 50 B.
MEASUREMENT = bytes.fromhex(
    "0E000000 00 00 0000"
    "00 00 01 01 00 00 01 00"  # 0 measured values, 5 quality good, 6 output 1 on, 7 output 2 off
    "00004841 0000A0BF 00000000 0000803F 00000040 00004040 00008040"  # 8 12.5, -1.25, 0..4
    "0000FA43 00F15365 90D00300 0700"  # 36 500 Hz, 40 s, 44 us, 48 encoder 7
)
# By hand from OX200 V2 page 27 and OX100 V2 pages 20-21: input registers 200..223.
READINGS = (
    *(0x0006, 1, 2),  # NTP and valid; weak signal; output 2
    *(0x0FDB, 0x4049),  # 3.14159274 = 0x40490FDB, low word first
    *(0x0000, 0xBFA0),  # -1.25
    *(0xCCCD, 0x3DCC),  # 0.1
    *(0, 0x3F80, 0, 0x4000, 0, 0x4040, 0, 0x4080),  # 1, 2, 3, 4
    *(0x0000, 0x43FA),  # 500 Hz
    *(0xF100, 0x6553, 0xD090, 0x0003, 0),  # s, us, reserved
)
# By hand from page 27: the product's id ends in the high byte of word 4, the type begins below it.
DEVICE = (
    *(0x3131, 0x3231, 0x3233, 0x3435, 0x004F, 0x584D, 0x3230, 0x3000),  # 11212345, OXM200
    *(0,) * 29,
    *(0x3730, 0x3132, 0x4100),  # word 37: 7012A
    *(0,) * 9,
)

STATE = State(
    parametrising=False,
    time_synced=True,
    valid=True,
    alarm=False,
    quality=1,
    rate_hz=500.0,
    seconds=1_700_000_000,
    microseconds=250_000,
    encoder=0x1234,
)


def fed(assembler: Assembler, datagrams: Iterable[bytes]) -> list[Event]:
    return list(chain.from_iterable(assembler.feed(datagram) for datagram in datagrams))


def only_profile(events: Sequence[Event]) -> ProfileMessage:
    (event,) = events
    assert isinstance(event, ProfileMessage)
    return event


def profiles(events: Iterable[Event]) -> list[ProfileMessage]:
    return [event for event in events if isinstance(event, ProfileMessage)]


def message(block: int, n: int = 6, content: Content = Content.Z, seed: int = 0) -> ProfileMessage:
    rng = np.random.default_rng((seed, block, n))
    x = rng.integers(-32768, 32768, n).astype(np.int16)
    z, intensity = rng.integers(1, 65536, (2, n)).astype(np.uint16)
    nothing = np.empty(0, dtype=np.uint16)
    return ProfileMessage(
        block,
        STATE,
        content,
        x,
        z if content is not Content.INTENSITY else nothing,
        intensity if content is not Content.Z else nothing,
        np.ones(n, dtype=bool),
    )


def same(left: ProfileMessage, right: ProfileMessage) -> bool:
    scalars = ("block", "state", "content")
    return all(getattr(left, name) == getattr(right, name) for name in scalars) and all(
        np.array_equal(getattr(left, name), getattr(right, name))
        for name in ("x", "z", "intensity", "arrived")
    )


def stream(blocks: Iterable[int]) -> list[bytes]:
    return [datagram for block in blocks for datagram in sent_block(block)]


@cache
def sent_block(block: int) -> list[bytes]:
    return encode_profile(message(block))


# A busy machine is no failure.
quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
contents = st.sampled_from([Content.Z, Content.INTENSITY, Content.Z_AND_INTENSITY])


def test_a_z_block_laid_out_by_hand_reads_to_its_values() -> None:
    read = only_profile(fed(Assembler(), [Z_SINGLE]))
    assert (read.block, read.state, read.content) == (13, STATE, Content.Z)
    assert read.x.tolist() == [-100, 0, 100]
    assert read.z.tolist() == [25_000, 0, 40_000]
    assert read.intensity.shape == (0,)
    assert not read.torn


def test_a_z_i_block_laid_out_by_hand_reads_to_its_values() -> None:
    read = only_profile(fed(Assembler(), [Z_I_SINGLE]))
    assert (read.block, read.content) == (0xFFFFFFFF, Content.Z_AND_INTENSITY)
    assert read.state == State(True, False, False, True, 2, 0.5, 1, 999_999, 65_535)  # noqa: FBT003
    assert read.x.tolist() == [-32_768, 32_767]
    assert read.z.tolist() == [1, 65_535]
    assert read.intensity.tolist() == [1_000, 32_768]


def test_an_intensity_block_laid_out_by_hand_has_no_z() -> None:
    read = only_profile(fed(Assembler(), [I_SINGLE]))
    assert read.content is Content.INTENSITY
    assert (read.x.tolist(), read.z.tolist(), read.intensity.tolist()) == ([-1], [], [65_280])


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 3, 1, 2), (3, 2, 1, 0)])
def test_four_frames_laid_out_by_hand_make_one_profile_in_any_order(order: Sequence[int]) -> None:
    read = only_profile(fed(Assembler(), [Z_FOUR_FRAMES[index] for index in order]))
    assert read.block == 10
    assert read.x.tolist() == [-10, -5, 0, 5, 10]
    assert read.z.tolist() == [100, 200, 300, 400, 500]


def test_measured_values_laid_out_by_hand_read_to_their_values() -> None:
    (read,) = fed(Assembler(), [MEASUREMENT])
    assert isinstance(read, MeasurementMessage)
    assert (read.block, read.outputs) == (14, (True, False))
    assert read.values == (12.5, -1.25, 0.0, 1.0, 2.0, 3.0, 4.0)
    assert (read.state.rate_hz, read.state.seconds, read.state.microseconds) == (
        500.0,
        1_700_000_000,
        250_000,
    )
    assert (read.state.encoder, read.state.time_synced, read.state.alarm) == (7, True, False)


def test_the_encoder_writes_the_frames_that_were_laid_out_by_hand() -> None:
    for frame in (Z_SINGLE, Z_I_SINGLE, I_SINGLE):
        assert encode_profile(only_profile(fed(Assembler(), [frame]))) == [frame]
    (measured,) = fed(Assembler(), [MEASUREMENT])
    assert isinstance(measured, MeasurementMessage)
    assert encode_measurement(measured) == MEASUREMENT


def test_a_long_profile_is_cut_into_frames_of_1400_bytes_as_the_sensor_does() -> None:
    frames = encode_profile(message(7, n=1280))
    assert [len(frame) for frame in frames] == [1400, 1400, 1400, 8 + 24 + 4 * 1280 - 3 * 1392]
    assert [frame[4] for frame in frames] == [1, 2, 2, 2]  # first, consecutive
    assert [frame[6] for frame in frames] == [4, 1, 2, 3]  # the count, then the indices
    assert all(frame[:4] == b"\x07\0\0\0" for frame in frames)


def test_frames_1400_bytes_long_are_single_and_one_point_more_makes_two() -> None:
    fits = (1392 - 24) // 4
    assert [len(frame) for frame in encode_profile(message(0, n=fits))] == [1400]
    assert len(encode_profile(message(0, n=fits + 1))) == 2


@quick
@given(st.integers(0, 2**32 - 1), st.integers(0, 400), contents, st.integers(32, 1500), st.data())
def test_a_block_survives_any_cutting_reordering_and_duplication(
    block: int, n: int, content: Content, frame_bytes: int, data: st.DataObject
) -> None:
    sent = message(block, n, content)
    frames = encode_profile(sent, frame_bytes=frame_bytes)
    assert max(map(len, frames)) <= frame_bytes
    again = data.draw(st.lists(st.sampled_from(frames), max_size=5))
    shuffled = random.Random(data.draw(st.integers(0, 99))).sample(
        frames + again, len(frames + again)
    )
    assembler = Assembler()
    read = only_profile(fed(assembler, shuffled))
    assert same(read, sent)
    assert encode_profile(read, frame_bytes=frame_bytes) == frames
    assert assembler.ignored == len(again)


def naive_arrived(frames: Sequence[bytes], lost: set[int], size: int, n: int) -> list[bool]:
    """Byte by byte: a point has arrived when all its bytes did."""
    came = [index not in lost for index, frame in enumerate(frames) for _ in frame[8:]]
    return [all(came[24 + size * point : 24 + size * (point + 1)]) for point in range(n)]


@quick
@given(st.integers(20, 200), contents, st.integers(33, 120), st.data())
def test_a_block_that_lost_frames_keeps_the_places_of_what_is_missing(
    n: int, content: Content, frame_bytes: int, data: st.DataObject
) -> None:
    sent = message(5, n, content)
    frames = encode_profile(sent, frame_bytes=frame_bytes)
    lost = data.draw(
        st.sets(st.integers(1, len(frames) - 1), min_size=1) if frames[1:] else st.none()
    )
    if lost is None:
        return
    kept = [frame for index, frame in enumerate(frames) if index not in lost]
    random.Random(data.draw(st.integers(0, 99))).shuffle(kept)
    assembler = Assembler()
    assert fed(assembler, kept) == []
    read = only_profile(list(assembler.flush()))
    size = 6 if content is Content.Z_AND_INTENSITY else 4
    assert read.torn
    assert read.state == STATE
    assert read.arrived.tolist() == naive_arrived(frames, lost, size, n)
    for name in ("x", "z", "intensity"):
        got, expected = getattr(read, name), getattr(sent, name)
        if len(expected):
            assert np.array_equal(got, np.where(read.arrived, expected, 0))


def test_frames_of_odd_lengths_around_one_hole_stand_where_they_belong() -> None:
    assembler = Assembler()
    fed(assembler, [Z_FOUR_FRAMES[0], Z_FOUR_FRAMES[2], Z_FOUR_FRAMES[3]])
    read = only_profile(list(assembler.flush()))
    assert read.arrived.tolist() == [True, False, False, True, True]
    assert read.z.tolist() == [100, 0, 0, 400, 500]


def test_half_a_point_is_no_point() -> None:
    assembler = Assembler()
    fed(assembler, Z_FOUR_FRAMES[:3])
    read = only_profile(list(assembler.flush()))
    assert read.arrived.tolist() == [True, True, True, False, False]
    assert read.x.tolist() == [-10, -5, 0, 0, 0]


def test_blocks_13_14_19_lost_four() -> None:
    events = fed(Assembler(), stream([13, 14, 19]))
    assert [type(event) for event in events] == [
        ProfileMessage,
        ProfileMessage,
        Gap,
        ProfileMessage,
    ]
    assert events[2] == Gap(first=15, lost=4)


def test_the_numbering_wraps_without_a_gap_and_a_gap_across_the_wrap_is_counted() -> None:
    top = 2**32
    assert len(profiles(fed(Assembler(), stream([top - 2, top - 1, 0, 1])))) == 4
    events = fed(Assembler(), stream([top - 2, 3]))
    assert events[1] == Gap(first=top - 1, lost=4)
    events = fed(Assembler(), stream([top - 1, 3]))
    assert events[1] == Gap(first=0, lost=3)


def test_the_next_block_ends_a_torn_one_and_its_late_frames_are_ignored() -> None:
    first, second = encode_profile(message(1), frame_bytes=40), encode_profile(message(2))
    assembler = Assembler()
    events = fed(assembler, [*first[:-1], *second, first[-1]])
    torn, whole = profiles(events)
    assert len(events) == 2
    assert (torn.block, torn.torn) == (1, True)
    assert same(whole, message(2))
    assert assembler.ignored == 1


def test_a_block_without_its_first_frame_is_lost_as_a_whole() -> None:
    frames = encode_profile(message(2), frame_bytes=40)
    events = fed(Assembler(), [*stream([1]), *frames[1:], *stream([3])])
    assert [event for event in events if isinstance(event, Gap)] == [Gap(2, 1)]
    assert [event.block for event in profiles(events)] == [1, 3]


def test_the_rest_of_a_block_that_was_joined_late_is_no_loss() -> None:
    frames = encode_profile(message(2), frame_bytes=40)
    assembler = Assembler()
    assert [type(event) for event in fed(assembler, [*frames[1:], *stream([3])])] == [
        ProfileMessage
    ]
    assert assembler.ignored == len(frames) - 1


def test_measured_values_share_the_numbering_of_the_profiles() -> None:
    events = fed(Assembler(), [Z_SINGLE, MEASUREMENT, *stream([15])])
    assert not [event for event in events if isinstance(event, Gap)]


@quick
@given(st.lists(st.sampled_from(["came", "lost", "twice", "torn", "beheaded"]), max_size=40))
def test_every_block_between_the_first_and_the_last_is_delivered_or_counted(
    fates: list[str],
) -> None:
    assembler, events = Assembler(), fed(Assembler(), [])
    events += fed(assembler, stream([99]))
    for block, fate in enumerate(fates, start=100):
        frames = encode_profile(message(block), frame_bytes=40)
        kept = {
            "came": frames,
            "lost": [],
            "twice": frames + frames,
            "torn": frames[:1] + frames[2:],
            "beheaded": frames[1:],
        }
        events += fed(assembler, kept[fate])
    events += fed(assembler, stream([100 + len(fates)]))
    delivered = profiles(events)
    assert [p.block for p in delivered if p.torn] == [
        block for block, fate in enumerate(fates, start=100) if fate == "torn"
    ]
    lost = sum(event.lost for event in events if isinstance(event, Gap))
    assert lost == fates.count("lost") + fates.count("beheaded")
    assert len(delivered) + lost == len(fates) + 2
    assert all(before.block < after.block for before, after in pairwise(delivered))


def test_a_sensor_that_restarts_its_numbering_is_heard_again() -> None:
    assembler = Assembler()
    fed(assembler, stream(range(5000, 5010)))
    events = fed(assembler, stream(range(20)))
    assert [event.block for event in profiles(events)] == list(range(7, 20))
    assert not [event for event in events if isinstance(event, Gap)]
    assert assembler.restarts == 1


def test_a_jump_of_more_than_an_hour_is_another_numbering_and_no_loss() -> None:
    for block in (2**25, 2**31, 2**32 - 2**25):
        events = fed(Assembler(), stream([5, block]))
        assert [event.block for event in profiles(events)] == [5, block]
        assert len(events) == 2


def test_a_block_that_is_repeated_for_ever_is_no_restart() -> None:
    assembler = Assembler()
    events = fed(assembler, [*stream(range(10)), *stream([3]) * 50])
    assert len(profiles(events)) == 10
    assert (assembler.restarts, assembler.ignored) == (0, 50)


@pytest.mark.parametrize(
    ("damaged", "why"),
    [
        (b"", "0 B"),
        (Z_SINGLE[:8], "8 B"),
        (Z_SINGLE[:-1], "35 B in the first of 1 for 36 B"),
        (Z_SINGLE + b"\0", "37 B in the first of 1 for 36 B"),
        (Z_SINGLE[:20], "no head"),
        (Z_SINGLE[:4] + b"\1\0\2\0" + Z_SINGLE[8:], "36 B in the first of 2 for 36 B"),
        (Z_SINGLE[:4] + b"\3" + Z_SINGLE[5:], "frame type 3"),
        (Z_SINGLE[:8] + b"\4" + Z_SINGLE[9:], "content 4"),
        (Z_SINGLE[:28] + b"\0\0\0\x01" + Z_SINGLE[32:], "16777216 points"),
        (Z_FOUR_FRAMES[0][:6] + b"\0\0" + Z_FOUR_FRAMES[0][8:], "first of 0"),
        (Z_FOUR_FRAMES[1][:6] + b"\0\0" + Z_FOUR_FRAMES[1][8:], "index 0"),
        (MEASUREMENT[:-1], "49 B in the first of 1 for 50 B"),
        (MEASUREMENT[:4] + b"\1\0\2\0" + MEASUREMENT[8:-9], "measured values in 2 frames"),
    ],
)
def test_a_datagram_that_breaks_the_grammar_says_how_and_disturbs_nothing(
    damaged: bytes, why: str
) -> None:
    assembler = Assembler()
    fed(assembler, stream([12]))
    (bad,) = fed(assembler, [damaged])
    assert isinstance(bad, BadFrame)
    assert why in bad.reason
    only_profile(fed(assembler, [Z_SINGLE]))  # block 13, no gap


def test_a_frame_beyond_the_count_is_bad_and_the_block_still_completes() -> None:
    beyond = bytes.fromhex("0A000000 02 00 0400 0000")
    events = fed(Assembler(), [Z_FOUR_FRAMES[0], beyond, *Z_FOUR_FRAMES[1:]])
    assert [type(event) for event in events] == [BadFrame, ProfileMessage]


def test_a_block_of_the_wrong_length_is_bad_and_shows_as_a_gap() -> None:
    longer = Z_FOUR_FRAMES[3] + b"\0"
    assembler = Assembler()
    events = fed(assembler, [*stream([9]), *Z_FOUR_FRAMES[:3], longer, *stream([11])])
    assert [type(event) for event in events[1:]] == [BadFrame, Gap, ProfileMessage]
    assert events[2] == Gap(10, 1)


@pytest.mark.parametrize("surplus", [8, 9, 40])
def test_frames_that_leave_no_place_for_the_lost_one_are_bad(surplus: int) -> None:
    assembler = Assembler()
    fed(assembler, [Z_FOUR_FRAMES[0], Z_FOUR_FRAMES[2], Z_FOUR_FRAMES[3] + bytes(surplus)])
    assert [type(event) for event in assembler.flush()] == [BadFrame]


def test_a_frame_between_two_holes_is_lost_where_the_frames_are_of_odd_lengths() -> None:
    whole = encode_profile(message(1, n=40))[0]
    cuts = [8, 36, 44, 84, 112, 192]  # the first frame holds 28 B, the third of five 40
    first = whole[:4] + b"\1\0\5\0" + whole[8:36]
    rest = [
        whole[:4] + bytes([2, 0, index, 0]) + whole[cuts[index] : cuts[index + 1]]
        for index in range(1, 5)
    ]
    assembler = Assembler()
    fed(assembler, [first, rest[0], rest[2]])
    read = only_profile(list(assembler.flush()))
    assert read.arrived.tolist() == [True] * 3 + [False] * 37


def test_a_block_never_holds_more_than_its_largest_body() -> None:
    assembler = Assembler()
    piece = bytes(60_000)
    headers = [bytes.fromhex("05000000 02 00") + i.to_bytes(2, "little") for i in range(1, 50)]
    events = fed(assembler, [header + piece for header in headers])
    assert {type(event) for event in events} == {BadFrame}
    assert len(events) == 49 - (24 + 6 * 65_536) // 60_000


frames_alike = st.builds(
    lambda block, kind, number, body: (
        block.to_bytes(4, "little") + bytes([kind, 0]) + number.to_bytes(2, "little") + body
    ),
    st.integers(0, 2**32 - 1) | st.integers(95, 105),
    st.integers(0, 3),
    st.integers(0, 4) | st.integers(0, 65_535),
    st.binary(max_size=60)
    | st.builds(lambda head, rest: head + rest, st.just(Z_SINGLE[8:32]), st.binary(max_size=20)),
)


@quick
@given(st.lists(st.binary(max_size=80) | frames_alike, max_size=30))
def test_after_any_bytes_the_stream_is_heard_again_within_ten_blocks(rubbish: list[bytes]) -> None:
    assembler = Assembler()
    fed(assembler, [*stream([100]), *rubbish])
    events = fed(assembler, stream(range(101, 121)))
    assert [event.block for event in profiles(events)][-10:] == list(range(111, 121))


@quick
@given(st.lists(st.tuples(st.integers(0, 11), st.integers(0, 60), st.integers(1, 255)), max_size=8))
def test_bits_that_flip_raise_nothing(flips: list[tuple[int, int, int]]) -> None:
    frames = [
        bytearray(f) for block in (7, 8, 9) for f in encode_profile(message(block), frame_bytes=40)
    ]
    for index, at, mask in flips:
        frame = frames[index % len(frames)]
        frame[at % len(frame)] ^= mask
    assembler = Assembler()
    events = fed(assembler, map(bytes, frames)) + list(assembler.flush())
    assert len(profiles(events)) <= len(frames)
    if not flips:
        assert [event.block for event in profiles(events)] == [7, 8, 9]


def test_a_torn_block_cannot_be_sent_and_a_count_beyond_its_type_is_refused() -> None:
    assembler = Assembler()
    fed(assembler, Z_FOUR_FRAMES[:3])
    torn = only_profile(list(assembler.flush()))
    with pytest.raises(ValueError, match="torn"):
        encode_profile(torn)
    with pytest.raises(ValueError, match="32 B is the least"):
        encode_profile(message(1), frame_bytes=31)
    with pytest.raises(ValueError, match=r"z: 0 to 65536 is beyond uint16"):
        ProfileMessage(1, STATE, Content.Z, [0, 0], [0, 65_536], [], [True, True])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"x: -32769 to 0 is beyond int16"):
        ProfileMessage(1, STATE, Content.Z, [-32_769, 0], [0, 0], [], [True, True])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"\(1,\) z, not \(2,\)"):
        ProfileMessage(1, STATE, Content.Z, [0, 0], [0], [], [True, True])  # type: ignore[arg-type]


def test_registers_laid_out_by_hand_read_to_their_values() -> None:
    read = registers.readings(READINGS)
    assert (read.parametrising, read.time_synced, read.valid, read.alarm) == (
        False,
        True,
        True,
        False,
    )
    assert (read.quality, read.outputs) == (Quality.WEAK_SIGNAL, (False, True))
    assert read.values == pytest.approx((3.14159274, -1.25, 0.1, 1, 2, 3, 4), rel=1e-7)
    assert (read.rate_hz, read.seconds, read.microseconds) == (500.0, 1_700_000_000, 250_000)
    assert registers.readings_words(read) == READINGS


@pytest.mark.parametrize(
    ("word", "name"), [(1, "parametrising"), (2, "time_synced"), (4, "valid"), (8, "alarm")]
)
def test_each_bit_of_the_status_has_its_name(word: int, name: str) -> None:
    read = registers.readings((word, *READINGS[1:]))
    names = ("parametrising", "time_synced", "valid", "alarm")
    assert [each for each in names if getattr(read, each)] == [name]


def test_32_bit_registers_agree_with_pymodbus_low_word_first() -> None:
    convert, types = ModbusClientMixin.convert_from_registers, ModbusClientMixin.DATATYPE
    read = registers.readings(READINGS)
    values = [
        convert(list(READINGS[at : at + 2]), types.FLOAT32, word_order="little")
        for at in range(3, 19, 2)
    ]
    assert [*read.values, read.rate_hz] == values
    assert read.seconds == convert(list(READINGS[19:21]), types.UINT32, word_order="little")


def test_the_device_is_read_across_the_word_that_two_texts_share() -> None:
    who = Device(product_id="11212345", sensor_type="OXM200", serial="7012A")
    assert registers.device(DEVICE) == who
    assert registers.device_words(who) == DEVICE
    assert registers.device(registers.device_words(Device("123456789", "", ""))).product_id == (
        "123456789"
    )


def test_the_vendor_is_read_up_to_its_end() -> None:
    words = (0x4261, 0x756D, 0x6572, *(0,) * 30)  # "Baumer", two characters a word
    assert registers.vendor(words) == "Baumer"
    assert registers.vendor_words("Baumer") == words


def test_a_text_that_is_no_ascii_is_shown_and_not_believed() -> None:
    assert registers.vendor((0x42FF, *(0,) * 32)) == "B\\xff"


def test_a_quality_that_the_manual_does_not_know_is_a_frame_error() -> None:
    with pytest.raises(FrameError, match="quality 3 in input register 201"):
        registers.readings((0, 3, *READINGS[2:]))


@pytest.mark.parametrize("read", [registers.readings, registers.vendor, registers.device])
def test_a_span_of_another_length_is_the_callers_mistake(read: object) -> None:
    with pytest.raises(ValueError, match="7 words"):
        read((0,) * 7)  # type: ignore[operator]


@quick
@given(
    st.builds(
        Readings,
        parametrising=st.booleans(),
        time_synced=st.booleans(),
        valid=st.booleans(),
        alarm=st.booleans(),
        quality=st.sampled_from(Quality),
        outputs=st.tuples(st.booleans(), st.booleans()),
        values=st.tuples(*[st.floats(width=32, allow_nan=False)] * 7),
        rate_hz=st.floats(width=32, allow_nan=False),
        seconds=st.integers(0, 2**32 - 1),
        microseconds=st.integers(0, 2**32 - 1),
    )
)
def test_readings_survive_their_registers(said: Readings) -> None:
    words = registers.readings_words(said)
    assert all(0 <= word < 1 << 16 for word in words)
    assert registers.readings(words) == said
