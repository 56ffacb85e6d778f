"""A scene becomes a picture: z-buffer, light, occlusion, mean of subpixels.

    Scene -> project -> visibility buffer (2h, 2w) -> light -> compose -> uint8 (h, w, 3)

No display and no GL: the same bytes on every run, on a server as in CI.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from loftscan.rendering.camera import Camera, View
from loftscan.rendering.compositing import (
    SUBPIXELS,
    compose,
    light_clouds,
    linear_light,
    nearest,
    occlusion,
    paper,
    studio,
)
from loftscan.rendering.lighting import (
    LightArray,
    light_beads,
    light_faces,
    light_segments,
    vertex_normals,
)
from loftscan.rendering.rasterising import (
    NOTHING,
    DepthArray,
    IdArray,
    draw_beads,
    draw_segments,
    draw_triangles,
)
from loftscan.rendering.scene import (
    CLAY,
    INK,
    Backdrop,
    ByteArray,
    Edges,
    MeshLayer,
    PointLayer,
    PolylineLayer,
    Scene,
    Shading,
)
from reconstruction.arrays import FloatArray
from reconstruction.meshing import Mesh

_EDGE_STRENGTH = 0.45
_OCCLUSION_REACH = 0.035  # of the picture's shorter side
_OUTLINE_STEP = 0.03  # of the camera's radius


@dataclass(frozen=True, slots=True, eq=False)
class _Canvas:
    """The buffers of one picture, all in subpixels; filled in place by the layers."""

    view: View
    nearness: DepthArray  # (2h, 2w)
    ids: IdArray  # (2h, 2w)
    lit: LightArray  # (2h, 2w, 3)


def render_scene(scene: Scene, *, camera: Camera, size_px: tuple[int, int]) -> ByteArray:
    """Draw all layers into one picture.

    Parameters
    ----------
    scene
        Meshes, points and polylines, in mm in one frame.
    camera
        Where the picture is taken from.
    size_px
        Width and height.

    Returns
    -------
    RGB bytes (height, width, 3).

    Raises
    ------
    ValueError
        If the size is not positive.
    """
    canvas = _canvas(camera, size_px)
    for first, layer in _numbered(scene):
        if isinstance(layer, MeshLayer):
            _draw_mesh(canvas, layer, first)
        elif isinstance(layer, PointLayer):
            _draw_points(canvas, layer, first, camera)
        else:
            _draw_polylines(canvas, layer, first)
    return _developed(canvas, scene, camera, size_px)


def render_mesh(
    mesh: Mesh,
    *,
    camera: Camera,
    size_px: tuple[int, int],
    colours: ByteArray | tuple[int, int, int] = CLAY,
    shading: Shading = Shading.SMOOTH,
    edges: Edges = Edges.HIDDEN,
    backdrop: Backdrop = Backdrop.STUDIO,
) -> ByteArray:
    """Picture (h, w, 3) of a mesh; colours (3,), a vertex (n, 3) or a face (m, 3)."""
    layer = MeshLayer(mesh, colours, shading, edges)
    return render_scene(Scene((layer,), backdrop=backdrop), camera=camera, size_px=size_px)


def render_points(
    points_mm: FloatArray,
    *,
    camera: Camera,
    size_px: tuple[int, int],
    colours: ByteArray | tuple[int, int, int] = INK,
    radius_px: float = 1.5,
    backdrop: Backdrop = Backdrop.STUDIO,
) -> ByteArray:
    """Picture (h, w, 3) of points (n, 3) in one colour, (3,), or one each, (n, 3)."""
    layer = PointLayer(points_mm, colours, radius_px)
    return render_scene(Scene(points=(layer,), backdrop=backdrop), camera=camera, size_px=size_px)


def _canvas(camera: Camera, size_px: tuple[int, int]) -> _Canvas:
    width, height = size_px
    if width < 1 or height < 1:
        raise ValueError(f"picture: the size must be positive, got {width} x {height} px")
    fine = (height * SUBPIXELS, width * SUBPIXELS)
    return _Canvas(
        view=camera.view((fine[1], fine[0])),
        nearness=np.full(fine, -np.inf, np.float32),
        ids=np.full(fine, NOTHING, np.int32),
        lit=np.empty((*fine, 3), np.float32),
    )


def _numbered(scene: Scene) -> Iterator[tuple[int, MeshLayer | PointLayer | PolylineLayer]]:
    """Each layer with the number of its first triangle, point or segment.

    A polyline's segments are numbered as its vertices are; the last one's number stays unused.
    """
    first = 0
    for mesh in scene.meshes:
        yield first, mesh
        first += len(mesh.mesh.faces)
    for points in scene.points:
        yield first, points
        first += len(points.points_mm)
    for lines in scene.polylines:
        yield first, lines
        first += sum(len(line) for line in lines.polylines_mm)


def _draw_mesh(canvas: _Canvas, layer: MeshLayer, first: int) -> None:
    view, vertices = canvas.view, layer.mesh.vertices_mm
    faces = layer.mesh.faces.astype(np.int32)
    screen = view.project(vertices)
    turned = (vertices - view.centre_mm) @ view.rotation.T
    smooth = layer.shading is Shading.SMOOTH
    light_faces_of = faces if smooth else faces[:0]
    normals = vertex_normals(turned, light_faces_of)[: len(vertices) if smooth else 0]
    draw_triangles(screen, faces, first, canvas.nearness, canvas.ids)
    colours, painted = _paint(layer, faces)
    edges = _EDGE_STRENGTH if layer.edges is Edges.DRAWN else 0.0
    light_faces(
        canvas.ids, first, screen, turned, normals, faces, colours, painted,
        view.inverse_distance, edges, canvas.lit,
    )  # fmt: skip


def _paint(layer: MeshLayer, faces: IdArray) -> tuple[LightArray, IdArray]:
    """Colours (k, 3) and which of them each corner has, (m, 3); vertices win where n = m."""
    colours = linear_light(np.atleast_2d(layer.colours))
    if np.ndim(layer.colours) == 1:
        return colours, np.zeros_like(faces)
    if len(colours) == len(layer.mesh.vertices_mm):
        return colours, faces
    return colours, np.repeat(np.arange(len(faces), dtype=np.int32), 3).reshape(-1, 3)


def _draw_points(canvas: _Canvas, layer: PointLayer, first: int, camera: Camera) -> None:
    screen = canvas.view.project(layer.points_mm)
    radius = layer.radius_px * SUBPIXELS
    height_mm = radius / canvas.view.scale_px_mm
    draw_beads(screen, radius, height_mm, first, canvas.nearness, canvas.ids)
    colours = linear_light(np.atleast_2d(layer.colours))
    light_beads(canvas.ids, first, screen, camera.radius_mm, colours, canvas.lit)


def _draw_polylines(canvas: _Canvas, layer: PolylineLayer, first: int) -> None:
    lengths = [len(line) for line in layer.polylines_mm]
    if not sum(lengths):
        return
    screen = canvas.view.project(np.concatenate(layer.polylines_mm))
    screen[:, 2] += layer.lift_mm
    ends = np.cumsum(lengths) - 1
    starts = np.setdiff1d(np.arange(len(screen)), ends).astype(np.int32)
    radius = layer.width_px * SUBPIXELS / 2
    draw_segments(screen, starts, radius, first, canvas.nearness, canvas.ids)
    owner = np.repeat(np.arange(len(lengths)), lengths)[starts]
    colours = linear_light(np.atleast_2d(layer.colours))
    own = colours[owner if np.ndim(layer.colours) == 2 else np.zeros_like(owner)]
    light_segments(canvas.ids, first, screen, starts, radius, own, canvas.lit)


def _developed(
    canvas: _Canvas, scene: Scene, camera: Camera, size_px: tuple[int, int]
) -> ByteArray:
    coarse = camera.view(size_px)
    near = nearest(canvas.nearness)
    light = occlusion(
        near,
        scale_px_mm=coarse.scale_px_mm,
        reach_px=max(2.0, _OCCLUSION_REACH * min(size_px)),
    )
    first, last = _bead_ids(scene)
    light_clouds(light, near, canvas.ids, first, last, 1.0 / coarse.scale_px_mm)
    if scene.backdrop is Backdrop.PAPER:
        behind = paper(size_px)
    else:
        behind = studio(size_px, coarse, camera, scene.meshes)
    step_mm = _OUTLINE_STEP * camera.radius_mm
    return compose(
        canvas.lit, canvas.ids, canvas.nearness, light, behind, step_mm=step_mm, outlined=first
    )


def _bead_ids(scene: Scene) -> tuple[int, int]:
    """Return the points' numbers as a half-open range; they follow the triangles'."""
    first = sum(len(layer.mesh.faces) for layer in scene.meshes)
    return first, first + sum(len(layer.points_mm) for layer in scene.points)
