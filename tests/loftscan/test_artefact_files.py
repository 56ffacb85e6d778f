"""artefact.toml: what may stand in it, and that nothing else passes."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loftscan.calibrating.artefact import Artefact, parse_artefact
from sim.artefacts import ball_plate_toml
from tests.loftscan.calibration_cases import balls_toml

WHOLE = balls_toml() + "[frustums.block]\nbase_mm = 60.0\ntop_mm = 30.0\nheight_mm = 20.0\n"


def test_an_artefact_says_what_it_is_made_of() -> None:
    found = parse_artefact(WHOLE)
    assert found.words() == "balls (3 spheres, 1 plane, 1 frustum)"
    assert found.spacings["far"].held_out
    assert not found.spacings["near"].held_out


def test_the_simulators_certificate_is_one() -> None:
    assert parse_artefact(ball_plate_toml()).name == "ball plate"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "nothing on it"),
        ("[spheres.a]\nradius_mm = -1.0", "spheres.a.radius_mm: -1.0 is out of bounds"),
        ("[spheres.a]\nradius_mm = nan", "radius_mm"),
        ("[spheres.a]\nradius_mm = 1e9", "radius_mm"),
        ("[spheres.a]\nradius = 5.0", "did you mean spheres.a.radius_mm"),
        ("[cubes.a]\n", "cubes: unknown key"),
        ("spheres = 3", "spheres: no table"),
        ("[spheres]\na = 3", "spheres.a: no table"),
        ("[spheres.a]\n[planes.a]\n", "a: names two elements"),
        ("[frustums.f]\nbase_mm=10.0\ntop_mm=10.0\nheight_mm=5.0", "is not below base_mm"),
        ("[frustums.f]\nbase_mm=10.0\nheight_mm=5.0", "frustums.f.top_mm is missing"),
        (
            "[spheres.a]\n[spacings.s]\none='a'\nother='b'\ndistance_mm=9.0",
            "'b' is no sphere of this file",
        ),
        (
            "[spheres.a]\n[spacings.s]\none='a'\nother='a'\ndistance_mm=9.0",
            "from a to itself",
        ),
        (
            "[spheres.a]\nradius_mm=10.0\n[spheres.b]\nradius_mm=10.0\n"
            "[spacings.s]\none='a'\nother='b'\ndistance_mm=15.0",
            "would stand in each other",
        ),
        (
            "[spheres.a]\n[spheres.b]\n[spheres.c]\n"
            "[spacings.s]\none='a'\nother='b'\ndistance_mm=10.0\n"
            "[spacings.t]\none='b'\nother='c'\ndistance_mm=10.0\n"
            "[spacings.u]\none='a'\nother='c'\ndistance_mm=30.0\n",
            "make no triangle",
        ),
        ("name = 3\n[spheres.a]", "is no text"),
    ],
)
def test_impossible_artefacts_are_refused_in_a_line(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=r"^artefact\.toml: ") as refused:
        parse_artefact(text)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_a_bent_file_is_read_or_refused_in_a_line(data: st.DataObject) -> None:
    text = WHOLE
    for _ in range(data.draw(st.integers(1, 3))):
        at, length = data.draw(st.integers(0, len(text))), data.draw(st.integers(0, 12))
        text = text[:at] + data.draw(st.text(max_size=6)) + text[at + length :]
    try:
        found = parse_artefact(text)
    except ValueError as refused:
        words = str(refused)
        assert words.startswith("artefact.toml: ")
    else:
        assert isinstance(found, Artefact)
