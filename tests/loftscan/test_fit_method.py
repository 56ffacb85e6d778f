"""`method="fit"` from Python: slices in, one watertight surface with its certainty out."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from loftscan import reconstruct, reconstruct_stream
from loftscan.result import Result
from loftscan.updates import Finished, Fitted, Missed
from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.exporting import read_sections_json, read_step, read_surface_json
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.nurbs.surface_evaluation import evaluate_surface_at
from reconstruction.skinning import surfacing
from reconstruction.slices import Frame, Slice

SIGMA_MM = 0.05
STEP_MM = 2.0
BESIDE_MM = 5.0  # of the part's middle from the axis
GAP = math.radians(40.0)


def radii(height_mm: float) -> tuple[float, float]:
    """Half axes of the part: an ellipse that grows and sways with height."""
    return 20.0 + 0.1 * height_mm, 14.0 + 2.0 * math.sin(height_mm / 9.0)


def ring(
    index: int, *, half_turned: bool = False, aside_mm: float = 0.0, gap: bool = False
) -> Slice:
    """A slice of the part, shuffled, its points 0.2 mm apart; it stands beside the axis."""
    rng = np.random.default_rng(index)
    height = STEP_MM * index
    seen = math.tau - (GAP if gap else 0.0)
    angle = rng.permutation(np.arange(500) + rng.uniform(0.0, 1.0, 500)) * seen / 500
    a, b = radii(height)
    places = np.column_stack([a * np.cos(angle), b * np.sin(angle)])
    places += rng.normal(0.0, SIGMA_MM, places.shape) + np.array([BESIDE_MM + aside_mm, 0.0])
    places *= -1.0 if half_turned else 1.0
    points = np.column_stack([places, np.full(len(places), height)])
    return Slice(index, points, Frame(np.array([0.0, 0.0, height]), np.eye(3)))


def empty(index: int) -> Slice:
    height = STEP_MM * index
    return Slice(index, np.empty((0, 3)), Frame(np.array([0.0, 0.0, height]), np.eye(3)))


def stack(count: int = 12) -> list[Slice]:
    return [ring(index, gap=4 <= index < 7) for index in range(count)]


def off_mm(places_mm: FloatArray) -> FloatArray:
    """Roughly how far places lie from the true wall, in the plane."""
    x, y, z = places_mm.T - [[BESIDE_MM], [0.0], [0.0]]
    a, b = 20.0 + 0.1 * z, 14.0 + 2.0 * np.sin(z / 9.0)
    level = np.hypot(x / a, y / b)
    slope = np.hypot(x / a**2, y / b**2) / level
    return np.asarray((level - 1.0) / slope)


@pytest.fixture(scope="module")
def made() -> Result:
    return reconstruct(stack(), method="fit")


def test_the_surface_is_nearer_to_the_truth_than_the_noise_and_knows_it(made: Result) -> None:
    done = made.reconstruction
    assert isinstance(done, FittedReconstruction)
    (skin,) = done.skinned.skins
    end_u, end_v = skin.fit.net.spans
    u, v = (
        each.ravel()
        for each in np.meshgrid(np.linspace(0, end_u, 90), np.linspace(1, end_v - 1, 40))
    )
    measured = ~skin.synthetic(u, v)
    off = off_mm(evaluate_surface_at(skin.fit.net.surface(), u, v))
    assert np.sqrt(np.mean(off[measured] ** 2)) < 0.3 * SIGMA_MM
    assert np.sqrt(np.mean(off[~measured] ** 2)) < 1.5 * SIGMA_MM  # in the gap, and at the ends
    pulls = off / skin.deviation_mm(u, v)
    assert np.mean(np.abs(pulls) > 3.0) < 0.02


def test_what_is_measured_of_it_is_said(made: Result) -> None:
    numbers = made.metrics
    assert (numbers["slices"], numbers["sections"], numbers["patches"]) == (12, 12, 1)
    assert (numbers["contours"], numbers["branches"], numbers["cavities"]) == (12, 1, 0)
    assert numbers["watertight"]
    assert numbers["euler_number"] == 2
    assert numbers["thickness_mm"] == pytest.approx(4.0 * SIGMA_MM, rel=0.1)
    assert numbers["residual_rms_mm"] == pytest.approx(SIGMA_MM, rel=0.1)
    assert numbers["gap_fraction"] == pytest.approx(3 / 12 * 40 / 360, rel=0.2)
    points = 12 * 500
    assert numbers["points_in"] == points
    assert numbers["residual_points"] + numbers["points_left_out"] == points
    assert made.provenance["settings"]["method"] == "fit"  # type: ignore[index]
    *doubts, ends = made.warnings
    assert [doubt.split(":")[0] for doubt in doubts] == ["slice 4", "slice 5", "slice 6"]
    assert all("may be closed or open: closed" in doubt for doubt in doubts)
    assert "2 closed by a flat cap" in ends


def test_its_files_hold_a_solid_every_contour_and_the_standard_deviation(
    made: Result, tmp_path: Path
) -> None:
    folder = made.save(tmp_path / "out")
    (surface,) = read_surface_json(folder / "surface.json")
    assert surface.periodic_u
    assert len(read_sections_json(folder / "sections.json")) == 12
    step = (folder / "surface.step").read_text()
    assert len(re.findall("MANIFOLD_SOLID_BREP", step)) == 1
    assert len(read_step(folder / "surface.step")) >= 1
    assert json.loads((folder / "metrics.json").read_text())["watertight"]
    assert "Standard deviation of the surface" in (folder / "report.html").read_text()


def test_programs_that_read_no_step_get_an_iges_file_when_asked_for(
    made: Result, tmp_path: Path
) -> None:
    folder = made.save(tmp_path / "out", formats=["iges"])
    text = (folder / "surface.igs").read_text(encoding="ascii")
    kinds = [line.split()[0] for line in text.splitlines()[:-1] if line[72] == "D"]
    assert kinds.count("144") == 2 * 3  # trimmed surfaces, two lines each: the wall and two caps
    assert not (folder / "surface.step").exists()
    usual = made.save(tmp_path / "usual")
    assert not (usual / "surface.igs").exists()


def test_a_mesh_that_stands_in_is_said_and_leaves_no_surfaces_but_a_solid_of_facets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surfacing, "part_of", lambda mesh, *_: (mesh, "a mesh stands in"))
    result = reconstruct(stack(), method="fit")
    assert "a mesh stands in" in result.warnings
    assert result.reconstruction.patches == ()
    assert result.metrics["shapes"] == []
    remarks: list[str] = []
    folder = result.save(tmp_path / "out", remark=remarks.append)
    assert read_surface_json(folder / "surface.json") == ()
    step = (folder / "surface.step").read_text()
    assert len(re.findall("MANIFOLD_SOLID_BREP", step)) == 1
    assert "B_SPLINE_SURFACE" not in step
    assert any("planar facets of the mesh, none of NURBS surfaces" in words for words in remarks)
    kept = reconstruct(stack(), method="fit", nurbs="always")
    assert len(kept.reconstruction.patches) == 1
    assert "a mesh stands in" not in kept.warnings


def test_slices_that_come_one_by_one_give_sections_a_growing_mesh_and_the_same_surface(
    made: Result,
) -> None:
    def coming() -> Iterator[Slice]:
        yield from stack()

    *updates, last = reconstruct_stream(coming(), method="fit")
    assert all(isinstance(update, Fitted) for update in updates)
    first, third = updates[0], updates[2]
    assert isinstance(first, Fitted)
    assert isinstance(third, Fitted)
    assert first.mesh() is None
    grown = third.mesh()
    assert grown is not None
    assert grown.vertices_mm[:, 2].max() == pytest.approx(2.5 * STEP_MM, abs=0.01)
    assert isinstance(last, Finished)
    assert last.result.mesh.vertices_mm.tobytes() == made.mesh.vertices_mm.tobytes()


def test_an_empty_slice_in_the_middle_is_named_and_bridged() -> None:
    slices = [empty(6) if piece.index == 6 else piece for piece in stack()]
    *updates, last = reconstruct_stream(iter(slices), method="fit")
    assert [update.index for update in updates if isinstance(update, Missed)] == [6]
    assert isinstance(last, Finished)
    assert last.result.metrics["watertight"]
    assert last.result.metrics["branches"] == 1
    assert any("slice 6" in warning for warning in last.result.warnings)


@pytest.mark.parametrize("wrong", [ring(6, aside_mm=9.0), ring(6, half_turned=True)])
def test_a_slice_that_lies_elsewhere_or_is_turned_is_named_and_does_not_pull_the_surface(
    wrong: Slice,
) -> None:
    assert np.abs(off_mm(wrong.points_mm)).max() > 5.0
    slices = [wrong if piece.index == 6 else piece for piece in stack()]
    result = reconstruct(slices, method="fit")
    assert result.metrics["watertight"]
    assert any("slice 6" in warning for warning in result.warnings)
    walls = result.mesh.vertices_mm[np.abs(result.mesh.vertices_mm[:, 2] - 12.0) < 1.0]
    assert np.abs(off_mm(walls)).max() < 6 * SIGMA_MM


def test_two_identical_slices_are_a_prism_between_them() -> None:
    low, high = ring(0), ring(1)
    same = low.points_mm + np.array([0.0, 0.0, STEP_MM])
    result = reconstruct([low, Slice(1, same, high.frame)], method="fit")
    a, b = radii(0.0)
    # Half a step is added beyond either slice, where no slice tells of an end.
    assert result.metrics["volume_mm3"] == pytest.approx(math.pi * a * b * 2.0 * STEP_MM, rel=0.01)


def test_two_slices_are_enough_and_one_is_named_as_too_few() -> None:
    result = reconstruct([ring(0), ring(1)], method="fit")
    assert result.metrics["watertight"]
    with pytest.raises(NotLoftable, match="1 of 1 slices gave a closed section, two are needed"):
        reconstruct([ring(0)], method="fit")


def test_no_slice_at_all_is_said_and_a_point_that_is_no_number_is_named_with_its_slice() -> None:
    with pytest.raises(TooFewPoints, match="no slice in it yet"):
        reconstruct([], method="fit")
    slices = stack()
    points = np.array(slices[5].points_mm)
    points[7, 1] = np.nan
    slices[5] = Slice(5, points, slices[5].frame)
    with pytest.raises(ValueError, match=r"^slice 5: points must be finite: set NaN"):
        reconstruct(slices, method="fit")


@pytest.mark.parametrize("noise_mm", [0.0, 0.01, SIGMA_MM])
def test_a_slice_that_crosses_itself_is_named_and_does_not_pull_the_surface(
    noise_mm: float,
) -> None:
    rng = np.random.default_rng(6)
    angle = rng.permutation(np.arange(500)) * math.tau / 500
    places = np.column_stack([20 * np.sin(angle) + BESIDE_MM, 14 * np.sin(2 * angle)])
    places += rng.normal(0.0, noise_mm, places.shape)
    points = np.column_stack([places, np.full(500, 6 * STEP_MM)])
    slices = stack()
    slices[6] = Slice(6, points, slices[6].frame)
    result = reconstruct(slices, method="fit")
    assert result.metrics["watertight"]
    assert any(each.startswith("slice 6: ") for each in result.warnings)
    walls = result.mesh.vertices_mm[np.abs(result.mesh.vertices_mm[:, 2] - 12.0) < 1.0]
    assert np.abs(off_mm(walls)).max() < 6 * SIGMA_MM


def test_slices_in_another_order_are_refused_with_the_two_that_are_out_of_it() -> None:
    slices = stack()
    slices[3], slices[7] = slices[7], slices[3]
    with pytest.raises(ValueError, match="slice 4 at 8 mm follows slice 7 at 14 mm"):
        reconstruct(slices, method="fit")


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ({"method": "fit", "resolution_mm": 1.0}, "--resolution-mm"),
        ({"method": "fit", "intermediate": 3}, "--intermediate"),
        ({"method": "paper", "exact": "never"}, "--exact"),
    ],
)
def test_an_option_of_the_other_method_is_refused(given: dict[str, object], option: str) -> None:
    other = {"fit": "paper", "paper": "fit"}[str(given["method"])]
    said = f"^{option}: means nothing to --method {given['method']}; .* or choose --method {other}$"
    with pytest.raises(ValueError, match=said):
        reconstruct(stack(), **given)  # type: ignore[arg-type]
