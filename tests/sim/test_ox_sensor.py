"""The simulated OX200 against frames laid out by hand, and with our driver at the other end."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.axis import Identity
from drivers.baumer_ox import BaumerOx
from drivers.baumer_ox import Quality as Signal
from drivers.baumer_ox import Settings as DriverSettings
from drivers.errors import NoReply, Refused
from drivers.loopback import Carrying, loopback
from drivers.modbus import Framing, ModbusBus
from drivers.profiler import Profile, Tally
from drivers.profiler import Reason as Why
from sim import AxisMotion, Flaws, Limits, OpticalBench, OpticsSettings, Play, Sensor, SimProfile
from sim.baumer_ox import Encoding, OxSensor, OxSettings, Quality
from sim.baumer_ox.frames import frames, profile_body
from sim.baumer_ox.reading import Reading
from sim.device import ModbusRefusal
from sim.modbus import TcpSession
from sim.witness import Memory
from sim.world import Pace, World, WorldAxis
from tests.sim.optics_cases import peg

# The layout of the bench, and, for the driver and the truth, written a second time: neither scale
# is the other's, x has both signs, and z is above 32 767 counts everywhere.
EYE = Sensor(
    points=120,
    near_mm=190.0,
    far_mm=260.0,
    width_mm=40.0,
    x_mm_per_count=0.002,
    z_mm_per_count=0.005,
    x_offset_mm=1.5,
    z_offset_mm=20.0,
)
X_MM, Z_MM, X_0_MM, Z_0_MM = 0.002, 0.005, 1.5, 20.0
BRIGHT = Flaws(full_intensity=60_000)  # most intensities do not fit 15 bits
START_S = 1000.0


def peg_bench() -> OpticalBench:
    """A peg of 10 mm beside the axis; seen from azimuth 0 its middle is at x = -1, z = 223."""
    return OpticalBench(peg(2.0, -1.0), OpticsSettings(sensor=EYE, flaws=BRIGHT))


def bench_of(profile: SimProfile) -> SimpleNamespace:
    """A bench that always sees the same."""
    return SimpleNamespace(settings=OpticsSettings(sensor=EYE), profile=lambda *_: profile)


def sim_profile(x, z, intensity) -> SimProfile:
    """One whose beams return where z is not 0."""
    reasons = np.where(np.asarray(z) > 0, 0, 2)
    return SimProfile(np.column_stack([x, z]), reasons, np.asarray(intensity))


THREE = sim_profile([-100, 0, 100], [25_000, 0, 40_000], [1_000, 0, 65_535])


def world_of(bench, pace: Pace | None = None) -> World:
    pace, witness = pace or Pace(), Memory()
    stage = AxisMotion.standing(5.0, Limits(20.0, 100.0), Play(0.25))
    table = AxisMotion.standing(0.0, Limits(1.0, 5.0), Play(0.01))
    axes = [
        WorldAxis(name, motion, pace, witness)
        for name, motion in (("table", table), ("stage", stage))
    ]
    return World(bench, *axes, pace, witness)


def lit_world(bench, pace: Pace | None = None) -> World:
    world = world_of(bench, pace)
    world.switch_laser(START_S, on=True, why="test")
    return world


def profile_notes(world: World) -> list[dict[str, object]]:
    return [event for event in world.witness.events if event["what"] == "profile"]


class Rig:
    """Driver and sensor on a TCP connection and a stream of datagrams; reads make time pass."""

    def __init__(
        self,
        world: World,
        told: OxSettings | None = None,
        *,
        arrives: Callable[[bytes], bool] = lambda _: True,
    ) -> None:
        self.now_s = START_S
        self.world = world
        self.sensor = OxSensor(world, told)
        self.arrives = arrives
        self.sent: list[bytes] = []
        self._session = TcpSession({1: self.sensor})
        near, self._registers = loopback("ox", wait=self._wait)
        stream, self._stream = loopback("ox", carrying=Carrying.DATAGRAMS, wait=self._wait)
        self.bus = ModbusBus(
            near, Framing.TCP, timeout_s=0.3, slowest_reply_s=0.1, clock=self._clock,
            sleep=self._wait,
        )  # fmt: skip
        layout = DriverSettings(X_MM, Z_MM, X_0_MM, Z_0_MM)
        self.ox = BaumerOx(self.bus, stream, layout, clock=self._clock)

    def take(self, count: int) -> list[Profile]:
        return list(islice(self.ox.profiles(0.5), count))

    def _clock(self) -> float:
        return self.now_s

    def _wait(self, seconds: float) -> None:
        """Let the sensor live on, 2 ms at a time, until it has said something."""
        ends_s, said = self.now_s + seconds, False
        while self.now_s < ends_s and not said:
            self.now_s = min(self.now_s + 0.002, ends_s)
            said = self._live()

    def _live(self) -> bool:
        answer = self._session.receive(self._registers.read(0.0), self.now_s)
        answer += self._session.tick(self.now_s)
        self._registers.write(answer)
        due = self.sensor.datagrams(self.now_s)
        self.sent += due
        coming = [datagram for datagram in due if self.arrives(datagram)]
        for datagram in coming:
            self._stream.write(datagram)
        return bool(answer or coming)


# By hand from the manual's tables (V2, pages 35 to 39; framing V4, page 44).
HEAD = "0000FA43 00F15365 90D00300 0000 03000000"  # 500 Hz, 1 700 000 000 s, 250 000 us, no
#                                                     encoder, three points
GOOD = Reading(
    parametrising=False, quality=Quality.OK, rate_hz=500.0, time_us=1_700_000_000_250_000
)
BLIND = Reading(
    parametrising=True, quality=Quality.NO_SIGNAL, rate_hz=500.0, time_us=1_700_000_000_250_000
)


@pytest.mark.parametrize(
    ("reading", "encoding", "golden"),
    [
        (GOOD, Encoding.Z, "01 00 00 01 00 00" + HEAD + "9CFFA861 00000000 6400409C"),
        (GOOD, Encoding.I, "02 00 00 01 00 00" + HEAD + "9CFFE803 00000000 6400FFFF"),
        (
            BLIND,
            Encoding.ZI,
            "03 01 00 00 01 02" + HEAD + "9CFFA861E803 000000000000 6400409CFFFF",
        ),
    ],
)
def test_a_body_is_laid_out_as_the_manual_draws_it(reading, encoding, golden):
    assert profile_body(reading, THREE, encoding) == bytes.fromhex(golden)


def test_a_body_that_fits_goes_in_a_single_frame():
    assert frames(b"body", 0x0A0B0C0D, 12) == [bytes.fromhex("0D0C0B0A 00 00 0000") + b"body"]


def test_a_longer_body_is_counted_in_its_first_frame_and_indexed_in_the_others():
    assert frames(b"a body of parts", 10, 12) == [
        bytes.fromhex("0A000000 01 00 0400") + b"a bo",
        bytes.fromhex("0A000000 02 00 0100") + b"dy o",
        bytes.fromhex("0A000000 02 00 0200") + b"f pa",
        bytes.fromhex("0A000000 02 00 0300") + b"rts",
    ]


def test_the_texts_begin_in_the_high_byte_and_the_type_in_the_middle_of_a_word():
    told = OxSettings(product_id="123456789", sensor_type="OXM", serial="7012A")
    sensor = OxSensor(world_of(bench_of(THREE)), told)
    vendor = sensor.read_input(0, 33, START_S)
    assert vendor[:4] == [0x4261, 0x756D, 0x6572, 0x2045]  # "Baumer E"
    assert len(vendor) == 33
    assert sensor.read_input(40, 49, START_S) == [
        *(0x3132, 0x3334, 0x3536, 0x3738, 0x394F, 0x584D),
        *(0,) * 31,
        *(0x3730, 0x3132, 0x4100),
        *(0,) * 9,
    ]


def test_the_readings_have_their_low_words_first():
    # 40 000 * 0.005 + 20 = 220 mm = 0x435C0000; 0.1 Hz = 0x3DCCCCCD; 1000.123456 s
    world = lit_world(bench_of(sim_profile([0, 0], [0, 40_000], [0, 9])))
    sensor = OxSensor(world, OxSettings(rate_hz=0.1))
    assert sensor.read_input(200, 24, 1000.123456) == [
        *(0x0004, 0, 0),
        *(0x0000, 0x435C),
        *(0x0000, 0x7FC0) * 6,
        *(0xCCCD, 0x3DCC),
        *(1000, 0),
        *(0xE240, 0x0001),  # 123 456
        0,
    ]


def test_the_time_stamp_is_two_words_of_seconds():
    sensor = OxSensor(world_of(bench_of(THREE), Pace(origin_s=-1_700_000_000.0)))
    assert sensor.read_input(219, 4, 0.0) == [0xF100, 0x6553, 0, 0]


def test_the_driver_reads_who_it_is():
    told = OxSettings(product_id="123456789", serial="12345678901234567890")
    assert Rig(world_of(peg_bench()), told).ox.identify() == Identity(
        family="baumer_ox",
        model="OX200 (simulated) 123456789",
        firmware="",
        serial="12345678901234567890",
    )


def test_the_driver_reads_the_nearest_point_in_millimetres():
    said = Rig(lit_world(peg_bench()), OxSettings(rate_hz=160.1)).ox.status()
    assert (said.valid, said.alarm, said.quality) == (True, False, Signal.GOOD)
    assert said.values[0] == pytest.approx(213.0, abs=0.02)  # the peg's middle, less its radius
    assert all(math.isnan(value) for value in said.values[1:])
    assert said.rate_hz == pytest.approx(160.1)
    assert said.seconds + said.microseconds * 1e-6 == pytest.approx(START_S + 0.002)


@pytest.mark.parametrize("laser", ["off", "past the part"])
def test_without_a_return_there_is_no_signal_and_nothing_is_valid(laser):
    nothing = sim_profile([0, 0], [0, 0], [0, 0])
    world = world_of(peg_bench()) if laser == "off" else lit_world(bench_of(nothing))
    said = Rig(world).ox.status()
    assert (said.valid, said.alarm, said.quality) == (False, True, Signal.NO_SIGNAL)
    assert all(math.isnan(value) for value in said.values)


def test_the_driver_loads_a_setup():
    rig = Rig(world_of(peg_bench()))
    assert rig.ox.active_setup() == 1
    rig.ox.load_setup(3, rig._wait)
    assert rig.ox.active_setup() == 3
    assert not rig.ox.status().parametrising


def test_a_setup_is_refused_outside_of_parametrisation():
    rig = Rig(world_of(peg_bench()), OxSettings(setup=2))
    with pytest.raises(Refused, match="code 4"):
        rig.bus.write_register(1, 501, 3)
    rig.bus.write_register(1, 0, 77)
    rig.bus.write_register(1, 1, 77)
    with pytest.raises(Refused, match="code 4"):
        rig.bus.write_register(1, 501, 3)
    assert rig.ox.active_setup() == 2


def test_a_setup_that_is_not_there_is_refused():
    rig = Rig(world_of(peg_bench()))
    with pytest.raises(Refused, match="code 3"):
        rig.ox.load_setup(4, rig._wait)
    assert rig.ox.active_setup() == 1


def test_any_value_requests_parametrisation_and_raises_the_alarm():
    rig = Rig(lit_world(peg_bench()))
    rig.bus.write_register(1, 0, 0)
    assert (rig.ox.status().parametrising, rig.ox.status().alarm) == (True, True)
    rig.bus.write_registers(1, 0, [1, 1])  # requested, and left
    assert (rig.ox.status().parametrising, rig.ox.status().alarm) == (False, False)


@pytest.mark.parametrize(
    ("first", "count"),
    [(33, 1), (0, 34), (39, 2), (88, 2), (199, 2), (223, 2), (401, 2), (2500, 1)],
)
def test_an_address_that_the_manual_does_not_list_is_refused(first, count):
    with pytest.raises(Refused, match="code 2"):
        Rig(world_of(peg_bench())).bus.read_input(1, first, count)


@pytest.mark.parametrize(("first", "words"), [(2, [1]), (0, [1, 1, 1]), (501, [1, 1]), (401, [1])])
def test_a_command_that_the_manual_does_not_list_is_refused_and_changes_nothing(first, words):
    rig = Rig(lit_world(peg_bench()))
    with pytest.raises(Refused, match="code 2"):
        rig.bus.write_registers(1, first, words)
    assert not rig.ox.status().parametrising


@pytest.mark.parametrize("ask", ["read_coils", "read_discrete"])
def test_it_knows_nothing_of_bits(ask):
    sensor = OxSensor(world_of(peg_bench()))
    with pytest.raises(ModbusRefusal) as refusal:
        getattr(sensor, ask)(0, 1, START_S)
    assert refusal.value.code == 1
    with pytest.raises(ModbusRefusal) as refusal:
        sensor.write_coils(0, [True], START_S)
    assert refusal.value.code == 1


@pytest.mark.parametrize("most_bytes", [1400, 107])  # one datagram, and many cut within points
@pytest.mark.parametrize("encoding", [Encoding.Z, Encoding.ZI])
def test_the_drivers_points_are_those_of_the_truth(encoding, most_bytes):
    rig = Rig(lit_world(peg_bench()), OxSettings(encoding=encoding, most_bytes=most_bytes))
    (profile,) = rig.take(1)
    truth = rig.world.look(rig.now_s)
    counts = truth.counts[truth.seen]
    truth_mm = np.column_stack([counts[:, 0] * X_MM + X_0_MM, counts[:, 1] * Z_MM + Z_0_MM])
    assert (counts[:, 0] < 0).any()
    assert counts[:, 1].min() > 32_767
    np.testing.assert_allclose(profile.points_mm, truth_mm, rtol=0.0, atol=1e-9)
    assert ((profile.reasons == Why.MEASURED) == truth.seen).all()
    assert (profile.reasons[~truth.seen] == Why.NO_RETURN).all()
    told = truth.intensity if encoding is Encoding.ZI else []
    np.testing.assert_array_equal(profile.intensity, told)


def test_the_drivers_points_lie_on_the_peg():
    (profile,) = Rig(lit_world(peg_bench())).take(1)
    x_mm, z_mm = profile.points_mm.T
    assert np.hypot(x_mm + 1.0, z_mm - 223.0) == pytest.approx(10.0, abs=0.006)
    assert np.ptp(x_mm) > 18.0


def test_an_intensity_profile_tells_no_distance():
    rig = Rig(lit_world(peg_bench()), OxSettings(encoding=Encoding.I))
    (profile,) = rig.take(1)
    truth = rig.world.look(rig.now_s)
    np.testing.assert_array_equal(profile.counts[:, 0], truth.counts[:, 0])
    np.testing.assert_array_equal(profile.intensity, truth.intensity)
    assert profile.intensity.max() > 32_767
    assert (profile.reasons == Why.UNKNOWN).all()


WORDS = st.integers(0, 65_535)


@given(
    points=st.lists(st.tuples(st.integers(-32_768, 32_767), WORDS, WORDS), min_size=1, max_size=60),
    encoding=st.sampled_from(Encoding),
    most_bytes=st.integers(32, 500),
)
@settings(deadline=None, max_examples=60)
def test_whatever_is_seen_arrives_in_any_encoding_and_any_number_of_frames(
    points, encoding, most_bytes
):
    x, z, intensity = (np.array(column) for column in zip(*points, strict=True))
    world = lit_world(bench_of(sim_profile(x, z, intensity)))
    rig = Rig(world, OxSettings(encoding=encoding, most_bytes=most_bytes))
    (profile,) = rig.take(1)
    told_z = np.zeros_like(z) if encoding is Encoding.I else z
    np.testing.assert_array_equal(profile.counts, np.column_stack([x, told_z]))
    np.testing.assert_array_equal(profile.intensity, [] if encoding is Encoding.Z else intensity)
    assert max(map(len, rig.sent)) <= most_bytes
    assert rig.ox.tally() == Tally(profiles=1)


@pytest.mark.parametrize("indices", [{1}, {2}, {3}, {1, 3}])
@pytest.mark.parametrize(("encoding", "point_bytes"), [(Encoding.Z, 4), (Encoding.ZI, 6)])
def test_a_frame_that_is_lost_takes_its_points_and_no_others(encoding, point_bytes, indices):
    size = 8 + 24 + 115  # of four or more frames; the first ends within a point

    def arrives(datagram: bytes) -> bool:
        return datagram[4] != 2 or datagram[6] not in indices

    rig = Rig(
        lit_world(peg_bench()), OxSettings(encoding=encoding, most_bytes=size), arrives=arrives
    )
    profile, _ = rig.take(2)
    truth = rig.world.look(rig.now_s)
    room = size - 8
    lost = np.zeros(120, bool)
    for index in indices:
        begins, ends = index * room - 24, (index + 1) * room - 24
        lost[begins // point_bytes : math.ceil(ends / point_bytes)] = True
    np.testing.assert_array_equal(profile.reasons == Why.LOST, lost)
    np.testing.assert_array_equal(profile.counts[~lost], truth.counts[~lost])
    assert rig.ox.tally() == Tally(profiles=2, torn_profiles=2)


@pytest.mark.parametrize("taken", ["the first frame", "all frames"])
def test_a_profile_of_which_nothing_can_be_told_is_lost(taken):
    def arrives(datagram: bytes) -> bool:
        block = int.from_bytes(datagram[:4], "little")
        return block % 3 != 0 or (taken == "the first frame" and datagram[4] != 1)

    rig = Rig(lit_world(peg_bench()), OxSettings(most_bytes=200), arrives=arrives)
    numbers = [profile.frame for profile in rig.take(4)]
    assert numbers == [1, 2, 4, 5]
    assert rig.ox.tally() == Tally(profiles=4, lost_profiles=1)


def test_profiles_follow_each_other_at_the_rate_and_none_is_missing():
    rig = Rig(lit_world(peg_bench()))
    profiles = rig.take(5)
    numbers = [profile.frame for profile in profiles]
    assert numbers == list(range(numbers[0], numbers[0] + 5))
    assert numbers == [note["frame"] for note in profile_notes(rig.world)]
    assert rig.ox.tally() == Tally(profiles=5)
    times_s = [profile.sensor_time_s for profile in profiles]
    assert np.diff(times_s) == pytest.approx(0.010, abs=0.0021)  # reads are 2 ms apart
    assert times_s[-1] == pytest.approx(rig.now_s, abs=1e-6)


def test_with_the_laser_off_the_driver_says_that_nothing_came():
    rig = Rig(world_of(peg_bench()))
    with pytest.raises(NoReply, match="is the laser on"):
        rig.take(1)
    assert rig.sent == []
    assert profile_notes(rig.world) == []


def test_dark_periods_are_not_sent_and_take_no_number():
    world = world_of(bench_of(THREE))
    sensor = OxSensor(world)
    numbers = []
    for period in range(10):
        world.switch_laser(START_S, on=period not in range(3, 7), why="test")
        due = sensor.datagrams(START_S + (period + 0.5) / 100.0)
        numbers += [int.from_bytes(frame[:4], "little") for frame in due]
    assert numbers == list(range(6))


def test_a_period_that_began_in_the_dark_stays_dark():
    world = world_of(bench_of(THREE))
    sensor = OxSensor(world)
    assert len(sensor.datagrams(START_S + 0.001)) == 0
    world.switch_laser(START_S + 0.002, on=True, why="test")
    assert len(sensor.datagrams(START_S + 0.009)) == 0
    assert len(sensor.datagrams(START_S + 0.011)) == 1


def test_a_profile_is_sent_once():
    sensor = OxSensor(lit_world(bench_of(THREE)))
    assert len(sensor.datagrams(START_S + 0.001)) == 1
    assert len(sensor.datagrams(START_S + 0.009)) == 0
    assert len(sensor.datagrams(START_S + 0.011)) == 1


def test_after_a_pause_only_the_newest_profile_is_due_and_it_is_the_next_block():
    sensor = OxSensor(lit_world(bench_of(THREE)))
    sensor.datagrams(START_S)
    (newest,) = sensor.datagrams(START_S + 7.005)
    assert newest[:4] == (1).to_bytes(4, "little")
    assert len(sensor.datagrams(START_S + 7.006)) == 0


def test_the_rate_follows_the_stations_time():
    sensor = OxSensor(lit_world(bench_of(THREE), Pace(START_S, 10.0)))
    told = [sensor.datagrams(START_S + step * 0.002 + 0.0001) for step in range(4)]
    assert [int.from_bytes(frame[:4], "little") for (frame,) in told] == [0, 1, 2, 3]
    ((second,),) = told[1:2]
    assert second[18:26] == bytes.fromhex("00000000 08520000")  # 21 000 us


def test_block_numbers_wrap_as_32_bits_do():
    sensor = OxSensor(lit_world(bench_of(THREE)))
    sensor._sent = 2**32 - 1  # 497 days later
    ((before,), (after,)) = sensor.datagrams(START_S + 0.005), sensor.datagrams(START_S + 0.015)
    assert (before[:4], after[:4]) == (b"\xff" * 4, bytes(4))


def test_each_profile_is_witnessed_where_the_load_truly_was():
    world = lit_world(peg_bench())
    sensor = OxSensor(world)
    world.table.go(-0.5, START_S, speed=1.0)
    world.stage.go(4.0, START_S, speed=20.0)
    now_s = START_S + 5.0
    frame, *_ = sensor.datagrams(now_s)
    assert (world.table.motor(now_s), world.stage.motor(now_s)) == (-0.5, 4.0)
    assert profile_notes(world) == [
        {
            "time_s": now_s,
            "what": "profile",
            "frame": int.from_bytes(frame[:4], "little"),
            "table_rad": -0.49,  # both came downward, and hang in their play
            "stage_mm": 4.25,
            "seen": int(world.look(now_s).seen.sum()),
        }
    ]


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"rate_hz": 0.0}, "rate"),
        ({"rate_hz": math.nan}, "rate"),
        ({"most_bytes": 31}, "32 to 65507"),
        ({"most_bytes": 65_508}, "32 to 65507"),
        ({"setup": 0}, "setup 0"),
        ({"setup": 4}, "setup 4"),
        ({"serial": "1" * 21}, "at most 20"),
        ({"product_id": "1" * 10}, "at most 9"),
        ({"vendor": "Bäumer"}, "ASCII"),
    ],
)
def test_a_sensor_that_cannot_be_is_not_made(wrong, told):
    with pytest.raises(ValueError, match=told):
        OxSettings(**wrong)
