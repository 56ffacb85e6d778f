"""IGES files of NURBS patches, in millimetres, for programs that read no STEP."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from reconstruction.exporting import provenance as origins
from reconstruction.exporting.atomic import replacing
from reconstruction.exporting.brep import require_open_cascade, shells, silence
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
    from OCP.IGESControl import IGESControl_Controller, IGESControl_Writer

    with silence():
        IGESControl_Controller.Init_s()
        writer = IGESControl_Writer("MM", 0)
        shape, _ = shells(surfaces, sew_within_mm=sew_within_mm)
        done = writer.AddShape(shape)
        writer.ComputeModel()
        _describe(writer.Model(), provenance)
        _sign(writer.Model(), name, author, organisation, Path(path).name)
        text = io.BytesIO()
        if not (done and writer.Write(text)):
            raise ValueError(f"{path}: Open CASCADE cannot write these patches")
    with replacing(path) as file:
        file.write(text.getbuffer())


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
