"""One discipline for all motion: the same sentences, said of every family.

Each family is its own driver at its own simulated device; the world says where the axis truly is.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from drivers.axis import Axis, Motion
from drivers.errors import DriverError, LinkLost, NoReply, Refused
from drivers.grbl import GrblAxis
from drivers.recipes import Recited, Word
from tests.drivers.motion_cases import FAMILIES, Bench

every_family = pytest.mark.parametrize("name", FAMILIES)


class Interrupted(Exception):  # noqa: N818
    """What a caller's pause raises."""


def homed(name: str, scale: float = 1.0) -> tuple[Bench, Axis]:
    bench = Bench(FAMILIES[name], scale)
    axis = bench.driver()
    axis.home(bench.pause)
    return bench, axis


@every_family
def test_outside_the_soft_limits_no_byte_is_sent(name) -> None:
    bench, axis = homed(name)
    bench.sent.clear()
    family = bench.family
    for outside in (family.lower - 0.01 * family.unit, family.upper + 0.01 * family.unit):
        for move in (axis.move_to, axis.jog_to):
            with pytest.raises(Refused, match="outside its"):
                move(outside, bench.pause)
    with pytest.raises(ValueError, match="no position"):
        axis.move_to(math.nan, bench.pause)
    assert bench.sent == []


@every_family
def test_unhomed_it_does_nothing_but_home_and_jog_a_little(name) -> None:
    bench = Bench(FAMILIES[name])
    axis, unit = bench.driver(), bench.family.unit
    with pytest.raises(Refused, match="not homed"):
        axis.move_to(0.5 * unit, bench.pause)
    assert bench.sent == []
    here, stood = axis.state().position, bench.axis.motor(bench.now_s)
    with pytest.raises(Refused, match=r"jogs at most 1|locked since it started"):
        axis.jog_to(here + 1.5 * unit, bench.pause)
    assert bench.moves() == []
    if not isinstance(axis, GrblAxis):  # which is locked until it is homed, if it has a switch
        axis.jog_to(here + 0.5 * unit, bench.pause)
        assert bench.axis.motor(bench.now_s) - stood == pytest.approx(0.5 * unit, abs=0.02 * unit)


@every_family
def test_a_new_connection_moves_nothing_and_knows_no_home(name) -> None:
    bench, axis = homed(name)
    axis.move_to(5.0 * bench.family.unit, bench.pause)
    stood, before = bench.axis.motor(bench.now_s), len(bench.moves())
    again = bench.driver()
    again.identify()
    assert again.state().homed is False
    with pytest.raises(Refused, match="not homed"):
        again.move_to(0.0, bench.pause)
    assert (bench.axis.motor(bench.now_s), len(bench.moves())) == (stood, before)


@every_family
def test_a_lost_link_forgets_home(name) -> None:
    bench, axis = homed(name)
    bench.link.close()
    with pytest.raises(LinkLost):
        axis.state()
    with pytest.raises(Refused, match="not homed"):
        axis.move_to(0.0, bench.pause)


@every_family
def test_a_question_is_asked_three_times_at_most(name) -> None:
    bench, axis = homed(name)
    bench.sent.clear()
    bench.lose = lambda words: "answer"
    with pytest.raises(NoReply):
        axis.state()
    assert 1 < len([words for words in bench.sent if bench.family.asks(words)]) <= 3
    bench.lose = lambda words: ""
    assert axis.state().motion is Motion.STANDING


@every_family
@pytest.mark.parametrize("lost", ["answer", "request"])
def test_a_move_is_sent_once_whatever_becomes_of_it(name, lost) -> None:
    bench, axis = homed(name)
    bench.sent.clear()
    bench.lose = lambda words: lost if bench.family.moves(words) else ""
    target = 20.0 * bench.family.unit
    if lost == "answer":
        state = axis.move_to(target, bench.pause)
        assert state.position == pytest.approx(target, abs=0.06 * bench.family.unit)
    else:
        with pytest.raises((NoReply, Refused)):
            axis.move_to(target, bench.pause)
    assert len(bench.moves()) == 1


@every_family
def test_leaving_a_wait_stops_the_axis_and_the_position_is_read_where_it_stands(name) -> None:
    bench, axis = homed(name)
    zero, unit = bench.axis.motor(bench.now_s), bench.family.unit
    at_home = axis.state().position

    def pause(seconds: float) -> None:
        bench.pause(seconds)
        if abs(bench.axis.motor(bench.now_s) - zero) > 10.0 * unit:
            raise Interrupted

    with pytest.raises(Interrupted):
        axis.move_to(bench.family.upper - unit, pause)
    bench.pause(1.0)
    assert bench.axis.stands(bench.now_s)
    turned = bench.axis.motor(bench.now_s) - zero
    assert turned < 60.0 * unit
    assert axis.state().position - at_home == pytest.approx(turned, abs=0.06 * unit)


# --- stalls, lost steps, wrong scales: seeded cases, each beside a sound twin ----------------

FAULTS = ("stall", "lost steps", "wrong steps a unit", "sound")
SEEDS = range(20)


def drill(bench: Bench, axis: Axis, rng: np.random.Generator, fault: str) -> None:
    """Home, go about, go into the fault; whoever can only know by a switch looks there."""
    unit = bench.family.unit
    home = axis.home(bench.pause).position
    zero = bench.axis.motor(bench.now_s) - home
    for _ in range(3):
        axis.move_to(home + rng.uniform(0.0, 60.0) * unit, bench.pause)
    target = home + rng.uniform(70.0, 200.0) * unit
    if fault == "stall":
        bench.axis.obstacle = zero + target - rng.uniform(5.0, 60.0) * unit
    if fault == "lost steps":  # a motor that was held for a moment
        bench.axis.obstacle = zero + target - rng.uniform(0.15, 1.0) * unit
    axis.move_to(target, bench.pause)
    bench.axis.obstacle = None
    if isinstance(axis, GrblAxis):
        axis.check_reference(bench.pause)


@every_family
@pytest.mark.parametrize("seed", SEEDS)
def test_what_went_wrong_is_found_by_reading_back_and_what_did_not_is_left_alone(
    name, seed
) -> None:
    fault = FAULTS[seed % len(FAULTS)]
    rng = np.random.default_rng(1000 + seed)
    off = rng.choice([-1, 1]) * rng.integers(2, 40) / 64.0  # a 64th is a microstep of Zaber's
    bench = Bench(FAMILIES[name], 1.0 + off if fault == "wrong steps a unit" else 1.0)
    axis = bench.driver()
    if fault == "sound":
        drill(bench, axis, rng, fault)
        assert axis.state().homed
        return
    with pytest.raises(Refused) as found:
        drill(bench, axis, rng, fault)
    assert axis_forgot(axis)
    if fault == "wrong steps a unit":
        assert bench.moves() == []
        assert any(words in str(found.value) for words in ("steps", "pulses", "resolution"))


def axis_forgot(axis: Axis) -> bool:
    """Whether it no longer believes in its home; a device that refuses to talk is not homed."""
    try:
        return not axis.state().homed
    except DriverError:
        return True


def found(bench: Bench, word: Word) -> bool:
    """Say a word as somebody does who knows bytes and patterns and nothing else."""
    bench.link.write(word.send)
    heard, until_s = b"", bench.now_s + max(word.within_s, 0.01)
    while bench.now_s < until_s:
        heard += bench.link.read(0.005)
        if word.reply and re.search(word.reply, heard, re.DOTALL):
            return True
    return not word.reply


@every_family
def test_its_recipe_brings_it_to_rest_when_its_program_says_nothing_more(name) -> None:
    bench, axis = homed(name)
    assert isinstance(axis, Recited)
    recipe = axis.recipes()[0]
    target = 20.0 * bench.family.unit

    def hangs(seconds: float) -> None:
        """In the midst of a move; somebody else has the wire from here on."""
        bench.pause(seconds)
        if bench.axis.stands(bench.now_s):
            return
        bench.link.read(1e-3)
        begun_s = bench.now_s
        for word in recipe.words * 3:
            assert found(bench, word)
        (stands,) = recipe.check
        while not found(bench, stands):
            assert bench.now_s - begun_s < recipe.rest_s + 1.0
        assert bench.axis.stands(bench.now_s)
        assert abs(bench.axis.motor(bench.now_s) - target) > 0.1 * bench.family.unit
        raise Interrupted

    with pytest.raises(Interrupted):
        axis.move_to(target, hangs)
