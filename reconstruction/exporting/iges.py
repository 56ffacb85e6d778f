"""IGES files of NURBS patches, in millimetres, for programs that read no STEP."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from reconstruction.exporting import provenance as origins
from reconstruction.exporting.atomic import replacing
from reconstruction.exporting.bodies import Body
from reconstruction.exporting.brep import require_open_cascade, shells, silence
from reconstruction.exporting.solids import Solidity, assemble
from reconstruction.meshing import Mesh
from reconstruction.nurbs.values import Surface


def write_iges(
    path: Path | str,
    surfaces: Sequence[Surface],
    *,
    name: str,
    provenance: Mapping[str, object],
    author: str = "",
    organisation: str = "",
    sew_within_mm: float = 1e-4,
) -> None:
    """Write the patches as trimmed surfaces (entity 144).

    Left to itself, Open CASCADE writes the account's name as the author; this does not.

    Raises
    ------
    MissingExtra
        Open CASCADE is not installed.
    ValueError
        No patch, or one that Open CASCADE cannot represent.
    OSError
        The file cannot be written.
    """
    require_open_cascade()
    if not surfaces:
        raise ValueError(f"{path}: no patch to write")
    with silence():
        shape, _ = shells(surfaces, sew_within_mm=sew_within_mm)
        text = _text_of(path, shape, name, provenance, author, organisation)
    with replacing(path) as file:
        file.write(text.getbuffer())


def write_iges_solid(
    path: Path | str,
    bodies: Sequence[Body],
    *,
    name: str,
    provenance: Mapping[str, object],
    author: str = "",
    organisation: str = "",
    sew_within_mm: float = 1e-4,
    volume_mm3: float | None = None,
    mesh: Mesh | None = None,
) -> Solidity:
    """Write every face of a part's solids, flat caps too, as trimmed surfaces (entity 144).

    The faces are those of `step.write_step_solid`, and so are the parameters, the errors and the
    value returned. Readers sew them: the entities that hold solids are read by few programs.
    """
    require_open_cascade()
    if not bodies and mesh is None:
        raise ValueError(f"{path}: no body to write")
    with silence():
        made = assemble(bodies, sew_within_mm=sew_within_mm, volume_mm3=volume_mm3, mesh=mesh)
        text = _text_of(path, made.shape, name, provenance, author, organisation)
    with replacing(path) as file:
        file.write(text.getbuffer())
    return made.solidity


def _text_of(
    path: Path | str,
    shape: Any,  # noqa: ANN401
    name: str,
    provenance: Mapping[str, object],
    author: str,
    organisation: str,
) -> io.BytesIO:
    from OCP.IGESControl import IGESControl_Controller, IGESControl_Writer

    IGESControl_Controller.Init_s()
    writer = IGESControl_Writer("MM", 0)
    done = writer.AddShape(shape)
    writer.ComputeModel()
    _describe(writer.Model(), provenance)
    _sign(writer.Model(), name, author, organisation, Path(path).name)
    text = io.BytesIO()
    if not (done and writer.Write(text)):
        raise ValueError(f"{path}: Open CASCADE cannot write these patches")
    return text


def _describe(model: Any, provenance: Mapping[str, object]) -> None:  # noqa: ANN401
    """Fill the start section, lines of 72 columns for people."""
    model.ClearStartSection()
    for line in ("loftscan NURBS surface, unit: mm", *origins.lines(provenance)):
        for part in textwrap.wrap(_ascii(line), 72):
            model.AddStartLine(part)


def _sign(model: Any, name: str, author: str, organisation: str, file_name: str) -> None:  # noqa: ANN401
    from OCP.TCollection import TCollection_HAsciiString

    section = model.GlobalSection()
    section.SetSendName(TCollection_HAsciiString(_ascii(name)))
    section.SetAuthorName(TCollection_HAsciiString(_ascii(author)))
    section.SetCompanyName(TCollection_HAsciiString(_ascii(organisation)))
    section.SetFileName(TCollection_HAsciiString(_ascii(file_name)))
    model.SetGlobalSection(section)


def _ascii(text: str) -> str:
    """IGES knows ASCII only."""
    return text.encode("ascii", "replace").decode()
