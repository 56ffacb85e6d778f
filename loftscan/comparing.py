"""The verb `compare`: how far one thing lies from another, as numbers, pictures and a verdict."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from loftscan.inputs import Unit, open_input
from loftscan.rendering import Axis
from loftscan.result import appearing_whole
from reconstruction.arrays import FloatArray
from reconstruction.comparison import Align, Deviation, compare_clouds, compare_to_mesh
from reconstruction.errors import UnreadableCloud
from reconstruction.meshing import Mesh

MESHES = (".stl", ".obj", ".off", ".ply")
MARKS = ("comparison.json", "deviation.ply")  # files that tell the folder of a comparison
_RESULT_MESH = "mesh.ply"


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """One side of a comparison: a mesh, or the points of a cloud."""

    name: str
    mesh: Mesh | None
    points_mm: FloatArray  # (n, 3) of the cloud, or the vertices of the mesh
    up: Axis | None = None  # the stacking axis, where a result folder says it

    @property
    def kind(self) -> str:
        """What it is, in a word."""
        return "mesh" if self.mesh is not None else "cloud"


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What `compare` returns: a deviation for every measured point."""

    measured: Thing  # whose points were measured
    reference: Thing
    deviation: Deviation

    @property
    def up(self) -> Axis:
        """Which axis points upwards in pictures: what a result folder says, else z."""
        return self.measured.up or self.reference.up or "z"

    @property
    def points_mm(self) -> FloatArray:
        """The measured points where they were compared, (n, 3): after the alignment, if any."""
        found = self.deviation.alignment
        if found is None:
            return self.measured.points_mm
        turned = self.measured.points_mm @ found.transform[:3, :3].T
        return np.asarray(turned + found.transform[:3, 3])

    @property
    def metrics(self) -> dict[str, object]:
        """The numbers of comparison.json."""
        found, verdict = self.deviation.alignment, self.deviation.verdict
        numbers = self.deviation.statistics
        return {
            "unit": "mm",
            "measured": {"name": self.measured.name, "kind": self.measured.kind},
            "reference": {"name": self.reference.name, "kind": self.reference.kind},
            "method": self.deviation.method.value,
            "points": numbers.count,
            "points_set_aside": numbers.set_aside,
            "points_on_border": numbers.on_border,
            "mean_mm": _finite(numbers.mean_mm),
            "rms_mm": _finite(numbers.rms_mm),
            "std_mm": _finite(numbers.std_mm),
            "median_mm": _finite(numbers.median_mm),
            "absolute_95_mm": _finite(numbers.absolute_95_mm),
            "min_mm": _finite(numbers.min_mm),
            "max_mm": _finite(numbers.max_mm),
            "alignment": None
            if found is None
            else {
                "transform": found.transform.tolist(),
                "rotation_rad": found.rotation_rad,
                "translation_mm": found.translation_mm,
                "converged": found.converged,
                "held_freedoms": found.held_freedoms,
                "rms_mm": found.rms_mm,
                "points": found.points,
            },
            "verdict": None
            if verdict is None
            else {
                "within": verdict.within,
                "tolerance_mm": verdict.tolerance_mm,
                "share_within": verdict.share_within,
                "required_share": verdict.required_share,
                "rule": verdict.rule,
            },
        }

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write comparison.json, deviation.ply (a distance for every point) and report.html."""
        from loftscan.comparison_report import write_comparison_report

        target = Path(folder)
        with appearing_whole(target, overwrite=overwrite, marks=MARKS) as partial:
            text = json.dumps(self.metrics, indent=2) + "\n"
            (partial / "comparison.json").write_text(text, encoding="utf-8")
            _write_deviation(partial / "deviation.ply", self)
            write_comparison_report(partial / "report.html", self)
        return target


def compare_things(
    a: Path | str | ArrayLike,
    b: Path | str | ArrayLike,
    *,
    align: Align,
    tolerance_mm: float | None,
    unit: Unit,
) -> Comparison:
    """Compare what two names stand for; see `loftscan.compare`."""
    if tolerance_mm is not None and not 0.0 < tolerance_mm < math.inf:
        raise ValueError(f"--tolerance-mm {tolerance_mm:g}: a length above 0 mm is expected")
    measured, reference = open_thing(a, unit), open_thing(b, unit)
    if reference.mesh is None and measured.mesh is not None:
        # A cloud has no inside: the signed answer is that of its points against the mesh.
        measured, reference = reference, measured
    if reference.mesh is not None:
        deviation = compare_to_mesh(
            measured.points_mm, reference.mesh, align=align, tolerance_mm=tolerance_mm
        )
    elif align is Align.NONE:
        deviation = compare_clouds(
            measured.points_mm, reference.points_mm, tolerance_mm=tolerance_mm
        )
    else:
        raise ValueError("--align best-fit: two clouds have no surface to fit to; use a mesh for B")
    return Comparison(measured, reference, deviation)


def open_thing(source: Path | str | ArrayLike, unit: Unit) -> Thing:
    """Open a cloud, a mesh or a result folder, or wrap an (n, 3) array.

    Raises
    ------
    UnreadableCloud
        One line that names the file and what is wrong with it.
    """
    if not isinstance(source, (str, Path)):
        return _open_cloud(source, unit)
    path = Path(source)
    if path.is_dir():
        if not (path / _RESULT_MESH).exists():
            raise UnreadableCloud(f"{path}: no {_RESULT_MESH} in it; is it a result folder?")
        opened = _open_mesh(path / _RESULT_MESH, path.name, Unit.MM)
        return replace(opened, up=_stacking_axis(path / "provenance.json"))
    if path.suffix.lower() in MESHES and path.is_file() and _has_faces(path):
        return _open_mesh(path, path.name, unit)
    return _open_cloud(path, unit)


def _stacking_axis(path: Path) -> Axis | None:
    """The axis of a result folder's settings; None for a folder that does not say it."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))["settings"]["axis"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    letters: dict[str, Axis] = {"x": "x", "y": "y", "z": "z"}
    return letters.get(said)


def _has_faces(path: Path) -> bool:
    if path.suffix.lower() != ".ply":
        return True
    with path.open("rb") as file:
        head = file.read(65536).partition(b"end_header")[0]
    return any(
        line.split()[:2] == [b"element", b"face"] and line.split()[-1] != b"0"
        for line in head.splitlines()
    )


# Of rubbish trimesh makes any of these, ImportError where it would guess a text's encoding.
_MISREAD = (ValueError, IndexError, KeyError, TypeError, AttributeError, ImportError, OSError)


def _open_mesh(path: Path, name: str, unit: Unit) -> Thing:
    import trimesh

    try:
        # Merging equal vertices gives an .stl its edges back; nothing else may be changed.
        loaded = trimesh.load_mesh(path, process=False)
        loaded.merge_vertices(merge_tex=True, merge_norm=True)
        vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces)
    except _MISREAD as error:
        why = " ".join(str(error).split()) or "it is damaged"
        raise UnreadableCloud(
            f"{path}: is no mesh that can be read ({why}); export it again"
        ) from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise UnreadableCloud(f"{path}: has no faces, or vertices that are no numbers")
    vertices = vertices * unit.in_mm
    mesh = Mesh(vertices, faces, np.zeros(len(vertices), dtype=np.bool_))
    return Thing(name, mesh, mesh.vertices_mm)


def _open_cloud(source: Path | str | ArrayLike, unit: Unit) -> Thing:
    with open_input(source, unit) as opened:
        points = np.concatenate(list(opened.chunks()))
        return Thing(opened.name, None, points)


def _write_deviation(path: Path, comparison: Comparison) -> None:
    points = comparison.points_mm
    rows = np.empty(len(points), dtype=[("p", "<f8", 3), ("d", "<f4")])
    rows["p"], rows["d"] = points, comparison.deviation.distances_mm
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment loftscan deviation, unit: mm\n"
        f"comment {comparison.deviation.method.value}\nelement vertex {len(points)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty float deviation_mm\n"
        "end_header\n"
    )
    with path.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(rows.data)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
