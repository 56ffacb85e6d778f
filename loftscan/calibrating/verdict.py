"""What an artefact's scans tell, and what they cannot: the singular values, in words.

The columns of the kinematic parameters, with what the artefact's own unknowns can imitate taken
out of them, in units of 1 mm, 1 degree and 1 percent:

    J_k' = J_k - Q Q^T J_k,  Q spans J_a        J_k' = U S V^T

One over a singular value is the standard deviation of the combination V that it belongs to. A
combination known worse than `_LIMIT` of those units is not observable; which parameters are in it
says what is missing, and which artefact would bring it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray
from loftscan.calibrating.model import PARAMETERS
from loftscan.calibrating.solving import Solution

_LIMIT = 0.1  # of a unit: 0.1 mm, 0.1 degrees, 0.1 percent
_PART = 0.25  # of a combination: a smaller share is none
_UNIT = {
    name: 1.0 if name in ("standoff_mm", "side_mm", "pitch_deg", "roll_deg") else 0.01
    for name in PARAMETERS
}
_GROUPS = {
    "standoff_mm": "the axis's position (standoff_mm)",
    "side_mm": "the axis's position (side_mm)",
    "pitch_deg": "the axis's direction (pitch_deg)",
    "roll_deg": "the axis's direction (roll_deg)",
    "table_deg_per_deg": "the table's scale",
    "stage_x_mm": "the stage's direction (stage_x_mm)",
    "stage_y_mm": "the stage's direction (stage_y_mm)",
    "stage_z_mm": "the stage's scale",
    "x_mm_per_mm": "the sensor's x scale",
    "z_mm_per_mm": "the sensor's z scale",
    "x_mm_per_z_mm": "the sensor's shear",
}
_OFF_AXIS = (
    "put a sphere of known radius 20 mm or more off the axis, and another at a different height"
)
_LENGTH = (
    "add a known length: spheres of known radius or spacing, or a frustum of known geometry;"
    " planes and cylinders along the stage stay what they are however far it moves"
)
_TURN = (
    "let the plan turn the table by a whole turn, and put something that is not round off its axis"
)
_STAGE = (
    "scan spheres of known radius at several heights, or a frustum of known geometry: any motion of"
    " the stage keeps planes planes"
)


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """What the scans leave open, as a sentence each."""

    what: str
    remedy: str
    sd: float  # in units of 1 mm, 1 degree, 1 percent


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Rank and condition of the kinematic part."""

    names: tuple[str, ...]
    singular: FloatArray  # falling, in 1 / unit
    rank: int
    open: tuple[Combination, ...]

    @property
    def observable(self) -> bool:
        """Whether all is told."""
        return not self.open

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; inf where the smallest is none."""
        least = float(self.singular[-1])
        return float(self.singular[0]) / least if least > 0.0 else float("inf")

    def words(self) -> str:
        """What is not observable and what would make it so, in one sentence."""
        what = "; ".join(each.what for each in self.open)
        remedies = "; ".join(dict.fromkeys(each.remedy for each in self.open))
        return f"{what} cannot be told from these scans: {remedies}"


def judge(solution: Solution) -> Verdict:
    """Tell what a solution knows."""
    free = solution.model.free
    count = len(free)
    units = np.array([_UNIT[name] for name in free])
    own = solution.jacobian[:, count:]
    kinematic = solution.jacobian[:, :count] * units
    left = _without(kinematic, own) / np.sqrt(solution.alike)
    _, singular, combinations = np.linalg.svd(np.linalg.qr(left, mode="r"))
    sd = 1.0 / np.maximum(singular, 1e-12)
    found = tuple(
        _combination(free, combinations[i], float(sd[i])) for i in np.flatnonzero(sd > _LIMIT)
    )
    return Verdict(free, singular, int(np.count_nonzero(sd <= _LIMIT)), _merged(found))


def _without(columns: FloatArray, own: FloatArray) -> FloatArray:
    """What of columns the others cannot imitate."""
    if not own.shape[1]:
        return columns
    scale = np.linalg.norm(own, axis=0)
    q, s, _ = np.linalg.svd(own[:, scale > 0] / scale[scale > 0], full_matrices=False)
    q = q[:, s > 1e-9 * s.max()]
    return np.asarray(columns - q @ (q.T @ columns))


def _combination(names: tuple[str, ...], parts: FloatArray, sd: float) -> Combination:
    strong = [name for name, part in zip(names, parts, strict=True) if abs(part) > _PART]
    return Combination(
        " with ".join(dict.fromkeys(_GROUPS[name] for name in strong)), _remedy(strong), sd
    )


def _remedy(names: list[str]) -> str:
    if any(name.startswith("stage_") for name in names):
        scales = {"stage_z_mm", "x_mm_per_mm", "z_mm_per_mm", "standoff_mm", "side_mm"}
        return _LENGTH if scales >= set(names) else _STAGE
    if any(name in ("x_mm_per_mm", "z_mm_per_mm") for name in names):
        return _LENGTH
    if "table_deg_per_deg" in names:
        return _TURN
    return _OFF_AXIS


def _merged(found: tuple[Combination, ...]) -> tuple[Combination, ...]:
    """One of each sentence."""
    return tuple({each.what: each for each in found}.values())
