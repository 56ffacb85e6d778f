"""One picture of a run: a row a case, a column a method, coloured by the distance to the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.surface.cases import MODELS, RADIUS_MM, Case
from benchmarks.surface.measures import distances
from loftscan.rendering import Backdrop, Camera, Shading, render_mesh
from reconstruction.meshing import Mesh

Bytes = NDArray[np.uint8]

SIDE_PX = 420
LIMIT_MM = 0.5  # and 0.5 % of the diagonal of all cases but the cylinder
COLOURS = "viridis"


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """What stands in one place of the picture."""

    image: Bytes | None
    words: str


def draw_cell(mesh: trimesh.Trimesh, case: Case, words: str) -> Cell:
    """Draw a result in the place of its case."""
    low = case.points_mm.min(axis=0) - LIMIT_MM
    high = case.points_mm.max(axis=0) + LIMIT_MM
    model = case.name.split("+")[0] in MODELS
    camera = Camera(
        np.stack([low, high]), up="y" if model else "z", azimuth_rad=_azimuth(case), zoom=1.1
    )
    scale = ScalarMappable(Normalize(0.0, LIMIT_MM), COLOURS)
    colours = scale.to_rgba(_off(mesh, case), bytes=True)[:, :3]
    unmarked = np.zeros(len(mesh.vertices), dtype=np.bool_)
    image = render_mesh(
        Mesh(mesh.vertices, mesh.faces, unmarked),
        camera=camera, size_px=(SIDE_PX, SIDE_PX), colours=colours,
        shading=Shading.FLAT, backdrop=Backdrop.PAPER,
    )  # fmt: skip
    return Cell(image, words)


def _azimuth(case: Case) -> float:
    """Look into the cylinder's strip; at the others from a little left of the front."""
    if case.gaps:
        return case.gaps[0].start_rad + np.radians(36.0 / 2 + 25.0)
    return float(np.radians(35.0))


def _off(mesh: trimesh.Trimesh, case: Case) -> NDArray[np.float64]:
    vertices = np.asarray(mesh.vertices)
    if case.truth is None:
        return np.abs(np.hypot(vertices[:, 0], vertices[:, 1]) - RADIUS_MM)
    return distances(vertices, case.truth.solid())[0]


def write_picture(path: Path, rows: dict[str, dict[str, Cell]], methods: list[str]) -> None:
    """Write all cells as one PNG."""
    figure = Figure(figsize=(2.6 * len(methods), 3.0 * len(rows) + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), len(methods), squeeze=False)
    for line, (name, cells) in zip(axes, rows.items(), strict=True):
        for place, method in zip(line, methods, strict=True):
            cell = cells.get(method, Cell(None, "not run"))
            place.set_xticks([])
            place.set_yticks([])
            place.set_frame_on(False)
            place.set_title(f"{name}: {method}" if cell.image is not None else method, fontsize=7)
            place.set_xlabel(cell.words, fontsize=7)
            if cell.image is None:
                place.text(0.5, 0.5, "\n".join(_wrapped(cell.words)), ha="center", fontsize=7)
                place.set_xlabel("")
            else:
                place.imshow(cell.image)
    bar = ScalarMappable(Normalize(0.0, LIMIT_MM), COLOURS)
    figure.colorbar(
        bar, ax=axes, orientation="horizontal", shrink=0.4, aspect=50, extend="max",
        label="distance to the truth: % of the diagonal; cylinder: mm, radial",
    )  # fmt: skip
    figure.savefig(path, dpi=130)


def _wrapped(words: str, width: int = 34) -> list[str]:
    return [words[k : k + width] for k in range(0, len(words), width)]
