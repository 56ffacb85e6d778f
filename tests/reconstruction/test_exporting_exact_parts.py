"""Exact rational walls reach CAD as they are: valid solids of the part's volume, weights kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from reconstruction.exporting import (
    bodies_of,
    read_threedm,
    write_iges_solid,
    write_step_solid,
    write_threedm,
)
from reconstruction.nurbs import evaluate_surface
from reconstruction.skinning.surfacing import Skinned, skin_slices
from tests.reconstruction.cad_samples import PROVENANCE
from tests.reconstruction.exact_parts import PARTS, pieces, steady

pytest.importorskip("OCP.Geom", reason="needs the extra cad")

from tests.reconstruction.test_exporting_solids import is_valid, read_shape, volume_of


def mesh_volume(found: Skinned) -> float:
    solid = trimesh.Trimesh(found.mesh.vertices_mm, found.mesh.faces, process=False)
    assert solid.is_watertight
    return float(solid.volume)


@pytest.mark.parametrize("name", PARTS)
def test_an_exact_part_is_one_valid_solid_of_its_meshs_volume(name: str, tmp_path: Path) -> None:
    cut, kinds = PARTS[name]
    found = skin_slices(cut())
    assert [shape and shape.kind for shape in found.shapes] == kinds
    made = write_step_solid(
        tmp_path / "a.step", bodies_of(found.skins), name=name, provenance=PROVENANCE
    )
    assert (made.solids, made.reasons) == (1, ())
    shape = read_shape(tmp_path / "a.step")
    assert is_valid(shape)
    assert volume_of(shape) == pytest.approx(mesh_volume(found), rel=1e-3)


def test_an_exact_cylinder_reaches_iges_as_a_closed_shell(tmp_path: Path) -> None:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing

    found = skin_slices(pieces(steady(20.0)))
    made = write_iges_solid(
        tmp_path / "a.igs", bodies_of(found.skins), name="tube", provenance=PROVENANCE
    )
    assert made.closed
    sewing = BRepBuilderAPI_Sewing(1e-4)
    sewing.Add(read_shape(tmp_path / "a.igs"))
    sewing.Perform()
    assert sewing.NbFreeEdges() == 0
    volume = abs(volume_of(sewing.SewedShape(), in_shells=False))
    assert volume == pytest.approx(mesh_volume(found), rel=1e-3)


def test_an_exact_cylinder_reaches_3dm_with_its_weights(tmp_path: Path) -> None:
    pytest.importorskip("rhino3dm", reason="needs the extra cad")
    found = skin_slices(pieces(steady(20.0)))
    (shape,) = found.shapes
    assert shape is not None
    write_threedm(
        tmp_path / "a.3dm", [found.skins[0].surface], [], name="tube", provenance=PROVENANCE
    )
    back = read_threedm(tmp_path / "a.3dm")[0][0]
    assert np.ptp(back.weights) > 0.1
    places = evaluate_surface(back, *(np.linspace(*domain, 70) for domain in back.domain))
    assert np.abs(shape.form.measure(places.reshape(-1, 3)).distances_mm).max() < 1e-9
