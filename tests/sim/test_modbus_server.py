"""The answering end of a Modbus wire, against the specification's frames and pymodbus's client."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.bit_message import ReadCoilsRequest, WriteMultipleCoilsRequest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, WriteMultipleRegistersRequest

from sim.device import ModbusRefusal
from sim.modbus import RtuServer, TcpSession, answer

NOW_S = 1000.0
repeatable = settings(deadline=None, derandomize=True)


class Notebook:
    """A unit of 300 registers and as many coils, which remembers what was asked of it."""

    def __init__(self) -> None:
        self.words = [0] * 300
        self.states = [False] * 300
        self.heard_s: list[float] = []
        self.ticked_s: list[float] = []
        self.writes = 0

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        return self._part(self.words, first, count)

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        return [word ^ 0xFFFF for word in self._part(self.words, first, count)]

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        return self._part(self.states, first, count)

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        return [not state for state in self._part(self.states, first, count)]

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        self._part(self.words, first, len(words))
        self.writes += 1
        self.words[first : first + len(words)] = words

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        self._part(self.states, first, len(states))
        self.writes += 1
        self.states[first : first + len(states)] = states

    def heard(self, now_s: float) -> None:
        self.heard_s.append(now_s)

    def tick(self, now_s: float) -> None:
        self.ticked_s.append(now_s)

    @staticmethod
    def _part(row: list, first: int, count: int) -> list:
        if first + count > len(row):
            raise ModbusRefusal(2)
        return row[first : first + count]


class Complainer(Notebook):
    """One that answers a bad CRC."""

    crc_refusal = 8


def bits(text: str) -> list[bool]:
    """Spec's order: bytes as printed, the lowest bit of each first."""
    return [bool(byte >> k & 1) for byte in bytes.fromhex(text) for k in range(8)]


def rtu(device_id: int, pdu: str | bytes) -> bytes:
    body = bytes([device_id]) + (bytes.fromhex(pdu) if isinstance(pdu, str) else pdu)
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def tcp(transaction: int, device_id: int, pdu: str, protocol: int = 0) -> bytes:
    body = bytes([device_id]) + bytes.fromhex(pdu)
    head = transaction.to_bytes(2, "big") + protocol.to_bytes(2, "big")
    return head + len(body).to_bytes(2, "big") + body


# Modbus Application Protocol V1.1b3, the examples of 6.1 to 6.12.
SPECIFIED = [
    ("01 0013 0013", "01 03 CD6B05"),
    ("02 00C4 0016", "02 03 ACDB35"),
    ("03 006B 0003", "03 06 022B 0000 0064"),
    ("04 0008 0001", "04 02 000A"),
    ("05 00AC FF00", "05 00AC FF00"),
    ("06 0001 0003", "06 0001 0003"),
    ("0F 0013 000A 02 CD01", "0F 0013 000A"),
    ("10 0001 0002 04 000A 0102", "10 0001 0002"),
]


def specified_unit() -> Notebook:
    unit = Notebook()
    unit.states[0x13 : 0x13 + 24] = bits("CD6B05")
    unit.states[0xC4 : 0xC4 + 24] = [not state for state in bits("ACDB35")]
    unit.words[0x6B : 0x6B + 3] = [0x022B, 0, 0x64]
    unit.words[8] = 0x000A ^ 0xFFFF
    return unit


@pytest.mark.parametrize(("asked", "answered"), SPECIFIED)
def test_the_specifications_examples_are_answered_to_the_byte(asked, answered):
    reply = answer(specified_unit(), bytes.fromhex(asked), NOW_S)
    assert reply == bytes.fromhex(answered)


def test_what_is_written_arrives_in_its_order():
    unit = Notebook()
    answer(unit, bytes.fromhex("05 00AC FF00"), NOW_S)
    answer(unit, bytes.fromhex("0F 0013 000A 02 CD01"), NOW_S)
    answer(unit, bytes.fromhex("10 0001 0002 04 000A 0102"), NOW_S)
    assert unit.states[0xAC]
    assert unit.states[0x12:0x1E] == [False, *bits("CD01")[:10], False]
    assert unit.words[:4] == [0, 0x000A, 0x0102, 0]
    answer(unit, bytes.fromhex("05 00AC 0000"), NOW_S)
    assert not unit.states[0xAC]


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ("07", 1),
        ("16 0004 00F2 0025", 1),
        ("03 0000 0000", 3),
        ("03 0000 007E", 3),
        ("01 0000 07D1", 3),
        ("05 0000 0001", 3),
        ("05 0000 FF", 3),
        ("06 0000", 3),
        ("0F 0000 0009 01 FF", 3),
        ("0F 0000", 3),
        ("10 0000 0002 02 0001", 3),
        ("10 0000 0001 02 0001 00", 3),
        ("10 0000 007C F8" + "0000" * 124, 3),
        ("03 FFFF 0002", 2),
        ("03 012C 0001", 2),
    ],
)
def test_a_request_that_cannot_be_served_is_refused_with_its_code_and_changes_nothing(asked, code):
    unit = Notebook()
    pdu = bytes.fromhex(asked)
    assert answer(unit, pdu, NOW_S) == bytes([pdu[0] | 0x80, code])
    assert unit.writes == 0


def test_addresses_end_at_65535_whatever_a_unit_would_answer():
    unit = Notebook()
    unit.read_holding = lambda first, count, now_s: [0] * count
    assert answer(unit, bytes.fromhex("03 FFFF 0001"), NOW_S) == bytes.fromhex("03 02 0000")
    assert answer(unit, bytes.fromhex("03 FFFF 0002"), NOW_S) == bytes.fromhex("83 02")


def test_the_largest_requests_are_served():
    unit = Notebook()
    words = answer(unit, bytes.fromhex("03 0000 007D"), NOW_S)
    assert len(words) == 2 + 250
    reply = answer(unit, bytes.fromhex("10 0000 007B F6" + "1234" * 123), NOW_S)
    assert reply == bytes.fromhex("10 0000 007B")
    assert unit.words[122:124] == [0x1234, 0]


# ---- the serial line


def test_a_foreign_frame_is_not_answered_and_does_not_count_as_heard():
    unit = Notebook()
    assert RtuServer({1: unit}).receive(rtu(2, "03 0000 0001"), NOW_S) == b""
    assert unit.heard_s == []


def test_each_unit_of_a_line_answers_for_itself():
    one, two = Notebook(), Notebook()
    two.words[0] = 7
    server = RtuServer({1: one, 2: two})
    assert server.receive(rtu(2, "03 0000 0001"), NOW_S) == rtu(2, "03 02 0007")
    assert (one.heard_s, two.heard_s) == ([], [NOW_S])


def test_a_refused_request_was_heard_all_the_same():
    unit = Notebook()
    assert RtuServer({1: unit}).receive(rtu(1, "03 FFFF 0002"), NOW_S) == rtu(1, "83 02")
    assert unit.heard_s == [NOW_S]


def test_a_broadcast_is_done_by_all_and_answered_by_none():
    units = {1: Notebook(), 2: Notebook()}
    server = RtuServer(units)
    assert server.receive(rtu(0, "06 0005 00AA"), NOW_S) == b""
    assert server.receive(rtu(0, "03 0005 0001"), NOW_S) == b""
    assert server.receive(rtu(0, "06 FFFF 0001"), NOW_S) == b""
    assert [unit.words[5] for unit in units.values()] == [0xAA, 0xAA]
    assert units[1].heard_s == [NOW_S] * 3


def damaged(frame: bytes) -> bytes:
    return frame[:-1] + bytes([frame[-1] ^ 0x40])


def test_a_bad_crc_meets_silence_and_changes_nothing():
    unit = Notebook()
    assert RtuServer({1: unit}).receive(damaged(rtu(1, "06 0000 0001")), NOW_S) == b""
    assert (unit.writes, unit.heard_s) == (0, [])


def test_a_unit_that_complains_of_a_bad_crc_does_so():
    server = RtuServer({1: Complainer()})
    reply = server.receive(damaged(rtu(1, "06 0000 0001")), NOW_S)
    assert reply == rtu(1, "86 08")


def test_after_a_bad_crc_nothing_is_heard_until_the_line_was_silent():
    server = RtuServer({1: Notebook()})
    good = rtu(1, "03 0000 0001")
    assert server.receive(damaged(good) + good, NOW_S) == b""
    assert server.receive(good, NOW_S + 0.01) == b""
    assert server.receive(good, NOW_S + 0.05) == rtu(1, "03 02 0000")


def test_silence_forgets_half_a_request():
    server = RtuServer({1: Notebook()})
    good = rtu(1, "03 0000 0001")
    server.receive(good[:5], NOW_S)
    assert server.receive(good, NOW_S + 0.03) == rtu(1, "03 02 0000")


def test_being_handed_nothing_does_not_break_the_silence():
    server = RtuServer({1: Notebook()})
    good = rtu(1, "03 0000 0001")
    server.receive(good[:5], NOW_S)
    for k in range(1, 4):
        server.receive(b"", NOW_S + 0.01 * k)
    assert server.receive(good, NOW_S + 0.03) == rtu(1, "03 02 0000")


def test_a_request_may_come_with_short_pauses():
    server = RtuServer({1: Notebook()})
    good, answers = rtu(1, "03 0000 0001"), b""
    for k, byte in enumerate(good):
        answers += server.receive(bytes([byte]), NOW_S + 0.01 * k)
        answers += server.tick(NOW_S + 0.01 * k + 0.005)
    assert answers == rtu(1, "03 02 0000")


def test_an_unknown_function_is_refused_once_silence_has_ended_its_frame():
    server = RtuServer({1: Notebook()})
    assert server.receive(rtu(1, "2B 0E 01 00"), NOW_S) == b""
    assert server.tick(NOW_S + 0.01) == b""
    assert server.tick(NOW_S + 0.03) == rtu(1, "AB 01")
    assert server.tick(NOW_S + 0.06) == b""


def test_noise_is_never_answered_and_ends_with_silence():
    server = RtuServer({1: Notebook()})
    assert server.receive(bytes(range(200, 256)) * 20, NOW_S) == b""
    assert server.receive(rtu(1, "03 0000 0001"), NOW_S + 0.05) == rtu(1, "03 02 0000")


def test_a_tick_reaches_every_unit():
    units = {1: Notebook(), 2: Notebook()}
    RtuServer(units).tick(NOW_S)
    assert [unit.ticked_s for unit in units.values()] == [[NOW_S], [NOW_S]]


@pytest.mark.parametrize("device_id", [0, 248])
def test_an_id_that_no_line_has_is_a_mistake(device_id):
    with pytest.raises(ValueError, match="1 to 247"):
        RtuServer({device_id: Notebook()})


REQUESTS = st.lists(st.sampled_from([asked for asked, _ in SPECIFIED]), min_size=1, max_size=6)


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({0, len(data), *(at % (len(data) + 1) for at in cuts)})
    return [data[a:b] for a, b in pairwise(places)]


@repeatable
@given(asked=REQUESTS, cuts=st.lists(st.integers(0, 10_000), max_size=12))
def test_however_a_line_is_cut_the_answers_are_the_same(asked, cuts):
    said = b"".join(rtu(9, pdu) for pdu in asked)
    whole, pieces = RtuServer({9: specified_unit()}), RtuServer({9: specified_unit()})
    expected = b"".join(whole.receive(rtu(9, pdu), NOW_S) for pdu in asked)
    assert b"".join(pieces.receive(piece, NOW_S) for piece in cut(said, cuts)) == expected


@repeatable
@given(asked=REQUESTS, cuts=st.lists(st.integers(0, 10_000), max_size=12))
def test_however_a_connection_is_cut_the_answers_are_the_same(asked, cuts):
    frames = [tcp(k, 1, pdu) for k, pdu in enumerate(asked, 0xFFF0)]
    unit = specified_unit()
    expected = [
        tcp(k, 1, answer(unit, bytes.fromhex(pdu), NOW_S).hex())
        for k, pdu in enumerate(asked, 0xFFF0)
    ]
    session = TcpSession({1: specified_unit()})
    pieces = cut(b"".join(frames), cuts)
    assert b"".join(session.receive(piece, NOW_S) for piece in pieces) == b"".join(expected)


@repeatable
@given(noise=st.binary(max_size=300), cuts=st.lists(st.integers(0, 10_000), max_size=6))
def test_whatever_comes_the_server_lives_on(noise, cuts):
    server, session = RtuServer({1: Notebook()}), TcpSession({1: Notebook()})
    for piece in cut(noise, cuts):
        server.receive(piece, NOW_S)
        session.receive(piece, NOW_S)
    server.tick(NOW_S + 0.05)
    assert server.receive(rtu(1, "03 012B 0001"), NOW_S + 0.1)[:3] == bytes.fromhex("01 03 02")


# ---- the connection


def test_several_requests_of_one_segment_are_answered_in_order():
    session = TcpSession({1: Notebook()})
    segment = tcp(1, 1, "06 0000 0011") + tcp(2, 1, "03 0000 0001")
    assert session.receive(segment, NOW_S) == tcp(1, 1, "06 0000 0011") + tcp(2, 1, "03 02 0011")


def test_another_protocol_is_passed_over():
    session = TcpSession({1: Notebook()})
    segment = tcp(1, 1, "06 0000 0011", protocol=5) + tcp(2, 1, "03 0000 0001")
    assert session.receive(segment, NOW_S) == tcp(2, 1, "03 02 0000")


@pytest.mark.parametrize("length", [0, 1, 255, 0xFFFF])
def test_after_an_impossible_length_the_session_is_lost(length):
    unit = Notebook()
    session = TcpSession({1: unit})
    head = bytes.fromhex("0001 0000") + length.to_bytes(2, "big") + b"\x01"
    assert session.receive(head + tcp(2, 1, "03 0000 0001"), NOW_S) == b""
    assert session.lost
    assert session.receive(tcp(3, 1, "03 0000 0001"), NOW_S) == b""
    assert unit.heard_s == []


@pytest.mark.parametrize("called", [0, 1, 0xFF])
def test_a_single_unit_answers_by_whatever_id_it_was_called(called):
    unit = Notebook()
    session = TcpSession({1: unit})
    assert session.receive(tcp(7, called, "03 0000 0001"), NOW_S) == tcp(7, called, "03 02 0000")
    assert unit.heard_s == [NOW_S]


def test_an_unknown_unit_among_several_is_refused_as_by_a_gateway():
    session = TcpSession({1: Notebook(), 2: Notebook()})
    assert session.receive(tcp(7, 3, "03 0000 0001"), NOW_S) == tcp(7, 3, "83 0B")


def test_a_connections_tick_reaches_its_units():
    unit = Notebook()
    assert TcpSession({1: unit}).tick(NOW_S) == b""
    assert unit.ticked_s == [NOW_S]


# ---- pymodbus at the other end


def test_pymodbus_understands_the_answers_on_the_line():
    framer, server = FramerRTU(DecodePDU(is_server=False)), RtuServer({9: Notebook()})
    written = WriteMultipleRegistersRequest(address=20, registers=[1, 0xFFFF, 3], dev_id=9)
    read = ReadHoldingRegistersRequest(address=20, count=3, dev_id=9)
    wrong = ReadHoldingRegistersRequest(address=299, count=3, dev_id=9)
    replies = []
    for request in (written, read, wrong):
        said = server.receive(framer.buildFrame(request), NOW_S)
        replies.append(framer.handleFrame(said, 9, 0)[1])
    assert (replies[0].address, replies[0].count) == (20, 3)
    assert replies[1].registers == [1, 0xFFFF, 3]
    assert isinstance(replies[2], ExceptionResponse)
    assert replies[2].exception_code == 2


def test_pymodbus_understands_the_answers_of_a_connection():
    framer, session = FramerSocket(DecodePDU(is_server=False)), TcpSession({1: Notebook()})
    states = [True, False, True, True, False, False, False, True, True]
    written = WriteMultipleCoilsRequest(address=20, bits=states, dev_id=1, transaction_id=3)
    read = ReadCoilsRequest(address=20, count=9, dev_id=1, transaction_id=4)
    for request in (written, read):
        said = session.receive(framer.buildFrame(request), NOW_S)
        reply = framer.handleFrame(said, 1, request.transaction_id)[1]
    assert reply.bits[:9] == states
