"""The campaigns that take minutes or hours, in small, and their judges."""

from __future__ import annotations

import pytest

from tests.campaigns import soak
from tests.campaigns.questions import PROTOCOLS, campaign
from tests.campaigns.soak import HANG_S, Soak, grown_wrong, growth, witnessed_wrong
from tests.campaigns.testimony import Event

SOAK_HOURS = 0.2  # at 20 times: 36 s
QUESTIONS, WIRES = 250, 25


def test_a_station_that_is_worked_over_bad_wires_neither_grows_nor_hangs_nor_loses_a_slice(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert soak.main(["--hours", str(SOAK_HOURS), "--seed", "3"]) == 0, capsys.readouterr().out


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_no_wrong_value_comes_over_real_bad_wires(protocol: str) -> None:
    came, struck = campaign(protocol, questions=QUESTIONS, wires=WIRES, seed=2)
    assert came["wrong"] == 0
    assert came["right"] > 0.4 * QUESTIONS  # the wires are bad, not dead
    assert struck["late"] > 0.2 * QUESTIONS


# --- the judges ----------------------------------------------------------------------------------


def work(kind: str, begun_s: float, ended_s: float) -> Soak:
    made = Soak()
    made.take({"event": "begun", "kind": kind, "time_s": begun_s})
    made.take(
        {"event": "ended", "kind": kind, "begun_s": begun_s, "time_s": ended_s, "came": "done"}
    )
    return made


def laser(time_s: float, *, on: bool) -> Event:
    return {"time_s": time_s, "what": "laser", "on": on}


def move(time_s: float) -> Event:
    return {"time_s": time_s, "what": "move", "axis": "stage", "ends_s": time_s + 0.1}


def test_light_is_asked_for_by_what_exposes_only_and_is_over_with_it_or_by_the_watchdog() -> None:
    def complaints(kind: str, on_s: float, off_s: float) -> int:
        events = [laser(on_s, on=True), laser(off_s, on=False)]
        return len(list(witnessed_wrong(work(kind, 1.0, 2.0), events)))

    assert complaints("profile", 1.1, 1.9) == 0
    assert complaints("profile", 1.1, 2.2) == 0  # its cable was pulled
    assert complaints("profile", 1.1, 2.4) == 1
    assert complaints("profile", 0.9, 1.5) == 1
    assert complaints("jog", 1.1, 1.9) == 1


def test_a_move_is_asked_for_by_what_moves() -> None:
    assert list(witnessed_wrong(work("jog", 1.0, 2.0), [move(1.5), move(2.2)])) == []
    assert len(list(witnessed_wrong(work("jog", 1.0, 2.0), [move(0.5), move(2.5)]))) == 2
    assert len(list(witnessed_wrong(work("acknowledge", 1.0, 2.0), [move(1.5)]))) == 1


def test_what_grows_after_the_warm_up_is_found() -> None:
    def life(descriptors: float) -> list[dict[str, float]]:
        return [
            {
                "time_s": float(k), "rss": 4e7 + 1e6 * min(k, 20), "threads": 2,
                "python_threads": 1, "descriptors": 17 + int(descriptors * k), "children": 1,
            }
            for k in range(100)
        ]  # fmt: skip

    assert list(grown_wrong(life(0.0))) == []  # what was taken in the warm-up is no growth
    (told,) = grown_wrong(life(0.1))
    assert told.startswith("descriptors grew from 20")
    assert growth(life(0.1), "descriptors")[1] == pytest.approx(26.0, abs=0.6)


def test_work_that_takes_too_long_is_a_hang() -> None:
    assert work("home", 0.0, HANG_S - 1.0).broken == []
    assert len(work("home", 0.0, HANG_S + 1.0).broken) == 1
