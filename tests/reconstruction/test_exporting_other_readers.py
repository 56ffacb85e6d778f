"""STEP and IGES as programs without Open CASCADE, which wrote them, understand them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.interpolate import BSpline

from reconstruction.exporting import write_iges
from tests.reconstruction.cad_samples import (
    LARGEST_DIFFERENCE_MM,
    PROVENANCE,
    SURFACES,
    every_surface,
    probes,
    save_step,
)

pytestmark = pytest.mark.usefixtures("open_cascade")


@pytest.fixture
def open_cascade() -> None:
    pytest.importorskip("OCP.Geom", reason="the extra 'cad' is not installed")


class Read(NamedTuple):
    """A patch as a file says it: unwrapped, whether it closes or not."""

    degrees: tuple[int, int]
    knots_u: np.ndarray
    knots_v: np.ndarray
    points_mm: np.ndarray  # (nu, nv, 3)
    weights: np.ndarray  # (nu, nv)
    closed: tuple[bool, bool]

    def at(self, parameters: np.ndarray) -> np.ndarray:
        """Points (m, 3), by scipy."""
        whole = np.concatenate([self.points_mm, np.ones((*self.weights.shape, 1))], axis=2)
        whole *= self.weights[..., None]
        found = np.empty((len(parameters), 3))
        for row, (u, v) in enumerate(parameters):
            column = BSpline(self.knots_u, whole, self.degrees[0])(u)
            point = BSpline(self.knots_v, column, self.degrees[1])(v)
            found[row] = point[:3] / point[3]
        return found


# --- STEP, by steputils ---------------------------------------------------------------------------


def step_patches(path: Path) -> list[Read]:
    """Every B-spline surface of a STEP file."""
    from steputils import p21

    instances = p21.readfile(str(path)).data[0].instances
    places = {
        name: np.array(each.entity.params[1])
        for name, each in instances.items()
        if p21.is_simple_entity_instance(each) and each.entity.name == "CARTESIAN_POINT"
    }
    found = []
    for each in instances.values():
        if p21.is_simple_entity_instance(each):
            parts = {each.entity.name: list(each.entity.params)}
            if each.entity.name == "B_SPLINE_SURFACE_WITH_KNOTS":
                said = parts.pop(each.entity.name)
                parts = {"B_SPLINE_SURFACE": said[1:8], "B_SPLINE_SURFACE_WITH_KNOTS": said[8:]}
        else:
            parts = {entity.name: list(entity.params) for entity in each.entities}
        if "B_SPLINE_SURFACE" in parts:
            found.append(patch_of(parts, places))
    return found


def patch_of(parts: dict[str, list], places: dict[str, np.ndarray]) -> Read:
    degree_u, degree_v, names, _, closed_u, closed_v, _ = parts["B_SPLINE_SURFACE"]
    counts_u, counts_v, knots_u, knots_v, _ = parts["B_SPLINE_SURFACE_WITH_KNOTS"]
    points = np.array([[places[name] for name in row] for row in names])
    told = parts.get("RATIONAL_B_SPLINE_SURFACE")
    weights = np.ones(points.shape[:2]) if told is None else np.array(told[0], dtype=float)
    return Read(
        (degree_u, degree_v), np.repeat(knots_u, counts_u), np.repeat(knots_v, counts_v), points,
        weights, (closed_u == ".T.", closed_v == ".T."),
    )  # fmt: skip


@every_surface
def test_steputils_reads_our_surface_from_a_step_file(key: str, tmp_path: Path) -> None:
    save_step(tmp_path / "a.step", [SURFACES[key]])
    (read,) = step_patches(tmp_path / "a.step")
    parameters, points = probes(key)
    assert np.abs(read.at(parameters) - points).max() < LARGEST_DIFFERENCE_MM


@every_surface
def test_a_step_file_says_which_way_a_surface_closes(key: str, tmp_path: Path) -> None:
    surface = SURFACES[key]
    save_step(tmp_path / "a.step", [surface])
    (read,) = step_patches(tmp_path / "a.step")
    assert read.closed == (surface.periodic_u, surface.periodic_v)


# --- IGES, by pyiges ------------------------------------------------------------------------------


def iges_patches(path: Path) -> list[Read]:
    """Every rational B-spline surface (entity 128) of an IGES file."""
    import pyiges

    found = []
    for each in pyiges.read(str(path)):
        said = vars(each)
        if "_cp" not in said:
            continue
        shape = (said["_k2"] + 1, said["_k1"] + 1)  # u runs fastest
        found.append(
            Read(
                (said["_m1"], said["_m2"]), said["_knot1"], said["_knot2"],
                said["_cp"].reshape(*shape, 3).transpose(1, 0, 2),
                said["_weights"].reshape(shape).T, (said["_flag4"], said["_flag5"]),
            )
        )  # fmt: skip
    return found


@every_surface
def test_pyiges_reads_our_surface_from_an_iges_file(key: str, tmp_path: Path) -> None:
    write_iges(tmp_path / "a.igs", [SURFACES[key]], name="vase", provenance=PROVENANCE)
    (read,) = iges_patches(tmp_path / "a.igs")
    parameters, points = probes(key)
    assert np.abs(read.at(parameters) - points).max() < LARGEST_DIFFERENCE_MM


@every_surface
def test_an_iges_file_says_which_way_a_surface_is_periodic(key: str, tmp_path: Path) -> None:
    surface = SURFACES[key]
    write_iges(tmp_path / "a.igs", [surface], name="vase", provenance=PROVENANCE)
    (read,) = iges_patches(tmp_path / "a.igs")
    assert read.closed == (surface.periodic_u, surface.periodic_v)
