"""STEP files (ISO 10303-21) of NURBS patches, in millimetres.

Written by Open CASCADE; what it would put in by itself (statistics on stdout, the clock, its own
name as the product's) is replaced, so that equal surfaces and an equal time stamp give equal files.
STEP knows no periodic knots: a periodic direction is written unwrapped, with the knots outside its
domain, and marked closed; Open CASCADE makes it periodic again when it reads.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from reconstruction.exporting import provenance as origins
from reconstruction.exporting.atomic import replacing
from reconstruction.exporting.bodies import Body
from reconstruction.exporting.brep import (
    faces_of,
    require_open_cascade,
    shells,
    silence,
    surface_of,
)
from reconstruction.exporting.solids import Solidity, assemble
from reconstruction.meshing import Mesh
from reconstruction.nurbs.values import Surface

Schema = Literal["AP214IS", "AP242DIS"]

# ISO 10303-21 ends a header string at 256 characters; encoded ones grow.
_HEADER_WIDTH = 60


def write_step(
    path: Path | str,
    surfaces: Sequence[Surface],
    *,
    name: str,
    provenance: Mapping[str, object],
    author: str = "",
    organisation: str = "",
    schema: Schema = "AP214IS",
    time_stamp: str | None = None,
    sew_within_mm: float = 1e-4,
) -> None:
    """Write the patches as faces of open shells.

    Parameters
    ----------
    path
        Final name; the file appears whole or not at all.
    name
        The product's name.
    provenance
        Goes to the header as one description line an entry.
    time_stamp
        ISO 8601; by default now, in UTC.
    sew_within_mm
        Borders of patches closer than this become one edge.

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
        shape, faces = shells(surfaces, sew_within_mm=sew_within_mm)
        named = [(f"patch {index}", face) for index, face in enumerate(faces)]
        stamps = _Stamps(name, provenance, author, organisation, schema, time_stamp)
        text = _text_of(shape, named, stamps)
    with replacing(path) as file:
        file.write(text.getbuffer())


def write_step_solid(
    path: Path | str,
    bodies: Sequence[Body],
    *,
    name: str,
    provenance: Mapping[str, object],
    author: str = "",
    organisation: str = "",
    schema: Schema = "AP242DIS",
    time_stamp: str | None = None,
    sew_within_mm: float = 1e-4,
    volume_mm3: float | None = None,
    mesh: Mesh | None = None,
) -> Solidity:
    """Write one closed solid for each outer shell of a part; its cavities are voids in there.

    Only solids that Open CASCADE's BRepCheck calls valid are written as such. Where there are none,
    the file has a solid of planar facets of the mesh, if that is given; else the patches as
    `write_step` writes them. The value returned says why. BRepCheck does not see a wall that
    crosses itself; nor does this.

    Parameters
    ----------
    bodies
        From the outside in (`bodies.bodies_of`): each is united with what is before it or, as a
        hole, taken out.
    volume_mm3
        What the part's mesh holds. A solid that differs by more than 0.1 % is not written.
    mesh
        The part's closed mesh, to be written as planar facets where its surfaces make no solid.
    path, name, provenance, time_stamp, sew_within_mm
        As in `write_step`.

    Returns
    -------
    How many solids were written and their volume, or the reasons why there are none.

    Raises
    ------
    MissingExtra
        Open CASCADE is not installed.
    ValueError
        No body, or a surface that Open CASCADE cannot represent.
    OSError
        The file cannot be written.
    """
    require_open_cascade()
    if not bodies and mesh is None:
        raise ValueError(f"{path}: no body to write")
    with silence():
        made = assemble(bodies, sew_within_mm=sew_within_mm, volume_mm3=volume_mm3, mesh=mesh)
        stamps = _Stamps(name, provenance, author, organisation, schema, time_stamp)
        text = _text_of(made.shape, made.faces, stamps)
    with replacing(path) as file:
        file.write(text.getbuffer())
    return made.solidity


def read_step(path: Path | str) -> tuple[Surface, ...]:
    """Read every B-spline face of a STEP file, in millimetres, in the file's order (by shell).

    Raises
    ------
    MissingExtra
        Open CASCADE is not installed.
    OSError
        The file cannot be read.
    ValueError
        Not a STEP file.
    """
    require_open_cascade()
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPControl import STEPControl_Reader

    path = Path(path)
    data = io.BytesIO(path.read_bytes())
    with silence():
        reader = STEPControl_Reader()
        status = reader.ReadStream(path.name, data)
        if status != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise ValueError(f"{path}: not a STEP file")
        reader.TransferRoots()
        return tuple(surface_of(made) for made in faces_of(reader.OneShape()))


@dataclass(frozen=True, slots=True)
class _Stamps:
    """What a file says beside its geometry."""

    name: str
    provenance: Mapping[str, object]
    author: str
    organisation: str
    schema: Schema
    time_stamp: str | None


def _text_of(shape: Any, faces: Sequence[tuple[str, Any]], stamps: _Stamps) -> io.BytesIO:  # noqa: ANN401
    writer = _writer(stamps.schema)
    _transfer(writer, shape)
    _name_faces(writer, faces)
    _mark_closed(writer, shape)
    model = writer.Model(False)  # noqa: FBT003 (not a new one)
    _name_product(model, stamps.name)
    _write_header(
        model,
        name=stamps.name,
        author=stamps.author,
        organisation=stamps.organisation,
        description=tuple(_description(stamps.provenance)),
        time_stamp=stamps.time_stamp or datetime.now(UTC).isoformat(timespec="seconds"),
    )
    text = io.BytesIO()
    _expect_done(writer.WriteStream(text))
    return text


def _writer(schema: str) -> Any:  # noqa: ANN401
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_Controller, STEPControl_Writer

    # These settings are the process's, not the writer's: set anew for every file.
    STEPControl_Controller.Init_s()
    Interface_Static.SetCVal_s("write.step.schema", schema)
    # One part: an assembly of shells would number its uses over the process's life.
    Interface_Static.SetIVal_s("write.step.assembly", 0)
    Interface_Static.SetCVal_s("xstep.cascade.unit", "MM")
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    return STEPControl_Writer()


def _transfer(writer: Any, shape: Any) -> None:  # noqa: ANN401
    from OCP.STEPControl import STEPControl_AsIs

    _expect_done(writer.Transfer(shape, STEPControl_AsIs))


def _expect_done(status: Any) -> None:  # noqa: ANN401
    from OCP.IFSelect import IFSelect_ReturnStatus

    if status != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ValueError(f"Open CASCADE cannot write these patches: {status}")


def _name_faces(writer: Any, faces: Sequence[tuple[str, Any]]) -> None:  # noqa: ANN401
    """Name faces after their patches: sewing groups them by shell."""
    finder = writer.WS().TransferWriter().FinderProcess()
    for name, face in faces:
        entity = _entity_of(finder, face)
        if entity is not None:  # a Boolean operation may merge two faces to one, of one name
            entity.SetName(_text(name))


def _mark_closed(writer: Any, shape: Any) -> None:  # noqa: ANN401
    """Mark rational surfaces closed, too, where they are: Open CASCADE marks the others alone."""
    from OCP.BRep import BRep_Tool
    from OCP.StepData import StepData_Logical
    from OCP.StepGeom import StepGeom_BSplineSurface
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    finder = writer.WS().TransferWriter().FinderProcess()
    faces = TopExp_Explorer(shape, TopAbs_FACE)
    while faces.More():
        face = TopoDS.Face_s(faces.Current())
        faces.Next()
        entity = _entity_of(finder, face)
        told = entity and entity.FaceGeometry()
        if isinstance(told, StepGeom_BSplineSurface):
            made = BRep_Tool.Surface_s(face)
            if made.IsUPeriodic():
                told.SetUClosed(StepData_Logical.StepData_LTrue)
            if made.IsVPeriodic():
                told.SetVClosed(StepData_Logical.StepData_LTrue)


def _entity_of(finder: Any, face: Any) -> Any:  # noqa: ANN401
    from OCP.STEPConstruct import STEPConstruct
    from OCP.TopLoc import TopLoc_Location

    return STEPConstruct.FindEntity_s(finder, face, TopLoc_Location())


def _name_product(model: Any, name: str) -> None:  # noqa: ANN401
    """Name the product; Open CASCADE would number products over the process's life."""
    from OCP.StepBasic import StepBasic_Product

    for index in range(1, model.NbEntities() + 1):
        entity = model.Value(index)
        if isinstance(entity, StepBasic_Product):
            entity.SetId(_text(name))
            entity.SetName(_text(name))


def _write_header(
    model: Any,  # noqa: ANN401
    *,
    name: str,
    author: str,
    organisation: str,
    description: Sequence[str],
    time_stamp: str,
) -> None:
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.Interface import Interface_HArray1OfHAsciiString

    header = APIHeaderSection_MakeHeader(model)
    header.SetName(_text(name))
    header.SetAuthorValue(1, _text(author))
    header.SetOrganizationValue(1, _text(organisation))
    header.SetOriginatingSystem(_text("loftscan"))
    header.SetAuthorisation(_text(""))
    header.SetTimeStamp(_text(time_stamp))
    lines = Interface_HArray1OfHAsciiString(1, len(description))
    for index, line in enumerate(description, 1):
        lines.SetValue(index, _text(line))
    header.SetDescription(lines)


def _description(provenance: Mapping[str, object]) -> Iterator[str]:
    yield "loftscan NURBS surface, unit: mm"
    for line in origins.lines(provenance):
        yield from textwrap.wrap(line, _HEADER_WIDTH)


def _text(text: str) -> Any:  # noqa: ANN401
    from OCP.TCollection import TCollection_HAsciiString

    return TCollection_HAsciiString(encoded(text))


def encoded(text: str) -> str:
    r"""Write a string as ISO 10303-21 does: ASCII, all else as ``\X2\hhhh\X0\`` in UTF-16.

    Control characters become spaces. Open CASCADE itself doubles quotes and lone backslashes.
    """
    return "".join(_encoded(character) for character in text)


def _encoded(character: str) -> str:
    if " " <= character <= "~":
        return character
    if character < " " or character == "\x7f":
        return " "
    if character > "\uffff":
        return f"\\X4\\{ord(character):08X}\\X0\\"
    return f"\\X2\\{ord(character):04X}\\X0\\"
