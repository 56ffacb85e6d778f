"""Slices in, what is ready out: sections as they come, at last the whole reconstruction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import ClassVar

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.cleanup import Cleaned, CleanupSettings, clean
from reconstruction.course import OF_A_CLOUD, Remedy, run_course, too_few
from reconstruction.lofting import lay_rows, loft_run, split_runs
from reconstruction.meshing import Mesh, mesh_rows
from reconstruction.nurbs import Surface
from reconstruction.paper import LEFT_OUT_CELLS, Base, PaperSettings, draw_section
from reconstruction.sections import Residual, Section, Skipped
from reconstruction.slices import Slice

_GRAZING_SHARE = 1.0 / 3.0  # of its length that an end section may be synthetic
_GRAZING_TIMES = 2.0  # and how much more synthetic than a typical section


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """Everything that became of the slices."""

    REACH: ClassVar = f"{LEFT_OUT_CELLS:g} cells"  # points farther from their curve are left out
    SIGMA_RULE: ClassVar = "sigma from local parabolas"

    sections: tuple[Section, ...]
    skipped: tuple[Skipped, ...]
    patches: tuple[Surface, ...]  # one a run of equal count
    runs: tuple[tuple[int, ...], ...]  # section indices of each run, runs without a patch too
    mesh: Mesh  # closed, cleaned
    cleaned: Cleaned  # what the cleanup did and found

    @property
    def normal(self) -> FloatArray:
        """The stacking normal (3,), along which heights are told."""
        return np.asarray(self.sections[0].frame.axes[2])

    @property
    def cap_heights_mm(self) -> FloatArray:
        """Heights along the stacking normal at which flat caps close the part."""
        ends = (self.sections[0].frame, self.sections[-1].frame)
        return np.array([frame.origin_mm @ frame.axes[2] for frame in ends])

    @property
    def residual(self) -> Residual:
        """Of the unreduced points that the sections stand for."""
        return reduce(Residual.plus, (section.residual for section in self.sections))

    @property
    def residual_all(self) -> Residual:
        """Of all points of all sections, those left out too."""
        return reduce(Residual.plus, (section.residual_all for section in self.sections))


def reconstruct_paper(
    slices: Iterable[Slice],
    settings: PaperSettings,
    cleanup: CleanupSettings,
) -> Iterator[Section | Skipped | Reconstruction]:
    """Run the paper's method over a stream of slices.

    Yields
    ------
    Section, Skipped
        One of the two for every slice, as soon as it is known.
    Reconstruction
        Once, at the end.

    Raises
    ------
    NotLoftable
        At the end, when fewer than two sections came out.
    CleanupFailed, MissingExtra
        From the mesh cleanup.
    """
    yield from run_course(slices, PaperCourse(settings, cleanup), OF_A_CLOUD)


class PaperCourse:
    """`--method paper`: the 25 % rule looks only back, so a section is ready with its slice."""

    def __init__(self, settings: PaperSettings, cleanup: CleanupSettings) -> None:
        self._settings = settings
        self._cleanup = cleanup
        self._base: Base | None = None
        self._sections: list[Section] = []

    def draw(self, piece: Slice) -> Section:
        """Turn the next slice into a section."""
        section, self._base = draw_section(piece, self._settings, self._base)
        self._sections.append(section)
        return section

    def finish(self, skipped: Sequence[Skipped], remedy: Remedy) -> Reconstruction:
        """Patches and mesh of all sections but those that only grazed the part."""
        sections, trimmed = trim_ends(self._sections)
        every = [*skipped, *trimmed]
        if len(sections) < 2:
            indices = [section.index for section in sections]
            finer = f"{remedy.other_settings}, or try another --resolution-mm"
            raise too_few("section", indices, indices, every, replace(remedy, other_settings=finer))
        return loft(sections, every, self._settings, self._cleanup)


def trim_ends(sections: list[Section]) -> tuple[list[Section], list[Skipped]]:
    """Take away end sections that are mostly bridged: there the slice only grazed the part.

    Between others such a section is worth having; at an end it would become the cap. Where a
    typical section has many gaps, too, an end one is only badly acquired, and stays.
    """
    trimmed: list[Skipped] = []
    kept = list(sections)
    typical = float(np.median([each.gap_mm / each.length_mm for each in kept])) if kept else 0.0
    limit = max(_GRAZING_SHARE, _GRAZING_TIMES * typical)
    for end in (0, -1):
        while len(kept) > 2 and kept[end].gap_mm > limit * kept[end].length_mm:
            section = kept.pop(end)
            share = section.gap_mm / section.length_mm
            reason = f"an end section, and synthetic over {share:.0%} of its length"
            trimmed.append(Skipped(section.index, section.points, reason))
    return kept, trimmed


def loft(
    sections: list[Section],
    skipped: list[Skipped],
    settings: PaperSettings,
    cleanup: CleanupSettings,
) -> Reconstruction:
    """Join sections by patches and pairs, mesh them, and clean the mesh."""
    runs = split_runs(sections)
    patches = [loft_run(run) for run in runs]
    rows = lay_rows(runs, patches, intermediate=settings.intermediate)
    axes = np.asarray(sections[0].frame.axes[:2])
    cleaned = clean(mesh_rows(rows, axes), cleanup)
    return Reconstruction(
        sections=tuple(sections),
        skipped=tuple(skipped),
        patches=tuple(patch for patch in patches if patch is not None),
        runs=tuple(tuple(section.index for section in run) for run in runs),
        mesh=cleaned.mesh,
        cleaned=cleaned,
    )
