"""Pictures of meshes, clouds and curves without GL or a display."""

from loftscan.rendering.camera import Axis, Camera, Lens, camera_around
from loftscan.rendering.drawing import render_mesh, render_points, render_scene
from loftscan.rendering.png import decode_png, encode_png
from loftscan.rendering.scene import (
    Backdrop,
    Edges,
    MeshLayer,
    PointLayer,
    PolylineLayer,
    Scene,
    Shading,
)

__all__ = [
    "Axis",
    "Backdrop",
    "Camera",
    "Edges",
    "Lens",
    "MeshLayer",
    "PointLayer",
    "PolylineLayer",
    "Scene",
    "Shading",
    "camera_around",
    "decode_png",
    "encode_png",
    "render_mesh",
    "render_points",
    "render_scene",
]
