"""`loftscan demo`: what somebody types first."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from loftscan.demo import HEIGHT_MM, make_cloud, vase_radius_mm
from tests.system.command_cases import RESULT_FILES, contents, run, succeeded


def vase_volume_mm3() -> float:
    """By the formula of the vase, integrated over angle and height."""
    angle, height = np.meshgrid(
        np.arange(720) * (math.tau / 720), (np.arange(900) + 0.5) * HEIGHT_MM / 900
    )
    return float((vase_radius_mm(angle, height) ** 2).mean() * math.pi * HEIGHT_MM)


def test_the_demo_makes_a_whole_result_of_a_vase_close_to_its_formula(place: Path) -> None:
    ran = succeeded(run("demo"))
    assert ran.stdout.splitlines()[-1] == "report: demo-out/report.html"
    assert set(contents(place / "demo-out")) == RESULT_FILES
    told = json.loads((place / "demo-out/metrics.json").read_text())
    assert told["watertight"] is True
    assert told["slices"] == told["sections"] == 91
    assert told["volume_mm3"] == pytest.approx(vase_volume_mm3(), rel=0.01)
    # 4 sigma of the noise; the gaps that it was given are seen as such.
    assert told["thickness_mm"] == pytest.approx(0.6, rel=0.1)
    assert 0.01 < told["gap_fraction"] < 0.05
    assert told["points_set_aside_by_reason"]["stray"] > 0
    assert told["residual_rms_mm"] < 0.16


def test_a_seed_is_a_cloud() -> None:
    assert make_cloud(3).tobytes() == make_cloud(3).tobytes()
    assert make_cloud(3).shape != make_cloud(4).shape


def test_the_cloud_is_noisy_and_gappy_as_promised() -> None:
    cloud = make_cloud()
    radius, angle = np.hypot(*cloud[:, :2].T), np.arctan2(cloud[:, 1], cloud[:, 0])
    part = radius < 50.0
    off = radius[part] - vase_radius_mm(angle[part], cloud[part, 2])
    assert off.std() == pytest.approx(0.15, rel=0.02)
    shadow = part & (np.abs(angle - 1.0) < 0.17) & (np.abs(cloud[:, 2] - 50.0) < 19.0)
    assert not shadow.any()


def test_the_demo_refuses_to_replace_what_it_did_not_make(place: Path) -> None:
    (place / "demo-out").mkdir()
    (place / "demo-out/thesis.txt").write_text("years of work")
    for options in ([], ["--overwrite"]):
        assert run("demo", *options).exit_code == 2
    assert (place / "demo-out/thesis.txt").read_text() == "years of work"
