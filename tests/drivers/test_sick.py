"""The SICK Profiler 2 driver against the simulated sensor, in a time of their own."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import pytest

from drivers.errors import DriverError, FrameError, NoReply, Refused
from drivers.profiler import Profile, Profiler, Reason, Tally
from drivers.sick import Addresses, ByteOrder, Settings, SickLine, SickProfiler2
from drivers.sick.line import FORGETS_S
from drivers.sick.profiler import piece_counts
from drivers.sick.wire import ERRORS, Frame, encoded
from sim.device import Device
from sim.faulty_wire import FaultyLine, Plug
from sim.lasers import Slow as SlowLine
from sim.sick import ProfilerSettings, SickProfiler
from sim.wire_faults import Carrier, WireFaults
from tests.drivers.virtual_wire import Clock, VirtualWire
from tests.sim.judges import dark_world

BAUD = 115200
SCALE = Settings(x_mm_per_count=0.005, z_mm_per_count=0.005, z_offset_mm=225.0)


class Rig:
    def __init__(
        self,
        told: ProfilerSettings | None = None,
        settings: Settings = SCALE,
        wrap: Callable[[Device], Device] = lambda device: SlowLine(device, BAUD),
    ) -> None:
        self.world = dark_world()
        self.world.switch_laser(0.0, on=True, why="the relay")
        self.clock = Clock()
        self.wire = VirtualWire(self.clock, wrap(SickProfiler(self.world, told)))
        self.line = SickLine(self.wire, baud=BAUD, clock=self.clock)
        self.profiler = SickProfiler2(self.line, settings)

    def taken(self, timeout_s: float = 5.0) -> Profile:
        return next(self.profiler.profiles(timeout_s))


def test_it_is_a_profiler() -> None:
    profiler: Profiler = Rig().profiler
    assert profiler.tally() == Tally()


def test_the_sensor_is_known_by_the_size_of_its_profile() -> None:
    assert Rig().profiler.identify().model == "Profiler 2, 832 points"
    due = Settings(x_mm_per_count=1, z_mm_per_count=1, points=830)
    with pytest.raises(FrameError, match="830 were due"):
        Rig(settings=due).profiler.identify()


def due_of(rig: Rig) -> np.ndarray:
    """What the optics see, (m, 2) in mm."""
    look = rig.world.look(rig.clock())
    return look.counts[look.seen] * 0.005


@pytest.mark.parametrize("bytes_count", [False, True])
@pytest.mark.parametrize("big", [True, False])
def test_a_profile_is_what_the_optics_see_whatever_the_memory_is_like(
    *, big: bool, bytes_count: bool
) -> None:
    told = ProfilerSettings(big_endian=big, addresses_count_bytes=bytes_count)
    settings = Settings(
        x_mm_per_count=0.005, z_mm_per_count=0.005, z_offset_mm=225.0,
        byte_order=ByteOrder.BIG if big else ByteOrder.LITTLE,
        addresses=Addresses.BYTES if bytes_count else Addresses.WORDS,
    )  # fmt: skip
    rig = Rig(told, settings)
    profile = rig.taken()
    assert len(profile.reasons) == 832
    seen = due_of(rig)
    mine = profile.points_mm
    assert len(mine) > 20
    nearest = np.linalg.norm(mine[:, None] - seen[None], axis=2).min(axis=1)
    assert nearest.max() < 0.0036  # half a count of 0.005 mm, both ways
    assert profile.reasons[0] == Reason.UNKNOWN  # beside the peg; the sensor says no more


def test_the_wrong_byte_order_is_noticed_by_the_size() -> None:
    """832 points are 6800, turned round 0068: 104 / 32 is no whole number."""
    with pytest.raises(FrameError, match="byte order"):
        Rig(ProfilerSettings(big_endian=False)).profiler.identify()


def test_no_three_reads_in_a_row_are_of_one_length() -> None:
    """Else an answer that comes late or twice would be taken for another's."""
    for points in range(1, 2048):
        counts = piece_counts(points)
        assert sum(counts) == points
        assert max(counts) <= 126
        assert all(
            len(set(counts[k : k + 3])) == len(counts[k : k + 3]) for k in range(len(counts))
        )


def test_thinned_points_are_each_second_one() -> None:
    whole = Rig().taken()
    thin = Rig(settings=Settings(
        x_mm_per_count=0.005, z_mm_per_count=0.005, z_offset_mm=225.0, thinning=2
    )).taken()  # fmt: skip
    assert thin.counts.tolist() == whole.counts[::2].tolist()


def test_a_read_that_takes_longer_than_a_look_goes_on_with_the_next() -> None:
    """0.3 s at 115200 baud, as the arithmetic of its bytes has it; looks of 50 ms, none longer."""
    rig = Rig()
    began_s, looks = rig.clock(), 0
    while True:
        looks, look_s = looks + 1, rig.clock()
        try:
            profile = rig.taken(0.05)
            break
        except NoReply:
            assert rig.clock() - look_s < 0.075  # and one short wait
    took_s = rig.clock() - began_s
    assert 0.29 < took_s < 0.36
    assert looks >= 5
    assert len(profile.points_mm) > 20


def test_a_caller_that_was_away_finds_the_answer_and_loses_nothing() -> None:
    rig = Rig()
    profile = None
    while profile is None:
        try:
            profile = rig.taken(0.02)
        except NoReply:
            rig.wire.sleep(0.3)  # longer than any answer's time
    assert profile.counts.tolist() == Rig().taken().counts.tolist()
    assert rig.profiler.tally() == Tally(profiles=1)


def test_a_discarded_read_begins_anew_and_its_late_answer_is_nobodys() -> None:
    rig = Rig()
    with pytest.raises(NoReply):
        rig.taken(0.05)
    rig.profiler.discard()
    assert rig.taken().counts.tolist() == Rig().taken().counts.tolist()
    assert rig.profiler.tally() == Tally(profiles=1)


@dataclass
class Answering:
    """A sensor that says the same to whatever it is asked."""

    answer: bytes
    asked_s: list[float] = field(default_factory=list)

    def receive(self, data: bytes, now_s: float) -> bytes:
        self.asked_s.append(now_s)
        return self.answer

    def tick(self, now_s: float) -> bytes:
        return b""


@pytest.mark.parametrize("code", ERRORS)
def test_each_error_is_named_and_only_damaged_requests_are_asked_again(code: int) -> None:
    device = Answering(encoded(Frame(code)))
    rig = Rig(wrap=lambda _: device)
    with pytest.raises(DriverError, match=f"E{code & 0xFFF:03d}, {ERRORS[code]}") as caught:
        rig.profiler.identify()
    refused = code in (0xE002, 0xE006, 0xE008)
    assert isinstance(caught.value, Refused) == refused
    assert len(device.asked_s) == (1 if refused else 2)
    if isinstance(caught.value, Refused):
        assert caught.value.code == code


def test_nobody_answers_then_the_line_rests_until_the_sensor_forgets() -> None:
    device = Answering(b"")
    rig = Rig(wrap=lambda _: device)
    with pytest.raises(NoReply, match="wires A and B"):
        rig.profiler.identify()
    first_s, second_s = device.asked_s
    assert second_s - first_s >= FORGETS_S
    assert rig.clock() - second_s < 0.06  # 10 requests of 16 bytes at 115200 and 50 ms


class Babbling:
    """A line on which something else never stops."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        return b""

    def tick(self, now_s: float) -> bytes:
        return b"U"


def test_a_line_that_is_never_quiet_is_an_error_within_seconds() -> None:
    rig = Rig(wrap=lambda _: Babbling())
    began_s = rig.clock()
    with pytest.raises(FrameError, match="never quiet"):
        rig.profiler.identify()
    assert rig.clock() - began_s < 0.1 + FORGETS_S + 1.1


def test_no_request_is_written_while_an_answer_may_come() -> None:
    """Half duplex: on the line, no byte of ours lies between a request and its answer's end."""
    spoken: list[tuple[str, float]] = []

    class Tapped(SlowLine):
        def receive(self, data: bytes, now_s: float) -> bytes:
            spoken.append(("ask", now_s))
            return super().receive(data, now_s)

        def tick(self, now_s: float) -> bytes:
            said = super().tick(now_s)
            spoken.extend([("answer", now_s)] * bool(said))
            return said

    rig = Rig(wrap=lambda device: Tapped(device, BAUD))
    for _ in range(3):
        rig.taken()
    assert [what for what, _ in spoken] == ["ask", "answer"] * (len(spoken) // 2)
    assert len(spoken) == 2 * 3 * 9  # address, size, seven pieces of 126 points at most


@pytest.mark.parametrize("seed", range(4))
def test_a_bad_wire_brings_no_false_profile(seed: int) -> None:
    """30 profiles a seed: each is the one of a sound wire, or an error.

    A question fails by 0.19 (0.09 there and back, 0.04 by the doubled one before it), twice by
    0.036; a profile needs nine: 21 of 30 are due, sigma is 2.5, five sigma below is 9.
    """
    chances = {"drop": 0.01, "flip": 0.03, "cut": 0.02, "noise": 0.03, "split": 0.2, "twice": 0.02}
    faults = WireFaults(chances=MappingProxyType(chances), late_s=0.02)
    plug, dice = Plug("sick"), random.Random(seed)
    rig = Rig(wrap=lambda each: FaultyLine(each, faults, Carrier.SERIAL, plug, dice))
    due, came = Rig().taken().counts.tolist(), 0
    for _ in range(30):
        try:
            profile = rig.taken(60.0)
        except DriverError:
            continue
        assert profile.counts.tolist() == due
        came += 1
    assert came >= 9
    assert plug.happened["flip"] > 10
