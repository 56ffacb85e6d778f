"""Modbus frames: golden bytes, an answer recognised under any chunking, and nothing else."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.bit_message import WriteSingleCoilRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.errors import FrameError
from drivers.modbus_wire import Question, match_rtu, match_tcp, rtu_frame, tcp_frame, without_echo

repeatable = settings(deadline=None, derandomize=True)
words = st.integers(0, 0xFFFF)
register_lists = st.lists(words, min_size=1, max_size=30)
device_ids = st.integers(1, 247)


def naive_crc(data: bytes) -> bytes:
    """The CRC bit by bit, as the serial line specification writes it."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


def asked(device_id: int, count: int, transaction: int = 0) -> Question:
    request = ReadHoldingRegistersRequest(
        dev_id=device_id, transaction_id=transaction, address=0, count=count
    )
    return Question(request, bytes([3, 2 * count]), 2 + 2 * count, "read")


def answered(device_id: int, registers: list[int], transaction: int = 0) -> bytes:
    pdu = ReadHoldingRegistersResponse(
        dev_id=device_id, transaction_id=transaction, registers=registers
    )
    framer = FramerSocket if transaction else FramerRTU
    return framer(DecodePDU(is_server=True)).buildFrame(pdu)


# The bytes are hardware.md's: 3.1, Leadshine's manual p. 50, "immediate trigger"; 3.2, an Oriental
# AZ direct data operation in public code (asukiaaa/arduino-OrientalAZ); 4.5, Banner EZ-ARRAY's
# manual 130426. The relay's are section 8's words (function 5, 0xFF00 on), the CRC by the twin.
LEADSHINE_MOVE = bytes.fromhex("07106200000810000100002710000027102710000000108D50")
LEADSHINE_ECHO = bytes.fromhex("071062000008DE11")
GOLDEN = [
    (
        WriteMultipleRegistersRequest(
            dev_id=7, address=0x6200, registers=[1, 0, 10000, 0, 10000, 10000, 0, 16]
        ),
        LEADSHINE_MOVE,
    ),
    (
        WriteMultipleRegistersRequest(
            dev_id=1,
            address=0x58,
            registers=[0, 0, 0, 2, 0, 8500, 0, 2000, 0, 1500, 0, 1500, 0, 1000, 0, 1],
        ),
        bytes.fromhex(
            "01100058001020" "0000000000000002" "00002134000007D0" "000005DC000005DC"
            "000003E800000001" "1C08"
        ),
    ),
    (
        ReadInputRegistersRequest(dev_id=65, address=0x7724, count=25),
        bytes.fromhex("41047724001964BF"),
    ),
    (WriteSingleCoilRequest(dev_id=1, address=0, bits=[True]), bytes.fromhex("01050000FF008C3A")),
    (WriteSingleCoilRequest(dev_id=1, address=0, bits=[False]), bytes.fromhex("010500000000CDCA")),
]  # fmt: skip


@pytest.mark.parametrize(("request_", "frame"), GOLDEN)
def test_a_request_is_the_manuals_frame_byte_for_byte(request_, frame) -> None:
    assert rtu_frame(request_) == frame
    assert naive_crc(frame[:-2]) == frame[-2:]


def test_a_watchdog_of_half_a_second_is_written_over_tcp() -> None:
    # hardware.md 8: Turck register 0x1120, milliseconds; the header is the specification's.
    request = WriteSingleRegisterRequest(
        dev_id=1, transaction_id=0x0102, address=0x1120, registers=[500]
    )
    assert tcp_frame(request) == bytes.fromhex("010200000006 01 06 1120 01F4")


def test_the_longest_reply_is_recognised() -> None:
    frame = answered(247, list(range(125)))
    assert match_rtu(frame, asked(247, 125)) == frame[1:-2]


def test_leadshines_echo_answers_the_move_and_only_in_full() -> None:
    request, _ = GOLDEN[0]
    move = Question(request, bytes.fromhex("1062000008"), 5, "move")
    assert match_rtu(LEADSHINE_ECHO, move) == LEADSHINE_ECHO[1:-2]
    for k in range(len(LEADSHINE_ECHO)):
        assert match_rtu(LEADSHINE_ECHO[:k], move) is None
    wrong_count = bytes.fromhex("071062000007")
    with pytest.raises(FrameError, match="was due"):
        match_rtu(wrong_count + naive_crc(wrong_count), move)


@repeatable
@given(device_ids, register_lists)
def test_a_reply_is_recognised_when_whole_and_not_before(device_id, registers) -> None:
    frame = answered(device_id, registers)
    question = asked(device_id, len(registers))
    assert all(match_rtu(frame[:k], question) is None for k in range(len(frame)))
    _, oracle = FramerRTU(DecodePDU(is_server=False)).handleFrame(frame, device_id, 0)
    pdu = match_rtu(frame, question)
    assert oracle is not None
    assert pdu == bytes([3]) + oracle.encode()


@repeatable
@given(device_ids, register_lists, st.integers(1, 0xFFFF))
def test_a_tcp_reply_is_recognised_when_whole_and_not_before(device_id, registers, number) -> None:
    frame = answered(device_id, registers, number)
    question = asked(device_id, len(registers), number)
    assert all(match_tcp(frame[:k], question) is None for k in range(len(frame)))
    assert match_tcp(frame, question) == frame[7:]


@repeatable
@given(device_ids, register_lists, st.data())
def test_one_flipped_bit_is_never_an_answer(device_id, registers, data) -> None:
    frame = bytearray(answered(device_id, registers))
    at = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[at // 8] ^= 1 << at % 8
    with suppress(FrameError):
        assert match_rtu(bytes(frame), asked(device_id, len(registers))) is None


@repeatable
@given(device_ids, st.binary(max_size=40))
def test_garbage_is_an_error_or_unfinished_never_an_answer(device_id, garbage) -> None:
    with suppress(FrameError):
        assert match_rtu(garbage, asked(device_id, 2)) is None
    with suppress(FrameError):
        assert match_tcp(b"\x00\x02" + garbage, asked(device_id, 2, 1)) is None


@repeatable
@given(device_ids, register_lists, st.integers(1, 30))
def test_a_valid_reply_of_another_count_is_an_error(device_id, registers, count) -> None:
    frame = answered(device_id, registers)
    if count == len(registers):
        assert match_rtu(frame, asked(device_id, count)) is not None
        return
    with pytest.raises(FrameError):
        match_rtu(frame, asked(device_id, count))


def test_an_empty_success_is_an_error() -> None:
    # hardware.md 5: jsmodbus answers an out-of-range read so.
    empty = bytes.fromhex("0001 0000 0003 01 03 00")
    with pytest.raises(FrameError, match="03 04 was due"):
        match_tcp(empty, asked(1, 2, 1))


def test_a_header_that_announces_less_than_the_reply_is_an_error() -> None:
    short = bytes.fromhex("0001 0000 0005 01 03 04 0007")
    with pytest.raises(FrameError, match="6 were due"):
        match_tcp(short, asked(1, 2, 1))


@pytest.mark.parametrize("header", ["0001 0001 0005 01", "0001 0000 0002 01", "0001 0000 00FF 01"])
def test_a_header_that_is_none_is_an_error(header: str) -> None:
    with pytest.raises(FrameError, match="no Modbus TCP header"):
        match_tcp(bytes.fromhex(header), asked(1, 2, 1))


@pytest.mark.parametrize("code", [1, 2, 3, 4, 8, 200])
def test_a_refusal_is_an_answer(code: int) -> None:
    refusal = ExceptionResponse(3, code, device_id=7)
    rtu = FramerRTU(DecodePDU(is_server=True)).buildFrame(refusal)
    assert match_rtu(rtu, asked(7, 2)) == bytes([0x83, code])
    assert all(match_rtu(rtu[:k], asked(7, 2)) is None for k in range(len(rtu)))


def test_a_reply_of_another_device_is_an_error() -> None:
    with pytest.raises(FrameError, match="reply of 7"):
        match_rtu(answered(8, [1, 2]), asked(7, 2))
    with pytest.raises(FrameError, match="7 was asked, 8 answered"):
        match_tcp(answered(8, [1, 2], 5), asked(7, 2, 5))


def test_a_late_reply_of_another_transaction_is_passed_over() -> None:
    late, due = answered(7, [1, 1], 4), answered(7, [2, 2], 5)
    assert match_tcp(late, asked(7, 2, 5)) is None
    assert match_tcp(late + due, asked(7, 2, 5)) == due[7:]


def test_a_second_frame_behind_the_reply_is_an_error() -> None:
    frame = answered(7, [1, 2])
    with pytest.raises(FrameError, match="9 bytes more"):
        match_rtu(frame + frame, asked(7, 2))


def test_the_noise_of_a_transceiver_that_turns_round_is_no_reply() -> None:
    frame = answered(7, [1, 0xFFFF])
    assert match_rtu(b"\x00\xff" + frame + b"\x00", asked(7, 2)) == frame[1:-2]
    assert match_rtu(b"\x00\xff", asked(7, 2)) is None


@repeatable
@given(st.binary(min_size=1, max_size=20), st.binary(max_size=20))
def test_the_local_echo_is_taken_off_once_it_is_whole(sent: bytes, reply: bytes) -> None:
    assert without_echo(sent + reply, sent) == reply
    assert all(without_echo(sent[:k], sent) is None for k in range(len(sent)))


def test_an_echo_that_differs_is_a_collision() -> None:
    with pytest.raises(FrameError, match="echo"):
        without_echo(b"\x07\x03\x11", b"\x07\x03\x10\x00")
