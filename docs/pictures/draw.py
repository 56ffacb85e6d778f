"""Draw the README's picture: a cloud, its sections, its mesh.

Run it from the repository: ``python docs/pictures/draw.py``.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from noisy_vase import make_cloud

from loftscan import reconstruct
from loftscan.picturing import polylines, synthetic_faces
from loftscan.rendering import (
    Edges,
    MeshLayer,
    PointLayer,
    PolylineLayer,
    Scene,
    camera_around,
    encode_png,
    render_scene,
)

SIZE_PX = (520, 620)
CLAY, BRIDGED, POINT = (196, 203, 212), (226, 140, 45), (70, 120, 172)


def main() -> None:
    """Write vase.png beside this script."""
    result = reconstruct(make_cloud())
    camera = camera_around(result.mesh.vertices_mm, azimuth_rad=math.radians(10), zoom=1.12)
    colours = np.where(synthetic_faces(result)[:, None], BRIDGED, CLAY).astype(np.uint8)
    lines = tuple(line for section in result.sections[::2] for line in polylines(section))
    ramp = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(lines)), bytes=True)[:, :3]
    scenes = (
        Scene(points=(PointLayer(result.sample_mm, POINT, 1.1),)),
        Scene(polylines=(PolylineLayer(lines, ramp, 1.7),)),
        Scene(meshes=(MeshLayer(result.mesh, colours, edges=Edges.HIDDEN),)),
    )
    panels = [render_scene(scene, camera=camera, size_px=SIZE_PX) for scene in scenes]
    picture = np.concatenate(panels, axis=1)
    Path(__file__).with_name("vase.png").write_bytes(encode_png(picture))


if __name__ == "__main__":
    main()
