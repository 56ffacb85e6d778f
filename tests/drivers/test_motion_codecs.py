"""State machines over the codecs of motion: any chunking, noise before, between and after.

Zaber's are in test_zaber_wire. Both ends are held to it: the drivers' and the simulated devices'.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from pymodbus.framer import FramerRTU

from drivers.errors import FrameError, NoReply
from drivers.grbl.messages import (
    Alarm,
    Banner,
    Error,
    Feedback,
    Message,
    Ok,
    Setting,
    State,
    Status,
    Unknown,
    message_bytes,
)
from drivers.grbl.wire import FENCE, CommandDecoder, Dialogue, Line, LineDecoder, Realtime
from drivers.long_words import value_of, words_of
from drivers.modbus import Framing, ModbusBus
from sim.leadshine import LeadshineDrive
from sim.leadshine import registers as sim_leadshine
from sim.modbus import RtuServer
from sim.motion import Limits
from sim.oriental import registers as sim_az
from sim.zaber import ZaberChain, ZaberDevice
from tests.sim.judges import world_axis

MANY = settings(max_examples=60, stateful_step_count=30, deadline=None)

cuts = st.lists(st.integers(1, 9), min_size=1, max_size=12)
coordinates = st.integers(-(10**7), 10**7).map(lambda thousandths: thousandths / 1000.0)


def chunks(data: bytes, sizes: Sequence[int]) -> list[bytes]:
    """Data in pieces of these sizes, over and over."""
    pieces, at, k = [], 0, 0
    while at < len(data):
        size = sizes[k % len(sizes)]
        pieces.append(data[at : at + size])
        at, k = at + size, k + 1
    return pieces


# --- Grbl: what the board says -----------------------------------------------------------------

messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(Ok),
    st.builds(Error, st.integers(1, 99)),
    st.builds(Alarm, st.integers(1, 20)),
    st.builds(Setting, st.integers(0, 400), st.just("1.500")),
    st.just(Banner("Grbl", "1.1h")),
    st.just(Feedback("NVS STORAGE", "*EEPROM")),
    st.builds(
        Status,
        st.sampled_from([State.IDLE, State.RUN, State.JOG]),
        machine=st.tuples(coordinates, coordinates, coordinates, coordinates),
        feed=st.just(0.0),
        spindle=st.just(0.0),
    ),
)
# Without a check a line of noise must be noise: it begins with what no message begins with.
noise_lines = st.binary(max_size=30).map(
    lambda data: b"~" + bytes(byte for byte in data if byte not in b"\r\n") + b"\n"
)


class GrblSays(RuleBasedStateMachine):
    """Messages between lines of noise: all are heard, in order, and nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.decoder = LineDecoder()
        self.said: list[Message] = []
        self.heard: list[Message] = []

    def pass_on(self, data: bytes, sizes: Sequence[int]) -> None:
        for piece in chunks(data, sizes):
            found = self.decoder.feed(piece)
            self.heard += [each for each in found if not isinstance(each, Unknown)]

    @rule(message=messages, cut=cuts)
    def message(self, message: Message, cut: list[int]) -> None:
        self.said.append(message)
        self.pass_on(message_bytes(message), cut)

    @rule(noise=noise_lines, cut=cuts)
    def noise(self, noise: bytes, cut: list[int]) -> None:
        self.pass_on(noise, cut)

    @invariant()
    def nothing_is_lost_or_made_up(self) -> None:
        assert self.heard == self.said


class GrblAnswers(RuleBasedStateMachine):
    """Lines, answers that are late or lost, and pushes: no answer is taken for another line's.

    The board answers in order. Each line gets an answer of its own number, so that it can be told.
    """

    def __init__(self) -> None:
        super().__init__()
        self.dialogue = Dialogue()
        self.due: list[tuple[str, int]] = []  # on their way: the line, its answer
        self.asked: tuple[str, int] | None = None
        self.count = 0

    def send(self, line: str) -> None:
        self.count = self.count % 90 + 1
        self.dialogue.send(line)
        self.asked = (line, self.count)
        self.due.append(self.asked)

    @precondition(lambda self: not self.dialogue.outstanding and self.dialogue.fenced)
    @rule()
    def a_line(self) -> None:
        self.send("$X")

    @precondition(
        lambda self: not (self.dialogue.outstanding or self.dialogue.fenced or self.dialogue.mute)
    )
    @rule()
    def a_fence(self) -> None:
        self.send(FENCE)

    @precondition(lambda self: self.due)
    @rule(lost=st.booleans(), cut=cuts)
    def an_answer_comes(self, *, lost: bool, cut: list[int]) -> None:
        line, number = self.due.pop(0)
        if lost:
            return
        pushed = [Feedback("GC", "G0")] if line == FENCE else []
        for message in (*pushed, Error(number)):
            for piece in chunks(message_bytes(message), cut):
                self.dialogue.feed(piece)

    @precondition(lambda self: self.dialogue.outstanding)
    @rule()
    def nobody_waits_any_more(self) -> None:
        self.dialogue.give_up()
        self.asked = None

    @precondition(lambda self: self.dialogue.mute)
    @rule()
    def a_reset(self) -> None:
        """What the board had said before is still on its way; then it owes nothing."""
        self.dialogue.reset()
        while self.due:
            self.an_answer_comes(lost=False, cut=[3])
        self.dialogue.feed(message_bytes(Banner("Grbl", "1.1h")))

    @rule(message=st.sampled_from([Setting(1, "2"), Feedback("MSG", "hello")]))
    def a_push(self, message: Message) -> None:
        self.dialogue.feed(message_bytes(message))

    @invariant()
    def an_answer_is_that_of_the_line(self) -> None:
        if self.asked is not None and self.dialogue.answer is not None:
            assert self.dialogue.answer == Error(self.asked[1])


class GrblHears(RuleBasedStateMachine):
    """The board's ear: lines come whole, realtime bytes where they stand, noise above 0x7F not."""

    def __init__(self) -> None:
        super().__init__()
        self.decoder = CommandDecoder()
        self.heard: list[Line | Realtime] = []
        self.meant: list[Line | Realtime] = []

    @rule(
        line=st.sampled_from(["$I", "G1X2F3", "$J=G91X-3F9"]),
        byte=st.sampled_from([None, Realtime.STATUS, Realtime.JOG_CANCEL, Realtime.HOLD]),
        at=st.integers(0, 10),
        noise=st.sampled_from([b"", b"\xff", b"\xfe\xe0"]),
        cut=cuts,
    )
    def told(self, line: str, byte: Realtime | None, at: int, noise: bytes, cut: list[int]) -> None:
        data = line.encode()
        inside = b"" if byte is None else byte.wire
        for piece in chunks(noise + data[:at] + inside + noise + data[at:] + b"\n", cut):
            self.heard += list(self.decoder.feed(piece))
        self.meant += [*([] if byte is None else [byte]), Line(line)]

    @invariant()
    def nothing_is_lost_or_made_up(self) -> None:
        assert self.heard == self.meant


# --- Modbus RTU: the driver's end --------------------------------------------------------------

TIMEOUT_S, SLOWEST_S = 0.1, 0.2


class Slave:
    """A link with one honest device of id 7 behind it, and a line that does what it is told to."""

    address = "test://line"

    def __init__(self) -> None:
        self.now_s = 10.0
        self.coming: list[tuple[float, bytes]] = []
        self.fate = "sound"
        self.before = self.after = b""
        self.sizes: Sequence[int] = (99,)

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def read(self, timeout_s: float) -> bytes:
        self.coming.sort(key=lambda each: each[0])
        if self.coming and self.coming[0][0] <= self.now_s + timeout_s:
            due_s, data = self.coming.pop(0)
            self.now_s = max(self.now_s, due_s)
            return data
        self.now_s += timeout_s
        return b""

    def write(self, data: bytes) -> None:
        first, count = struct.unpack_from(">HH", data, 2)
        body = bytes([7, 3, 2 * count]) + b"".join(
            struct.pack(">H", word_at(first + k)) for k in range(count)
        )
        reply = body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        if self.fate == "lost":
            return
        # Late is later than anybody waits, and not later than the slowest reply.
        delay_s = TIMEOUT_S + 0.9 * SLOWEST_S if self.fate == "late" else 0.01
        for k, piece in enumerate(chunks(self.before + reply + self.after, self.sizes)):
            self.coming.append((self.now_s + delay_s + 0.0005 * k, piece))
        self.fate, self.before, self.after = "sound", b"", b""  # the line is well again

    def close(self) -> None:
        """Nothing."""


def word_at(register: int) -> int:
    """What stands in a register: another number in each."""
    return (register * 40503 + 17) & 0xFFFF


class ModbusAsks(RuleBasedStateMachine):
    """Late, lost, torn and dirty replies: a value that is handed out is the register's."""

    def __init__(self) -> None:
        super().__init__()
        self.line = Slave()
        self.bus = ModbusBus(
            self.line, Framing.RTU, timeout_s=TIMEOUT_S, slowest_reply_s=SLOWEST_S,
            clock=self.line.clock, sleep=self.line.sleep,
        )  # fmt: skip

    @rule(
        register=st.integers(0, 60_000),
        count=st.integers(1, 6),
        fate=st.sampled_from(["sound", "lost", "late"]),
        before=st.binary(max_size=6),
        after=st.binary(max_size=6),
        cut=cuts,
    )
    def asked_on_a_bad_line(
        self, register: int, count: int, fate: str, before: bytes, after: bytes, cut: list[int]
    ) -> None:
        line = self.line
        line.fate, line.before, line.after, line.sizes = fate, before, after, cut
        try:
            words = self.bus.read_holding(7, register, count)
        except (FrameError, NoReply):
            return
        assert words == tuple(word_at(register + k) for k in range(count))

    @rule(noise=st.binary(min_size=1, max_size=40), cut=cuts)
    def noise_with_nobody_asking(self, noise: bytes, cut: list[int]) -> None:
        for k, piece in enumerate(chunks(noise, cut)):
            self.line.coming.append((self.line.now_s + 0.0005 * k, piece))

    @rule(register=st.integers(0, 60_000), cut=cuts)
    def asked_on_a_sound_line(self, register: int, cut: list[int]) -> None:
        """Whatever came before: one question, and at most one more, and it is answered."""
        line = self.line
        line.fate, line.before, line.after, line.sizes = "sound", b"", b"", cut
        assert self.bus.read_holding(7, register, 1) == (word_at(register),)


# --- the simulated devices' ends ---------------------------------------------------------------


class ModbusIsAsked(RuleBasedStateMachine):
    """The answering end: after a silence every whole request is answered, whatever came before."""

    def __init__(self) -> None:
        super().__init__()
        drive = LeadshineDrive(world_axis("stage", 0.0, Limits(10.0, 10.0)))
        self.server = RtuServer({7: drive})
        self.now_s = 1000.0

    def quiet(self) -> None:
        self.now_s += 0.05
        self.server.tick(self.now_s)

    @rule(noise=st.binary(min_size=1, max_size=30), cut=cuts)
    def noise(self, noise: bytes, cut: list[int]) -> None:
        for piece in chunks(noise, cut):
            self.now_s += 0.0005
            self.server.receive(piece, self.now_s)
        self.quiet()

    @rule(kept=st.integers(1, 7), cut=cuts)
    def torn(self, kept: int, cut: list[int]) -> None:
        for piece in chunks(bytes.fromhex("070300010001D5AC")[:kept], cut):
            self.server.receive(piece, self.now_s)
        self.quiet()

    @rule(cut=cuts)
    def asked(self, cut: list[int]) -> None:
        body = bytes.fromhex("070300010001")
        asked = body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        said = b""
        for piece in chunks(asked, cut):
            self.now_s += 0.0005
            said += self.server.receive(piece, self.now_s)
        assert said[:5] == bytes.fromhex("0703022710")
        self.quiet()


class ZaberIsAsked(RuleBasedStateMachine):
    """The chain: each sound command is answered once, with its id; noise is answered never."""

    def __init__(self) -> None:
        super().__init__()
        self.chain = ZaberChain({1: ZaberDevice(world_axis("stage", 0.0, Limits(10.0, 10.0)))})
        self.number = 0

    def say(self, data: bytes, sizes: Sequence[int]) -> bytes:
        return b"".join(self.chain.receive(piece, 1000.0) for piece in chunks(data, sizes))

    @rule(noise=st.binary(max_size=20), cut=cuts)
    def noise(self, noise: bytes, cut: list[int]) -> None:
        kept = bytes(byte for byte in noise if byte != ord("/"))
        assert self.say(kept + b"\n", cut) == b""

    @rule(cut=cuts, before=st.sampled_from([b"", b"\n", b"\x00\xff", b"junk"]))
    def asked(self, cut: list[int], before: bytes) -> None:
        self.number = (self.number + 1) % 100
        body = f"1 1 {self.number:02d} get resolution"
        line = f"/{body}:{-sum(body.encode()) & 0xFF:02X}\n".encode()
        assert self.say(before + line, cut) == f"@01 1 {self.number:02d} OK IDLE WR 64\r\n".encode()

    @rule(cut=cuts, bit=st.integers(0, 6))
    def asked_with_a_wrong_bit(self, cut: list[int], bit: int) -> None:
        line = bytearray(b"/1 1 00 get pos:2C\n")
        line[4] ^= 1 << bit  # in the id
        if line[4] not in b"\r\n/":
            assert self.say(bytes(line), cut) == b""


for machine in (
    GrblSays, GrblAnswers, GrblHears, ModbusAsks, ModbusIsAsked, ZaberIsAsked,
):  # fmt: skip
    case = machine.TestCase
    case.settings = MANY
    globals()[f"Test{machine.__name__}"] = case


# --- words of registers ------------------------------------------------------------------------


@given(st.integers(-(2**31), 2**31 - 1))
def test_a_number_of_32_bits_survives_its_words_at_both_ends(value) -> None:
    for joined in (sim_leadshine.joined, sim_az.joined):
        assert joined(*words_of(value)) == value
    for split in (sim_leadshine.split, sim_az.halves):
        assert value_of(*split(value)) == value
