"""The numbers of metrics.json: every one there, explained, and in agreement with the others."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from loftscan import reconstruct
from loftscan.metrics import is_one_turn, resources
from loftscan.result import Result
from tests.conftest import Saved
from tests.system.command_cases import (
    NOISE_MM,
    ROW_MM,
    ROWS,
    SHADOW_RAD,
    SHADOWED_ROWS,
    FloatArray,
    volume_mm3,
)

PROMISED = {
    *("points_in", "points_set_aside", "slices", "sections", "patches", "control_points"),
    *("thickness_mm", "residual_rms_mm", "residual_max_mm", "gap_fraction", "watertight"),
    *("volume_mm3", "area_mm2", "seconds", "peak_memory_mb"),
}
PAGE = Path(__file__).resolve().parents[2] / "docs/result-folder.md"


def explained() -> dict[str, str]:
    """Name and row of everything that the page explains as a number."""
    numbers = PAGE.read_text(encoding="utf-8").partition("## metrics.json")[2]
    rows = [line for line in numbers.splitlines() if line.startswith("| `")]
    return {name: row for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}


@pytest.fixture
def numbers(saved: Saved) -> dict:
    return json.loads((saved.folder / "metrics.json").read_text())


def test_every_promised_number_is_there(numbers: dict) -> None:
    assert PROMISED - set(numbers) == set()


def test_every_number_is_explained_and_nothing_else_is(numbers: dict, paper_result: Result) -> None:
    page = PAGE.read_text(encoding="utf-8")
    besides = page.partition("Of `--method fit` besides:")[2].partition("###")[0]
    of_fit = set(re.findall(r"^\| `(\w+)`", besides, re.MULTILINE))
    of_paper = {name for name, row in explained().items() if "(paper)" in row.split("|")[1]}
    assert set(explained()) - of_fit == set(paper_result.metrics)
    assert set(explained()) - of_paper == set(numbers)


def test_the_explained_unit_is_that_of_the_name(numbers: dict) -> None:
    endings = {"mm": "mm", "mm2": "mm²", "mm3": "mm³", "mb": "MB", "fraction": "fraction"}
    for name, row in explained().items():
        unit = row.split("|")[2].strip()
        ending = name.rpartition("_")[2]
        if ending in endings:
            assert unit == endings[ending], name
        else:
            assert unit in {"count", "counts", "fraction", "text", "truth", "s", "list"}, name


def test_every_reason_and_every_stage_is_explained(numbers: dict) -> None:
    rows = explained()
    for name in ("points_set_aside_by_reason", "seconds_by_stage"):
        for key in numbers[name]:
            assert f"`{key}`" in rows[name]


def test_every_file_of_a_result_is_explained(saved: Saved) -> None:
    named = set(re.findall(r"^\| `([\w.]+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    assert {path.name for path in saved.folder.iterdir()} <= named


def test_no_point_is_lost(numbers: dict) -> None:
    assert numbers["points_in"] == (
        numbers["points_set_aside"]
        + numbers["points_in_sections"]
        + numbers["points_in_skipped_slices"]
    )
    assert numbers["points_set_aside"] == sum(numbers["points_set_aside_by_reason"].values())
    assert numbers["points_in_sections"] == numbers["residual_all_points"]
    assert numbers["points_in_sections"] == numbers["residual_points"] + numbers["points_left_out"]
    assert numbers["slices"] == numbers["sections"] + numbers["slices_skipped"]


def test_the_mesh_counts_are_those_of_a_closed_body(numbers: dict, paper_result: Result) -> None:
    for told in (numbers, paper_result.metrics):
        assert told["euler_number"] == 2
        assert told["components"] == 1
        assert told["faces"] == 2 * told["vertices"] - 4
    assert paper_result.metrics["volume_mm3"] == pytest.approx(volume_mm3(), rel=0.005)
    # A fit goes on for half a row beyond the first and the last.
    beyond = ROW_MM / 2 * math.pi * (20.0**2 + 2.0**2 / 2.0 + 13.0**2)
    assert numbers["volume_mm3"] == pytest.approx(volume_mm3() + beyond, rel=0.005)


@pytest.mark.parametrize("method", ["fit", "paper"])
def test_a_rectangle_of_noise_has_its_width_and_a_shadow_its_share(
    part_result: Result, paper_result: Result, method: str
) -> None:
    numbers = {"fit": part_result, "paper": paper_result}[method].metrics
    assert numbers["thickness_mm"] == pytest.approx(4.0 * NOISE_MM, rel=0.1)
    # Half the rows are 2 pi 20 mm long (and a little: they are oval), half 2 pi 13 mm.
    foot = 2.0 * math.pi * 20.0 * 1.01
    whole = ROWS / 2 * (foot + 2.0 * math.pi * 13.0)
    # Around 2 rad the foot is a bit nearer than 20 mm; a gap ends at the next measured cell.
    shadow = SHADOWED_ROWS * SHADOW_RAD * (20.0 + 2.0 * math.cos(4.0))
    # A fit bridges from point to point, the paper from cell to cell.
    cells = SHADOWED_ROWS * 2.0 * numbers["cell_mm"] if method == "paper" else 0.0
    assert 0.9 * shadow <= numbers["gap_fraction"] * whole <= 1.1 * shadow + 2.0 * cells


@pytest.mark.parametrize("method", ["fit", "paper"])
def test_the_residuals_are_those_of_the_sections(
    part_result: Result, paper_result: Result, method: str
) -> None:
    part_result = {"fit": part_result, "paper": paper_result}[method]
    told, sections = part_result.metrics, part_result.sections
    count = sum(section.residual.count for section in sections)
    squares = sum(section.residual.squares_mm2 for section in sections)
    assert told["residual_rms_mm"] == pytest.approx(math.sqrt(squares / count), rel=1e-12)
    assert told["residual_max_mm"] == max(section.residual.max_mm for section in sections)
    assert told["residual_points"] == count
    curves = [drawn.curve for section in sections for drawn in section.curves]
    assert told["control_points"] == sum(len(curve.control_points_mm) for curve in curves)
    off = part_result.deviation.distances_mm
    assert told["surface_deviation_rms_mm"] == pytest.approx(np.sqrt((off**2).mean()), rel=1e-9)
    assert told["surface_deviation_max_mm"] == pytest.approx(np.abs(off).max(), rel=1e-9)
    assert told["surface_deviation_points"] == len(off)


def test_what_is_left_out_is_in_the_residual_of_all_points_only(part_points: FloatArray) -> None:
    rng = np.random.default_rng(1)
    # A piece of a handle, 6 mm beside the neck in four rows.
    height = np.repeat([20.0, 22.0, 24.0, 26.0], 60)
    angle, radius = rng.uniform(-0.4, 0.4, 240), 19.0 + rng.normal(0.0, NOISE_MM, 240)
    handle = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    told = reconstruct(np.concatenate([part_points, handle]), method="paper").metrics
    assert told["points_left_out"] > 0
    assert told["residual_points"] == told["points_in_sections"] - told["points_left_out"]
    assert told["residual_max_mm"] < 5.0 < told["residual_all_max_mm"]
    assert told["residual_rms_mm"] < told["residual_all_rms_mm"]


def test_seconds_add_up_and_memory_is_that_of_the_process() -> None:
    told = resources({"slicing": 1.25, "sections": 2.5})
    assert told["seconds"] == 3.75
    assert told["seconds_by_stage"] == {"slicing": 1.25, "sections": 2.5}
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("this system tells no peak memory in /proc")
    peak = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())
    assert peak is not None
    assert told["peak_memory_mb"] == pytest.approx(int(peak[1]) / 1024, rel=0.05)


@pytest.mark.parametrize(
    ("turns", "once"), [(1.0, True), (-1.0, True), (1.0 + 1e-9, True), (0.0, False), (2.0, False)]
)
def test_a_contour_goes_round_once_in_either_direction(turns: float, once: bool) -> None:  # noqa: FBT001
    assert is_one_turn(turns) is once
