"""STEP and 3DM, written by a process of its own while the report is drawn.

Open CASCADE takes longer to load than its work takes, and is a large C++ library: beside us it
costs no time, and a crash of it is a message. The child reads surface.json and sections.json, so
what CAD gets is what those files say.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from reconstruction.errors import ReconstructionError

_WRITERS = ("step", "3dm")
_TIME_LIMIT_S = 600.0


@contextmanager
def written_beside(folder: Path, formats: tuple[str, ...], *, name: str) -> Iterator[None]:
    """Write those of `formats` that are CAD files into `folder` while the block runs.

    Raises
    ------
    ReconstructionError
        At the end of the block, when the child failed; the message says why.
    OSError
        When it failed for lack of space or permission.
    """
    chosen = [each for each in _WRITERS if each in formats]
    if not chosen:
        yield
        return
    command = [sys.executable, "-m", "loftscan.cad_files", str(folder), name, *chosen]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        try:
            yield
            said, complaint = child.communicate(timeout=_TIME_LIMIT_S)
        except subprocess.TimeoutExpired as late:
            message = f"CAD files: not written in {_TIME_LIMIT_S:g} s; leave them out: --formats"
            raise ReconstructionError(message) from late
        finally:
            child.kill()
    if child.returncode != 0:
        raise _failure(said, complaint, child.returncode)


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


def write_files(folder: Path, name: str, formats: list[str]) -> None:
    """Write the CAD files of a result folder from its JSON files."""
    from reconstruction.exporting.sections_json import read_sections_json
    from reconstruction.exporting.step import write_step
    from reconstruction.exporting.surface_json import read_surface_json
    from reconstruction.exporting.threedm import write_threedm

    surfaces = read_surface_json(folder / "surface.json")
    provenance = json.loads((folder / "surface.json").read_text(encoding="utf-8"))["provenance"]
    if "step" in formats:
        write_step(folder / "surface.step", surfaces, name=name, provenance=provenance)
    if "3dm" in formats:
        curves = [record.curve for record in read_sections_json(folder / "sections.json")]
        write_threedm(folder / "surface.3dm", surfaces, curves, name=name, provenance=provenance)


def main(arguments: list[str]) -> int:
    """Run as the child; say what went wrong as one JSON line."""
    folder, name, *formats = arguments
    try:
        write_files(Path(folder), name, formats)
    except (OSError, ReconstructionError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) else None
        text = (error.strerror if isinstance(error, OSError) else None) or str(error)
        place = getattr(error, "filename", None)
        print(json.dumps({"errno": number, "message": text, "file": place and str(place)}))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
