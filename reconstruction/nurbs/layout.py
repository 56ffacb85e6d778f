r"""Which points a surface gets: rows of constant v, in each row some of the lines of constant u.

Lines and rows are placed for the worst place (`grid_lines`); then every band between two rows
leaves out the lines that it does not need, in pairs, pairs of pairs and so on. A row has the points
of both its bands, so that the cells of a band end on points of both its rows::

    row 2   o-------o-------o-------o      band 1 needs every other line,
            |     / | \   / |     / |
    row 1   o---o---o---o---o---o---o      band 0 every line; row 1 has them all
            | / | / | / | / | / | / |
    row 0   o---o---o---o---o---o---o

A border can be given its points. Those of a border of constant v are joined to the next row, which
takes them all up; those of a border of constant u to the next line, which every row then has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.nurbs.algebra import clamped_along
from reconstruction.nurbs.bundle import Along, swapped
from reconstruction.nurbs.flatness import Flatness, flatness
from reconstruction.nurbs.grid_lines import place_lines
from reconstruction.nurbs.strips import Strip, dropped_lines
from reconstruction.nurbs.values import Surface


class Border(Enum):
    """A border of the domain."""

    U_START = "u = start"
    U_END = "u = end"
    V_START = "v = start"
    V_END = "v = end"

    @property
    def across(self) -> Border:
        """The same border with u and v exchanged."""
        return _ACROSS[self]


_ACROSS = {
    Border.U_START: Border.V_START, Border.U_END: Border.V_END,
    Border.V_START: Border.U_START, Border.V_END: Border.U_END,
}  # fmt: skip
_MOST_POINTS = 30_000_000
_SIDES = (Border.V_START, Border.V_END, Border.U_START, Border.U_END)


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A surface, and what of it decides a layout."""

    surface: Surface
    closed: tuple[bool, bool]  # whether u and v run back into their start
    flat: Flatness
    given: Mapping[Border, FloatArray]

    @property
    def turned(self) -> Sheet:
        """The same with u and v exchanged."""
        given = {side.across: at for side, at in self.given.items()}
        return Sheet(swapped(self.surface), self.closed[::-1], self.flat.turned, given)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The points of a sheet."""

    u: FloatArray  # (lines,)
    v: FloatArray  # (rows,)
    kept: BoolArray  # (rows, lines)
    listed: frozenset[Border]  # borders whose points were given

    @property
    def numbers(self) -> IntArray:
        """Numbers of the points, row by row, -1 where there is none; (rows, lines)."""
        found: IntArray = np.full(self.kept.shape, -1, dtype=np.int64)
        found[self.kept] = np.arange(self.kept.sum())
        return found

    @property
    def parameters(self) -> FloatArray:
        """Of every point, (n, 2)."""
        rows, lines = np.nonzero(self.kept)
        return np.stack([self.u[lines], self.v[rows]], axis=1)

    def border(self, side: Border) -> IntArray:
        """Numbers of the points along a border, by growing parameter."""
        along = self.numbers if side in (Border.V_START, Border.V_END) else self.numbers.T
        ids = along[0 if side in (Border.V_START, Border.U_START) else -1]
        return np.asarray(ids[ids >= 0])

    def strips(self) -> list[Strip]:
        """Bands between the rows, and upright strips along borders of u that were given points.

        Such a strip takes the outermost cells from the bands; where a given border of v meets one
        of u, the two share the diagonal of the corner.
        """
        low, high, left, right = (side in self.listed for side in _SIDES)
        rows, lines = self.kept.shape
        first, last = int(left), lines - int(right)
        numbers = self.numbers

        def chain(row: int) -> tuple[IntArray, FloatArray]:
            whole = (row == 0 and low) or (row == rows - 1 and high)
            begin, end = (0, lines) if whole else (first, last)
            at = begin + np.flatnonzero(self.kept[row, begin:end])
            return numbers[row, at], self.u[at]

        def upright(line: int, begin: int = 0, end: int = rows) -> tuple[IntArray, FloatArray]:
            at = begin + np.flatnonzero(self.kept[begin:end, line])
            return numbers[at, line], self.v[at]

        strips = [Strip(*chain(row), *chain(row + 1)) for row in range(rows - 1)]
        inner = int(low), rows - int(high)
        if left:
            strips.append(Strip(*upright(first, *inner), *upright(0)))
        if right:
            strips.append(Strip(*upright(lines - 1), *upright(last - 1, *inner)))
        return strips


def sheet_of(surface: Surface, borders: Mapping[Border, ArrayLike]) -> Sheet:
    """Prepare a surface.

    Raises
    ------
    ValueError
        Parameters of a border that do not grow from the start to the end of the domain, or of a
        border that a closed surface does not have.
    """
    surface = _clamped(surface)
    closed = (_meets(surface, Along.U), _meets(surface, Along.V))
    given = {side: _checked(surface, closed, side, at) for side, at in borders.items()}
    return Sheet(surface, closed, flatness(surface), given)


def lay(sheet: Sheet, *, tolerance_mm: float) -> Layout:
    """Place lines and rows, and leave out what the bands do not need."""
    low, high, left, right = (sheet.given.get(side, np.empty(0)) for side in _SIDES)
    u, v = place_lines(
        sheet.flat,
        tolerance_mm=tolerance_mm,
        also_u=np.concatenate([low, high]),
        also_v=np.concatenate([left, right]),
    )
    # A ring has three points; between two poles, or two given borders, there is something.
    u, v = _at_least(u, 3 if sheet.closed[0] else 2), _at_least(v, 3 if sheet.closed[1] else 2)
    if len(u) * len(v) > _MOST_POINTS:
        raise ValueError(
            f"a tolerance of {tolerance_mm:g} mm asks for a grid of {len(u)} x {len(v)} points, at "
            f"most {_MOST_POINTS} are possible: allow a larger one"
        )
    fixed = _fixed(sheet, u, left=len(left) > 0, right=len(right) > 0)
    needed = ~dropped_lines(sheet.flat, u, v, fixed, tolerance_mm)
    kept = np.zeros((len(v), len(u)), dtype=np.bool_)
    kept[:-1] |= needed
    kept[1:] |= needed
    if sheet.closed[1]:
        kept[0] = kept[-1] = kept[0] | kept[-1]
    _keep_given(kept, u, (low, high))
    kept[1] |= kept[0] & (len(low) > 0)
    kept[-2] |= kept[-1] & (len(high) > 0)
    _keep_given(kept.T, v, (left, right))
    return Layout(u, v, kept, frozenset(sheet.given))


def _fixed(sheet: Sheet, u: FloatArray, *, left: bool, right: bool) -> BoolArray:
    """Lines that every row has."""
    fixed = np.isin(u, sheet.flat.breaks_u[sheet.flat.sharp_u])
    if sheet.closed[0]:
        fixed[[len(u) // 3, 2 * len(u) // 3]] = True
    fixed[1] |= left
    fixed[-2] |= right
    return fixed


def _keep_given(kept: BoolArray, lines: FloatArray, ends: tuple[FloatArray, FloatArray]) -> None:
    """Give the first and the last row just the points they were given, if they were."""
    for row, values in zip((0, -1), ends, strict=True):
        if len(values):
            kept[row] = np.isin(lines, values)


def _at_least(lines: FloatArray, steps: int) -> FloatArray:
    """Cut the widest steps in two until there are so many."""
    while len(lines) <= steps:
        widest = int(np.argmax(np.diff(lines)))
        lines = np.insert(lines, widest + 1, (lines[widest] + lines[widest + 1]) / 2)
    return lines


def _clamped(surface: Surface) -> Surface:
    """Let open directions begin and end on their outermost control points."""
    for along, degree, knots, periodic in (
        (Along.U, surface.degree_u, surface.knots_u, surface.periodic_u),
        (Along.V, surface.degree_v, surface.knots_v, surface.periodic_v),
    ):
        if not periodic and (knots[0] != knots[degree] or knots[-1] != knots[-1 - degree]):
            surface = clamped_along(surface, along)
    return surface


def _meets(surface: Surface, along: Along) -> bool:
    """Whether a direction runs back into its start, smoothly or with an edge."""
    if along is Along.V:
        return _meets(swapped(surface), Along.U)
    same = np.array_equal(surface.control_points_mm[0], surface.control_points_mm[-1])
    weights = surface.weights
    return surface.periodic_u or (same and np.array_equal(weights[0], weights[-1]))


def _checked(
    surface: Surface, closed: tuple[bool, bool], side: Border, values: ArrayLike
) -> FloatArray:
    along = 1 if side in (Border.U_START, Border.U_END) else 0
    if closed[1 - along]:
        raise ValueError(f"border {side.value}: a closed surface has none there")
    start, end = surface.domain[along]
    parameters = np.asarray(values, dtype=np.float64)
    grows = parameters.ndim == 1 and len(parameters) > 1 and bool(np.all(np.diff(parameters) > 0))
    if not grows or parameters[0] != start or parameters[-1] != end:
        raise ValueError(
            f"border {side.value}: its parameters must grow from {start:g} to {end:g}, both given"
        )
    return parameters
