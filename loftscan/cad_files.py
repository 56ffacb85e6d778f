"""STEP, IGES and 3DM, written by a process of its own while other work is done.

Open CASCADE takes longer to load than its work takes, and is a large C++ library: beside us it
costs no time, and a crash of it is a message. The child loads its libraries as soon as it is
started, waits for a line that names a folder, and writes from that folder's surface.json and
sections.json, so that what CAD gets is what those files say.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from reconstruction.errors import ReconstructionError
from reconstruction.meshing import Mesh

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from reconstruction.exporting import Body
    from reconstruction.nurbs import Surface

_WRITERS = ("step", "iges", "3dm")
_FILE_OF = {"step": "surface.step", "iges": "surface.igs"}
_TIME_LIMIT_S = 600.0


@dataclass(frozen=True, slots=True)
class SolidOrder:
    """How the patches of surface.json enclose a part, one entry a patch."""

    holes: tuple[bool, ...]  # material lies outside
    closings: tuple[str, ...]  # values of `exporting.Closing`
    volume_mm3: float  # that the part's mesh holds


SPARE_MESH = (
    ".spare.npz"  # in the folder until the child has read it: facets, should they be needed
)


class CadWriter:
    """The child, from its start to its end: ``with CadWriter(formats) as cad: ...``.

    Started before a reconstruction, it has loaded its libraries by the time there is something to
    write. Leaving the block ends it, whatever it is doing.
    """

    def __init__(self, formats: tuple[str, ...]) -> None:
        self._formats = [each for each in _WRITERS if each in formats]
        self._child: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        if self._formats:
            # -P: no file of the folder we run in may hide a module of the child's.
            # In a session of its own: an operator's Ctrl-C is ours to answer, not the child's.
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-m", "loftscan.cad_files", *self._formats],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._child is not None:
            self._child.kill()
            with self._child:  # closes its pipes and waits for its end
                pass

    def write(
        self, folder: Path, *, name: str, solid: SolidOrder | None = None, mesh: Mesh | None = None
    ) -> None:
        """Let the child write into a folder that holds surface.json and sections.json.

        Parameters
        ----------
        solid
            How the patches enclose the part; without it they are patches and no more.
        mesh
            The part's closed mesh: a solid's facets, where its patches make none.
        """
        if self._child is None or self._child.stdin is None:
            return
        if mesh is not None and "step" in self._formats:
            np.savez(
                folder / SPARE_MESH,
                vertices_mm=mesh.vertices_mm, faces=mesh.faces, synthetic=mesh.synthetic,
            )  # fmt: skip
        said = None if solid is None else asdict(solid)
        order = json.dumps({"folder": str(folder), "name": name, "solid": said})
        try:
            self._child.stdin.write(order + "\n")
            self._child.stdin.flush()
        except BrokenPipeError:
            pass  # it died: `finish` says of what

    def finish(self) -> tuple[str, ...]:
        """Wait for the files; say what is not as it should be: why surfaces make no solid.

        Raises
        ------
        ReconstructionError
            The child failed; the message says why.
        OSError
            It failed for lack of space or permission.
        """
        if self._child is None:
            return ()
        try:
            said, complaint = self._child.communicate(timeout=_TIME_LIMIT_S)
        except subprocess.TimeoutExpired as late:
            message = f"CAD files: not written in {_TIME_LIMIT_S:g} s; leave them out: --formats"
            raise ReconstructionError(message) from late
        if self._child.returncode != 0:
            raise _failure(said, complaint, self._child.returncode)
        return tuple(json.loads(said.strip().splitlines()[-1])["reasons"]) if said.strip() else ()


def _failure(said: str, complaint: str, code: int) -> Exception:
    try:
        told = json.loads(said.strip().splitlines()[-1])
    except (ValueError, IndexError):
        last = (complaint.strip().splitlines() or [f"exit code {code}"])[-1]
        return ReconstructionError(
            f"CAD files: the writer died ({last}); leave them out with --formats"
        )
    if told["errno"] is not None:
        return OSError(told["errno"], told["message"], told["file"])
    return ReconstructionError(f"CAD files: {told['message']}")


def write_files(
    folder: Path, name: str, formats: list[str], solid: SolidOrder | None = None
) -> tuple[str, ...]:
    """Write the CAD files of a result folder from its JSON files; say why there is no solid."""
    from reconstruction.exporting import (
        flat_caps,
        read_sections_json,
        read_surface_json,
        write_threedm,
    )

    surfaces = read_surface_json(folder / "surface.json")
    provenance = json.loads((folder / "surface.json").read_text(encoding="utf-8"))["provenance"]
    bodies = () if solid is None else _bodies(surfaces, solid)
    mesh = _spare_mesh(folder / SPARE_MESH)
    reasons: list[str] = []
    for each in ("step", "iges"):
        if each not in formats:
            continue
        if solid is not None and (bodies or mesh is not None):
            reasons += _write_solid(folder, each, bodies, (name, provenance), solid, mesh)
        elif surfaces:  # without a patch there is nothing that such a file could hold
            _write_patches(folder, each, surfaces, name, provenance)
    if "3dm" in formats:
        curves = [record.curve for record in read_sections_json(folder / "sections.json")]
        write_threedm(
            folder / "surface.3dm", surfaces, curves, caps=flat_caps(bodies), name=name,
            provenance=provenance,
        )  # fmt: skip
    return tuple(reasons)


def _write_patches(
    folder: Path, form: str, surfaces: Sequence[Surface], name: str, provenance: dict[str, object]
) -> None:
    from reconstruction.exporting import write_iges, write_step

    write = {"step": write_step, "iges": write_iges}[form]
    write(folder / _FILE_OF[form], surfaces, name=name, provenance=provenance)


def _write_solid(
    folder: Path,
    form: str,
    bodies: Sequence[Body],
    stamps: tuple[str, dict[str, object]],
    solid: SolidOrder,
    mesh: Mesh | None,
) -> Iterator[str]:
    """Write a part as a solid; what a person should know of it."""
    from reconstruction.exporting import write_iges_solid, write_step_solid

    write = {"step": write_step_solid, "iges": write_iges_solid}[form]
    file, (name, provenance) = _FILE_OF[form], stamps
    found = write(
        folder / file, bodies, name=name, provenance=provenance, volume_mm3=solid.volume_mm3,
        mesh=mesh,
    )  # fmt: skip
    if found.reasons:
        made = (
            f"a solid of {found.facets} planar facets of the mesh, none of NURBS surfaces"
            if found.facets
            else "open shells, no solid"
        )
        yield f"{file} holds {made}: {'; '.join(found.reasons)}"


def _spare_mesh(path: Path) -> Mesh | None:
    """Read the mesh that was left for us, and take it away."""
    if not path.exists():
        return None
    with np.load(path) as kept:
        mesh = Mesh(kept["vertices_mm"], kept["faces"], kept["synthetic"])
    path.unlink()
    return mesh


def _bodies(surfaces: Sequence[Surface], solid: SolidOrder) -> tuple[Body, ...]:
    from reconstruction.exporting import Body, Closing

    pairs = zip(surfaces, solid.holes, solid.closings, strict=True)
    return tuple(Body(each, hole, Closing(closing)) for each, hole, closing in pairs)


def _load_libraries(formats: list[str]) -> None:
    import reconstruction.exporting  # noqa: F401

    if "step" in formats:
        import OCP.STEPControl
    if "iges" in formats:
        import OCP.IGESControl  # noqa: F401
    if "3dm" in formats:
        import rhino3dm  # noqa: F401


def main(formats: list[str]) -> int:
    """Run as the child; say what went wrong as one JSON line."""
    try:
        _load_libraries(formats)
        line = sys.stdin.readline()
        if not line:  # whoever started us had nothing to write, or is gone
            return 0
        order = json.loads(line)
        solid = order["solid"] and SolidOrder(**order["solid"])
        reasons = write_files(Path(order["folder"]), order["name"], formats, solid)
        print(json.dumps({"reasons": reasons}))
    except (OSError, ImportError, ReconstructionError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) else None
        text = (error.strerror if isinstance(error, OSError) else None) or str(error)
        place = getattr(error, "filename", None)
        print(json.dumps({"errno": number, "message": text, "file": place and str(place)}))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
