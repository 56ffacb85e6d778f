"""What is in a picture: layers of triangles, points and lines, and the backdrop."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruction.arrays import FloatArray, frozen
from reconstruction.meshing import Mesh

ByteArray = NDArray[np.uint8]

CLAY: tuple[int, int, int] = (176, 190, 204)  # a cool matt grey: shape shows, nothing else does
INK: tuple[int, int, int] = (70, 120, 172)


class Shading(Enum):
    """How light follows the triangles."""

    FLAT = "flat"  # every triangle is seen
    SMOOTH = "smooth"  # normals are averaged, except over creases


class Edges(Enum):
    """Whether the triangles' edges are drawn over the surface."""

    HIDDEN = "hidden"
    DRAWN = "drawn"


class Backdrop(Enum):
    """What stands behind."""

    PAPER = "paper"  # plain white
    STUDIO = "studio"  # a soft grey, and the shadow of the meshes on a floor


@dataclass(frozen=True, slots=True, eq=False)
class MeshLayer:
    """A mesh with one colour, or one a vertex, or one a face."""

    mesh: Mesh
    colours: ByteArray | tuple[int, int, int] = CLAY  # (3,), (n, 3) or (m, 3)
    shading: Shading = Shading.SMOOTH
    edges: Edges = Edges.HIDDEN

    def __post_init__(self) -> None:
        vertices, faces = self.mesh.vertices_mm, self.mesh.faces
        _check_columns("mesh vertices", vertices)
        _check_columns("mesh faces", faces)
        if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
            raise ValueError(f"mesh: a face points outside the {len(vertices)} vertices")
        colours = _colours(self.colours)
        if colours.shape not in {(3,), (len(vertices), 3), (len(faces), 3)}:
            raise ValueError(
                f"mesh: colours {colours.shape} fit neither {len(vertices)} vertices "
                f"nor {len(faces)} faces"
            )
        object.__setattr__(self, "colours", colours)


@dataclass(frozen=True, slots=True, eq=False)
class PointLayer:
    """Points as small round beads of one size on the screen."""

    points_mm: FloatArray  # (n, 3)
    colours: ByteArray | tuple[int, int, int] = INK  # (3,) or (n, 3)
    radius_px: float = 1.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_mm", frozen(self.points_mm))
        _check_columns("points", self.points_mm)
        colours = _colours(self.colours)
        if colours.shape not in {(3,), self.points_mm.shape} or not self.radius_px > 0:
            raise ValueError(
                f"points: {len(self.points_mm)} points need as many colours or one, "
                f"got {colours.shape}, and a positive radius, got {self.radius_px} px"
            )
        object.__setattr__(self, "colours", colours)


@dataclass(frozen=True, slots=True, eq=False)
class PolylineLayer:
    """Lines of one width on the screen, hidden by what is before them.

    `lift_mm` brings them that far towards the eye, so that a line on a surface is not half in it.
    """

    polylines_mm: tuple[FloatArray, ...]  # each (k, 3)
    colours: ByteArray | tuple[int, int, int] = INK  # (3,), or one a polyline
    width_px: float = 2.0
    lift_mm: float = 0.0

    def __post_init__(self) -> None:
        lines = tuple(frozen(line) for line in self.polylines_mm)
        for line in lines:
            _check_columns("polyline", line)
        colours = _colours(self.colours)
        if colours.shape not in {(3,), (len(lines), 3)} or not self.width_px > 0:
            raise ValueError(
                f"polylines: {len(lines)} lines need as many colours or one, "
                f"got {colours.shape}, and a positive width, got {self.width_px} px"
            )
        object.__setattr__(self, "polylines_mm", lines)
        object.__setattr__(self, "colours", colours)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything in one picture; all layers hide each other by depth."""

    meshes: tuple[MeshLayer, ...] = ()
    points: tuple[PointLayer, ...] = ()
    polylines: tuple[PolylineLayer, ...] = ()
    backdrop: Backdrop = Backdrop.STUDIO


def _colours(colours: ArrayLike) -> ByteArray:
    given = np.asarray(colours)
    if given.dtype.kind not in "iu" or (
        given.size and not (0 <= given.min() <= given.max() <= 255)
    ):
        raise ValueError(f"colours must be whole numbers from 0 to 255, got {given.dtype}")
    return frozen(given, np.uint8)


def _check_columns(name: str, values: NDArray[np.generic]) -> None:
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(f"{name}: shape (n, 3) expected, got {values.shape}")
