"""Mesh cleanup with pymeshlab, in a child process with a time and a memory limit.

The library is C++ that can crash, leak or never return, and its repairs can undo one another; so
it runs where a crash is a message, repeats until nothing changes, and is not believed: what comes
back is checked here with our own counts.

    parent   request.npz, request.json  ->  cleanup_child.py (limits, pymeshlab, passes)
             promises, marks            <-  result.npz, report.json or failure.json
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.errors import CleanupFailed, MissingExtra
from reconstruction.meshing import Mesh
from reconstruction.soundness import Soundness, soundness

# -P: the child's folder is not searched for modules, so none of ours can hide one of pymeshlab's.
CHILD = (sys.executable, "-P", str(Path(__file__).with_name("cleanup_child.py")))

_REMEDY = "run: apt-get install libgl1 libopengl0"
_VOLUME_SHARE = 0.01  # of the volume that may change


@dataclass(frozen=True, slots=True)
class CleanupSettings:
    """What to do, and at what cost."""

    merge_within_mm: float = 0.0  # 0: vertices at exactly one place only
    max_hole_edges: int = 100  # larger holes stay open; 0: all do
    remesh_edge_mm: float | None = None
    decimate_to_faces: int | None = None
    time_limit_s: float = 120.0
    memory_limit_mb: float = 4096.0  # address space

    def __post_init__(self) -> None:
        if not (self.merge_within_mm >= 0 and self.max_hole_edges >= 0):
            raise ValueError("cleanup: merge_within_mm and max_hole_edges must not be negative")
        if self.remesh_edge_mm is not None and not self.remesh_edge_mm > 0:
            raise ValueError("cleanup: remesh_edge_mm must be above 0")
        if self.decimate_to_faces is not None and self.decimate_to_faces < 4:
            raise ValueError("cleanup: a closed mesh has at least 4 faces")
        if not (self.time_limit_s > 0 and self.memory_limit_mb > 0):
            raise ValueError("cleanup: the limits must be above 0")


@dataclass(frozen=True, slots=True)
class Work:
    """What the child did, in counts."""

    passes: int = 0
    merged_vertices: int = 0
    unused_vertices: int = 0
    duplicate_faces: int = 0
    flipped_faces: int = 0  # flat ones whose long edge was flipped
    degenerate_faces: int = 0
    nonmanifold_faces: int = 0  # removed from edges with more than two
    split_vertices: int = 0  # added where fans only touched
    holes_closed: int = 0
    hole_faces: int = 0
    reoriented_faces: int = 0
    remeshed: int = 0
    decimated_faces: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """The mesh, what was done to it, and its state before and after."""

    mesh: Mesh
    work: Work
    before: Soundness
    after: Soundness
    seconds: float
    peak_memory_mb: float | None  # of the child; None: the mesh was sound, no child was needed
    pymeshlab_version: str


def clean(
    mesh: Mesh, settings: CleanupSettings | None = None, *, child: Sequence[str] = CHILD
) -> Cleaned:
    """Repair a mesh, and remesh or decimate it where asked.

    A mesh that is sound already, and of which nothing is asked, comes back as it is.

    Parameters
    ----------
    child
        The command that does the work in its current directory.

    Raises
    ------
    CleanupFailed
        The child crashed, ran out of time or memory, found no fixed point, or what it made is not
        manifold and oriented, is open where the mesh was closed, or has another volume.
    MissingExtra
        pymeshlab or a system library of it is missing.
    """
    settings = settings or CleanupSettings()
    began = time.monotonic()
    before = soundness(mesh)
    if before.faces == 0:
        raise CleanupFailed("mesh cleanup: the mesh has no faces; nothing can be repaired")
    if before.sound and not _asked(settings, before):
        work, peak, cleaned, after = Work(), None, mesh, before
    else:
        cleaned, work, peak = _run(mesh, settings, child)
        after = _checked(cleaned, before)
    version = importlib.metadata.version("pymeshlab")
    seconds = time.monotonic() - began
    return Cleaned(cleaned, work, before, after, seconds, peak, version)


def _asked(settings: CleanupSettings, before: Soundness) -> bool:
    """Whether there is something to do on a sound mesh."""
    most = settings.decimate_to_faces
    thin = most is not None and before.faces > most
    return settings.merge_within_mm > 0 or settings.remesh_edge_mm is not None or thin


def _run(mesh: Mesh, settings: CleanupSettings, child: Sequence[str]) -> tuple[Mesh, Work, float]:
    """Run the child in a folder of its own."""
    with TemporaryDirectory(prefix="loftscan-cleanup-") as name:
        folder = Path(name)
        np.savez(folder / "request.npz", vertices_mm=mesh.vertices_mm, faces=mesh.faces)
        (folder / "request.json").write_text(json.dumps(asdict(settings)))
        try:
            done = subprocess.run(
                list(child), cwd=folder, env=_environment(), timeout=settings.time_limit_s,
                stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
                check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as late:
            raise CleanupFailed(
                f"mesh cleanup: not done in {settings.time_limit_s:g} s; decimate the mesh "
                "first, or raise the time limit"
            ) from late
        if done.returncode != 0:
            raise _failure(folder, done, settings)
        return _result(folder, mesh, settings)


def _environment() -> dict[str, str]:
    """Ours, with one thread: each further one of BLAS reserves address space of its own."""
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return dict(os.environ) | dict.fromkeys(threads, "1")


def _failure(
    folder: Path, done: subprocess.CompletedProcess[str], settings: CleanupSettings
) -> CleanupFailed | MissingExtra:
    """Say in one line why the child ended."""
    told = folder / "failure.json"
    said = json.loads(told.read_text()) if told.exists() else {}
    message = " ".join(str(said.get("message", "")).split())
    last = (done.stderr.strip().splitlines() or [""])[-1]
    out_of_memory = f"mesh cleanup: it needs more than the limit of {settings.memory_limit_mb:g} MB"
    if said.get("kind") == "missing":
        return MissingExtra(f"pymeshlab: {message}; {_REMEDY}")
    if said.get("kind") == "memory" or "bad_alloc" in done.stderr or "MemoryError" in last:
        return CleanupFailed(f"{out_of_memory}; decimate the mesh first, or raise the limit")
    if said:
        return CleanupFailed(f"mesh cleanup: {message}; the mesh was left as it was")
    if done.returncode < 0:
        return _crash(signal.Signals(-done.returncode), settings)
    return CleanupFailed(f"mesh cleanup: the child ended with {done.returncode}: {last}")


def _crash(died: signal.Signals, settings: CleanupSettings) -> CleanupFailed:
    if died is signal.SIGXCPU:
        return CleanupFailed(
            f"mesh cleanup: more than {settings.time_limit_s:g} s of processor time; decimate the "
            "mesh first, or raise the time limit"
        )
    why = ", perhaps for want of memory" if died is signal.SIGKILL else ""
    return CleanupFailed(
        f"mesh cleanup: pymeshlab crashed ({died.name}{why}); the mesh was left as it was, try it "
        "without remeshing or with a larger merge distance"
    )


def _result(folder: Path, mesh: Mesh, settings: CleanupSettings) -> tuple[Mesh, Work, float]:
    """Read what the child left, believing nothing of its form."""
    try:
        report = json.loads((folder / "report.json").read_text())
        with np.load(folder / "result.npz") as made:
            vertices, faces = made["vertices_mm"], made["faces"]
        work, peak = _work(report), float(report["peak_memory_mb"])
    except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as bad:
        raise _broken(f"it left no readable result ({bad})") from bad
    synthetic = _marks(np.asarray(vertices, dtype=np.float64), mesh, settings)
    return Mesh(vertices, faces, synthetic), work, peak


def _work(report: Mapping[str, Any]) -> Work:
    return Work(**{name: int(report.get(name, 0)) for name in Work.__dataclass_fields__})


def _broken(what: str) -> CleanupFailed:
    return CleanupFailed(
        f"mesh cleanup broke its promise: {what}; remesh with shorter edges, decimate to more "
        "faces, or leave both out"
    )


def _marks(vertices_mm: FloatArray, mesh: Mesh, settings: CleanupSettings) -> BoolArray:
    """Synthetic is what lies nearer to a synthetic vertex than to a measured one.

    Of vertices merged at one place the measured one wins: there is a point behind it.
    """
    if vertices_mm.ndim != 2 or vertices_mm.shape[1] != 3 or not np.all(np.isfinite(vertices_mm)):
        raise _broken("its vertices are no finite (n, 3)")
    used = np.unique(mesh.faces)
    made_up = mesh.synthetic[used]
    to_synthetic = _distances(vertices_mm, mesh.vertices_mm[used[made_up]])
    to_measured = _distances(vertices_mm, mesh.vertices_mm[used[~made_up]])
    reshaped = settings.remesh_edge_mm is not None or settings.decimate_to_faces is not None
    off = np.minimum(to_synthetic, to_measured)
    if not reshaped and np.any(off > settings.merge_within_mm):
        raise _broken(f"a vertex lies {off.max():.3g} mm from all of the mesh's own")
    return np.asarray(to_synthetic < to_measured)


def _distances(points_mm: FloatArray, among_mm: FloatArray) -> FloatArray:
    """Distance of each point to the nearest of some, infinite when there are none."""
    if len(among_mm) == 0:
        return np.full(len(points_mm), np.inf)
    return np.asarray(cKDTree(among_mm).query(points_mm)[0])


def _checked(cleaned: Mesh, before: Soundness) -> Soundness:
    """Hold the result against the promises; its soundness."""
    try:
        after = soundness(cleaned)
    except ValueError as malformed:
        raise _broken(str(malformed)) from malformed
    if after.faces == 0:
        raise _broken("no face is left")
    if not after.manifold:
        raise _broken(
            f"{after.nonmanifold_edges} edges and {after.nonmanifold_vertices} vertices are "
            "not manifold"
        )
    if not after.oriented:
        raise _broken(f"{after.misdirected_edges} edges join faces that look opposite ways")
    if before.watertight and not after.watertight:
        raise _broken(f"the mesh was closed, now {after.boundary_edges} edges are open")
    _check_volume(before, after)
    return after


def _check_volume(before: Soundness, after: Soundness) -> None:
    """Hold a closed mesh to its volume, within 1 %; one that was inside out is turned."""
    if after.watertight and after.volume_mm3 < 0:
        raise _broken("its faces look inward")
    was_mm3, is_mm3 = abs(before.volume_mm3), after.volume_mm3
    if not np.isnan(was_mm3) and not abs(is_mm3 - was_mm3) <= _VOLUME_SHARE * was_mm3:
        change = 100 * (is_mm3 / was_mm3 - 1) if was_mm3 > 0 else float("inf")
        raise _broken(
            f"the volume changed by {change:+.2f} %, {100 * _VOLUME_SHARE:g} % is allowed"
        )
