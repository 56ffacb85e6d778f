"""NURBS: values, evaluation, the algebra of knots and degrees, interpolation; rational throughout.

After Piegl and Tiller, *The NURBS Book* (2nd ed., 1997), and the paper's eqs. 1-3. How open and
periodic directions are stored: `reconstruction.nurbs.values`.
"""

from reconstruction.nurbs.algebra import (
    clamped,
    clamped_along,
    elevate,
    elevate_along,
    insert_knot,
    insert_knot_along,
    opened,
    opened_along,
    refine,
    refine_along,
    reparametrise,
    reparametrise_along,
    reverse,
    reverse_along,
    split,
    split_along,
)
from reconstruction.nurbs.basis import basis_derivatives, basis_functions, find_spans
from reconstruction.nurbs.bundle import Along, swapped
from reconstruction.nurbs.evaluation import curve_derivatives, evaluate_curve, wrapped
from reconstruction.nurbs.grid_lines import grid_lines
from reconstruction.nurbs.interpolation import (
    averaged_knots,
    chord_parameters,
    interpolate_open,
    interpolate_periodic,
    loft_sections,
)
from reconstruction.nurbs.layout import Border
from reconstruction.nurbs.shapes import circle, clamped_uniform, periodic_uniform
from reconstruction.nurbs.surface_evaluation import (
    Curvatures,
    evaluate_surface,
    evaluate_surface_at,
    points_and_normals,
    points_and_normals_at,
    points_and_tangents_at,
    surface_curvatures_at,
    surface_derivatives,
    surface_derivatives_on_grid,
    surface_normals,
    surface_normals_at,
)
from reconstruction.nurbs.tessellation import Tessellation, tessellate
from reconstruction.nurbs.values import Curve, Surface

__all__ = [
    "Along",
    "Border",
    "Curvatures",
    "Curve",
    "Surface",
    "Tessellation",
    "averaged_knots",
    "basis_derivatives",
    "basis_functions",
    "chord_parameters",
    "circle",
    "clamped",
    "clamped_along",
    "clamped_uniform",
    "curve_derivatives",
    "elevate",
    "elevate_along",
    "evaluate_curve",
    "evaluate_surface",
    "evaluate_surface_at",
    "find_spans",
    "grid_lines",
    "insert_knot",
    "insert_knot_along",
    "interpolate_open",
    "interpolate_periodic",
    "loft_sections",
    "opened",
    "opened_along",
    "periodic_uniform",
    "points_and_normals",
    "points_and_normals_at",
    "points_and_tangents_at",
    "refine",
    "refine_along",
    "reparametrise",
    "reparametrise_along",
    "reverse",
    "reverse_along",
    "split",
    "split_along",
    "surface_curvatures_at",
    "surface_derivatives",
    "surface_derivatives_on_grid",
    "surface_normals",
    "surface_normals_at",
    "swapped",
    "tessellate",
    "wrapped",
]
