"""The laser switches against devices modelled from the manuals' text, in a time of their own.

The models know addresses and words a second time and judge the laser themselves: what counts is
when *their* output was on, not what the driver believes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.axis import Identity
from drivers.bus import Bus
from drivers.errors import DriverError, LinkLost, NoReply, Refused
from drivers.laser import Guarantee, LaserSwitch
from drivers.relay import Coil, OutputBit, PlainRelay, WatchedBlock
from drivers.relay.registers import text_of, watchdog_word

STATION = 3


@dataclass
class Block:
    """A multiprotocol block: 0x1120 at 0 holds the outputs, above 0 drops them after that time."""

    now_s: float = 0.0
    transaction_s: float = 0.003
    follows_s: float = 0.0  # from the write to the output, as a slow relay has it
    welded: bool = False  # a contact that never opens
    dead: bool = False  # an output that never closes
    shortest_ms: int = 0  # a watchdog time that the block will not go below
    keeps_watchdog: bool = True  # whether it takes what is written to 0x1120
    watchdog: bool = True  # whether it has 0x1120 at all
    words: dict[int, int] = field(default_factory=lambda: {0x0800: 0, 0x1120: 0})
    coils: dict[int, bool] = field(default_factory=dict)
    breaks: list[tuple[str, DriverError, bool]] = field(default_factory=list)
    log: list[tuple[str, int, int]] = field(default_factory=list)
    _heard_s: float = 0.0
    _changes: list[tuple[float, int]] = field(default_factory=list)

    @property
    def address(self) -> str:
        return "tcp://10.0.0.7:502"

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert 0.0 < seconds <= 0.05
        self.now_s += seconds

    def output(self, number: int = 0) -> bool:
        """What the output does now, whatever anybody believes."""
        limit_s = self.words[0x1120] / 1000.0
        if limit_s and self.now_s - self._heard_s > limit_s:
            self._changes.clear()
            self._set(0)
        while self._changes and self._changes[0][0] <= self.now_s:
            self._set(self._changes.pop(0)[1])
        return bool(self.words[0x0800] >> number & 1)

    def _set(self, word: int) -> None:
        held = self.words[0x0800] if self.welded else 0
        self.words[0x0800] = (0 if self.dead else word) | held

    def restart(self) -> None:
        self.words.update({0x0800: 0, 0x1120: 0})

    def read_holding(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        self._transact("read", device_id, first, 0)
        if first == 0x1120 and not self.watchdog:
            raise Refused("illegal address", code=2)
        if any(at not in self.words for at in range(first, first + count)):
            raise Refused("illegal address", code=2)
        return tuple(self.words[at] for at in range(first, first + count))

    def write_register(self, device_id: int, register: int, value: int) -> None:
        lost = self._transact("write", device_id, register, value)
        assert 0 <= value <= 0xFFFF
        if register == 0x1120 and not self.watchdog:
            raise Refused("illegal address", code=2)
        if lost is None or not lost[1]:
            if register == 0x0800:
                self._changes.append((self.now_s + self.follows_s, value))
                self.output()
            elif self.keeps_watchdog:
                self.words[register] = max(value, self.shortest_ms)
        if lost is not None:
            raise lost[0]

    def read_coils(self, device_id: int, first: int, count: int) -> tuple[bool, ...]:
        self._transact("read coil", device_id, first, 0)
        return tuple(self.output(at) for at in range(first, first + count))

    def write_coil(self, device_id: int, coil: int, value: bool) -> None:  # noqa: FBT001
        lost = self._transact("write coil", device_id, coil, int(value))
        if lost is None or not lost[1]:
            word = self.words[0x0800] & ~(1 << coil) | value << coil
            self._changes.append((self.now_s + self.follows_s, word))
            self.output()
        if lost is not None:
            raise lost[0]

    def read_input(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        raise Refused("function 4 is not supported", code=1)

    def write_registers(self, device_id: int, first: int, values: Sequence[int]) -> None:
        raise Refused("function 16 is not supported", code=1)

    def _transact(
        self, what: str, device_id: int, first: int, value: int
    ) -> tuple[DriverError, bool] | None:
        assert device_id == STATION
        self.now_s += self.transaction_s
        self.output()
        self.log.append((what, first, value))
        if not self.breaks or self.breaks[0][0] not in (_kind(what, first, value), "any"):
            self._heard_s = self.now_s
            return None
        _, error, before = self.breaks.pop(0)
        if what.startswith("read"):
            raise error
        return error, before

    def switchings(self) -> list[int]:
        """What was written to the output, in order."""
        return [value for what, at, value in self.log if what[:5] == "write" and at != 0x1120]

    def writes(self, first: int) -> list[int]:
        return [value for what, at, value in self.log if what.startswith("write") and at == first]


def _kind(what: str, first: int, value: int) -> str:
    """Name what a transaction is for, whichever function carries it."""
    if first == 0x1120:
        return "watchdog"
    if what.startswith("read"):
        return "read back"
    return "on" if value else "off"


def guarded(block: Block, *, bit: int = 0, watchdog_s: float = 0.25) -> WatchedBlock:
    return WatchedBlock(
        block,
        STATION,
        OutputBit(bit),
        watchdog_s=watchdog_s,
        clock=block.clock,
        sleep=block.sleep,
    )


def plain(block: Block, coil: int = 0) -> PlainRelay:
    return PlainRelay(block, STATION, coil, clock=block.clock, sleep=block.sleep)


def by_coil(block: Block) -> WatchedBlock:
    return WatchedBlock(
        block, STATION, Coil(0), watchdog_s=0.25, clock=block.clock, sleep=block.sleep
    )


@pytest.fixture
def block() -> Block:
    return Block()


@pytest.fixture(params=[guarded, plain, by_coil])
def switch(request: pytest.FixtureRequest, block: Block) -> LaserSwitch:
    made: LaserSwitch = request.param(block)
    return made


# --- every switch


def test_on_is_on_and_off_is_off_at_the_output_itself(switch: LaserSwitch, block: Block) -> None:
    switch.on()
    assert block.output()
    assert switch.is_on()
    switch.off()
    assert not block.output()
    assert not switch.is_on()


def test_off_is_sent_whatever_is_believed(switch: LaserSwitch, block: Block) -> None:
    switch.off()
    switch.off()
    assert block.switchings() == [0, 0]


def test_an_output_that_was_on_before_us_is_seen_and_switched_off(
    switch: LaserSwitch, block: Block
) -> None:
    block.words[0x0800] = 1
    assert switch.is_on()
    switch.off()
    assert not block.output()


def test_a_relay_that_needs_its_time_is_waited_for(switch: LaserSwitch, block: Block) -> None:
    block.follows_s = 0.05
    switch.on()
    assert block.output()
    switch.off()
    assert not block.output()
    assert block.switchings() == [1, 0]


@pytest.mark.parametrize("failures", [1, 2])
@pytest.mark.parametrize("error", [NoReply("no answer"), Refused("busy", code=6)])
def test_an_off_that_gets_lost_is_sent_again(
    switch: LaserSwitch, block: Block, failures: int, error: DriverError
) -> None:
    switch.on()
    block.log.clear()
    block.breaks.extend([("off", error, True)] * failures)
    switch.off()
    assert not block.output()
    assert block.switchings() == [0] * (failures + 1)


def test_a_read_back_that_gets_lost_makes_off_try_again(switch: LaserSwitch, block: Block) -> None:
    switch.on()
    block.log.clear()
    block.breaks.append(("read back", NoReply("no answer"), True))
    switch.off()
    assert not block.output()
    assert block.switchings() == [0, 0]


def test_a_welded_contact_is_tried_three_times_and_then_calls_for_the_emergency_stop(
    switch: LaserSwitch, block: Block
) -> None:
    switch.on()
    block.welded = True
    block.log.clear()
    before_s = block.now_s
    with pytest.raises(Refused, match="not confirmed in 3 tries: press the emergency stop"):
        switch.off()
    assert block.switchings() == [0, 0, 0]
    assert 0.3 <= block.now_s - before_s < 0.45


def test_a_lost_link_is_told_at_once_to_whoever_may_open_it_again(
    switch: LaserSwitch, block: Block
) -> None:
    lost = LinkLost("tcp://10.0.0.7:502: the peer closed")
    block.breaks.extend([("any", lost, True)])
    with pytest.raises(LinkLost, match=r"off was not heard.*the peer closed") as caught:
        switch.off()
    assert caught.value.__cause__ is lost


def test_an_output_that_does_not_go_on_is_refused_and_switched_off(
    switch: LaserSwitch, block: Block
) -> None:
    block.dead = True
    with pytest.raises(Refused, match="did not go on within"):
        switch.on()
    assert block.switchings() == [1, 0]


def test_an_on_whose_answer_is_lost_is_followed_by_off(switch: LaserSwitch, block: Block) -> None:
    block.breaks.append(("on", NoReply("no answer"), False))
    with pytest.raises(NoReply):
        switch.on()
    assert block.switchings() == [1, 0]
    assert not block.output()


def test_an_off_that_fails_after_a_failed_on_does_not_hide_it(
    switch: LaserSwitch, block: Block
) -> None:
    block.breaks.append(("on", NoReply("no answer"), False))
    block.welded = True
    with pytest.raises(NoReply) as caught:
        switch.on()
    assert any("press the emergency stop" in note for note in caught.value.__notes__)


# --- the watchdog


def test_the_watchdog_is_written_in_milliseconds_and_what_is_read_is_promised(
    block: Block,
) -> None:
    promise = guarded(block).guarantee()
    assert block.log == [("write", 0x1120, 250), ("read", 0x1120, 0)]
    assert promise.watchdog_s == 0.25
    assert "off 0.25 s after" in promise.sentence


def test_the_promise_is_what_the_block_took_not_what_was_asked(block: Block) -> None:
    block.shortest_ms = 500
    assert guarded(block).guarantee().watchdog_s == 0.5


def test_a_watchdog_that_reads_0_is_no_guarantee(block: Block) -> None:
    block.keeps_watchdog = False
    promise = guarded(block).guarantee()
    assert promise.watchdog_s is None
    assert "reads 0 ms after 250 were written" in promise.sentence


def test_a_block_without_the_register_is_no_guarantee(block: Block) -> None:
    block.watchdog = False
    promise = guarded(block).guarantee()
    assert promise.watchdog_s is None
    assert "refused to set its watchdog" in promise.sentence


def test_a_block_that_does_not_answer_is_not_called_unguarded_but_missing(block: Block) -> None:
    block.breaks.append(("watchdog", NoReply("no answer"), True))
    with pytest.raises(NoReply):
        guarded(block).guarantee()


def test_when_the_program_dies_the_block_drops_its_output_within_the_promised_time(
    block: Block,
) -> None:
    switch = guarded(block)
    promise = switch.guarantee()
    switch.on()
    assert promise.watchdog_s is not None
    block.now_s += promise.watchdog_s - 0.01
    assert block.output()
    block.now_s += 0.02
    assert not block.output()


def test_on_again_renews_the_watchdog(block: Block) -> None:
    switch = guarded(block)
    switch.guarantee()
    for _ in range(10):
        switch.on()
        block.now_s += 0.2
        assert block.output()


def test_a_block_that_was_restarted_is_not_lit_again_without_its_watchdog(block: Block) -> None:
    switch = guarded(block)
    switch.guarantee()
    switch.on()
    block.restart()
    block.log.clear()
    with pytest.raises(Refused, match="reads 0 ms, 250 were promised"):
        switch.on()
    assert block.writes(0x0800) == [0]


def test_a_lit_laser_whose_watchdog_was_changed_is_switched_off(block: Block) -> None:
    switch = guarded(block)
    switch.guarantee()
    switch.on()
    block.words[0x1120] = 60_000
    with pytest.raises(Refused, match="reads 60000 ms"):
        switch.on()
    assert not block.output()


@given(st.integers(1, 0xFFFF))
def test_a_time_in_whole_milliseconds_is_kept(milliseconds: int) -> None:
    assert watchdog_word(milliseconds / 1000.0) == milliseconds


@given(st.floats(0.001, 65.535))
def test_the_word_is_never_later_than_asked_and_never_0(watchdog_s: float) -> None:
    word = watchdog_word(watchdog_s)
    assert 1 <= word <= 0xFFFF
    assert watchdog_s - 0.001 < word / 1000.0 <= watchdog_s + 1e-6


@pytest.mark.parametrize("watchdog_s", [0.0, 0.0009, -0.25, 65.6, float("nan"), float("inf")])
def test_a_time_that_is_no_watchdog_is_a_mistake(block: Block, watchdog_s: float) -> None:
    with pytest.raises(ValueError, match="watchdog"):
        guarded(block, watchdog_s=watchdog_s)


# --- the output register


@pytest.mark.parametrize("bit", [0, 5, 15])
def test_an_output_bit_is_its_own_power_of_two(block: Block, bit: int) -> None:
    switch = guarded(block, bit=bit)
    switch.on()
    assert block.words[0x0800] == 1 << bit
    assert switch.is_on()
    switch.off()
    assert block.words[0x0800] == 0


def test_another_bit_that_is_on_is_not_our_laser(block: Block) -> None:
    block.words[0x0800] = 0b0010
    assert not guarded(block, bit=0).is_on()


@pytest.mark.parametrize("bit", [-1, 16])
def test_a_bit_that_no_register_has_is_a_mistake(bit: int) -> None:
    with pytest.raises(ValueError, match="there are 0 to 15"):
        OutputBit(bit)


def test_off_needs_no_read_before_it(block: Block) -> None:
    guarded(block).off()
    assert block.log[0] == ("write", 0x0800, 0)


# --- the plain relay


def test_a_plain_relay_promises_nothing_and_says_so_without_a_byte(block: Block) -> None:
    promise = plain(block).guarantee()
    assert promise.watchdog_s is None
    assert "stay at the station" in promise.sentence
    assert block.log == []


def test_a_plain_relay_uses_its_own_coil_only(block: Block) -> None:
    block.words[0x0800] = 0b101
    switch = plain(block, coil=1)
    switch.on()
    assert block.words[0x0800] == 0b111
    switch.off()
    assert block.words[0x0800] == 0b101
    assert [entry for entry in block.log if entry[1] != 1] == []


# --- who answered


def test_a_block_says_its_identifier_and_its_mapping(block: Block) -> None:
    name = b"TBEN-S1-8DOP\0\0"
    words = [int.from_bytes(name[at : at + 2], "big") for at in range(0, 14, 2)]
    block.words.update(zip(range(0x1000, 0x1007), words, strict=True))
    block.words[0x1017] = 2
    assert guarded(block).identify() == Identity("turck", "TBEN-S1-8DOP", "register mapping 2")


def test_a_block_without_identity_is_still_a_block(block: Block) -> None:
    assert guarded(block).identify() == Identity("turck", "I/O block without identity", "")


def test_a_block_that_fails_is_not_a_block_without_identity(block: Block) -> None:
    block.breaks.append(("read back", Refused("device failure", code=4), True))
    with pytest.raises(Refused, match="device failure"):
        guarded(block).identify()


def test_a_plain_relay_is_known_by_answering(block: Block) -> None:
    assert plain(block, coil=2).identify() == Identity("relay", "plain relay, coil 2", "")
    block.breaks.append(("read back", NoReply("no answer"), True))
    with pytest.raises(NoReply):
        plain(block).identify()


def test_words_that_are_no_text_are_shown_as_they_are() -> None:
    assert text_of([0x4142, 0x4300]) == "ABC"
    assert text_of([0x0102, 0x0304]) == "01020304"


def test_the_models_and_the_switches_keep_their_contracts(block: Block) -> None:
    bus: Bus = block
    switches: tuple[LaserSwitch, ...] = (guarded(block), plain(block))
    assert all(isinstance(each.guarantee(), Guarantee) for each in switches)
    assert bus.address == "tcp://10.0.0.7:502"
