"""From the scans of an artefact to a calibration: focus, find, solve, name, solve, judge.

Every step gives what the next begins with::

    focus   angle scale and sense to a percent, the axis to a millimetre, nothing else known
    find    which points are of which element, within 2 mm
    solve   all but spacings; points are given out anew within less, until they settle
    name    spheres of one radius by their spacings
    solve   with the spacings that are not held out
    check   the spacing that is: what the calibration makes of it beside its certificate
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import Kind, Kinematics
from acquisition.poses import Sweep
from loftscan.calibrating.artefact import Artefact
from loftscan.calibrating.errors import CalibrationRefused
from loftscan.calibrating.finding import assigned, find_faces, named, spacings_of
from loftscan.calibrating.focusing import Focus, focus, thinned
from loftscan.calibrating.model import LENGTHS, PARAMETERS, Face, Model, Seen, Spacing
from loftscan.calibrating.shapes import Form
from loftscan.calibrating.solving import Solution, solve
from loftscan.calibrating.verdict import Verdict, judge

_PLACES = tuple(name for name in PARAMETERS if name not in LENGTHS)
_FIRST_SIGMA_MM = 0.05
_WITHIN_MM = (2.0, 1.0)
_SIGMAS = 8.0  # of the noise: points within are an element's
_LEAST_WITHIN_MM = 0.1
_TRIES = 3
_ROUGH_POINTS = 5_000
_MOST_ROLL = 0.5  # its sine
_MOST_POINTS = 60_000


@dataclass(frozen=True, slots=True)
class Check:
    """A held-out spacing."""

    name: str
    scan: int
    found_mm: float
    certified_mm: float
    sd_mm: float  # of the difference

    @property
    def sound(self) -> bool:
        """Whether the difference is within three standard deviations."""
        return abs(self.found_mm - self.certified_mm) <= 3.0 * self.sd_mm


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """What came of it, good or not."""

    solution: Solution
    verdict: Verdict
    focus: Focus
    checks: tuple[Check, ...]
    points_seen: int

    @property
    def kinematics(self) -> Kinematics:
        """As solved."""
        return replace(self.solution.kinematics, kind=Kind.CALIBRATED)


def seen_in(scans: Sequence[Sequence[Sweep]]) -> Seen:
    """All measured points of scans, with the poses they were taken at."""
    planar, stage, table, scan, profile = [], [], [], [], []
    number = 0
    for index, sweeps in enumerate(scans):
        for sweep in sweeps:
            for each, pose in zip(sweep.profiles, sweep.poses, strict=True):
                points_mm = each.points_mm
                planar.append(points_mm)
                stage.append(np.full(len(points_mm), pose.stage_mm))
                table.append(np.full(len(points_mm), pose.table_rad))
                scan.append(np.full(len(points_mm), index, np.int64))
                profile.append(np.full(len(points_mm), number, np.int64))
                number += 1
    if not planar:
        raise CalibrationRefused("calibration: no profile in these scans")
    return Seen(*(np.concatenate(each) for each in (planar, stage, table, scan, profile)))


def calibrate(
    seen: Seen,
    nominal: Kinematics,
    artefact: Artefact,
    *,
    seed: int = 1,
    progress: Callable[[str], None] = lambda _: None,
) -> Calibrated:
    """Solve for the kinematics of the station that took these scans of an artefact.

    Raises
    ------
    CalibrationRefused
        An element is not found, the spacings do not fit: one line, with the remedy.
    """
    must_be_level(nominal)
    whole = len(seen)
    if whole == 0:
        raise CalibrationRefused(
            "calibration: not one measured point; see that the sheet meets the part"
        )
    seen = thinned(seen, _MOST_POINTS)
    progress("focus")
    focused = focus(seen, nominal)
    if focused.planes_swapped or focused.axes_swapped:
        return _unsolved(seen, focused, whole)
    progress("find and solve")
    solution = _found(thinned(seen, _ROUGH_POINTS), focused.kinematics, artefact, seed)
    held = spacings_of(artefact, held_out=False)
    solution = _finished(seen, solution, held)
    return Calibrated(solution, judge(solution), focused, check(solution, artefact), whole)


def must_be_level(nominal: Kinematics) -> None:
    """Refuse a station whose sheet stands upright: its artefact is not found in what it saw.

    Raises
    ------
    CalibrationRefused
    """
    if abs(math.sin(math.radians(nominal.roll_deg))) > _MOST_ROLL:
        raise CalibrationRefused(
            f"calibration: the sheet stands upright (roll_deg = {nominal.roll_deg:g}), and only"
            " stations with a level sheet are solved; measure [kinematics] by hand and scan with"
            ' --override "why", or calibrate with the sensor turned level'
        )


def _found(seen: Seen, start: Kinematics, artefact: Artefact, seed: int) -> Solution:
    """Elements, roughly solved and named; chance draws them, so that it may draw again."""
    for tries_left in reversed(range(_TRIES)):
        rng = np.random.default_rng([seed, tries_left])
        scans = range(int(seen.scan.max()) + 1)
        try:
            faces = tuple(f for i in scans for f in find_faces(seen, i, start, artefact, rng))
            solution = _settled(seen, start, faces, len(scans), start)
            if not artefact.spheres:
                return solution
            faces = named(_at(solution), artefact)
            return _settled(seen, solution.kinematics, faces, len(scans), start)
        except CalibrationRefused:
            if not tries_left:
                raise
    raise AssertionError("no try was left, and none refused")


def held_to(
    seen: Seen, kinematics: Kinematics, artefact: Artefact, *, seed: int = 1
) -> tuple[Solution, tuple[Check, ...]]:
    """Fit the artefact alone, the kinematics as they are: what does not fit has drifted.

    Raises
    ------
    CalibrationRefused
        An element is not found where the calibration places it.
    """
    seen = thinned(seen, _ROUGH_POINTS)
    rng = np.random.default_rng(seed)
    scans = range(int(seen.scan.max()) + 1)
    faces = tuple(f for i in scans for f in find_faces(seen, i, kinematics, artefact, rng))
    sigma_mm = np.full(len(scans), _FIRST_SIGMA_MM)
    solution = solve(Model(kinematics, (), seen, faces, (), sigma_mm))
    faces = assigned(seen, _at(solution), kinematics, _WITHIN_MM[-1])
    faces = named(faces, artefact) if artefact.spheres else faces
    solution = solve(Model(kinematics, (), seen, faces, (), solution.model.sigma_mm))
    return solution, check(solution, artefact)


def check(solution: Solution, artefact: Artefact) -> tuple[Check, ...]:
    """Compare the spacings that were held out."""
    found = []
    faces = solution.model.faces
    own = solution.model.own(solution.at)
    columns = solution.model.columns()
    for scan in sorted({each.scan for each in faces}):
        where = {f.name: i for i, f in enumerate(faces)
                 if f.scan == scan and f.shape.form is Form.SPHERE}  # fmt: skip
        for each in spacings_of(artefact, held_out=True):
            if each.one in where and each.other in where:
                one, other = where[each.one], where[each.other]
                found.append(_check(solution, each, scan, own, (one, other), columns))
    return tuple(found)


def _check(
    solution: Solution,
    spacing: Spacing,
    scan: int,
    own: list[FloatArray],
    pair: tuple[int, int],
    columns: list[slice],
) -> Check:
    way = own[pair[0]][:3] - own[pair[1]][:3]
    length = float(np.linalg.norm(way))
    row = np.zeros(len(solution.at))
    row[columns[pair[0]]], row[columns[pair[1]]] = way / length, -way / length
    variance = float(row @ solution.covariance @ row) + spacing.sd_mm**2
    return Check(spacing.name, scan, length, spacing.distance_mm, math.sqrt(max(variance, 0.0)))


def _settled(
    seen: Seen, start: Kinematics, faces: tuple[Face, ...], scans: int, anchor: Kinematics
) -> Solution:
    """Solve and give the points out anew, within less each time."""
    sigma_mm = np.full(scans, _FIRST_SIGMA_MM)
    # With every length free a part may shrink to a point, which lies on any face: not at first.
    solution = solve(Model(start, _PLACES, seen, faces, (), sigma_mm, anchor))
    for within_mm in _WITHIN_MM:
        solution = _again(seen, solution, within_mm, ())
    return solution


def _finished(seen: Seen, solution: Solution, spacings: tuple[Spacing, ...]) -> Solution:
    """With every point, within a few standard deviations of the noise."""
    worst_mm = float(solution.model.sigma_mm.max())
    within_mm = max(_SIGMAS * worst_mm, _LEAST_WITHIN_MM)
    return _again(seen, solution, within_mm, spacings)


def _again(
    seen: Seen, solution: Solution, within_mm: float, spacings: tuple[Spacing, ...]
) -> Solution:
    kinematics = solution.kinematics
    faces = assigned(seen, _at(solution), kinematics, within_mm)
    known = solution.model
    return solve(Model(kinematics, PARAMETERS, seen, faces, spacings, known.sigma_mm, known.anchor))


def _at(solution: Solution) -> tuple[Face, ...]:
    own = solution.model.own(solution.at)
    return tuple(
        replace(face, own=each) for face, each in zip(solution.model.faces, own, strict=True)
    )


def _unsolved(seen: Seen, focused: Focus, whole: int) -> Calibrated:
    empty = np.empty(0)
    model = Model(focused.kinematics, (), seen, (), (), np.ones(1))
    nothing = Solution(model, empty, empty, np.empty((0, 0)), 1.0, 0, np.empty((0, 0)))
    return Calibrated(nothing, Verdict((), empty, 0, ()), focused, (), whole)
