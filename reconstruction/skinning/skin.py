"""The surface of one branch: outlines aligned, a net laid along them and fitted to their points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.skinning.aligning import Stations, align
from reconstruction.skinning.branch import Branch
from reconstruction.skinning.ends import Apex, Brim, brim_or_apex
from reconstruction.skinning.laying import Laid, lay_net
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.tensor_fit import FREE, Rim, TensorFit, fit_net

_SPANS_A_FREEDOM = 2.5
_MORE_SPANS = 10
_MOST_SPANS = 240
_LEAST_SPANS_V = 6
_MOST_SPANS_V = 160
_STATIONS_A_SPAN = 3
_LEAST_STATIONS = 96
_EXACT = 1e-7  # of a part's size: scatter below it is none


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A branch and the surface fitted to it."""

    branch: Branch
    brims: tuple[Brim | Apex, Brim | Apex] | None  # None: it closes in v
    laid: Laid
    stations: Stations
    moments: Moments
    fit: TensorFit


def skin_branch(branch: Branch) -> Skin:
    """Fit one tensor surface to a branch of at least two outlines."""
    outlines = branch.outlines
    spans = (_spans_around(branch), _spans_along(branch))
    stations = align(
        outlines, max(_STATIONS_A_SPAN * spans[0], _LEAST_STATIONS), cyclic=branch.cyclic
    )
    brims = _brims(branch)
    laid = lay_net(outlines, stations, brims, spans)
    moments = Moments.together([outline.moments for outline in outlines])
    fit = fit_net(laid.net, moments, laid.u, laid.v, _noise(branch), rims=_rims(brims))
    return Skin(branch, brims, laid, stations, moments, fit)


def _spans_around(branch: Branch) -> int:
    """Spans enough for the liveliest of the outlines; the stiffness does the rest."""
    edf = float(np.quantile([outline.fitted.edf for outline in branch.outlines], 0.9))
    return int(min(max(_SPANS_A_FREEDOM * edf + _MORE_SPANS, 12), _MOST_SPANS))


def _spans_along(branch: Branch) -> int:
    """A span an outline, within bounds: outlines stand as densely as the part asks for."""
    return int(min(max(len(branch.outlines), _LEAST_SPANS_V), _MOST_SPANS_V))


def _brims(branch: Branch) -> tuple[Brim | Apex, Brim | Apex] | None:
    if branch.ends is None:
        return None
    low, high = branch.ends
    return (
        brim_or_apex(branch.outlines, low, last=False),
        brim_or_apex(branch.outlines, high, last=True),
    )


def _rims(brims: tuple[Brim | Apex, Brim | Apex] | None) -> tuple[Rim, Rim]:
    if brims is None:
        return FREE
    low, high = (
        Rim(level=brim.axis) if isinstance(brim, Brim) else Rim(smooth=not brim.sharp)
        for brim in brims
    )
    return low, high


def _noise(branch: Branch) -> Noise:
    """Scatter and kinship as the sections saw them; the fit looks at the scatter again."""
    sigma = float(np.median([outline.fitted.sigma_mm for outline in branch.outlines]))
    inflation = float(np.median([outline.fitted.inflation for outline in branch.outlines]))
    size = max(float(np.ptp(outline.moments.means_mm, axis=0).max()) for outline in branch.outlines)
    variance = max(sigma, _EXACT * size) ** 2
    axis = branch.outlines[0].frame.axes[2]
    return Noise(variance, variance, axis, max(inflation, 1.0))
