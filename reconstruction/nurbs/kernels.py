"""The compiled loops under evaluation: spans, local basis functions, sums over a patch.

Algorithms A2.1 to A2.3 of Piegl and Tiller, *The NURBS Book* (2nd ed., 1997), and the sums of the
paper's eq. 1. Nets are homogeneous, ``(x w, y w, z w, w)``, and *full* (periodic directions
wrapped), so that nothing here knows about periods. All kernels live in this one file because
numba's cache is keyed by the caller's file only: a kernel elsewhere would go stale.

Parameters have been checked and reduced to the domain by the callers.

The surface loops take `unroll`, whose length is the number of basis functions of a direction. Given
as a tuple, that length is part of the type, so numba compiles a kernel of its own with every inner
loop unrolled (2 x faster); given as an array, the same source serves any degree.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray

Vector = tuple[float, float, float]
Homogeneous = tuple[float, float, float, float]
Unroll = tuple[int, ...] | FloatArray
Frame = tuple[Vector, Vector, Vector]  # a point and its two first derivatives


@njit(cache=True)
def span_starts(knots: FloatArray, degree: int, last: int) -> tuple[IntArray, float]:
    """For equal buckets of the domain the span of each bucket's start; buckets per parameter."""
    start, end = knots[degree], knots[last + 1]
    count = 16 * (last + 1 - degree)
    starts = np.empty(count + 1, np.int64)
    span = degree
    for bucket in range(count + 1):
        u = start + (end - start) * bucket / count
        while span < last and knots[span + 1] <= u:
            span += 1
        starts[bucket] = span
    return starts, count / (end - start)


@njit(cache=True)
def span_of(u: float, knots: FloatArray, degree: int, starts: IntArray, scale: float) -> int:
    """Return the k with knots[k] <= u < knots[k + 1]; the domain's end is in the last real span."""
    last = starts[len(starts) - 1]
    span = starts[int((u - knots[degree]) * scale)]
    while knots[span + 1] <= u and span < last:
        span += 1
    while (u < knots[span] or knots[span] >= knots[span + 1]) and span > degree:
        span -= 1
    return int(span)


@njit(cache=True)
def spans_of(u: FloatArray, knots: FloatArray, degree: int, last: int) -> IntArray:
    """Return the span of every parameter; (m,) -> (m,)."""
    spans = np.empty(len(u), np.int64)
    starts, scale = span_starts(knots, degree, last)
    for row in range(len(u)):
        spans[row] = span_of(u[row], knots, degree, starts, scale)
    return spans


@njit(cache=True, error_model="numpy")
def basis_into(
    u: float, span: int, knots: FloatArray, values: FloatArray, slopes: FloatArray
) -> None:
    """Write the p + 1 basis functions that live on a span, and their slopes (A2.2).

    The last step of the recursion holds the slopes already: N'(i, p) is p times the difference of
    two neighbouring quotients N(i, p - 1) / (t(i + p) - t(i)).
    """
    degree = len(values) - 1
    values[0] = 1.0
    for level in range(1, degree + 1):
        saved, before = 0.0, 0.0
        for r in range(level):
            upper, lower = knots[span + r + 1], knots[span + 1 - level + r]
            quotient = values[r] / (upper - lower)
            slopes[r] = degree * (before - quotient)
            values[r] = saved + (upper - u) * quotient
            saved = (u - lower) * quotient
            before = quotient
        values[level] = saved
        slopes[level] = degree * before


@njit(cache=True)
def basis_rows(
    u: FloatArray, spans: IntArray, knots: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Basis functions and slopes at many parameters; each (m, p + 1)."""
    values = np.empty((len(u), degree + 1))
    slopes = np.empty((len(u), degree + 1))
    for row in range(len(u)):
        basis_into(u[row], spans[row], knots, values[row], slopes[row])
    return values, slopes


@njit(cache=True)
def basis_triangle(u: float, span: int, knots: FloatArray, triangle: FloatArray) -> None:
    """Basis functions of all degrees above the diagonal, knot differences below (A2.3, part 1)."""
    degree = len(triangle) - 1
    triangle[0, 0] = 1.0
    for j in range(1, degree + 1):
        saved = 0.0
        for r in range(j):
            upper, lower = knots[span + r + 1], knots[span + 1 - j + r]
            triangle[j, r] = upper - lower
            quotient = triangle[r, j - 1] / triangle[j, r]
            triangle[r, j] = saved + (upper - u) * quotient
            saved = (u - lower) * quotient
        triangle[j, j] = saved


@njit(cache=True)
def derivatives_into(triangle: FloatArray, r: int, out: FloatArray) -> None:
    """Write derivatives 1..len(out) - 1 of the r-th local basis function (A2.3, part 2)."""
    degree = len(triangle) - 1
    rows = np.zeros((2, degree + 1))
    rows[0, 0] = 1.0
    now, factor = 0, float(degree)
    for k in range(1, len(out)):
        below, after, total = degree - k, 1 - now, 0.0
        for j in range(max(0, k - r), min(k, degree - r) + 1):
            left = rows[now, j - 1] if j > 0 else 0.0
            right = rows[now, j] if j < k else 0.0
            rows[after, j] = (right - left) / triangle[below + 1, r - k + j]
            total += rows[after, j] * triangle[r - k + j, below]
        out[k] = total * factor
        factor *= below
        rows[now, :] = 0.0
        now = after


@njit(cache=True)
def basis_derivative_rows(
    u: FloatArray, spans: IntArray, knots: FloatArray, degree: int, order: int
) -> FloatArray:
    """Local basis functions and their derivatives; (m, p + 1, order + 1), zero beyond degree."""
    rows = np.zeros((len(u), degree + 1, order + 1))
    triangle = np.empty((degree + 1, degree + 1))
    highest = min(order, degree)
    for row in range(len(u)):
        basis_triangle(u[row], spans[row], knots, triangle)
        for r in range(degree + 1):
            rows[row, r, 0] = triangle[r, degree]
            derivatives_into(triangle, r, rows[row, r, : highest + 1])
    return rows


@njit(cache=True)
def combined(basis: FloatArray, spans: IntArray, coefficients: FloatArray) -> FloatArray:
    """Sum local basis functions (m, p + 1) over full coefficients (n, k); (m, k)."""
    terms, width = basis.shape[1], coefficients.shape[1]
    sums = np.zeros((len(basis), width))
    for row in range(len(basis)):
        first = spans[row] - terms + 1
        for r in range(terms):
            for c in range(width):
                sums[row, c] += basis[row, r] * coefficients[first + r, c]
    return sums


@njit(cache=True)
def combined_scattered(
    basis_u: FloatArray, spans_u: IntArray, basis_v: FloatArray, spans_v: IntArray, net: FloatArray
) -> FloatArray:
    """Sum a full net (nu, nv, k) over both local bases at scattered parameters; (m, k)."""
    terms_u, terms_v, width = basis_u.shape[1], basis_v.shape[1], net.shape[2]
    sums = np.zeros((len(basis_u), width))
    for row in range(len(basis_u)):
        i, j = spans_u[row] - terms_u + 1, spans_v[row] - terms_v + 1
        for r in range(terms_u):
            for s in range(terms_v):
                factor = basis_u[row, r] * basis_v[row, s]
                for c in range(width):
                    sums[row, c] += factor * net[i + r, j + s, c]
    return sums


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def projected_frame(
    s: Homogeneous,
    su: Homogeneous,
    sv: Homogeneous,
) -> Frame:
    """Project a homogeneous point and its first derivatives to space (the quotient rule)."""
    f = 1.0 / s[3]
    x, y, z = s[0] / s[3], s[1] / s[3], s[2] / s[3]
    du = ((su[0] - su[3] * x) * f, (su[1] - su[3] * y) * f, (su[2] - su[3] * z) * f)
    dv = ((sv[0] - sv[3] * x) * f, (sv[1] - sv[3] * y) * f, (sv[2] - sv[3] * z) * f)
    return (x, y, z), du, dv


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def unit_normal(du: Vector, dv: Vector, least: float) -> Vector:
    """Scale du x dv to length one; zeros where its length is not above `least`."""
    x = du[1] * dv[2] - du[2] * dv[1]
    y = du[2] * dv[0] - du[0] * dv[2]
    z = du[0] * dv[1] - du[1] * dv[0]
    square = x * x + y * y + z * z
    f = 1.0 / np.sqrt(square) if square > least * least else 0.0
    return x * f, y * f, z * f


@njit(cache=True, error_model="numpy")
def reciprocals(knots: FloatArray, degree: int, last: int) -> FloatArray:
    """1 / every knot difference that A2.2 divides by, row by span, in its order of use."""
    table = np.zeros((last + 1, degree * (degree + 1) // 2))
    for span in range(degree, last + 1):
        if knots[span + 1] > knots[span]:
            use = 0
            for level in range(1, degree + 1):
                for r in range(level):
                    table[span, use] = 1.0 / (knots[span + r + 1] - knots[span + 1 - level + r])
                    use += 1
    return table


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fast_basis_into(
    u: float,
    span: int,
    knots: FloatArray,
    table: FloatArray,
    values: FloatArray,
    slopes: FloatArray,
    unroll: Unroll,
) -> None:
    """`basis_into` without divisions; on knots it is one rounding off, as x * (1 / x) is from 1.

    A branch to the exact form costs 80 % here: callers redo the few points at the domain's ends.
    """
    degree, use = len(unroll) - 1, 0
    values[0] = 1.0
    for level in range(1, degree + 1):
        saved, before = 0.0, 0.0
        for r in range(level):
            quotient = values[r] * table[span, use]
            use += 1
            slopes[r] = degree * (before - quotient)
            values[r] = saved + (knots[span + r + 1] - u) * quotient
            saved = (u - knots[span + 1 - level + r]) * quotient
            before = quotient
        values[level] = saved
        slopes[level] = degree * before


@njit(cache=True, fastmath={"contract"})
def row_sum(row: FloatArray, first: int, factors: FloatArray, unroll: Unroll) -> Homogeneous:
    """Sum `factors` over consecutive control points of one row (n, 4)."""
    x, y, z, w = 0.0, 0.0, 0.0, 0.0
    for j in range(len(unroll)):
        f = factors[j]
        x += f * row[first + j, 0]
        y += f * row[first + j, 1]
        z += f * row[first + j, 2]
        w += f * row[first + j, 3]
    return x, y, z, w


@njit(cache=True, fastmath={"contract"})
def added(s: Homogeneous, factor: float, a: Homogeneous) -> Homogeneous:
    """Return s + factor * a."""
    return (
        s[0] + factor * a[0],
        s[1] + factor * a[1],
        s[2] + factor * a[2],
        s[3] + factor * a[3],
    )


@njit(cache=True, fastmath={"contract"})
def row_into(
    net: FloatArray, first: int, factors: FloatArray, unroll: Unroll, row: FloatArray
) -> None:
    """Sum the net over u alone: the control points (nv, 4) of one curve of constant u."""
    for j in range(net.shape[1]):
        s = (0.0, 0.0, 0.0, 0.0)
        for i in range(len(unroll)):
            k = first + i
            point = (net[k, j, 0], net[k, j, 1], net[k, j, 2], net[k, j, 3])
            s = added(s, factors[i], point)
        row[j, 0], row[j, 1], row[j, 2], row[j, 3] = s


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def grid_points(
    net: FloatArray,
    first_u: IntArray,
    basis_u: FloatArray,
    first_v: IntArray,
    basis_v: FloatArray,
    unroll_u: Unroll,
    unroll_v: Unroll,
    points: FloatArray,
) -> None:
    """Points (mu, mv, 3) of a grid; the sum over u is done once a row."""
    row = np.empty((net.shape[1], 4))
    for a in range(len(first_u)):
        row_into(net, first_u[a], basis_u[a], unroll_u, row)
        for b in range(len(first_v)):
            x, y, z, w = row_sum(row, first_v[b], basis_v[b], unroll_v)
            points[a, b, 0], points[a, b, 1], points[a, b, 2] = x / w, y / w, z / w


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def grid_frames(
    net: FloatArray,
    first_u: IntArray,
    basis_u: tuple[FloatArray, FloatArray],
    first_v: IntArray,
    basis_v: tuple[FloatArray, FloatArray],
    unroll_u: Unroll,
    unroll_v: Unroll,
    frames: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Points and first derivatives of a grid into three arrays (mu, mv, 3)."""
    row, slope = np.empty((net.shape[1], 4)), np.empty((net.shape[1], 4))
    for a in range(len(first_u)):
        row_into(net, first_u[a], basis_u[0][a], unroll_u, row)
        row_into(net, first_u[a], basis_u[1][a], unroll_u, slope)
        for b in range(len(first_v)):
            frame = projected_frame(
                row_sum(row, first_v[b], basis_v[0][b], unroll_v),
                row_sum(slope, first_v[b], basis_v[0][b], unroll_v),
                row_sum(row, first_v[b], basis_v[1][b], unroll_v),
            )
            frames[0][a, b, 0], frames[0][a, b, 1], frames[0][a, b, 2] = frame[0]
            frames[1][a, b, 0], frames[1][a, b, 1], frames[1][a, b, 2] = frame[1]
            frames[2][a, b, 0], frames[2][a, b, 1], frames[2][a, b, 2] = frame[2]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def grid_normals(
    net: FloatArray,
    first_u: IntArray,
    basis_u: tuple[FloatArray, FloatArray],
    first_v: IntArray,
    basis_v: tuple[FloatArray, FloatArray],
    unroll_u: Unroll,
    unroll_v: Unroll,
    points: FloatArray,
    normals: FloatArray,
    least: float,
) -> int:
    """Points and unit normals of a grid, (mu, mv, 3) each; returns how many have no normal."""
    missing = 0
    row, slope = np.empty((net.shape[1], 4)), np.empty((net.shape[1], 4))
    for a in range(len(first_u)):
        row_into(net, first_u[a], basis_u[0][a], unroll_u, row)
        row_into(net, first_u[a], basis_u[1][a], unroll_u, slope)
        for b in range(len(first_v)):
            point, du, dv = projected_frame(
                row_sum(row, first_v[b], basis_v[0][b], unroll_v),
                row_sum(slope, first_v[b], basis_v[0][b], unroll_v),
                row_sum(row, first_v[b], basis_v[1][b], unroll_v),
            )
            points[a, b, 0], points[a, b, 1], points[a, b, 2] = point
            normal = unit_normal(du, dv, least)
            normals[a, b, 0], normals[a, b, 1], normals[a, b, 2] = normal
            missing += normal == (0.0, 0.0, 0.0)
    return missing


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def patch_row_sum(
    net: FloatArray, i: int, first: int, factors: FloatArray, unroll: Unroll
) -> Homogeneous:
    """`row_sum` of one row of the net; a view of the row would cost more than its sum."""
    x, y, z, w = 0.0, 0.0, 0.0, 0.0
    for j in range(len(unroll)):
        f = factors[j]
        x += f * net[i, first + j, 0]
        y += f * net[i, first + j, 1]
        z += f * net[i, first + j, 2]
        w += f * net[i, first + j, 3]
    return x, y, z, w


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def scattered_points(
    net: FloatArray,
    u: FloatArray,
    knots_u: FloatArray,
    v: FloatArray,
    knots_v: FloatArray,
    unroll_u: Unroll,
    unroll_v: Unroll,
    points: FloatArray,
) -> None:
    """Points (m, 3) at scattered parameters."""
    p, q = len(unroll_u) - 1, len(unroll_v) - 1
    starts_u, scale_u = span_starts(knots_u, p, net.shape[0] - 1)
    starts_v, scale_v = span_starts(knots_v, q, net.shape[1] - 1)
    table_u = reciprocals(knots_u, p, net.shape[0] - 1)
    table_v = reciprocals(knots_v, q, net.shape[1] - 1)
    bu, du, bv, dv = np.empty(p + 1), np.empty(p + 1), np.empty(q + 1), np.empty(q + 1)
    for m in range(len(u)):
        i = span_of(u[m], knots_u, p, starts_u, scale_u)
        j = span_of(v[m], knots_v, q, starts_v, scale_v)
        fast_basis_into(u[m], i, knots_u, table_u, bu, du, unroll_u)
        fast_basis_into(v[m], j, knots_v, table_v, bv, dv, unroll_v)
        s = (0.0, 0.0, 0.0, 0.0)
        for r in range(len(unroll_u)):
            s = added(s, bu[r], patch_row_sum(net, i - p + r, j - q, bv, unroll_v))
        points[m, 0], points[m, 1], points[m, 2] = s[0] / s[3], s[1] / s[3], s[2] / s[3]


@njit(cache=True, error_model="numpy", fastmath={"contract"}, inline="always")
def patch_frame(
    net: FloatArray,
    corner: tuple[int, int],
    bases: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    unroll_u: Unroll,
    unroll_v: Unroll,
) -> Frame:
    """Point and both first derivatives on the patch that begins at a corner of the net."""
    bu, du, bv, dv = bases
    s = su = sv = (0.0, 0.0, 0.0, 0.0)
    for r in range(len(unroll_u)):
        along = patch_row_sum(net, corner[0] + r, corner[1], bv, unroll_v)
        across = patch_row_sum(net, corner[0] + r, corner[1], dv, unroll_v)
        s, su, sv = added(s, bu[r], along), added(su, du[r], along), added(sv, bu[r], across)
    return projected_frame(s, su, sv)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def scattered_normals(
    net: FloatArray,
    u: FloatArray,
    knots_u: FloatArray,
    v: FloatArray,
    knots_v: FloatArray,
    unroll_u: Unroll,
    unroll_v: Unroll,
    points: FloatArray,
    normals: FloatArray,
    least: float,
) -> int:
    """Points and unit normals at scattered parameters; returns how many have no normal."""
    missing = 0
    p, q = len(unroll_u) - 1, len(unroll_v) - 1
    starts_u, scale_u = span_starts(knots_u, p, net.shape[0] - 1)
    starts_v, scale_v = span_starts(knots_v, q, net.shape[1] - 1)
    table_u = reciprocals(knots_u, p, net.shape[0] - 1)
    table_v = reciprocals(knots_v, q, net.shape[1] - 1)
    bu, du, bv, dv = np.empty(p + 1), np.empty(p + 1), np.empty(q + 1), np.empty(q + 1)
    for m in range(len(u)):
        i = span_of(u[m], knots_u, p, starts_u, scale_u)
        j = span_of(v[m], knots_v, q, starts_v, scale_v)
        fast_basis_into(u[m], i, knots_u, table_u, bu, du, unroll_u)
        fast_basis_into(v[m], j, knots_v, table_v, bv, dv, unroll_v)
        corner, bases = (i - p, j - q), (bu, du, bv, dv)
        point, tangent_u, tangent_v = patch_frame(net, corner, bases, unroll_u, unroll_v)
        points[m, 0], points[m, 1], points[m, 2] = point
        normal = unit_normal(tangent_u, tangent_v, least)
        normals[m, 0], normals[m, 1], normals[m, 2] = normal
        missing += normal == (0.0, 0.0, 0.0)
    return missing


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def scattered_tangents(
    net: FloatArray,
    u: FloatArray,
    knots_u: FloatArray,
    v: FloatArray,
    knots_v: FloatArray,
    unroll_u: Unroll,
    unroll_v: Unroll,
    frames: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Points and both first derivatives at scattered parameters into three arrays (m, 3)."""
    p, q = len(unroll_u) - 1, len(unroll_v) - 1
    starts_u, scale_u = span_starts(knots_u, p, net.shape[0] - 1)
    starts_v, scale_v = span_starts(knots_v, q, net.shape[1] - 1)
    table_u = reciprocals(knots_u, p, net.shape[0] - 1)
    table_v = reciprocals(knots_v, q, net.shape[1] - 1)
    bu, du, bv, dv = np.empty(p + 1), np.empty(p + 1), np.empty(q + 1), np.empty(q + 1)
    for m in range(len(u)):
        i = span_of(u[m], knots_u, p, starts_u, scale_u)
        j = span_of(v[m], knots_v, q, starts_v, scale_v)
        fast_basis_into(u[m], i, knots_u, table_u, bu, du, unroll_u)
        fast_basis_into(v[m], j, knots_v, table_v, bv, dv, unroll_v)
        corner, bases = (i - p, j - q), (bu, du, bv, dv)
        frame = patch_frame(net, corner, bases, unroll_u, unroll_v)
        frames[0][m, 0], frames[0][m, 1], frames[0][m, 2] = frame[0]
        frames[1][m, 0], frames[1][m, 1], frames[1][m, 2] = frame[1]
        frames[2][m, 0], frames[2][m, 1], frames[2][m, 2] = frame[2]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fast_bends_into(
    u: float,
    span: int,
    knots: FloatArray,
    table: FloatArray,
    values: FloatArray,
    slopes: FloatArray,
    bends: FloatArray,
    unroll: Unroll,
) -> None:
    """`fast_basis_into` with second derivatives: slopes of one degree less, differenced again."""
    use = 0
    values[0], slopes[0], bends[0] = 1.0, 0.0, 0.0
    for level in range(1, len(unroll)):
        saved, before, turned = 0.0, 0.0, 0.0
        for r in range(level):
            quotient, turn = values[r] * table[span, use], slopes[r] * table[span, use]
            use += 1
            bends[r] = level * (turned - turn)
            slopes[r] = level * (before - quotient)
            values[r] = saved + (knots[span + r + 1] - u) * quotient
            saved = (u - knots[span + 1 - level + r]) * quotient
            before, turned = quotient, turn
        values[level] = saved
        slopes[level] = level * before
        bends[level] = level * turned


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def projected_second(
    second: Homogeneous, weights: tuple[float, float], firsts: tuple[Vector, Vector], point: Vector,
    w: float,
) -> Vector:  # fmt: skip
    """Project a second derivative in a and b: `weights` are w_a, w_b, `firsts` S_b, S_a."""
    f = 1.0 / w
    (wa, wb), (sb, sa), c = weights, firsts, second[3]
    return (
        (second[0] - wa * sb[0] - wb * sa[0] - c * point[0]) * f,
        (second[1] - wa * sb[1] - wb * sa[1] - c * point[1]) * f,
        (second[2] - wa * sb[2] - wb * sa[2] - c * point[2]) * f,
    )


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def dot(a: Vector, b: Vector) -> float:
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def shape_operator(
    du: Vector, dv: Vector, seconds: tuple[Vector, Vector, Vector], least: float
) -> tuple[float, float, float]:
    """Second fundamental form in orthonormal tangents, (a, b, c) of ((a, b), (b, c)).

    The first tangent is along `du`. In this basis principal curvatures are eigenvalues of a
    symmetric matrix and exact even where they are equal. NaN where there is no normal.
    """
    normal = unit_normal(du, dv, least)
    if normal == (0.0, 0.0, 0.0):
        return np.nan, np.nan, np.nan
    length = np.sqrt(dot(du, du))
    shear = dot(du, dv) / (length * length)
    aside = (dv[0] - shear * du[0], dv[1] - shear * du[1], dv[2] - shear * du[2])
    width = np.sqrt(dot(aside, aside))
    uu, uv, vv = dot(seconds[0], normal), dot(seconds[1], normal), dot(seconds[2], normal)
    a = uu / (length * length)
    b = (uv - shear * uu) / (length * width)
    return a, b, (vv - 2.0 * shear * uv + shear * shear * uu) / (width * width)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def scattered_curvatures(
    net: FloatArray,
    u: FloatArray,
    knots_u: FloatArray,
    v: FloatArray,
    knots_v: FloatArray,
    unroll_u: Unroll,
    unroll_v: Unroll,
    curvatures: FloatArray,
    least: float,
) -> None:
    """Gaussian, mean, larger and smaller principal curvature at scattered parameters; (m, 4)."""
    p, q = len(unroll_u) - 1, len(unroll_v) - 1
    starts_u, scale_u = span_starts(knots_u, p, net.shape[0] - 1)
    starts_v, scale_v = span_starts(knots_v, q, net.shape[1] - 1)
    table_u = reciprocals(knots_u, p, net.shape[0] - 1)
    table_v = reciprocals(knots_v, q, net.shape[1] - 1)
    bu, du, au = np.empty(p + 1), np.empty(p + 1), np.empty(p + 1)
    bv, dv, av = np.empty(q + 1), np.empty(q + 1), np.empty(q + 1)
    for m in range(len(u)):
        i = span_of(u[m], knots_u, p, starts_u, scale_u)
        j = span_of(v[m], knots_v, q, starts_v, scale_v)
        fast_bends_into(u[m], i, knots_u, table_u, bu, du, au, unroll_u)
        fast_bends_into(v[m], j, knots_v, table_v, bv, dv, av, unroll_v)
        s = su = sv = suu = suv = svv = (0.0, 0.0, 0.0, 0.0)
        for r in range(len(unroll_u)):
            along = patch_row_sum(net, i - p + r, j - q, bv, unroll_v)
            across = patch_row_sum(net, i - p + r, j - q, dv, unroll_v)
            bent = patch_row_sum(net, i - p + r, j - q, av, unroll_v)
            s, su, sv = added(s, bu[r], along), added(su, du[r], along), added(sv, bu[r], across)
            suu, suv = added(suu, au[r], along), added(suv, du[r], across)
            svv = added(svv, bu[r], bent)
        point, tu, tv = projected_frame(s, su, sv)
        wu, wv, w = su[3], sv[3], s[3]
        seconds = (
            projected_second(suu, (wu, wu), (tu, tu), point, w),
            projected_second(suv, (wu, wv), (tv, tu), point, w),
            projected_second(svv, (wv, wv), (tv, tv), point, w),
        )
        a, b, c = shape_operator(tu, tv, seconds, least)
        mean, spread = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
        curvatures[m, 0], curvatures[m, 1] = a * c - b * b, mean
        curvatures[m, 2], curvatures[m, 3] = mean + spread, mean - spread
