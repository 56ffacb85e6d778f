"""What a Grbl driver asks again and what it never does, and what a bent letter can do on that wire.

Grbl's lines carry no checksum. Questions change nothing and are asked again, from a reset on; moves
and homings are sent once, whatever becomes of them. The simulated board and its world are witness.
"""

from __future__ import annotations

import random
from collections import Counter
from contextlib import suppress
from types import MappingProxyType

import pytest

from drivers.errors import DriverError, NoReply, Refused
from sim.faulty_wire import FaultyLine, Plug
from sim.wire_faults import Carrier, WireFaults
from tests.drivers.motion_cases import FAMILIES, Bench

QUESTIONS = (b"?", b"$I\n", b"$$\n")


def bench() -> Bench:
    return Bench(FAMILIES["grbl"])


class Once:
    """Loses, or bends, what begins so, the first time."""

    def __init__(self, words: bytes, lost: str) -> None:
        self.words, self.lost, self.struck = words, lost, 0

    def __call__(self, words: bytes) -> str:
        if words != self.words or self.struck:
            return ""
        self.struck += 1
        return self.lost


@pytest.mark.parametrize("lost", ["request", "answer"])
@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_whose_answer_was_lost_is_asked_again(question: bytes, lost: str) -> None:
    at = bench()
    at.lose = Once(question, lost)
    assert at.driver().identify().family == "grbl"
    assert at.sent.count(question) >= 2
    assert at.moves() == []


def test_a_board_that_is_not_there_is_asked_for_once() -> None:
    at = bench()
    at.lose = lambda _: "request"
    begun_s = at.now_s
    with pytest.raises(NoReply, match="no report"):
        at.driver().identify()
    assert (
        at.now_s - begun_s < 6.0
    )  # a boot loader's time and two reports; thrice is more than eleven
    assert b"$I\n" not in at.sent


def test_a_setting_that_no_wire_bent_is_refused_at_once() -> None:
    at = Bench(FAMILIES["grbl"], scale=1.1)
    with pytest.raises(Refused, match="steps"):
        at.driver().identify()
    assert at.sent.count(b"$$\n") == 1


@pytest.mark.parametrize("lost", ["request", "answer"])
@pytest.mark.parametrize("moves", ["home", "move"])
def test_what_moves_is_sent_once_whatever_becomes_of_it(moves: str, lost: str) -> None:
    at = bench()
    axis = at.driver()
    if moves == "move":
        axis.home(at.pause)
    at.sent.clear()
    at.lose = lambda words: lost if FAMILIES["grbl"].moves(words) else ""
    with suppress(DriverError):
        axis.home(at.pause) if moves == "home" else axis.move_to(0.1, at.pause)
    assert len(at.moves()) == 1


def test_a_handshake_over_a_bad_wire_mostly_ends_well_and_leaves_nothing_moving() -> None:
    came: Counter[str] = Counter()
    chances = MappingProxyType({"drop": 0.05, "flip": 0.05, "late": 0.05, "twice": 0.05})
    for seed in range(200):
        at = bench()
        end, dice = at._device, random.Random(seed)
        faults = WireFaults(chances=chances, late_s=0.05)
        at._device = FaultyLine(end, faults, Carrier.SERIAL, Plug("table"), dice)
        axis = at.driver()
        try:
            axis.identify()
        except DriverError as error:
            came[type(error).__name__] += 1
            at._device = end
            axis.stop()  # as a station's way out does
        else:
            came["known"] += 1
        at._device = end
        here = at.axis.motor(at.now_s)
        at.pause(0.05)
        came["moving"] += at.axis.motor(at.now_s) != here
    assert came["moving"] == 0
    assert came["known"] > 150, came


def test_of_all_questions_with_one_bit_bent_only_those_that_become_homing_move_anything() -> None:
    """Which is why a handshake that was not answered begins anew with a reset."""
    found = []
    for words in (*QUESTIONS, b"$X\n", b"$G\n", b"\x18", b"!", b"\x85"):
        for place in range(len(words)):
            for bit in range(8):
                bent = bytearray(words)
                bent[place] ^= 1 << bit
                at = bench()
                before = at.axis.motor(at.now_s)
                at._device.receive(bytes(bent) + b"\n", at.now_s)
                for _ in range(10):
                    at.pause(0.05)
                    at._device.tick(at.now_s)
                if at.axis.motor(at.now_s) != before:
                    found.append(bytes(bent))
    assert set(found) == {b"$H\n"}
    assert len(found) == 2  # of $I and of $X
