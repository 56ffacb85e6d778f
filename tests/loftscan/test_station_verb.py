"""The verbs `Station` and `scan` on fake devices, which are the witnesses.

Signals are raised by the fakes themselves, at the very instant that a test is about: in the middle
of a move, between two words to the laser, on the way out.
"""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from acquisition.errors import NotNow, Stopped
from acquisition.plan import ring
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from acquisition.station import Station as Settings
from acquisition.stream import buffered
from drivers.endings import at_last
from drivers.errors import LinkLost, NoReply, Refused
from drivers.profiler import Profile
from loftscan import Station, scan
from loftscan.scan_folders import prospect
from loftscan.scanning import Scan
from tests.acquisition.scan_cases import STATION, assert_same_sweep
from tests.acquisition.test_scan import Rig, rig

PLAN = ring(10.0, 12.0, 1.0, 4)


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch) -> Rig:
    """A rig that `Station.open` finds in place of a real station, with the same way out."""
    made = rig()

    @contextmanager
    def opened(_: Settings, **__: object) -> Iterator[object]:
        with ExitStack() as endings:
            for ending in (made.table.stop, made.stage.stop, made.laser.off):
                endings.enter_context(at_last(ending))
            yield made.station

    monkeypatch.setattr("loftscan.station.open_station", opened)
    return made


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Whatever a test does, it leaves the signals' handlers as they were."""
    watched = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in watched}
    yield
    after = {number: signal.getsignal(number) for number in watched}
    for number, handler in before.items():
        signal.signal(number, handler)
    assert after == before


def raising(number: signal.Signals) -> Callable[[], None]:
    return lambda: signal.raise_signal(number)


# -- moving and looking --------------------------------------------------------------------------


def test_home_finds_both_references_or_the_one_that_is_named(at: Rig) -> None:
    with Station.open(STATION) as opened:
        assert opened.home("stage").stage.homed
        assert not at.table.homed
        assert opened.home().table.homed
        assert opened.settings == STATION


def test_jog_speaks_degrees_and_moves_in_radians(at: Rig) -> None:
    with Station.open(STATION) as opened:
        opened.home()
        stand = opened.jog(table_deg=90.0, stage_mm=12.0)
        assert at.table.moves == [pytest.approx(math.tau / 4)]
        assert at.stage.moves == [12.0]
        assert stand.table_deg == pytest.approx(90.0, abs=0.01)
        assert stand.stage_mm == pytest.approx(12.0, abs=0.001)
        assert not stand.laser_on
        opened.jog_by(table_deg=-45.0)
        assert at.table.moves[-1] == pytest.approx(math.tau / 8, abs=1e-3)
        opened.jog_by(stage_mm=1.5)
        assert at.stage.moves[-1] == pytest.approx(13.5, abs=1e-3)


def test_a_profile_is_taken_in_light_that_is_off_again(at: Rig) -> None:
    with Station.open(STATION) as opened:
        assert isinstance(opened.profile(), Profile)
        assert not at.bench.lit
    assert "profiler profile lit" in at.bench.calls


def test_a_sensor_that_is_silent_is_waited_for_in_steps_that_keep_the_lease(at: Rig) -> None:
    at.profiler.script = ["silent"] * 2
    with Station.open(STATION) as opened, pytest.raises(NoReply, match="no profile"):
        opened.profile()
    assert at.bench.calls.count("laser on lit") >= 10
    assert at.laser.longest_unkept_s < 0.12
    assert at.at_rest


def test_stop_switches_off_first_and_says_what_was_read_back(at: Rig) -> None:
    with Station.open(STATION) as opened:
        at.bench.lit = at.table.moving = at.stage.moving = True
        stand = opened.stop()
        assert at.at_rest
        assert not stand.laser_on
    stops = [
        call.removesuffix(" lit") for call in at.bench.calls if call.split()[1] in ("off", "stop")
    ]
    assert stops[:3] == ["laser off", "stage stop", "table stop"]


@pytest.mark.parametrize("broken", ["laser", "stage", "table"])
def test_stop_goes_on_with_the_rest_when_one_device_fails(at: Rig, broken: str) -> None:
    word = "off" if broken == "laser" else "stop"

    def fail() -> None:
        raise LinkLost(f"{broken} is gone")

    with Station.open(STATION) as opened:
        at.bench.lit = at.table.moving = at.stage.moving = True
        device = getattr(at, broken)
        whole = getattr(device, word)
        setattr(device, word, fail)
        with pytest.raises(LinkLost, match=f"{broken} is gone"):
            opened.stop()
        rest = {"laser": at.bench.lit, "stage": at.stage.moving, "table": at.table.moving}
        assert rest == {name: name == broken for name in rest}
        setattr(device, word, whole)


def test_a_laser_that_reads_on_after_off_is_refused(at: Rig) -> None:
    with Station.open(STATION) as opened:
        at.laser.is_on = lambda: True  # type: ignore[method-assign]
        with pytest.raises(Refused, match="press the emergency stop"):
            opened.stop()


def test_an_axis_that_does_not_stop_is_refused_in_time(at: Rig) -> None:
    with Station.open(STATION) as opened:
        at.stage.moving = True
        at.stage.stop = lambda: None  # type: ignore[method-assign]
        with pytest.raises(Refused, match="stage: still moves"):
            opened.stop()
    assert at.bench.now_s < 60.0


# -- signals -------------------------------------------------------------------------------------


def test_ctrl_c_amid_a_move_is_raised_when_everything_rests(at: Rig) -> None:
    with Station.open(STATION) as opened:
        opened.home()
        at.bench.events.append((at.bench.now_s + 0.1, raising(signal.SIGINT)))
        with pytest.raises(KeyboardInterrupt):
            opened.jog(table_deg=350.0, stage_mm=290.0)
        assert at.at_rest
        assert len(at.stage.moves) == 1
        assert at.table.moves == []
        # The station goes on, for a script that asks what to do now.
        assert opened.jog(table_deg=5.0).table.homed


def test_ctrl_c_between_the_words_of_an_exposure_finds_the_laser_off(at: Rig) -> None:
    for nth in range(40):
        at.bench.calls.clear()
        whole = at.bench.call

        def call(
            name: str, act: Callable[[], None] = lambda: None, *, nth: int = nth, whole=whole
        ) -> None:
            if len(at.bench.calls) == nth:
                signal.raise_signal(signal.SIGINT)
            whole(name, act)

        at.bench.call = call  # type: ignore[method-assign]
        try:
            with Station.open(STATION) as opened:
                at.profiler.script = ["silent", "whole"]
                at.profiler.begun = False
                opened.profile()
                opened.profile()
        except (KeyboardInterrupt, NoReply):
            pass
        finally:
            at.bench.call = whole  # type: ignore[method-assign]
        assert at.at_rest
        assert at.bench.calls[-3:] == ["laser off", "stage stop", "table stop"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_what_would_kill_ends_the_blocks_instead(at: Rig, number: signal.Signals) -> None:
    with pytest.raises(SystemExit) as ended, Station.open(STATION) as opened:  # noqa: PT012
        at.bench.events.append((at.bench.now_s + 0.1, raising(number)))
        opened.home()
        pytest.fail("it went on")
    assert ended.value.code == 128 + number
    assert at.at_rest


def test_a_handler_of_the_script_is_called_in_place_of_ours(at: Rig) -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    try:
        with Station.open(STATION) as opened:
            signal.raise_signal(signal.SIGTERM)
            assert heard == [signal.SIGTERM]
            at.bench.events.append((at.bench.now_s + 0.1, raising(signal.SIGTERM)))
            with pytest.raises(Stopped):
                opened.home()
        assert heard == [signal.SIGTERM] * 2
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_signal_that_is_ignored_stays_ignored(at: Rig) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Station.open(STATION) as opened:
            at.bench.events.append((at.bench.now_s + 0.1, raising(signal.SIGHUP)))
            assert opened.home().table.homed
    finally:
        signal.signal(signal.SIGHUP, before)


def test_ctrl_c_in_the_scripts_own_lines_acts_at_once(at: Rig) -> None:
    steps = []
    with pytest.raises(KeyboardInterrupt), Station.open(STATION):  # noqa: PT012
        steps.append("before")
        signal.raise_signal(signal.SIGINT)
        steps.append("after")
    assert steps == ["before"]
    assert at.bench.calls[-3:] == ["laser off", "stage stop", "table stop"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_on_the_way_out_does_not_cut_it_short(at: Rig, number: signal.Signals) -> None:
    whole = at.laser.off

    def off() -> None:
        signal.raise_signal(number)
        whole()
        signal.raise_signal(number)

    at.laser.off = off  # type: ignore[method-assign]
    at.table.moving = at.stage.moving = True
    expected = KeyboardInterrupt if number is signal.SIGINT else SystemExit
    with pytest.raises(expected), Station.open(STATION):
        at.bench.lit = True
    assert at.at_rest


def test_a_second_signal_does_not_cut_the_first_ones_way_out_short(at: Rig) -> None:
    whole = at.stage.stop

    def stop() -> None:
        signal.raise_signal(signal.SIGTERM)
        whole()

    at.stage.stop = stop  # type: ignore[method-assign]
    at.table.moving = at.stage.moving = at.bench.lit = True
    with pytest.raises(KeyboardInterrupt), Station.open(STATION):
        signal.raise_signal(signal.SIGINT)
    assert at.at_rest


def test_what_a_device_complains_of_comes_before_the_signal(at: Rig) -> None:
    def off() -> None:
        signal.raise_signal(signal.SIGINT)
        raise Refused("off was not confirmed: press the emergency stop")

    at.laser.off = off  # type: ignore[method-assign]
    with pytest.raises(Refused, match="emergency stop") as raised, Station.open(STATION):
        pass
    assert raised.value.__notes__ == ["SIGINT came meanwhile"]


def test_outside_the_main_thread_a_station_works_without_signals(at: Rig) -> None:
    found: list[float] = []

    def work() -> None:
        with Station.open(STATION) as opened:
            opened.home()
            found.append(opened.jog(stage_mm=3.0).stage_mm)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [pytest.approx(3.0, abs=1e-3)]


# -- scan ----------------------------------------------------------------------------------------


def test_a_scan_gives_every_slice_and_what_is_needed_to_place_it(at: Rig) -> None:
    with Station.open(STATION) as opened:
        sweeps = scan(opened, PLAN)
        assert sweeps.total == 3
        assert sweeps.kinematics == STATION.kinematics
        assert [each.index for each in sweeps] == [0, 1, 2]
        assert list(sweeps) == []


def test_a_slice_is_on_the_disk_before_it_is_given(at: Rig, tmp_path: Path) -> None:
    out = tmp_path / "new/part.scan"
    with Station.open(STATION) as opened:
        for sweep in scan(opened, PLAN, out=out):
            assert_same_sweep(ScanFolder(out).read(sweep.index), sweep)
        record = ScanFolder.open(out).record()
    assert record.state is State.COMPLETE
    assert record.station == STATION
    assert record.plan == PLAN
    assert record.software.startswith("loftscan ")
    assert ScanFolder(out).missing() == ()


def test_a_loop_that_is_left_says_aborted_and_a_resume_gives_every_slice_once(
    at: Rig, tmp_path: Path
) -> None:
    out = tmp_path / "part.scan"
    with Station.open(STATION) as opened:
        sweeps = scan(opened, PLAN, out=out)
        first = next(sweeps)
        sweeps.close()
        assert ScanFolder.open(out).record().state is State.ABORTED
        exposures = at.bench.calls.count("laser on")
        again = list(scan(opened, PLAN, out=out, resume=True))
        assert at.bench.calls.count("laser on") == exposures + 8
    assert [each.index for each in again] == [0, 1, 2]
    assert_same_sweep(again[0], first)
    assert ScanFolder.open(out).record().state is State.COMPLETE


def test_a_scan_that_nobody_ends_ends_with_its_station(at: Rig, tmp_path: Path) -> None:
    out = tmp_path / "part.scan"
    with Station.open(STATION) as opened:
        held = scan(opened, PLAN, out=out)
        next(held)
    assert ScanFolder.open(out).record().state is State.ABORTED
    assert list(held) == []
    ScanFolder.open(out).resume().close()  # nobody holds the folder


def test_a_failed_scan_lets_go_of_its_folder_at_once(at: Rig, tmp_path: Path) -> None:
    out = tmp_path / "part.scan"
    with Station.open(STATION) as opened:
        sweeps = scan(opened, PLAN, out=out)
        next(sweeps)
        at.bench.fault_at = len(at.bench.calls) + 5
        with pytest.raises(LinkLost, match="planned fault"):
            next(sweeps)
        assert at.at_rest
        assert ScanFolder.open(out).record().state is State.ABORTED
        ScanFolder.open(out).resume().close()
        with pytest.raises(NotNow, match="remove the cause, then acknowledge"):
            opened.home()
        opened.acknowledge()
        assert [each.index for each in scan(opened, PLAN, out=out, resume=True)] == [0, 1, 2]


def test_ctrl_c_amid_a_slice_keeps_those_before_it(at: Rig, tmp_path: Path) -> None:
    out = tmp_path / "part.scan"
    with pytest.raises(KeyboardInterrupt), Station.open(STATION) as opened:  # noqa: PT012
        for sweep in scan(opened, PLAN, out=out):
            if sweep.index == 1:
                at.bench.events.append((at.bench.now_s + 0.2, raising(signal.SIGINT)))
    assert at.at_rest
    assert ScanFolder(out).indices() == (0, 1)
    assert ScanFolder.open(out).record().state is State.ABORTED


def test_ctrl_c_reaches_a_scan_that_another_thread_takes(at: Rig) -> None:
    with pytest.raises(KeyboardInterrupt), Station.open(STATION) as opened:  # noqa: PT012
        for sweep in buffered(_generator(scan(opened, ring(10.0, 200.0, 1.0, 100))), 1):
            assert sweep.index == 0
            signal.raise_signal(signal.SIGINT)
    assert at.at_rest
    assert len(at.stage.moves) < 10  # it was not left to finish


def _generator(sweeps: Scan) -> Iterator[object]:
    yield from sweeps


@pytest.mark.parametrize(
    ("plan", "options", "said"),
    [
        (ring(10.0, 400.0, 1.0, 4), {}, "above the stage's soft limit"),
        (PLAN, {"resume": True}, "resume needs out"),
    ],
)
def test_what_cannot_work_is_refused_at_once(at: Rig, plan, options, said: str) -> None:
    with Station.open(STATION) as opened, pytest.raises(ValueError, match=said):
        scan(opened, plan, **options)
    assert not at.stage.moves


def test_a_device_that_does_not_answer_leaves_no_folder(at: Rig, tmp_path: Path) -> None:
    out = tmp_path / "part.scan"
    with Station.open(STATION) as opened:
        at.bench.fault_at = len(at.bench.calls) + 2
        with pytest.raises(LinkLost):
            scan(opened, PLAN, out=out)
    assert not out.exists()


def test_what_a_program_left_that_was_killed_before_its_record_is_taken_over(
    tmp_path: Path,
) -> None:
    rest = tmp_path / "x.scan"
    (rest / "slices").mkdir(parents=True)
    (rest / ".lock").touch()
    begun = prospect(STATION, PLAN, rest, resume=False)
    assert begun.missing == tuple(range(PLAN.ring.count))
    (rest / "slices/000000.npz").touch()
    with pytest.raises(ValueError, match=r"holds 000000\.npz, no scan"):
        prospect(STATION, PLAN, rest, resume=False)
