"""A profile in numbers, in text and as a table; coverage and progress of a scan in words."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.frames import Kind, Kinematics, Lifting, Turning
from acquisition.plan import ring
from acquisition.poses import Pose, Sweep
from acquisition.scan import Progress, StopRequest
from drivers.profiler import Profile, Reason, Tally
from loftscan.coverage import sweep_coverage
from loftscan.profile_view import Glyphs, numbers, picture, sentence, table
from loftscan.scan_folders import in_bytes
from loftscan.scan_progress import Manner, Pace, ScanTeller, in_time
from loftscan.wire_logs import log_of

KINEMATICS = Kinematics(
    kind=Kind.NOMINAL,
    table_sense=Turning.CLOCKWISE,
    stage_sense=Lifting.UP,
    height_mm=0.0,
    standoff_mm=100.0,
)


def made(x_mm: list[float], z_mm: list[float], reasons: list[Reason] | None = None) -> Profile:
    counts = np.array([x_mm, z_mm]).T * 100.0
    why = np.array(reasons or [Reason.MEASURED] * len(x_mm), np.uint8)
    light = np.arange(len(x_mm), dtype=np.uint16) * 10
    return Profile(counts.round().astype(np.int32), (0.01, 0.01), (0.0, 0.0), why, light, 0.0, 0, 7)


def test_the_numbers_count_every_reason_and_span_only_what_was_measured() -> None:
    seen = made(
        [-1.0, 0.0, 1.0, 99.0],
        [50.0, 40.0, 60.0, 1.0],
        [Reason.MEASURED, Reason.MEASURED, Reason.SATURATED, Reason.NO_RETURN],
    )
    found = numbers(seen)
    assert (found.points, found.measured) == (4, 2)
    assert found.reasons == {"no return": 1, "saturated": 1}
    assert found.x_mm == (-1.0, 0.0)
    assert found.z_mm == (40.0, 50.0)
    assert found.intensity == (0, 5, 10)
    assert sentence(found) == (
        "profile 7: 2 of 4 points measured (50.0%), 1 no return, 1 saturated, x -1.00 to 0.00 mm,"
        " z 40.00 to 50.00 mm, intensity 0 to 10, median 5"
    )


def test_a_profile_without_a_measurement_has_no_spans_and_an_empty_picture() -> None:
    seen = made([0.0], [0.0], [Reason.NO_RETURN])
    found = numbers(seen)
    assert (found.measured, found.x_mm, found.z_mm, found.intensity) == (0, None, None, None)
    assert picture(seen.points_mm, 5, 2, Glyphs.ASCII) == ["", ""]
    assert picture(seen.points_mm, 2, 1, Glyphs.BRAILLE) == ["\u2800\u2800"]


def test_the_picture_has_the_nearest_points_above_and_x_to_the_right() -> None:
    step = made([0.0, 1.0, 2.0, 3.0], [10.0, 10.0, 20.0, 20.0]).points_mm
    assert picture(step, 4, 2, Glyphs.ASCII) == ["**", "  **"]
    # Dots of a braille cell: 1 2 3 down the left, 4 5 6 down the right, 7 and 8 below them.
    assert picture(step, 2, 1, Glyphs.BRAILLE) == ["\u2809\u28c0"]


def test_the_table_has_a_row_for_every_point_and_places_for_the_measured() -> None:
    seen = made([1.25, 2.0], [30.5, 0.0], [Reason.MEASURED, Reason.LOST])
    assert table([seen]).splitlines() == [
        "frame,point,x_mm,z_mm,reason,intensity",
        "7,0,1.25,30.5,measured,0",
        "7,1,,,lost,10",
    ]


def turned(stops: int, half_width_mm: float) -> Sweep:
    """A cylinder of radius 50 seen from so many sides, each a piece of its circle."""
    across = np.linspace(-half_width_mm, half_width_mm, 400)
    away = 100.0 - np.sqrt(50.0**2 - across**2)
    profiles = [made(list(across), list(away)) for _ in range(stops)]
    poses = [Pose(math.tau * stop / stops, 0.0, 0.0) for stop in range(stops)]
    return Sweep(0, tuple(profiles), tuple(poses))


@pytest.mark.parametrize(("stops", "share"), [(1, 60 / 360), (3, 180 / 360), (6, 1.0)])
def test_coverage_is_the_share_of_the_turn_that_has_points(stops: int, share: float) -> None:
    # Half a chord of 25 mm on a radius of 50 is 30 degrees to either side.
    assert sweep_coverage(turned(stops, 25.0), KINEMATICS) == pytest.approx(
        share, abs=3 * stops / 360
    )


def test_a_slice_without_a_point_covers_nothing() -> None:
    empty = made([0.0], [0.0], [Reason.LOST])
    assert sweep_coverage(Sweep(0, (empty,), (Pose(0.0, 0.0, 0.0),)), KINEMATICS) == 0.0


def test_pace_and_time_left_follow_from_what_is_done() -> None:
    pace = Pace(30.0, 2.5, 10)
    assert pace.slices_per_min == pytest.approx(5.0)
    assert pace.left_s == pytest.approx(90.0)
    assert Pace(0.0, 0.0, 10).left_s is None
    assert [in_time(s) for s in (0.04, 9.0, 59.7, 150.0, 7260.0)] == [
        "0.0 s", "9.0 s", "60 s", "2 min", "2 h 1 min"
    ]  # fmt: skip
    assert [in_bytes(count) for count in (12, 4200, 1.5e6, 2e9, 3e12)] == [
        "12 B", "4.2 kB", "1.5 MB", "2 GB", "3 TB"
    ]  # fmt: skip


def told(manner: Manner, stop: StopRequest) -> str:
    text, times = io.StringIO(), iter([0.0, 10.0, 20.0, 20.0])
    teller = ScanTeller(text, manner, KINEMATICS, stop, clock=lambda: next(times))
    teller.stopped_at(Progress(4, 0, 2, 6, 12, 0))
    teller.stopped_at(Progress(4, 0, 2, 12, 12, 1))
    teller.kept(turned(6, 25.0))
    return text.getvalue()


def test_a_terminal_sees_one_line_rewritten() -> None:
    shown = told(Manner.LIVE, StopRequest())
    assert "\n" not in shown
    assert shown.split("\r")[1].rstrip() == (
        "slice 1 of 2, stop 6 of 12, 3.0 slices/min, 30 s left"
    )
    assert "1 profiles lost" in shown.split("\r")[2]
    stop = StopRequest()
    stop.ask()
    assert "pausing after this slice; Ctrl-C again stops now" in told(Manner.LIVE, stop)


def test_a_pipe_gets_a_line_a_slice_and_a_program_an_object() -> None:
    line = "slice 1 of 2, 6.0 slices/min, coverage 100%, 1 profiles lost, 10 s left\n"
    assert told(Manner.LINES, StopRequest()) == line
    (said,) = map(json.loads, told(Manner.JSON, StopRequest()).splitlines())
    assert (said["event"], said["slices_done"], said["slices"]) == ("slice", 1, 2)
    assert said["lost_profiles"] == 1
    assert said["coverage"] == 1.0


def test_points_that_were_lost_on_the_wire_are_told_at_the_end() -> None:
    here = SimpleNamespace(out=Path("part.scan"), plan=ring(0.0, 1.0, 1.0, 3))
    torn = made([0.0, 1.0, 2.0], [10.0, 10.0, 0.0], [Reason.MEASURED, Reason.LOST, Reason.LOST])
    said = {}
    for manner in (Manner.LINES, Manner.JSON):
        text = io.StringIO()
        teller = ScanTeller(text, manner, KINEMATICS, StopRequest(), clock=lambda: 0.0)
        teller.kept(Sweep(0, (torn, made([0.0], [9.0]), torn), (Pose(0.0, 0.0, 0.0),) * 3))
        teller.done(here, here.plan.count)
        said[manner] = text.getvalue().splitlines()[-1]
    assert said[Manner.LINES].startswith("warning: 2 profiles are kept with 4 points lost between")
    end = json.loads(said[Manner.JSON])
    assert (end["torn_profiles"], end["lost_points"]) == (2, 4)


def test_frames_that_were_dropped_on_their_way_are_told_at_the_end() -> None:
    here = SimpleNamespace(out=Path("part.scan"), plan=ring(0.0, 1.0, 1.0, 3))
    for tally, count in ((Tally(90), 0), (Tally(90, 3, 1, 2), 1)):
        for manner in (Manner.LINES, Manner.JSON):
            text = io.StringIO()
            teller = ScanTeller(text, manner, KINEMATICS, StopRequest(), clock=lambda: 0.0)
            teller.stopped_at(Progress(1, 1, 2, 3, 3, 0, tally))
            teller.done(here, here.plan.count)
            lines = text.getvalue().splitlines()
            if manner is Manner.JSON:
                (end,) = map(json.loads, lines)
                counts = [end[f"{name}_frames"] for name in ("dropped", "torn", "bad")]
                assert counts == [tally.lost_profiles, tally.torn_profiles, tally.bad_frames]
            else:
                said = "profiler: 3 frames dropped, 1 torn, 2 damaged on their way; exposures were"
                assert len([line for line in lines if line.startswith(said)]) == count


@pytest.mark.parametrize(
    ("address", "name"),
    [
        ("serial:///dev/ttyUSB0?baud=9600", "a/wire-dev-ttyUSB0.log"),
        ("tcp://10.0.0.2:502", "a/wire-10.0.0.2-502.log"),
        ("udp://:9009", "a/wire-9009.log"),
    ],
)
def test_each_link_has_a_log_of_its_own_name(address: str, name: str) -> None:
    assert log_of(Path("a/wire.log"), address) == Path(name)
