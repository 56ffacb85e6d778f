"""A preview as a picture: the part unrolled, coloured by what is seen of it and why not."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from loftscan import figures
from loftscan.previewing import WORDS, Preview, Seen

_COLOURS = {
    Seen.NO_SLICE: figures.MUTED,
    Seen.FACES_AWAY: figures.PURPLE,
    Seen.TOO_FAR: figures.ORANGE,
    Seen.TOO_NEAR: figures.RED,
    Seen.BESIDE: figures.GREEN,
    Seen.SEEN: figures.BLUE,
}


def preview_figure(found: Preview) -> Figure:
    """Angle around the axis against height, a dot a place."""
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    axes = figure.add_subplot()
    turned = np.degrees(np.arctan2(found.places_mm[:, 1], found.places_mm[:, 0])) % 360.0
    for fate in Seen:
        rows = found.fate == fate
        if rows.any():
            label = f"{WORDS[fate]}: {rows.mean():.0%}"
            axes.plot(
                turned[rows], found.places_mm[rows, 2], "s", color=_COLOURS[fate], label=label,
                markersize=4.5, markeredgewidth=0.0,
            )  # fmt: skip
    axes.set_xlim(0.0, 360.0)
    axes.set_xticks(np.arange(0, 361, 45))
    axes.set_xlabel("angle about the table's axis [deg]")
    axes.set_ylabel("height over the plate [mm]")
    axes.set_title(f"What the plan sees: {found.share:.0%}", loc="left")
    figure.legend(loc="outside lower left", frameon=False, fontsize=8.5)
    return figure
