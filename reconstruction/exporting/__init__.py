r"""Files that other programs open: the NURBS as JSON, STEP, IGES, 3DM; the mesh as STL, PLY, GLB.

::

    surface_json  sections_json       step  iges           threedm       meshes
          \        /                    \    /                |             |
          documents                 solids (checked)          |             |
               |                      |      \_____ bodies ___|             |
               |                    brep (Open CASCADE)       |             |
               \__________ knots _____/_______________________/             |
          provenance, atomic: under all of them ____________________________/
"""

from reconstruction.exporting.bodies import Body, Closing, bodies_of, flat_caps
from reconstruction.exporting.iges import write_iges, write_iges_solid
from reconstruction.exporting.meshes import write_glb, write_ply, write_stl
from reconstruction.exporting.sections_json import (
    SectionRecord,
    read_sections_json,
    sections_document,
    write_sections_json,
)
from reconstruction.exporting.solids import Solidity
from reconstruction.exporting.step import read_step, write_step, write_step_solid
from reconstruction.exporting.surface_json import (
    read_surface_json,
    surface_document,
    write_surface_json,
)
from reconstruction.exporting.threedm import read_threedm, write_threedm

__all__ = [
    "Body",
    "Closing",
    "SectionRecord",
    "Solidity",
    "bodies_of",
    "flat_caps",
    "read_sections_json",
    "read_step",
    "read_surface_json",
    "read_threedm",
    "sections_document",
    "surface_document",
    "write_glb",
    "write_iges",
    "write_iges_solid",
    "write_ply",
    "write_sections_json",
    "write_step",
    "write_step_solid",
    "write_stl",
    "write_surface_json",
    "write_threedm",
]
