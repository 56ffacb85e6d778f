"""Which contours follow each other, judged by solids whose shape is known."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.path import Path as Polygon

from loftscan.inputs import Unit, open_input
from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.skinning.agreeing import cheapest_way
from reconstruction.skinning.branch import Branch, Ending
from reconstruction.skinning.branching import Branching, find_branches, is_ring_ended
from reconstruction.skinning.doubts import crossings
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.skinning.loops import AROUND, Loops, loops_of
from reconstruction.skinning.outlines import Outline
from reconstruction.skinning.overlaps import measure_overlaps
from reconstruction.skinning.stack import stack_up
from reconstruction.slicing import cut_cloud
from reconstruction.survey import Axis
from tests.reconstruction.part_cases import star
from tests.reconstruction.skinning_cases import (
    CUP,
    MUG,
    ball,
    box,
    cut,
    outline,
    pillar,
    ring,
    rod,
    torus,
    turned,
    union,
    without,
)

HEIGHTS = np.arange(-25.0, 25.1, 1.0) + 0.03


def rings(*radii: float, index: int = 0, height: float = 0.0) -> list[Outline]:
    """Concentric circles, every other one a hole."""
    return [
        outline(ring(radius), height, index=index, hole=k % 2 == 1)
        for k, radius in enumerate(radii)
    ]


def tube(count: int = 9, radius: float = 10.0) -> tuple[list[list[Outline]], FloatArray]:
    """Equal circles, each a little aside: what follows is exact repetition otherwise."""
    heights = np.arange(float(count))
    shapes = [ring(radius, (0.01 * math.sin(7.0 * k), 0.0)) for k in range(count)]
    slices = [
        [outline(each, h, index=k)] for k, (each, h) in enumerate(zip(shapes, heights, strict=True))
    ]
    return slices, heights


def endings(branch: Branch) -> tuple[Ending, ...]:
    return tuple(each.ending for each in branch.ends or ())


def shape_of(found: Branching) -> list[tuple[bool, bool, tuple[str, ...]]]:
    """Hole, cyclic, and the endings of every branch, in a fixed order."""
    return sorted(
        (each.hole, each.cyclic, tuple(ending.value for ending in endings(each)))
        for each in found.branches
    )


# -- one to one, splits and merges ---------------------------------------------------------------


def test_a_tube_is_one_branch_with_unseen_ends() -> None:
    (branch,) = find_branches(*tube()).branches
    assert [each.slice_index for each in branch.outlines] == list(range(9))
    assert endings(branch) == (Ending.UNSEEN, Ending.UNSEEN)
    assert branch.ends is not None
    assert [each.height_mm for each in branch.ends] == [0.0, 8.0]


def test_two_legs_and_a_body_meet_in_a_joint_midway() -> None:
    legs = union(rod((-8, 0, -20), (-5, 0, 5), 5), rod((8, 0, -20), (5, 0, 5), 5))
    found = find_branches(cut(union(legs, pillar(13, 3, 15)), HEIGHTS), HEIGHTS)
    (joint,) = found.joints
    assert joint.height_mm == pytest.approx(2.53)  # between 2.03 and 3.03
    assert (len(joint.below), len(joint.above)) == (2, 1)
    for number in (*joint.below, *joint.above):
        (at,) = [each for each in found.branches[number].ends or () if each.joint == 0]
        assert (at.ending, at.height_mm) == (Ending.JOINED, joint.height_mm)


def test_a_joint_lies_midway_where_slices_are_unequally_far_apart() -> None:
    heights = [0.0, 1.0, 4.0, 4.5]
    slices = [
        *[
            [outline(ring(4, (x, 0.1 * k)), h, index=k) for x in (-5, 5)]
            for k, h in enumerate(heights[:2])
        ],
        *[[outline(ring(12, (0, 0.1 * k)), h, index=k + 2)] for k, h in enumerate(heights[2:])],
    ]
    (joint,) = find_branches(slices, heights).joints
    assert joint.height_mm == 2.5


def test_bodies_apart_are_branches_apart() -> None:
    found = find_branches(cut(union(ball(8, (12, 0, 3)), ball(8, (-12, 0, -3))), HEIGHTS), HEIGHTS)
    assert shape_of(found) == [(False, False, ("closed", "closed"))] * 2
    assert not found.joints


def test_a_part_that_drifts_by_its_width_is_still_one() -> None:
    heights = np.arange(8.0)
    slices = [[outline(ring(2, (3.9 * k, 0)), h, index=k)] for k, h in enumerate(heights)]
    (branch,) = find_branches(slices, heights).branches
    assert len(branch.outlines) == 8


def test_rods_in_a_row_that_lean_over_each_other_are_told_apart_by_their_drift() -> None:
    heights = np.arange(10.0)
    slices = [
        [outline(ring(2, (9 * n + 3.2 * k, 0)), h, index=k) for n in range(4)]
        for k, h in enumerate(heights)
    ]
    found = find_branches(slices, heights)
    assert len(found.branches) == 4
    assert all(len(each.outlines) == 10 for each in found.branches)


def test_a_leaning_leg_overlaps_its_neighbours_next_place_and_does_not_join_it() -> None:
    heights = np.arange(8.0)
    slices = [
        [outline(ring(4, (9.2 * n + 2.2 * k, 0)), h, index=k) for n in range(2)]
        for k, h in enumerate(heights)
    ]  # 35 % of each lies over the other's place a slice below
    found = find_branches(slices, heights)
    assert not found.joints
    assert len(found.branches) == 2


# -- holes ---------------------------------------------------------------------------------------


def test_a_ring_lying_flat_is_one_cyclic_branch() -> None:
    (branch,) = find_branches(cut(torus(15, 5), HEIGHTS), HEIGHTS).branches
    assert branch.cyclic
    assert branch.ends is None
    assert not branch.hole
    up = [each.height_mm for each in branch.outlines if not each.hole]
    down = [each.height_mm for each in branch.outlines if each.hole]
    assert [each.hole for each in branch.outlines] == [False] * len(up) + [True] * len(down)
    assert up == sorted(down) == down[::-1]


def test_a_cup_is_one_branch_over_its_rim_down_to_its_bottom() -> None:
    (branch,) = find_branches(cut(CUP, HEIGHTS), HEIGHTS).branches
    assert endings(branch) == (Ending.CLOSED, Ending.CLOSED)
    assert not branch.hole
    assert not branch.outlines[0].hole
    assert branch.outlines[-1].hole
    assert branch.outlines[-1].height_mm == pytest.approx(-14.97)  # the bottom is at -15


def test_a_cavity_is_a_hole_closed_at_both_ends() -> None:
    found = find_branches(cut(without(ball(20), ball(12)), HEIGHTS), HEIGHTS)
    assert shape_of(found) == [
        (False, False, ("closed", "closed")),
        (True, False, ("closed", "closed")),
    ]
    assert not found.branches[0].hole  # from the outside in


def test_a_thin_wall_that_slopes_follows_itself_though_it_never_overlaps() -> None:
    steep = turned(lambda r, z: np.maximum(np.abs(r - (15 + 1.2 * z)) - 0.4, np.abs(z) - 10))
    slices = cut(steep, HEIGHTS, cells=600)
    (branch,) = find_branches(slices, HEIGHTS).branches
    assert branch.cyclic  # both of its rims


def test_a_hole_that_opens_over_void_comes_out_of_the_outer_contour() -> None:
    """A handle lying in the cutting plane: body, then body and handle with a hole between."""
    handle = without(torus(10, 2, "z", (0, 15, 0)), pillar(13, -30, 30))
    found = find_branches(cut(union(pillar(13, -12, 12), handle), HEIGHTS), HEIGHTS)
    holes = [each for each in found.branches if each.hole]
    assert [endings(each) for each in holes] == [(Ending.JOINED, Ending.JOINED)]
    assert [(len(each.below), len(each.above)) for each in found.joints] == [(1, 2), (2, 1)]


def test_a_hole_that_opens_over_material_begins_there() -> None:
    blind = without(box((-20, -15, -20), (20, 15, 20)), pillar(5, -3.5, 30))
    slices = cut(blind, HEIGHTS)[:40]  # the scan ends within the hole
    found = find_branches(slices, HEIGHTS[:40])
    assert shape_of(found) == [
        (False, False, ("closed", "unseen")),
        (True, False, ("closed", "unseen")),
    ]


def test_a_groove_round_a_core_goes_down_and_up_again() -> None:
    bundt = turned(
        lambda r, z: np.maximum(
            np.maximum(r - 20, np.abs(z) - 10), -np.maximum(np.abs(r - 10) - 4, -5 - z)
        )
    )
    (branch,) = find_branches(cut(bundt, HEIGHTS), HEIGHTS).branches
    assert endings(branch) == (Ending.CLOSED, Ending.CLOSED)
    folds = [a.hole != b.hole for a, b in itertools.pairwise(branch.outlines)]
    assert sum(folds) == 2  # over the rim, and along the bottom of the groove


def test_pipes_in_pipes_keep_to_themselves() -> None:
    pipes = union(*(without(pillar(r, -40, 40), pillar(r - 2, -41, 41)) for r in (20, 14, 8)))
    found = find_branches(cut(pipes, HEIGHTS), HEIGHTS)
    assert [each.hole for each in found.branches] == [False, True] * 3  # from the outside in
    assert not found.joints


def test_a_ring_that_begins_within_a_pipe_is_no_part_of_the_pipe() -> None:
    pipe = without(pillar(20, -40, 40), pillar(18, -41, 41))
    inner = without(pillar(14, -10.2, 10.2), pillar(12, -41, 41))
    found = find_branches(cut(union(pipe, inner), HEIGHTS), HEIGHTS)
    assert [each.cyclic for each in found.branches] == [False, False, True]


def test_the_inside_of_a_cup_is_parted_where_its_outside_meets_the_handle() -> None:
    found = find_branches(cut(MUG, HEIGHTS), HEIGHTS)
    (rim,) = [each for each in found.branches if is_ring_ended(each)]
    (inside,) = [each for each in found.branches if each.hole]
    upper = max(found.joints, key=lambda each: each.height_mm)
    assert {each.height_mm for each in rim.ends or ()} == {upper.height_mm}
    assert inside.ends is not None
    assert inside.ends[1].height_mm == upper.height_mm
    assert found.branches.index(inside) in upper.below
    assert upper.above == (found.branches.index(rim),)


# -- slices that are doubtful --------------------------------------------------------------------


def test_an_empty_slice_between_like_ones_is_a_missed_one() -> None:
    slices, heights = tube()
    slices[4] = []
    found = find_branches(slices, heights)
    assert len(found.branches) == 1
    assert found.suspects == (4,)
    assert found.warnings == (
        "slice 4: no contour, though those below and above go on in each other; bridged",
    )


def test_an_empty_slice_beyond_the_last_one_closes_the_branch() -> None:
    slices, heights = tube()
    slices[0] = slices[8] = []
    (branch,) = find_branches(slices, heights).branches
    assert endings(branch) == (Ending.CLOSED, Ending.CLOSED)
    assert branch.ends is not None
    assert [each.height_mm for each in branch.ends] == [0.0, 8.0]


def test_slices_with_points_and_no_contour_do_not_end_a_part() -> None:
    slices, heights = tube(20)
    for k in range(6, 13):
        slices[k] = []
    assert len(find_branches(slices, heights).branches) == 2  # nothing is there
    open_runs = [6 <= k < 13 for k in range(20)]
    found = find_branches(slices, heights, unresolved=open_runs)
    assert len(found.branches) == 1
    assert found.suspects == tuple(range(6, 13))


def test_a_ring_that_one_slice_misses_altogether_is_bridged() -> None:
    """Loop and hole fold into each other below and above: no change of Euler number tells."""
    heights = np.arange(9.0)
    slices = [rings(20 + 0.01 * k, 15, index=k, height=h) for k, h in enumerate(heights)]
    slices[4] = []
    assert len(find_branches(slices, heights).branches) == 2  # outside and inside


def test_a_hole_that_has_lost_its_outline_in_one_slice_is_not_taken_for_one() -> None:
    heights = np.arange(9.0)
    slices = [rings(20 + 0.01 * k, 15, index=k, height=h) for k, h in enumerate(heights)]
    slices[4] = [outline(ring(15.02), 4.0, index=4)]
    found = find_branches(slices, heights)
    assert [len(each.outlines) for each in found.branches] == [8, 8]
    assert found.suspects == (4,)


def test_two_balls_one_above_the_other_with_a_slice_between_stay_two() -> None:
    solid = union(ball(10, (0, 0, -10.9)), ball(10, (0, 0, 10.9)))
    slices = cut(solid, HEIGHTS)
    assert [len(each) for each in slices[23:28]] == [1, 1, 0, 1, 1]
    assert len(find_branches(slices, HEIGHTS).branches) == 2


def test_contours_that_run_together_in_one_slice_are_kept_apart() -> None:
    heights = np.arange(9.0)
    slices = [
        [outline(ring(4, (x, 0.01 * k)), h, index=k) for x in (-5, 5)]
        for k, h in enumerate(heights)
    ]
    slices[4] = [outline(ring(10, (0, 0)), 4.0, index=4)]
    found = find_branches(slices, heights)
    assert shape_of(found) == [(False, False, ("unseen", "unseen"))] * 2
    assert found.suspects == (4,)
    assert len(found.left_out) == 1


def test_a_bridge_that_two_slices_show_is_believed() -> None:
    heights = np.arange(9.0)
    slices = [
        [outline(ring(4, (x, 0.01 * k)), h, index=k) for x in (-5, 5)]
        for k, h in enumerate(heights)
    ]
    for k in (4, 5):
        slices[k] = [outline(ring(10, (0.01 * k, 0)), float(k), index=k)]
    found = find_branches(slices, heights)
    assert len(found.joints) == 2
    assert len(found.branches) == 5


def test_one_contour_of_two_that_a_slice_misses_is_bridged_and_the_other_used() -> None:
    heights = np.arange(9.0)
    slices = [
        [outline(ring(4, (x, 0.01 * k)), h, index=k) for x in (-5, 5)]
        for k, h in enumerate(heights)
    ]
    del slices[4][1]
    found = find_branches(slices, heights)
    assert sorted(len(each.outlines) for each in found.branches) == [8, 9]
    assert found.suspects == (4,)


def test_a_slice_far_off_is_named_with_its_distance_and_left_out() -> None:
    slices, heights = tube()
    slices[5] = [outline(ring(10, (7.0, 0)), 5.0, index=5)]
    found = find_branches(slices, heights)
    assert [each.slice_index for each in found.branches[0].outlines] == [0, 1, 2, 3, 4, 6, 7, 8]
    (warning,) = found.warnings
    assert warning.startswith("slice 5: a contour 20 mm across lies 7")
    assert "left out" in warning


def test_a_slice_a_little_off_is_named_and_used() -> None:
    slices, heights = tube()
    slices[5] = [outline(ring(10, (1.0, 0)), 5.0, index=5)]
    found = find_branches(slices, heights)
    assert len(found.branches[0].outlines) == 9
    assert found.suspects == (5,)


def test_a_slice_that_lies_nowhere_near_the_others_is_left_out() -> None:
    slices, heights = tube()
    slices[5] = [outline(ring(10, (70.0, 0)), 5.0, index=5)]
    found = find_branches(slices, heights)
    assert len(found.branches) == 1
    assert found.suspects == (5,)
    assert found.left_out == (slices[5][0],)


def test_a_slice_turned_by_half_a_turn_changes_nothing() -> None:
    slices, heights = tube()
    shape = 10.0 * star(np.random.default_rng(2), 9)
    slices = [[outline(shape * (1 + 0.001 * k), k, index=k)] for k in range(9)]
    slices[4] = [outline(np.roll(shape, 4, axis=0) * 1.004, 4, index=4)]
    found = find_branches(slices, heights)
    assert len(found.branches) == 1
    assert not found.warnings


def test_steps_and_tapers_are_no_outliers() -> None:
    heights = np.arange(12.0)
    radii = [10, 10, 10, 6, 6, 6, 6, 5, 4, 3, 2, 1]
    slices = [
        [outline(ring(r, (0.001 * k, 0)), h, index=k)]
        for k, (r, h) in enumerate(zip(radii, heights, strict=True))
    ]
    assert not find_branches(slices, heights).warnings


def test_slices_recorded_twice_are_named() -> None:
    slices, heights = tube()
    again = slices[3][0]
    slices[4] = [outline(again.polygon_mm(120), 4.0, index=4)]
    slices[3] = [outline(again.polygon_mm(120), 3.0, index=3)]
    found = find_branches(slices, heights)
    assert found.suspects == (4,)
    assert "recorded twice" in found.warnings[0]
    assert len(found.branches[0].outlines) == 9


def test_two_slices_at_one_height_leave_one() -> None:
    slices, heights = tube()
    heights[4] = heights[3]
    slices[4] = [outline(ring(10, (0.02, 0)), 3.0, index=4)]
    found = find_branches(slices, heights)
    assert found.warnings == ("slice 4: lies at the height of slice 3; left out",)
    assert len(found.branches[0].outlines) == 8


def test_a_contour_that_crosses_itself_is_named_and_left_out() -> None:
    slices, heights = tube()
    angle = np.arange(120) * (math.tau / 120)
    eight = np.stack([10 * np.sin(angle), 9 * np.sin(2 * angle)], axis=1)
    slices[4] = [outline(eight, 4.0, index=4)]
    found = find_branches(slices, heights)
    assert found.suspects == (4,)
    assert any("crosses itself" in each for each in found.warnings)
    assert len(found.branches[0].outlines) == 8


def test_two_runs_taken_for_one_at_the_end_of_a_stack_are_told_by_their_scatter() -> None:
    """The lowest slices of a ring: its two contours lie so close that one curve runs through."""
    heights = np.arange(12.0)
    wall = [0.0, 0.0, *np.linspace(0.5, 3.0, 10)]
    slices = []
    for k, (half, h) in enumerate(zip(wall, heights, strict=True)):
        if half:
            slices.append(rings(20 + half, 20 - half, index=k, height=h))
        else:
            slices.append([outline(ring(20, (0.01 * k, 0)), h, index=k, sigma_mm=0.8)])
    found = find_branches(slices, heights)
    assert shape_of(found) == [
        (False, False, ("unseen", "unseen")),
        (True, False, ("unseen", "unseen")),
    ]
    assert found.suspects == (0, 1)


def test_a_hole_in_no_outline_is_left_out() -> None:
    slices, heights = tube()
    slices[4] = [*slices[4], outline(ring(2, (30, 0)), 4.0, index=4, hole=True)]
    found = find_branches(slices, heights)
    assert found.warnings == ("slice 4: a hole 4 mm across lies in no outline; left out",)


def test_one_slice_is_no_surface_and_the_error_names_it() -> None:
    slices, heights = tube()
    with pytest.raises(NotLoftable, match="only slice 3 has contours") as caught:
        find_branches([[], slices[3], []], heights[2:5])
    assert caught.value.indices == (3,)


def test_slices_of_different_places_are_no_surface() -> None:
    slices = [[outline(ring(2, (50.0 * k, 0)), k, index=k)] for k in range(3)]
    with pytest.raises(NotLoftable, match="no contour of 3 slices goes on"):
        find_branches(slices, np.arange(3.0))


def test_two_slices_are_a_surface() -> None:
    slices, heights = tube(2)
    (branch,) = find_branches(slices, heights).branches
    assert len(branch.outlines) == 2


@pytest.mark.parametrize(
    ("heights", "message"),
    [([0.0, 1.0], "3 expected"), ([0.0, 2.0, 1.0], "ascending"), ([0.0, 1.0, np.nan], "finite")],
)
def test_heights_that_cannot_be_are_refused(heights: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        find_branches(tube(3)[0], heights)


def test_planes_that_are_not_parallel_are_refused() -> None:
    slices, heights = tube(3)
    slices[2] = [outline(ring(10), 2.0, index=2, axes=np.eye(3)[[1, 2, 0]])]
    with pytest.raises(ValueError, match="slice 2: its plane is not parallel"):
        find_branches(slices, heights)


def test_empty_slices_are_named_by_the_indices_given() -> None:
    slices, heights = tube()
    slices[4] = []
    named = [8, 7, 6, 5, 40, 3, 2, 1, 0]  # recorded from the top down
    assert find_branches(slices, heights, indices=named).suspects == (40,)


# -- twins of the kernels ------------------------------------------------------------------------


def stack_of(*slices: list[Outline]) -> Loops:
    return loops_of(stack_up(slices, np.arange(float(len(slices))), None, None, []))


def naive_inside(polygon: FloatArray, grid: FloatArray) -> BoolArray:
    return Polygon(np.vstack([polygon, polygon[:1]])).contains_points(grid)


def test_overlaps_are_those_of_a_fine_raster() -> None:
    rng = np.random.default_rng(5)
    lower = rings(20, 15, 9, 5)
    upper = [
        outline(0.9 * star(rng, 11) + (3, 2), 1.0),
        outline(ring(3, (3, 2)), 1.0, hole=True),
        outline(ring(6, (-20, 12)), 1.0),
    ]
    loops = stack_of(lower, upper)
    found = measure_overlaps(loops, loops.at(0), loops.at(1))
    axis = np.linspace(-30, 30, 900)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    inside = np.stack([naive_inside(each, grid) for each in loops.corners_mm])
    own = inside.copy()
    for number, parent in enumerate(loops.parents):
        if parent != AROUND:
            own[parent] &= ~inside[number]
    for p, q in itertools.product(range(4), range(3)):
        a, b = p, 4 + q
        same = loops.holes[a] == loops.holes[b]
        both = inside[a] & inside[b]
        expected = (
            (own[a] & own[b]).sum() / min(own[a].sum(), own[b].sum()) if same else 0.0,
            (both & (own[a] == own[b])).sum() / min(inside[a].sum(), inside[b].sum())
            if same
            else 0.0,
            both.sum() / (inside[a] | inside[b]).sum() if same else 0.0,
        )
        measured = found.direct[p, q], found.agreement[p, q], found.likeness[p, q]
        # 24 rows across each loop; a row more or less at a corner of a star is 3 %.
        np.testing.assert_allclose(measured, expected, atol=0.03)
    outside = ~inside[4:].any(axis=0)
    for p in (1, 3):  # the holes below
        share = (own[p] & outside).sum() / own[p].sum()
        assert found.direct[p, -1] == pytest.approx(share, abs=0.03)


def test_nesting_is_that_of_points_in_polygons() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(-60, 60, (12, 2))
    shapes = [
        outline(ring(r, tuple(c)), 0.0) for r, c in zip(rng.uniform(1, 60, 12), places, strict=True)
    ]
    loops = stack_of(shapes)
    for number in range(12):
        around = [
            other
            for other in range(12)
            if loops.areas_mm2[other] > loops.areas_mm2[number]
            and 2 * naive_inside(loops.corners_mm[other], loops.corners_mm[number][::8]).sum() > 16
        ]
        assert loops.depths[number] == len(around)
        expected = min(around, key=lambda each: loops.areas_mm2[each], default=AROUND)
        assert loops.parents[number] == expected


def test_areas_and_centres_are_those_of_the_shapes() -> None:
    loops = stack_of([outline(ring(7.0, (100.0, -50.0), 400), 0.0)])
    assert loops.areas_mm2[0] == pytest.approx(math.pi * 49.0, rel=1e-3)  # a polygon of 128
    np.testing.assert_allclose(loops.centres_mm[0], [100.0, -50.0], atol=1e-9)
    assert loops.radii_mm[0] == pytest.approx(7.0, rel=1e-3)


def naive_crosses(one: FloatArray, other: FloatArray, *, same: bool) -> bool:
    def turn(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
        return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    n, m = len(one), len(other)
    for i, j in itertools.product(range(n), range(m)):
        if same and (i - j) % n in (0, 1, n - 1):
            continue
        a, b, c, d = one[i], one[(i + 1) % n], other[j], other[(j + 1) % m]
        if turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0:
            return True
    return False


def test_crossings_are_those_that_every_pair_of_edges_shows() -> None:
    rng = np.random.default_rng(11)
    shapes = []
    for _ in range(8):
        angle = np.arange(128) * (math.tau / 128)
        radius = 10 + 3 * rng.normal() * np.cos(3 * angle) + rng.uniform(0, 8) * np.cos(angle)
        turns = angle if rng.random() < 0.6 else 2 * angle
        shape = np.stack([radius * np.cos(angle), radius * np.sin(turns)], axis=1)
        shapes.append(shape + rng.uniform(-15, 15, 2))
    loops = stack_of([outline(each, 0.0) for each in shapes])
    found = crossings(loops)
    for one in range(8):
        corners = loops.corners_mm
        assert found[one, 0] == naive_crosses(corners[one], corners[one], same=True)
        others = [naive_crosses(corners[one], corners[k], same=False) for k in range(one)]
        assert found[one, 1] == any(others)
    assert found[:, 0].any()
    assert not found[:, 0].all()


class RandomPrices:
    def __init__(self, rng: np.random.Generator, count: int) -> None:
        self.steps = rng.uniform(0.0, 3.0, (count, count)).round(1)
        self.ends = rng.uniform(0.0, 6.0, count).round(1)

    def passing(self, lower: int, upper: int) -> float:
        return 0.5 * (upper - lower - 1) if upper - lower <= 4 else math.inf

    def going(self, lower: int, upper: int) -> float:
        return float(self.steps[lower, upper])

    def leaving_out(self, levels: range) -> float:
        return float(self.ends[list(levels)].sum()) if len(levels) <= 3 else math.inf

    def of(self, way: list[int], count: int) -> float:
        inner = sum(self.passing(a, b) + self.going(a, b) for a, b in itertools.pairwise(way))
        return inner + self.leaving_out(range(way[0])) + self.leaving_out(range(way[-1] + 1, count))


@pytest.mark.parametrize("seed", range(20))
def test_the_way_chosen_is_the_cheapest_of_all(seed: int) -> None:
    count = 7
    prices = RandomPrices(np.random.default_rng(seed), count)
    every = [
        list(way)
        for size in range(2, count + 1)
        for way in itertools.combinations(range(count), size)
    ]
    best = min(prices.of(each, count) for each in every)
    assert prices.of(cheapest_way(prices, count), count) == pytest.approx(best)


# -- real scans ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "unit", "axis"),
    [
        ("UHU.pcd", Unit.CM, Axis.Y),
        ("cup.pcd", Unit.CM, Axis.Y),
        ("bigCub.pts", Unit.CM, Axis.Y),
        ("fabscanpi_duck.ply", Unit.MM, Axis.Z),
    ],
)
def test_real_scans_are_followed_past_slices_without_a_contour(
    shared_data: Path, name: str, unit: Unit, axis: Axis
) -> None:
    with open_input(shared_data / "scans" / name, unit) as given:
        pieces = [draw_outlines(each) for each in cut_cloud(given.chunks, axis).slices()]
    heights = [each.height_mm for each in pieces]
    found = find_branches(
        [each.outlines for each in pieces],
        heights,
        indices=[each.index for each in pieces],
        unresolved=[each.unresolved for each in pieces],
    )
    longest = max(found.branches, key=lambda each: len(each.outlines))
    reached = longest.outlines[-1].height_mm - longest.outlines[0].height_mm
    assert reached > 0.9 * (heights[-1] - heights[0])
    assert not longest.hole
