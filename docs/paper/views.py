"""The paper's figures in space: the cylinder (7, 8) and the cone (9 to 11)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from solids import Made, sample_section

from loftscan.figures import INK
from loftscan.rendering import (
    Backdrop,
    Camera,
    Edges,
    Lens,
    MeshLayer,
    PointLayer,
    PolylineLayer,
    Scene,
    Shading,
    camera_around,
    render_scene,
)
from loftscan.rendering.scene import ByteArray
from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.lofting import split_runs
from reconstruction.pipeline import Reconstruction
from reconstruction.sections import Section

_SIZE_PX = (520, 470)
_TITLE_PX = 34
_DOTS_PER_INCH = 130
_DOT = (58, 104, 152)
_CLAY = (188, 196, 206)
_BRIDGED = (222, 135, 40)
_PAIRED = (230, 170, 60)
_ZOOM = 1.2  # a box around a round part is fitted with room to spare
_AZIMUTH = math.radians(-58)

Panel = tuple[ByteArray, str]


def plate(panels: Sequence[Panel]) -> Figure:
    """Pictures side by side, pixel for pixel, each under its own title."""
    height = panels[0][0].shape[0] + _TITLE_PX
    width = sum(image.shape[1] for image, _ in panels)
    figure = Figure((width / _DOTS_PER_INCH, height / _DOTS_PER_INCH), dpi=_DOTS_PER_INCH)
    left = 0
    for image, title in panels:
        figure.figimage(image, xo=left, yo=0, resize=False)
        place = (left + 8) / width
        figure.text(place, 1 - 0.5 * _TITLE_PX / height, title, size=9.5, va="center", color=INK)
        left += image.shape[1]
    return figure


def figure_7(made: Made) -> Figure:
    """The cylinder's cloud, and its five sections with the bridged stretches in orange."""
    camera = _camera(made, elevation_deg=24)
    cloud = _shoot(_drawing(points=(PointLayer(made.cloud_mm, _DOT, 1.15),)), camera)
    faint = PointLayer(made.cloud_mm, (205, 212, 218), 0.8)
    scene = _drawing(points=(faint,), polylines=_curves(made.plain))
    return plate(
        [
            (cloud, f"Fig. 7. {len(made.cloud_mm)} points, five slices"),
            (_shoot(scene, camera), "NURBS sections; orange: bridged, no points"),
        ]
    )


def figure_8(made: Made) -> Figure:
    """The cylinder's mesh, what of it is synthetic, and the rendering."""
    camera = _camera(made, elevation_deg=24)
    mesh = made.plain.mesh
    synthetic = mesh.synthetic[mesh.faces].any(axis=1) & ~_is_cap(made.plain)
    colours = np.where(synthetic[:, None], _BRIDGED, _CLAY).astype(np.uint8)
    layer = MeshLayer(mesh, colours, Shading.FLAT, Edges.DRAWN)
    return plate(
        [
            (_shoot(Scene((layer,)), camera), "Mesh of five slices; orange: across empty regions"),
            (_shoot(Scene((MeshLayer(made.smooth.mesh),)), camera), "Fig. 8. Rendered"),
        ]
    )


def figure_9(made: Made) -> Figure:
    """The cone's cloud from above and in space."""
    above = camera_around(
        made.cloud_mm, azimuth_rad=_AZIMUTH, elevation_rad=math.pi / 2, lens=Lens.ORTHOGRAPHIC,
        zoom=1.3,
    )  # fmt: skip
    dots = _drawing(points=(PointLayer(made.cloud_mm, _DOT, 0.9),))
    return plate(
        [
            (_in_few_colours(_shoot(dots, above)), "Fig. 9a. Top view"),
            (
                _in_few_colours(_shoot(dots, _camera(made))),
                f"Fig. 9b. {len(made.cloud_mm)} points in space",
            ),
        ]
    )


def figure_10(made: Made) -> Figure:
    """The cone's curves, one colour a base curve, and its mesh, pair-connected bands in orange."""
    camera = _camera(made)
    runs = split_runs(made.plain.sections)
    shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(runs)), bytes=True)[:, :3]
    lines = [_closed(section) for run in runs for section in run]
    colours = np.repeat(shades, [len(run) for run in runs], axis=0)
    curves = _drawing(polylines=(PolylineLayer(tuple(lines), colours, 2.2),))
    return plate(
        [
            (_shoot(curves, camera), "Fig. 10a. NURBS curves; a colour: one count of CP"),
            (draw_pairs(made.plain, camera), "Fig. 10b. Mesh; orange: connected in pairs"),
        ]
    )


def figure_11(made: Made) -> Figure:
    """The cone rendered, and its truncated apex from near."""
    top = made.plain.sections[-6:]
    near = camera_around(
        *(section.knot_points_mm for section in top), azimuth_rad=_AZIMUTH, zoom=1.0
    )
    return plate(
        [
            (_shoot(Scene((MeshLayer(made.smooth.mesh),)), _camera(made)), "Fig. 11. Rendered"),
            (
                draw_pairs(made.plain, near, backdrop=Backdrop.PAPER),
                "The apex enlarged: a flat cap ends the mesh",
            ),
        ]
    )


def draw_pairs(
    done: Reconstruction, camera: Camera, *, backdrop: Backdrop = Backdrop.STUDIO
) -> ByteArray:
    """The mesh with its edges, bands between sections of unequal count in orange."""
    paired = between_runs(done)
    colours = np.where(paired[:, None], _PAIRED, _CLAY).astype(np.uint8)
    layer = MeshLayer(done.mesh, colours, Shading.FLAT, Edges.DRAWN)
    return _shoot(Scene((layer,), backdrop=backdrop), camera)


def between_runs(done: Reconstruction) -> BoolArray:
    """Faces of the pair-connected bands, (m,); level sections only."""
    heights = done.mesh.vertices_mm[done.mesh.faces, 2]
    low, high = heights.min(axis=1), heights.max(axis=1)
    found = np.zeros(len(heights), dtype=np.bool_)
    runs = split_runs(done.sections)
    for before, after in pairwise(runs):
        bottom, top = before[-1].height_mm, after[0].height_mm
        found |= (low >= bottom - 1e-9) & (high <= top + 1e-9) & (high - low > 1e-9)
    return np.asarray(found)


def _is_cap(done: Reconstruction) -> BoolArray:
    """Faces whose three corners lie in an end section's plane, (m,)."""
    flat = np.zeros(len(done.mesh.faces), dtype=np.bool_)
    for section in (done.sections[0], done.sections[-1]):
        height = section.frame.to_plane(done.mesh.vertices_mm)[:, 2]
        flat |= (np.abs(height) < 1e-6)[done.mesh.faces].all(axis=1)
    return np.asarray(flat)


def _camera(made: Made, *, elevation_deg: float = 20.0) -> Camera:
    return camera_around(
        made.cloud_mm,
        azimuth_rad=_AZIMUTH,
        elevation_rad=math.radians(elevation_deg),
        zoom=_ZOOM,
    )


def _drawing(
    points: tuple[PointLayer, ...] = (), polylines: tuple[PolylineLayer, ...] = ()
) -> Scene:
    """Clouds and curves stand on white, as in the paper."""
    return Scene(points=points, polylines=polylines, backdrop=Backdrop.PAPER)


def _shoot(scene: Scene, camera: Camera) -> ByteArray:
    return render_scene(scene, camera=camera, size_px=_SIZE_PX)


def _in_few_colours(image: ByteArray) -> ByteArray:
    """Sixteen steps a channel, white kept: a cloud's dots fill the file with shades, else."""
    return np.asarray((image.astype(np.uint16) + 8) // 17 * 17, dtype=np.uint8)


def _closed(section: Section) -> FloatArray:
    points, _, _ = sample_section(section)
    return np.vstack([points, points[:1]])


def _curves(done: Reconstruction) -> tuple[PolylineLayer, ...]:
    """Section curves, their bridged stretches in another colour."""
    measured: list[FloatArray] = []
    bridged: list[FloatArray] = []
    for section in done.sections:
        points, inside, _ = sample_section(section)
        ring = np.vstack([points, points[:1]])
        changes = np.flatnonzero(np.diff(inside.astype(int))) + 1
        edges = [0, *changes.tolist(), len(points)]
        for first, last in pairwise(edges):
            (bridged if inside[first] else measured).append(ring[first : last + 1])
    return (
        PolylineLayer(tuple(measured), _DOT, 2.4, lift_mm=2.5),
        PolylineLayer(tuple(bridged), _BRIDGED, 3.2, lift_mm=3.0),
    )
