"""The register profiler at a server of modbus-tk, whose words are packed by `struct` alone."""

from __future__ import annotations

from itertools import islice

import numpy as np

from drivers.modbus import Framing
from drivers.profiler import Reason
from drivers.register_profiler import (
    Flag,
    Layout,
    Packing,
    RegisterProfiler,
    Trigger,
    WordOrder,
)
from tests.peers.test_modbus_tk import serving

LAYOUT = Layout(
    first_register=0x0100,
    columns=150,
    packing=Packing.TWO_WORDS,
    word_order=WordOrder.LOW_FIRST,
    signed=True,
    z_mm_per_count=0.001,
    column_pitch_mm=0.5,
    missing=((-(2**31), Reason.NO_RETURN),),
    sequence_register=5,
    ready=Flag(4, 3),
    trigger=Trigger(0x0020, 1),
)


def test_a_triggered_profile_of_three_frames_is_read_from_a_third_partys_server() -> None:
    with serving("columns", Framing.RTU) as (peer, bus):
        profiler = RegisterProfiler(bus, 9, LAYOUT, period_s=0.01)
        profiler.identify()
        first, second = islice(profiler.profiles(10.0), 2)
        written = peer.written()
    assert (first.frame, second.frame) == (7, 8)
    k = np.array([*range(10), *range(50, 150)])
    # The bank's formula in mm: -3 + 2.013 k, none from 10 to 49.
    expected_mm = np.column_stack([0.5 * k, -3.0 + 2.013 * k])
    for profile in (first, second):
        np.testing.assert_allclose(profile.points_mm, expected_mm, atol=1e-9)
        assert np.flatnonzero(profile.reasons == Reason.NO_RETURN).tolist() == [*range(10, 50)]
    assert written == ["06 00 20 00 01"] * 2
