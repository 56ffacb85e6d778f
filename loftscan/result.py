"""A finished reconstruction, and the folder it is saved as."""

from __future__ import annotations

import errno
import json
import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from loftscan.cad_files import CadWriter, SolidOrder
from loftscan.methods import AnyReconstruction, AnySection
from loftscan.sliced import Sliced
from reconstruction.arrays import FloatArray
from reconstruction.comparison import Deviation
from reconstruction.errors import MissingExtra
from reconstruction.exporting import (
    SectionRecord,
    bodies_of,
    write_glb,
    write_ply,
    write_sections_json,
    write_stl,
    write_surface_json,
)
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Surface
from reconstruction.skinning.exact_shapes import Shape

USUAL_FORMATS = ("step", "3dm", "stl", "ply", "glb")
FORMATS = (*USUAL_FORMATS, "iges")  # for programs that read no STEP: only when asked for
_LIBRARY_OF = {"step": "OCP", "iges": "OCP", "3dm": "rhino3dm"}
MARKS = ("metrics.json", "provenance.json")  # files that tell a result folder
_OURS = {
    *("surface.json", "surface.step", "surface.3dm", "surface.igs", "sections.json", "report.html"),
    *("mesh.stl", "mesh.stl.unit.txt", "mesh.ply", "mesh.glb"),
    *("metrics.json", "provenance.json", "comparison.json", "deviation.ply"),
}
_SIDECAR = "mesh.stl carries no unit; its coordinates are millimetres.\n"


class NoSolid(UserWarning):
    """The surfaces of a result are written, but they are no solid that CAD calls valid."""


class OutputExists(ValueError):  # noqa: N818 (the house names errors after the fact)
    """The output folder is already there and holds something."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What `reconstruct` returns.

    `surface` holds the tensor patches, `sections` the fitted sections from the lowest up, `mesh`
    the closed triangle mesh, `metrics` what metrics.json will say.
    """

    name: str
    reconstruction: AnyReconstruction
    cutting: Sliced  # a `Cutting` of a cloud, or what was `Gathered` from a scan
    sample_mm: FloatArray  # (k, 3) an even sample of the measured points used
    deviation: Deviation  # of that sample from the mesh
    metrics: dict[str, object]
    provenance: dict[str, object]
    warnings: tuple[str, ...]

    @property
    def surface(self) -> tuple[Surface, ...]:
        """The tensor patches: one a run of sections of equal count, or one a branch."""
        return self.reconstruction.patches

    @property
    def shapes(self) -> tuple[Shape | None, ...]:
        """The exact shape of every patch of method fit; None where its surface is a free one."""
        done = self.reconstruction
        if isinstance(done, FittedReconstruction):
            return done.skinned.shapes
        return (None,) * len(done.patches)

    @property
    def sections(self) -> tuple[AnySection, ...]:
        """The sections, from the lowest up."""
        return self.reconstruction.sections

    @property
    def mesh(self) -> Mesh:
        """The closed mesh."""
        return self.reconstruction.mesh

    def save(
        self,
        folder: Path | str,
        *,
        formats: Iterable[str] | None = None,
        overwrite: bool = False,
        cad: CadWriter | None = None,
        remark: Callable[[str], None] | None = None,
    ) -> Path:
        """Write the result folder; it appears whole or not at all.

        Parameters
        ----------
        folder
            Where; it must not exist, or be empty, unless `overwrite`.
        formats
            Of `FORMATS`; by default `USUAL_FORMATS` whose libraries are installed.
        cad
            A writer of the same formats that was started earlier, to save its loading time.
        remark
            Called with what a person should know of the files, as that the surfaces make no valid
            solid; by default that is a `NoSolid` warning.

        Raises
        ------
        OutputExists, MissingExtra, ValueError
            Before anything is written.
        OSError
            For example a full disk; then nothing half-written is left.
        """
        target, tell = Path(folder), remark or _warn
        chosen = choose_formats(formats)
        with appearing_whole(target, overwrite=overwrite) as partial:
            self._write_json_files(partial)
            if cad is not None:
                self._write_rest(partial, chosen, cad, tell)
            else:
                with CadWriter(chosen) as own:
                    self._write_rest(partial, chosen, own, tell)
        return target

    def _write_rest(
        self,
        folder: Path,
        formats: tuple[str, ...],
        cad: CadWriter,
        remark: Callable[[str], None],
    ) -> None:
        from loftscan.reporting import write_result_report

        solid = _solid_of(self.reconstruction)
        spare = None if solid is None else self.mesh
        cad.write(folder, name=self.name, solid=solid, mesh=spare)
        self._write_meshes(folder, formats)
        write_result_report(folder / "report.html", self)
        for words in cad.finish():
            remark(words)

    def _write_json_files(self, folder: Path) -> None:
        name, said = self.name, self.provenance
        write_surface_json(folder / "surface.json", self.surface, name=name, provenance=said)
        write_sections_json(folder / "sections.json", self._records(), name=name, provenance=said)
        _write_json(folder / "metrics.json", self.metrics)
        _write_json(folder / "provenance.json", self.provenance)

    def _write_meshes(self, folder: Path, formats: tuple[str, ...]) -> None:
        mesh, name = self.mesh, self.name
        if "stl" in formats:
            write_stl(folder / "mesh.stl", mesh, name=name)
            (folder / "mesh.stl.unit.txt").write_text(_SIDECAR, encoding="utf-8")
        if "ply" in formats:
            write_ply(folder / "mesh.ply", mesh, name=name, provenance=self.provenance)
        if "glb" in formats:
            write_glb(folder / "mesh.glb", mesh, name=name, provenance=self.provenance)

    def _records(self) -> list[SectionRecord]:
        return [
            SectionRecord(
                index=section.index,
                height_mm=section.height_mm,
                frame=section.frame,
                curve=drawn.curve,
                gaps=drawn.gaps,
                residual_rms_mm=drawn.residual_rms_mm if drawn.points else None,
                residual_max_mm=drawn.residual_max_mm if drawn.points else None,
                points=drawn.points,
            )
            for section in self.sections
            for drawn in section.curves
        ]


def _warn(words: str) -> None:
    warnings.warn(words, NoSolid, stacklevel=3)


def _solid_of(done: AnyReconstruction) -> SolidOrder | None:
    """How the surfaces of branches enclose the part; the paper's patches enclose nothing."""
    if not isinstance(done, FittedReconstruction):
        return None
    if done.skinned.open:  # it has borders: CAD gets a shell
        return None
    bodies = bodies_of(done.skinned.shown)
    return SolidOrder(
        holes=tuple(body.hole for body in bodies),
        closings=tuple(body.closing.value for body in bodies),
        volume_mm3=done.cleaned.before.volume_mm3,
    )


def _write_json(path: Path, content: dict[str, object]) -> None:
    # A NaN would make the file unreadable to others: whoever has none to say says null.
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


@contextmanager
def appearing_whole(
    target: Path, *, overwrite: bool, marks: tuple[str, ...] = MARKS
) -> Iterator[Path]:
    """Make a folder to fill; it takes the name `target` only when the block ends well.

    Whatever ends the block early leaves nothing behind, and an older result as it was.

    Raises
    ------
    OutputExists
        As `check_output`.
    OSError
        For example a full disk; it names `target`.
    """
    check_output(target, overwrite=overwrite, marks=marks)
    place = target.resolve()
    partial = place.with_name(f".{place.name}.partial")
    older = place.with_name(f".{place.name}.older")
    missing = [parent for parent in place.parents if not parent.exists()]
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        yield partial
        if place.exists():
            shutil.rmtree(older, ignore_errors=True)
            place.rename(older)
        partial.rename(place)
    except OSError as error:
        # The person knows the target's name, not that of the partial folder.
        if error.filename is None or Path(error.filename).is_relative_to(partial):
            error.filename = str(target)
        raise
    finally:
        if older.exists() and not place.exists():
            older.rename(place)
        for leftover in (partial, older):
            shutil.rmtree(leftover, ignore_errors=True)
        for parent in missing:
            with suppress(OSError):  # it holds the result, or was never made
                parent.rmdir()


def check_output(target: Path, *, overwrite: bool, marks: tuple[str, ...] = MARKS) -> None:
    """Refuse an output folder that cannot be made, or holds something.

    With `overwrite` it may hold a result, which has the files `marks`, and nothing else.

    Raises
    ------
    OutputExists, PermissionError
    """
    if target.name in {"", ".."}:
        raise OutputExists(f"{target}: the result needs a folder of its own; name a new --out")
    if target.exists() and not target.is_dir():
        raise OutputExists(f"{target}: is a file, not a folder; name another --out")
    _check_place(target)
    if not target.exists() or not any(target.iterdir()):
        return
    if not overwrite:
        raise OutputExists(f"{target}: is there already; name another --out, or add --overwrite")
    if not all((target / mark).exists() for mark in marks):
        raise OutputExists(f"{target}: holds no result of loftscan, so it is not overwritten")
    foreign = sorted(path.name for path in target.iterdir() if path.name not in _OURS)
    if foreign:
        raise OutputExists(
            f"{target}: holds {foreign[0]} beside the result, so it is not overwritten; "
            "move that away, or name another --out"
        )


def _check_place(target: Path) -> None:
    """Refuse before the work what would fail after it."""
    place = next(path for path in target.resolve().parents if path.exists())
    if not place.is_dir():
        raise OutputExists(f"{target}: {place.name} is a file, not a folder; name another --out")
    if not os.access(place, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "no permission to write there", str(target))


def choose_formats(wanted: Iterable[str] | None) -> tuple[str, ...]:
    """Check the wanted formats; None: the usual ones whose libraries are there.

    Raises
    ------
    ValueError
        For a name that is no format.
    MissingExtra
        For a wanted format whose library is not installed.
    """
    if wanted is None:
        return tuple(each for each in USUAL_FORMATS if not missing_library(each))
    chosen = tuple(dict.fromkeys(each.strip().lower() for each in wanted if each.strip()))
    if not chosen:
        raise ValueError(f"--formats '': one of {', '.join(FORMATS)} expected")
    for each in chosen:
        if each not in FORMATS:
            raise ValueError(f"--formats {each!r}: one of {', '.join(FORMATS)} expected")
        if missing_library(each):
            raise MissingExtra(
                f"writing {each} needs the library {_LIBRARY_OF[each]}: "
                "pip install 'loftscan[cad]', or choose other --formats"
            )
    return chosen


def missing_library(form: str) -> bool:
    """Whether the library that writes this format is absent."""
    library = _LIBRARY_OF.get(form)
    if library is None:
        return False
    try:
        return find_spec(library) is None
    except (ValueError, ModuleNotFoundError):
        return True
