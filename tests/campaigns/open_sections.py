"""Meridians and stripes by `--method fit`, and the same parts by rings: figures against the truth.

    python -m tests.campaigns.open_sections [--seeds 3] [--only CASE ...]

Of every case, medians over the seeds: rms and greatest distance of a lattice of 400 x 400 places
of the surface from the formula (the 2 mm beside ends, and 0.5 mm beside the unseen wall of a step,
left out), the bound sigma sqrt(freedom / points), whether the mesh is watertight, its Euler number,
whether the surface folds (its normal turns against the part's outside on 1000 x 1000 places), what
STEP holds and whether BRepCheck calls it valid, how far IGES and 3DM read back are off, seconds of
processor time to the mesh.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loftscan import reconstruct
from loftscan.result import Result
from reconstruction.arrays import FloatArray
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.nurbs import evaluate_surface, points_and_tangents_at
from reconstruction.skinning.skin import Skin
from reconstruction.slices import Slice
from tests.reconstruction import open_cases as cases

LATTICE, FOLD_LATTICE = 400, 1000
BESIDE_ENDS, BESIDE_WALL = 2.0, 0.5  # mm, left out


@dataclass(frozen=True, slots=True)
class Case:
    """A scan, and how far places are from the part."""

    slices: Callable[[int], list[Slice]]
    errors: Callable[[FloatArray], FloatArray]
    told: Callable[[FloatArray], np.ndarray]  # which places are compared
    outside: Callable[[FloatArray], FloatArray]  # a direction on the outer side
    exact: str = "never"


def _away_from_ends(places: FloatArray) -> np.ndarray:
    z = places[:, 2]
    return (z > BESIDE_ENDS) & (z < cases.VASE_HEIGHT - BESIDE_ENDS)


def _away_from_rim(places: FloatArray) -> np.ndarray:
    inside = np.array([60.0, 40.0]) - BESIDE_ENDS
    return (np.abs(places[:, :2]) < inside).all(axis=1)


def _away_from_step(places: FloatArray) -> np.ndarray:
    x, y = places[:, 0], places[:, 1]
    return _away_from_rim(places) & (np.abs(cases.beyond_step(x, y)) > BESIDE_WALL)


def _everywhere(places: FloatArray) -> np.ndarray:
    return np.ones(len(places), np.bool_)


def _from_axis(places: FloatArray) -> FloatArray:
    return places * np.array([1.0, 1.0, 0.0])


def _upwards(places: FloatArray) -> FloatArray:
    return np.broadcast_to(np.array([0.0, 0.0, 1.0]), places.shape)


def _turned(radius: cases.Turned, slices: Callable[[int], list[Slice]], exact: str) -> Case:
    return Case(
        slices, lambda places: cases.turned_errors(radius, places), _away_from_ends, _from_axis,
        exact,
    )  # fmt: skip


def _sphere(slices: Callable[[int], list[Slice]], exact: str) -> Case:
    return Case(
        slices,
        lambda places: np.linalg.norm(places, axis=1) - cases.SPHERE_RADIUS,
        _everywhere,
        lambda places: places,
        exact,
    )


def _plate(height: cases.Relief, told: Callable[[FloatArray], np.ndarray], **scan: float) -> Case:
    return Case(
        lambda seed: cases.stripe_slices(height, seed=seed, **scan),  # type: ignore[arg-type]
        lambda places: cases.relief_errors(height, places),
        told,
        _upwards,
    )


def _cases() -> dict[str, Case]:
    vase, lobed = cases.vase, cases.lobed_vase
    found = {}
    for exact in ("auto", "never"):
        found |= {
            f"vase, meridians, exact {exact}": _turned(
                vase, lambda seed: cases.meridian_slices(vase, seed=seed), exact
            ),
            f"vase, rings, exact {exact}": _turned(
                vase, lambda seed: cases.rings_of(vase, seed=seed), exact
            ),
            f"sphere, meridians, exact {exact}": _sphere(
                lambda seed: cases.sphere_meridians(seed=seed), exact
            ),
            f"sphere, rings, exact {exact}": _sphere(
                lambda seed: cases.sphere_rings(seed=seed), exact
            ),
        }
    return found | {
        "lobed vase, meridians": _turned(
            lobed, lambda seed: cases.meridian_slices(lobed, seed=seed), "never"
        ),
        "lobed vase, meridians, a fifth lost": _turned(
            lobed, lambda seed: cases.meridian_slices(lobed, seed=seed, share_lost=0.2), "never"
        ),
        "lobed vase, rings": _turned(lobed, lambda seed: cases.rings_of(lobed, seed=seed), "never"),
        "plate, stripes": _plate(cases.bulge, _away_from_rim),
        "plate, stripes, gaps, ragged": _plate(
            cases.bulge, _away_from_rim, share_lost=0.15, ragged=0.1
        ),
        "stepped plate, stripes": _plate(cases.stepped_bulge, _away_from_step),
        "stepped plate, stripes, gaps": _plate(
            cases.stepped_bulge, _away_from_step, share_lost=0.15
        ),
    }


def lattice_of(result: Result, count: int) -> tuple[FloatArray, FloatArray]:
    """Places and normals (n, 3) on a lattice over the surface, degenerate rows left out."""
    (surface,) = result.surface
    u, v = (np.linspace(*domain, count + 2)[1:-1] for domain in surface.domain)
    places = evaluate_surface(surface, u, v).reshape(-1, 3)
    grid_u, grid_v = np.meshgrid(u, v, indexing="ij")
    _, along, across = points_and_tangents_at(surface, grid_u.ravel(), grid_v.ravel())
    return places, np.cross(along, across)


def bound_mm(result: Result) -> float:
    """sigma sqrt(freedom / points) of a free surface; nan of an exact one."""
    done = result.reconstruction
    assert isinstance(done, FittedReconstruction)
    (skin,) = done.skinned.skins
    if not isinstance(skin, Skin):
        return math.nan
    return cases.SIGMA * math.sqrt(skin.fit.edf / skin.moments.total)


def folds(case: Case, result: Result) -> int:
    """Places at which the surface's normal looks to the other side than most do."""
    places, normals = lattice_of(result, FOLD_LATTICE)
    told = case.told(places)
    sides = np.sign((normals * case.outside(places)).sum(axis=1))[told]
    return int((sides != np.sign(sides.sum())).sum())


def cad_of(result: Result, folder: Path) -> str:
    """What the files hold, read back."""
    from tests.reconstruction.test_exporting_solids import count_of, is_valid, read_shape, volume_of

    saved = result.save(folder, formats=["step", "iges", "3dm"], overwrite=True)
    shape = read_shape(saved / "surface.step")
    solids = count_of(shape, "SOLID")
    valid = "valid" if is_valid(shape) else "NOT valid"
    if not solids:
        return f"sheet of {count_of(shape, 'FACE')} faces, {valid}"
    volume = float(str(result.metrics["volume_mm3"]))
    return f"{solids} solid, {valid}, volume {volume_of(shape) / volume - 1.0:+.1e}"


def measure(name: str, case: Case, seeds: int) -> None:
    """Print one line of the table."""
    rows, seconds, last = [], [], None
    for seed in range(seeds):
        begun = time.process_time()
        last = reconstruct(case.slices(seed), exact=case.exact)  # type: ignore[arg-type]
        seconds.append(time.process_time() - begun)
        if len(last.surface) != 1:
            sys.stdout.write(f"{name:40} {len(last.surface)} surfaces; {last.warnings[:1]}\n")
            return
        places, _ = lattice_of(last, LATTICE)
        errors = case.errors(places[case.told(places)])
        rms, most = float(np.sqrt((errors**2).mean())), float(np.abs(errors).max())
        rows.append((rms, most, bound_mm(last)))
    assert last is not None
    rms, most, bound = np.median(np.array(rows), axis=0)
    with tempfile.TemporaryDirectory() as folder:
        cad = cad_of(last, Path(folder) / "out")
    points, numbers = last.metrics["points_in"], last.metrics
    sys.stdout.write(
        f"{name:40} N {points} rms {rms:.4f} max {most:.4f} bound {bound:.4f} mm;"
        f" watertight {numbers['watertight']}, Euler {numbers['euler_number']},"
        f" folds {folds(case, last)}; STEP {cad}; {np.median(seconds):.1f} s\n"
    )
    sys.stdout.flush()


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=[])
    given = parser.parse_args(arguments)
    for name, case in _cases().items():
        if not given.only or any(word in name for word in given.only):
            measure(name, case, given.seeds)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
