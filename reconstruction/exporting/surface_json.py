"""surface.json: every NURBS patch to the last bit, for programs that know no CAD format.

The format is described in docs/surface-json.md and by surface.schema.json beside this module.
Floats are written in the shortest form that reads back to the same 64 bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from reconstruction.exporting.documents import Field, checked, read_document, write_document
from reconstruction.exporting.provenance import plain
from reconstruction.nurbs.values import Surface

FORMAT = "loftscan.surface"
VERSION = 1


def surface_document(
    surfaces: Sequence[Surface], *, name: str, provenance: Mapping[str, object]
) -> dict[str, object]:
    """Every patch as lists and numbers that JSON can say.

    Parameters
    ----------
    surfaces
        Patches in the part frame, in order along the loft.
    provenance
        Anything JSON knows; a `Path` is cut to its last part.
    """
    return {
        "format": FORMAT,
        "version": VERSION,
        "unit": "mm",
        "name": name,
        "provenance": plain(provenance),
        "patches": [_patch(surface) for surface in surfaces],
    }


def write_surface_json(
    path: Path | str,
    surfaces: Sequence[Surface],
    *,
    name: str,
    provenance: Mapping[str, object],
) -> None:
    """Write `surface_document`; the file appears whole or not at all."""
    write_document(path, surface_document(surfaces, name=name, provenance=provenance))


def read_surface_json(path: Path | str) -> tuple[Surface, ...]:
    """Read the patches of a surface.json, bit for bit as they were written.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        One line that names the file, the field, and what is wrong with it.
    """
    document = read_document(path, format_name=FORMAT, version=VERSION)
    return tuple(_surface(patch) for patch in document.child("patches").items())


def _patch(surface: Surface) -> dict[str, object]:
    return {
        "degree_u": surface.degree_u,
        "degree_v": surface.degree_v,
        "periodic_u": surface.periodic_u,
        "periodic_v": surface.periodic_v,
        "knots_u": surface.knots_u.tolist(),
        "knots_v": surface.knots_v.tolist(),
        "control_points_mm": surface.control_points_mm.tolist(),
        "weights": surface.weights.tolist(),
    }


def _surface(patch: Field) -> Surface:
    return checked(
        patch,
        lambda: Surface(
            degree_u=patch.child("degree_u").integer(),
            degree_v=patch.child("degree_v").integer(),
            knots_u=patch.child("knots_u").array((None,)),
            knots_v=patch.child("knots_v").array((None,)),
            control_points_mm=patch.child("control_points_mm").array((None, None, 3)),
            weights=patch.child("weights").array((None, None)),
            periodic_u=patch.child("periodic_u").flag(),
            periodic_v=patch.child("periodic_v").flag(),
        ),
    )
