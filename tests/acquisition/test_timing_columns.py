"""A slice of a table that turned: its timing is written, read, proven, salvaged like the rest."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from acquisition.poses import Sweep, Timing
from acquisition.salvage import salvaged
from acquisition.sweep_codec import TIMING_COLUMNS, decode_sweep, encode_sweep
from tests.acquisition.scan_cases import assert_same_sweep, sweep


def turned(seed: int, profiles: int = 5, asked: int = 7) -> Sweep:
    rng = np.random.default_rng(seed)
    arrived_s = rng.random(profiles)
    arrived_s[1] = math.nan
    timing = Timing(
        arrived_s=arrived_s,
        asked_s=rng.random(asked),
        asked_rad=rng.random(asked),
        speed_rad_s=1.0,
        latency_s=math.nan if seed % 2 else 0.002,
        latency_sd_s=math.inf if seed % 2 else 1e-5,
        drift_ppm=40.0,
        clock_late_s=1e-3,
        table_rms_rad=1e-4,
        apart_mm=math.nan,
        noise_mm=0.03,
        lost=1,
    )
    return replace(sweep(seed, profiles), timing=timing)


def assert_same(one: Sweep, other: Sweep) -> None:
    assert_same_sweep(one, other)
    assert one.timing is not None
    assert other.timing is not None
    for name in TIMING_COLUMNS:
        np.testing.assert_array_equal(getattr(one.timing, name), getattr(other.timing, name))


@pytest.mark.parametrize("seed", range(4))
def test_it_reads_back_and_equal_sweeps_give_equal_bytes(seed: int) -> None:
    data = encode_sweep(turned(seed))
    assert_same(decode_sweep(data), turned(seed))
    assert encode_sweep(turned(seed)) == data
    assert set(TIMING_COLUMNS) == set(Timing.__dataclass_fields__)


def test_a_table_that_stood_writes_what_it_always_wrote() -> None:
    data = encode_sweep(sweep(3))
    assert all(f"{name}.npy".encode() not in data for name in TIMING_COLUMNS)
    assert decode_sweep(data).timing is None


def test_times_that_are_not_those_of_the_profiles_are_refused() -> None:
    whole = turned(2)
    assert whole.timing is not None
    with pytest.raises(ValueError, match="sweep 2: 5 poses, 3 times"):
        replace(whole, timing=replace(whole.timing, arrived_s=np.zeros(3)))


def test_any_byte_that_changed_is_noticed_and_what_is_salvaged_is_what_was_written() -> None:
    rng = random.Random(1)
    whole = turned(2)
    data = encode_sweep(whole)
    salvages = 0
    for _ in range(300):
        damaged = bytearray(data)
        at = rng.randrange(len(data))
        damaged[at] ^= 1 << rng.randrange(8)
        with pytest.raises(ValueError, match=r"\w"):
            decode_sweep(bytes(damaged))
        if (found := salvaged(bytes(damaged))) is not None:
            assert_same(found, whole)
            salvages += 1
    assert salvages > 30  # headers and directory are a good part of so small a file


def test_a_file_that_ends_after_the_points_is_no_slice_of_a_table_that_stood() -> None:
    data = encode_sweep(turned(2))
    local_header = 30  # bytes before a name
    for cut in (data.index(b"arrived_s.npy") - local_header, data.index(b"lost.npy")):
        assert salvaged(data[:cut]) is None
