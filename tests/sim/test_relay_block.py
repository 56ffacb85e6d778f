"""The simulated block of outputs: its coils and words, its watchdog, and our driver's switch."""

from __future__ import annotations

import pytest

from drivers.axis import Identity
from drivers.errors import NoReply, Refused
from drivers.modbus import Framing
from drivers.relay import Coil, OutputBit, PlainRelay, WatchedBlock
from sim.device import ModbusRefusal
from sim.modbus import RtuServer, TcpSession
from sim.relay import Block, Contact, RelayBlock, RelaySettings
from tests.sim.judges import START_S, RelayRig, Rig, dark_world

WATCHDOG_MS, LEFT_MS, OUTPUTS = 0x1120, 0x1020, 0x0800


def block_of(**told: object) -> RelayBlock:
    return RelayBlock(dark_world(), RelaySettings(**told))


def lit(block: RelayBlock) -> bool:
    return block._world.laser_on


def events(block: RelayBlock) -> list[dict[str, object]]:
    return block._world.witness.events


def rtu(text: str) -> bytes:
    return bytes.fromhex(text)


# ---- coils and words


def test_the_frames_of_a_plain_relay_are_answered_to_the_byte():
    # Modbus Application Protocol V1.1b3, 6.1 and 6.5, as the boards' makers print them: FF00 is on.
    block = block_of(block=Block.PLAIN)
    server = RtuServer({1: block})
    on, off = rtu("01 05 00 00 FF 00 8C 3A"), rtu("01 05 00 00 00 00 CD CA")
    assert server.receive(on, START_S) == on
    assert lit(block)
    assert server.receive(rtu("01 01 00 00 00 08 3D CC"), START_S) == rtu("01 01 01 01 90 48")
    assert server.receive(off, START_S) == off
    assert not lit(block)


def test_only_the_lasers_output_switches_the_laser():
    block = block_of(laser_output=2)
    block.write_coils(0, [True, True], START_S)
    assert not lit(block)
    block.write_coils(2, [True], START_S)
    assert lit(block)
    block.write_coils(0, [False, False], START_S)
    assert lit(block)
    assert block.read_coils(0, 8, START_S) == [False, False, True, *[False] * 5]
    assert events(block)[-1] == {"time_s": START_S, "what": "laser", "on": True, "why": "coil 2"}


@pytest.mark.parametrize("register", [OUTPUTS, 0x9000])
def test_the_outputs_are_the_bits_of_a_word_the_first_lowest(register):
    block = block_of(laser_output=2)
    block.write_registers(register, [0b0000_0110], START_S)
    assert lit(block)
    assert block.read_coils(0, 3, START_S) == [False, True, True]
    assert block.read_holding(OUTPUTS, 1, START_S) == [6]
    assert block.read_holding(0x9000, 2, START_S) == [6, 0]
    assert block.read_input(OUTPUTS, 1, START_S) == [6]
    block.write_registers(register, [0xFFFB], START_S)
    assert not lit(block)
    assert block.read_holding(OUTPUTS, 1, START_S) == [0xFB]  # eight outputs


def test_other_process_words_do_nothing():
    block = block_of()
    block.write_registers(OUTPUTS + 1, [0xFFFF], START_S)
    assert not lit(block)
    assert block.read_holding(OUTPUTS + 1, 1, START_S) == [0]


@pytest.mark.parametrize(
    ("first", "words", "code"),
    [
        (0x0000, [1], 2),
        (0x1000, [1], 2),
        (0x1017, [1], 2),
        (LEFT_MS, [1], 2),
        (0x1121, [1], 2),
        (0x0A00, [1], 2),
        (0x1130, [4], 3),
        (0x1130, [1, 1, 1], 2),
    ],
)
def test_a_write_that_is_not_allowed_is_refused_and_changes_nothing(first, words, code):
    block = block_of()
    with pytest.raises(ModbusRefusal) as refusal:
        block.write_registers(first, words, START_S)
    assert refusal.value.code == code
    assert block.read_holding(0x1130, 2, START_S) == [0, 0]


@pytest.mark.parametrize("address", [0x0A00, 0x0200, 0x100D, 0x1121, 0x1132])
def test_a_register_that_is_not_there_is_refused(address):
    with pytest.raises(ModbusRefusal) as refusal:
        block_of().read_holding(address, 1, START_S)
    assert refusal.value.code == 2


def test_a_coil_that_is_not_there_is_refused_and_nothing_switched():
    block = block_of(outputs=4)
    for ask in (
        lambda: block.read_coils(0, 5, START_S),
        lambda: block.write_coils(3, [True, True], START_S),
        lambda: block.write_coils(4, [True], START_S),
    ):
        with pytest.raises(ModbusRefusal) as refusal:
            ask()
        assert refusal.value.code == 2
    assert block.read_coils(0, 4, START_S) == [False] * 4


def test_the_safety_chain_is_closed_until_it_is_pressed_and_beyond_it_nothing_is_wired():
    block = block_of()
    assert block.read_discrete(0, 16, START_S) == [True] * 3 + [False] * 13
    assert block.read_holding(0x0000, 1, START_S) == [0b111]
    block.press(Contact.ESTOP)
    assert block.read_holding(0x0000, 1, START_S) == [0b110]
    block.release(Contact.ESTOP)
    assert block.read_holding(0x0000, 4, START_S) == [0b111, 0, 0, 0]
    with pytest.raises(ModbusRefusal):
        block.read_discrete(16 * 0x200 - 1, 2, START_S)


def test_its_name_begins_in_the_high_byte_and_the_mapping_is_the_second():
    block = block_of(name="TBEN-S2")
    assert block.read_holding(0x1000, 5, START_S) == [0x5442, 0x454E, 0x2D53, 0x3200, 0]
    assert block.read_holding(0x1017, 1, START_S) == [2]


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"laser_output": 8}, "output 8 of 8"),
        ({"outputs": 17}, "17 outputs"),
        ({"watchdog_ms": 70_000}, "70000 ms"),
    ],
)
def test_settings_that_no_block_has_are_a_mistake(told, said):
    with pytest.raises(ValueError, match=said):
        RelaySettings(**told)


# ---- the watchdog


def watched(watchdog_ms: int = 250) -> RelayBlock:
    """The laser on, and the last frame just heard."""
    block = block_of(watchdog_ms=watchdog_ms)
    block.heard(START_S)
    block.write_coils(0, [True, True], START_S)
    return block


def test_the_watchdog_drops_all_outputs_once_and_says_that_it_was_it():
    block = watched()
    block.tick(START_S + 0.249)
    assert lit(block)
    block.tick(START_S + 0.251)
    assert not lit(block)
    block.tick(START_S + 0.3)
    assert block.read_coils(0, 2, START_S + 0.3) == [False, False]
    off = {"time_s": START_S + 0.251, "what": "laser", "on": False, "why": "watchdog"}
    assert [event for event in events(block) if not event["on"]] == [off]


def test_any_frame_to_the_block_restarts_the_watchdog():
    block = watched()
    session = TcpSession({1: block})
    asked = bytes.fromhex("0001 0000 0006 01 03 FFF0 0001")  # a refused one, too
    for k in range(1, 20):
        session.receive(asked, START_S + 0.2 * k)
        session.tick(START_S + 0.2 * k + 0.1)
        assert lit(block)
    session.tick(START_S + 0.2 * 19 + 0.26)
    assert not lit(block)


def test_a_frame_that_comes_too_late_finds_the_outputs_dropped():
    block = watched()
    block.heard(START_S + 1.0)
    assert not lit(block)
    assert block.read_coils(0, 2, START_S + 1.0) == [False, False]


def test_frames_alone_do_not_light_again_what_was_dropped_and_a_write_does():
    block = watched()
    block.tick(START_S + 0.3)
    for k in range(5):
        block.heard(START_S + 0.4 + 0.1 * k)
        block.tick(START_S + 0.4 + 0.1 * k)
    assert not lit(block)
    block.write_coils(0, [True], START_S + 0.9)
    assert lit(block)
    assert block.read_coils(0, 2, START_S + 0.9) == [True, False]


def test_without_a_time_the_outputs_hold_for_ever():
    block = watched(watchdog_ms=0)
    block.tick(START_S + 1e6)
    assert lit(block)
    assert block.read_holding(LEFT_MS, 1, START_S) == [0]


def test_a_time_written_counts_from_its_frame_and_is_read_back():
    block = watched(watchdog_ms=0)
    block.heard(START_S + 5.0)
    block.write_registers(WATCHDOG_MS, [120], START_S + 5.0)
    assert block.read_holding(WATCHDOG_MS, 1, START_S + 5.0) == [120]
    assert block.read_holding(LEFT_MS, 1, START_S + 5.02) == [100]
    block.tick(START_S + 5.119)
    assert lit(block)
    block.tick(START_S + 5.121)
    assert not lit(block)
    assert block.read_holding(LEFT_MS, 1, START_S + 6.0) == [0]


def test_a_plain_board_has_no_watchdog_and_no_registers():
    block = block_of(block=Block.PLAIN, watchdog_ms=100)
    block.heard(START_S)
    block.write_coils(0, [True], START_S)
    block.tick(START_S + 1e3)
    assert lit(block)
    for ask in (
        lambda: block.read_holding(WATCHDOG_MS, 1, START_S),
        lambda: block.read_input(OUTPUTS, 1, START_S),
        lambda: block.read_discrete(0, 1, START_S),
        lambda: block.write_registers(OUTPUTS, [0], START_S),
    ):
        with pytest.raises(ModbusRefusal) as refusal:
            ask()
        assert refusal.value.code == 1
    assert lit(block)


# ---- passwords, power


def test_parameters_survive_the_power_only_when_saved():
    block = watched(watchdog_ms=0)
    block.write_registers(WATCHDOG_MS, [120], START_S)
    block.power_up(START_S)
    assert not lit(block)
    assert block.read_holding(WATCHDOG_MS, 1, START_S) == [0]
    block.write_registers(WATCHDOG_MS, [120], START_S)
    block.write_registers(0x113E, [0x7361], START_S)
    block.write_registers(0x113F, [0x7665], START_S + 29.0)
    block.write_registers(WATCHDOG_MS, [5], START_S + 29.0)
    block.power_up(START_S + 30.0)
    assert block.read_holding(WATCHDOG_MS, 1, START_S + 30.0) == [120]


def test_both_halves_of_a_password_may_come_in_one_frame():
    block = block_of(watchdog_ms=500)
    block.write_registers(WATCHDOG_MS, [120], START_S)
    block.write_registers(0x113C, [0x6C6F, 0x6164], START_S)
    assert block.read_holding(WATCHDOG_MS, 1, START_S) == [500]


@pytest.mark.parametrize(
    ("first", "second", "later_s"),
    [
        ((0x113C, 0x6C6F), (0x113D, 0x6164), 31.0),
        ((0x113C, 0x6C6E), (0x113D, 0x6164), 0.0),
        ((0x113C, 0x6C6F), (0x113D, 0x6165), 0.0),
        ((0x113E, 0x6C6F), (0x113D, 0x6164), 0.0),
    ],
)
def test_half_a_password_does_nothing(first, second, later_s):
    block = block_of()
    block.write_registers(WATCHDOG_MS, [120], START_S)
    block.write_registers(first[0], [first[1]], START_S)
    block.write_registers(second[0], [second[1]], START_S + later_s)
    assert block.read_holding(WATCHDOG_MS, 1, START_S + later_s) == [120]


# ---- our driver's switch


def test_the_driver_reads_who_it_is():
    assert RelayRig().laser.identify() == Identity("turck", "TBEN-S1-8DOP", "register mapping 2")


@pytest.mark.parametrize("output", [Coil(2), OutputBit(2)], ids=repr)
def test_the_driver_sees_that_the_watchdog_has_bitten_and_lights_again(output):
    rig = RelayRig(output)
    rig.laser.guarantee()
    rig.laser.on()
    rig.pause(0.3)
    assert not rig.laser.is_on()
    assert not rig.world.laser_on
    rig.laser.on()
    assert rig.world.laser_on


def test_the_driver_refuses_to_light_after_the_block_lost_its_power():
    rig = RelayRig()
    rig.laser.guarantee()
    rig.laser.on()
    rig.block.power_up(rig.now_s)
    with pytest.raises(Refused, match="reads 0 ms"):
        rig.laser.on()
    assert not rig.world.laser_on


def test_the_driver_promises_nothing_for_a_block_that_has_no_watchdog():
    world = dark_world()
    rig = Rig(TcpSession({1: RelayBlock(world, RelaySettings(block=Block.PLAIN))}))
    bus = rig.bus(Framing.TCP)
    laser = WatchedBlock(bus, 1, Coil(0), watchdog_s=0.2, clock=rig.clock, sleep=rig.pause)
    assert laser.guarantee().watchdog_s is None


def test_the_driver_switches_a_plain_relay_on_a_serial_line_which_holds_it():
    world = dark_world()
    rig = Rig(RtuServer({3: RelayBlock(world, RelaySettings(block=Block.PLAIN, laser_output=1))}))
    laser = PlainRelay(rig.bus(), 3, 1, clock=rig.clock, sleep=rig.pause)
    laser.on()
    rig.pause(5.0)
    assert world.laser_on
    assert laser.is_on()
    laser.off()
    assert not world.laser_on


def test_a_program_that_dies_leaves_the_laser_on_no_longer_than_was_promised():
    rig = RelayRig(watchdog_s=0.12)
    promised_s = rig.laser.guarantee().watchdog_s
    rig.laser.on()
    last_s = rig.now_s
    rig.link.write(bytes.fromhex("0009 0000 0006 01"))  # dies amid a request
    rig.pause(1.0)
    (off,) = (event for event in rig.world.witness.events if not event["on"])
    assert 0.0 < off["time_s"] - last_s <= promised_s + 0.002


def test_a_unit_that_is_not_on_the_line_is_not_heard_by_the_block():
    block = RelayBlock(dark_world(), RelaySettings(watchdog_ms=100))
    rig = Rig(RtuServer({3: block}))
    bus = rig.bus()
    bus.write_register(3, OUTPUTS, 1)
    with pytest.raises(NoReply):
        bus.read_coils(4, 0, 1)
    assert not lit(block)
