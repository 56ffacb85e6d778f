r"""Normals where a surface is degenerate: a pole, an apex, a row of the net that is one point.

At a pole S_u = 0 for every u, so S_u x S_v says nothing; but one step h into the domain
S_u is nearly h S_uv, so the limit of the normal is that of S_uv x S_v, with the sign of h::

        o  pole, S_u = 0
       /|\
      / | \     S_uv points along the ring that the next row forms
     o--o--o    S_v points from ring to pole
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray

Domain = tuple[tuple[float, float], tuple[float, float]]

# A derivative counts as vanished when one span further on it is this much longer. Both ways of
# taking the normal are then right to about the same 1e-8: the one by rounding, the other by h.
_VANISHED = 1e-8


def replaced_normals(
    derivatives: FloatArray,
    u: FloatArray,
    v: FloatArray,
    domain: Domain,
    steps: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Form unit normals (m, 3) from derivatives (2, 2, m, 3), with limits where one vanishes.

    Parameters
    ----------
    steps
        For u and for v the length (m,) of the knot span of each parameter.

    Returns
    -------
    Normals; zeros where no direction is left to form one.
    """
    du, dv, twist = derivatives[1, 0], derivatives[0, 1], derivatives[1, 1]
    tangent_u = _or_limit(du, twist * _inwards(v, domain[1])[:, None], steps[1])
    tangent_v = _or_limit(dv, twist * _inwards(u, domain[0])[:, None], steps[0])
    normals = np.cross(tangent_u, tangent_v)
    lengths = np.linalg.norm(normals, axis=1)
    least = _VANISHED * np.linalg.norm(tangent_u, axis=1) * np.linalg.norm(tangent_v, axis=1)
    sound = lengths > least
    return np.where(sound[:, None], normals / np.where(sound, lengths, 1.0)[:, None], 0.0)


def are_regular(derivatives: FloatArray, steps: tuple[FloatArray, FloatArray]) -> BoolArray:
    """Whether both tangents exist by themselves and are not parallel; (2, 2, m, 3) -> (m,)."""
    du, dv, twist = derivatives[1, 0], derivatives[0, 1], derivatives[1, 1]
    lengths = np.linalg.norm(du, axis=1), np.linalg.norm(dv, axis=1)
    cross = np.linalg.norm(np.cross(du, dv), axis=1)
    return np.asarray(
        ~_has_vanished(du, twist, steps[1])
        & ~_has_vanished(dv, twist, steps[0])
        & (cross > _VANISHED * lengths[0] * lengths[1])
    )


def _inwards(parameters: FloatArray, ends: tuple[float, float]) -> FloatArray:
    """Return +1 in the first half of the domain, -1 in the second: the way a limit comes from."""
    return np.where(parameters < (ends[0] + ends[1]) / 2, 1.0, -1.0)


def _or_limit(tangent: FloatArray, limit: FloatArray, step: FloatArray) -> FloatArray:
    return np.where(_has_vanished(tangent, limit, step)[:, None], limit, tangent)


def _has_vanished(tangent: FloatArray, limit: FloatArray, step: FloatArray) -> BoolArray:
    length = np.linalg.norm(tangent, axis=1)
    return np.asarray(length <= _VANISHED * step * np.linalg.norm(limit, axis=1))
