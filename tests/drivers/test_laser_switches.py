"""A Grbl output and a timed relay as laser switches, and what each hands to a guard.

The devices are the simulator's, in one process and a time of their own; who is judged is the lamp
that hangs on them. The recipes are said here by hand, byte for byte, as the guard says them.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from drivers.baumer_ox import BaumerOx, Settings
from drivers.errors import NoReply, Refused
from drivers.grbl import GrblLaser
from drivers.laser import LaserSwitch
from drivers.links import ByteLink
from drivers.modbus import Framing, ModbusBus
from drivers.recipes import Order, Recipe, Word
from drivers.relay import BlockInputs, Coil, OutputBit, PlainRelay, TimedRelay, WatchedBlock
from sim.device import Device
from sim.grbl import GrblBoard
from sim.lasers import LaserWiring, Slow
from sim.modbus import RtuServer
from sim.parts import cylinder
from sim.relay import Contact, RelayBlock
from sim.stations import Layout, build
from sim.witness import Memory
from sim.world import World


@dataclass
class Line:
    """A serial line to a device, and the time; a `ByteLink`."""

    device: Device
    now_s: float = 0.0
    dead: bool = False
    inbox: bytes = b""
    sent: list[bytes] = field(default_factory=list)
    address: str = "serial:///test"

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self._let_pass(seconds)

    def read(self, timeout_s: float) -> bytes:
        if not self.inbox:
            self._let_pass(max(timeout_s, 0.0))
        data, self.inbox = self.inbox, b""
        return data

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        if not self.dead:
            self.inbox += self.device.receive(data, self.now_s)

    def close(self) -> None:
        """Nothing to close."""

    def _let_pass(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self.now_s < until_s and not self.inbox:
            self.now_s = min(self.now_s + 0.001, until_s)
            self.inbox += b"" if self.dead else self.device.tick(self.now_s)


def world_of(wiring: LaserWiring) -> tuple[World, RelayBlock, GrblBoard]:
    made = build(replace(Layout(), laser=wiring), cylinder(around=16), Memory(), 0.0)
    return made.world, made.relay, made.laser_board


def grbl() -> tuple[World, Line, GrblLaser]:
    world, _, board = world_of(LaserWiring.GRBL)
    line = Line(Slow(board, 115200))
    return world, line, GrblLaser(line, clock=line.clock)


def rtu(line: ByteLink, clock: Callable[[], float], sleep: Callable[[float], None]) -> ModbusBus:
    return ModbusBus(line, Framing.RTU, timeout_s=0.2, slowest_reply_s=0.3, baud=115200,
                     clock=clock, sleep=sleep)  # fmt: skip


def said(line: Line, recipe: Recipe) -> bool:
    """Say a recipe as the guard does, without its driver; whether it is confirmed."""
    line.read(recipe.quiet_s)
    for _ in range(3):
        for word in recipe.words:
            _answered(line, word)
    return all(_answered(line, word) for word in recipe.check)


def _answered(line: Line, word: Word) -> bool:
    line.write(word.send)
    until_s, came = line.now_s + word.within_s, b""
    while line.now_s < until_s and not re.search(word.reply, came, re.DOTALL):
        came += line.read(0.005)
    return bool(re.search(word.reply, came, re.DOTALL))


# --- Grbl -----------------------------------------------------------------------------------------


def test_a_grbl_output_goes_on_and_off_and_is_read_back() -> None:
    world, line, laser = grbl()
    laser.off()
    assert line.sent[0] == b"\x18"  # the first byte, before anything is asked
    assert laser.identify().family == "grbl"
    for _ in range(3):
        laser.on()
        assert world.laser_on
        assert laser.is_on()
        laser.on()  # again: only read back
        laser.off()
        assert not world.laser_on
        assert not laser.is_on()
    assert sum(data.startswith(b"M3") for data in line.sent) == 3


def test_grbl_is_switched_off_by_a_reset_and_never_by_a_line_that_could_wait() -> None:
    _, line, laser = grbl()
    laser.on()
    line.sent.clear()
    laser.off()
    assert line.sent[0] == b"\x18"
    assert not any(b"M5" in data for data in line.sent)


def test_an_off_that_a_board_does_not_confirm_is_raised() -> None:
    _, line, laser = grbl()
    laser.on()
    line.dead = True
    with pytest.raises(Refused, match=r"off was not confirmed in 3 tries .*emergency stop"):
        laser.off()
    with pytest.raises(NoReply, match="is the board on"):
        laser.is_on()


def test_a_board_in_laser_mode_is_refused() -> None:
    _, line, laser = grbl()
    laser.off()
    line.write(b"$32=1\n")
    line.sleep(0.1)
    with pytest.raises(Refused, match=r"set \$32=0"):
        laser.on()


def test_grbls_promise_is_that_there_is_none() -> None:
    _, _, laser = grbl()
    assert laser.guarantee().watchdog_s is None
    assert "stay at the station" in laser.guarantee().sentence


# --- timed ----------------------------------------------------------------------------------------


def test_a_timed_relay_drops_by_itself_and_stays_on_while_it_is_renewed() -> None:
    world, relay, _ = world_of(LaserWiring.TIMED)
    line = Line(RtuServer({1: relay}))
    laser = TimedRelay(rtu(line, line.clock, line.sleep), 1, clock=line.clock, sleep=line.sleep)
    laser.off()
    laser.on()
    begun_s = line.now_s
    while line.now_s < begun_s + 2.0:
        laser.on()
        assert world.laser_on
        line.sleep(0.05)
    last_s = line.now_s
    while world.laser_on:
        line.sleep(0.001)
    assert line.now_s - last_s <= 0.3
    # The frame as the seller prints it: flash on of relay 0, here for 300 ms.
    assert any(data[:6] == bytes.fromhex("01 05 02 00 00 03") for data in line.sent)


def test_a_plain_relay_does_not_know_a_timed_on() -> None:
    world, relay, _ = world_of(LaserWiring.PLAIN)
    line = Line(RtuServer({1: relay}))
    laser = TimedRelay(rtu(line, line.clock, line.sleep), 1, clock=line.clock, sleep=line.sleep)
    with pytest.raises(Refused):
        laser.on()
    assert not world.laser_on


# --- recipes --------------------------------------------------------------------------------------

SWITCHES: dict[str, Callable[[ModbusBus, Line], LaserSwitch]] = {
    "plain": lambda bus, line: PlainRelay(bus, 1, clock=line.clock, sleep=line.sleep),
    "timed": lambda bus, line: TimedRelay(bus, 1, clock=line.clock, sleep=line.sleep),
    "block by coil": lambda bus, line: WatchedBlock(
        bus, 1, Coil(0), watchdog_s=10.0, clock=line.clock, sleep=line.sleep
    ),
    "block by bit": lambda bus, line: WatchedBlock(
        bus, 1, OutputBit(0), watchdog_s=10.0, clock=line.clock, sleep=line.sleep
    ),
}


@pytest.mark.parametrize("name", SWITCHES)
def test_a_relays_recipe_turns_it_off_and_sees_it(name: str) -> None:
    wiring = {"plain": LaserWiring.PLAIN, "timed": LaserWiring.TIMED}.get(name, LaserWiring.TURCK)
    world, relay, _ = world_of(wiring)
    line = Line(RtuServer({1: relay}))
    switch = SWITCHES[name](rtu(line, line.clock, line.sleep), line)
    switch.guarantee()
    switch.on()
    assert world.laser_on
    (recipe,) = switch.recipes()  # type: ignore[attr-defined]
    assert recipe.order is Order.LASER
    (is_off,) = recipe.check
    assert not _answered(line, is_off)  # lit, and not taken for dark
    assert said(line, recipe)
    assert not world.laser_on


def test_a_recipe_of_a_grbl_laser_turns_it_off_and_sees_it() -> None:
    world, line, laser = grbl()
    laser.on()
    (recipe,) = laser.recipes()
    assert not _answered(line, recipe.check[0])
    assert said(line, recipe)
    assert not world.laser_on


def test_the_frames_of_a_recipe_are_the_manuals() -> None:
    line = Line(RtuServer({}))
    (recipe,) = PlainRelay(rtu(line, line.clock, line.sleep), 1).recipes()
    (off,), (is_off,) = recipe.words, recipe.check
    assert off.send == bytes.fromhex("01 05 00 00 00 00 CD CA")  # "relay 0 off" of Waveshare
    assert re.fullmatch(off.reply, off.send, re.DOTALL)
    assert is_off.send == bytes.fromhex("01 01 00 00 00 01 FD CA")
    assert recipe.quiet_s == pytest.approx(0.015 + 64 * 11 / 115200)
    assert recipe.wire_s == pytest.approx(8 * 11 / 115200)


def test_on_tcp_a_recipe_needs_no_silence_and_a_transaction_of_nobody_else() -> None:
    line = Line(RtuServer({}))
    bus = ModbusBus(line, Framing.TCP, timeout_s=0.5, slowest_reply_s=0.5, clock=line.clock)
    (recipe,) = PlainRelay(bus, 1, 3).recipes()
    assert recipe.words[0].send == bytes.fromhex("FF FF 00 00 00 06 01 05 00 03 00 00")
    assert recipe.quiet_s == 0.0
    (leave,) = BaumerOx(bus, line, Settings(0.01, 0.01)).recipes()
    assert leave.order is Order.SENSOR
    assert leave.words[0].send == bytes.fromhex("FF FF 00 00 00 06 01 06 00 01 00 01")


# --- the safety chain -----------------------------------------------------------------------------


@pytest.mark.parametrize("contact", Contact)
def test_an_open_contact_is_read_as_pressed_and_what_is_not_wired_is_well(contact: Contact) -> None:
    _, relay, _ = world_of(LaserWiring.TURCK)
    line = Line(RtuServer({1: relay}))
    bus = rtu(line, line.clock, line.sleep)
    inputs = BlockInputs(bus, 1, estop=0, interlock=1, key=2)
    well = inputs.read()
    assert (well.estop_pressed, well.interlock_open, well.key_on) == (False, False, True)
    relay.press(contact)
    now = inputs.read()
    assert now.estop_pressed == (contact is Contact.ESTOP)
    assert now.interlock_open == (contact is Contact.INTERLOCK)
    assert now.key_on == (contact is not Contact.KEY)
    assert BlockInputs(bus, 1).read() == well
    relay.release(contact)
    assert inputs.read() == well


def test_an_input_that_the_first_word_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="input 16; the block's first word has 0 to 15"):
        BlockInputs(rtu(Line(RtuServer({})), lambda: 0.0, lambda _: None), 1, estop=16)
