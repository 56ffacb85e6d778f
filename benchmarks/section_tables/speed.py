"""Time, memory and compilation."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from reconstruction.errors import TooFewPoints
from reconstruction.fitting.bands import factorise, solve
from reconstruction.fitting.preliminary import normal_equations
from reconstruction.fitting.section import resolve_section
from reconstruction.fitting.section_fit import fit_ordered
from reconstruction.fitting.topology import find_chains
from section_tables.outlines import CURVES, SIGMA_MM, Array, Outline, drawn
from section_tables.rivals import paper_mm

PROFILES, WIDTH = 360, 1280  # a slice: so many profiles of so many points
ORDERED, CONTROL = 10_000, 80
REPEATS = 15

# A process that reads a slice; or lets a kernel see its points once, too; or fits a few of them,
# for warm-up; or fits the whole; and says the most memory it ever had, in kB.
_READS = """
import sys
import numpy as np
from reconstruction.fitting.cells import bounds
from reconstruction.fitting.section import resolve_section
points = np.load(sys.argv[1])
if sys.argv[2] == "see":
    bounds(points)
if sys.argv[2] == "warm":
    resolve_section(points[::40].copy())
if sys.argv[2] == "fit":
    assert resolve_section(points).curves
print(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
"""

# A process that fits one small slice twice: seconds, and kernels that were not found compiled.
_FITS = """
import sys, time
import numpy as np
from numba.core.registry import CPUDispatcher
from reconstruction.fitting.section import resolve_section
points = np.load(sys.argv[1])
times = []
for _ in range(2):
    begun = time.process_time()
    resolve_section(points)
    times.append(time.process_time() - begun)
modules = [module for name, module in sys.modules.items() if name.startswith("reconstruction.")]
kernels = {id(each): each for module in modules for each in vars(module).values()
           if isinstance(each, CPUDispatcher)}
stats = [each.stats for each in kernels.values()]
missed = sum(sum(each.cache_misses.values()) for each in stats)
loaded = sum(sum(each.cache_hits.values()) for each in stats)
print(*times, missed, loaded)
"""


def speed_table(shapes: dict[str, Outline], _seeds: int | None) -> Iterator[str]:
    """Processor time of one core after warm-up, and what a fresh process needs."""
    yield f"Speed: processor time of one core after warm-up, best and median of {REPEATS}, ms"
    yield from _slice_times(shapes)
    yield from _ordered_times(shapes["superformula"])
    with tempfile.TemporaryDirectory() as folder:
        yield from _memory(Path(folder), shapes)
        yield from _compilation(Path(folder), shapes["superformula"])


def _slice_times(shapes: dict[str, Outline]) -> Iterator[str]:
    count = PROFILES * WIDTH
    yield f"a slice, {PROFILES} x {WIDTH} = {count} points shuffled, to its curve (bound 65)"
    yield f"  {'':14}{'best':>8}{'median':>8}{'ns a point':>12}{'topology':>10}{'paper':>8}"
    for name, outline in shapes.items():
        points, _ = drawn(outline, 1, count=count)
        best, median = times_ms(lambda points=points: resolve_section(points))
        topology, _ = times_ms(lambda points=points: find_chains(points))
        paper, _ = times_ms(lambda points=points, outline=outline: _paper(points, outline), 3)
        yield (f"  {name:14}{best:8.1f}{median:8.1f}{1e6 * best / count:12.0f}{topology:10.1f}"
               f"{paper:8.1f}")  # fmt: skip


def _paper(points: Array, outline: Outline) -> None:
    try:
        paper_mm(points, outline)
    except TooFewPoints:
        return


def _ordered_times(outline: Outline) -> Iterator[str]:
    points, share = drawn(outline, 0, count=ORDERED)
    wrap = csr_array(np.vstack([np.eye(CONTROL), np.eye(CONTROL)[:3]]))

    def scipys() -> object:
        knots = np.arange(-3.0, CONTROL + 4)
        design = BSpline.design_matrix(share * CONTROL, knots, 3) @ wrap
        return np.linalg.solve((design.T @ design).toarray(), design.T @ points)

    def ours() -> object:
        band, right = normal_equations(share * CONTROL, points, CONTROL, closed=True)
        return solve(*factorise(band), right)

    def full() -> object:
        return fit_ordered(points, share, spans=CONTROL, closed=True, sigma_mm=SIGMA_MM)

    assert np.allclose(scipys(), ours())
    yield f"{ORDERED} points, {CONTROL} control points, the order given"
    for words, work in (
        ("one solve (bound 1.5)", ours),
        ("the same by scipy's design_matrix", scipys),
        ("full fit (bound 5)", full),
    ):
        best, median = times_ms(work)
        yield f"  {words:36}{best:8.2f}{median:8.2f}"
    path = CURVES / "Monitor0.txt"
    if path.is_file():
        monitor = np.loadtxt(path)
        best, median = times_ms(lambda: resolve_section(monitor))
        yield f"peers' Monitor0, {len(monitor)} points, whole: {best:.1f} (median {median:.1f});"
        yield "  by their own programs 3600 (FitConnect) and 7300 (StretchDenoise)"


def times_ms(work: Callable[[], object], repeats: int = REPEATS) -> tuple[float, float]:
    """Least and median processor time of several runs after one."""
    work()
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return 1e3 * min(times), 1e3 * float(np.median(times))


def _memory(folder: Path, shapes: dict[str, Outline]) -> Iterator[str]:
    if not Path("/proc/self/status").exists():
        yield "memory: not measured, this system has no /proc"
        return
    yield "most memory of a fresh process (VmHWM), MB above one that reads the same slice ..."
    yield f"  {'':14}{'and fits few':>14}{'and sees it':>14}{'and no more':>14}   (bound 30)"
    for name, outline in shapes.items():
        path = folder / "slice.npy"
        np.save(path, drawn(outline, 1, count=PROFILES * WIDTH)[0])
        _run(_READS, path, "fit")  # its kernels are compiled
        most = [int(_run(_READS, path, what)[0]) for what in ("fit", "warm", "see", "read")]
        above = "".join(f"{(most[0] - each) / 1024:14.1f}" for each in most[1:])
        yield f"  {name:14}{above}"
    yield "  few: every 40th point, for warm-up; sees: one kernel, so that numba itself is counted"
    yield "  on both sides; no more: numba's own 40 MB are counted in"


def _compilation(folder: Path, outline: Outline) -> Iterator[str]:
    path = folder / "small.npy"
    np.save(path, drawn(outline, 0)[0])
    yield "compilation: the first fit of 2000 points in a process, s, and the second"
    for words in ("no kernel on disk", "the next process"):
        first, second, missed, loaded = _run(_FITS, path, cache=folder / "kernels")
        yield (f"  {words:20}{float(first):8.2f}{float(second):8.3f}   {missed} kernels compiled,"
               f" {loaded} loaded")  # fmt: skip


def _run(program: str, *arguments: object, cache: Path | None = None) -> list[str]:
    """Words that a program prints, in a process of its own."""
    environment = dict(os.environ) | ({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)})
    ran = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True, text=True, check=True, env=environment,
    )  # fmt: skip
    return ran.stdout.split()
