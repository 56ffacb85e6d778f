"""A finished reconstruction, and the folder it is saved as."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from reconstruction.arrays import FloatArray
from reconstruction.comparison import Deviation
from reconstruction.errors import MissingExtra
from reconstruction.exporting import (
    SectionRecord,
    write_glb,
    write_ply,
    write_sections_json,
    write_step,
    write_stl,
    write_surface_json,
    write_threedm,
)
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Surface
from reconstruction.pipeline import Reconstruction
from reconstruction.sections import Section
from reconstruction.slicing import Cutting

FORMATS = ("step", "3dm", "stl", "ply", "glb")
_LIBRARY_OF = {"step": "OCP", "3dm": "rhino3dm"}
_SIDECAR = "mesh.stl carries no unit; its coordinates are millimetres.\n"


class OutputExists(ValueError):  # noqa: N818 (the house names errors after the fact)
    """The output folder is already there and holds something."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What `reconstruct` returns.

    `surface` holds the tensor patches, `sections` the fitted sections from the lowest up, `mesh`
    the closed triangle mesh, `metrics` what metrics.json will say.
    """

    name: str
    reconstruction: Reconstruction
    cutting: Cutting
    sample_mm: FloatArray  # (k, 3) an even sample of the measured points used
    deviation: Deviation  # of that sample from the mesh
    metrics: dict[str, object]
    provenance: dict[str, object]
    warnings: tuple[str, ...]

    @property
    def surface(self) -> tuple[Surface, ...]:
        """The tensor patches, one a run of sections of equal count."""
        return self.reconstruction.patches

    @property
    def sections(self) -> tuple[Section, ...]:
        """The sections, from the lowest up."""
        return self.reconstruction.sections

    @property
    def mesh(self) -> Mesh:
        """The closed mesh."""
        return self.reconstruction.mesh

    def save(
        self, folder: Path | str, *, formats: Iterable[str] | None = None, overwrite: bool = False
    ) -> Path:
        """Write the result folder; it appears whole or not at all.

        Parameters
        ----------
        folder
            Where; it must not exist, or be empty, unless `overwrite`.
        formats
            Of `FORMATS`; by default all whose libraries are installed.

        Raises
        ------
        OutputExists, MissingExtra, ValueError
            Before anything is written.
        OSError
            For example a full disk; then nothing half-written is left.
        """
        target = Path(folder)
        chosen = choose_formats(formats)
        check_output(target, overwrite=overwrite)
        partial = target.with_name(f".{target.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        try:
            partial.mkdir(parents=True)
            for write in self._writers(partial, chosen):
                write()
            if target.exists():
                shutil.rmtree(target)
            partial.rename(target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        return target

    def _writers(self, folder: Path, formats: tuple[str, ...]) -> Iterable[Callable[[], object]]:
        from loftscan.reporting import write_result_report

        name, provenance = self.name, self.provenance
        yield lambda: write_surface_json(
            folder / "surface.json", self.surface, name=name, provenance=provenance
        )
        yield lambda: write_sections_json(
            folder / "sections.json", self._records(), name=name, provenance=provenance
        )
        curves = [section.curve for section in self.sections]
        by_format: dict[str, Callable[[], object]] = {
            "step": lambda: write_step(
                folder / "surface.step", self.surface, name=name, provenance=provenance
            ),
            "3dm": lambda: write_threedm(
                folder / "surface.3dm", self.surface, curves, name=name, provenance=provenance
            ),
            "stl": lambda: write_stl(folder / "mesh.stl", self.mesh, name=name),
            "ply": lambda: write_ply(
                folder / "mesh.ply", self.mesh, name=name, provenance=provenance
            ),
            "glb": lambda: write_glb(
                folder / "mesh.glb", self.mesh, name=name, provenance=provenance
            ),
        }
        yield from (by_format[each] for each in formats)
        if "stl" in formats:
            yield lambda: (folder / "mesh.stl.unit.txt").write_text(_SIDECAR)
        yield lambda: _write_json(folder / "metrics.json", self.metrics)
        yield lambda: _write_json(folder / "provenance.json", provenance)
        yield lambda: write_result_report(folder / "report.html", self)

    def _records(self) -> list[SectionRecord]:
        return [
            SectionRecord(
                index=section.index,
                height_mm=section.height_mm,
                frame=section.frame,
                curve=section.curve,
                gaps=section.gaps,
                residual_rms_mm=section.residual.rms_mm if section.residual.count else None,
                residual_max_mm=section.residual.max_mm if section.residual.count else None,
                points=section.residual.count,
            )
            for section in self.sections
        ]


def _write_json(path: Path, content: dict[str, object]) -> None:
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def check_output(
    target: Path,
    *,
    overwrite: bool,
    marks: tuple[str, ...] = ("metrics.json", "provenance.json"),
) -> None:
    """Refuse an output folder that holds something; with `overwrite`, unless it holds `marks`.

    Raises
    ------
    OutputExists
    """
    if target.exists() and not target.is_dir():
        raise OutputExists(f"{target}: is a file, not a folder; name another --out")
    if not target.exists() or not any(target.iterdir()):
        return
    if not overwrite:
        raise OutputExists(f"{target}: is there already; name another --out, or add --overwrite")
    if not all((target / mark).exists() for mark in marks):
        raise OutputExists(f"{target}: holds no result of loftscan, so it is not overwritten")


def choose_formats(wanted: Iterable[str] | None) -> tuple[str, ...]:
    """Check the wanted formats; None: all whose libraries are there.

    Raises
    ------
    ValueError
        For a name that is no format.
    MissingExtra
        For a wanted format whose library is not installed.
    """
    if wanted is None:
        return tuple(each for each in FORMATS if not missing_library(each))
    chosen = tuple(dict.fromkeys(each.strip().lower() for each in wanted if each.strip()))
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
