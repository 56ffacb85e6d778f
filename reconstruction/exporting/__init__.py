r"""Files that other programs open: the NURBS as JSON, STEP, IGES, 3DM; the mesh as STL, PLY, GLB.

::

    surface_json  sections_json       step  iges           threedm       meshes
          \        /                    \    /                |             |
          documents                     brep (Open CASCADE)   |             |
               \__________ knots _________/___________________/             |
          provenance, atomic: under all of them ____________________________/
"""

from reconstruction.exporting.iges import write_iges
from reconstruction.exporting.meshes import write_glb, write_ply, write_stl
from reconstruction.exporting.sections_json import (
    SectionRecord,
    read_sections_json,
    sections_document,
    write_sections_json,
)
from reconstruction.exporting.step import read_step, write_step
from reconstruction.exporting.surface_json import (
    read_surface_json,
    surface_document,
    write_surface_json,
)
from reconstruction.exporting.threedm import read_threedm, write_threedm

__all__ = [
    "SectionRecord",
    "read_sections_json",
    "read_step",
    "read_surface_json",
    "read_threedm",
    "sections_document",
    "surface_document",
    "write_glb",
    "write_iges",
    "write_ply",
    "write_sections_json",
    "write_step",
    "write_stl",
    "write_surface_json",
    "write_threedm",
]
