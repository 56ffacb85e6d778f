"""Figures: axes in mm, counts in legends, colours that can be relied on."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from loftscan.figures import (
    UNDEFINED,
    CellGrid,
    bead_radius_px,
    cloud_figure,
    deviation_colours,
    deviation_figure,
    histogram_figure,
    picture_figure,
    png,
    section_figure,
    sections_figure,
)
from loftscan.rendering import decode_png

ANGLES = np.linspace(0, 2 * np.pi, 60)
CIRCLE = 20 * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


def full_section_figure() -> Figure:
    return section_figure(
        CIRCLE,
        title="Section 3",
        cells=CellGrid(CIRCLE[::5], np.arange(1, 13), (4.0, 4.0)),
        contour_mm=CIRCLE[::5],
        curve_mm=CIRCLE,
        gaps_mm=[CIRCLE[3:9], CIRCLE[20:25]],
        left_out_mm=np.zeros((7, 2)),
    )


def legend_of(figure: Figure) -> list[str]:
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    return [text.get_text() for legend in legends if legend for text in legend.get_texts()]


def test_a_section_has_equal_axes_in_mm_and_says_what_is_drawn() -> None:
    figure = full_section_figure()
    axes = figure.axes[0]
    assert "[mm]" in axes.get_xlabel()
    assert "[mm]" in axes.get_ylabel()
    assert axes.get_aspect() == 1
    expected = {"60 points", "12 cells", "7 left out", "contour", "curve", "gaps, synthetic: 2"}
    assert set(legend_of(figure)) == expected


def test_a_section_without_anything_can_be_drawn() -> None:
    figure = section_figure(np.empty((0, 2)), title="empty")
    assert legend_of(figure) == ["0 points"]
    assert png(figure).startswith(b"\x89PNG")


def test_a_figure_gives_the_same_bytes_twice() -> None:
    assert png(full_section_figure()) == png(full_section_figure())


def test_deviation_is_blue_below_white_at_zero_red_above_and_grey_where_unknown() -> None:
    values = np.array([-1.0, -0.1, 0.0, 0.1, 1.0, np.nan, 0.1, np.inf])
    synthetic = np.array([False] * 6 + [True, False])
    colours = deviation_colours(values, 0.1, synthetic=synthetic).astype(int)
    assert np.array_equal(colours[0], colours[1])  # beyond the limit the ends stay
    assert np.array_equal(colours[3], colours[4])
    assert colours[1, 2] > colours[1, 0] + 80
    assert colours[3, 0] > colours[3, 2] + 80
    assert colours[2].min() >= 240
    assert np.all(colours[[5, 6, 7]] == UNDEFINED)


def test_deviation_colours_grow_darker_with_the_deviation_on_both_sides() -> None:
    steps = np.linspace(0, 1, 50)
    for side in (-1, 1):
        brightness = deviation_colours(side * steps, 1.0) @ np.array([0.2126, 0.7152, 0.0722])
        assert np.all(np.diff(brightness) <= 0.5)
        assert brightness[0] > brightness[-1] + 120


def test_a_deviation_limit_must_be_positive() -> None:
    with pytest.raises(ValueError, match="positive"):
        deviation_colours(np.zeros(3), 0.0)


def test_the_colour_bar_is_in_mm_and_spans_the_limit() -> None:
    figure = deviation_figure(np.full((30, 40, 3), 200, np.uint8), limit_mm=0.25, title="map")
    bar = figure.axes[0]
    assert "[mm]" in bar.get_ylabel()
    assert bar.get_ylim() == (-0.25, 0.25)
    assert legend_of(figure) == ["no measured point"]


def test_a_histogram_loses_no_value_and_counts_what_is_within_tolerance() -> None:
    values = np.concatenate([np.random.default_rng(1).normal(0, 0.05, 2000), [5.0, np.nan]])
    figure = histogram_figure(values, tolerance_mm=0.1)
    axes = figure.axes[0]
    assert sum(bar.get_height() for bar in axes.patches) == 2001
    share = np.mean(np.abs(values[:-1]) <= 0.1)
    assert axes.get_title(loc="right") == f"N = 2,001; {share:.1%} within ± 0.1 mm"
    assert "[mm]" in axes.get_xlabel()


def test_a_histogram_takes_bins_that_were_counted_elsewhere() -> None:
    figure = histogram_figure(binned=(np.array([-1.0, 0, 1, 2]), np.array([4, 5, 6])))
    assert [bar.get_height() for bar in figure.axes[0].patches] == [4, 5, 6]
    with pytest.raises(ValueError, match="either"):
        histogram_figure()


def test_a_histogram_of_nothing_says_so() -> None:
    figure = histogram_figure(np.array([np.nan]), tolerance_mm=0.1)
    assert figure.axes[0].get_title(loc="right") == "N = 0"


def test_a_cloud_shows_set_aside_points_in_orange_and_counts_both() -> None:
    rng = np.random.default_rng(2)
    cloud, aside = rng.normal(0, 1, (1500, 3)), np.array([[9.0, -9.0, 9.0]] * 12)
    figure = cloud_figure(cloud, aside, title="Cloud", size_px=(300, 200))
    assert legend_of(figure) == ["1,500 points", "12 set aside or left out"]
    assert any(text.get_text().endswith(" mm") for text in figure.texts)
    picture = figure.images[0].get_array().astype(int)
    assert np.count_nonzero(picture[..., 0] > picture[..., 2] + 80) > 3
    assert np.count_nonzero(picture[..., 2] > picture[..., 0] + 40) > 200
    assert legend_of(cloud_figure(np.empty((0, 3)), title="none", size_px=(60, 40))) == ["0 points"]


def test_sections_are_drawn_in_space_and_counted() -> None:
    rings = [np.column_stack([CIRCLE, np.full(60, z)]) for z in (0.0, 5.0, 10.0)]
    figure = sections_figure(rings, title="Sections", left_out_mm=rings[0] * 0.2)
    assert legend_of(figure) == ["3 sections", "60 points left out"]
    assert legend_of(sections_figure([], title="none", size_px=(60, 40))) == ["0 sections"]


def test_a_picture_keeps_its_pixels_in_its_figure() -> None:
    image = np.zeros((200, 300, 3), np.uint8)
    image[:, 150:] = (255, 0, 0)
    page = decode_png(png(picture_figure(image, title="Half red")))
    middle = page[page.shape[0] // 2]
    assert tuple(middle[page.shape[1] // 4]) == (0, 0, 0)
    assert tuple(middle[3 * page.shape[1] // 4]) == (255, 0, 0)


def test_beads_grow_as_clouds_thin_out() -> None:
    radii = [bead_radius_px(count, (1100, 760)) for count in (0, 5_000, 50_000, 5_000_000)]
    assert radii == sorted(radii, reverse=True)
    assert 0.5 < radii[-1] < radii[0] < 5
