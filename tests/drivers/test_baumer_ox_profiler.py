"""The OX200 driver on a bus and a link of the test's own; time is a number that reads advance."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
import pytest

from drivers.axis import Identity
from drivers.baumer_ox import BaumerOx, Quality, Settings
from drivers.bus import Bus
from drivers.errors import LinkLost, NoReply, Refused
from drivers.links import ByteLink
from drivers.profiler import Profile, Profiler, Reason, Tally

# Laid out by hand from the OX200 manual (V2 pages 35-39), not by our encoder: header 8, head 24 B.
HEAD_Z = "01 00 01 01 00 00 0000FA43 00F15365 90D00300 3412"  # 1 700 000 000 s, 250 000 us, 0x1234
HEAD_I = "02" + HEAD_Z[2:]
HEAD_Z_I = "03" + HEAD_Z[2:]


def z_block(block: int, z: int = 25_000) -> bytes:
    """Three points in one frame: (-100, z), (0, 0), (100, 40 000)."""
    points = bytes.fromhex("9CFF") + z.to_bytes(2, "little") + bytes.fromhex("00000000 6400409C")
    return block.to_bytes(4, "little") + bytes.fromhex("00 00 0000" + HEAD_Z + "03000000") + points


def z_frames(block: int) -> list[bytes]:
    """The same three points in three frames, one point a frame."""
    number = block.to_bytes(4, "little")
    return [
        number + bytes.fromhex("01 00 0300" + HEAD_Z + "03000000" + "9CFFA861"),
        number + bytes.fromhex("02 00 0100" + "00000000"),
        number + bytes.fromhex("02 00 0200" + "6400409C"),
    ]


MEASUREMENT = bytes.fromhex("0E000000 00 00 0000 00") + bytes(49)
# By hand from pages 26-27: "Baumer"; 11212345, OXM200 from the low byte of word 4, 7012A at 37.
VENDOR = (0x4261, 0x756D, 0x6572, *(0,) * 30)
DEVICE = (
    *(0x3131, 0x3231, 0x3233, 0x3435, 0x004F, 0x584D, 0x3230, 0x3000),
    *(0,) * 29,
    *(0x3730, 0x3132, 0x4100),
    *(0,) * 9,
)
READINGS = (0x000C, 2, 0, *(0xCCCD, 0x3DCC), *(0,) * 12, 0, 0x43FA, *(0,) * 5)  # valid and alarm

SETTINGS = Settings(x_mm_per_count=0.01, z_mm_per_count=0.005, x_offset_mm=2.0, z_offset_mm=100.0)


class Time:
    def __init__(self) -> None:
        self.now_s = 1000.0
        self.waits_s: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def pause(self, seconds: float, /) -> None:
        self.waits_s.append(seconds)
        self.now_s += seconds


class Line:
    """A link that says what it was given; None is a silence of one read, as is its end."""

    address = "udp://:9009"

    def __init__(self, time: Time, said: Sequence[bytes | None] = ()) -> None:
        self.time = time
        self.said: deque[bytes | None] = deque(said)
        self.lost = False

    def read(self, timeout_s: float) -> bytes:
        if self.lost:
            raise LinkLost(f"{self.address}: gone")
        said = self.said.popleft() if self.said else None
        if said is None:
            self.time.pause(timeout_s)
            return b""
        return said

    def write(self, data: bytes) -> None:
        raise AssertionError("nothing is ever sent to the sensor's stream")

    def close(self) -> None:
        raise AssertionError("the link is closed by whoever opened it")


class Registers:
    """A bus with one sensor that loads a setup after some reads, or refuses."""

    address = "tcp://sensor:502"

    def __init__(self) -> None:
        self.input = {0: VENDOR, 40: DEVICE, 200: READINGS}
        self.active, self.loading, self.reads_until_active = 1, 1, 3
        self.refusing = False
        self.writes: list[tuple[int, int, int]] = []

    def read_input(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        assert device_id == 1
        if first == 401:
            self.reads_until_active -= 1
            if self.reads_until_active <= 0:
                self.active = self.loading
            return (self.active,)
        words = self.input[first]
        assert len(words) == count
        return words

    def write_register(self, device_id: int, register: int, value: int) -> None:
        self.writes.append((device_id, register, value))
        if register == 501:
            if self.refusing:
                raise Refused("sensor: illegal value", code=3)
            self.loading = value

    def read_holding(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        raise AssertionError((device_id, first, count))

    def read_coils(self, device_id: int, first: int, count: int) -> tuple[bool, ...]:
        raise AssertionError((device_id, first, count))

    def write_registers(self, device_id: int, first: int, values: Sequence[int]) -> None:
        raise AssertionError((device_id, first, values))

    def write_coil(self, device_id: int, coil: int, value: bool) -> None:  # noqa: FBT001
        raise AssertionError((device_id, coil, value))


class Bench:
    def __init__(self, *said: bytes | None, settings: Settings = SETTINGS) -> None:
        self.time = Time()
        self.line = Line(self.time, said)
        self.registers = Registers()
        bus: Bus = self.registers
        link: ByteLink = self.line
        self.ox = BaumerOx(bus, link, settings, clock=self.time)

    def taken(self, count: int, timeout_s: float = 1.0) -> list[Profile]:
        return list(islice(self.ox.profiles(timeout_s), count))


def test_it_is_a_profiler() -> None:
    profiler: Profiler = Bench().ox
    assert profiler.tally() == Tally()


def test_counts_stay_the_sensors_and_millimetres_follow_from_the_settings() -> None:
    (profile,) = Bench(z_block(13)).taken(1)
    assert profile.counts.tolist() == [[-100, 25_000], [0, 0], [100, 40_000]]
    assert (profile.scale_mm, profile.offset_mm) == ((0.01, 0.005), (2.0, 100.0))
    assert profile.points_mm.tolist() == pytest.approx(np.array([[1.0, 225.0], [3.0, 300.0]]))


def test_a_point_without_a_return_keeps_its_place_and_says_why() -> None:
    (profile,) = Bench(z_block(13)).taken(1)
    assert profile.reasons.tolist() == [Reason.MEASURED, Reason.NO_RETURN, Reason.MEASURED]


def test_each_invalid_count_has_the_reason_that_the_settings_give_it() -> None:
    several = Settings(
        x_mm_per_count=0.01,
        z_mm_per_count=0.01,
        invalid_z=((40_000, Reason.SATURATED), (25_000, Reason.OUT_OF_RANGE)),
    )
    (profile,) = Bench(z_block(13), settings=several).taken(1)
    assert profile.reasons.tolist() == [Reason.OUT_OF_RANGE, Reason.MEASURED, Reason.SATURATED]


def test_frame_encoder_and_sensor_clock_come_with_the_profile() -> None:
    (profile,) = Bench(z_block(13)).taken(1)
    assert (profile.frame, profile.encoder) == (13, 0x1234)
    assert profile.sensor_time_s == pytest.approx(1_700_000_000.25, abs=1e-6)


def test_intensity_comes_beside_its_point() -> None:
    z_i = bytes.fromhex(
        "0D000000 00 00 0000" + HEAD_Z_I + "02000000" + "9CFF A861 E803" + "6400 0000 0500"
    )
    (profile,) = Bench(z_i).taken(1)
    assert profile.counts.tolist() == [[-100, 25_000], [100, 0]]
    assert profile.intensity.tolist() == [1_000, 5]
    assert profile.reasons.tolist() == [Reason.MEASURED, Reason.NO_RETURN]


def test_an_intensity_profile_has_no_measured_point() -> None:
    i = bytes.fromhex("0D000000 00 00 0000" + HEAD_I + "01000000" + "9CFF A861")
    (profile,) = Bench(i).taken(1)
    assert profile.reasons.tolist() == [Reason.UNKNOWN]
    assert profile.intensity.tolist() == [25_000]
    assert profile.points_mm.shape == (0, 2)


def test_profiles_come_oldest_first_and_losses_are_counted() -> None:
    bench = Bench(z_block(13), z_block(14), b"rubbish", MEASUREMENT, z_block(19))
    assert [profile.frame for profile in bench.taken(3)] == [13, 14, 19]
    assert bench.ox.tally() == Tally(profiles=3, lost_profiles=4, torn_profiles=0, bad_frames=1)


def test_a_profile_that_lost_a_frame_is_delivered_when_the_next_one_comes() -> None:
    frames = z_frames(13)
    bench = Bench(frames[0], frames[2], z_block(14))
    torn, whole = bench.taken(2)
    assert torn.reasons.tolist() == [Reason.MEASURED, Reason.LOST, Reason.MEASURED]
    assert torn.counts.tolist() == [[-100, 25_000], [0, 0], [100, 40_000]]
    assert (whole.frame, Reason.LOST in whole.reasons) == (14, False)
    assert bench.ox.tally() == Tally(profiles=2, torn_profiles=1)


def test_a_profile_that_lost_its_last_frame_is_delivered_after_one_silent_slice() -> None:
    bench = Bench(*z_frames(13)[:2])
    (torn,) = bench.taken(1)
    assert torn.reasons.tolist() == [Reason.MEASURED, Reason.NO_RETURN, Reason.LOST]
    assert bench.time.now_s == pytest.approx(1000.05)


def test_short_reads_do_not_tear_a_profile_whose_frames_are_on_the_way() -> None:
    first, second, third = z_frames(13)
    bench = Bench(first, second, None, None, None, None, third)  # two reads a call
    for _ in range(2):
        with pytest.raises(NoReply):
            bench.taken(1, timeout_s=0.01)
    (whole,) = bench.taken(1, timeout_s=0.01)
    assert Reason.LOST not in whole.reasons
    assert bench.ox.tally() == Tally(profiles=1)


def test_what_has_arrived_is_taken_even_without_waiting() -> None:
    bench = Bench(*z_frames(13))
    assert [profile.frame for profile in bench.taken(1, timeout_s=0.0)] == [13]
    assert bench.time.now_s == 1000.0


def test_silence_says_what_to_check_after_the_time_asked_for_in_slices_of_50_ms() -> None:
    bench = Bench()
    with pytest.raises(
        NoReply, match=r"udp://:9009: no profile in 0.32 s; is the laser on, the trigger running"
    ):
        bench.taken(1, timeout_s=0.32)
    assert max(bench.time.waits_s) <= 0.05
    assert bench.time.now_s == pytest.approx(1000.32)


@pytest.mark.parametrize(
    ("said", "advice"),
    [
        (MEASUREMENT, "only measured values; choose a profile"),
        (b"GET / HTTP/1.1", "no frame of it; does another device send here"),
    ],
)
def test_silence_says_what_came_instead_of_a_profile(said: bytes, advice: str) -> None:
    with pytest.raises(NoReply, match=advice):
        Bench(said).taken(1)


def test_blocks_that_always_lack_their_first_frame_point_to_the_network() -> None:
    beheaded = [frame for block in range(14, 20) for frame in z_frames(block)[1:]]
    bench = Bench(z_block(13), *beheaded)
    with pytest.raises(NoReply, match="only pieces of some; is the network overloaded"):
        bench.taken(2)


def test_other_datagrams_do_not_put_off_the_deadline() -> None:
    bench = Bench(*[word for _ in range(400) for word in (b"rubbish", None)])
    with pytest.raises(NoReply):
        bench.taken(1, timeout_s=0.5)
    assert bench.time.now_s == pytest.approx(1000.5)


def test_a_flood_without_a_profile_ends_too() -> None:
    bench = Bench()

    def flood(timeout_s: float) -> bytes:
        bench.time.pause(0.001)
        return b"rubbish"

    bench.line.read = flood  # type: ignore[method-assign]
    with pytest.raises(NoReply):
        bench.taken(1, timeout_s=0.2)
    assert bench.time.now_s == pytest.approx(1000.25, abs=0.003)


def test_the_time_that_the_caller_spends_on_a_profile_is_not_silence() -> None:
    bench = Bench(z_block(13), None, z_block(14))
    stream = bench.ox.profiles(0.1)
    next(stream)
    bench.time.now_s += 60.0
    assert next(stream).frame == 14


def test_leaving_the_iterator_loses_no_profile() -> None:
    bench = Bench(*z_frames(13)[:2], z_block(14))
    assert [profile.frame for profile in bench.taken(1)] == [13]  # 14 came with it
    assert [profile.frame for profile in bench.taken(1)] == [14]


def test_discarded_profiles_are_gone_and_no_loss() -> None:
    bench = Bench(*z_frames(13)[:2], z_block(14), z_block(15), z_block(16), z_frames(17)[0])
    bench.taken(1)  # 14 waits in the driver, the rest on the line
    bench.ox.discard()
    bench.line.said.extend([*z_frames(17)[1:], z_block(18), z_block(19)])
    assert [profile.frame for profile in bench.taken(2)] == [18, 19]
    assert bench.ox.tally().lost_profiles == 0


def test_a_sensor_switched_off_and_on_between_exposures_is_heard_from_its_first_profile() -> None:
    bench = Bench(z_block(5000))
    bench.taken(1)
    bench.ox.discard()
    bench.line.said.extend([z_block(0), z_block(1)])
    assert [profile.frame for profile in bench.taken(2)] == [0, 1]
    assert bench.ox.tally() == Tally(profiles=3)


def test_discarding_ends_though_the_sensor_never_pauses() -> None:
    bench = Bench()
    bench.line.read = lambda timeout_s: z_block(1)  # type: ignore[method-assign]
    bench.ox.discard()
    assert bench.ox.tally() == Tally()


def test_a_lost_link_is_not_silence() -> None:
    bench = Bench()
    bench.line.lost = True
    with pytest.raises(LinkLost):
        bench.taken(1)


def test_it_says_who_it_is() -> None:
    assert Bench().ox.identify() == Identity(
        family="baumer_ox", model="OXM200 11212345", firmware="", serial="7012A"
    )


def test_another_makers_device_at_the_address_is_refused_by_name() -> None:
    bench = Bench()
    bench.registers.input[0] = (0x5475, 0x7263, 0x6B00, *(0,) * 30)
    with pytest.raises(Refused, match=r"tcp://sensor:502: the vendor is 'Turck', not Baumer"):
        bench.ox.identify()


def test_its_status_is_read_from_the_registers() -> None:
    status = Bench().ox.status()
    assert (status.valid, status.alarm, status.parametrising) == (True, True, False)
    assert status.quality is Quality.NO_SIGNAL
    assert status.values[0] == pytest.approx(0.1)
    assert status.rate_hz == 500.0


def test_a_setup_is_loaded_in_parametrisation_and_awaited() -> None:
    bench = Bench()
    bench.ox.load_setup(7, bench.time.pause)
    assert bench.registers.writes == [(1, 0, 1), (1, 501, 7), (1, 1, 1)]
    assert bench.ox.active_setup() == 7
    assert bench.time.waits_s == [0.05, 0.05]


def test_a_setup_is_not_done_while_the_sensor_still_parametrises() -> None:
    bench = Bench()
    bench.registers.input[200] = (0x0001, *READINGS[1:])
    with pytest.raises(Refused, match="setup 7 is active 3 s after 7 was loaded"):
        bench.ox.load_setup(7, bench.time.pause)


def test_a_setup_that_never_becomes_active_is_refused_and_not_loaded_again() -> None:
    bench = Bench()
    bench.registers.reads_until_active = 10_000
    with pytest.raises(Refused, match="setup 1 is active 3 s after 7 was loaded; is it stored"):
        bench.ox.load_setup(7, bench.time.pause)
    assert len(bench.registers.writes) == 3
    assert bench.time.now_s == pytest.approx(1003.0, abs=0.051)


def test_parametrisation_is_left_when_the_sensor_refuses_the_setup() -> None:
    bench = Bench()
    bench.registers.refusing = True
    with pytest.raises(Refused, match="illegal value"):
        bench.ox.load_setup(7, bench.time.pause)
    assert [register for _, register, _ in bench.registers.writes] == [0, 501, 1]


@pytest.mark.parametrize("number", [-1, 256])
def test_a_setup_that_cannot_be_is_refused_before_anything_is_written(number: int) -> None:
    bench = Bench()
    with pytest.raises(ValueError, match="0 to 255"):
        bench.ox.load_setup(number, bench.time.pause)
    assert bench.registers.writes == []


@pytest.mark.parametrize("scale", [0.0, float("nan"), float("inf")])
def test_a_scale_that_makes_no_millimetres_is_the_callers_mistake(scale: float) -> None:
    with pytest.raises(ValueError, match="z_mm_per_count"):
        Settings(x_mm_per_count=0.01, z_mm_per_count=scale)


def test_its_profiles_are_an_iterator_that_reads_nothing_before_it_is_asked() -> None:
    bench = Bench(z_block(13))
    stream: Iterator[Profile] = bench.ox.profiles(1.0)
    assert len(bench.line.said) == 1
    assert next(stream).frame == 13
