"""The algebra of `knot_algebra` and `elevation` for curves, and along u or v for surfaces.

No verb here changes the shape: a curve or surface comes back with other knots, another degree, or
another parameter, and the same points.
"""

from __future__ import annotations

from collections.abc import Iterable

from reconstruction.nurbs import knot_algebra
from reconstruction.nurbs.bundle import Along, changed_curve, changed_surface
from reconstruction.nurbs.elevation import elevated
from reconstruction.nurbs.values import Curve, Surface


def insert_knot(curve: Curve, u: float, *, times: int = 1) -> Curve:
    """Insert a knot; `ValueError` when it would stand more often than the degree."""
    return changed_curve(curve, lambda bundle: knot_algebra.inserted(bundle, u, times=times))


def refine(curve: Curve, knots: Iterable[float]) -> Curve:
    """Insert many knots."""
    return changed_curve(curve, lambda bundle: knot_algebra.refined(bundle, knots))


def elevate(curve: Curve, *, by: int = 1) -> Curve:
    """Raise the degree; a periodic curve stays periodic, an open one comes out clamped."""
    return changed_curve(curve, lambda bundle: elevated(bundle, by=by))


def split(curve: Curve, u: float) -> tuple[Curve, Curve]:
    """Split an open curve inside its domain; `opened` cuts a periodic one."""
    return (
        changed_curve(curve, lambda bundle: knot_algebra.split(bundle, u)[0]),
        changed_curve(curve, lambda bundle: knot_algebra.split(bundle, u)[1]),
    )


def opened(curve: Curve, u: float) -> Curve:
    """Cut a periodic curve at u: one clamped curve from u over one period."""
    return changed_curve(curve, lambda bundle: knot_algebra.opened(bundle, u))


def clamped(curve: Curve) -> Curve:
    """Give a curve p + 1 equal knots at both ends of the same domain; a periodic one opens."""
    return changed_curve(curve, knot_algebra.clamped)


def reverse(curve: Curve) -> Curve:
    """Run through the curve backwards, on the same domain."""
    return changed_curve(curve, knot_algebra.reversed_bundle)


def reparametrise(curve: Curve, start: float, end: float) -> Curve:
    """Map the domain affinely to [start, end]."""
    return changed_curve(curve, lambda bundle: knot_algebra.reparametrised(bundle, start, end))


def insert_knot_along(surface: Surface, along: Along, knot: float, *, times: int = 1) -> Surface:
    """Do what `insert_knot` does in one direction of a surface."""
    return changed_surface(
        surface, along, lambda bundle: knot_algebra.inserted(bundle, knot, times=times)
    )


def refine_along(surface: Surface, along: Along, knots: Iterable[float]) -> Surface:
    """Do what `refine` does in one direction of a surface."""
    return changed_surface(surface, along, lambda bundle: knot_algebra.refined(bundle, knots))


def elevate_along(surface: Surface, along: Along, *, by: int = 1) -> Surface:
    """Do what `elevate` does in one direction of a surface."""
    return changed_surface(surface, along, lambda bundle: elevated(bundle, by=by))


def split_along(surface: Surface, along: Along, parameter: float) -> tuple[Surface, Surface]:
    """Do what `split` does in one direction of a surface."""
    return (
        changed_surface(surface, along, lambda bundle: knot_algebra.split(bundle, parameter)[0]),
        changed_surface(surface, along, lambda bundle: knot_algebra.split(bundle, parameter)[1]),
    )


def opened_along(surface: Surface, along: Along, parameter: float) -> Surface:
    """Do what `opened` does in one direction of a surface."""
    return changed_surface(surface, along, lambda bundle: knot_algebra.opened(bundle, parameter))


def clamped_along(surface: Surface, along: Along) -> Surface:
    """Do what `clamped` does in one direction of a surface."""
    return changed_surface(surface, along, knot_algebra.clamped)


def reverse_along(surface: Surface, along: Along) -> Surface:
    """Do what `reverse` does in one direction of a surface; the normals turn round."""
    return changed_surface(surface, along, knot_algebra.reversed_bundle)


def reparametrise_along(surface: Surface, along: Along, start: float, end: float) -> Surface:
    """Do what `reparametrise` does in one direction of a surface."""
    return changed_surface(
        surface, along, lambda bundle: knot_algebra.reparametrised(bundle, start, end)
    )
