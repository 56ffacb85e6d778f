"""The same surface on a net of twice the spans, along u, along v or both."""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.net import Net, basis_at, greville, knots_of

_NONE = np.empty(0, np.int64)


def refined(net: Net, along: tuple[bool, bool]) -> Net:
    """Halve the spans of the directions said; the surface stays as it is."""
    creases = net.creases
    whole = net.surface()  # where columns meet in a crease, one
    control, knots_u, knots_v = whole.control_points_mm, whole.knots_u, net.knots_v
    if along[0]:
        creases = 2 * creases
        control, knots_u = _halved(control, knots_u, closed=net.closed_u, creases=creases)
    apex = net.apex
    if along[1]:
        turned = control.swapaxes(0, 1)
        control, knots_v = _halved(turned, knots_v, closed=net.closed_v, creases=_NONE)
        control = np.array(control.swapaxes(0, 1))
        apex = np.zeros(control.shape[1], np.bool_)
        apex[[0, -1]] = net.apex[[0, -1]] & (not net.closed_v)
    for row in (0, -1):
        if apex[row]:
            control[:, row] = net.control_mm[0, row]
    return Net(control, knots_u, knots_v, net.closed_u, net.closed_v, apex).cut_at(creases)


def _halved(
    control: FloatArray, knots: FloatArray, *, closed: bool, creases: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Control points (n, m, 3) of the first direction for half the spans, by collocation."""
    spans = 2 * int(knots[-4])
    fine = knots_of(spans, closed=closed, creases=creases)
    count = len(fine) - (7 if closed else 4)
    t = greville(fine, count)
    t = np.mod(t, spans) if closed else t
    given = _collocated(t / 2.0, knots, len(control), closed=closed)
    wanted = _collocated(t, fine, count, closed=closed)
    places = (given @ control.reshape(len(control), -1)).reshape(count, *control.shape[1:])
    solved = np.linalg.solve(wanted, places.reshape(count, -1)).reshape(places.shape)
    if not closed:
        solved[[0, -1]] = control[[0, -1]]  # exactly: ends lie in planes
    return np.asarray(solved), fine


def _collocated(t: FloatArray, knots: FloatArray, count: int, *, closed: bool) -> FloatArray:
    """Basis functions at parameters (m, count)."""
    basis = basis_at(t, knots, 0, closed=closed)
    design = np.zeros((len(t), count))
    for k in range(4):
        np.add.at(design, (np.arange(len(t)), (basis.first + k) % count), basis.values[:, 0, k])
    return design
