"""Exact shapes of `--method fit`: their figures, each with its standard deviation."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from loftscan.methods import AnyReconstruction
from loftscan.report import Fact, MetricGroup
from reconstruction.arrays import FloatArray
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.pipeline import Reconstruction
from reconstruction.skinning.apexes import Tip, tips_of
from reconstruction.skinning.exact_shapes import Quantity, Shape

_MOST = 8  # shapes that are said one by one
_NAMES = {"revolution": "surface of revolution"}
_ENDINGS = {"mm": "_mm", "rad": "_rad", "1": ""}
_LEAST_DIGITS, _MOST_DIGITS = 0, 12


def shapes_said(done: FittedReconstruction) -> list[dict[str, object]]:
    """What metrics.json says of every branch whose surface is exact."""
    return [
        {"branch": number, "kind": shape.kind, **_figures(shape)} for number, shape in _found(done)
    ]


def apexes_said(done: FittedReconstruction) -> list[dict[str, object]]:
    """What metrics.json says of every point in which a surface runs out."""
    return [
        {
            "branch": tip.branch,
            "point_mm": tip.point_mm.tolist(),
            "point_sd_mm": tip.deviations_mm.tolist(),
            "sharp": tip.sharp,
            "exact": done.skinned.shapes[tip.branch] is not None,
        }
        for tip in tips_of(done.skinned.shown)
    ]


def tell_shapes(done: AnyReconstruction) -> list[str]:
    """A sentence for every branch whose surface is exact; the paper's are none."""
    if isinstance(done, Reconstruction):
        return []
    found, branches = list(_found(done)), len(done.skinned.skins)
    said = [_sentence(number, shape, branches) for number, shape in found[:_MOST]]
    rest = len(found) - len(said)
    return said if rest <= 0 else [*said, f"And {rest} more exact shapes: see the numbers."]


def shape_tables(done: AnyReconstruction) -> tuple[MetricGroup, ...]:
    """A table of the figures of every exact shape, and one of the points that end surfaces."""
    if isinstance(done, Reconstruction):
        return ()
    groups = [
        MetricGroup(
            f"Exact shape of branch {number}: {_name(shape)}",
            tuple(fact for each in shape.quantities for fact in _facts(each)),
        )
        for number, shape in _found(done)
    ]
    tips = [fact for tip in tips_of(done.skinned.shown) for fact in _tip_facts(tip)]
    return tuple(groups) + ((MetricGroup("Ends in a point", tuple(tips)),) if tips else ())


def _found(done: FittedReconstruction) -> Iterator[tuple[int, Shape]]:
    for number, shape in enumerate(done.skinned.shapes):
        if shape is not None:
            yield number, shape


def _figures(shape: Shape) -> dict[str, object]:
    said: dict[str, object] = {}
    for each in shape.quantities:
        name, ending = each.name.replace(" ", "_"), _ENDINGS[each.unit]
        said[f"{name}{ending}"] = _plain(each.values)
        said[f"{name}_sd{ending}"] = _plain(each.deviations)
    return said


def _plain(values: FloatArray) -> float | list[float]:
    return float(values[0]) if len(values) == 1 else [float(each) for each in values]


def _name(shape: Shape) -> str:
    return _NAMES.get(shape.kind, shape.kind)


def _sentence(number: int, shape: Shape, branches: int) -> str:
    subject = "The surface" if branches == 1 else f"The surface of branch {number}"
    figures = "; ".join(_words(each) for each in shape.quantities)
    return (
        f"{subject} is an exact {_name(shape)}, because its points are those of one: {figures} "
        "(plus or minus one standard deviation, by the noise of the points)."
    )


def _words(figure: Quantity) -> str:
    """Radius 50.00027 ± 0.00020 mm."""
    values, deviations = figure.values, figure.deviations
    unit = "" if figure.unit == "1" else f" {figure.unit}"
    if figure.unit == "rad":
        values, deviations, unit = np.degrees(values), np.degrees(deviations), "°"
    digits = _digits(float(deviations.max()))
    if len(values) == 1:
        return f"{figure.name} {values[0]:.{digits}f} ± {deviations[0]:.{digits}f}{unit}"
    told = ", ".join(f"{value:.{digits}f}" for value in values)
    within = f"{float(deviations.max()):.{digits}f}"
    return f"{figure.name} ({told}) ± {within}{unit}"


def _facts(figure: Quantity) -> Iterator[Fact]:
    unit = "" if figure.unit == "1" else figure.unit
    names = [""] if len(figure.values) == 1 else [" x", " y", " z"]
    for name, value, deviation in zip(names, figure.values, figure.deviations, strict=True):
        digits = _digits(float(deviation))
        yield Fact(f"{figure.name}{name}", f"{value:.{digits}f} ± {deviation:.{digits}f}", unit)


def _tip_facts(tip: Tip) -> Iterator[Fact]:
    kind = "tip" if tip.sharp else "dome"
    for name, value, deviation in zip("xyz", tip.point_mm, tip.deviations_mm, strict=True):
        digits = _digits(float(deviation))
        words = f"{value:.{digits}f} ± {deviation:.{digits}f}"
        yield Fact(f"{kind} of branch {tip.branch} {name}", words, "mm")


def _digits(deviation: float) -> int:
    """Behind the point: two that count of the deviation."""
    if not deviation > 0.0:
        return 6
    return int(np.clip(1 - math.floor(math.log10(deviation)), _LEAST_DIGITS, _MOST_DIGITS))
