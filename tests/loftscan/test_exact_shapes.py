"""What a person and a program are told of an exact shape, from the command line on."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from loftscan import reconstruct
from loftscan.reporting import compose
from loftscan.result import Result
from loftscan.shape_findings import apexes_said, shape_tables, shapes_said, tell_shapes
from reconstruction.arrays import FloatArray
from reconstruction.exporting import read_surface_json
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.nurbs import evaluate_surface
from tests.system.command_cases import run, succeeded

SIGMA = 0.1
RADIUS, SHIFT = 20.0, np.array([3.0, -5.0, 0.0])


def cylinder_cloud(seed: int = 1) -> FloatArray:
    """40 rows of 400 points, a quarter of the turn missing half-way up."""
    rng = np.random.default_rng(seed)
    height = np.repeat(np.arange(40) * 1.5, 400)
    turn = rng.uniform(0.0, math.tau, len(height))
    missing = (turn < math.pi / 2) & (height > 20.0) & (height < 40.0)
    height, turn = height[~missing], turn[~missing]
    places = np.column_stack([RADIUS * np.cos(turn), RADIUS * np.sin(turn), height])
    places[:, :2] += rng.normal(0.0, SIGMA, (len(places), 2))
    return places + SHIFT


def cone_cloud(seed: int = 1) -> FloatArray:
    """A cone of half angle 0.3 rad whose apex is 40 mm up, rows of 300 points up to 39 mm."""
    rng = np.random.default_rng(seed)
    height = np.repeat(np.arange(0.0, 39.1, 1.0), 300)
    turn = rng.uniform(0.0, math.tau, len(height))
    radius = (40.0 - height) * math.tan(0.3)
    places = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    places[:, :2] += rng.normal(0.0, SIGMA, (len(places), 2))
    return places


@pytest.fixture(scope="module")
def cylinder() -> Result:
    return reconstruct(cylinder_cloud(), method="fit")


@pytest.fixture(scope="module")
def cone() -> Result:
    return reconstruct(cone_cloud(), method="fit")


@pytest.fixture(scope="module")
def free() -> Result:
    return reconstruct(cylinder_cloud(), method="fit", exact="never")


def fitted(result: Result) -> FittedReconstruction:
    assert isinstance(result.reconstruction, FittedReconstruction)
    return result.reconstruction


def test_the_result_knows_the_shape_and_its_figures(cylinder: Result) -> None:
    (shape,) = cylinder.shapes
    assert shape is not None
    figures = {each.name: each for each in shape.quantities}
    assert set(figures) == {"axis point", "axis direction", "radius"}
    radius = figures["radius"]
    assert abs(radius.values[0] - RADIUS) < 4.0 * radius.deviations[0]
    # The axis runs through the true one, as seen from above; its height is free.
    off = np.abs(figures["axis point"].values - SHIFT)[:2]
    assert (off < 4.0 * figures["axis point"].deviations[:2]).all()


def test_metrics_say_every_figure_with_its_deviation_and_unit(cylinder: Result) -> None:
    (said,) = cylinder.metrics["shapes"]  # type: ignore[misc]
    assert (said["branch"], said["kind"]) == (0, "cylinder")
    assert said["radius_mm"] == pytest.approx(RADIUS, abs=4.0 * said["radius_sd_mm"])
    assert 0.0 < said["radius_sd_mm"] < 4.0 * SIGMA / math.sqrt(14_000)
    assert len(said["axis_point_mm"]) == len(said["axis_point_sd_mm"]) == 3
    assert said["axis_direction"] == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)
    assert cylinder.metrics["branches_exact"] == 1
    assert cylinder.metrics["apexes"] == []


def test_metrics_say_half_angle_and_apex_of_a_cone(cone: Result) -> None:
    (said,) = cone.metrics["shapes"]  # type: ignore[misc]
    assert said["kind"] == "cone"
    assert said["half_angle_rad"] == pytest.approx(0.3, abs=4.0 * said["half_angle_sd_rad"])
    for found, true, deviation in zip(
        said["apex_mm"], (0.0, 0.0, 40.0), said["apex_sd_mm"], strict=True
    ):
        assert abs(found - true) < 4.0 * deviation
    (tip,) = cone.metrics["apexes"]  # type: ignore[misc]
    assert (tip["branch"], tip["sharp"], tip["exact"]) == (0, True, True)
    assert tip["point_mm"] == pytest.approx(said["apex_mm"])
    assert tip["point_sd_mm"] == pytest.approx(said["apex_sd_mm"])


def test_the_tip_of_an_exact_cone_may_be_measured_its_flat_foot_may_not(cone: Result) -> None:
    (ends,) = [each for each in cone.warnings if "no slice samples" in each]
    assert "1 closed by a flat cap" in ends
    assert "tip" not in ends


def test_the_report_says_the_shape_in_words_and_in_a_table(cone: Result) -> None:
    report = compose(cone)
    (sentence,) = [each.sentence for each in report.findings if "exact" in each.sentence]
    assert sentence.startswith("The surface is an exact cone, because its points are those of one")
    assert "half angle 17.1" in sentence  # 0.3 rad are 17.19 degrees
    assert "±" in sentence
    titles = [group.title for group in report.metrics]
    assert "Exact shape of branch 0: cone" in titles
    assert "Ends in a point" in titles
    (table,) = [group for group in report.metrics if "Exact shape" in group.title]
    labels = [fact.label for fact in table.facts]
    assert {"half angle", "apex x", "apex z", "axis point y", "axis direction x"} <= set(labels)
    assert all("±" in str(fact.value) for fact in table.facts)


def test_the_surface_that_is_written_is_the_exact_one(cylinder: Result) -> None:
    (surface,) = cylinder.surface
    (shape,) = cylinder.shapes
    assert shape is not None
    assert np.ptp(surface.weights) > 0.1  # rational: a circle is no polynomial
    places = evaluate_surface(surface, np.linspace(0, 1, 99), np.linspace(*surface.domain[1], 5))
    assert np.abs(shape.form.measure(places.reshape(-1, 3)).distances_mm).max() < 1e-9


def test_never_claims_nothing_and_says_nothing_of_shapes(free: Result) -> None:
    assert free.shapes == (None,)
    assert free.metrics["shapes"] == []
    assert free.metrics["branches_exact"] == 0
    assert not [each for each in compose(free).findings if "exact" in each.sentence]
    (surface,) = free.surface
    assert np.ptp(surface.weights) == 0.0


def test_the_papers_patches_are_no_shapes() -> None:
    result = reconstruct(cylinder_cloud(), method="paper")
    assert result.shapes == (None,) * len(result.surface)
    assert tell_shapes(result.reconstruction) == []
    assert shape_tables(result.reconstruction) == ()
    assert "shapes" not in result.metrics


def test_what_is_said_is_plain_json(cone: Result) -> None:
    said = {"shapes": shapes_said(fitted(cone)), "apexes": apexes_said(fitted(cone))}
    assert json.loads(json.dumps(said, allow_nan=False)) == said


@pytest.mark.parametrize("exact", ["auto", "never"])
def test_the_command_writes_a_cylinder_as_what_it_is_unless_told_never(
    exact: str, tmp_path: Path
) -> None:
    cloud, out = tmp_path / "part.npy", tmp_path / "out"
    np.save(cloud, cylinder_cloud())
    ran = succeeded(
        run(
            "reconstruct", cloud, "--out", out, "--method", "fit", "--exact", exact,
            "--formats", "step,3dm,stl",
        )
    )  # fmt: skip
    told = [line for line in ran.stdout.splitlines() if line.startswith("shape: ")]
    numbers = json.loads((out / "metrics.json").read_text())
    (surface,) = read_surface_json(out / "surface.json")
    page = (out / "report.html").read_text()
    assert numbers["watertight"]
    assert "no solid" not in ran.stderr
    assert (out / "surface.step").read_text().count("MANIFOLD_SOLID_BREP") == 1
    assert json.loads((out / "provenance.json").read_text())["settings"]["exact"] == exact
    assert "Standard deviation of the surface" in page
    if exact == "never":
        assert told == []
        assert numbers["shapes"] == []
        assert np.ptp(surface.weights) == 0.0
        assert "an exact cylinder" not in page
        return
    assert len(told) == 1
    assert "an exact cylinder" in told[0]
    assert numbers["shapes"][0]["kind"] == "cylinder"
    assert np.ptp(surface.weights) > 0.1
    assert "an exact cylinder" in page
    assert "Exact shape of branch 0: cylinder" in page


def test_json_lines_carry_the_shapes(tmp_path: Path) -> None:
    cloud = tmp_path / "part.npy"
    np.save(cloud, cone_cloud())
    ran = succeeded(
        run(
            "reconstruct", cloud, "--out", tmp_path / "o", "--method", "fit", "--json",
            "--formats", "stl",
        )
    )  # fmt: skip
    done = json.loads(ran.stdout.splitlines()[-1])
    assert done["event"] == "done"
    assert [shape["kind"] for shape in done["shapes"]] == ["cone"]
    assert "shape:" not in ran.stdout
