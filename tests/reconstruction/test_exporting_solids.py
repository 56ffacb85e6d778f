"""Bodies become solids that CAD opens: valid, of the right volume, told apart from mere patches."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.interpolate import BSpline

from reconstruction.exporting import (
    Body,
    Closing,
    Solidity,
    bodies_of,
    flat_caps,
    read_threedm,
    write_iges_solid,
    write_step_solid,
    write_threedm,
)
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Surface, clamped_uniform
from reconstruction.skinning.surfacing import skin_slices
from reconstruction.slices import Frame, Slice
from tests.reconstruction.cad_samples import PROVENANCE, STAMP, naive_surface_point
from tests.reconstruction.skinning_parts import drawn, ring_slices, torus_net, tube_net

pytest.importorskip("OCP.Geom", reason="needs the extra cad")

ALONG = np.linspace(0.0, 1.0, 20001)


def tube(
    scale: float = 1.0, low: float = 0.0, high: float = 20.0, aside: float = 0.0, *, apex=False
) -> Surface:
    """The net of a tube of radius 10 and height 20, scaled across and moved."""
    surface = tube_net(apex=apex).surface()
    points = surface.control_points_mm * [scale, scale, (high - low) / 20.0]
    return replace(surface, control_points_mm=points + np.array([aside, 0.0, low]))


def half_torus() -> Surface:
    """Outside up, over the top, inside down: both ends in the plane z = 0."""
    tilt = np.linspace(0.0, math.pi, 12)
    whole = torus_net()
    turn = np.arange(12) / 12 * math.tau
    arm = 20.0 + 6.0 * np.cos(tilt)
    height = np.broadcast_to(6.0 * np.sin(tilt), (12, 12))
    points = np.stack([np.outer(np.cos(turn), arm), np.outer(np.sin(turn), arm), height], axis=-1)
    points[:, [0, -1], 2] = 0.0
    knots = clamped_uniform(np.zeros((12, 2))).knots
    return Surface(3, 3, whole.knots_u, knots, points, np.ones((12, 12)), True, False)  # noqa: FBT003


def section_area(control: np.ndarray) -> float:
    """Area within a uniform periodic cubic of control points (n, 2), by scipy."""
    n = len(control)
    curve = BSpline(np.arange(-3.0, n + 4.0), np.concatenate([control, control[:3]]), 3)
    (x, y), (dx, dy) = curve(ALONG * n).T, curve(ALONG * n, nu=1).T
    return float(np.trapezoid(x * dy - y * dx, ALONG * n)) / 2.0


def swept_volume(surface: Surface) -> float:
    """Of a surface whose columns are scaled copies of one: section area times arm squared, dz."""
    unit = surface.control_points_mm[:, 0, :2] / np.linalg.norm(surface.control_points_mm[0, 0, :2])
    profile = np.linalg.norm(surface.control_points_mm[0, :, :2], axis=1)
    rows = np.column_stack([profile, surface.control_points_mm[0, :, 2]])
    if surface.periodic_v:
        rows = np.concatenate([rows, rows[:3]])
    curve = BSpline(surface.knots_v, rows, 3)
    (v0, v1) = surface.domain[1]
    t = v0 + (v1 - v0) * ALONG
    arm, slope = curve(t)[:, 0], curve(t, nu=1)[:, 1]
    return abs(section_area(unit) * float(np.trapezoid(arm**2 * slope, t)))


UNIT = swept_volume(tube())  # mm3 of the tube of radius 10 and height 20
PARTS = {
    "two flat caps": ([Body(tube())], 1, UNIT),
    "an apex": ([Body(tube(apex=True))], 1, UNIT / 3),
    "a torus": ([Body(torus_net().surface())], 1, swept_volume(torus_net().surface())),
    "a ring below": (
        [Body(half_torus(), closing=Closing.RING)], 1, swept_volume(half_torus()),
    ),
    "a cavity": (
        [Body(tube()), Body(tube(0.4, 5, 15), hole=True)], 1, UNIT * (1 - 0.16 / 2),
    ),
    "a bore": ([Body(tube()), Body(tube(0.4), hole=True)], 1, UNIT * (1 - 0.16)),
    "a solid in a cavity": (
        [Body(tube()), Body(tube(0.6, 4, 16), hole=True), Body(tube(0.3, 6, 14))],
        2, UNIT * (1 - 0.36 * 0.6 + 0.09 * 0.4),
    ),
    "two parts": ([Body(tube()), Body(tube(aside=30.0))], 2, 2 * UNIT),
    "a fork": (
        [Body(tube()), Body(tube(0.3, 20, 40, -5)), Body(tube(0.3, 20, 40, 5))],
        1, UNIT * (1 + 2 * 0.09),
    ),
    "a branch that stands over": (
        [Body(tube()), Body(tube(0.5, 20, 40, 8))], 1, UNIT * (1 + 0.25),
    ),
}  # fmt: skip
every_part = pytest.mark.parametrize("key", PARTS)


def save(path: Path, bodies: list[Body], **options) -> Solidity:
    return write_step_solid(
        path, bodies, name="vase", provenance=PROVENANCE, time_stamp=STAMP, **options
    )


def read_shape(path: Path):
    """What Open CASCADE itself reads, past our own code."""
    from OCP.IGESControl import IGESControl_Reader
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader() if path.suffix == ".step" else IGESControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    return reader.OneShape()


def count_of(shape, kind: str) -> int:
    from OCP import TopAbs
    from OCP.TopExp import TopExp
    from OCP.TopTools import TopTools_IndexedMapOfShape

    found = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, getattr(TopAbs, f"TopAbs_{kind}"), found)
    return found.Extent()


def volume_of(shape, *, in_shells: bool = True) -> float:
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties, 1e-6, in_shells, False)  # noqa: FBT003
    return properties.Mass()


def is_valid(shape) -> bool:
    from OCP.BRepCheck import BRepCheck_Analyzer

    return BRepCheck_Analyzer(shape).IsValid()


def plain_text(path: Path) -> str:
    return re.sub(r"\s*\n\s*", "", path.read_text(encoding="ascii"))


# --- STEP -----------------------------------------------------------------------------------------


@every_part
def test_read_back_a_step_file_has_valid_solids_of_the_parts_volume(key, tmp_path: Path) -> None:
    bodies, solids, volume = PARTS[key]
    found = save(tmp_path / "a.step", bodies, volume_mm3=volume)
    assert (found.reasons, found.closed, found.solids) == ((), True, solids)
    shape = read_shape(tmp_path / "a.step")
    assert count_of(shape, "SOLID") == solids
    assert is_valid(shape)
    # Our bound on the integration is 1e-5; scipy's sums over 20 000 steps are better.
    assert found.volume_mm3 == pytest.approx(volume, rel=2e-5)
    assert volume_of(shape) == pytest.approx(volume, rel=2e-5)


@every_part
def test_without_open_cascade_too_every_edge_of_the_file_lies_between_two_faces(
    key, tmp_path: Path
) -> None:
    """Read from the text alone: each edge of a closed shell is passed twice, a seam by one face."""
    bodies, solids, _ = PARTS[key]
    save(tmp_path / "a.step", bodies)
    text = plain_text(tmp_path / "a.step")
    edges = re.findall(r"(#\d+) ?= ?EDGE_CURVE\(", text)
    passed = Counter(re.findall(r"ORIENTED_EDGE\('',\*,\*,(#\d+),", text))
    assert edges
    assert passed == dict.fromkeys(edges, 2)
    assert len(re.findall(r"MANIFOLD_SOLID_BREP\(|BREP_WITH_VOIDS\(", text)) == solids
    assert "OPEN_SHELL" not in text


def surfaces_in(text: str) -> list[Surface]:
    """The plain B-spline surfaces of a STEP text, in its order: a reader of our own, for tests."""
    places = {
        number: [float(each) for each in numbers.split(",")]
        for number, numbers in re.findall(r"(#\d+) ?= ?CARTESIAN_POINT\('',\(([^)]*)\)\)", text)
    }
    found = []
    for p, q, rows, rest in re.findall(
        r"B_SPLINE_SURFACE_WITH_KNOTS\('',(\d),(\d),\((\(#.*?\))\),\.\w+\.,\.\w\.,\.\w\.,\.\w\.,(.*?)\.\w+\.\)",
        text,
    ):
        counts_u, counts_v, at_u, at_v = (
            [float(each) for each in group.split(",")] for group in re.findall(r"\(([^)]*)\)", rest)
        )
        control = [
            [places[each] for each in row.split(",")] for row in re.findall(r"\(([^)]*)\)", rows)
        ]
        found.append(
            Surface(
                int(p), int(q), np.repeat(at_u, np.array(counts_u, int)),
                np.repeat(at_v, np.array(counts_v, int)), np.array(control),
                np.ones(np.shape(control)[:2]), periodic_u=False, periodic_v=False,
            )
        )  # fmt: skip
    return found


@pytest.mark.parametrize("key", ["two flat caps", "an apex", "a torus", "a cavity", "a fork"])
def test_the_walls_in_the_text_are_our_surfaces(key, tmp_path: Path) -> None:
    bodies, _, _ = PARTS[key]
    save(tmp_path / "a.step", bodies)
    written = surfaces_in(plain_text(tmp_path / "a.step"))
    assert len(written) == len(bodies)
    rng = np.random.default_rng(4)
    for body, again in zip(bodies, written, strict=True):
        np.testing.assert_allclose(again.domain, body.surface.domain, atol=1e-12)
        (u0, u1), (v0, v1) = again.domain
        for u, v in rng.uniform((u0, v0), (u1, v1), (25, 2)):
            expected = naive_surface_point(body.surface, u, v)
            np.testing.assert_allclose(naive_surface_point(again, u, v), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("schema", "written"), [("AP214IS", "AUTOMOTIVE_DESIGN"), ("AP242DIS", "AP242_MANAGED")]
)
def test_a_solids_header_has_schema_name_and_provenance_and_its_unit_is_mm(
    schema, written, tmp_path: Path
) -> None:
    save(tmp_path / "a.step", PARTS["two parts"][0], schema=schema)
    header, _, data = plain_text(tmp_path / "a.step").partition("DATA;")
    assert f"FILE_NAME('vase','{STAMP}'" in header
    assert "'input: UHU.pcd'" in header
    assert written in header
    assert re.search(r"LENGTH_UNIT\(\) ?NAMED_UNIT\(\*\) ?SI_UNIT\(\.MILLI\.,\.METRE\.\)", data)
    assert re.findall(r"PRODUCT\('([^']*)'", data) == ["vase"]


def test_walls_and_caps_are_named_after_their_bodies(tmp_path: Path) -> None:
    save(tmp_path / "a.step", PARTS["a bore"][0])
    names = Counter(re.findall(r"ADVANCED_FACE\('([^']*)'", plain_text(tmp_path / "a.step")))
    assert names["patch 0"] == names["patch 1"] == 1
    assert sum(names[name] for name in names if name.startswith("cap")) == 2
    assert names.total() == 4


def test_the_same_bodies_make_the_same_file_in_silence(tmp_path: Path, capfd) -> None:
    for name in ("a.step", "b.step"):
        save(tmp_path / name, PARTS["a fork"][0])
    assert (tmp_path / "a.step").read_bytes() == (tmp_path / "b.step").read_bytes()
    assert capfd.readouterr() == ("", "")


# --- what is no solid -----------------------------------------------------------------------------


def crooked(surface: Surface) -> Surface:
    points = surface.control_points_mm.copy()
    points[:6, -1, 2] += 0.5
    return replace(surface, control_points_mm=points)


def sheet() -> Surface:
    knots = clamped_uniform(np.zeros((12, 2))).knots
    return replace(tube(), knots_u=knots, periodic_u=False)


@pytest.mark.parametrize(
    ("bodies", "options", "reason"),
    [
        ([Body(crooked(tube()))], {}, r"patch 0 ends 0\.\d+ mm off a plane"),
        ([Body(tube()), Body(sheet())], {}, "patch 1 is open around u"),
        ([Body(tube())], {"volume_mm3": 1.002 * UNIT}, "not the same part"),
        ([Body(tube(), hole=True)], {}, "nothing to take it out of"),
        ([Body(tube()), Body(tube(2.0, -5, 25), hole=True)], {}, "nothing is left"),
        ([Body(tube(), closing=Closing.RING)], {}, "mm off a plane"),
        ([Body(torus_net().surface(), closing=Closing.RING)], {}, "it has 0"),
    ],
)  # fmt: skip
def test_what_makes_no_solid_is_written_as_patches_and_the_value_says_why(
    bodies, options, reason, tmp_path: Path
) -> None:
    found = save(tmp_path / "a.step", bodies, **options)
    assert not found.closed
    assert found.volume_mm3 == 0.0
    (said,) = found.reasons
    assert re.search(reason, said)
    shape = read_shape(tmp_path / "a.step")
    assert count_of(shape, "SOLID") == 0
    assert count_of(shape, "FACE") == len(bodies)


def test_no_body_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a\.step: no body to write"):
        save(tmp_path / "a.step", [])


# --- IGES and 3DM ---------------------------------------------------------------------------------


@every_part
def test_the_faces_of_an_iges_file_sew_to_a_closed_shell_of_the_parts_volume(
    key, tmp_path: Path
) -> None:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing

    bodies, _, volume = PARTS[key]
    found = write_iges_solid(tmp_path / "a.igs", bodies, name="vase", provenance=PROVENANCE)
    assert found.closed
    shape = read_shape(tmp_path / "a.igs")
    sewing = BRepBuilderAPI_Sewing(1e-4)
    sewing.Add(shape)
    sewing.Perform()
    assert sewing.NbFreeEdges() == 0
    save(tmp_path / "a.step", bodies)
    assert count_of(shape, "FACE") == count_of(read_shape(tmp_path / "a.step"), "FACE")
    if len(bodies) == 1:  # sewn shells of several bodies lose which side is inside
        # A torus is sewn to a face without a shell.
        assert abs(volume_of(sewing.SewedShape(), in_shells=False)) == pytest.approx(
            volume, rel=2e-5
        )


@pytest.mark.parametrize(
    ("key", "caps"),
    [("two flat caps", 2), ("an apex", 1), ("a torus", 0), ("a ring below", 0), ("a cavity", 4),
     ("a bore", 0), ("a fork", 3), ("two parts", 4)],
)  # fmt: skip
def test_a_3dm_file_has_every_patch_and_every_cap_that_nothing_meets(
    key, caps, tmp_path: Path
) -> None:
    rhino3dm = pytest.importorskip("rhino3dm", reason="needs the extra cad")
    bodies, _, _ = PARTS[key]
    surfaces = [body.surface for body in bodies]
    borders = flat_caps(bodies)
    write_threedm(tmp_path / "a.3dm", surfaces, caps=borders, name="vase", provenance=PROVENANCE)
    model = rhino3dm.File3dm.Read(str(tmp_path / "a.3dm"))
    assert model.Settings.ModelUnitSystem == rhino3dm.UnitSystem.Millimeters
    breps = [each.Geometry for each in model.Objects if isinstance(each.Geometry, rhino3dm.Brep)]
    assert len(breps) == len(borders) == caps
    assert all(each.IsValid for each in breps)
    for brep, border in zip(breps, borders, strict=True):
        edge = brep.Edges[0]
        share = np.linspace(0.0, 1.0, 60)
        at = [edge.PointAt((1 - each) * edge.Domain.T0 + each * edge.Domain.T1) for each in share]
        seen = np.array([[point.X, point.Y, point.Z] for point in at])
        (u0, u1) = border.domain
        np.testing.assert_allclose(seen, border(u0 + share * (u1 - u0)), atol=1e-9)
    assert len(read_threedm(tmp_path / "a.3dm")[0]) == len(bodies)


# --- from slices ----------------------------------------------------------------------------------


def test_the_skin_of_a_tube_with_a_bore_is_one_solid_of_its_meshs_volume(tmp_path: Path) -> None:
    slices = []
    for index, height in enumerate(np.arange(12) * 2.0):
        rings = [
            ring_slices([float(height)], lambda turn, z, r=r: np.full_like(turn, r), count=900,
                        sigma_mm=0.1, seed=10 * index + int(r))[0].points_mm
            for r in (30.0, 20.0)
        ]  # fmt: skip
        slices.append(
            Slice(index, np.vstack(rings), Frame(np.array([0.0, 0.0, height]), np.eye(3)))
        )
    skinned = skin_slices(drawn(slices))
    mesh = trimesh.Trimesh(skinned.mesh.vertices_mm, skinned.mesh.faces, process=False)
    found = save(tmp_path / "a.step", bodies_of(skinned.skins), volume_mm3=mesh.volume)
    assert (found.solids, found.reasons) == (1, ())
    shape = read_shape(tmp_path / "a.step")
    assert is_valid(shape)
    assert volume_of(shape) == pytest.approx(mesh.volume, rel=1e-3)


# --- facets, where the surfaces are no solid ------------------------------------------------------


def crossed_tube() -> Surface:
    """A tube whose outline is a figure of eight: it crosses itself all the way up."""
    surface = tube_net().surface()
    points = np.array(surface.control_points_mm)
    turn = np.arange(len(points)) / len(points) * math.tau
    points[..., 0], points[..., 1] = (10 * np.cos(turn))[:, None], (8 * np.sin(2 * turn))[:, None]
    return replace(surface, control_points_mm=points)


def as_mesh(solid: trimesh.Trimesh) -> Mesh:
    vertices = np.array(solid.vertices)
    return Mesh(vertices, np.array(solid.faces, dtype=np.int64), np.zeros(len(vertices), bool))


@pytest.mark.parametrize(
    ("solid", "faces_at_most"),
    [
        (trimesh.creation.torus(20.0, 6.0, major_sections=90, minor_sections=40), 8_000),
        (trimesh.creation.icosphere(subdivisions=5, radius=9.0), 12_000),  # of 20 480
    ],
)
def test_surfaces_that_cross_themselves_become_a_valid_solid_of_facets(
    solid, faces_at_most: int, tmp_path: Path
) -> None:
    found = save(
        tmp_path / "a.step", [Body(crossed_tube())], volume_mm3=solid.volume, mesh=as_mesh(solid)
    )
    assert found.closed
    assert found.reasons != ()
    assert 0 < found.facets <= faces_at_most
    shape = read_shape(tmp_path / "a.step")
    assert count_of(shape, "SOLID") == 1
    assert count_of(shape, "FACE") == found.facets
    assert is_valid(shape)
    assert volume_of(shape) == pytest.approx(solid.volume, rel=1e-3)
    assert "OPEN_SHELL" not in plain_text(tmp_path / "a.step")


def test_a_cavity_of_facets_is_a_void_of_the_solid_around_it(tmp_path: Path) -> None:
    outer, inner = (trimesh.creation.icosphere(subdivisions=2, radius=r) for r in (9.0, 4.0))
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    volume = outer.volume + inner.volume
    mesh = as_mesh(hollow)
    found = save(tmp_path / "a.step", [Body(crossed_tube())], volume_mm3=volume, mesh=mesh)
    assert (found.solids, found.facets) == (1, len(hollow.faces))
    shape = read_shape(tmp_path / "a.step")
    assert is_valid(shape)
    assert volume_of(shape) == pytest.approx(volume, rel=1e-3)


def test_an_open_mesh_makes_no_solid_and_both_reasons_are_said(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=9.0)
    sphere.update_faces(np.arange(len(sphere.faces)) > 0)
    mesh = as_mesh(sphere)
    found = save(tmp_path / "a.step", [Body(crossed_tube())], volume_mm3=3000.0, mesh=mesh)
    assert (found.closed, found.facets, len(found.reasons)) == (False, 0, 2)
    assert "OPEN_SHELL" in plain_text(tmp_path / "a.step")
