"""A bad wire does what each of its faults is named after, and nothing to what it spares."""

from __future__ import annotations

import random
from types import MappingProxyType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.faults import parse_faults
from sim.faulty_wire import FaultyLine, FaultyNetwork, Plug, Way
from sim.wire_faults import CHANCES, Carrier, WireFaults

MESSAGES = [f"message {k:03d}".encode() for k in range(200)]
AGES_S = 100.0
messages = st.lists(st.binary(min_size=1, max_size=30), max_size=30)


class Echo:
    """Answers with what it heard."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        del now_s
        return data

    def tick(self, now_s: float) -> bytes:
        del now_s
        return b""


def faults(**chances: float) -> WireFaults:
    return WireFaults(chances=MappingProxyType(chances))


def way(carrier: Carrier = Carrier.SERIAL, seed: int = 1, **chances: float) -> tuple[Way, Plug]:
    plug = Plug("stage")
    return Way(faults(**chances), carrier, plug, random.Random(seed)), plug


def carried(through: Way, said: list[bytes], apart_s: float = 1.0) -> list[bytes]:
    arrived = []
    for k, message in enumerate(said):
        through.put(message, k * apart_s)
        arrived += through.due((k + 0.5) * apart_s)
    return arrived + through.due(len(said) * apart_s + AGES_S)


@given(messages, st.sampled_from(Carrier))
def test_a_wire_with_nothing_wrong_carries_every_message_at_once(said, carrier):
    through, plug = way(carrier)
    for message in said:
        through.put(message, 0.0)
    assert through.due(0.0) == said
    assert not plug.happened


@given(messages, st.integers(0, 1000))
def test_what_tcp_is_late_with_or_splits_arrives_whole_and_in_order(said, seed):
    through, _ = way(
        Carrier.TCP, seed, late=0.3, split=0.5, drop=1.0, flip=1.0, swap=1.0, noise=1.0
    )
    assert b"".join(carried(through, said, apart_s=0.01)) == b"".join(said)


def test_a_late_message_holds_up_those_behind_it_on_a_line():
    through, _ = way(late=1.0)
    through.put(b"first", 0.0)
    assert through.due(0.149) == []
    assert through.due(0.151) == [b"first"]


def test_datagrams_overtake_a_late_one():
    plug = Plug("profiler")
    through = Way(faults(late=0.5), Carrier.UDP, plug, random.Random(4))
    arrived = carried(through, MESSAGES, apart_s=0.01)
    assert sorted(arrived) == MESSAGES
    assert arrived != MESSAGES


def test_a_lost_message_never_comes():
    through, plug = way(drop=0.3)
    arrived = carried(through, MESSAGES)
    assert len(arrived) == len(MESSAGES) - plug.happened["drop"]
    assert set(arrived) < set(MESSAGES)


def test_a_bent_message_has_exactly_one_bit_wrong():
    through, _ = way(flip=1.0)
    for said, heard in zip(MESSAGES, carried(through, MESSAGES), strict=True):
        assert sum((a ^ b).bit_count() for a, b in zip(said, heard, strict=True)) == 1


def test_a_cut_message_is_the_beginning_of_what_was_said():
    through, plug = way(cut=1.0)
    said = [b"message"] * 50
    arrived = carried(through, said)
    assert all(b"message".startswith(each) and each != b"message" for each in arrived)
    assert plug.happened["cut"] == len(said)


def test_a_doubled_message_comes_twice_within_30_ms():
    through, _ = way(twice=1.0)
    through.put(b"said", 0.0)
    assert through.due(0.0) == [b"said"]
    assert through.due(0.03) == [b"said"]


def test_an_overtaken_message_comes_after_the_next():
    through, _ = way(swap=0.5, seed=3)
    arrived = carried(through, MESSAGES, apart_s=0.01)
    assert sorted(arrived) == MESSAGES
    assert arrived != MESSAGES


def test_noise_comes_before_a_message_that_is_whole():
    through, _ = way(noise=1.0)
    for said, heard in zip(MESSAGES, carried(through, MESSAGES), strict=True):
        assert heard.endswith(said)
        assert 1 <= len(heard) - len(said) <= 11


def test_a_mute_line_carries_nothing_for_as_long_as_it_is_told():
    through, plug = way()
    plug.hush(0.0)
    through.put(b"unheard", 0.499)
    through.put(b"heard", 0.501)
    assert through.due(1.0) == [b"heard"]


@pytest.mark.parametrize("name", CHANCES)
def test_a_chance_is_met_as_often_as_it_says(name):
    struck = 0
    for seed in range(10):
        through, plug = way(seed=seed, **{name: 0.2})
        carried(through, MESSAGES)
        struck += plug.happened[name]
    n = 10 * len(MESSAGES)
    assert abs(struck / n - 0.2) < 4.0 * (0.2 * 0.8 / n) ** 0.5  # four standard deviations


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_the_same_seed_fails_in_the_same_way(seed):
    chances = dict.fromkeys(set(CHANCES) - {"unplug", "mute"}, 0.2)
    once, again = (carried(way(seed=seed, **chances)[0], MESSAGES) for _ in range(2))
    other = carried(way(seed=seed + 1, **chances)[0], MESSAGES)
    assert once == again != other


def test_a_pulled_cable_loses_what_is_under_way_and_comes_back_by_itself():
    plug = Plug("table", away_s=0.5)
    line = FaultyLine(Echo(), faults(late=1.0), Carrier.SERIAL, plug, random.Random(1))
    assert line.receive(b"question", 0.0) == b""
    plug.pull(0.1)
    assert line.tick(0.2) == b""
    assert line.lost
    assert line.receive(b"unheard", 0.3) == b""
    assert line.tick(0.61) == b""
    assert not line.lost
    line.receive(b"again", 0.7)
    line.tick(0.86)  # there
    assert line.tick(1.02) == b"again"  # and back


def test_a_planned_pull_counts_from_the_first_word():
    plug = Plug("table", away_s=0.5, pulled_after_s=2.0)
    line = FaultyLine(Echo(), faults(), Carrier.SERIAL, plug, random.Random(1))
    line.tick(50.0)
    assert line.receive(b"first", 100.0) == b"first"
    line.tick(101.9)
    assert not line.lost
    line.tick(102.0)
    assert line.lost
    line.tick(102.6)
    assert not line.lost
    assert plug.happened == {"unplug": 1}


def test_a_network_loses_datagrams():
    class Counting:
        sent = 0

        def datagrams(self, now_s: float) -> list[bytes]:
            del now_s
            self.sent += 1
            return [bytes([self.sent])]

    source = Counting()
    plug = Plug("profiler")
    network = FaultyNetwork(source, faults(drop=0.5), plug, random.Random(1))
    heard = [each for k in range(100) for each in network.datagrams(float(k))]
    assert len(heard) == 100 - plug.happened["drop"] < 70


def test_faults_of_a_wire_are_named_in_the_same_list_as_all_others():
    wires = parse_faults(
        "late=0.05, flip=0.01,late-ms=80,away-ms=900,unplug-stage=12,garbage=7"
    ).wires
    assert wires.chances == {"late": 0.05, "flip": 0.01}
    assert (wires.late_s, wires.away_s, wires.unplug_after_s) == (0.08, 0.9, {"stage": 12.0})


@pytest.mark.parametrize(
    ("fault", "wanted"),
    [
        ("late", "a chance from 0 to 1"),
        ("flip=2", "a chance from 0 to 1"),
        ("drop=-0.1", "a chance from 0 to 1"),
        ("cut=nan", "a chance from 0 to 1"),
        ("late-ms=1e9", "ms from 0 to 60000"),
        ("unplug-table=soon", "seconds from 0 on"),
        ("unplug-table=inf", "seconds from 0 on"),
        ("unplug-mains=3", "is not known"),
    ],
)
def test_an_impossible_fault_is_named_with_what_is_possible(fault, wanted):
    with pytest.raises(ValueError, match=wanted):
        parse_faults(fault)
