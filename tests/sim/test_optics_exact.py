from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim import Flaws, Mounting, OpticalBench, OpticsSettings, Part, Reason, SeedKey, Sensor
from sim.hierarchy import arrange
from sim.parts import badly_acquired, blade, cone, cylinder, vase
from sim.sensor import Hand, Turning
from sim.shadows import hide
from sim.sheet import Slicer
from tests.sim.optics_cases import naive_hits, shifted, turned

SENSOR = Sensor(points=45, near_mm=190.0, far_mm=250.0, width_mm=96.0)
FLAWS = Flaws(steepest_incidence_rad=math.radians(65.0), faintest=0.2)
MOUNTING = Mounting(
    side_mm=1.3, azimuth_rad=0.4, turning=Turning.CLOCKWISE, hand=Hand.LEFT, height_mm=0.7
)


def soup(reach_mm: float, faces: int = 400) -> Part:
    """Loose triangles anywhere: open, crossing each other, many contours, all shades."""
    rng = np.random.default_rng(5)
    middle_mm = rng.uniform(-reach_mm, reach_mm, (faces, 1, 3)) + np.array([0, 0, reach_mm])
    corners_mm = middle_mm + rng.normal(0.0, reach_mm / 8, (faces, 3, 3))
    numbers = np.arange(3 * faces).reshape(-1, 3)
    shades = rng.uniform(0.0, 1.0, faces).astype(np.float32)
    return Part("soup", corners_mm.reshape(-1, 3), numbers, reflectance=shades)


def bumps(seed: int = 3) -> Part:
    """A closed ball of random radii: overhangs on every side, several hills along a beam."""
    rng = np.random.default_rng(seed)
    ball = vase(30.0, 60.0, around=40, levels=21)
    grown = rng.uniform(0.6, 1.4, (len(ball.vertices_mm), 1)) ** [1.0, 1.0, 0.0]
    wobble_mm = rng.uniform(-3.0, 3.0, (len(ball.vertices_mm), 1)) * [0.0, 0.0, 1.0]
    return Part("bumps", ball.vertices_mm * grown + wobble_mm, ball.faces)


CASES = {
    "cylinder": (lambda: cylinder(around=96, levels=5), (3.1, 40.2)),
    "cone": (lambda: cone(around=96, levels=7), (3.1, 41.7)),
    "vase": (lambda: vase(around=90, levels=20), (12.2, 37.9, 81.3)),
    "blade": (lambda: blade(levels=19), (11.0, 21.3, 60.1)),
    "bumps": (bumps, (9.3, 24.1, 44.9)),
    "soup": (lambda: soup(45.0), (20.3, 44.4, 70.7)),
}


def beams_at(table_rad, stage_mm, mounting: Mounting, sensor: Sensor):
    """Emitter (3,), camera (3,) and directions (n, 3) around a standing part."""
    turn_rad = mounting.azimuth_rad - mounting.turning.value * table_rad
    height_mm = mounting.height_mm + mounting.lifting.value * stage_mm
    emitter = np.array([*turned(mounting.standoff_mm, -mounting.side_mm, turn_rad), height_mm])
    slopes = mounting.hand.value * np.linspace(-sensor.steepest, sensor.steepest, sensor.points)
    x, y = turned(-1.0, slopes, turn_rad)
    return emitter, emitter + np.array([0, 0, sensor.rise_mm]), np.column_stack([x, y, 0.0 * x])


def naive_twin(part: Part, settings: OpticsSettings, table_rad: float, stage_mm: float):
    """Both rays of every beam against every face: (z, |cosine|, brightness), reasons, each (n,)."""
    sensor, flaws = settings.sensor, settings.flaws
    corners = part.vertices_mm[part.faces]
    emitter, camera, directions = beams_at(table_rad, stage_mm, settings.mounting, sensor)
    amounts, reasons = [], []
    for direction in directions:
        ways = naive_hits(corners, emitter, direction)
        face = ways.argmin()
        normal = np.cross(corners[face, 1] - corners[face, 0], corners[face, 2] - corners[face, 0])
        cosine = abs(normal @ direction) / np.linalg.norm(normal) / np.linalg.norm(direction)
        start = emitter + direction * (min(ways[face], 1e9) - 1e-5 * part.size_mm)
        if not np.isfinite(ways[face]):
            reason = Reason.NO_HIT
        elif not sensor.near_mm <= ways[face] <= sensor.far_mm:
            reason = Reason.OUT_OF_RANGE
        elif cosine < math.cos(flaws.steepest_incidence_rad):
            reason = Reason.GRAZING
        elif cosine * part.reflectance[face] < flaws.faintest:
            reason = Reason.DARK
        elif (naive_hits(corners, start, camera - start) < 1.0).any():
            reason = Reason.OCCLUDED
        else:
            reason = Reason.MEASURED
        amounts.append((ways[face], cosine, cosine * part.reflectance[face]))
        reasons.append(reason)
    return np.array(amounts).T, np.array(reasons)


def compare(part: Part, settings: OpticsSettings, angles_rad, stage_mm: float) -> list[int]:
    """Check one ring against the twin; returns the reasons that came up."""
    bench = OpticalBench(part, settings)
    mounting = settings.mounting
    height_mm = mounting.height_mm + mounting.lifting.value * stage_mm
    turns_rad = mounting.azimuth_rad - mounting.turning.value * np.asarray(angles_rad)
    light = bench._lit(bench._frames(turns_rad), height_mm)
    keys = [SeedKey(0, number) for number in range(len(angles_rad))]
    profiles = bench.profiles(angles_rad, stage_mm, keys)
    found: list[int] = []
    for row, angle_rad in enumerate(angles_rad):
        (z_mm, cosines, bright), reasons = naive_twin(part, settings, angle_rad, stage_mm)
        met = reasons != Reason.NO_HIT
        clear = met & (cosines > 1e-3)  # edge-on, the meeting point itself is not well defined
        assert profiles[row].reasons.tolist() == reasons.tolist()
        assert np.abs(light.z_mm[row] - z_mm)[clear].max(initial=0.0) < 1e-9
        assert np.abs(light.brightness[row] - bright)[met].max(initial=0.0) < 1e-9
        lean = cosines * np.hypot(1.0, bench._slopes)
        assert np.abs(light.lean[row] - lean)[met].max(initial=0.0) < 1e-9
        found += reasons.tolist()
    return found


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("triangulation_deg", [25.0, -35.0])
def test_depth_incidence_and_reason_are_those_of_brute_force(name, triangulation_deg):
    make, stages_mm = CASES[name]
    part = shifted(make(), 2.1, -1.7)
    sensor = replace(SENSOR, triangulation_rad=math.radians(triangulation_deg))
    settings = OpticsSettings(mounting=MOUNTING, sensor=sensor, flaws=FLAWS)
    found = [
        reason
        for stage_mm in stages_mm
        for reason in compare(part, settings, (0.37, 2.9), stage_mm)
    ]
    assert found.count(Reason.MEASURED) > 20
    assert len(set(found)) > 2
    if name in ("bumps", "soup"):
        assert found.count(Reason.OCCLUDED) > 10


def test_black_patches_of_a_hundred_thousand_faces_are_those_of_brute_force():
    settings = OpticsSettings(sensor=replace(SENSOR, points=15, near_mm=170.0), flaws=FLAWS)
    found = compare(shifted(badly_acquired(), 0.3, 0.2), settings, (0.5,), 51.3)
    assert {Reason.MEASURED, Reason.DARK} <= set(found)


@pytest.mark.parametrize("triangulation_deg", [25.0, -60.0])
def test_an_emitter_in_the_midst_of_the_part_sees_only_what_is_before_it(triangulation_deg):
    triangulation_rad = math.radians(triangulation_deg)
    sensor = Sensor(
        points=121, near_mm=1.0, far_mm=80.0, width_mm=70.0, triangulation_rad=triangulation_rad
    )
    settings = OpticsSettings(mounting=Mounting(standoff_mm=9.0), sensor=sensor, flaws=FLAWS)
    found = compare(soup(40.0, 900), settings, (0.4, 1.9, 3.3, 5.2), 40.1)
    assert {Reason.MEASURED, Reason.OCCLUDED, Reason.NO_HIT, Reason.GRAZING} <= set(found)


def test_what_hangs_straight_over_the_emitter_hides_no_beam_that_was_not_lit():
    awning_mm = np.array([[0.0, -30.0, 50.0], [0.0, 30.0, 50.0], [290.0, 0.0, 50.0]])
    peg = cylinder(8.0, 20.0, around=64, levels=2)
    part = Part(
        "awning",
        np.concatenate([peg.vertices_mm, awning_mm]),
        np.concatenate([peg.faces, np.arange(3)[None] + len(peg.vertices_mm)]),
    )
    found = compare(part, OpticsSettings(sensor=SENSOR, flaws=FLAWS), (0.01,), 10.3)
    assert {Reason.NO_HIT, Reason.OCCLUDED} <= set(found)


@pytest.mark.parametrize("roll", [0, 1, 2])  # the seam as the first, second and third edge of both
def test_the_seam_of_two_faces_hides_what_the_faces_hide(roll):
    peg = cylinder(8.0, 20.0, around=64, levels=2)
    low, high, left, right = np.arange(4) + len(peg.vertices_mm)
    fence_mm = np.array([[60.0, 0, 10.5], [60.0, 0, 60.0], [60.0, 5.0, 30.0], [60.0, -5.0, 30.0]])
    fence = np.roll([[low, high, left], [high, low, right]], roll, axis=1)
    vertices_mm = np.concatenate([peg.vertices_mm, fence_mm])
    part = Part("fence", vertices_mm, np.concatenate([peg.faces, fence]))
    for points in (1279, 1281, 1283):  # the middle beam looks along the seam, straight at the part
        bench = OpticalBench(part, OpticsSettings(sensor=Sensor(points=points)))
        profile = bench.profile(0.0, 10.0, SeedKey(0, 0))
        middle = points // 2
        assert set(profile.reasons[middle - 10 : middle + 11]) == {Reason.OCCLUDED}


@pytest.mark.parametrize("rise_mm", [70.0, -50.0])
@pytest.mark.parametrize("side_mm", [-30.0, 0.0, 30.0])
def test_the_boxes_spare_work_and_change_no_answer(rise_mm, side_mm):
    part, height_mm = vase(around=90, levels=40), 44.1
    tree = arrange(part)
    boundless = tree.boxes_mm + np.array([0.0, 0.0, 1e6, 1e6, -1e6, 1e6])
    boundless.flags.writeable = False  # as the tree is: one kernel serves both
    slopes = np.linspace(-0.7, 0.7, 2001)
    turns_rad = np.arange(6.0)
    cosine, sine = np.cos(turns_rad), np.sin(turns_rad)
    ahead = np.stack([-cosine, -sine, np.full(6, 90.0)], axis=1)
    across = np.stack([-sine, cosine, np.full(6, side_mm)], axis=1)
    frames = np.stack([ahead, across], axis=1)
    start_mm = np.random.default_rng(1).uniform(30.0, 150.0, (6, 2001))
    answers = []
    for boxes_mm in (tree.boxes_mm, boundless):
        reasons = np.zeros((6, 2001), np.uint8)
        reasons[:, ::7] = Reason.GRAZING
        hide((boxes_mm, tree.corners_mm), frames, slopes, (height_mm, rise_mm), start_mm, reasons)
        answers.append(reasons)
    assert np.array_equal(*answers)
    assert np.all(answers[0][:, ::7] == Reason.GRAZING)
    assert 0.05 < (answers[0] == Reason.OCCLUDED).mean() < 0.8


def test_first_hits_and_shadows_of_a_whole_ring_are_those_of_embree():
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    construction = pytest.importorskip("embreex.mesh_construction")
    part, sensor = blade(), Sensor(width_mm=60.0, triangulation_rad=math.radians(-25.0))
    settings = OpticsSettings(mounting=MOUNTING, sensor=sensor)
    scene = rtcore_scene.EmbreeScene()
    vertices = part.vertices_mm.astype(np.float32)
    construction.TriangleMesh(scene=scene, vertices=vertices, indices=np.array(part.faces))
    bench = OpticalBench(part, settings)
    agreed = asked = hidden = 0
    for number in range(12):
        angle_rad, stage_mm = 0.11 + 0.5 * number, 20.45 + 1.7 * number
        reasons = bench.profile(angle_rad, stage_mm, SeedKey(0, number)).reasons
        emitter, camera, directions = beams_at(angle_rad, stage_mm, MOUNTING, settings.sensor)
        light = bench._lit(bench._frames(np.array([0.4 + angle_rad])), emitter[2])
        origins = np.broadcast_to(emitter, directions.shape).astype(np.float32)
        far_mm = scene.run(origins, directions.astype(np.float32), query="DISTANCE")
        met = reasons != Reason.NO_HIT
        asked += met.size
        agreed += int(((far_mm < 1e9) == met).sum())
        assert np.abs(light.z_mm[0] - far_mm)[met & (far_mm < 1e9)].max() < 0.01
        lit = reasons % Reason.OCCLUDED == Reason.MEASURED
        start = emitter + directions[lit] * (light.z_mm[0][lit] - bench._clearance_mm)[:, None]
        rays = (start.astype(np.float32), (camera - start).astype(np.float32))
        blocked = scene.run(*rays, query="OCCLUDED") >= 0
        asked += len(blocked)
        agreed += int((blocked == (reasons[lit] == Reason.OCCLUDED)).sum())
        hidden += int(blocked.sum())
    assert asked > 15_000
    assert hidden > 100
    assert agreed / asked > 0.9995  # the rest are edges, where float32 errs


def test_neighbouring_segments_end_in_one_point_to_the_last_bit():
    for part, height_mm in ((vase(), 37.9), (blade(), 20.0), (bumps(), 20.0), (cone(), 5.0)):
        ends_mm = Slicer(part).at(height_mm).ends_mm.reshape(-1, 2)
        _, times = np.unique(ends_mm, axis=0, return_counts=True)
        assert len(ends_mm) > 60
        assert np.all(times % 2 == 0)


@pytest.mark.parametrize("faces", [1, 2, 7, 8, 9, 100, 1025])
def test_every_face_stands_in_a_leaf_and_in_every_box_above_it(faces):
    part = soup(45.0, faces)
    tree = arrange(part)
    leaves = len(tree.corners_mm)
    assert len(tree.boxes_mm) == 2 * leaves - 1
    kept = {corners.tobytes() for corners in tree.corners_mm.reshape(-1, 9)}
    assert kept == {corners.tobytes() for corners in part.vertices_mm[part.faces].reshape(-1, 9)}
    for leaf, corners_mm in enumerate(tree.corners_mm):
        node = leaves - 1 + leaf
        x, y, z = corners_mm.reshape(-1, 3).T
        while node >= 0:
            box = tree.boxes_mm[node]
            assert np.abs(x - box[0]).max() <= box[2]
            assert np.abs(y - box[1]).max() <= box[3]
            assert box[4] <= z.min() <= z.max() <= box[5]
            node = (node - 1) // 2 if node else -1
