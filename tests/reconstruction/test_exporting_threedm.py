"""3DM against a naive evaluator: Rhino must see what we mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reconstruction.exporting import read_threedm
from reconstruction.nurbs.values import Curve
from tests.reconstruction.cad_samples import (
    LARGEST_DIFFERENCE_MM,
    SURFACES,
    every_surface,
    naive_curve_point,
    naive_surface_point,
    probes,
    sample_knots,
    save_threedm,
)


@pytest.fixture
def rhino():
    return pytest.importorskip("rhino3dm", reason="the extra 'cad' is not installed")


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


def test_a_3dm_seam_on_a_double_knot_is_cut_open_and_closed(tmp_path: Path, rhino) -> None:
    save_threedm(tmp_path / "a.3dm", [SURFACES["double-at-seam"]], [])
    (item,) = rhino.File3dm.Read(str(tmp_path / "a.3dm")).Objects
    assert item.Geometry.IsClosed(0)
    assert not item.Geometry.IsPeriodic(0)


def test_the_same_surfaces_give_the_same_file_but_for_its_dates(tmp_path: Path, rhino) -> None:
    files = [tmp_path / "a.3dm", tmp_path / "b.3dm"]
    for path in files:
        save_threedm(path, [SURFACES["ring"], SURFACES["ring"]], [])
    first, second = (np.frombuffer(path.read_bytes(), np.uint8) for path in files)
    # Two dates of four bytes at most that tick, and the checksum over them.
    assert len(first) == len(second)
    assert np.count_nonzero(first != second) <= 12
    objects = [list(rhino.File3dm.Read(str(path)).Objects) for path in files]
    ids = [[each.Attributes.Id for each in some] for some in objects]
    assert ids[0] == ids[1]
    assert len(set(ids[0])) == 2
