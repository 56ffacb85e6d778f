"""Our patches as Open CASCADE geometry and shells, and back: what STEP and IGES share.

Open CASCADE comes with the extra ``cad`` and is imported inside the functions, so that everything
else runs without it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import MissingExtra
from reconstruction.exporting.knots import DistinctKnots, distinct, flat
from reconstruction.nurbs import Along, clamped_along
from reconstruction.nurbs.values import Surface


def require_open_cascade() -> None:
    """Raise MissingExtra with the remedy unless Open CASCADE can be imported."""
    try:
        import OCP.Geom  # noqa: F401
    except ImportError as missing:
        raise MissingExtra(
            f"STEP and IGES need Open CASCADE ({missing}): pip install 'loftscan[cad]'"
        ) from missing


def geometry(surface: Surface) -> Any:  # noqa: ANN401 (Open CASCADE has no usable types)
    """Surface -> Geom_BSplineSurface; periodic stays periodic, equal weights make it polynomial.

    An unclamped open direction is clamped to its domain (by knot insertion, so exactly), because
    many CAD programs read no other.

    Raises
    ------
    ValueError
        A knot more multiple than its degree allows: the surface would be two.
    """
    from OCP.Geom import Geom_BSplineSurface

    surface = _clamped(surface)
    u, v = (_direction(surface, way) for way in ("u", "v"))
    points = np.roll(surface.control_points_mm, (-u.first_pole, -v.first_pole), axis=(0, 1))
    weights = np.roll(surface.weights, (-u.first_pole, -v.first_pole), axis=(0, 1))
    rational = () if np.all(weights == weights.flat[0]) else (_reals_2d(weights),)
    return Geom_BSplineSurface(
        _points_2d(points),
        *rational,
        _reals(u.knots),
        _reals(v.knots),
        _integers(u.multiplicities),
        _integers(v.multiplicities),
        surface.degree_u,
        surface.degree_v,
        surface.periodic_u,
        surface.periodic_v,
    )


def surface_of(made: Any) -> Surface:  # noqa: ANN401
    """Geom_BSplineSurface -> Surface, without any change of parameters."""
    weights = np.array(
        [[made.Weight(i, j) for j in _from_1(made.NbVPoles())] for i in _from_1(made.NbUPoles())]
    )
    poles = [[made.Pole(i, j) for j in _from_1(made.NbVPoles())] for i in _from_1(made.NbUPoles())]
    return Surface(
        degree_u=made.UDegree(),
        degree_v=made.VDegree(),
        knots_u=flat(
            made.UDegree(),
            np.array([made.UKnot(i) for i in _from_1(made.NbUKnots())]),
            np.array([made.UMultiplicity(i) for i in _from_1(made.NbUKnots())]),
            periodic=made.IsUPeriodic(),
        ),
        knots_v=flat(
            made.VDegree(),
            np.array([made.VKnot(i) for i in _from_1(made.NbVKnots())]),
            np.array([made.VMultiplicity(i) for i in _from_1(made.NbVKnots())]),
            periodic=made.IsVPeriodic(),
        ),
        control_points_mm=np.array([[(p.X(), p.Y(), p.Z()) for p in row] for row in poles]),
        weights=weights,
        periodic_u=made.IsUPeriodic(),
        periodic_v=made.IsVPeriodic(),
    )


def shells(surfaces: Sequence[Surface], *, sew_within_mm: float) -> tuple[Any, list[Any]]:
    """Sew faces over the whole domains: borders closer than `sew_within_mm` become one edge.

    Returns
    -------
    shape
        A shell, or a compound of shells (and single faces) where patches do not touch.
    faces
        The face of each patch in there, in the patches' order.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_Sewing

    faces = [BRepBuilderAPI_MakeFace(geometry(s), sew_within_mm).Face() for s in surfaces]
    if len(faces) == 1:
        return shell_of(faces[0]), faces
    sewing = BRepBuilderAPI_Sewing(sew_within_mm)
    for face in faces:
        sewing.Add(face)
    sewing.Perform()
    return sewing.SewedShape(), [sewing.ModifiedSubShape(face) for face in faces]


def faces_of(shape: Any) -> Iterator[Any]:  # noqa: ANN401
    """Every B-spline surface under a face of `shape`, in the shape's order."""
    from OCP.BRep import BRep_Tool
    from OCP.Geom import Geom_BSplineSurface
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    explorer = TopExp_Explorer(shape, TopAbs_FACE)
    while explorer.More():
        made = BRep_Tool.Surface_s(TopoDS.Face_s(explorer.Current()))
        if isinstance(made, Geom_BSplineSurface):
            yield made
        explorer.Next()


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Take away the printers through which Open CASCADE talks to stdout; give them back after."""
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)


def _direction(surface: Surface, way: str) -> DistinctKnots:
    try:
        return distinct(
            getattr(surface, f"degree_{way}"),
            getattr(surface, f"knots_{way}"),
            periodic=getattr(surface, f"periodic_{way}"),
        )
    except ValueError as wrong:
        raise ValueError(f"surface {way}: {wrong}") from wrong


def _clamped(surface: Surface) -> Surface:
    if not surface.periodic_u:
        surface = clamped_along(surface, Along.U)
    return surface if surface.periodic_v else clamped_along(surface, Along.V)


def shell_of(face: Any) -> Any:  # noqa: ANN401
    """A shell of one face."""
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Shell

    shell = TopoDS_Shell()
    BRep_Builder().MakeShell(shell)
    BRep_Builder().Add(shell, face)
    return shell


def _points_2d(points: FloatArray) -> Any:  # noqa: ANN401
    from OCP.gp import gp_Pnt
    from OCP.TColgp import TColgp_Array2OfPnt

    rows, columns = points.shape[:2]
    array = TColgp_Array2OfPnt(1, rows, 1, columns)
    for (i, j), _ in np.ndenumerate(points[..., 0]):
        array.SetValue(i + 1, j + 1, gp_Pnt(*points[i, j].tolist()))
    return array


def _reals_2d(values: FloatArray) -> Any:  # noqa: ANN401
    from OCP.TColStd import TColStd_Array2OfReal

    array = TColStd_Array2OfReal(1, values.shape[0], 1, values.shape[1])
    for (i, j), value in np.ndenumerate(values):
        array.SetValue(i + 1, j + 1, float(value))
    return array


def _reals(values: FloatArray) -> Any:  # noqa: ANN401
    from OCP.TColStd import TColStd_Array1OfReal

    array = TColStd_Array1OfReal(1, len(values))
    for index, value in enumerate(values.tolist(), 1):
        array.SetValue(index, value)
    return array


def _integers(values: IntArray) -> Any:  # noqa: ANN401
    from OCP.TColStd import TColStd_Array1OfInteger

    array = TColStd_Array1OfInteger(1, len(values))
    for index, value in enumerate(values.tolist(), 1):
        array.SetValue(index, value)
    return array


def _from_1(count: int) -> range:
    return range(1, count + 1)
