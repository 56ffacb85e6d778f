"""Zaber's lines against golden frames and against anything a wire can make of them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.zaber.wire import (
    Alert,
    Damaged,
    Decoder,
    Dialogue,
    Info,
    Reply,
    check_of,
    command_bytes,
    parsed,
)

# As captured from zaber-motion 10.2.0 and 10.3.0, the maker's client.
CAPTURED = [
    (b"/1 1 00 get pos:2C\n", (1, 1, 0, "get pos")),
    (b"/1 1 01 move rel 1000:E2\n", (1, 1, 1, "move rel 1000")),
    (b"/1 1 02 stop:16\n", (1, 1, 2, "stop")),
    (b"/1 1 04 home:31\n", (1, 1, 4, "home")),
    (b"/1 1 06:F8\n", (1, 1, 6, "")),
    (b"/1 1 12 move abs 1000:ED\n", (1, 1, 12, "move abs 1000")),
    (b"/1 0 25 get deviceid:3B\n", (1, 0, 25, "get deviceid")),
]


@pytest.mark.parametrize(("wire", "said"), CAPTURED)
def test_a_command_is_the_makers_clients_byte_for_byte(wire, said) -> None:
    assert command_bytes(*said) == wire


def test_the_reply_that_the_makers_client_took_is_read() -> None:
    assert parsed("@01 1 00 OK IDLE WH 0:C7") == Reply(
        1, 1, 0, accepted=True, busy=False, flag="WH", data="0", checked=True
    )


def test_replies_infos_and_alerts_of_the_manual_are_told_apart() -> None:
    assert parsed("@01 1 07 OK BUSY WR 0") == reply(1, 1, 7, "OK BUSY", "WR", "0", checked=False)
    assert parsed("@01 0 OK IDLE -- 0") == reply(1, 0, None, "OK IDLE", "--", "0", checked=False)
    assert parsed("@02 0 RJ IDLE -- BADDATA") == reply(
        2, 0, None, "RJ IDLE", "--", "BADDATA", checked=False
    )
    assert parsed("#01 0 some words") == Info(1, 0, None, "some words")
    assert parsed("!01 1 IDLE --") == Alert(1, 1, busy=False, flag="--", text="")
    assert parsed("?01 1 IDLE --") == Damaged("?01 1 IDLE --")


def test_a_command_with_what_no_command_has_is_the_callers_mistake() -> None:
    for bad in ((1, 1, 0, "get pos\n"), (100, 1, 0, ""), (1, 1, 100, ""), (1, 1, 0, "a:b")):
        with pytest.raises(ValueError, match="zaber"):
            command_bytes(*bad)


def reply(device, axis, number, how, flag, data, *, checked: bool) -> Reply:
    """A reply as the manual prints it; `how` is such as ``OK BUSY``."""
    taken, state = how.split()
    return Reply(
        device, axis, number, accepted=taken == "OK", busy=state == "BUSY", flag=flag, data=data,
        checked=checked,
    )  # fmt: skip


def line(body: str) -> bytes:
    return f"@{body}:{check_of(body.encode()):02X}\r\n".encode()


@given(st.integers(0, 24), st.integers(0, 7))
def test_a_reply_with_one_wrong_bit_is_never_another_reply(at, bit) -> None:
    """A sum notices every single wrong bit; the line may break there, and then both parts fail."""
    good = line("01 1 00 OK IDLE -- 12800")
    bad = bytearray(good)
    bad[at] ^= 1 << bit
    found = [each for each in Decoder().feed(bytes(bad)) if isinstance(each, Reply)]
    assert all(each == parsed(good.decode().strip()) for each in found)  # or noise before it


chunks = st.lists(st.integers(1, 7), min_size=1, max_size=20)
noise = st.binary(max_size=12).map(lambda data: bytes(b for b in data if b not in b"@#!\r\n"))


class Hearing(RuleBasedStateMachine):
    """Replies between noise, in any chunks: every whole one is heard, in order, and no other.

    Only what carries a check counts: the chain takes nothing else once a device has shown one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.decoder = Decoder()
        self.sent: list[Reply] = []
        self.heard: list[Reply] = []

    def say(self, data: bytes, sizes: list[int]) -> None:
        while data:
            size = sizes[0]
            sizes = [*sizes[1:], size]
            for each in self.decoder.feed(data[:size]):
                if isinstance(each, Reply) and each.checked:
                    self.heard.append(each)
            data = data[size:]

    @rule(before=noise, number=st.integers(0, 99), value=st.integers(-(10**6), 10**6), cut=chunks)
    def a_reply(self, before: bytes, number: int, value: int, cut: list[int]) -> None:
        body = f"01 1 {number:02d} OK BUSY WR {value}"
        self.sent.append(reply(1, 1, number, "OK BUSY", "WR", str(value), checked=True))
        self.say(before + line(body), cut)

    @rule(data=noise, cut=chunks)
    def garbage_line(self, data: bytes, cut: list[int]) -> None:
        self.say(data + b"\n", cut)

    @rule(kept=st.integers(1, 20), cut=chunks)
    def torn(self, kept: int, cut: list[int]) -> None:
        """A line that breaks off, and the next one begins on it."""
        self.say(line("01 1 55 OK IDLE -- 777777777777")[:kept], cut)

    @invariant()
    def nothing_lost_and_nothing_made_up(self) -> None:
        assert self.heard == self.sent


TestHearing = Hearing.TestCase
TestHearing.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)


class Talking(RuleBasedStateMachine):
    """Commands under way, replies in any order, late, doubled: none is taken for another's."""

    def __init__(self) -> None:
        super().__init__()
        self.dialogue = Dialogue()
        self.now_s = 0.0
        self.open: list[tuple[object, str]] = []
        self.late: list[bytes] = []
        self.serial = 0

    @rule(device=st.integers(1, 3))
    def ask(self, device: int) -> None:
        if len(self.open) < 90:
            asked, _ = self.dialogue.send(device, 1, "get pos", self.now_s)
            self.serial += 1
            self.open.append((asked, str(self.serial)))

    def answer_of(self, asked, data: str) -> bytes:
        return line(f"{asked.device:02d} 1 {asked.message_id:02d} OK IDLE -- {data}")

    @rule(pick=st.integers(0, 100), doubled=st.booleans())
    def answered(self, pick: int, *, doubled: bool) -> None:
        if self.open:
            asked, data = self.open.pop(pick % len(self.open))
            said = self.answer_of(asked, data)
            self.dialogue.feed(said * (1 + doubled))
            reply = self.dialogue.take(asked)
            assert reply is not None
            assert (reply.data, reply.device) == (data, asked.device)

    @rule(pick=st.integers(0, 100))
    def given_up(self, pick: int) -> None:
        if self.open:
            asked, data = self.open.pop(pick % len(self.open))
            self.dialogue.give_up(asked, self.now_s + 5.0)
            self.late.append(self.answer_of(asked, data))

    @rule()
    def late_replies_come(self) -> None:
        for said in self.late:  # all within the five seconds that an id rests
            self.dialogue.feed(said)
        self.late.clear()
        for asked, _ in self.open:
            assert self.dialogue.take(asked) is None

    @rule()
    def time_passes(self) -> None:
        self.late.clear()
        self.now_s += 6.0


TestTalking = Talking.TestCase
TestTalking.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
