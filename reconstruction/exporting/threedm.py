"""3DM files (openNURBS, Rhino) of patches and section curves, in millimetres.

openNURBS knot vectors lack our first and last knot, which no point of the domain depends on; a
periodic direction repeats its first p control points at the end, as our `knots` already expect.
Degree 1 and fewer than p + 2 control points are closed, but never periodic, to openNURBS.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from uuid import UUID, uuid5

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import MissingExtra
from reconstruction.exporting import provenance as origins
from reconstruction.exporting.atomic import replacing
from reconstruction.exporting.bodies import plane_of
from reconstruction.exporting.knots import clamped, distinct
from reconstruction.nurbs.values import Curve, Surface

# Rhino 7 and everything later reads this; Rhino 8's own form would lock Rhino 7 out.
_RHINO_VERSION = 7
_OURS = UUID("6c6f6674-7363-516e-8000-000000000001")
_STEEL = (120, 144, 156, 255)
_ORANGE = (230, 120, 20, 255)


def write_threedm(
    path: Path | str,
    surfaces: Sequence[Surface],
    curves: Sequence[Curve] = (),
    *,
    caps: Sequence[Curve] = (),
    name: str,
    provenance: Mapping[str, object],
) -> None:
    """Write patches on the layer "surface" and curves on the layer "sections".

    Parameters
    ----------
    path
        Final name; the file appears whole or not at all.
    curves
        In the part frame: three coordinates a control point.
    caps
        Closed flat curves, each the border of a trimmed plane beside the patches
        (`bodies.flat_caps`).
    provenance
        Goes to the start section comments and to the document's user text.

    Raises
    ------
    MissingExtra
        rhino3dm is not installed.
    ValueError
        A planar curve, a cap that is not flat, or a knot more multiple than the degree allows.
    OSError
        The file cannot be written.
    """
    rhino = _rhino()
    model = rhino.File3dm()
    model.Settings.ModelUnitSystem = rhino.UnitSystem.Millimeters
    model.ApplicationName = "loftscan"
    _annotate(model, name, provenance)
    layer = _layer(model, "surface", _STEEL)
    for index, surface in enumerate(surfaces):
        attributes = _attributes(rhino, f"{name} patch {index}", layer)
        model.Objects.AddSurface(_nurbs_surface(rhino, surface), attributes)
    for index, border in enumerate(caps):
        attributes = _attributes(rhino, f"{name} cap {index}", layer)
        model.Objects.AddBrep(_trimmed_plane(rhino, index, border), attributes)
    layer = _layer(model, "sections", _ORANGE)
    for index, curve in enumerate(curves):
        attributes = _attributes(rhino, f"{name} section {index}", layer)
        model.Objects.AddCurve(_nurbs_curve(rhino, curve), attributes)
    options = rhino.File3dmWriteOptions()
    options.Version = _RHINO_VERSION
    with replacing(path) as file:
        file.write(base64.b64decode(model.Encode(options)))


def read_threedm(path: Path | str) -> tuple[tuple[Surface, ...], tuple[Curve, ...]]:
    """Read the NURBS surfaces and curves of a 3DM file, in their order in the file.

    The knots that openNURBS leaves out come back as continuations: a periodic direction's from its
    period, an open one's as a copy of its neighbour.

    Raises
    ------
    MissingExtra
        rhino3dm is not installed.
    OSError
        The file cannot be read.
    ValueError
        Not a 3DM file, or one in another unit.
    """
    rhino = _rhino()
    model = rhino.File3dm.FromByteArray(Path(path).read_bytes())
    if model is None:
        raise ValueError(f"{path}: not a 3DM file")
    if model.Settings.ModelUnitSystem != rhino.UnitSystem.Millimeters:
        raise ValueError(f"{path}: unit {model.Settings.ModelUnitSystem.name}, not millimetres")
    geometries = [item.Geometry for item in model.Objects]
    return (
        tuple(_surface(g) for g in geometries if isinstance(g, rhino.NurbsSurface)),
        tuple(_curve(g) for g in geometries if isinstance(g, rhino.NurbsCurve)),
    )


def _rhino() -> Any:  # noqa: ANN401 (rhino3dm's types are not usable)
    try:
        import rhino3dm
    except ImportError as missing:
        raise MissingExtra(
            f"3DM needs rhino3dm ({missing}): pip install 'loftscan[cad]'"
        ) from missing
    return rhino3dm


def _annotate(model: Any, name: str, provenance: Mapping[str, object]) -> None:  # noqa: ANN401
    notes = ("loftscan NURBS surface, unit: mm", f"name: {name}", *origins.lines(provenance))
    model.StartSectionComments = "\n".join(notes)
    model.Strings["loftscan\\name"] = name
    model.Strings["loftscan\\unit"] = "mm"
    for line in origins.lines(provenance):
        key, _, value = line.partition(": ")
        model.Strings[f"loftscan\\{key}"] = value


def _layer(model: Any, name: str, colour: tuple[int, int, int, int]) -> int:  # noqa: ANN401
    index: int = model.Layers.AddLayer(name, colour)
    model.Layers[index].Id = uuid5(_OURS, name)
    return index


def _attributes(rhino: Any, name: str, layer: int) -> Any:  # noqa: ANN401
    attributes = rhino.ObjectAttributes()
    attributes.Name = name
    # Of the name, not of chance: the same reconstruction gives the same file.
    attributes.Id = uuid5(_OURS, name)
    attributes.LayerIndex = layer
    return attributes


def _nurbs_surface(rhino: Any, surface: Surface) -> Any:  # noqa: ANN401
    points = _homogeneous(surface.control_points_mm, surface.weights)
    degree_u, degree_v = surface.degree_u, surface.degree_v
    knots_u, points = _direction(degree_u, surface.knots_u, points, periodic=surface.periodic_u)
    points = points.swapaxes(0, 1)
    knots_v, points = _direction(degree_v, surface.knots_v, points, periodic=surface.periodic_v)
    points = points.swapaxes(0, 1)
    rational = not _all_equal(surface.weights)
    made = rhino.NurbsSurface.Create(3, rational, degree_u + 1, degree_v + 1, *points.shape[:2])
    _set_knots(made.KnotsU, knots_u)
    _set_knots(made.KnotsV, knots_v)
    for i, row in enumerate(points.tolist()):
        for j, point in enumerate(row):
            made.Points[i, j] = rhino.Point4d(*point)
    return made


def _nurbs_curve(rhino: Any, curve: Curve) -> Any:  # noqa: ANN401
    if curve.control_points_mm.shape[1] != 3:
        raise ValueError("3DM: curves need three coordinates, in the part frame")
    points = _homogeneous(curve.control_points_mm, curve.weights)
    knots, points = _direction(curve.degree, curve.knots, points, periodic=curve.periodic)
    made = rhino.NurbsCurve(3, not _all_equal(curve.weights), curve.degree + 1, len(points))
    _set_knots(made.Knots, knots)
    for index, point in enumerate(points.tolist()):
        made.Points[index] = rhino.Point4d(*point)
    return made


def _trimmed_plane(rhino: Any, index: int, border: Curve) -> Any:  # noqa: ANN401
    place, normal, _ = plane_of(border)
    plane = rhino.Plane(rhino.Point3d(*place.tolist()), rhino.Vector3d(*normal.tolist()))
    made = rhino.Brep.CreateTrimmedPlane(plane, _nurbs_curve(rhino, border))
    if made is None:
        raise ValueError(f"3DM: cap {index}: openNURBS finds no closed flat curve in its border")
    return made


def _direction(
    degree: int, knots: FloatArray, points: FloatArray, *, periodic: bool
) -> tuple[FloatArray, FloatArray]:
    """Knots and control points of the first axis as openNURBS takes them.

    A periodic seam on a multiple knot is invalid to openNURBS: that direction is cut open.
    """
    at_seam = distinct(degree, knots, periodic=periodic).multiplicities[0]
    if not periodic:
        return knots, points
    if at_seam > 1:
        return clamped(degree, knots, points)
    return knots, np.take(points, np.arange(len(points) + degree), axis=0, mode="wrap")


def _homogeneous(points_mm: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., 3), (...) -> (..., 4) as (w x, w y, w z, w); equal weights are taken as 1."""
    if _all_equal(weights):
        weights = np.ones_like(weights)
    return np.concatenate([points_mm * weights[..., None], weights[..., None]], axis=-1)


def _all_equal(weights: FloatArray) -> bool:
    return bool(np.all(weights == weights.flat[0]))


def _set_knots(target: Any, knots: FloatArray) -> None:  # noqa: ANN401
    for index, knot in enumerate(knots[1:-1].tolist()):
        target[index] = knot


def _surface(made: Any) -> Surface:  # noqa: ANN401
    full = np.array(
        [
            [_coordinates(made.Points[i, j]) for j in range(made.Points.CountV)]
            for i in range(made.Points.CountU)
        ]
    )
    periodic_u, periodic_v = made.IsPeriodic(0), made.IsPeriodic(1)
    degree_u, degree_v = made.OrderU - 1, made.OrderV - 1
    rows = full.shape[0] - (degree_u if periodic_u else 0)
    columns = full.shape[1] - (degree_v if periodic_v else 0)
    unique = full[:rows, :columns]
    return Surface(
        degree_u=degree_u,
        degree_v=degree_v,
        knots_u=_full_knots(made.KnotsU, degree_u, periodic=periodic_u),
        knots_v=_full_knots(made.KnotsV, degree_v, periodic=periodic_v),
        control_points_mm=unique[..., :3] / unique[..., 3:],
        weights=unique[..., 3],
        periodic_u=periodic_u,
        periodic_v=periodic_v,
    )


def _curve(made: Any) -> Curve:  # noqa: ANN401
    full = np.array([_coordinates(made.Points[i]) for i in range(len(made.Points))])
    periodic, degree = made.IsPeriodic, made.Order - 1
    unique = full[: len(full) - degree] if periodic else full
    return Curve(
        degree=degree,
        knots=_full_knots(made.Knots, degree, periodic=periodic),
        control_points_mm=unique[:, :3] / unique[:, 3:],
        weights=unique[:, 3],
        periodic=periodic,
    )


def _coordinates(point: Any) -> tuple[float, float, float, float]:  # noqa: ANN401
    return point.X, point.Y, point.Z, point.W


def _full_knots(source: Any, degree: int, *, periodic: bool) -> FloatArray:  # noqa: ANN401
    """Put back the first and last knot that openNURBS leaves out."""
    inner = np.array([source[i] for i in range(len(source))], dtype=np.float64)
    if not periodic:
        return np.concatenate([inner[:1], inner, inner[-1:]])
    count = len(inner) - 2 * degree + 1
    period = inner[degree - 1 + count] - inner[degree - 1]
    first, last = inner[count - 1] - period, inner[2 * degree - 1] + period
    return np.concatenate([[first], inner, [last]])
