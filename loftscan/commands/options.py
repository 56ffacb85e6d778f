"""Options that several commands share, and how a typed word becomes a member."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, TypeVar

import typer

Choice = TypeVar("Choice", bound=Enum)

Out = Annotated[Path, typer.Option(help="Folder for the result; it must not exist yet.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an older result in --out.")]
JsonLines = Annotated[bool, typer.Option("--json", help="Print machine-readable lines.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Tolerance = Annotated[float | None, typer.Option(help="Judge the points by this distance.")]
UnitName = Annotated[str, typer.Option(help="Unit of the input: mm, cm, m, um or inch.")]
Formats = Annotated[
    str | None,
    typer.Option(help="Files to write, of step,3dm,stl,ply,glb,iges; by default all but iges."),
]


def choice(names: type[Choice], wanted: str, option: str) -> Choice:
    """Find the member of an enumeration by its value, which is what a person types."""
    try:
        return names(wanted.lower())
    except ValueError as unknown:
        known = ", ".join(str(member.value) for member in names)
        raise ValueError(f"{option} {wanted!r}: one of {known} expected") from unknown
