"""The Hokuyo driver, both its roles, against the simulated scanner, in a time of their own.

What the laser truly did is the World's word, not the driver's.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable
from itertools import islice
from types import MappingProxyType

import numpy as np
import pytest

from drivers.errors import DriverError, NoReply, Refused
from drivers.hokuyo import Geometry, Hokuyo, HokuyoLaser, ScipLine, Settings
from drivers.hokuyo.profiler import angles_rad, profile_of
from drivers.hokuyo.wire import Scan, Window, scan_command, scan_of
from drivers.laser import LaserSwitch
from drivers.profiler import Profiler, Reason, Tally
from drivers.recipes import Recited
from sim.faulty_wire import FaultyLine, Plug
from sim.hokuyo import HokuyoScanner, ScannerSettings
from sim.lasers import Slow as SlowLine
from sim.wire_faults import Carrier, WireFaults
from tests.drivers.virtual_wire import Clock, VirtualWire
from tests.sim.judges import dark_world

URG = Geometry("URG-04LX(Hokuyo Automatic Co.,Ltd.)", 20, 5600, 1024, 44, 725, 384, 600)
WINDOW = Settings(first_step=304, last_step=464)
ABOVE_THE_PEG_MM = 60.0


class Rig:
    def __init__(
        self,
        told: ScannerSettings | None = None,
        settings: Settings = WINDOW,
        wrap: Callable[[HokuyoScanner], object] = lambda scanner: scanner,
    ) -> None:
        self.world = dark_world()
        self.clock = Clock()
        self.scanner = HokuyoScanner(self.world, told)
        self.wire = VirtualWire(self.clock, wrap(self.scanner))
        self.line = ScipLine(
            self.wire, longest_reply_s=settings.wire_s, baud=settings.baud, clock=self.clock
        )
        self.profiler = Hokuyo(self.line, settings)
        self.laser = HokuyoLaser(self.line)

    @property
    def commands(self) -> list[bytes]:
        return [data.strip() for data in self.wire.written]


def test_it_keeps_the_three_protocols() -> None:
    rig = Rig()
    profiler: Profiler = rig.profiler
    laser: LaserSwitch = rig.laser
    assert profiler.tally() == Tally()
    assert laser.guarantee().watchdog_s is None
    assert isinstance(rig.laser, Recited)


def test_the_sensor_says_who_it_is_and_nothing_is_lit() -> None:
    rig = Rig()
    who = rig.profiler.identify()
    assert (who.family, who.model) == ("hokuyo", "SOKUIKI Sensor URG-04LX")
    assert (who.firmware, who.serial) == ("3.3.00(16/Apr./2008)", "H0000001")
    assert rig.laser.identify() == who
    assert rig.profiler.geometry() == URG
    assert not rig.world.laser_on


@pytest.mark.parametrize(
    ("told", "settings", "says"),
    [
        (ScannerSettings(vendor="Other"), WINDOW, "vendor"),
        (ScannerSettings(protocol="SCIP 1.1"), WINDOW, "SCIP 2"),
        (None, Settings(first_step=0, last_step=9, serial="H7"), "serial"),
        (None, Settings(first_step=44, last_step=90, firmware="4."), "firmware"),
        (None, Settings(first_step=0, last_step=99), "steps 0 to 99"),
    ],
)
def test_another_sensor_than_the_stations_is_refused(told, settings, says) -> None:
    with pytest.raises(Refused, match=says):
        Rig(told, settings).profiler.identify()


def test_a_sensor_in_scip_1_is_told_to_speak_2() -> None:
    rig = Rig(ScannerSettings(begins_in_scip_1=True))
    assert rig.profiler.identify().serial == "H0000001"


def test_no_question_lights_the_laser_and_a_dark_sensor_is_named() -> None:
    """MD would light it by itself; the driver has no MD."""
    rig = Rig()
    with pytest.raises(NoReply, match="its laser is off"):
        next(rig.profiler.profiles(0.5))
    assert not any(event["what"] == "laser" for event in rig.world.witness.events)
    assert not any(data.startswith(b"M") for data in rig.commands)


def test_the_laser_goes_on_and_off_and_is_read_back() -> None:
    rig = Rig()
    rig.laser.on()
    assert (rig.world.laser_on, rig.laser.is_on()) == (True, True)
    rig.laser.off()
    assert (rig.world.laser_on, rig.laser.is_on()) == (False, False)


def test_off_is_sent_whatever_is_believed() -> None:
    rig = Rig()
    rig.laser.off()
    assert any(b"QT" in data for data in rig.wire.written)


def test_a_laser_that_does_not_go_on_is_refused_by_its_status_and_put_out() -> None:
    rig = Rig(ScannerSettings(laser_works=False))
    with pytest.raises(Refused, match="malfunction"):
        rig.laser.on()
    assert b"QT" in rig.commands[-2]


class Deaf:
    """A sensor whose laser stays on."""

    def __init__(self, scanner: HokuyoScanner) -> None:
        self._scanner = scanner

    def receive(self, data: bytes, now_s: float) -> bytes:
        return b"" if b"QT" in data else self._scanner.receive(data, now_s)

    def tick(self, now_s: float) -> bytes:
        return self._scanner.tick(now_s)


def test_an_off_that_is_not_confirmed_calls_for_the_emergency_stop() -> None:
    rig = Rig(wrap=Deaf)
    rig.laser.on()
    with pytest.raises(Refused, match="press the emergency stop"):
        rig.laser.off()
    assert sum(b"QT" in data for data in rig.wire.written) == 3


def test_qt_waits_behind_no_reply_and_the_laser_is_dark_at_once() -> None:
    """A slow line holds 50 ms of a scan: QT passes it on the way there."""
    settings = Settings(first_step=304, last_step=460, baud=115200)
    rig = Rig(settings=settings, wrap=lambda scanner: SlowLine(scanner, 115200))
    rig.laser.on()
    with pytest.raises(NoReply):
        next(rig.profiler.profiles(0.01))  # a scan is under way
    asked_s = rig.clock()
    rig.laser.off()
    dark_s = next(
        event["time_s"] for event in rig.world.witness.events
        if event["what"] == "laser" and not event["on"]
    )  # fmt: skip
    assert dark_s - asked_s < 0.003  # a line of 10 characters takes 0.9 ms
    assert rig.clock() - asked_s < 0.1


def test_a_line_too_slow_to_confirm_a_switch_off_is_refused() -> None:
    with pytest.raises(ValueError, match="raise the baud rate"):
        Settings(first_step=44, last_step=725, baud=115200)


def test_profiles_are_what_stands_in_front_each_turn_once() -> None:
    """A peg of 20 mm, 225 mm away: in the middle its front, whole millimetres."""
    rig = Rig()
    rig.laser.on()
    profiles = list(islice(rig.profiler.profiles(1.0), 5))
    assert [each.frame for each in profiles] == [0, 1, 2, 3, 4]
    assert np.diff([each.sensor_time_s for each in profiles]) == pytest.approx([0.1] * 4)
    look = rig.world.look(rig.clock())
    seen = look.counts[look.seen] * 0.005
    ranges = np.hypot(*seen.T)
    mine = np.hypot(*profiles[-1].points_mm.T)
    assert len(mine) > 3
    assert abs(mine.min() - ranges.min()) <= 0.51 + 0.001  # half a millimetre and a count
    assert np.allclose(mine, np.rint(mine), atol=0.002)
    right = profiles[-1].points_mm[:, 0]
    assert right.min() < 0.0 < right.max()


def test_a_scan_of_before_the_discard_or_half_of_it_is_not_delivered() -> None:
    """GD gives the newest scan: right after BM, one of before QT, with a stamp of its own."""
    rig = Rig()
    rig.laser.on()
    assert len(next(rig.profiler.profiles(1.0)).points_mm) > 0
    rig.wire.sleep(0.12)  # another turn, that nobody asked for
    rig.laser.off()
    rig.world.stage.go(ABOVE_THE_PEG_MM, rig.clock(), speed=100.0)
    rig.wire.sleep(0.1 + rig.world.stage.ends_s() - rig.clock())
    rig.laser.on()
    stale = scan_of(rig.line.ask(scan_command(WINDOW.window)), WINDOW.window)
    assert np.any(stale.ranges > 20)  # the peg, which is below by now
    rig.profiler.discard()
    lit_s = rig.clock()
    after = next(rig.profiler.profiles(1.0))
    assert len(after.points_mm) == 0
    assert 0.1 < rig.clock() - lit_s < 0.35  # a whole turn at least, three and a look at most


def test_a_scan_that_was_asked_for_and_never_came_is_counted() -> None:
    rig = Rig()
    rig.laser.on()
    rig.profiler.geometry()
    receive = rig.scanner.receive
    rig.scanner.receive = lambda data, now_s: b""  # type: ignore[method-assign]
    with pytest.raises(NoReply, match="is the sensor on"):
        next(rig.profiler.profiles(0.35))
    rig.scanner.receive = receive  # type: ignore[method-assign]
    next(rig.profiler.profiles(1.0))
    assert 3 <= rig.profiler.tally().lost_profiles <= 4


def test_frames_of_axes_are_those_drawn() -> None:
    """256 steps before the front of 1024 are a quarter turn to the right."""
    geometry = Geometry("URG-04LX", 20, 5600, 1024, 44, 725, 384, 600)
    assert angles_rad(Window(128, 128), geometry) == pytest.approx([-math.pi / 2])
    scan = Scan(0, np.array([1000]))
    (point,) = profile_of(scan, Window(128, 128), geometry, 0.0, 0).points_mm
    assert point == pytest.approx([1000.0, 0.0], abs=0.001)
    in_threes = angles_rad(Window(383, 387, 3), geometry) * 1024 / math.tau
    assert in_threes == pytest.approx([0.0, 2.5])  # 383 to 385, and 386 and 387


def test_error_values_keep_their_places_and_say_why() -> None:
    ranges = np.array([0, 1, 2, 6, 7, 18, 19, 20, 5600, 5601])
    profile = profile_of(Scan(0, ranges), Window(380, 389), URG, 0.0, 0)
    R = Reason  # noqa: N806
    assert profile.reasons.tolist() == [
        R.OUT_OF_RANGE, R.NO_RETURN, R.NO_RETURN, R.UNKNOWN, R.UNKNOWN, R.SATURATED, R.OUT_OF_RANGE,
        R.MEASURED, R.MEASURED, R.OUT_OF_RANGE,
    ]  # fmt: skip
    utm = Geometry("UTM-30LX", 23, 60000, 1440, 0, 1080, 540, 2400)
    profile = profile_of(Scan(0, np.arange(6)), Window(0, 5), utm, 0.0, 0)
    assert profile.reasons.tolist() == [
        R.UNKNOWN, R.NO_RETURN, R.OUT_OF_RANGE, R.UNKNOWN, R.OUT_OF_RANGE, R.UNKNOWN,
    ]  # fmt: skip


def test_the_sensors_clock_wraps_in_the_midst_of_a_scan() -> None:
    rig = Rig(ScannerSettings(clock_ms=2**24 - 1_000_100))
    rig.laser.on()
    times = [each.sensor_time_s for each in islice(rig.profiler.profiles(1.0), 6)]
    assert np.diff(times) == pytest.approx([0.1] * 5)


def test_a_stream_that_another_program_left_on_does_not_disturb() -> None:
    rig = Rig()
    rig.wire.write(b"MD0304046401000\n")
    assert rig.world.laser_on
    rig.wire.sleep(0.5)
    rig.laser.off()
    assert not rig.world.laser_on
    assert rig.profiler.identify().serial == "H0000001"
    assert rig.line.dialogue.strays > 3


class Babbling:
    """A port on which something else never stops."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        return b""

    def tick(self, now_s: float) -> bytes:
        return b"U"


def test_no_babble_makes_a_wait_longer_than_its_deadline() -> None:
    rig = Rig(wrap=lambda _: Babbling())
    began_s = rig.clock()
    with pytest.raises(NoReply):
        rig.line.ask("II")
    assert rig.clock() - began_s < 2 * (0.1 + 0.02 + 0.005) + 0.01  # twice: reply, late, one step
    with pytest.raises(Refused, match="emergency stop"):
        rig.laser.off()
    assert rig.clock() - began_s < 5 * 0.13 + 0.01


def test_the_guards_words_put_the_laser_out_and_find_the_answers() -> None:
    """The guard knows no protocol: bytes, and patterns in what comes; a command broke off here."""
    rig = Rig()
    rig.laser.on()
    rig.wire.write(b"GD03040")
    (recipe,) = rig.laser.recipes()
    for word in (*recipe.words, *recipe.check):
        rig.wire.write(word.send)
        assert re.search(word.reply, rig.wire.read(word.within_s), re.DOTALL)
    assert not rig.world.laser_on
    assert not re.search(recipe.check[0].reply, b"II\n00P\nLASR:ON;U\n")


@pytest.mark.parametrize("seed", range(4))
def test_a_bad_wire_brings_no_false_profile_and_off_is_never_believed_falsely(seed: int) -> None:
    """40 exposures a seed; a true profile is the one that a sound wire brings at the same pose.

    A question fails by 0.30 (there 1 - 0.98 * 0.95**2 * 0.9, back without the noise, which stands
    before a reply and harms none), twice by 0.09; an exposure needs three: 30 of 40 are due, sigma
    is 2.7, five sigma below is 17.
    """
    chances = {"drop": 0.02, "flip": 0.05, "cut": 0.05, "noise": 0.1, "split": 0.2, "twice": 0.05}
    faults = WireFaults(chances=MappingProxyType(chances), late_s=0.05)
    plug, dice = Plug("hokuyo"), random.Random(seed)
    rig = Rig(wrap=lambda each: FaultyLine(each, faults, Carrier.SERIAL, plug, dice))
    sound = Rig()
    sound.laser.on()
    due = next(sound.profiler.profiles(1.0)).counts.tolist()
    came = 0
    for _ in range(40):
        try:
            rig.laser.on()
            profile = next(rig.profiler.profiles(1.0))
            assert profile.counts.tolist() == due
            came += 1
        except DriverError:
            pass
        try:
            rig.laser.off()
            assert not rig.world.laser_on
        except DriverError:
            pass
    assert came >= 17
    assert plug.happened["flip"] > 10
