"""How large a cell should be (the paper's section 2.2, last part).

"For radii bigger than ten times the width of cloud points a resolution as two times the width
can be used. For smaller radii a resolution equal to the width."
"""

from __future__ import annotations

from dataclasses import dataclass

from reconstruction.thickness import Thickness

_GENTLE = 10.0  # radius over width from which the coarse resolution serves
_FEWEST = 12  # cells that a section should at least have around it
_NEIGHBOURS = 1.5  # sampling distances that a cell spans at least


@dataclass(frozen=True, slots=True)
class Resolution:
    """The side of a square cell, and what decided it."""

    cell_mm: float
    rule_mm: float  # what the paper's rule alone asks for
    reason: str


def choose_resolution(
    thickness: Thickness, *, sampling_mm: float, size_mm: float, given_mm: float | None = None
) -> Resolution:
    """Choose the cell side of a slice.

    Parameters
    ----------
    thickness : Thickness
        Of the cloud in this slice.
    sampling_mm : float
        Distance along the contour between neighbouring measurements. The paper's clouds are
        dense; in a sparse one cells of the cloud's width would stand alone, so none is finer than
        1.5 times this.
    size_mm : float
        Larger side of the slice; a section keeps at least about 12 cells across its outline.
    given_mm : float, optional
        The operator's own resolution, which overrules everything.
    """
    coarse = thickness.radius_mm > _GENTLE * thickness.width_mm
    rule = (2.0 if coarse else 1.0) * thickness.width_mm
    if given_mm is not None:
        return Resolution(given_mm, rule, "given")
    floor, ceiling = _NEIGHBOURS * sampling_mm, 3.0 * size_mm / _FEWEST
    if rule < floor:
        return Resolution(min(floor, ceiling), rule, "the sampling is coarser than the cloud")
    if rule > ceiling:
        return Resolution(ceiling, rule, "the section is small")
    return Resolution(rule, rule, "twice the width" if coarse else "the width")
