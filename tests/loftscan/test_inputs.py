"""What a person names as input: units, one or more passes, boxes, hashes."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loftscan import inputs
from loftscan.inputs import Unit, hash_file, judge_size, open_input, parse_crop
from reconstruction.errors import UnreadableCloud
from reconstruction.reduction import Box
from tests.system.command_cases import FloatArray, write_cloud

POINTS = np.random.default_rng(11).uniform(-20.0, 20.0, (5000, 3))


def passed(source: inputs.Input) -> FloatArray:
    return np.concatenate(list(source.chunks()))


@pytest.mark.parametrize(
    ("unit", "millimetres"),
    [(Unit.MM, 1.0), (Unit.CM, 10.0), (Unit.M, 1000.0), (Unit.UM, 1e-3), (Unit.INCH, 25.4)],
)
def test_every_pass_gives_the_points_in_millimetres(
    place: Path, unit: Unit, millimetres: float
) -> None:
    for source in (
        POINTS,
        write_cloud(place / "a.npy", POINTS),
        write_cloud(place / "a.xyz", POINTS),
    ):
        with open_input(source, unit) as opened:
            for _ in range(3):
                np.testing.assert_array_equal(passed(opened), POINTS * millimetres)
            assert (opened.points, opened.invalid) == (5000, 0)


@pytest.mark.parametrize("suffix", [".npy", ".xyz"])
def test_a_large_cloud_is_read_again_or_put_into_a_file_with_the_same_bytes(
    place: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    rows = np.insert(POINTS, [0, 2500], math.nan, axis=0)
    path = write_cloud(place / f"cloud{suffix}", rows)
    monkeypatch.setattr(inputs, "_IN_MEMORY", 1000)
    with open_input(path, Unit.CM) as opened:
        first = passed(opened)
        spilt = list((place / "temporary").rglob("*.npy"))
        # Text is parsed once only; binary is as quick to read as a copy.
        assert len(spilt) == (suffix == ".xyz")
        for _ in range(2):
            np.testing.assert_array_equal(passed(opened), first)
        np.testing.assert_array_equal(first, POINTS * 10.0)
        assert (opened.points, opened.invalid) == (5000, 2)
    assert list((place / "temporary").iterdir()) == []


def test_a_text_file_is_parsed_once(place: Path) -> None:
    path = write_cloud(place / "a.xyz", POINTS)
    with open_input(path, Unit.MM) as opened:
        passed(opened)
        path.write_text("no longer a cloud")
        np.testing.assert_array_equal(passed(opened), POINTS)


def test_an_input_that_breaks_on_the_way_leaves_no_file(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_cloud(place / "a.xyz", POINTS)
    with path.open("a") as file:
        file.write("1 2 three\n")
    monkeypatch.setattr(inputs, "_IN_MEMORY", 1000)
    with open_input(path, Unit.MM) as opened, pytest.raises(UnreadableCloud, match="line 5001"):
        passed(opened)
    assert list((place / "temporary").iterdir()) == []


def test_an_input_is_called_by_its_file_without_the_folder(place: Path) -> None:
    (place / "deep").mkdir()
    assert open_input(write_cloud(place / "deep/a.npy", POINTS), Unit.MM).name == "a.npy"
    assert open_input(POINTS, Unit.MM).name == "array"


@pytest.mark.parametrize("wrong", [np.zeros((4, 2)), np.zeros(9), np.zeros((3, 3), complex)])
def test_an_array_of_another_shape_or_kind_is_the_callers_mistake(wrong: FloatArray) -> None:
    with pytest.raises(ValueError, match=r"^points_mm: "):
        open_input(wrong, Unit.MM)


# -- size ----------------------------------------------------------------------------------------


def cube(side_mm: float) -> Box:
    return Box(np.zeros(3), np.array([0.1, 0.2, 1.0]) * side_mm)


@pytest.mark.parametrize("side_mm", [0.1, 1.0, 44.0, 4_999.0])
def test_a_part_between_a_grain_and_a_car_is_not_remarked_upon(side_mm: float) -> None:
    assert judge_size(cube(side_mm), Unit.MM) is None


@pytest.mark.parametrize(
    ("side_mm", "unit", "said"),
    [
        (10_000.0, Unit.MM, "the part is 10 m wide in --unit mm, is that right? With --unit um"),
        (0.01, Unit.MM, "the part is 10 µm wide in --unit mm, is that right? With --unit m it"),
        (44_000.0, Unit.M, "the part is 44 m wide in --unit m, is that right? With --unit mm"),
        (0.044, Unit.UM, "the part is 44 µm wide in --unit um, is that right? With --unit mm"),
        (25_400.0, Unit.CM, "the part is 25.4 m wide in --unit cm"),
    ],
)
def test_a_part_of_another_size_is_named_with_the_unit_that_fits(
    side_mm: float, unit: Unit, said: str
) -> None:
    sentence = judge_size(cube(side_mm), unit)
    assert sentence is not None
    assert sentence.startswith(said)


@given(st.floats(1e-7, 1e8), st.sampled_from(Unit))
def test_no_other_unit_would_bring_an_implausible_part_nearer_to_a_decimetre(
    side_mm: float, unit: Unit
) -> None:
    sentence = judge_size(cube(side_mm), unit)
    assert (sentence is None) == (0.1 <= side_mm <= 5000.0)
    if sentence is not None:
        named = Unit(sentence.split("With --unit ")[1].split()[0])
        away = {each: abs(math.log10(side_mm / unit.in_mm * each.in_mm) - 2.0) for each in Unit}
        assert away[named] == pytest.approx(min(away.values()), abs=1e-9)


# -- crop ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("1,2,3,4,5,6", [1, 3, 5], [2, 4, 6]),
        (" -1.5 , 2e1,,,,7", [-1.5, -math.inf, -math.inf], [20, math.inf, 7]),
        (",,,,,", [-math.inf] * 3, [math.inf] * 3),
    ],
)
def test_a_crop_is_six_numbers_and_an_empty_place_is_no_limit(
    text: str, low: list[float], high: list[float]
) -> None:
    box = parse_crop(text)
    np.testing.assert_array_equal(box.low_mm, low)
    np.testing.assert_array_equal(box.high_mm, high)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "six numbers"),
        ("1,2,3,4,5", "six numbers"),
        ("1,2,3,4,5,6,7", "six numbers"),
        ("1;2;3;4;5;6", "six numbers"),
        ("1,2,3,4,5,high", "could not convert string to float: 'high'"),
        ("2,1,,,,", "every minimum must be below its maximum"),
        ("1,1,,,,", "every minimum must be below its maximum"),
        ("inf,,,,,", "finite numbers expected; leave a place empty for no limit"),
        ("nan,,,,,", "finite numbers expected; leave a place empty for no limit"),
    ],
)
def test_another_crop_is_refused_and_quoted(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=r"^--crop ") as refusal:
        parse_crop(text)
    assert repr(text) in str(refusal.value)
    assert said in str(refusal.value)


def test_the_hash_is_that_of_the_bytes(tmp_path: Path) -> None:
    data = np.random.default_rng(2).bytes(3_000_001)
    (tmp_path / "a").write_bytes(data)
    assert hash_file(tmp_path / "a") == hashlib.sha256(data).hexdigest()
