"""Slices come, sections go: the reconstruction of whatever delivers slices one by one.

A generator from end to end: nothing runs between two steps, and closing it closes what delivers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from acquisition.errors import DamagedSlice
from loftscan import metrics, provenance
from loftscan.findings import judge, judge_arrivals
from loftscan.gathering import Gathered, Intake, coverage
from loftscan.inputs import Unit
from loftscan.methods import AnyCourse, AnyReconstruction, AnySection, Method
from loftscan.progress import Progress, silent
from loftscan.reconstructing import Settings
from loftscan.result import Result
from loftscan.scans import Absent, Arrival, Source
from loftscan.stage_clock import StageClock
from loftscan.surface_findings import judge_surface
from loftscan.updates import Finished, Fitted, Missed, Standing, Update
from reconstruction.comparison import Deviation, compare_to_mesh
from reconstruction.course import Remedy
from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.sections import Skipped
from reconstruction.skinning.layout import Layout, is_turned
from reconstruction.slices import Frame
from reconstruction.survey import Axis

_REMEDY = Remedy(
    "scan more slices",
    "Look whether the sensor sees the part all round",
)


def stream(
    source: Source,
    settings: Settings,
    *,
    name: str | None = None,
    progress: Progress = silent,
    prepare: Callable[[Settings], None] = lambda _: None,
    now_s: Callable[[], float] = time.time,
) -> Generator[Update]:
    """Reconstruct slices as they come; the last update is the result.

    `prepare` is called with the settings before the first slice is asked for.

    Raises
    ------
    ValueError
        At once, for settings that slices do not take; later, for slices out of order.
    TooFewPoints, DamagedSlice
        No slice came, or none that can be used.
    ReconstructionError
        The work failed; the message says what and what to do.
    """
    check_settings(settings)
    run = _Run(source, settings, name or Path(source.name).stem, progress, now_s)
    return run.updates(prepare)


def finish(updates: Iterator[Update]) -> Result:
    """Take all updates and give the result."""
    *_, last = updates
    assert isinstance(last, Finished), "a stream ends with its result"
    return last.result


def check_settings(settings: Settings) -> None:
    """Refuse what slices say themselves.

    Raises
    ------
    ValueError
    """
    said = {
        f"--axis {settings.axis.value}": settings.axis is not Axis.Z,
        "--spacing-mm": settings.spacing_mm is not None,
        f"--unit {settings.unit.value}": settings.unit is not Unit.MM,
        "--axis-at": settings.axis_at_mm is not None,
    }
    wrong = [option for option, given in said.items() if given]
    if wrong:
        raise ValueError(
            f"{wrong[0]}: the slices of a scan say their axis, heights and unit (mm) themselves;"
            " leave the option out"
        )


def laid_out(settings: Settings, scanned: Layout, name: str) -> Settings:
    """Settings with the layout that a scan was taken in, where nobody chose one.

    Raises
    ------
    ValueError
        The two contradict each other, or the method cannot join such slices.
    """
    if scanned is Layout.AUTO:
        return settings
    if settings.method is Method.PAPER:
        raise ValueError(_only_rings(name, scanned))
    if settings.layout in (Layout.AUTO, scanned):
        return replace(settings, layout=scanned)
    if Layout.MERIDIANS in (settings.layout, scanned):
        raise ValueError(
            f"--layout {settings.layout.value}: the slices of {name} are {scanned.value}, as its"
            " plan says; leave the option out"
        )
    return settings


def _only_rings(name: str, layout: Layout) -> str:
    return (
        f"--method paper: the slices of {name} are {layout.value}, and the paper's method joins"
        " rings only; choose --method fit"
    )


class _Run:
    """One reconstruction under way."""

    def __init__(
        self,
        source: Source,
        settings: Settings,
        name: str,
        progress: Progress,
        now_s: Callable[[], float],
    ) -> None:
        self._source = source
        self._settings = settings
        self._name = name
        self._progress = progress
        self._now_s = now_s
        self._begun_s = now_s()
        self._clock = StageClock(time.perf_counter)
        self._intake = Intake(settings.crop)
        self._damages: list[str] = []
        self._begun: AnyCourse | None = None
        self._first: Frame | None = None  # plane of the first slice
        self._sections: list[AnySection] = []
        self._skipped: list[Skipped] = []
        self._lags_s: list[float] = []
        self._appeared_s: list[float] = []
        self._total: int | None = None
        self._done = 0

    def updates(self, prepare: Callable[[Settings], None]) -> Generator[Update]:
        prepare(self._settings)
        self._clock.to("slicing")
        with closing(self._source.pieces()) as pieces:
            for piece in pieces:
                self._done += 1
                self._total = self._total or self._source.total
                update = self._miss(piece) if isinstance(piece, Absent) else self._draw(piece)
                self._progress("sections", self._done, self._total or 0)
                self._clock.to(None)
                yield update
                self._clock.to("slicing")
        result = self._result()
        self._clock.to(None)
        yield Finished(result)

    def _miss(self, absent: Absent) -> Missed:
        self._intake.miss(absent)
        if absent.damage is not None:
            self._damages.append(f"slice {absent.index}: {absent.damage}")
        why = "not there" if absent.damage is None else f"damaged: {absent.damage}"
        return Missed(absent.index, 0, why, self._standing(0.0, None))

    def _draw(self, arrival: Arrival) -> Fitted | Missed:
        piece = self._intake.take(arrival)
        self._clock.to("sections")
        seen, points = coverage(piece), len(piece.points_mm)
        self._first = self._first or piece.frame
        if self._settings.method is Method.PAPER and is_turned(self._first, piece.frame):
            raise NotLoftable(_only_rings(self._source.name, Layout.MERIDIANS))
        try:
            section = self._course().draw(piece)
        except TooFewPoints as few:
            self._skipped.append(Skipped(piece.index, points, str(few)))
            return Missed(piece.index, points, str(few), self._standing(seen, arrival))
        self._sections.append(section)
        return Fitted(section, self._standing(seen, arrival), tuple(self._sections))

    def _course(self) -> AnyCourse:
        """Begun with the first slice: before that a scan's plan may not be there to say its layout.

        Raises
        ------
        ValueError
            The scan was taken otherwise than the settings say, or can say.
        """
        if self._begun is None:
            settings = laid_out(self._settings, self._source.layout(), self._source.name)
            self._begun = settings.course()
        return self._begun

    def _standing(self, seen: float, arrival: Arrival | None) -> Standing:
        """How far it is. A slice that was there before the beginning has not waited for us."""
        lag_s: float | None = None
        appeared_s = None if arrival is None else arrival.appeared_s
        if appeared_s is not None:
            self._appeared_s.append(appeared_s)
        if appeared_s is not None and appeared_s >= self._begun_s:
            # Two clocks tell: a file's time may lie a tick ahead.
            lag_s = max(0.0, self._now_s() - appeared_s)
            self._lags_s.append(lag_s)
        return Standing(self._done, self._total, seen, lag_s)

    def _result(self) -> Result:
        self._clock.to("sections")
        gathered = self._gathered()
        done = self._course().finish(self._skipped, _REMEDY)
        self._clock.to("comparison")
        self._progress("comparison", 0, 1)
        deviation = compare_to_mesh(
            gathered.sample_mm, done.mesh, tolerance_mm=self._settings.tolerance_mm
        )
        self._progress("comparison", 1, 1)
        self._clock.to(None)
        return self._concluded(gathered, done, deviation)

    def _concluded(
        self, gathered: Gathered, done: AnyReconstruction, deviation: Deviation
    ) -> Result:
        numbers = metrics.gather(gathered, gathered, done, deviation)
        numbers |= metrics.of_scan(gathered) | metrics.lag(self._lags_s, self._appeared_s)
        numbers |= metrics.resources(self._clock.seconds)
        remarks = self._source.remarks()
        missed = judge_arrivals(gathered, self._source.name)
        away = judge_surface(gathered, done, gathered.sample_mm, deviation, self._settings.cleanup)
        return Result(
            name=self._name,
            reconstruction=done,
            cutting=gathered,
            sample_mm=gathered.sample_mm,
            deviation=deviation,
            metrics=numbers,
            provenance=provenance.record(self._source.origin(), self._settings.said()),
            warnings=(*remarks, *missed, *judge(gathered, done), *away),
        )

    def _gathered(self) -> Gathered:
        if not self._intake.empty:
            return self._intake.gathered()
        if self._damages:
            raise DamagedSlice(
                f"{self._source.name}: no slice that can be read ({self._damages[0]}); resume the"
                " scan to take them again"
            )
        raise TooFewPoints(f"{self._source.name}: no slice in it yet; scan first")
