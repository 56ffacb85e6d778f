"""The Zaber axis at the simulated device, which was written from the manual a second time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from drivers.axis import Axis, Kind, Motion
from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.zaber import Chain, Settings, ZaberAxis
from sim.motion import Limits
from sim.zaber import ZaberChain, ZaberDevice, ZaberSettings
from tests.sim.judges import Rig, world_axis

STAGE = Settings(
    name="stage",
    kind=Kind.LINEAR,
    device=1,
    microsteps_per_unit=2000.0,
    lower=-3.0,
    upper=140.0,
    speed=20.0,
    tolerance=0.002,
    home_position=-3.0,  # neither zero nor sign may be muddled
)
TABLE = Settings(
    name="table",
    kind=Kind.ROTARY,
    device=2,
    microsteps_per_unit=6400.0 / 9.0,
    lower=-math.tau,
    upper=2 * math.tau,
    speed=math.pi / 2,
    tolerance=math.radians(0.01),
    encoder=True,
)
PER_RAD = math.degrees(6400.0 / 9.0)
MADE = {
    "stage": ZaberSettings(microsteps_per_unit=2000.0, home_at=5.0, travel=(0.0, 150.0)),
    "table": ZaberSettings(
        microsteps_per_unit=PER_RAD, home_at=0.4, travel=(-20.0, 40.0), encoder=True
    ),
}


class Wire(Rig):
    """Two devices on one chain and a log of what was written."""

    def __init__(self, **made: ZaberSettings) -> None:
        told = {**MADE, **made}
        self.stage_axis = world_axis("stage", 40.0, Limits(100.0, 2000.0))
        self.table_axis = world_axis("table", 1.0, Limits(10.0, 100.0))
        self.stage_device = ZaberDevice(self.stage_axis, told["stage"])
        self.table_device = ZaberDevice(self.table_axis, told["table"])
        self.sent: list[bytes] = []
        self.damage: Callable[[bytes], bytes] = lambda said: said
        self.deaf: Callable[[bytes], bool] = lambda line: False
        chain = ZaberChain({1: self.stage_device, 2: self.table_device})
        super().__init__(_Between(chain, self))
        self.chain = Chain(self.link, clock=self.clock)

    def stage(self, **changed: object) -> ZaberAxis:
        return ZaberAxis(self.chain, replace(STAGE, **changed))

    def table(self, **changed: object) -> ZaberAxis:
        return ZaberAxis(self.chain, replace(TABLE, **changed))

    def moves(self) -> list[bytes]:
        return [line for line in self.sent if b" move " in line or b" home" in line]


class _Between:
    """What lies between driver and chain: notes what was said, loses what it is told to."""

    def __init__(self, chain: ZaberChain, wire: Wire) -> None:
        self._chain, self._wire = chain, wire

    def receive(self, data: bytes, now_s: float) -> bytes:
        said = b""
        for line in data.splitlines(keepends=True):
            self._wire.sent.append(line)
            if not self._wire.deaf(line):
                said += self._wire.damage(self._chain.receive(line, now_s))
        return said

    def tick(self, now_s: float) -> bytes:
        return self._chain.tick(now_s)


@pytest.fixture
def wire() -> Wire:
    return Wire()


def test_it_is_an_axis(wire) -> None:
    axis: Axis = wire.stage()
    assert axis.kind is Kind.LINEAR


def test_it_homes_and_moves_to_where_the_world_says(wire) -> None:
    stage = wire.stage()
    home = stage.home(wire.pause)
    assert (home.position, home.homed, home.motion) == (-3.0, True, Motion.STANDING)
    assert math.isclose(wire.stage_axis.motor(wire.now_s), 5.0, abs_tol=1e-3)
    for target_mm in (12.34, 139.0, -2.5, 0.0):
        state = stage.move_to(target_mm, wire.pause)
        assert wire.stage_axis.stands(wire.now_s)
        assert math.isclose(wire.stage_axis.motor(wire.now_s) - 8.0, target_mm, abs_tol=5e-4)
        assert math.isclose(state.position, target_mm, abs_tol=5e-4)


def test_a_table_on_the_same_chain_turns_unwrapped_and_is_read_by_its_encoder(wire) -> None:
    stage, table = wire.stage(), wire.table()
    stage.home(wire.pause)
    table.home(wire.pause)
    for target_rad in (3.0, 7.0, -1.0):
        state = table.move_to(target_rad, wire.pause)
        turned = wire.table_axis.motor(wire.now_s) - 0.4
        assert math.isclose(turned, target_rad, abs_tol=2e-5)
        assert math.isclose(state.position, target_rad, abs_tol=2e-5)
    assert stage.state().position == -3.0  # the other one stood still
    assert any(b"get encoder.pos" in line for line in wire.sent)


def test_it_says_who_it_is_and_switches_checks_on_once(wire) -> None:
    who = wire.stage().identify()
    assert (who.family, who.model, who.firmware, who.serial) == (
        "zaber", "device id 50081", "7.38", "33001",
    )  # fmt: skip
    assert sum(b"comm.checksum" in line for line in wire.sent) == 1
    assert not wire.moves()
    assert wire.stage_device.writes == 2  # checks and speed; not again, the device keeps them
    wire.stage().identify()
    assert wire.stage_device.writes == 2


@pytest.mark.parametrize(
    ("made", "changed", "words"),
    [
        (ZaberSettings(resolution=128), {}, "resolution of 128"),
        (ZaberSettings(), {"serial": "77"}, "serial number 33001"),
        (ZaberSettings(version="5.20"), {}, "firmware 5.20"),
        (ZaberSettings(travel=(0.0, 100.0)), {}, "own limits"),
        (ZaberSettings(), {"encoder": True}, "no encoder"),
    ],
)
def test_a_device_that_is_not_the_stations_is_refused_and_nothing_moves(
    made, changed, words
) -> None:
    wire = Wire(stage=made)
    stage = wire.stage(**changed)
    for refused in (stage.identify, lambda: stage.home(wire.pause)):
        with pytest.raises(Refused, match=words):
            refused()
    assert not wire.moves()


def test_nothing_is_sent_for_a_target_outside_the_limits_or_before_homing(wire) -> None:
    stage = wire.stage()
    for outside in (-3.1, 141.0):
        with pytest.raises(Refused, match="soft limits"):
            stage.move_to(outside, wire.pause)
    with pytest.raises(ValueError, match="no position"):
        stage.move_to(math.nan, wire.pause)
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(1.0, wire.pause)
    assert wire.sent == []


def test_it_jogs_unhomed_by_a_millimetre_and_no_more(wire) -> None:
    stage = wire.stage()
    here = stage.state().position
    assert math.isclose(stage.jog_to(here + 0.9, wire.pause).position, here + 0.9, abs_tol=1e-3)
    assert math.isclose(wire.stage_axis.motor(wire.now_s), 40.9, abs_tol=1e-3)
    with pytest.raises(Refused, match="jogs at most"):
        stage.jog_to(here + 5.0, wire.pause)


def test_a_move_whose_answer_is_lost_arrives_and_one_that_was_not_heard_is_told(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    wire.sent.clear()
    wire.damage = lambda said: b"" if wire.sent[-1].find(b" move ") > 0 else said
    assert math.isclose(stage.move_to(20.0, wire.pause).position, 20.0, abs_tol=1e-3)
    assert len(wire.moves()) == 1
    wire.deaf = lambda line: b" move " in line
    with pytest.raises(NoReply, match="not sent again"):
        stage.move_to(30.0, wire.pause)
    assert len(wire.moves()) == 2


def test_a_query_is_asked_twice_and_no_more(wire) -> None:
    stage = wire.stage()
    stage.identify()
    wire.sent.clear()
    wire.damage = lambda said: b""
    with pytest.raises(NoReply):
        stage.state()
    assert len(wire.sent) == 2
    wire.damage = lambda said: said.replace(b"IDLE", b"IDLF")
    with pytest.raises(FrameError, match="damaged"):
        stage.state()


def test_a_reply_that_lost_its_check_is_not_believed(wire) -> None:
    stage = wire.stage()
    stage.identify()
    wire.damage = lambda said: said[:-5] + b"\r\n"
    with pytest.raises(FrameError, match="without its check"):
        stage.state()


def test_a_late_reply_is_never_taken_for_anothers(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    held: list[bytes] = []

    def late(said: bytes) -> bytes:
        """Each answer comes one question later."""
        held.append(said)
        return held[-2] if len(held) > 1 else b""

    wire.damage = late
    with pytest.raises(NoReply):
        stage.state()
    wire.damage = lambda said: said
    assert stage.state().position == -3.0
    assert wire.chain.dialogue.strays >= 1


def test_a_stop_waits_for_no_reply_and_is_said_again_until_acknowledged(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    seen: list[int] = []

    def pause(seconds: float) -> None:
        wire.pause(seconds)
        if wire.stage_axis.motor(wire.now_s) > 30.0 and not seen:
            seen.append(len(wire.sent))
            raise KeyboardInterrupt

    lost = iter([True, True, False])
    wire.deaf = lambda line: b" stop" in line and next(lost)
    with pytest.raises(KeyboardInterrupt):
        stage.move_to(100.0, pause)
    after = wire.sent[seen[0] :]
    assert [b" stop:" in line for line in after] == [True, True, True]
    wire.pause(0.5)
    assert wire.stage_axis.stands(wire.now_s)
    # Two of the stops were lost, and each was waited for half a second at 20 mm/s.
    assert wire.stage_axis.motor(wire.now_s) < 30.0 + 2 * 0.5 * 20.0 + 1.0


def test_a_stop_amid_a_question_leaves_both_answers_where_they_belong(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    chain, stopped = wire.chain, []

    def pause(seconds: float) -> None:
        if not stopped:
            stopped.append(True)
            stage.stop()
        wire.pause(seconds)

    reply = chain.ask(1, 1, "get pos", pause)
    assert reply.data == "0"
    lines = [line.split(b" ", 3)[3] for line in wire.sent[-2:]]
    assert lines[0].startswith(b"get pos")
    assert lines[1].startswith(b"stop")


def test_a_stall_that_the_device_sees_is_a_named_fault_and_homed_is_lost() -> None:
    wire = Wire(table=replace(MADE["table"], detects_stalls=True))
    table = wire.table()
    table.home(wire.pause)
    wire.table_axis.obstacle = 2.0
    with pytest.raises(Refused, match="FS stalled"):
        table.move_to(3.0, wire.pause)
    state = table.state()
    assert (state.motion, state.homed) == (Motion.ALARM, False)
    assert "FS" in state.alarm
    wire.table_axis.obstacle = None
    assert table.home(wire.pause).homed


def test_lost_steps_that_no_flag_tells_are_found_by_the_encoder() -> None:
    wire = Wire(table=replace(MADE["table"], detects_stalls=False))
    table = wire.table()
    table.home(wire.pause)
    wire.table_axis.obstacle = 0.4 + 3.0 - math.radians(0.05)
    with pytest.raises(Refused, match="stands at"):
        table.move_to(3.0, wire.pause)
    with pytest.raises(Refused, match="not homed"):
        table.move_to(1.0, wire.pause)


def test_a_power_cycle_forgets_homed(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    stage.move_to(10.0, wire.pause)
    wire.stage_device.power_cycle(wire.now_s)
    before = len(wire.moves())
    assert not stage.state().homed
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(12.0, wire.pause)
    assert len(wire.moves()) == before


def test_a_lost_link_forgets_homed(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    wire.link.close()
    with pytest.raises(LinkLost):
        stage.state()
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(12.0, wire.pause)


def test_a_reconnected_driver_moves_nothing_and_knows_no_home(wire) -> None:
    wire.stage().home(wire.pause)
    before = len(wire.moves())
    again = wire.stage()
    again.identify()
    assert not again.state().homed
    assert len(wire.moves()) == before


def test_alerts_and_infos_answer_nothing() -> None:
    wire = Wire(stage=replace(MADE["stage"], alerts=True))
    stage = wire.stage()
    stage.home(wire.pause)
    stage.move_to(20.0, wire.pause)
    wire.pause(0.05)
    stage.state()
    assert len(wire.chain.dialogue.alerts) == 2
    wire.chain.ask(1, 0, "help")
    stage.state()
    assert wire.chain.dialogue.infos[0].text == "COMMAND USAGE:"


def test_a_disabled_driver_is_named(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    wire.chain.order(1, 1, "driver disable")
    with pytest.raises(Refused, match="not homed"):
        stage.move_to(stage.state().position, wire.pause)
    with pytest.raises(Refused, match="FO driver disabled"):
        stage.home(wire.pause)


@pytest.mark.parametrize(
    "changed",
    [
        {"device": 0}, {"axis": 10}, {"microsteps_per_unit": 0.0}, {"lower": 200.0},
        {"tolerance": 1e-5}, {"speed": 1e-9}, {"upper": 1e9}, {"homing_s": math.inf},
    ],
)  # fmt: skip
def test_settings_that_make_no_axis_are_the_callers_mistake(changed) -> None:
    with pytest.raises(ValueError, match="stage"):
        replace(STAGE, **changed)


def test_a_question_that_comes_too_early_is_asked_again_and_an_order_is_not(wire) -> None:
    stage = wire.stage()
    stage.home(wire.pause)
    wire.sent.clear()

    def busy(said: bytes) -> bytes:
        """The first answer of each command is AGAIN."""
        if len(wire.sent) % 2 == 0:
            return said
        number = wire.sent[-1].split(b" ")[2].split(b":")[0]
        body = b"01 1 " + number + b" RJ IDLE -- AGAIN"
        return b"@%s:%02X\r\n" % (body, -sum(body) & 0xFF)

    wire.damage = busy
    assert wire.chain.ask(1, 1, "get pos").data == "0"
    assert len(wire.sent) == 2
    with pytest.raises(Refused, match="AGAIN"):
        wire.chain.order(1, 1, "move abs 10")
    assert len(wire.sent) == 3


@pytest.mark.parametrize("setting", [b"comm.checksum", b"maxspeed"])
def test_a_setting_whose_answer_is_lost_is_read_back_and_written_once(wire, setting) -> None:
    wire.damage = lambda said: b"" if b"set " + setting in wire.sent[-1] else said
    assert wire.stage().identify().serial == "33001"
    assert sum(b"set " + setting in line for line in wire.sent) == 1
    assert wire.stage_device.writes == 2


def test_a_setting_that_was_not_heard_is_told(wire) -> None:
    wire.deaf = lambda line: b"set maxspeed" in line
    with pytest.raises(Refused, match="maxspeed is 153600, 65536 was to be set"):
        wire.stage().identify()
