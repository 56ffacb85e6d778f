"""The verb `reconstruct` for clouds: a cloud in, a result out. For slices: `loftscan.streaming`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from loftscan import metrics, provenance
from loftscan.findings import judge
from loftscan.inputs import Input, Unit, judge_size, open_input
from loftscan.methods import AnyCourse, AnyReconstruction, Method
from loftscan.progress import Progress, silent
from loftscan.result import Result
from loftscan.surface_findings import judge_surface
from reconstruction.arrays import FloatArray
from reconstruction.cleanup import CleanupSettings
from reconstruction.comparison import Deviation, compare_to_mesh
from reconstruction.course import OF_A_CLOUD, run_course
from reconstruction.errors import TooFewPoints
from reconstruction.fanning import FAN_PASSES, FanCutting, fan_cloud
from reconstruction.fit_pipeline import FitCourse, FittedReconstruction
from reconstruction.fitting.curve import Exact
from reconstruction.paper import PaperSettings
from reconstruction.pipeline import PaperCourse, Reconstruction
from reconstruction.reduction import Box
from reconstruction.skinning.layout import Layout
from reconstruction.skinning.standing_in import Nurbs
from reconstruction.slices import Slice
from reconstruction.slicing import PASSES, Cutting, cut_cloud
from reconstruction.survey import Axis, Pass

_SAMPLE = 200_000
_MOST_INTERMEDIATE = 1000
_LEAST_MM = 1e-9  # no length below the size of an atom is meant


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything that decides a reconstruction, besides its input."""

    method: Method = Method.FIT
    axis: Axis = Axis.Z
    unit: Unit = Unit.MM
    spacing_mm: float | None = None
    resolution_mm: float | None = None
    tolerance_mm: float | None = None
    crop: Box | None = None
    intermediate: int = 0
    exact: Exact = Exact.AUTO
    nurbs: Nurbs = Nurbs.AUTO
    layout: Layout = Layout.AUTO
    axis_at_mm: tuple[float, float] | None = None  # of meridians of a cloud
    cleanup: CleanupSettings = field(default_factory=CleanupSettings)

    def __post_init__(self) -> None:
        for name in ("spacing_mm", "resolution_mm", "tolerance_mm"):
            value = getattr(self, name)
            if value is not None and not (0.0 < value < float("inf")):
                option = name.replace("_", "-")
                raise ValueError(f"--{option} {value:g}: a length above 0 mm is expected")
            if value is not None and value < _LEAST_MM:
                name = name.replace("_", "-")
                raise ValueError(f"--{name} {value:g}: at least {_LEAST_MM:g} mm is expected")
        if self.intermediate not in range(_MOST_INTERMEDIATE + 1):
            raise ValueError(
                f"--intermediate {self.intermediate}: 0 to {_MOST_INTERMEDIATE} rows are possible"
            )
        if self.axis_at_mm is not None and self.layout is not Layout.MERIDIANS:
            raise ValueError("--axis-at: only --layout meridians of a cloud stand about an axis")
        self._check_method()

    def _check_method(self) -> None:
        """Refuse what the chosen method has no use for."""
        fit = self.method is Method.FIT
        useless = {
            "--resolution-mm": fit and self.resolution_mm is not None,
            "--intermediate": fit and self.intermediate > 0,
            "--exact": not fit and self.exact is not Exact.AUTO,
            "--nurbs": not fit and self.nurbs is not Nurbs.AUTO,
            "--layout": not fit and self.layout is not Layout.AUTO,
        }
        for option, given in useless.items():
            if given:
                other = Method.PAPER if fit else Method.FIT
                raise ValueError(
                    f"{option}: means nothing to --method {self.method.value}; leave it out, or"
                    f" choose --method {other.value}"
                )

    def course(self) -> AnyCourse:
        """Begin a reconstruction by the method that was chosen."""
        if self.method is Method.FIT:
            return FitCourse(self.exact, self.cleanup, nurbs=self.nurbs, layout=self.layout)
        paper = PaperSettings(resolution_mm=self.resolution_mm, intermediate=self.intermediate)
        return PaperCourse(paper, self.cleanup)

    def said(self) -> dict[str, object]:
        """The settings as provenance.json says them."""
        crop = self.crop and [self.crop.low_mm.tolist(), self.crop.high_mm.tolist()]
        return {
            "method": self.method.value,
            "axis": self.axis.value,
            "unit": self.unit.value,
            "spacing_mm": self.spacing_mm,
            "resolution_mm": self.resolution_mm,
            "tolerance_mm": self.tolerance_mm,
            "crop_mm": str(crop) if crop else None,
            "intermediate": self.intermediate,
            "exact": self.exact.value if self.method is Method.FIT else None,
            "nurbs": self.nurbs.value if self.method is Method.FIT else None,
            "layout": self.layout.value if self.method is Method.FIT else None,
            "axis_at_mm": str(list(self.axis_at_mm)) if self.axis_at_mm else None,
            "remesh_edge_mm": self.cleanup.remesh_edge_mm,
            "decimate_to_faces": self.cleanup.decimate_to_faces,
        }


def reconstruct_with(
    source: Path | str | ArrayLike,
    settings: Settings,
    *,
    name: str | None = None,
    progress: Progress = silent,
) -> Result:
    """Reconstruct a cloud file or an (n, 3) array, called `name` in what is written.

    Raises
    ------
    UnreadableCloud, TooFewPoints
        The input is no cloud, or too small for a surface.
    ReconstructionError
        The work failed; the message says what and what to do.
    """
    clock = _Clock()
    with open_input(source, settings.unit) as opened:
        with clock.stage("slicing"):
            cutting = _cut(opened, settings, progress)
        collector = _Collector(int(cutting.counts.sum()))
        with clock.stage("sections"):
            done = _draw(
                collector.pass_on(cutting.slices()), len(cutting.counts), settings, progress
            )
        with clock.stage("comparison"):
            progress("comparison", 0, 1)
            deviation = _compare(collector.points, done, settings)
            progress("comparison", 1, 1)
        title = name or Path(opened.name).stem
        return _conclude(title, opened, cutting, done, collector.points, deviation, settings, clock)


def _cut(opened: Input, settings: Settings, progress: Progress) -> Cutting | FanCutting:
    spacing_mm, crop = settings.spacing_mm, settings.crop
    try:
        if settings.layout is Layout.MERIDIANS:
            counted = _counted(opened, progress, PASSES + FAN_PASSES)
            place_mm = settings.axis_at_mm
            return fan_cloud(
                counted, settings.axis, place_mm=place_mm, spacing_mm=spacing_mm, crop=crop
            )
        counted = _counted(opened, progress, PASSES)
        return cut_cloud(counted, settings.axis, spacing_mm=spacing_mm, crop=crop)
    except TooFewPoints as few:
        inside = "" if settings.crop is None else " inside --crop"
        raise TooFewPoints(f"{opened.name}{inside}: {few}") from few


def _counted(opened: Input, progress: Progress, passes: int) -> Pass:
    """The passes over an input, told as they go: every point is passed so many times."""
    seen = 0

    def passing() -> Iterator[FloatArray]:
        nonlocal seen
        for chunk in opened.chunks():
            yield chunk
            seen += len(chunk)
            progress("slicing", seen, passes * (opened.points or opened.cloud.point_count or 0))

    return passing


def _draw(
    slices: Iterator[Slice], count: int, settings: Settings, progress: Progress
) -> AnyReconstruction:
    running = run_course(slices, settings.course(), OF_A_CLOUD)
    for number, ready in enumerate(running, start=1):
        if isinstance(ready, (Reconstruction, FittedReconstruction)):
            return ready
        progress("sections", number, count)
    raise AssertionError("a course ends with its surface")


def _compare(sample_mm: FloatArray, done: AnyReconstruction, settings: Settings) -> Deviation:
    return compare_to_mesh(sample_mm, done.mesh, tolerance_mm=settings.tolerance_mm)


def _conclude(
    title: str,
    opened: Input,
    cutting: Cutting | FanCutting,
    done: AnyReconstruction,
    sample_mm: FloatArray,
    deviation: Deviation,
    settings: Settings,
    clock: _Clock,
) -> Result:
    numbers = metrics.gather(opened, cutting, done, deviation)
    numbers |= metrics.resources(clock.seconds)
    size = judge_size(cutting.box, opened.unit)
    return Result(
        name=title,
        reconstruction=done,
        cutting=cutting,
        sample_mm=sample_mm,
        deviation=deviation,
        metrics=numbers,
        provenance=provenance.record(provenance.describe(opened), settings.said()),
        warnings=(
            *([size] if size else []),
            *judge(cutting, done),
            *judge_surface(cutting, done, sample_mm, deviation, settings.cleanup),
        ),
    )


class _Collector:
    """Keeps every k-th point of the slices that pass by, at most 200 000."""

    def __init__(self, points: int) -> None:
        self._stride = max(1, -(-points // _SAMPLE))
        self._offset = 0
        self._kept: list[FloatArray] = []

    def pass_on(self, slices: Iterator[Slice]) -> Iterator[Slice]:
        for piece in slices:
            self._kept.append(piece.points_mm[self._offset :: self._stride].copy())
            self._offset = (self._offset - len(piece.points_mm)) % self._stride
            yield piece

    @property
    def points(self) -> FloatArray:
        return np.concatenate([np.empty((0, 3)), *self._kept])


class _Clock:
    """Wall-clock seconds of each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begun = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - begun, 4)
