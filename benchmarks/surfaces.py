"""Surfaces from noisy slices: ours beside screened Poisson, ball pivoting and APSS, in one run.

    python benchmarks/surfaces.py [--cases NAME ...] [--methods NAME ...] [--out DIR]
                                  [--axis x, y, z or longest] [--seed N] [--limit-s S]

Cases, methods and measures say themselves what they are: `benchmarks/surface/`. A table goes to
stdout, and with a picture and the numbers as JSON into a folder. Every method runs on one core in
a process of its own; one that crashes or takes too long is reported so. A run of everything takes
about half an hour; the models are read from LOFTSCAN_DATA. Processor times are of one run.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.surface.cases import Case, case_names, make_case
from benchmarks.surface.child import Run, run_apart
from benchmarks.surface.measures import (
    errors_of,
    folded_share,
    mesh_of,
    shape_of,
    side_errors_of,
)
from benchmarks.surface.methods import METHODS, Task, missing_methods
from benchmarks.surface.picture import Cell, draw_cell, write_picture

Record = dict[str, object]

COSTS = ("cpu_s", "peak_mb", "above_imports_mb")
FORMATS = {
    "chamfer": "7.4f", "h95": "7.4f", "h100": "7.3f", "normals_deg": "6.2f", "volume": "7.3f",
    "apex": "7.4f", "outside_rms_mm": "8.4f", "inside_rms_mm": "8.4f", "covered": "7.4f",
    "stray": "7.4f", "faces": "8d", "euler": "6d", "watertight": "4s", "folded": "7.4f",
    "cpu_s": "7.2f", "peak_mb": "7.0f", "above_imports_mb": "7.0f",
}  # fmt: skip
HEADS = {
    "chamfer": "chamf %", "h95": "H95 %", "h100": "H100 %", "normals_deg": "nrm °",
    "volume": "vol %", "apex": "apex %", "outside_rms_mm": "outs mm", "inside_rms_mm": "gaps mm",
    "covered": "covered", "stray": "stray", "faces": "faces", "euler": "Euler",
    "watertight": "shut", "folded": "folded", "cpu_s": "CPU s", "peak_mb": "peak MB",
    "above_imports_mb": "+MB",
}  # fmt: skip


def judged(case: Case, method: str, run: Run, *, seed: int) -> tuple[Record, Cell]:
    """Turn a run into a line of the table and a cell of the picture."""
    record: Record = {"case": case.name, "method": method}
    if run.made is None or run.cost is None:
        return {**record, "failure": run.failure}, Cell(None, run.failure)
    if len(run.made.faces) == 0:
        return {**record, "failure": "made no faces"}, Cell(None, "made no faces")
    mesh = mesh_of(run.made.vertices_mm, run.made.faces)
    shape = shape_of(mesh)
    record |= asdict(shape) | {"watertight": "yes" if shape.watertight else "no"}
    if case.truth is None:
        side = side_errors_of(mesh, case.gaps, seed=seed)
        words = f"{side.outside_rms_mm:.4f} mm, gaps {side.inside_rms_mm:.3f} mm"
        record |= asdict(side)
    else:
        errors = errors_of(mesh, case.truth.solid(), seed=seed, apex_mm=case.apex_mm)
        words = f"chamfer {errors.chamfer:.3f} %, H95 {errors.h95:.3f} %"
        record |= asdict(errors)
    if run.made.patches and case.name.split("+")[0] in ("cylinder", "cone", "vase"):
        record["folded"] = max(folded_share(patch) for patch in run.made.patches)
    record |= asdict(run.cost)
    return record, draw_cell(mesh, case, words)


def lines_of(case: Case, records: list[Record]) -> Iterator[str]:
    """Lines of the table of one case."""
    known = [key for key in FORMATS if any(_told(record.get(key)) for record in records)]
    yield f"{case.name}: {'; '.join(case.notes)}"
    yield f"  {'':26}" + " ".join(f"{HEADS[key]:>{_width(key)}}" for key in known)
    for record in records:
        if "failure" in record:
            yield f"  {record['method']:26}{record['failure']}"
            continue
        cells = [_cell(key, record.get(key)) for key in known]
        yield f"  {record['method']:26}" + " ".join(cells)


def _told(value: object) -> bool:
    return value is not None and not (isinstance(value, float) and math.isnan(value))


def _width(key: str) -> int:
    return max(len(HEADS[key]), int(FORMATS[key].split(".")[0].rstrip("dsf")))


def _cell(key: str, value: object) -> str:
    if not _told(value):
        return f"{'-':>{_width(key)}}"
    return f"{value:>{FORMATS[key]}}".rjust(_width(key))


def warm_up(folder: Path) -> None:
    """Let our kernels be compiled into numba's cache once: on any machine that is done once."""
    rng = np.random.default_rng(0)
    turn, height = rng.uniform(0, math.tau, 8000), rng.integers(0, 20, 8000) * 1.0
    np.save(folder / "warm.npy", np.stack([20 * np.cos(turn), 20 * np.sin(turn), height], axis=1))
    task = Task(folder / "warm.npy", folder / "warm.npy", "z", 1.0)
    skipped = dict(missing_methods())
    for method in METHODS:
        if method.startswith(("paper", "fit")) and method not in skipped:
            run_apart(method, task, folder, limit_s=600)


def run_case(
    case: Case, methods: list[str], folder: Path, *, seed: int, limit_s: float
) -> Iterator[tuple[Record, Cell]]:
    """Run every method on one case, one after the other."""
    np.save(folder / "points.npy", case.points_mm)
    np.save(folder / "normals.npy", case.normals)
    task = Task(folder / "points.npy", folder / "normals.npy", case.axis, case.pitch_mm)
    for method in methods:
        run = run_apart(method, task, folder, limit_s=limit_s)
        yield judged(case, method, run, seed=seed)


def arguments() -> argparse.Namespace:
    """What was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", nargs="+", choices=case_names(), default=case_names())
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--out", type=Path, help="by default a new folder among the temporary ones")
    parser.add_argument("--axis", choices=["x", "y", "z", "longest"], default="z")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit-s", type=float, default=900.0)
    return parser.parse_args()


def main() -> None:
    """Run what was asked for."""
    asked = arguments()
    out = asked.out or Path(tempfile.mkdtemp(prefix="loftscan-surfaces-"))
    out.mkdir(parents=True, exist_ok=True)
    print(f"results go to {out}")
    skipped = dict(missing_methods())
    for method in asked.methods:
        if method in skipped:
            print(f"skipped: {method}: {skipped[method]}")
    methods = [method for method in asked.methods if method not in skipped]
    print(f"seed {asked.seed}; chamfer, H95, H100, apex in % of the diagonal, volume in %\n")
    everything: list[Record] = []
    cells: dict[str, dict[str, Cell]] = {}
    with tempfile.TemporaryDirectory(prefix="loftscan-surfaces-work-") as work:
        warm_up(Path(work))
        for name in asked.cases:
            try:
                case = make_case(name, seed=asked.seed, axis=asked.axis)
            except FileNotFoundError as missing:
                print(f"skipped: {name}: {missing}\n")
                continue
            rows = list(run_case(case, methods, Path(work), seed=asked.seed, limit_s=asked.limit_s))
            cells[name] = dict(zip(methods, (cell for _, cell in rows), strict=True))
            table = "\n".join(lines_of(case, [record for record, _ in rows])) + "\n"
            print(table, flush=True)
            everything += [record for record, _ in rows]
            with (out / "surfaces.txt").open("w" if len(cells) == 1 else "a") as file:
                file.write(table + os.linesep)
            _write_json(out / "surfaces.json", everything)
            write_picture(out / "surfaces.png", cells, methods)
    print(f"table, numbers and picture: {out}")


def _write_json(path: Path, records: list[Record]) -> None:
    cleaned = [{k: v if _told(v) else None for k, v in record.items()} for record in records]
    path.write_text(json.dumps(cleaned, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
