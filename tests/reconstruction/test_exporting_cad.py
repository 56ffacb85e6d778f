"""STEP and IGES against a naive evaluator: other programs must see what we mean."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from reconstruction.errors import MissingExtra
from reconstruction.exporting import read_step, read_threedm, write_iges, write_step
from reconstruction.exporting.knots import clamped, distinct, flat
from reconstruction.nurbs.values import Curve, Surface
from tests.reconstruction.cad_samples import (
    LARGEST_DIFFERENCE_MM,
    PROVENANCE,
    STAMP,
    SURFACES,
    every_surface,
    naive_curve_point,
    naive_surface_point,
    probes,
    sample_knots,
    save_step,
    save_threedm,
)


def step_shape(path: Path):
    """What Open CASCADE itself reads, past our reader."""
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    return reader.OneShape()


def step_faces(path: Path):
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    explorer = TopExp_Explorer(step_shape(path), TopAbs_FACE)
    while explorer.More():
        yield BRep_Tool.Surface_s(TopoDS.Face_s(explorer.Current()))
        explorer.Next()


@pytest.fixture
def open_cascade() -> None:
    pytest.importorskip("OCP.Geom", reason="the extra 'cad' is not installed")


# --- the naive evaluator is itself right ----------------------------------------------------------


@every_surface
def test_the_naive_evaluator_agrees_with_scipy_on_the_wrapped_form(key: str) -> None:
    from scipy.interpolate import BSpline

    surface, (parameters, points) = SURFACES[key], probes(key)
    full = np.concatenate([surface.control_points_mm, np.ones((*surface.weights.shape, 1))], -1)
    full = full * surface.weights[..., None]
    if surface.periodic_u:
        full = np.take(full, np.arange(len(full) + surface.degree_u), axis=0, mode="wrap")
    if surface.periodic_v:
        full = np.take(full, np.arange(full.shape[1] + surface.degree_v), axis=1, mode="wrap")
    for (u, v), expected in zip(parameters[::10], points[::10], strict=True):
        column = BSpline(surface.knots_u, full, surface.degree_u)(u)
        point = BSpline(surface.knots_v, column, surface.degree_v)(v)
        np.testing.assert_allclose(point[:3] / point[3], expected, atol=1e-9)


# --- knots ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 5, 9])
@pytest.mark.parametrize("multiple", [None, 0, 1, 2])
@pytest.mark.parametrize("degree", [2, 3])
def test_distinct_knots_become_the_same_flat_knots_again(degree, count, multiple) -> None:
    knots = sample_knots(degree, count, periodic=True, seed=3, multiple=multiple)
    found = distinct(degree, knots, periodic=True)
    again = flat(degree, found.knots, found.multiplicities, periodic=True)
    # Open CASCADE's vector starts `first_pole` knots later than ours.
    longer = np.concatenate([knots, knots[2 * degree + 1 :] + knots[count] - knots[0]])
    expected = longer[found.first_pole :][: len(again)]
    assert found.multiplicities[:-1].sum() == count
    np.testing.assert_allclose(again, expected, atol=1e-12)


def test_a_knot_that_would_break_the_surface_is_refused() -> None:
    with pytest.raises(ValueError, match="more often than the degree 2 allows"):
        distinct(2, np.array([0, 0, 0, 1, 1, 1, 2, 2, 2.0]), periodic=False)


@pytest.mark.parametrize(
    ("degree", "count", "multiple"),
    [
        (degree, count, multiple)
        for degree in (1, 2, 3, 4)
        for count in (3, 4, 9)
        for multiple in (None, 0, 1, 2)
        if count >= degree and (degree > 1 or multiple is None)
    ],
)
def test_a_period_cut_open_is_the_same_curve(degree, count, multiple) -> None:
    knots = sample_knots(degree, count, periodic=True, seed=4, multiple=multiple)
    points = np.random.default_rng(2).normal(size=(count, 2))
    whole = Curve(degree, knots, points, np.ones(count), periodic=True)
    ends, controls = clamped(degree, knots, points)
    cut = Curve(degree, ends, controls, np.ones(len(controls)), periodic=False)
    assert len(set(ends[: degree + 1])) == len(set(ends[-degree - 1 :])) == 1
    for t in np.linspace(*whole.domain, 60):
        np.testing.assert_allclose(
            naive_curve_point(cut, t), naive_curve_point(whole, t), atol=1e-12
        )


# --- STEP -----------------------------------------------------------------------------------------


@every_surface
@pytest.mark.usefixtures("open_cascade")
def test_open_cascade_evaluates_a_step_file_to_our_surface(key: str, tmp_path: Path) -> None:
    path, (parameters, points) = tmp_path / "a.step", probes(key)
    save_step(path, [SURFACES[key]])
    (face,) = step_faces(path)
    seen = np.array([face.Value(u, v).Coord() for u, v in parameters])
    assert np.abs(seen - points).max() < LARGEST_DIFFERENCE_MM


@every_surface
@pytest.mark.usefixtures("open_cascade")
def test_read_step_gives_the_same_surface_with_its_periods(key: str, tmp_path: Path) -> None:
    path, (parameters, points) = tmp_path / "a.step", probes(key)
    save_step(path, [SURFACES[key]])
    (again,) = read_step(path)
    seen = np.array([naive_surface_point(again, u, v) for u, v in parameters[::5]])
    assert np.abs(seen - points[::5]).max() < LARGEST_DIFFERENCE_MM
    assert (again.periodic_u, again.periodic_v) == (
        SURFACES[key].periodic_u,
        SURFACES[key].periodic_v,
    )


@pytest.mark.usefixtures("open_cascade")
def test_only_unequal_weights_make_a_step_file_rational(tmp_path: Path) -> None:
    save_step(tmp_path / "plain.step", [SURFACES["ring"]])
    save_step(tmp_path / "rational.step", [SURFACES["ring-rational"]])
    assert "RATIONAL_B_SPLINE" not in (tmp_path / "plain.step").read_text()
    assert "RATIONAL_B_SPLINE_SURFACE" in (tmp_path / "rational.step").read_text()


@pytest.mark.usefixtures("open_cascade")
def test_a_step_file_says_millimetres_its_name_and_its_provenance(tmp_path: Path) -> None:
    save_step(tmp_path / "a.step", [SURFACES["ring"]], name="Käfer's \\ vase")
    text = re.sub(r"\s*\n\s*", "", (tmp_path / "a.step").read_text(encoding="ascii"))
    header, _, data = text.partition("DATA;")
    assert re.search(r"LENGTH_UNIT\(\) ?NAMED_UNIT\(\*\) ?SI_UNIT\(\.MILLI\.,\.METRE\.\)", data)
    assert r"PRODUCT('K\X2\00E4\X0\fer''s \\ vase'," in data
    assert "'input: UHU.pcd'" in header
    assert "'settings.cell_mm: 4.0'" in header
    assert "secret" not in text
    assert f"'{STAMP}',(''),('')" in header


@pytest.mark.parametrize(
    ("schema", "written"), [("AP214IS", "AUTOMOTIVE_DESIGN"), ("AP242DIS", "AP242_MANAGED")]
)
@pytest.mark.usefixtures("open_cascade")
def test_the_schema_is_the_one_asked_for(schema, written, tmp_path: Path) -> None:
    for _ in range(2):  # the setting is the process's: a later file must not inherit it
        write_step(tmp_path / "a.step", [SURFACES["ring"]], name="a", provenance={}, schema=schema)
        assert written in (tmp_path / "a.step").read_text().partition("DATA;")[0]


@pytest.mark.usefixtures("open_cascade")
def test_the_same_surfaces_make_the_same_step_file_in_silence(tmp_path: Path, capfd) -> None:
    save_step(tmp_path / "a.step", [SURFACES["open"], SURFACES["ring"]])
    save_step(tmp_path / "b.step", [SURFACES["open"], SURFACES["ring"]])
    read_step(tmp_path / "a.step")
    assert (tmp_path / "a.step").read_bytes() == (tmp_path / "b.step").read_bytes()
    assert capfd.readouterr() == ("", "")


def neighbours() -> list[Surface]:
    """Two tubes of degree 1 in v that share a section: the paper's runs of slices."""
    tube = SURFACES["periodic-many-degree-1"]
    runs = [(slice(0, 3), [0.0, 0, 1, 2, 2]), (slice(2, 6), [2.0, 2, 3, 4, 5, 5])]
    return [
        dataclasses.replace(
            tube,
            knots_v=np.array(knots),
            control_points_mm=tube.control_points_mm[:, columns],
            weights=tube.weights[:, columns],
        )
        for columns, knots in runs
    ]


@pytest.mark.usefixtures("open_cascade")
def test_patches_that_share_a_section_are_sewn_into_one_shell(tmp_path: Path) -> None:
    from OCP.TopAbs import TopAbs_EDGE, TopAbs_SHELL
    from OCP.TopExp import TopExp
    from OCP.TopTools import TopTools_IndexedMapOfShape

    save_step(tmp_path / "a.step", neighbours())
    shells, edges = TopTools_IndexedMapOfShape(), TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(step_shape(tmp_path / "a.step"), TopAbs_SHELL, shells)
    TopExp.MapShapes_s(step_shape(tmp_path / "a.step"), TopAbs_EDGE, edges)
    assert shells.Extent() == 1
    assert edges.Extent() == 5  # two seams, two free borders, one shared one
    for written, read in zip(neighbours(), read_step(tmp_path / "a.step"), strict=True):
        for u, v in np.random.default_rng(1).uniform(0, 1, (40, 2)):
            u0, v0 = written.domain[0][0] + u, written.domain[1][0] + v
            difference = naive_surface_point(written, u0, v0) - naive_surface_point(read, u0, v0)
            assert np.abs(difference).max() < LARGEST_DIFFERENCE_MM


@pytest.mark.usefixtures("open_cascade")
def test_patches_are_named_in_the_order_they_were_given(tmp_path: Path) -> None:
    first, second = neighbours()
    patches = [second, SURFACES["ring"], first, SURFACES["open"]]
    save_step(tmp_path / "a.step", patches)
    text = re.sub(r"\s*\n\s*", "", (tmp_path / "a.step").read_text())
    for index, patch in enumerate(patches):
        (surface,) = re.findall(rf"ADVANCED_FACE\('patch {index}',\([^)]*\),(#\d+),", text)
        (degree_u, degree_v) = re.search(
            rf"{surface} = (?:\( ?BOUNDED_SURFACE\(\) ?)?B_SPLINE_SURFACE\w*\((?:'',)?(\d),(\d),",
            text,
        ).groups()
        assert (int(degree_u), int(degree_v)) == (patch.degree_u, patch.degree_v)


@pytest.mark.usefixtures("open_cascade")
def test_what_is_no_step_file_is_refused_in_one_silent_line(tmp_path: Path, capfd) -> None:
    (tmp_path / "a.step").write_text("solid cube\n")
    with pytest.raises(ValueError, match=r"a\.step: not a STEP file$"):
        read_step(tmp_path / "a.step")
    assert capfd.readouterr() == ("", "")


# --- IGES -----------------------------------------------------------------------------------------


@every_surface
@pytest.mark.usefixtures("open_cascade")
def test_open_cascade_evaluates_an_iges_file_to_our_surface(key: str, tmp_path: Path) -> None:
    from OCP.IGESControl import IGESControl_Reader

    from reconstruction.exporting.brep import faces_of

    write_iges(tmp_path / "a.igs", [SURFACES[key]], name="vase", provenance=PROVENANCE)
    reader = IGESControl_Reader()
    reader.ReadFile(str(tmp_path / "a.igs"))
    reader.TransferRoots()
    (face,) = faces_of(reader.OneShape())
    parameters, points = probes(key)
    seen = np.array([face.Value(u, v).Coord() for u, v in parameters])
    assert np.abs(seen - points).max() < LARGEST_DIFFERENCE_MM


@pytest.mark.usefixtures("open_cascade")
def test_an_iges_file_says_millimetres_and_not_who_wrote_it(tmp_path: Path, capfd) -> None:
    import getpass

    write_iges(tmp_path / "a.igs", [SURFACES["ring"]], name="vase", provenance=PROVENANCE)
    text = (tmp_path / "a.igs").read_text(encoding="ascii")
    start = [line[:72].rstrip() for line in text.splitlines() if line[72] == "S"]
    settings = "".join(line[:72] for line in text.splitlines() if line[72] == "G")
    assert "input: UHU.pcd" in start
    assert ",2,2HMM," in settings
    assert "4Hvase" in settings
    assert f"H{getpass.getuser()}," not in settings
    assert str(tmp_path) not in settings
    assert capfd.readouterr() == ("", "")


# --- without the extra ----------------------------------------------------------------------------


def test_a_missing_extra_names_its_remedy_and_leaves_nothing(tmp_path: Path, monkeypatch) -> None:
    for module in ("OCP", "OCP.Geom", "rhino3dm"):
        monkeypatch.setitem(sys.modules, module, None)
    ring = SURFACES["ring"]
    for attempt in (
        lambda: save_step(tmp_path / "a.step", [ring]),
        lambda: read_step(tmp_path / "a.step"),
        lambda: write_iges(tmp_path / "a.igs", [ring], name="a", provenance={}),
        lambda: save_threedm(tmp_path / "a.3dm", [ring], []),
        lambda: read_threedm(tmp_path / "a.3dm"),
    ):
        with pytest.raises(MissingExtra, match=r"pip install 'loftscan\[cad\]'"):
            attempt()
    assert list(tmp_path.iterdir()) == []
