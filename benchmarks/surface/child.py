"""One method on one cloud in a process of its own: what it made, and what it took.

Processor seconds are user and system, from the file to the mesh in memory, those of the process
and of its children; imports are done before. Memory is the process's VmHWM, and how far that lies
above what was resident after the imports; the largest child (`getrusage`) is added to both.
A peer that dies takes nobody with it, and is reported as dead.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.surface.methods import METHODS, Made, Task

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
ONE_CORE = dict.fromkeys(THREADS, "1")
MOST_MEMORY_BYTES = 12 << 30
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class Cost:
    """What a run took."""

    cpu_s: float
    peak_mb: float
    above_imports_mb: float


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """How a run ended: with a mesh and its cost, or with the reason why not."""

    made: Made | None
    cost: Cost | None
    failure: str = ""


def run_apart(method: str, task: Task, folder: Path, *, limit_s: float) -> Run:
    """Run a method in a child; its mesh is left in `folder`."""
    out = folder / "made.npz"
    out.unlink(missing_ok=True)
    said = {key: str(value) for key, value in asdict(task).items()}
    command = [sys.executable, "-m", "benchmarks.surface.child", method, json.dumps(said), str(out)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=limit_s, check=False,
            cwd=ROOT, env={**os.environ, **ONE_CORE},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Run(None, None, f"timed out after {limit_s:g} s")
    return ended(done, out)


def ended(done: subprocess.CompletedProcess[str], out: Path) -> Run:
    """Say how a child ended that may have written `out`."""
    if done.returncode < 0:
        return Run(None, None, f"crashed: {signal.Signals(-done.returncode).name}")
    if done.returncode > 0 or not out.exists():
        lines = done.stderr.strip().splitlines() or ["no word"]
        return Run(None, None, f"failed: {lines[-1][:160]}")
    return Run(read_made(out), Cost(**json.loads(done.stdout.strip().splitlines()[-1])))


def write_made(path: Path, made: Made) -> None:
    """Keep a mesh and its patches as one .npz."""
    names = ("degree_u", "degree_v", "knots_u", "knots_v", "control_points_mm", "weights",
             "periodic_u", "periodic_v")  # fmt: skip
    patches = {
        f"{index}.{name}": np.asarray(getattr(patch, name))
        for index, patch in enumerate(made.patches)
        for name in names
    }
    np.savez(path, vertices=made.vertices_mm, faces=made.faces, **patches)


def read_made(path: Path) -> Made:
    """Read what `write_made` wrote; patches come as dictionaries of arrays."""
    with np.load(path) as kept:
        patches: dict[str, dict[str, object]] = {}
        for key in kept.files:
            index, _, name = key.partition(".")
            if name:
                patches.setdefault(index, {})[name] = kept[key]
        return Made(kept["vertices"], kept["faces"], tuple(patches.values()))


def _status_mb(field: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) / 1024
    raise LookupError(field)


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main() -> None:
    """Work in the child."""
    method, said, out = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
    given = json.loads(said)
    task = Task(
        Path(given["points_file"]), Path(given["normals_file"]),
        given["axis"], float(given["pitch_mm"]),
    )  # fmt: skip
    work = METHODS[method]()
    resident, begun = _status_mb("VmRSS"), _cpu_s()
    made = work(task)
    cpu_s = _cpu_s() - begun
    children_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    peak = _status_mb("VmHWM") + children_mb
    write_made(Path(out), made)
    cost = Cost(round(cpu_s, 3), round(peak, 1), round(peak - resident, 1))
    print(json.dumps(asdict(cost)), flush=True)


if __name__ == "__main__":
    main()
