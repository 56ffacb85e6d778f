"""SCIP 2.0 against printed frames and against anything a wire can make of them."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.errors import FrameError
from drivers.hokuyo.wire import (
    Damaged,
    Decoder,
    Dialogue,
    Reply,
    Stamps,
    Window,
    check_of,
    command_bytes,
    fields_of,
    number_of,
    scan_command,
    scan_of,
)

# As printed on the maker's pages of SCIP status commands (a URG-04LX), byte for byte.
VV = (
    b"VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor URG-04LX;[\n"
    b"FIRM:3.1.00(18/Jan./2007);`\nPROT:SCIP 2.0;N\nSERI:H0614967;V\n\n"
)
PP = (
    b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\n"
    b"AMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n"
)
II = (
    b"II\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nLASR:OFF;7\n"
    b"SCSP:Initial(600[rpm])<-Default setting by user;A\nMESM:IDLE;:\n"
    b"SBPS:19200[bps]<-Default setting by user;A\nTIME:081615;N\nSTAT:Sensor works well.;8\n\n"
)


def decoded(data: bytes) -> list[Reply | Damaged]:
    return list(Decoder().feed(data))


def test_version_parameters_and_state_are_read_from_the_printed_frames() -> None:
    version, parameters, state = decoded(VV + PP + II)
    assert fields_of(version, ["PROT"]) == {
        "VEND": "Hokuyo Automatic Co.,Ltd.",
        "PROD": "SOKUIKI Sensor URG-04LX",
        "FIRM": "3.1.00(18/Jan./2007)",
        "PROT": "SCIP 2.0",
        "SERI": "H0614967",
    }
    assert fields_of(parameters, ["AMIN", "AMAX", "AFRT"])["ARES"] == "1024"
    assert fields_of(state, ["LASR"])["LASR"] == "OFF"


def test_statuses_of_the_specification_carry_their_printed_checks() -> None:
    for status, check in ((b"00", "P"), (b"99", "b"), (b"02", "R")):
        assert chr(check_of(status)) == check


def test_numbers_are_those_of_the_specifications_examples() -> None:
    assert [number_of(text) for text in ("CB", "1Dh", "m2@0")] == [1234, 5432, 16_000_000]
    with pytest.raises(FrameError):
        number_of("C\x7f")


def test_commands_are_those_that_the_makers_library_was_seen_to_send() -> None:
    assert command_bytes("MD0044072501000") == b"MD0044072501000\n"
    assert command_bytes("QT") == b"QT\n"
    assert command_bytes(scan_command(Window(44, 725))) == b"GD0044072501\n"
    for bad in ("", "QT\n", "XX", "GD00440725", "SS115200"):
        with pytest.raises(ValueError, match="hokuyo"):
            command_bytes(bad)
    with pytest.raises(ValueError, match="hokuyo"):
        command_bytes("QT", "seventeen letters")


def summed(text: str) -> bytes:
    return text.encode() + bytes([check_of(text.encode())]) + b"\n"


def scan_frame(echo: str, stamp: str, data: str, status: str = "00") -> bytes:
    body = b"".join(summed(data[k : k + 64]) for k in range(0, len(data), 64))
    return echo.encode() + b"\n" + summed(status) + summed(stamp) + body + b"\n"


def test_a_stream_that_another_program_left_on_is_read_as_replies_of_its_own() -> None:
    (reply,) = decoded(scan_frame("MD0340034101000", "m2@0", "1Dh0CB", "99"))
    assert (reply.status, reply.echo) == ("99", "MD0340034101000")
    scan = scan_of(reply, Window(340, 341))
    assert (scan.stamp_ms, scan.ranges.tolist()) == (16_000_000, [5432, 1234])


def test_a_reply_of_the_asked_length_in_bytes_and_ranges() -> None:
    for window in (Window(0, 0), Window(44, 725), Window(44, 725, 3), Window(0, 1080)):
        frame = scan_frame(f"{scan_command(window)};a000", "0000", "1Dh" * window.points)
        assert len(frame) == window.reply_bytes
        assert scan_of(decoded(frame)[0], window).ranges.tolist() == [5432] * window.points


@pytest.mark.parametrize("points", [0, 1, 3])
def test_a_scan_of_another_length_is_no_scan(points: int) -> None:
    (reply,) = decoded(scan_frame("GD0000000101;a000", "0000", "1Dh" * points))
    with pytest.raises(FrameError, match="2 ranges"):
        scan_of(reply, Window(0, 1))


def test_the_clock_wraps_and_goes_on() -> None:
    stamps = Stamps()
    assert stamps.seconds(2**24 - 100) == pytest.approx((2**24 - 100) / 1e3)
    assert stamps.seconds(0) == pytest.approx(2**24 / 1e3)
    assert stamps.seconds(100) == pytest.approx((2**24 + 100) / 1e3)


@given(st.integers(4, 200), st.integers(0, 7))
def test_one_wrong_bit_behind_the_echo_is_never_another_reply(at: int, bit: int) -> None:
    """Bits 6 and 7 are not in the check: they lead out of the characters, or to letters that are
    none of a number's, and the length shows the rest."""
    good = scan_frame("GD0000005001;a000", "m2@0", "1Dh" * 51)
    bad = bytearray(good)
    at = 18 + at % (len(good) - 19)
    bad[at] ^= 1 << bit
    for each in decoded(bytes(bad) + b"\n"):
        if isinstance(each, Reply):
            try:
                scan = scan_of(each, Window(0, 50))
            except FrameError:
                continue
            assert scan.ranges.tolist() == [5432] * 51
            assert scan.stamp_ms == 16_000_000


def test_the_six_bit_check_misses_one_random_line_in_64() -> None:
    """N = 100 000 lines of 20 random characters 0x30 to 0x6F: 1562.5 are due, sigma is 39; five
    sigma either way."""
    dice = random.Random(20)
    alphabet = [bytes([k]) for k in range(0x30, 0x70)]
    missed = 0
    for _ in range(100_000):
        line = b"".join(dice.choices(alphabet, k=20))
        missed += check_of(line[:-1]) == line[-1]
    assert abs(missed - 100_000 / 64) < 5 * 39.2


def test_of_random_lines_none_is_a_scan_that_was_asked_for() -> None:
    """N = 200 000 replies with the right echo and status and random lines: a scan of 682 ranges has
    34 checks, so that 64**-34 of them would pass; 3 / N bounds what was seen at 95 %."""
    dice = random.Random(21)
    decoder, passed = Decoder(), 0
    for _ in range(200_000):
        lines = b"".join(dice.randbytes(6).hex().encode() + b"\n" for _ in range(4))
        for each in decoder.feed(b"GD0044072501;a000\n00P\n" + lines + b"\n"):
            if isinstance(each, Reply):
                with pytest.raises(FrameError):
                    scan_of(each, Window(44, 725))
                passed += 1  # as lines, not as a scan
    assert passed < 10  # four random checks: 200 000 / 64**4 is 0.012


chunks = st.lists(st.integers(1, 9), min_size=1, max_size=20)
# No digit: only a line that begins with one can be a status, and make a reply of noise.
noise = st.binary(max_size=16).map(lambda data: bytes(b for b in data if b not in b"0123456789"))


class Hearing(RuleBasedStateMachine):
    """Replies between noise, in any chunks: every whole one is heard, in order, and no other."""

    def __init__(self) -> None:
        super().__init__()
        self.decoder = Decoder()
        self.number = 0
        self.sent: list[Reply] = []
        self.heard: list[Reply] = []

    def say(self, data: bytes, sizes: list[int]) -> None:
        while data:
            size = sizes[0]
            sizes = [*sizes[1:], size]
            self.heard += [
                each for each in self.decoder.feed(data[:size]) if isinstance(each, Reply)
            ]
            data = data[size:]

    @rule(before=noise, ranges=st.lists(st.integers(0, 2**18 - 1), max_size=60), cut=chunks)
    def a_scan(self, before: bytes, ranges: list[int], cut: list[int]) -> None:
        self.number += 1
        echo = f"GD0000{max(len(ranges), 1) - 1:04d}01;a{self.number:03d}"
        data = "".join(chr((v >> s & 63) + 48)
                       for v in ranges for s in (12, 6, 0))  # fmt: skip
        lines = ("00CB", *(data[k : k + 64] for k in range(0, len(data), 64)))
        self.sent.append(Reply(echo, "00", lines))
        self.say(before + scan_frame(echo, "00CB", data), cut)

    @rule(before=noise, command=st.sampled_from(["QT", "BM", "RS"]), cut=chunks)
    def a_short_reply(self, before: bytes, command: str, cut: list[int]) -> None:
        self.number += 1
        echo = f"{command};a{self.number:03d}"
        self.sent.append(Reply(echo, "00", ()))
        self.say(before + echo.encode() + b"\n00P\n\n", cut)

    @rule(data=noise, cut=chunks)
    def garbage(self, data: bytes, cut: list[int]) -> None:
        self.say(data, cut)

    @rule(kept=st.integers(1, 90), cut=chunks)
    def torn(self, kept: int, cut: list[int]) -> None:
        """A reply that breaks off, and the next one begins on it."""
        self.say(scan_frame("GD0000003001;torn", "00CB", "1Dh" * 31)[:kept], cut)

    @invariant()
    def nothing_lost_and_nothing_made_up(self) -> None:
        assert self.heard == self.sent


TestHearing = Hearing.TestCase
TestHearing.settings = settings(max_examples=80, stateful_step_count=25, deadline=None)


class Talking(RuleBasedStateMachine):
    """Commands under way, replies late, doubled, never: none is taken for another's."""

    def __init__(self) -> None:
        super().__init__()
        self.dialogue = Dialogue()
        self.open: list = []
        self.late: list[bytes] = []

    @rule(command=st.sampled_from(["VV", "II", "QT", "GD0000000001"]))
    def ask(self, command: str) -> None:
        if len(self.open) < 50:
            self.open.append(self.dialogue.send(command)[0])

    @rule(pick=st.integers(0, 100), doubled=st.booleans())
    def answered(self, pick: int, *, doubled: bool) -> None:
        if self.open:
            asked = self.open.pop(pick % len(self.open))
            self.dialogue.feed((asked.line.encode() + b"\n10Q\n\n") * (1 + doubled))
            reply = self.dialogue.take(asked)
            assert reply is not None
            assert (reply.echo, reply.status) == (asked.line, "10")

    @rule(pick=st.integers(0, 100))
    def given_up(self, pick: int) -> None:
        if self.open:
            asked = self.open.pop(pick % len(self.open))
            self.dialogue.give_up(asked)
            self.late.append(asked.line.encode() + b"\n10Q\n\n")

    @rule()
    def late_replies_come(self) -> None:
        for said in self.late:
            self.dialogue.feed(said)
        self.late.clear()
        assert all(self.dialogue.take(asked) is None for asked in self.open)


TestTalking = Talking.TestCase
TestTalking.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
