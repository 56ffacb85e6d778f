"""The paper's plane figures: cells, macro-region, curve, pairs (1, 2, 3, 5) and resolution (6)."""

from __future__ import annotations

import math
from typing import Any

import matplotlib as mpl
import numpy as np
from circles import COARSE_MM, FINE_MM, RADIUS_MM, SEEDS, Trial, run_trial
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from loftscan.figures import BLUE, GREEN, INK, MUTED, ORANGE, RED, RULE
from reconstruction.arrays import FloatArray, IntArray
from reconstruction.correspondence import connect_pairs
from reconstruction.numbering import number_contour
from reconstruction.nurbs import evaluate_curve, periodic_uniform
from reconstruction.ordering import Walk, walk_contour
from reconstruction.reduction import Cells, reduce_points

_STYLE: Any = {
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "font.size": 9,
    "legend.frameon": False,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
}
_LATTICE = "#b4bdc6"
_SPARSE = 6.0  # points a mm of arc where single points should be seen
_WINDOW = ((22.0, 46.0), (22.0, 46.0))  # of Figs. 1 and 2, in mm
_LOBES_WIDTH_MM = 3.0
_BIGGER, _SMALLER = 15, 10  # the paper's own example of Fig. 5


def figure_1() -> Figure:
    """Points and regions; regions and their centres of mass."""
    trial = run_trial(0, COARSE_MM, Walk.PURE, points_a_mm=_SPARSE)
    with mpl.rc_context(_STYLE):
        figure, (left, right) = _panels(2)
        _grid(left, trial)
        _points(left, trial.points_mm, size=5.0)
        left.set_title("a) acquired points, regions of 4 mm")
        _grid(right, trial)
        _shade(right, trial)
        right.plot(*trial.cells.centres_mm[:, :2].T, "o", ms=5, mfc=BLUE, mec="white")
        for centre, count in zip(trial.cells.centres_mm, trial.cells.counts, strict=True):
            if _inside(centre):
                place = (centre[0] + 0.35, centre[1] + 0.35)
                right.annotate(f"{count}", place, size=7.5, color=INK)
        right.set_title("b) their centres of mass, with point counts")
        for axes in (left, right):
            axes.set(xlim=_WINDOW[0], ylim=_WINDOW[1])
    return figure


def figure_2() -> Figure:
    """One step of the macro-region walk, with the product that decides it."""
    trial = run_trial(0, COARSE_MM, Walk.PURE, points_a_mm=_SPARSE)
    step = _step_inside(trial)
    path = trial.contour.cells
    here, there = int(path[step]), int(path[step + 1])
    with mpl.rc_context(_STYLE):
        figure = Figure((6.4, 5.6))
        axes = figure.add_axes((0.08, 0.08, 0.9, 0.84))
        _grid(axes, trial)
        _shade(axes, trial)
        _mark_macro_region(axes, trial, here)
        _points(axes, trial.points_mm, size=4.0)
        _judge_neighbours(axes, trial, step)
        walked = trial.contour.points_mm[: step + 1]
        axes.plot(*walked.T, "-o", color=BLUE, lw=1.4, ms=5, mec="white", zorder=4)
        _arrow(axes, trial.cells.centres_mm[here], trial.cells.centres_mm[there])
        middle = trial.cells.centres_mm[here]
        axes.set(xlim=middle[0] + np.array([-8.5, 8.5]), ylim=middle[1] + np.array([-7.5, 7.5]))
        axes.set_aspect("equal")
        axes.set(xlabel="x [mm]", ylabel="y [mm]")
        axes.set_title("macro-region of cell 1: count x distance [mm]; crosses are eliminated")
    return figure


def figure_3() -> Figure:
    """Acquired points, centres of mass as control points, and the NURBS curve of them."""
    points = _lobes(np.random.default_rng(3))
    cell = 6.0
    cells = reduce_points(points, size_mm=(cell, cell, math.inf), origin_mm=np.zeros(3))
    contour = number_contour(walk_contour(cells, walk=Walk.PURE), reference_x_mm=0.0)
    curve = periodic_uniform(contour.points_mm)
    line = evaluate_curve(curve, np.linspace(*curve.domain, 24 * len(contour.points_mm) + 1))
    with mpl.rc_context(_STYLE):
        figure, panels = _panels(2)
        for axes in panels:
            _points(axes, points, size=1.6)
            ring = np.vstack([contour.points_mm, contour.points_mm[:1]])
            axes.plot(*line.T, color=BLUE, lw=1.6, zorder=3)
            axes.plot(*ring.T, "-o", color=ORANGE, lw=0.9, ms=4.6, mec="white", mew=0.6, zorder=4)
        _number(panels[0], contour.points_mm)
        _legend(panels[0], [(MUTED, "points"), (ORANGE, "CM"), (BLUE, "NURBS")])
        panels[0].set_title(f"{len(points)} points, {len(contour.points_mm)} CM, one NURBS curve")
        panels[1].set(xlim=(20, 48), ylim=(10, 38), title="enlarged")
    return figure


def count_pairs() -> int:
    """How many pairs connect the two sections of Fig. 5."""
    groups = connect_pairs(_uneven_ring(_BIGGER, 10.0), _SMALLER)
    return int((np.diff(np.append(groups, _BIGGER)) == 2).sum())


def figure_5() -> Figure:
    """Fifteen control points onto ten."""
    bigger, smaller = _uneven_ring(_BIGGER, 10.0), _ring(_SMALLER, 6.4)
    groups = connect_pairs(bigger, _SMALLER)
    sizes = np.diff(np.append(groups, _BIGGER))
    with mpl.rc_context(_STYLE):
        figure = Figure((6.2, 5.9))
        axes = figure.add_axes((0.03, 0.03, 0.94, 0.89))
        _paint_pairs(axes, bigger, smaller, groups, sizes)
        axes.axvline(0.0, color=GREEN, lw=1.0, ls=(0, (6, 3)), zorder=0)
        axes.annotate("reference line", (0.2, -12.2), color=GREEN, size=8.5)
        for ring, colour, outward in ((bigger, BLUE, 1.0), (smaller, INK, -1.0)):
            axes.plot(*np.vstack([ring, ring[:1]]).T, "-o", color=colour, lw=1.6, ms=5.5, mec="w")
            for number, point in enumerate(ring, start=1):
                place = point * (1.0 + outward * 0.9 / math.hypot(*point))
                axes.annotate(f"{number}", place, ha="center", va="center", color=colour, size=8.5)
        axes.set(xlim=(-12.5, 12.5), ylim=(-12.5, 12.5))
        axes.set_aspect("equal")
        axes.axis("off")
        axes.set_title(f"{_BIGGER} control points onto {_SMALLER}: orange, the pairs")
    return figure


def figure_6_trials() -> tuple[Trial, Trial]:
    """The first cloud whose fine walk closes, fine and coarse."""
    seed = next(seed for seed in SEEDS if run_trial(seed, FINE_MM, Walk.PURE).is_ring)
    return run_trial(seed, FINE_MM, Walk.PURE), run_trial(seed, COARSE_MM, Walk.PURE)


def figure_6(fine: Trial, coarse: Trial) -> Figure:
    """The same cloud at 0.8 mm and at 4 mm, whole and enlarged."""
    angle = np.linspace(0.0, math.tau, 721)
    truth = RADIUS_MM * np.column_stack([np.cos(angle), np.sin(angle)])
    with mpl.rc_context(_STYLE):
        figure = Figure((9.2, 8.6))
        panels = figure.subplots(2, 2, height_ratios=(3, 2))
        for column, (trial, cell_mm, name) in enumerate(
            ((fine, FINE_MM, "a"), (coarse, COARSE_MM, "b"))
        ):
            _draw_trial(panels[0, column], trial, truth, size=0.12)
            panels[0, column].set(xlim=(-56, 56), ylim=(-56, 56))
            panels[0, column].set_title(f"{name}) resolution {cell_mm:g} mm")
            _draw_trial(panels[1, column], trial, truth, size=1.2)
            _outline_cells(panels[1, column], trial)
            panels[1, column].set(xlim=(26, 50), ylim=(24, 40.5), xlabel="x [mm]")
            panels[1, column].set_title("enlarged, with its regions")
        _legend(
            panels[0, 1],
            [(RULE, "points"), (ORANGE, "CM"), (BLUE, "NURBS"), (GREEN, "true circle")],
        )
        for axes in panels[:, 0]:
            axes.set_ylabel("y [mm]")
        figure.subplots_adjust(0.07, 0.06, 0.99, 0.96, wspace=0.12, hspace=0.16)
    return figure


# -- pieces --------------------------------------------------------------------------------------


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure((4.6 * count, 4.7))
    panels = [figure.add_subplot(1, count, k + 1) for k in range(count)]
    for axes in panels:
        axes.set_aspect("equal")
        axes.set(xlabel="x [mm]", ylabel="y [mm]")
    figure.subplots_adjust(0.07, 0.09, 0.99, 0.93, wspace=0.18)
    return figure, panels


def _points(axes: Axes, points_mm: FloatArray, *, size: float, colour: str = MUTED) -> None:
    axes.scatter(
        points_mm[:, 0], points_mm[:, 1], s=size, c=colour, lw=0, rasterized=True, zorder=2
    )


def _legend(axes: Axes, entries: list[tuple[str, str]]) -> None:
    handles = [mpl.lines.Line2D([], [], color=colour, lw=3) for colour, _ in entries]
    axes.legend(handles, [text for _, text in entries], loc="center", fontsize=8.5)


def _grid(axes: Axes, trial: Trial) -> None:
    """The lattice of the reduction over the whole section."""
    for first, direction in ((trial.corner_mm[0], "v"), (trial.corner_mm[1], "h")):
        lines = first + COARSE_MM * np.arange(-16, 17)
        draw = axes.axvline if direction == "v" else axes.axhline
        for line in lines:
            draw(float(line), color=_LATTICE, lw=0.8, zorder=0)


def _shade(axes: Axes, trial: Trial) -> None:
    cells = trial.cells
    low = trial.corner_mm[:2] + cells.lattice[:, :2] * COARSE_MM
    squares = [Rectangle(tuple(corner), COARSE_MM, COARSE_MM) for corner in low]
    shades = np.tile(mpl.colors.to_rgba(GREEN), (len(cells), 1))
    shades[:, 3] = 0.06 + 0.34 * cells.counts / cells.counts.max()
    axes.add_collection(PatchCollection(squares, facecolors=shades, edgecolors=_LATTICE, lw=0.8))


def _inside(place: FloatArray) -> bool:
    (x0, x1), (y0, y1) = _WINDOW
    return bool(x0 < place[0] < x1 - 1 and y0 < place[1] < y1 - 1)


def _step_inside(trial: Trial) -> int:
    """A step of the walk, with something to choose from, in the first quadrant."""
    for step in range(3, len(trial.contour.points_mm) - 1):
        rivals = _candidates(trial, step)
        if len(rivals) >= 3 and (trial.contour.points_mm[step] > 20.0).all():
            return step
    raise AssertionError("no step of the walk had three candidates")


def _candidates(trial: Trial, step: int) -> dict[int, float]:
    """Living neighbours of a step's cell, with count x distance; by the rule, not by the walk."""
    cells, path = trial.cells, trial.contour.cells
    gone: set[int] = set(path[: step + 1].tolist())
    for earlier in path[1:step]:
        gone |= _neighbours(cells, int(earlier))
    here = int(path[step])
    away = np.linalg.norm(cells.centres_mm - cells.centres_mm[here], axis=1)
    return {k: float(cells.counts[k] * away[k]) for k in sorted(_neighbours(cells, here) - gone)}


def _neighbours(cells: Cells, here: int) -> set[int]:
    away = np.abs(cells.lattice[:, :2] - cells.lattice[here, :2]).max(axis=1)
    return set(np.flatnonzero(away == 1).tolist())


def _mark_macro_region(axes: Axes, trial: Trial, here: int) -> None:
    low = trial.corner_mm[:2] + (trial.cells.lattice[here, :2] - 1) * COARSE_MM
    side = 3 * COARSE_MM
    axes.add_patch(Rectangle((low[0], low[1]), side, side, fill=False, ec=INK, lw=1.8, zorder=3))
    x, y, _ = trial.cells.centres_mm[here]
    axes.annotate("1", (x + 0.5, y + 0.1), weight="bold", size=11, zorder=6)


def _judge_neighbours(axes: Axes, trial: Trial, step: int) -> None:
    scores = _candidates(trial, step)
    chosen = max(scores, key=lambda cell: scores[cell])
    assert chosen == trial.contour.cells[step + 1], "the rule as drawn is not the rule as walked"
    here = int(trial.contour.cells[step])
    middle = trial.cells.centres_mm[here]
    onward = trial.cells.centres_mm[chosen] - middle
    for cell in _neighbours(trial.cells, here) - scores.keys():
        axes.plot(*trial.cells.centres_mm[cell, :2], "X", ms=7, color="#aab2ba", mec="w", zorder=3)
    for cell, score in scores.items():
        away = trial.cells.centres_mm[cell] - middle
        right = onward[0] * away[1] - onward[1] * away[0] < 0.0
        colour, marker = (RED, "o") if cell == chosen else (INK, "X")
        axes.plot(*trial.cells.centres_mm[cell, :2], marker, ms=8, color=colour, mec="w", zorder=5)
        count = trial.cells.counts[cell]
        words = f"{count} x {score / count:.2f} = {score:.0f}"
        place = trial.cells.centres_mm[cell, :2] + [0.45 if right else -0.45, 0.0]
        _words(axes, words, place, colour, side="left" if right else "right")


def _words(axes: Axes, words: str, place: FloatArray, colour: str, *, side: str) -> None:
    box = {"fc": "white", "ec": "none", "alpha": 0.85, "pad": 1.0}
    text = axes.annotate(words, (place[0], place[1]), ha=side, va="center", color=colour, size=8.5)
    text.set(bbox=box, zorder=6)


def _arrow(axes: Axes, start: FloatArray, end: FloatArray) -> None:
    style = {"arrowstyle": "-|>", "color": RED, "lw": 1.8, "shrinkA": 4, "shrinkB": 5}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=style, zorder=5)


def _lobes(rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0.0, math.tau, 2600)
    radius = 44.0 * (1.0 + 0.13 * np.cos(3.0 * angle)) + _LOBES_WIDTH_MM * rng.uniform(
        -0.5, 0.5, len(angle)
    )
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(angle))])


def _number(axes: Axes, points_mm: FloatArray) -> None:
    """Fig. 4 in passing: the reference line, the first centre of mass, and which way it goes."""
    axes.axvline(0.0, color=GREEN, lw=1.0, ls=(0, (6, 3)), zorder=0)
    for number, point in enumerate(points_mm[:5], start=1):
        place = point * (1.0 + 4.0 / math.hypot(*point))
        axes.annotate(f"{number}", place, ha="center", va="center", color=ORANGE, size=8.5)


def _ring(count: int, radius: float) -> FloatArray:
    angle = math.pi / 2 + 0.02 + math.tau * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _uneven_ring(count: int, radius: float) -> FloatArray:
    """A numbered section whose points are not equidistant, so that there are nearer ones."""
    order = np.arange(count)
    place = order + 0.33 * np.sin(1.7 * order)
    angle = math.pi / 2 + 0.02 + math.tau * place / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _paint_pairs(
    axes: Axes, bigger: FloatArray, smaller: FloatArray, groups: IntArray, sizes: IntArray
) -> None:
    links = []
    for number, (first, size) in enumerate(zip(groups, sizes, strict=True)):
        members = [bigger[(first + k) % len(bigger)] for k in range(size)]
        links += [np.array([member, smaller[number]]) for member in members]
        if size == 2:
            corners = np.array([*members, smaller[number]])
            axes.add_patch(Polygon(corners, fc=ORANGE, ec="none", alpha=0.45, zorder=1))
    axes.add_collection(LineCollection(links, colors=MUTED, lw=1.0, zorder=1))


def _draw_trial(axes: Axes, trial: Trial, truth_mm: FloatArray, *, size: float) -> None:
    axes.set_aspect("equal")
    _points(axes, trial.points_mm, size=size, colour="#c3cad1")
    axes.plot(*truth_mm.T, color=GREEN, lw=1.1, zorder=3)
    marker = 1.0 if size < 1 else 3.6
    axes.plot(*trial.contour.points_mm.T, "o", ms=marker, color=ORANGE, zorder=4)
    axes.plot(*trial.polyline_mm.T, color=BLUE, lw=0.8 if size < 1 else 1.4, zorder=5)


def _outline_cells(axes: Axes, trial: Trial) -> None:
    side = trial.cells.size_mm[0]
    low = trial.corner_mm[:2] + trial.cells.lattice[:, :2] * side
    squares = [Rectangle(tuple(corner), side, side) for corner in low]
    axes.add_collection(PatchCollection(squares, facecolors="none", edgecolors=RULE, lw=0.6))
