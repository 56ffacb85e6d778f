"""The process that runs pymeshlab for `cleanup`; started by file path, it imports nothing of ours.

It works in its current directory, which the parent made and will remove::

    request.json  settings      report.json   what was done, or
    request.npz   vertices_mm,  failure.json  kind (missing, memory, unsettled, refused) and message
                  faces         result.npz    vertices_mm, faces

The limits are set before numpy and pymeshlab are imported: a limit that comes after an allocation
holds nothing back. The processor-time limit ends this process even when its parent was killed.
"""

from __future__ import annotations

import importlib
import json
import resource
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    import numpy as np
    from numpy.typing import NDArray

MeshSet: TypeAlias = Any  # pymeshlab comes without types

_ALL_FILTERS = 280  # of pymeshlab 2025.7; with libgl1 but no libopengl0 it offers 235, silently
_MOST_PASSES = 10
_REMESH_ITERATIONS = 5
_FLAT_BELOW_MM = 1e-9  # the height below which a face is flat, as in soundness.py
_NEEDLE = 1e6  # longest edge over height of the faces that may be flipped away


class Failure(Exception):  # noqa: N818 (it is written down, not caught by others)
    """What ends the work; `kind` tells the parent whose fault it is."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def main() -> int:
    """Do the request of the current directory; 0, or 1 with a failure.json."""
    request = json.loads(Path("request.json").read_text())
    _limit(request)
    try:
        report = _work(request)
    except Failure as failure:
        return _fail(failure.kind, str(failure))
    except MemoryError:
        return _fail("memory", "out of memory")
    Path("report.json").write_text(json.dumps(report))
    return 0


def _fail(kind: str, message: str) -> int:
    Path("failure.json").write_text(json.dumps({"kind": kind, "message": message}))
    return 1


def _limit(request: dict[str, Any]) -> None:
    """Bound memory and processor time of this process."""
    memory = int(request["memory_limit_mb"] * 2**20)
    seconds = int(request["time_limit_s"]) + 2
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))


def _work(request: dict[str, Any]) -> dict[str, Any]:
    pymeshlab = _pymeshlab()
    import numpy as np

    with np.load("request.npz") as given:
        vertices, faces = given["vertices_mm"], given["faces"]
    meshes = pymeshlab.MeshSet(verbose=False)
    try:
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
        report = _clean(pymeshlab, meshes, request)
    except pymeshlab.PyMeshLabException as refusal:
        kind = "memory" if "bad_alloc" in str(refusal) else "refused"
        raise Failure(kind, " ".join(str(refusal).split())) from refusal
    done = meshes.current_mesh()
    done.compact()
    np.savez("result.npz", vertices_mm=done.vertex_matrix(), faces=done.face_matrix())
    return report | {"peak_memory_mb": _peak_memory_mb()}


def _pymeshlab() -> ModuleType:
    """Import pymeshlab whole, or say which part of the system it lacks."""
    try:
        pymeshlab = importlib.import_module("pymeshlab")
    except ImportError as unloaded:
        raise Failure(_why_unloaded(unloaded), str(unloaded)) from unloaded
    filters = len(pymeshlab.filter_list())
    if filters < _ALL_FILTERS:
        message = f"only {filters} of at least {_ALL_FILTERS} filters loaded"
        raise Failure("missing", message)
    return pymeshlab


def _why_unloaded(unloaded: ImportError) -> str:
    """Tell a library that is not there from one for which no address space was left."""
    absent = isinstance(unloaded, ModuleNotFoundError) or "cannot open" in str(unloaded)
    return "missing" if absent else "memory"


def _clean(pymeshlab: ModuleType, meshes: MeshSet, request: dict[str, Any]) -> dict[str, Any]:
    """Weld, repair until nothing changes, and remesh and decimate where asked; what was done."""
    done = {"merged_vertices": _weld(pymeshlab, meshes, request["merge_within_mm"])}
    _repair(meshes, request["max_hole_edges"], done)
    length_mm, most_faces = request["remesh_edge_mm"], request["decimate_to_faces"]
    done["remeshed"] = int(length_mm is not None)
    if length_mm is not None:
        meshes.meshing_isotropic_explicit_remeshing(
            targetlen=pymeshlab.PureValue(length_mm), iterations=_REMESH_ITERATIONS
        )
        _repair(meshes, request["max_hole_edges"], done)
    before = _faces(meshes)
    if most_faces is not None and before > most_faces:
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=most_faces,
            preservetopology=True,
            preserveboundary=True,
            preservenormal=True,
            planarquadric=True,
        )
        _repair(meshes, request["max_hole_edges"], done)
    done["decimated_faces"] = max(0, before - _faces(meshes))
    return done


def _weld(pymeshlab: ModuleType, meshes: MeshSet, within_mm: float) -> int:
    """Merge vertices; once only, for the repairs separate what must not be merged again."""
    before = _vertices(meshes)
    meshes.meshing_remove_duplicate_vertices()
    if within_mm > 0:
        meshes.meshing_merge_close_vertices(threshold=pymeshlab.PureValue(within_mm))
    return before - _vertices(meshes)


def _repair(meshes: MeshSet, max_hole_edges: int, done: dict[str, int]) -> None:
    """Repeat until a pass changes nothing: closing a hole can make an edge non-manifold again."""
    before = _state(meshes)
    for _ in range(_MOST_PASSES):
        _pass(meshes, max_hole_edges, done)
        _count(done, "passes", 1)
        after = _state(meshes)
        if after == before:
            return
        before = after
    raise Failure("unsettled", f"still changing after {_MOST_PASSES} passes")


def _pass(meshes: MeshSet, max_hole_edges: int, done: dict[str, int]) -> None:
    """Repair once; holes are closed before fans are split, for the split tears a hole further."""
    _count(done, "duplicate_faces", _lost(meshes, meshes.meshing_remove_duplicate_faces))
    _count(done, "flipped_faces", _flip(meshes))
    _count(done, "degenerate_faces", _lost(meshes, meshes.meshing_remove_null_faces))
    _count(done, "nonmanifold_faces", _lost(meshes, meshes.meshing_repair_non_manifold_edges))
    _count(done, "reoriented_faces", _orient(meshes))
    if max_hole_edges > 0:
        holes = meshes.meshing_close_holes(maxholesize=max_hole_edges)
        _count(done, "holes_closed", holes["closed_holes"])
        _count(done, "hole_faces", holes["new_faces"])
    before = _vertices(meshes)
    meshes.meshing_repair_non_manifold_vertices()
    _count(done, "split_vertices", _vertices(meshes) - before)
    before = _vertices(meshes)
    meshes.meshing_remove_unreferenced_vertices()
    _count(done, "unused_vertices", before - _vertices(meshes))


def _flip(meshes: MeshSet) -> int:
    """Flip flat faces away: to remove one would open the mesh along its long edge."""
    before = _flat(meshes)
    if before == 0:
        return 0
    if meshes.get_topological_measures()["non_two_manifold_edges"] == 0:
        meshes.meshing_remove_t_vertices(method="Edge Flip", threshold=_NEEDLE, repeat=True)
    return before - _flat(meshes)


def _flat(meshes: MeshSet) -> int:
    """Count the faces of three different vertices but without height."""
    import numpy as np

    mesh = meshes.current_mesh()
    corners = mesh.vertex_matrix()[mesh.face_matrix()]
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    flat = areas <= _FLAT_BELOW_MM * lengths.max(axis=1, initial=0.0)
    return int(np.sum(flat & (lengths.min(axis=1, initial=np.inf) > 0)))


def _orient(meshes: MeshSet) -> int:
    """Make the faces agree, and look outward where that can be told; how many were turned."""
    before = meshes.current_mesh().face_matrix()
    meshes.meshing_re_orient_faces_coherently()
    mesh = meshes.current_mesh()
    if mesh.face_number() > 0 and _volume(mesh.vertex_matrix(), mesh.face_matrix()) < 0:
        closed = meshes.get_topological_measures()["boundary_edges"] == 0
        if closed:
            meshes.meshing_invert_face_orientation(forceflip=True)
    after = meshes.current_mesh().face_matrix()
    return int((_rotated(before) != _rotated(after)).any(axis=1).sum())


def _rotated(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Turn each face in its cycle so that the lowest vertex comes first."""
    import numpy as np

    turned = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turned, axis=1)


def _volume(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> float:
    import numpy as np

    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _state(meshes: MeshSet) -> tuple[int, int, int]:
    """Vertices, faces, and a sum over the faces that does not depend on their order."""
    import numpy as np

    faces = _rotated(meshes.current_mesh().face_matrix()).astype(np.uint64)
    # Odd constants of splitmix64; products wrap around, as they should.
    mixed = faces[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ faces[:, 1] * np.uint64(
        0xBF58476D1CE4E5B9
    )
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0x94D049BB133111EB)
    mixed ^= faces[:, 2] * np.uint64(0xD6E8FEB86659FD93)
    return _vertices(meshes), len(faces), int((mixed * mixed).sum(dtype=np.uint64))


def _lost(meshes: MeshSet, remove: Callable[[], object]) -> int:
    """Run a filter, count the faces that are gone after it."""
    before = _faces(meshes)
    remove()
    return before - _faces(meshes)


def _count(done: dict[str, int], name: str, amount: int) -> None:
    done[name] = done.get(name, 0) + int(amount)


def _vertices(meshes: MeshSet) -> int:
    return int(meshes.current_mesh().vertex_number())


def _faces(meshes: MeshSet) -> int:
    return int(meshes.current_mesh().face_number())


def _peak_memory_mb() -> float:
    """Largest resident memory so far.

    On Linux getrusage starts a child with its parent's peak, so the kernel's own mark is read.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 1024


if __name__ == "__main__":
    sys.exit(main())
