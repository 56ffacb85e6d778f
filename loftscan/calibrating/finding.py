"""Which points are of which element: random triples and quadruples, then the joint solve's own.

Fischler and Bolles 1981 (doi:10.1145/358669.358692), largest first, on the focused cloud; a few mm
of smear are allowed for. After that a point belongs to the element that it lies nearest to, within
a distance that shrinks as the solve gets better. Spheres get their names by radius and spacing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import Kinematics
from loftscan.calibrating.artefact import Artefact, SphereOf
from loftscan.calibrating.errors import CalibrationRefused
from loftscan.calibrating.focusing import thinned
from loftscan.calibrating.model import Face, Seen, Spacing, placed_with
from loftscan.calibrating.shapes import Form, Shape, distances, frame_around

_POINTS = 3000
_TRIALS = 800
_SMEAR_MM = 2.0
_RADIUS_SHARE = 0.12  # of a known radius: a smeared sphere is thicker
_LEAST_POINTS = 30
_NEIGHBOURS_MM = 25.0
_SLAB_MM = 8.0
_FRUSTUM_SIDES = 4
_UNLIKE = 0.03  # spacings that differ by more are not these spheres'


def find_faces(
    seen: Seen, scan: int, kinematics: Kinematics, artefact: Artefact, rng: np.random.Generator
) -> tuple[Face, ...]:
    """Find every element of an artefact in one scan.

    Raises
    ------
    CalibrationRefused
        One is not there; names it and what to do.
    """
    few = thinned(seen.of(seen.scan == scan), _POINTS)
    placing = placed_with(kinematics, few)
    cloud = np.hstack([placing.part_mm, placing.beams()])
    faces: list[Face] = []
    radii = sorted(artefact.spheres.items(), key=lambda each: -(each[1].radius_mm or 0.0))
    for name, sphere in radii:
        own, cloud = _take(cloud, Form.SPHERE, sphere.radius_mm, rng, f"sphere {name}")
        faces.append(_sphere_face(name, scan, own, sphere))
    for name, cylinder in artefact.cylinders.items():
        own, cloud = _take(cloud, Form.CYLINDER, cylinder.radius_mm, rng, f"cylinder {name}")
        shape = Shape(Form.CYLINDER, np.eye(3), np.array([own[0], own[1], 0.0]))
        begin = np.array([0.0, 0.0, 0.0, 0.0, own[2]])
        known = (cylinder.radius_mm, cylinder.radius_sd_mm)
        faces.append(_face(name, scan, shape, begin, *known))
    for name, frustum in artefact.frustums.items():
        planes, cloud = _outward_planes(cloud, rng)
        faces.append(_frustum_face(name, scan, planes, frustum.faces()))
    for name in artefact.planes:
        own, cloud = _take(cloud, Form.PLANE, None, rng, f"plane {name}")
        shape = Shape(Form.PLANE, frame_around(own[:3]), np.zeros(3))
        faces.append(_face(name, scan, shape, np.array([0.0, 0.0, own[3]]), None, 0.0))
    return assigned(seen, faces, kinematics, _SMEAR_MM)


def assigned(
    seen: Seen, faces: Sequence[Face], kinematics: Kinematics, within_mm: float
) -> tuple[Face, ...]:
    """Give each point to the element of its scan that it lies nearest to, or to none.

    Raises
    ------
    CalibrationRefused
        An element has too few.
    """
    placing = placed_with(kinematics, seen)
    part_mm, beams = placing.part_mm, placing.beams()
    gaps = np.full((len(faces), len(seen)), np.inf)
    for number, face in enumerate(faces):
        here = np.flatnonzero(seen.scan == face.scan)
        gap, normal, _ = distances(face.shape, face.own, part_mm[here])
        lit = np.einsum("ij,ij->i", normal, beams[here]) < 0.0
        gaps[number, here] = np.where(lit, np.abs(gap), np.inf)
    nearest = gaps.argmin(axis=0)
    near = gaps[nearest, np.arange(len(seen))] <= within_mm
    found = []
    for number, face in enumerate(faces):
        rows = np.flatnonzero(near & (nearest == number))
        if len(rows) < _LEAST_POINTS:
            raise CalibrationRefused(
                f"calibration: {face.name}: {len(rows)} points within {within_mm:g} mm of it in"
                f" scan {face.scan + 1}; see that the sheet meets it, and that artefact.toml is it"
            )
        found.append(replace(face, rows=rows))
    return tuple(found)


def named(faces: Sequence[Face], artefact: Artefact) -> tuple[Face, ...]:
    """Exchange the names of spheres of one radius until their spacings fit.

    Raises
    ------
    CalibrationRefused
        No exchange fits; says by how much the best does not.
    """
    told = list(faces)
    for scan in sorted({each.scan for each in faces}):
        here = [i for i, each in enumerate(told)
                if each.scan == scan and each.shape.form is Form.SPHERE]  # fmt: skip
        best, misfit = _best_names([told[i] for i in here], artefact)
        if misfit > _UNLIKE:
            raise CalibrationRefused(
                f"calibration: the spacings of the spheres differ from artefact.toml by"
                f" {misfit:.1%} at best; correct it, or see that all spheres were scanned"
            )
        for i, name in zip(here, best, strict=True):
            sphere = artefact.spheres[name]
            told[i] = replace(
                told[i], name=name, radius=sphere.radius_mm, radius_sd_mm=sphere.radius_sd_mm
            )
    return tuple(told)


def spacings_of(artefact: Artefact, *, held_out: bool) -> tuple[Spacing, ...]:
    """The spacings that are solved with, or those that are checked."""
    return tuple(
        Spacing(name, each.one, each.other, each.distance_mm, each.sd_mm)
        for name, each in artefact.spacings.items()
        if each.held_out is held_out
    )


def _best_names(faces: Sequence[Face], artefact: Artefact) -> tuple[tuple[str, ...], float]:
    names = [each.name for each in faces]
    best, least = tuple(names), np.inf
    for tried in permutations(names):
        if any(
            _unlike(artefact.spheres[new], artefact.spheres[each.name])
            for new, each in zip(tried, faces, strict=True)
        ):
            continue
        middle = {name: each.own[:3] for name, each in zip(tried, faces, strict=True)}
        misfit = [
            abs(float(np.linalg.norm(middle[s.one] - middle[s.other])) / s.distance_mm - 1.0)
            for s in artefact.spacings.values()
            if s.one in middle and s.other in middle
        ]
        worst = max(misfit, default=0.0)
        if worst < least:
            best, least = tried, worst
    return best, least


def _unlike(one: SphereOf, other: SphereOf) -> bool:
    if one.radius_mm is None or other.radius_mm is None:
        return one.radius_mm is not other.radius_mm
    return abs(one.radius_mm - other.radius_mm) > _RADIUS_SHARE * one.radius_mm


def _sphere_face(name: str, scan: int, own: FloatArray, sphere: SphereOf) -> Face:
    shape = Shape(Form.SPHERE, np.eye(3), np.zeros(3))
    return _face(name, scan, shape, own, sphere.radius_mm, sphere.radius_sd_mm)


def _face(
    name: str, scan: int, shape: Shape, own: FloatArray, radius: float | None, sd_mm: float
) -> Face:
    if radius is not None:
        own = np.append(own[:-1], radius)
    return Face(name, scan, shape, own, np.empty(0, np.int64), radius, sd_mm)


def _take(
    cloud: FloatArray, form: Form, radius: float | None, rng: np.random.Generator, what: str
) -> tuple[FloatArray, FloatArray]:
    """The best element of a form, and what is left of the cloud without it."""
    best, count = np.empty(0), 0
    for _ in range(_TRIALS if len(cloud) >= _LEAST_POINTS else 0):
        made = _drawn(cloud, form, radius, rng)
        if made is None:
            continue
        inside = int(np.count_nonzero(_gap(cloud, form, made) < _SMEAR_MM))
        if inside > count:
            best, count = made, inside
    if count < _LEAST_POINTS:
        raise CalibrationRefused(
            f"calibration: {what}: not found among {len(cloud)} points; see that the plan meets"
            " it, and that artefact.toml is it"
        )
    best = _polished(cloud, form, best, radius)
    return best, cloud[_gap(cloud, form, best) >= 1.5 * _SMEAR_MM]


def _outward_planes(cloud: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Up to four planes (m, 4) that face away from the middle of a convex body, and the rest."""
    middle = cloud[:, :3].mean(axis=0) if len(cloud) else np.zeros(3)
    planes = np.empty((0, 4))
    while len(planes) < _FRUSTUM_SIDES:
        try:
            own, cloud = _take(cloud, Form.PLANE, None, rng, "frustum")
        except CalibrationRefused:
            break
        outward = 1.0 if own[3] > own[:3] @ middle else -1.0
        planes = np.vstack([planes, outward * own])
    return planes, cloud


def _drawn(
    cloud: FloatArray, form: Form, radius: float | None, rng: np.random.Generator
) -> FloatArray | None:
    """An element through a few neighbours drawn at random; None where there is none."""
    seed = cloud[rng.integers(len(cloud)), :3]
    away = np.abs(cloud[:, :3] - seed)
    reach = _NEIGHBOURS_MM if radius is None else min(2.0 * radius, 2.0 * _NEIGHBOURS_MM)
    near = np.linalg.norm(away, axis=1) < reach
    if form is Form.CYLINDER:
        near &= away[:, 2] < _SLAB_MM / 2.0
    pool = np.flatnonzero(near)
    wanted = 4 if form is Form.SPHERE else 3
    if len(pool) < 3 * wanted:
        return None
    drawn = cloud[rng.choice(pool, wanted, replace=False)]
    made = _through(drawn, form)
    if made is None or (form is not Form.PLANE and not _fits(made[-1], radius)):
        return None
    return made


def _fits(found: float, radius: float | None) -> bool:
    return found < 500.0 if radius is None else abs(found - radius) < 0.25 * radius


def _through(drawn: FloatArray, form: Form) -> FloatArray | None:
    """Sphere x, y, z, r; cylinder x, y, r; plane normal, against the light, and distance."""
    points = drawn[:, :3]
    if form is Form.PLANE:
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        length = float(np.linalg.norm(normal))
        if length < 1.0:
            return None
        normal /= length if normal @ drawn[0, 3:] < 0.0 else -length
        return np.append(normal, normal @ points[0])
    used = points if form is Form.SPHERE else points[:, :2]
    return _ball(used)


def _ball(points: FloatArray) -> FloatArray | None:
    """Least-squares sphere or circle: |p|^2 = 2 c . p + (r^2 - |c|^2)."""
    middle = points.mean(axis=0)
    moved = points - middle
    rows = np.column_stack([2.0 * moved, np.ones(len(moved))])
    found, _, rank, _ = np.linalg.lstsq(rows, np.sum(moved**2, axis=1), rcond=1e-9)
    square = found[-1] + found[:-1] @ found[:-1]
    if rank < rows.shape[1] or square <= 0.0:
        return None
    return np.append(found[:-1] + middle, np.sqrt(square))


def _gap(cloud: FloatArray, form: Form, own: FloatArray) -> FloatArray:
    if form is Form.PLANE:
        # A thin plate has two sides; what is lit from behind is of the other.
        lit = cloud[:, 3:] @ own[:3] < 0.0
        return np.where(lit, np.abs(cloud[:, :3] @ own[:3] - own[3]), np.inf)
    used = cloud[:, : 3 if form is Form.SPHERE else 2]
    return np.asarray(np.abs(np.linalg.norm(used - own[:-1], axis=1) - own[-1]))


def _polished(cloud: FloatArray, form: Form, own: FloatArray, radius: float | None) -> FloatArray:
    """Least squares over all that lie near, twice."""
    for _ in range(2):
        near = cloud[_gap(cloud, form, own) < _SMEAR_MM, :3]
        if form is Form.PLANE:
            middle = near.mean(axis=0)
            normal = np.linalg.svd(near - middle, full_matrices=False)[2][2]
            normal *= np.sign(normal @ own[:3]) or 1.0
            own = np.append(normal, normal @ middle)
        else:
            made = _ball(near if form is Form.SPHERE else near[:, :2])
            own = own if made is None or not _fits(made[-1], radius) else made
    return own


def _frustum_face(name: str, scan: int, planes: FloatArray, faces: FloatArray) -> Face:
    """The pose in which a frustum's faces lie on the planes found.

    Raises
    ------
    CalibrationRefused
        Fewer than three planes, or none that make this frustum.
    """
    if len(planes) < 3:
        raise CalibrationRefused(
            f"calibration: frustum {name}: {len(planes)} of its faces found, three are needed;"
            " see that the plan meets them"
        )
    best: tuple[float, FloatArray, FloatArray] | None = None
    for picked in permutations(range(len(faces)), len(planes)):
        made = _posed(planes, faces[list(picked)])
        if best is None or made[0] < best[0]:
            best = made
    if best is None or best[0] > _UNLIKE * 5.0:
        raise CalibrationRefused(
            f"calibration: frustum {name}: the planes found do not make it; correct artefact.toml"
        )
    shape = Shape(Form.FRUSTUM, best[1], np.zeros(3), faces)
    begin = np.concatenate([np.zeros(3), best[2]])
    return Face(name, scan, shape, begin, np.empty(0, np.int64))


def _posed(planes: FloatArray, faces: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Misfit, rotation and place, by Kabsch on normals and least squares on distances."""
    u, _, vt = np.linalg.svd(planes[:, :3].T @ faces[:, :3])
    flip = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    turn = u @ flip @ vt
    normals = faces[:, :3] @ turn.T
    misfit = float(np.abs(normals - planes[:, :3]).max())
    place = np.linalg.lstsq(planes[:, :3], planes[:, 3] - faces[:, 3], rcond=None)[0]
    left = float(np.abs(planes[:, :3] @ place - planes[:, 3] + faces[:, 3]).max())
    return misfit + left / 100.0, np.asarray(turn), np.asarray(place, np.float64)
