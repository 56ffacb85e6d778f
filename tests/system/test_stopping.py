"""A scan that is stopped, killed, held, or left by its reader, against the simulator's witness.

Here a scan is stopped in many ways in turn and resumed each time, and a second one in the others.
Machines that test also stall, so seconds are generous here: what counts is what the witness saw,
and in which order. The strict bounds are those of `make safety`, the campaign.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import pytest

from acquisition.plan import Plan, Ring, StepAndShoot
from loftscan import simulate
from tests.campaigns import deaths
from tests.campaigns.deaths import DEATHS, failure_bound, owners
from tests.campaigns.kinds import KINDS, Kind, held
from tests.campaigns.stopping import main
from tests.campaigns.struck_scan import Outcome, StruckScan
from tests.campaigns.testimony import (
    Event,
    Span,
    Witnessed,
    begun_by_nobody,
    lasted_at,
    lit,
    lit_in_motion,
    moving,
    over_after_s,
    read_all,
)
from tests.campaigns.victims import Instant, Phase, instants

BOUND_S = 2.0  # of a busy machine; the campaign's is 0.25 s
SCALE = 40.0
CALMER = 10.0  # homing must not be over between two looks of a stalled program
TRIES = 3  # where this machine was so busy that a scan was over before its instant
KIND = {kind.name: kind for kind in KINDS}
PLAN = Plan(
    ring=Ring(first_mm=6.0, last_mm=8.0, step_mm=2.0, profiles_per_turn=4),
    step_and_shoot=StepAndShoot(settle_s=0.02),
)
FIRST = (
    ("SIGTERM", Phase.EXPOSURE),
    ("SIGKILL", Phase.EXPOSURE),
    ("SIGINT twice", Phase.MOVING),
    ("SIGINT once", Phase.SETTLING),
)
SECOND = (
    ("SIGHUP", Phase.HOMING),
    ("exception", Phase.EXPOSURE),
    ("script SIGINT", Phase.EXPOSURE),
    ("stdout closed", Phase.MOVING),
    ("SIGSTOP", Phase.EXPOSURE),  # the guard kills what stands still with the laser on
)


def lenient(kind: Kind) -> Kind:
    """The same, with seconds for a busy machine; what must be over at the end must be so here."""
    laser_s, axes_s = (BOUND_S if bound_s else bound_s for bound_s in (kind.laser_s, kind.axes_s))
    longer = replace(kind, laser_s=laser_s, axes_s=axes_s)
    return replace(longer, strike=held(BOUND_S)) if kind.name == "SIGSTOP" else longer


@pytest.mark.parametrize("stops", [FIRST, SECOND], ids=["first", "second"])
def test_a_scan_that_is_stopped_in_many_ways_is_dark_and_at_rest_and_resumed_whole(
    place: Path, stops: tuple[tuple[str, Phase], ...]
) -> None:
    complaints: list[str] = []
    with simulate("cylinder", scale=SCALE, seed=5) as station:
        scan = StruckScan(station, PLAN, place / "scan", heard_s=BOUND_S)
        for name, phase in stops:
            outcome = None
            for attempt in range(TRIES):
                if outcome is None and not scan.missing:
                    complaints += scan.finish()
                    other = place / f"{name} {attempt}"
                    scan = StruckScan(station, PLAN, other, heard_s=BOUND_S)
                outcome = outcome or scan.strike(lenient(KIND[name]), Instant(phase, 0.2, 0.5))
            complaints += ["never struck"] if outcome is None else outcome.complaints()
        complaints += scan.finish()
    assert complaints == []


SIMPLE = "plain"  # a relay without a watchdog: whoever turns it off is the guard, or nobody
DEATHS_TRIED = 30


def test_whatever_ends_a_program_the_laser_is_off_by_itself_or_by_its_guard(tmp_path: Path) -> None:
    complaints: list[str] = []
    with (
        simulate("cylinder", scale=CALMER, seed=5, laser=SIMPLE) as station,
        owners(tmp_path) as by,
    ):
        drawn = deaths.instants([30])
        for death in islice(cycle(DEATHS), DEATHS_TRIED):
            end = deaths.strike(death, *next(drawn), station, by)
            # What is late on a busy machine is late; what stays on, or is lit again, is not.
            late = end.laser_s < BOUND_S
            complaints += [what for what in end.complaints() if not (late and " ms" in what)]
    assert complaints == []


def test_a_failure_rate_is_bounded_by_what_was_tried() -> None:
    assert failure_bound(0, 300) == pytest.approx(1.0 - 0.05 ** (1.0 / 300.0))
    assert failure_bound(0, 300) < 0.01
    assert failure_bound(1, 300) > failure_bound(0, 300)
    assert failure_bound(3, 3) == 1.0


# --- the judges ----------------------------------------------------------------------------------


def laser(time_s: float, *, on: bool) -> Event:
    return {"time_s": time_s, "what": "laser", "on": on}


def move(time_s: float, ends_s: float, axis: str = "table") -> Event:
    return {"time_s": time_s, "what": "move", "axis": axis, "ends_s": ends_s}


def stop(time_s: float, ends_s: float, axis: str = "table") -> Event:
    return {"time_s": time_s, "what": "stop", "axis": axis, "ends_s": ends_s}


def test_a_laser_that_nobody_switches_off_is_on_for_ever() -> None:
    events = [laser(1.0, on=True), laser(1.5, on=False), laser(2.0, on=True)]
    assert lit(events) == [Span(1.0, 1.5), Span(2.0, math.inf)]
    assert over_after_s(lit(events), 1.2) == math.inf
    assert over_after_s(lit(events[:2]), 1.2) == pytest.approx(0.3)
    assert over_after_s(lit(events[:2]), 1.6) == 0.0
    assert lasted_at(lit(events), 1.4)
    assert not lasted_at(lit(events), 1.7)


def test_a_motion_ends_where_its_own_stop_says() -> None:
    events = [move(1.0, 4.0), move(1.5, 3.0, "stage"), stop(2.0, 2.1)]
    assert moving(events, "table") == [Span(1.0, 2.1)]
    assert moving(events, "table", "stage") == [Span(1.0, 2.1), Span(1.5, 3.0)]


def test_a_stop_sent_to_an_axis_at_rest_is_no_motion() -> None:
    events = [stop(0.5, 0.5), move(1.0, 2.0), stop(9.0, 9.0)]
    assert moving(events, "table") == [Span(1.0, 2.0)]


def test_a_motion_under_the_laser_is_found_whichever_began_first() -> None:
    light = [laser(1.0, on=True), laser(2.0, on=False)]
    assert lit_in_motion([*light, move(2.0, 3.0)]) == []
    for amid in (move(1.5, 3.0), move(0.5, 1.5), move(0.5, 3.0, "stage"), move(1.2, 1.3)):
        assert len(lit_in_motion([*light, amid])) == 1


def test_a_dead_program_has_one_word_on_the_wire_and_no_more() -> None:
    scanning = [move(0.0, 0.5), laser(1.0, on=True), laser(1.1, on=False)]
    on_the_wire, late = move(2.01, 2.5), move(2.2, 2.5)
    assert begun_by_nobody([*scanning, on_the_wire], 2.0, heard_s=0.05) == []
    assert begun_by_nobody([*scanning, late], 2.0, heard_s=0.05) == [late]
    second = move(2.02, 2.5, "stage")
    assert begun_by_nobody([*scanning, on_the_wire, second], 2.0, heard_s=0.05) == [second]


def test_a_search_for_home_goes_on_by_itself_on_its_own_axis_only() -> None:
    own, other = move(2.5, 2.6, "stage"), move(2.7, 2.8)
    events = [move(1.9, 2.4, "stage"), own, other]
    assert begun_by_nobody(events, 2.0, heard_s=0.05) == [other]


def test_a_log_is_heard_from_its_end_on_and_by_whole_lines(tmp_path: Path) -> None:
    log = tmp_path / "witness.jsonl"
    before, half, whole = (json.dumps({"n": n}) + "\n" for n in range(3))
    log.write_text(before)
    witnessed = Witnessed(log)
    with log.open("a") as file:
        file.write(half[:4])
        file.flush()
        assert witnessed.listen() == []
        file.write(half[4:] + whole)
    assert witnessed.listen() == [{"n": 1}, {"n": 2}]
    assert read_all(log) == [{"n": 0}, {"n": 1}, {"n": 2}]


def test_the_instants_lie_in_every_phase_and_a_seed_gives_the_same_again() -> None:
    drawn = list(islice(instants([1]), 20))
    assert {instant.phase for instant in drawn} == set(Phase)
    assert sum(instant.phase is Phase.EXPOSURE for instant in drawn) >= 10
    assert drawn == list(islice(instants([1]), 20))
    assert drawn != list(islice(instants([2]), 20))


def test_a_bound_is_broken_by_what_comes_after_it() -> None:
    kind = KIND["SIGTERM"]
    assert list(kind.too_late(0.25, 0.25)) == []
    assert list(kind.too_late(0.26, 0.0)) == ["laser on 260 ms after the stop"]
    assert list(kind.too_late(0.0, math.inf)) == ["an axis moves inf ms after the stop"]
    assert list(KIND["SIGSTOP"].too_late(0.19, 99.0)) == []


def test_a_complaint_names_the_kind_and_the_instant() -> None:
    instant = Instant(Phase.MOVING, 0.25, 0.5)
    outcome = Outcome(
        KIND["SIGHUP"], instant, code=3, laser_s=0.0, axes_s=0.0, was_lit=False, was_moving=True,
        lost=(4,), twice=(5,), broken=("it burnt",),
    )  # fmt: skip
    assert outcome.complaints() == [
        "SIGHUP, moving 0.250 0.500: it burnt",
        "SIGHUP, moving 0.250 0.500: slice 4 was lost",
        "SIGHUP, moving 0.250 0.500: slice 5 was taken twice",
    ]


@pytest.mark.parametrize(("broken", "code"), [([], 0), (["it burnt"], 1)])
def test_the_campaign_ends_with_1_when_a_bound_is_broken(
    broken: list[str],
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("tests.campaigns.stopping.os.nice", lambda _: 0)
    monkeypatch.setattr("tests.campaigns.stopping._one_kind", lambda *_: broken)
    assert main(["--kinds", "SIGTERM", "--owners", "0"]) == code
    assert ("broken: it burnt" in capsys.readouterr().out) == bool(broken)


def test_the_campaign_refuses_a_kind_that_it_does_not_know() -> None:
    with pytest.raises(SystemExit):
        main(["--kinds", "SIGTERM,SIGNONSENSE"])
