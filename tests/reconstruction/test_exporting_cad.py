"""STEP, IGES and 3DM against a naive evaluator: other programs must see what we mean."""

from __future__ import annotations

import dataclasses
import re
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reconstruction.errors import MissingExtra
from reconstruction.exporting import (
    read_step,
    read_threedm,
    write_iges,
    write_step,
    write_threedm,
)
from reconstruction.exporting.knots import clamped, distinct, flat
from reconstruction.nurbs.values import Curve, Surface

LARGEST_DIFFERENCE_MM = 1e-6
STAMP = "2026-01-02T03:04:05+00:00"
PROVENANCE = {"input": Path("/somewhere/secret/UHU.pcd"), "settings": {"cell_mm": 4.0}}


# --- the naive evaluator -------------------------------------------------------------------------


def naive_basis(i: int, p: int, t: float, knots: tuple[float, ...], end: float) -> float:
    """The textbook recursion; the last span before `end` is closed on the right."""
    if p == 0:
        inside = knots[i] <= t < knots[i + 1]
        return float(inside or (t == end and knots[i] < end == knots[i + 1]))
    total = 0.0
    if knots[i + p] > knots[i]:
        total += (t - knots[i]) / (knots[i + p] - knots[i]) * naive_basis(i, p - 1, t, knots, end)
    if knots[i + p + 1] > knots[i + 1]:
        total += (
            (knots[i + p + 1] - t)
            / (knots[i + p + 1] - knots[i + 1])
            * naive_basis(i + 1, p - 1, t, knots, end)
        )
    return total


def naive_row(degree, knots, count, periodic, t):
    """The values of all `count` basis functions at t; wrapped ones are added to their originals."""
    row = np.zeros(count)
    end = float(knots[len(knots) - 1 - degree])
    for i in range(len(knots) - degree - 1):
        row[i % count if periodic else i] += naive_basis(i, degree, t, tuple(knots.tolist()), end)
    return row


def naive_surface_point(surface: Surface, u: float, v: float):
    rows, columns = surface.weights.shape
    in_u = naive_row(surface.degree_u, surface.knots_u, rows, surface.periodic_u, u)
    in_v = naive_row(surface.degree_v, surface.knots_v, columns, surface.periodic_v, v)
    weights = in_u[:, None] * in_v * surface.weights
    return (weights[..., None] * surface.control_points_mm).sum(axis=(0, 1)) / weights.sum()


def naive_curve_point(curve: Curve, t: float):
    weights = curve.weights * naive_row(
        curve.degree, curve.knots, len(curve.weights), curve.periodic, t
    )
    return weights @ curve.control_points_mm / weights.sum()


# --- samples ------------------------------------------------------------------------------------


def sample_knots(degree, count, *, periodic, seed, multiple=None, clamped=True):
    """Uneven knots; `multiple` is the index in one period of a knot that stands twice."""
    rng = np.random.default_rng(seed)
    if periodic:
        steps = rng.uniform(0.5, 2.0, count)
        if multiple is not None:
            steps[multiple] = 0.0
        steps = np.tile(steps, 2 * degree // count + 3)
        knots = np.concatenate([[0.0], steps.cumsum()])[: count + 2 * degree + 1]
        return knots - knots[degree] + 0.25
    knots = rng.uniform(0.5, 2.0, count + degree + 1).cumsum()
    if clamped:
        knots[: degree + 1] = knots[degree]
        knots[count:] = knots[count]
    return knots


def sample_surface(
    degrees, counts, periodic, *, rational, seed=0, multiple=None, clamped=True
) -> Surface:
    """A dented tube, or a dented ring where v is periodic, too."""
    rng = np.random.default_rng(seed)
    around = np.linspace(0.0, 2 * np.pi * (1.0 if periodic[0] else 0.8), counts[0], endpoint=False)
    along = np.linspace(0.0, 2 * np.pi if periodic[1] else 3.0, counts[1], endpoint=False)
    u, v = np.meshgrid(around, along, indexing="ij")
    tube = 10.0 + rng.uniform(0.0, 2.0, u.shape)
    if periodic[1]:
        far = 40.0 + tube * np.cos(u)
        points = np.stack([far * np.cos(v), far * np.sin(v), tube * np.sin(u)], axis=-1)
    else:
        points = np.stack([tube * np.cos(u), tube * np.sin(u), 15.0 * v], axis=-1)
    (p, q), (nu, nv) = degrees, counts
    return Surface(
        degree_u=p,
        degree_v=q,
        knots_u=sample_knots(p, nu, periodic=periodic[0], seed=seed, multiple=multiple),
        knots_v=sample_knots(q, nv, periodic=periodic[1], seed=seed + 1, clamped=clamped),
        control_points_mm=points,
        weights=rng.uniform(0.5, 2.0, counts) if rational else np.full(counts, 1.0),
        periodic_u=periodic[0],
        periodic_v=periodic[1],
    )


def with_poles(surface: Surface) -> Surface:
    """The same tube with each end drawn into a point, as caps are."""
    points = surface.control_points_mm.copy()
    points[:, 0], points[:, -1] = points[:, 0].mean(axis=0), points[:, -1].mean(axis=0)
    return dataclasses.replace(
        surface, control_points_mm=points, weights=np.ones_like(surface.weights)
    )


SURFACES = {
    "open": sample_surface((3, 3), (9, 7), (False, False), rational=False),
    "open-rational": sample_surface((3, 2), (9, 7), (False, False), rational=True),
    "open-degree-1": sample_surface((1, 1), (6, 4), (False, False), rational=False),
    "unclamped-in-v": sample_surface((3, 3), (9, 7), (True, False), rational=True, clamped=False),
    "periodic-two-sections": sample_surface((3, 1), (12, 2), (True, False), rational=False),
    "periodic-many-degree-1": sample_surface((3, 1), (12, 6), (True, False), rational=False),
    "periodic-rational": sample_surface((3, 2), (12, 5), (True, False), rational=True),
    "periodic-degree-2": sample_surface((2, 3), (10, 6), (True, False), rational=False),
    "periodic-polygon": sample_surface((1, 1), (8, 3), (True, False), rational=True),
    "periodic-3-points": sample_surface((3, 3), (3, 4), (True, False), rational=True),
    "double-knot": sample_surface((3, 2), (12, 5), (True, False), rational=True, multiple=7),
    "double-at-seam": sample_surface((3, 2), (12, 5), (True, False), rational=True, multiple=3),
    "double-before": sample_surface((3, 2), (9, 5), (True, False), rational=True, multiple=2),
    "closed-by-poles": with_poles(
        sample_surface((3, 3), (12, 7), (True, False), rational=False)
    ),
    "ring": sample_surface((3, 3), (9, 12), (True, True), rational=False),
    "ring-rational": sample_surface((2, 3), (9, 12), (True, True), rational=True),
}  # fmt: skip
every_surface = pytest.mark.parametrize("key", SURFACES)


@cache
def probes(key: str, count: int = 500):
    """Random parameters with the corners of the domain, and the naive points there."""
    surface = SURFACES[key]
    (u0, u1), (v0, v1) = surface.domain
    inside = np.random.default_rng(7).uniform((u0, v0), (u1, v1), (count - 4, 2))
    corners = [(u0, v0), (u0, v1), (u1, v0), (u1, v1)]
    parameters = np.concatenate([inside, corners])
    return parameters, np.array([naive_surface_point(surface, u, v) for u, v in parameters])


def save_step(path: Path, surfaces: list[Surface], name: str = "vase") -> None:
    write_step(path, surfaces, name=name, provenance=PROVENANCE, time_stamp=STAMP)


def save_threedm(path: Path, surfaces: list[Surface], curves: list[Curve]) -> None:
    write_threedm(path, surfaces, curves, name="vase", provenance=PROVENANCE)


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


@pytest.fixture
def rhino():
    return pytest.importorskip("rhino3dm", reason="the extra 'cad' is not installed")


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


def test_a_3dm_seam_on_a_double_knot_is_cut_open_and_closed(tmp_path: Path, rhino) -> None:
    save_threedm(tmp_path / "a.3dm", [SURFACES["double-at-seam"]], [])
    (item,) = rhino.File3dm.Read(str(tmp_path / "a.3dm")).Objects
    assert item.Geometry.IsClosed(0)
    assert not item.Geometry.IsPeriodic(0)


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


# --- 3DM ------------------------------------------------------------------------------------------


@every_surface
def test_rhino_evaluates_a_3dm_file_to_our_surface(key: str, tmp_path: Path, rhino) -> None:
    path, (parameters, points) = tmp_path / "a.3dm", probes(key)
    save_threedm(path, [SURFACES[key]], [])
    (item,) = rhino.File3dm.Read(str(path)).Objects
    assert item.Geometry.IsValid
    seen = [item.Geometry.PointAt(u, v) for u, v in parameters]
    assert np.abs([(p.X, p.Y, p.Z) - q for p, q in zip(seen, points, strict=True)]).max() < (
        LARGEST_DIFFERENCE_MM
    )


@every_surface
def test_read_threedm_gives_the_same_surface(key: str, tmp_path: Path, rhino) -> None:
    path, (parameters, points) = tmp_path / "a.3dm", probes(key)
    save_threedm(path, [SURFACES[key]], [])
    ((again,), ()) = read_threedm(path)
    seen = np.array([naive_surface_point(again, u, v) for u, v in parameters[::5]])
    assert np.abs(seen - points[::5]).max() < LARGEST_DIFFERENCE_MM


@pytest.mark.parametrize("key", ["periodic-rational", "ring", "ring-rational", "double-knot"])
def test_3dm_keeps_periodic_directions(key: str, tmp_path: Path, rhino) -> None:
    save_threedm(tmp_path / "a.3dm", [SURFACES[key]], [])
    ((again,), ()) = read_threedm(tmp_path / "a.3dm")
    wanted = SURFACES[key]
    assert (again.periodic_u, again.periodic_v) == (wanted.periodic_u, wanted.periodic_v)
    np.testing.assert_allclose(again.knots_u, wanted.knots_u, atol=1e-12)
    np.testing.assert_allclose(again.control_points_mm, wanted.control_points_mm, atol=1e-12)


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rhino_evaluates_the_section_curves(periodic, degree, tmp_path: Path, rhino) -> None:
    rng = np.random.default_rng(degree)
    knots = sample_knots(degree, 9, periodic=periodic, seed=5)
    curve = Curve(degree, knots, rng.normal(size=(9, 3)), rng.uniform(0.5, 2, 9), periodic)
    save_threedm(tmp_path / "a.3dm", [SURFACES["ring"]], [curve])
    model = rhino.File3dm.Read(str(tmp_path / "a.3dm"))
    made = model.Objects[1].Geometry
    (_, (again,)) = read_threedm(tmp_path / "a.3dm")
    for t in [*curve.domain, *rng.uniform(*curve.domain, 100)]:
        point, expected = made.PointAt(t), naive_curve_point(curve, t)
        assert np.abs(np.array([point.X, point.Y, point.Z]) - expected).max() < 1e-6
        assert np.abs(naive_curve_point(again, t) - expected).max() < 1e-6


def test_a_3dm_file_says_millimetres_layers_names_and_provenance(tmp_path: Path, rhino) -> None:
    curve = Curve(1, np.array([0.0, 0, 1, 1]), np.eye(3)[:2], np.ones(2), periodic=False)
    save_threedm(tmp_path / "a.3dm", [SURFACES["ring"]], [curve])
    model = rhino.File3dm.Read(str(tmp_path / "a.3dm"))
    layers = [layer.Name for layer in model.Layers]
    assert model.Settings.ModelUnitSystem == rhino.UnitSystem.Millimeters
    seen = [(item.Attributes.Name, layers[item.Attributes.LayerIndex]) for item in model.Objects]
    assert seen == [("vase patch 0", "surface"), ("vase section 0", "sections")]
    assert "unit: mm\nname: vase\ninput: UHU.pcd\n" in model.StartSectionComments
    assert model.Strings["loftscan\\settings.cell_mm"] == "4.0"
    assert b"secret" not in (tmp_path / "a.3dm").read_bytes()


def test_what_is_no_3dm_file_or_in_inches_is_refused(tmp_path: Path, rhino) -> None:
    (tmp_path / "a.3dm").write_bytes(b"solid cube\n")
    with pytest.raises(ValueError, match=r"a\.3dm: not a 3DM file$"):
        read_threedm(tmp_path / "a.3dm")
    model = rhino.File3dm()
    model.Settings.ModelUnitSystem = rhino.UnitSystem.Inches
    model.Write(str(tmp_path / "b.3dm"), 7)
    with pytest.raises(ValueError, match=r"b\.3dm: unit Inches"):
        read_threedm(tmp_path / "b.3dm")


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
