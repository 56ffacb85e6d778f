"""A picture of one fitted slice: points, chain, curves, their 95 % band, gaps, what was left out.

The band of a good fit is thinner than the line that draws the curve. In the whole picture it is
drawn wider than it is, by a factor that the legend says; the close-up beside has it to scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from loftscan.figures import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, RED, section_figure
from reconstruction.arrays import FloatArray, IntArray
from reconstruction.fitting.curve import FittedCurve
from reconstruction.fitting.section import SectionFit

_DRAWN = 20_000  # points; more make the picture no clearer
_SAMPLES = 1201  # of a curve
_SEEN = 0.006  # of the picture: a band thinner than this is exaggerated
_WIDEST = 0.06  # of the picture
_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_CLOSE_UP_WIDTHS = 8.0  # thicknesses of the cloud
_CLOSE_UP_SHARE = 0.15  # of the slice, at most


@dataclass(frozen=True, slots=True, eq=False)
class SliceView:
    """What is drawn of a slice in its plane."""

    points_mm: FloatArray  # (n, 2), all, or a sample of them
    curves: Sequence[FittedCurve]
    nodes_mm: Sequence[FloatArray]  # of the chains that the curves were fitted in
    strays: IntArray  # indices of points set aside
    unordered: IntArray  # indices of points in heaps
    measured: int  # points that are neither, where `points_mm` are some of them

    @property
    def width_mm(self) -> float:
        """Thickness of the cloud."""
        return 4.0 * max((curve.sigma_mm for curve in self.curves), default=0.0)


def view_fit(points_mm: FloatArray, found: SectionFit) -> SliceView:
    """Everything that was found in the points (n, 2) of a slice."""
    nodes = [chain.nodes_mm for chain in found.chains]
    measured = len(points_mm) - len(found.strays) - len(found.unordered)
    return SliceView(points_mm, found.curves, nodes, found.strays, found.unordered, measured)


def fitted_figure(view: SliceView, *, title: str) -> Figure:
    """Draw a slice with its curves."""
    points_mm = view.points_mm
    used = np.ones(len(points_mm), bool)
    used[view.strays] = used[view.unordered] = False
    figure = section_figure(
        _thinned(points_mm, np.flatnonzero(used)),
        title=title,
        left_out_mm=_thinned(points_mm, view.strays),
        measured=view.measured,
    )
    whole = figure.axes[0]
    whole.set_position((0.115, 0.1, 0.635, 0.82))  # room for long numbers
    size = float(np.ptp(points_mm, axis=0).max())
    _draw(whole, view, _exaggeration(view.curves, size))
    window = _window(view, size)
    if window is not None:
        _draw_close_up(figure, view, *window)
    figure.legends[0].remove()
    figure.legend(
        *whole.get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(0.995, 0.93),
        frameon=False, fontsize=8,
    )  # fmt: skip
    return figure


def _thinned(points_mm: FloatArray, rows: IntArray) -> FloatArray:
    return points_mm[rows[:: max(-(-len(rows) // _DRAWN), 1)]]


def _exaggeration(curves: Sequence[FittedCurve], size_mm: float) -> int:
    """How many times as wide the band is drawn."""
    if not curves:
        return 1
    halves = np.concatenate([1.96 * curve.deviations_mm for curve in curves])
    wanted = min(
        _SEEN * size_mm / max(float(np.median(halves)), 1e-300),
        _WIDEST * size_mm / max(float(halves.max()), 1e-300),
    )
    return max(factor for factor in _FACTORS if factor <= max(wanted, 1.0))


def _draw(axes: Axes, view: SliceView, factor: int) -> None:
    """Everything but the points that are on curves; labels once each."""
    said = set[str]()

    def label(words: str) -> str | None:
        new = words not in said
        said.add(words)
        return words if new else None

    if len(view.unordered):
        heap = _thinned(view.points_mm, view.unordered)
        words = f"{len(view.unordered):,} unordered"
        axes.scatter(
            heap[:, 0], heap[:, 1], s=5, c=PURPLE, lw=0, label=label(words), rasterized=True
        )
    band = "95 % band" if factor == 1 else f"95 % band, {factor} x as wide"
    for nodes in view.nodes_mm:
        axes.plot(*nodes.T, ".", ms=2.2, color=GREEN, label=label("chain"), zorder=2.2)
    for curve in view.curves:
        axes.add_patch(_band(curve, factor, label(band)))
        colour, words = (INK, "ambiguous") if curve.ambiguous else (BLUE, "curve")
        grid = np.linspace(*curve.domain, _SAMPLES)
        axes.plot(*curve(grid).T, color=colour, lw=1.2, label=label(words), zorder=2.4)
        for stretch in _gaps(curve):
            x, y = stretch.T
            axes.plot(x, y, c=RED, lw=2.2, ls=(0, (2, 1)), label=label("gaps"), zorder=2.6)
        if curve.creases:
            x, y = curve(np.array(curve.creases)).T
            axes.plot(x, y, "D", ms=4, mfc="none", mec=INK, label=label("corners"), zorder=2.7)


def _band(curve: FittedCurve, factor: int, label: str | None) -> PathPatch:
    grid = np.linspace(*curve.domain, _SAMPLES)
    arms = factor * 1.96 * curve.deviation_mm(grid)[:, None] * curve.normals(grid)
    places = curve(grid)
    sides = (places + arms, (places - arms)[::-1])
    path = Path(np.concatenate(sides))
    if curve.closed:
        path = Path.make_compound_path(*(Path(side) for side in sides))
    return PathPatch(path, fc=ORANGE, alpha=0.45, lw=0, label=label, zorder=2)


def _gaps(curve: FittedCurve) -> list[FloatArray]:
    start, end = curve.domain
    stretches = []
    for a, b in curve.gaps:
        grid = np.linspace(a, b if a < b else b + end - start, 101)
        stretches.append(curve(np.where(grid > end, grid - (end - start), grid)))
    return stretches


def _window(view: SliceView, size_mm: float) -> tuple[FloatArray, float] | None:
    """Middle and side of the close-up: where a gap begins, else some place of the first curve."""
    if not view.curves:
        return None
    side = min(max(_CLOSE_UP_WIDTHS * view.width_mm, 0.02 * size_mm), _CLOSE_UP_SHARE * size_mm)
    gapped = next((curve for curve in view.curves if curve.gaps), None)
    if gapped is not None:
        return gapped(gapped.gaps[0][0]), side
    start, end = view.curves[0].domain
    return view.curves[0](start + (end - start) / 8), side


def _draw_close_up(figure: Figure, view: SliceView, middle: FloatArray, side: float) -> None:
    low, high = middle - side / 2, middle + side / 2
    width, height = figure.get_size_inches()
    axes = figure.add_axes((0.775, 0.1, 0.205, 0.205 * width / height))
    points_mm = view.points_mm
    near = points_mm[((points_mm > low) & (points_mm < high)).all(axis=1)]
    x, y = near[:: max(len(near) // _DRAWN, 1)].T
    axes.scatter(x, y, s=4, c=MUTED, lw=0, rasterized=True)
    _draw(axes, view, 1)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=(), yticks=())
    axes.set_title(f"close-up, {side:.3g} mm, to scale", fontsize=8.5, color=MUTED, pad=4)
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
    figure.axes[0].plot(*corners.T, color=INK, lw=0.9, zorder=3)
