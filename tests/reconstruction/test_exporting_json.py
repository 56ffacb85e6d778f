"""surface.json and sections.json: exact to the bit, valid by their schemas, plain about damage."""

from __future__ import annotations

import copy
import dataclasses
import json
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from reconstruction.exporting import (
    SectionRecord,
    read_sections_json,
    read_surface_json,
    sections_document,
    surface_document,
    write_sections_json,
    write_surface_json,
)
from reconstruction.nurbs.values import Curve, Surface
from reconstruction.slices import Frame

PROVENANCE = {"input": Path("/somewhere/secret/UHU.pcd"), "cell_mm": np.float64(4.0)}
COORDINATES = st.floats(allow_nan=False, allow_infinity=False)
WEIGHTS = st.floats(min_value=1e-300, max_value=1e300)


@st.composite
def directions(draw):
    """Degree, count, knots, periodicity of one direction."""
    degree, periodic = draw(st.integers(1, 4)), draw(st.booleans())
    count = draw(st.integers(degree + 1, degree + 5))
    if not periodic:
        steps = draw(arrays(float, count + degree + 1, elements=st.floats(0, 1e6)))
        steps[degree + 1] += 0.5  # a domain needs a length
        return degree, count, steps.cumsum(), periodic
    steps = draw(arrays(float, count, elements=st.floats(0.01, 100)))
    knots = np.concatenate([[0.0], np.tile(steps, 3).cumsum()])[: count + 2 * degree + 1]
    return degree, count, knots + draw(st.floats(-100, 100)), periodic


@st.composite
def surfaces(draw):
    (p, nu, ku, round_u), (q, nv, kv, round_v) = draw(directions()), draw(directions())
    points = draw(arrays(float, (nu, nv, 3), elements=COORDINATES))
    weights = draw(arrays(float, (nu, nv), elements=WEIGHTS))
    return Surface(p, q, ku, kv, points, weights, round_u, round_v)


@st.composite
def records(draw):
    degree, count, knots, periodic = draw(directions())
    size = draw(st.integers(2, 3))
    points = draw(arrays(float, (count, size), elements=COORDINATES))
    curve = Curve(degree, knots, points, draw(arrays(float, count, elements=WEIGHTS)), periodic)
    starts = draw(st.lists(st.floats(-1e3, 1e3), max_size=3))
    measured = draw(st.booleans())
    return SectionRecord(
        index=draw(st.integers(0, 10**6)),
        height_mm=draw(COORDINATES),
        frame=Frame(draw(arrays(float, 3, elements=COORDINATES)), np.eye(3)[::-1]),
        curve=curve,
        gaps=tuple((start, start + 0.5) for start in starts),
        residual_rms_mm=draw(st.floats(0, 1e6)) if measured else None,
        residual_max_mm=draw(st.floats(0, 1e6)) if measured else None,
        points=draw(st.integers(1, 10**6)) if measured else 0,
    )


def assert_same_bits(one, other) -> None:
    """Every field equal, arrays to the sign of their zeros."""
    for field in dataclasses.fields(one):
        left, right = getattr(one, field.name), getattr(other, field.name)
        if isinstance(left, np.ndarray):
            assert left.shape == right.shape
            assert left.tobytes() == right.tobytes()
        elif dataclasses.is_dataclass(left):
            assert_same_bits(left, right)
        else:
            assert left == right


def validate(document, kind: str) -> None:
    schema = json.loads((files("reconstruction.exporting") / f"{kind}.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(document)


few = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@few
@given(patches=st.lists(surfaces(), max_size=3))
def test_a_surface_comes_back_to_the_bit_and_obeys_its_schema(patches, tmp_path: Path) -> None:
    path = tmp_path / "surface.json"
    write_surface_json(path, patches, name="vase", provenance=PROVENANCE)
    validate(json.loads(path.read_text()), "surface")
    for written, read in zip(patches, read_surface_json(path), strict=True):
        assert_same_bits(written, read)


@few
@given(sections=st.lists(records(), max_size=3))
def test_sections_come_back_to_the_bit_and_obey_their_schema(sections, tmp_path: Path) -> None:
    path = tmp_path / "sections.json"
    write_sections_json(path, sections, name="vase", provenance=PROVENANCE)
    validate(json.loads(path.read_text()), "sections")
    for written, read in zip(sections, read_sections_json(path), strict=True):
        assert_same_bits(written, read)


def tube() -> Surface:
    return Surface(
        degree_u=2,
        degree_v=1,
        knots_u=np.arange(-2.0, 7.0),
        knots_v=np.array([0.0, 0.0, 1.0, 1.0]),
        control_points_mm=np.random.default_rng(0).normal(size=(4, 2, 3)),
        weights=np.ones((4, 2)),
        periodic_u=True,
        periodic_v=False,
    )


def ring(**changes) -> SectionRecord:
    curve = Curve(2, np.arange(-2.0, 7.0), np.eye(4)[:, :2], np.ones(4), periodic=True)
    return dataclasses.replace(
        SectionRecord(3, 12.5, Frame(np.zeros(3), np.eye(3)), curve, ((3.5, 4.5),), 0.1, 0.4, 900),
        **changes,
    )


def test_a_document_says_unit_version_and_provenance_but_no_folder() -> None:
    document = surface_document([tube()], name="vase", provenance=PROVENANCE)
    assert (document["format"], document["version"]) == ("loftscan.surface", 1)
    assert (document["unit"], document["name"]) == ("mm", "vase")
    assert document["provenance"] == {"input": "UHU.pcd", "cell_mm": 4.0}


def test_the_documented_wrapping_evaluates_a_periodic_direction() -> None:
    from scipy.interpolate import BSpline

    document = sections_document([ring()], name="vase", provenance={})
    curve = document["sections"][0]["curve"]
    points, knots, degree = curve["control_points_mm"], curve["knots"], curve["degree"]
    spline = BSpline(knots, points + points[:degree], degree)
    start, end = knots[degree], knots[len(points) + degree]
    np.testing.assert_allclose(spline(start), spline(end), atol=1e-15)
    np.testing.assert_allclose(spline(start, 1), spline(end, 1), atol=1e-15)
    # A uniform quadratic passes midway between its control points.
    np.testing.assert_allclose(spline(start), (np.eye(4)[0, :2] + np.eye(4)[1, :2]) / 2)


def damaged(document, path, value):
    """A copy with the entry at `path` replaced, or removed where `value` is ..."""
    document = copy.deepcopy(document)
    *outer, last = path
    place = document
    for key in outer:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "complaint"),
    [
        (["format"], "loftscan.sections", "format: 'loftscan.surface' expected"),
        (["version"], 2, "version: 1 expected, got 2"),
        (["version"], True, "version: 1 expected, got True"),
        (["unit"], "cm", "unit: 'mm' expected, got 'cm'"),
        (["patches"], ..., "patches: missing"),
        (["patches"], {}, "patches: a list expected"),
        (["patches", 0], 7, "patches[0]: an object expected"),
        (["patches", 0, "degree_u"], 2.0, "patches[0].degree_u: a whole number expected"),
        (["patches", 0, "degree_v"], True, "patches[0].degree_v: a whole number expected"),
        (["patches", 0, "periodic_u"], 1, "patches[0].periodic_u: true or false expected"),
        (["patches", 0, "knots_u"], ["0"] * 9, "patches[0].knots_u: numbers expected"),
        (["patches", 0, "knots_u", 8], 6.5, "patches[0]: surface u: periodic knots must repeat"),
        (["patches", 0, "knots_v"], [0, 0, 1], "patches[0]: surface v: 4 knots expected"),
        (["patches", 0, "knots_v", 0], 0.5, "patches[0]: surface v: knots must not decrease"),
        (["patches", 0, "knots_v", 0], 10**400, "patches[0].knots_v: numbers expected"),
        (["patches", 0, "control_points_mm", 1], [[1, 2]], "rows differ in length"),
        (["patches", 0, "weights"], [1.0], "weights: numbers in the shape (n x n) expected"),
        (["patches", 0, "weights", 0, 0], 0, "patches[0]: surface: weights must be positive"),
        (["patches", 0, "weights", 0, 0], None, "patches[0].weights: numbers expected"),
    ],
)
def test_a_damaged_surface_is_refused_in_one_line(path, value, complaint, tmp_path) -> None:
    document = surface_document([tube()], name="vase", provenance={})
    file = tmp_path / "surface.json"
    file.write_text(json.dumps(damaged(document, path, value)))
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the message is what is tested)
        read_surface_json(file)
    assert str(refusal.value).startswith(f"{file}: ")
    assert complaint in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("path", "value", "complaint"),
    [
        (["index"], "3", "sections[0].index: a whole number expected"),
        (["height_mm"], None, "sections[0].height_mm: numbers expected"),
        (["frame", "axes"], [[1, 0, 0]], "sections[0].frame.axes: numbers in the shape (3 x 3)"),
        (["curve", "weights", 2], -1, "sections[0].curve: curve: 4 control points need 4 posi"),
        (["curve", "knots", 0], -9, "sections[0].curve: curve: periodic knots must repeat"),
        (["curve", "control_points_mm"], [[1.0]] * 4, "two or three coordinates"),
        (["gaps", 0], [1, 1], "sections[0]: section 3: the gap [1.0, 1.0] is empty"),
        (["gaps", 0], [1], "sections[0].gaps[0]: numbers in the shape (2)"),
        (["residual", "max_mm"], None, "sections[0]: section 3: rms and largest"),
        (["residual", "points"], ..., "sections[0].residual.points: missing"),
    ],
)
def test_a_damaged_section_is_refused_in_one_line(path, value, complaint, tmp_path) -> None:
    document = sections_document([ring()], name="vase", provenance={})
    file = tmp_path / "sections.json"
    file.write_text(json.dumps(damaged(document, ["sections", 0, *path], value)))
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the message is what is tested)
        read_sections_json(file)
    assert str(refusal.value).startswith(f"{file}: ")
    assert complaint in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "content", [b"", b"{", b"\xff\xfe", b"[NaN]", b"[1e999]", b"[" * 100_000, b"null", b"[]"]
)
def test_what_is_no_document_is_refused_in_one_line(content, tmp_path: Path) -> None:
    file = tmp_path / "surface.json"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"surface\.json: ") as refusal:
        read_surface_json(file)
    assert "\n" not in str(refusal.value)


def test_a_missing_file_is_the_systems_own_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_surface_json(tmp_path / "surface.json")


def test_numbers_that_json_cannot_say_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_surface_json(tmp_path / "a.json", [tube()], name="a", provenance={"x": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_a_section_without_points_has_no_residual() -> None:
    bare = ring(residual_rms_mm=None, residual_max_mm=None, points=0)
    document = sections_document([bare], name="a", provenance={})
    assert document["sections"][0]["residual"] == {"rms_mm": None, "max_mm": None, "points": 0}
    with pytest.raises(ValueError, match="residuals of 0 points"):
        ring(points=0)
