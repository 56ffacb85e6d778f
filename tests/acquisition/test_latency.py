"""The shift between two turns, on made-up parts: an outline seen from a sensor at 200 mm."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from acquisition.latency import View, shift_between

SPEED = math.radians(60.0)
SIGMA_MM = 0.025
Outline = Callable[[np.ndarray], np.ndarray]


def lobes(angle: np.ndarray) -> np.ndarray:
    return 30.0 + 2.0 * np.cos(5.0 * angle) + 0.7 * np.sin(2.0 * angle)


def circle(angle: np.ndarray) -> np.ndarray:
    return np.full_like(angle, 30.0)


def one_flat(angle: np.ndarray) -> np.ndarray:
    """A shaft with a flat of 20 degrees, and round elsewhere."""
    away = np.abs((angle + math.pi) % math.tau - math.pi)
    edge = math.cos(math.radians(10.0))
    return np.where(away < math.radians(10.0), 30.0 * edge / np.cos(away), 30.0)


def beside(angle: np.ndarray) -> np.ndarray:
    """A circle whose middle is 1 mm beside the axis."""
    return np.cos(angle) + np.sqrt(30.0**2 - np.sin(angle) ** 2)


def view(
    outline: Outline, shift_rad: float, seed: int, *, profiles: int = 1200, points: int = 60
) -> View:
    """What one turn shows, its angles off by the shift; run-ins of 15 degrees on both sides."""
    rng = np.random.default_rng(seed)
    true = np.radians(np.linspace(-15.0, 375.0, profiles)) + rng.uniform(0, 1e-3)
    seen = np.linspace(-1.0, 1.0, points)  # the part's side that faces the sensor, in radians
    made = []
    for angle in true:
        radius = outline(seen - angle)
        x, z = radius * np.sin(seen), 200.0 - radius * np.cos(seen)
        order = np.argsort(x)
        noise = SIGMA_MM * rng.standard_normal(points)
        made.append(np.column_stack([x, z + noise])[order])
    return View(made, true + shift_rad)


def found(outline: Outline, latency_s: float, seed: int = 0, **options: int):
    shift = latency_s * SPEED
    return shift_between(
        view(outline, shift, 2 * seed, **options),
        view(outline, -shift, 2 * seed + 1, **options),
        SPEED,
    )


@pytest.mark.parametrize("latency_s", [-0.01, 0.0, 0.002, 0.03, 0.09])
@pytest.mark.parametrize("outline", [lobes, one_flat, beside])
def test_the_latency_is_found_whatever_tells_it(outline: Outline, latency_s: float) -> None:
    told = found(outline, latency_s)
    assert told.told
    assert abs(told.shift_rad / SPEED - latency_s) < 4.0 * told.sd_rad / SPEED
    assert told.apart_mm == pytest.approx(told.noise_mm, rel=0.15)


def test_the_standard_deviation_is_that_of_the_error() -> None:
    off = []
    for seed in range(1, 21):
        told = found(lobes, 0.002, seed, profiles=400, points=40)
        off.append((told.shift_rad - 0.002 * SPEED) / told.sd_rad)
    # 20 draws of a standard normal: its mean square lies within 0.4 and 2.0 in 99 % of all cases.
    assert 0.4 < np.mean(np.square(off)) < 2.0


@pytest.mark.parametrize("seed", range(5))
def test_a_circle_about_the_axis_tells_nothing(seed: int) -> None:
    told = found(circle, 0.002, seed, profiles=600)
    assert not told.told
    assert math.isnan(told.shift_rad)
    assert told.apart_mm == pytest.approx(told.noise_mm, rel=0.15)


def test_another_part_is_apart_by_more_than_noise() -> None:
    told = shift_between(view(lobes, 0.0, 1), view(beside, 0.0, 2), SPEED)
    assert told.apart_mm > 3.0 * told.noise_mm


def test_nearly_nothing_seen_is_refused() -> None:
    nothing = View([np.empty((0, 2))] * 100, np.linspace(0.0, math.tau, 100))
    with pytest.raises(ValueError, match="too few profiles"):
        shift_between(nothing, nothing, SPEED)
