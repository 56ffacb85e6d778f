"""The report's figures: plots by matplotlib, pictures by `loftscan.rendering`.

Plain arrays in, a `Figure` out; `png` makes bytes of it. Only Figure objects, never pyplot: no
global state, no display. Colours follow Okabe and Ito (2008), which people with any of the common
colour blindnesses can tell apart; the diverging scale runs blue, white, red for the same reason.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from loftscan.rendering import Axis, Camera, PointLayer, PolylineLayer, Scene, camera_around
from loftscan.rendering import render_scene as _render
from loftscan.rendering.scene import ByteArray
from reconstruction.arrays import BoolArray, FloatArray

BLUE, ORANGE, GREEN, RED, PURPLE = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7"
INK, MUTED, RULE = "#20262d", "#66707a", "#d9dee3"
UNDEFINED = (150, 150, 150)  # synthetic, or nothing measured near

_KEPT = (70, 120, 172)
_SET_ASIDE = (213, 94, 0)
_SIZE_PX = (1100, 760)
_TITLE_PX = 44  # strip above a picture
_BAR_PX = 170  # strip beside it for the colour bar
_DOTS_PER_INCH = 130
_CLOSE_UP_CELLS = 16
_CLOSE_UP_SHARE = 0.25  # of the slice: a larger close-up shows nothing new
_STYLE: Any = {  # the keys are a Literal type in new matplotlib, str in old
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.titlepad": 10,
    "font.size": 9,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
}
_DIVERGING = LinearSegmentedColormap.from_list(
    "deviation", ["#0b3c7d", "#2f79b9", "#93c1de", "#f7f7f7", "#f0a582", "#cd4a3f", "#7f0f22"]
)
_UNCERTAIN = LinearSegmentedColormap.from_list(
    "certainty", ["#f4f1e8", "#f3cf8a", "#e69f00", "#b0541d", "#5e1a3c", "#2a0f2e"]
)


@dataclass(frozen=True, slots=True, eq=False)
class CellGrid:
    """The cells of a reduced section, as they are drawn."""

    centres_mm: FloatArray  # (c, 2)
    counts: NDArray[np.integer]  # (c,)
    size_mm: tuple[float, float]


def png(figure: Figure, *, dots_per_inch: float = _DOTS_PER_INCH) -> bytes:
    """Encode a figure as PNG bytes that depend on nothing but the figure."""
    stream = io.BytesIO()
    with mpl.rc_context(_STYLE):
        options = {"compress_level": 4}
        figure.savefig(stream, dpi=dots_per_inch, metadata={"Software": None}, pil_kwargs=options)
    return stream.getvalue()


def section_figure(
    points_mm: FloatArray,
    *,
    title: str,
    cells: CellGrid | None = None,
    contour_mm: FloatArray | None = None,
    curve_mm: FloatArray | None = None,
    gaps_mm: Sequence[FloatArray] = (),
    left_out_mm: FloatArray | None = None,
    measured: int | None = None,
) -> Figure:
    """Draw one slice in its plane: points, cells, contour, curve, gaps and what was left out.

    Where the cells are small beside the slice a close-up of some of them stands beside it.

    Parameters
    ----------
    points_mm
        Measured points of the slice, (n, 2).
    title
        What the slice is.
    cells
        Occupied cells, shaded by their counts.
    contour_mm, curve_mm
        Ordered centres of mass and the fitted curve, (k, 2) each.
    gaps_mm
        Stretches of the curve that no point supports, (k, 2) each.
    left_out_mm
        Points that the curve does not follow, (l, 2).
    measured
        How many points the slice has, where `points_mm` are some of them.
    """
    with mpl.rc_context(_STYLE):
        figure, axes = _plane(title)
        window = _close_up_window(points_mm, cells, curve_mm, gaps_mm)
        shown = [axes] if window is None else [axes, _close_up(figure, axes, window)]
        for each in shown:
            if cells is not None and len(cells.centres_mm):
                _draw_cells(each, cells)
            label = f"{len(points_mm):,} points"
            if measured is not None and measured > len(points_mm):
                label = f"{len(points_mm):,} of {measured:,} points"
            _dots(each, points_mm, MUTED, label)
            if left_out_mm is not None and len(left_out_mm):
                _dots(each, left_out_mm, ORANGE, f"{len(left_out_mm):,} left out", size=5)
            _draw_lines(each, contour_mm, curve_mm, gaps_mm)
        figure.legend(
            *axes.get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(0.99, 0.93)
        )
    return figure


def deviation_colours(
    values_mm: FloatArray, limit_mm: float, *, synthetic: BoolArray | None = None
) -> ByteArray:
    """Colours (n, 3) of signed deviations (n,): blue below, white at zero, red above.

    What is not finite or stands on no measured point is grey. Beyond the limit the ends stay.

    Raises
    ------
    ValueError
        If the limit is not positive.
    """
    if not limit_mm > 0:
        raise ValueError(f"deviation colours: the limit must be positive, got {limit_mm} mm")
    unknown = ~np.isfinite(values_mm)
    if synthetic is not None:
        unknown |= synthetic
    place = np.where(unknown, 0.0, values_mm) / (2 * limit_mm) + 0.5
    colours = _DIVERGING(np.clip(place, 0, 1), bytes=True)[:, :3]
    colours[unknown] = UNDEFINED
    return np.asarray(colours)


def deviation_figure(image: ByteArray, *, limit_mm: float, title: str) -> Figure:
    """Set a picture (h, w, 3) of a mesh in deviation colours beside its colour bar in mm."""
    with mpl.rc_context(_STYLE):
        figure = _picture(image, title, margin_px=_BAR_PX)
        scale, words = Normalize(-limit_mm, limit_mm), "deviation, outwards positive [mm]"
        _bar(figure, image, scale, _DIVERGING, words, "both")
        swatch = Line2D([], [], ls="", marker="s", color=np.divide(UNDEFINED, 255).tolist())
        figure.legend([swatch], ["no measured point"], loc="lower right")
    return figure


def certainty_colours(values_mm: FloatArray, limit_mm: float) -> ByteArray:
    """Colours (n, 3) of standard deviations (n,): light where certain, dark where not."""
    colours = _UNCERTAIN(np.clip(values_mm / limit_mm, 0, 1), bytes=True)[:, :3]
    return np.asarray(colours)


def certainty_figure(image: ByteArray, *, limit_mm: float, title: str) -> Figure:
    """Set a picture (h, w, 3) of a surface in certainty colours beside its colour bar in mm."""
    with mpl.rc_context(_STYLE):
        figure = _picture(image, title, margin_px=_BAR_PX)
        _bar(figure, image, Normalize(0.0, limit_mm), _UNCERTAIN, "standard deviation [mm]", "max")
    return figure


def histogram_figure(
    values_mm: FloatArray | None = None,
    *,
    binned: tuple[FloatArray, NDArray[np.integer]] | None = None,
    tolerance_mm: float | None = None,
    title: str = "Distribution of the deviation",
) -> Figure:
    """Draw a histogram of deviations (n,), or of `binned` = edges (b + 1,) and counts (b,).

    Raises
    ------
    ValueError
        If not exactly one of the two is given.
    """
    if (values_mm is None) == (binned is None):
        raise ValueError("histogram: give either values or (edges, counts)")
    edges, counts = binned if binned is not None else _binned(np.asarray(values_mm))
    with mpl.rc_context(_STYLE):
        figure = Figure((7.2, 3.4))
        axes = figure.add_axes((0.11, 0.15, 0.87, 0.73))
        axes.set(title=title, xlabel="deviation [mm]", ylabel="number of points")
        if values_mm is not None:
            axes.set_xlabel("deviation [mm]; the outermost bars hold what lies beyond")
        middles = (edges[:-1] + edges[1:]) / 2
        inside = np.abs(middles) <= (np.inf if tolerance_mm is None else tolerance_mm)
        colours = np.where(inside, BLUE, RED)
        axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=colours, zorder=2)
        axes.grid(visible=False, axis="x")
        if tolerance_mm is not None:
            axes.vlines([-tolerance_mm, tolerance_mm], 0, max(counts.max(), 1), INK, "--", lw=1)
        note = f"N = {counts.sum():,}"
        if values_mm is not None and tolerance_mm is not None and counts.sum():
            note += f"; {_share_within(values_mm, tolerance_mm):.1%} within ± {tolerance_mm:g} mm"
        axes.set_title(note, loc="right", fontsize=9, color=MUTED)
    return figure


def sections_figure(
    polylines_mm: Sequence[FloatArray],
    *,
    title: str,
    camera: Camera | None = None,
    up: Axis = "z",
    left_out_mm: FloatArray | None = None,
    size_px: tuple[int, int] = _SIZE_PX,
) -> Figure:
    """Draw section curves, (k, 3) each, in space; from lowest to highest through the colours."""
    lines = tuple(polylines_mm)
    left_out = np.empty((0, 3)) if left_out_mm is None else left_out_mm
    camera = camera or camera_around(*lines, left_out, up=up)
    heights = np.array([np.mean(line[:, camera.up_index]) if len(line) else 0.0 for line in lines])
    ranks = np.argsort(np.argsort(heights)) / max(len(lines) - 1, 1)
    colours = mpl.colormaps["viridis"](0.85 * ranks.reshape(-1), bytes=True)[:, :3]
    scene = Scene(
        points=(PointLayer(left_out, _SET_ASIDE, 2.4),),
        polylines=(PolylineLayer(lines, colours, 1.8),),
    )
    image = _render(scene, camera=camera, size_px=size_px)
    labels = [
        (_hex(colours[len(colours) // 2]) if len(lines) else MUTED, f"{len(lines):,} sections")
    ]
    if len(left_out):
        labels.append((RED, f"{len(left_out):,} points left out"))
    return _labelled_picture(image, title, labels, camera)


def cloud_figure(
    points_mm: FloatArray,
    set_aside_mm: FloatArray | None = None,
    *,
    title: str,
    camera: Camera | None = None,
    up: Axis = "z",
    size_px: tuple[int, int] = _SIZE_PX,
) -> Figure:
    """Draw a cloud (n, 3), what was set aside of it (m, 3) in another colour, and how many."""
    aside = np.empty((0, 3)) if set_aside_mm is None else set_aside_mm
    camera = camera or camera_around(points_mm, aside, up=up)
    kept = PointLayer(points_mm, _KEPT, bead_radius_px(len(points_mm), size_px))
    other = PointLayer(aside, _SET_ASIDE, max(1.6, kept.radius_px))
    image = _render(Scene(points=(kept, other)), camera=camera, size_px=size_px)
    labels = [(_hex(_KEPT), f"{len(points_mm):,} points")]
    if len(aside):
        labels.append((RED, f"{len(aside):,} set aside or left out"))
    return _labelled_picture(image, title, labels, camera)


def bead_radius_px(count: int, size_px: tuple[int, int]) -> float:
    """Radius at which `count` points about cover a part that fills a quarter of the picture."""
    area_px = size_px[0] * size_px[1] / 4
    return float(np.clip(1.2 * np.sqrt(area_px / max(count, 1) / np.pi), 0.9, 4.0))


def picture_figure(image: ByteArray, *, title: str) -> Figure:
    """Set a picture (h, w, 3) under its title, in the style of the other figures."""
    with mpl.rc_context(_STYLE):
        return _picture(image, title)


def _bar(
    figure: Figure,
    image: ByteArray,
    scale: Normalize,
    colours: LinearSegmentedColormap,
    words: str,
    extend: Literal["both", "max"],
) -> None:
    """A colour bar in the strip beside a picture (h, w, 3)."""
    width = image.shape[1] + _BAR_PX
    place = ((image.shape[1] + 24) / width, 0.14, 22 / width, 0.7)
    bar = figure.colorbar(ScalarMappable(scale, colours), cax=figure.add_axes(place), extend=extend)
    bar.set_label(words)
    bar.outline.set_visible(False)


def _plane(title: str) -> tuple[Figure, Axes]:
    figure = Figure((7.6, 5.6))
    axes = figure.add_axes((0.09, 0.1, 0.66, 0.82))
    axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    axes.set_aspect("equal", adjustable="datalim")
    return figure, axes


def _draw_lines(
    axes: Axes,
    contour_mm: FloatArray | None,
    curve_mm: FloatArray | None,
    gaps_mm: Sequence[FloatArray],
) -> None:
    if contour_mm is not None:
        axes.plot(*contour_mm.T, "o", ms=3.2, mfc="white", mec=BLUE, mew=1, label="contour")
    if curve_mm is not None:
        axes.plot(*curve_mm.T, color=BLUE, lw=1.4, label="curve")
    for number, gap in enumerate(gaps_mm):
        label = f"gaps, synthetic: {len(gaps_mm)}" if number == 0 else None
        axes.plot(*gap.T, color=RED, lw=2.6, ls=(0, (2, 1)), label=label)


def _close_up_window(
    points_mm: FloatArray,
    cells: CellGrid | None,
    curve_mm: FloatArray | None,
    gaps_mm: Sequence[FloatArray],
) -> tuple[FloatArray, float] | None:
    """Middle and side of what is worth a close-up: a gap's end, else some place of the curve."""
    if cells is None or curve_mm is None or not len(points_mm):
        return None
    side = _CLOSE_UP_CELLS * max(cells.size_mm)
    if side > _CLOSE_UP_SHARE * float(np.ptp(points_mm, axis=0).max()):
        return None
    return (gaps_mm[0][0] if len(gaps_mm) else curve_mm[len(curve_mm) // 8]), side


def _close_up(figure: Figure, whole: Axes, window: tuple[FloatArray, float]) -> Axes:
    middle, side = window
    low, high = middle - side / 2.0, middle + side / 2.0
    axes = figure.add_axes((0.775, 0.1, 0.205, 0.205 * 7.6 / 5.6))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=(), yticks=())
    axes.set_title(f"close-up, {side:.3g} mm", fontsize=8.5, color=MUTED, pad=4)
    for place in ("right", "top"):
        axes.spines[place].set_visible(True)
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
    whole.plot(*corners.T, color=INK, lw=0.9, zorder=3)
    return axes


def _draw_cells(axes: Axes, cells: CellGrid) -> None:
    half = np.divide(cells.size_mm, 2)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    outlines = cells.centres_mm[:, None] + corners
    strength = cells.counts / max(int(cells.counts.max()), 1)
    shades = np.tile(mpl.colors.to_rgba(GREEN), (len(strength), 1))
    shades[:, 3] = 0.08 + 0.37 * strength
    label = f"{len(strength):,} cells"
    axes.add_collection(
        LineCollection(outlines, facecolors=shades, colors=GREEN, lw=0.35, label=label, zorder=1)
    )


def _dots(axes: Axes, points_mm: FloatArray, colour: str, label: str, size: float = 2.5) -> None:
    x, y = points_mm.T
    axes.scatter(x, y, s=size, c=colour, lw=0, label=label, rasterized=True, zorder=1.5)


def _picture(image: ByteArray, title: str, *, margin_px: int = 0) -> Figure:
    """A figure that holds the picture pixel for pixel, a strip above for the title, one beside.

    No axes and no layout engine: both would resample the picture and draw everything twice.
    """
    height, width = image.shape[0] + _TITLE_PX, image.shape[1] + margin_px
    figure = Figure((width / _DOTS_PER_INCH, height / _DOTS_PER_INCH), dpi=_DOTS_PER_INCH)
    figure.figimage(image, resize=False)
    figure.text(8 / width, 1 - 0.5 * _TITLE_PX / height, title, size=11, va="center")
    return figure


def _labelled_picture(
    image: ByteArray, title: str, labels: Sequence[tuple[str, str]], camera: Camera
) -> Figure:
    with mpl.rc_context(_STYLE):
        figure = _picture(image, title)
        handles = [Line2D([], [], ls="", marker="o", ms=5, color=colour) for colour, _ in labels]
        top = image.shape[0] / (image.shape[0] + _TITLE_PX)
        words = [text for _, text in labels]
        figure.legend(handles, words, loc="upper left", bbox_to_anchor=(0.0, top))
        extent = " x ".join(f"{side:.4g}" for side in np.diff(camera.bounds_mm, axis=0)[0])
        right = 1 - 8 / image.shape[1]
        text = figure.text(right, (1 + top) / 2, f"{extent} mm", ha="right", va="center")
        text.set(size=9, color=MUTED)
    return figure


def _binned(values_mm: FloatArray) -> tuple[FloatArray, NDArray[np.integer]]:
    finite = values_mm[np.isfinite(values_mm)]
    if not len(finite):
        return np.array([-0.5, 0.5]), np.zeros(1, np.int64)
    low, high = np.quantile(finite, [0.0005, 0.9995])
    # What is beyond the ends stands in the outermost bars: nothing leaves the count.
    counts, edges = np.histogram(np.clip(finite, low, high), bins=61)
    return edges, counts


def _share_within(values_mm: FloatArray, tolerance_mm: float) -> float:
    finite = values_mm[np.isfinite(values_mm)]
    return float(np.mean(np.abs(finite) <= tolerance_mm))


def _hex(colour: Sequence[int] | ByteArray) -> str:
    return mpl.colors.to_hex(np.divide(colour, 255).tolist())
