# SPDX-License-Identifier: Apache-2.0
"""Least squares: small symmetric systems in one thread, in float64, of the first ``rows`` of six equations."""

import warp as wp

__all__ = ["solve_definite", "solve_truncated"]

_SWEEPS = wp.constant(12)
"""Largest number of Jacobi sweeps; convergence is quadratic, and matrices of this size need about six."""
_NONE = wp.constant(wp.float64(1.0e-14))
"""Share of the trace that counts as zero: about the rounding of float64."""


@wp.func
def solve_definite(gram: wp.spatial_matrixd, error: wp.spatial_vectord, rows: int) -> wp.spatial_vectord:
    """Solve ``A y = e`` for a semidefinite ``A`` by Cholesky's factors; ``y`` is 0 where a pivot vanishes."""
    factor = wp.spatial_matrixd()
    y = wp.spatial_vectord()
    least = _NONE * wp.trace(gram)
    for j in range(rows):
        pivot = gram[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        if pivot > least:
            root = wp.sqrt(pivot)
            factor[j, j] = root
            for i in range(j + 1, rows):
                entry = gram[i, j]
                for k in range(j):
                    entry -= factor[i, k] * factor[j, k]
                factor[i, j] = entry / root
    # Forward substitution, then back substitution, both over the pivots that did not vanish.
    for i in range(rows):
        if factor[i, i] > wp.float64(0.0):
            value = error[i]
            for k in range(i):
                value -= factor[i, k] * y[k]
            y[i] = value / factor[i, i]
    for back in range(rows):
        i = rows - 1 - back
        if factor[i, i] > wp.float64(0.0):
            value = y[i]
            for k in range(i + 1, rows):
                value -= factor[k, i] * y[k]
            y[i] = value / factor[i, i]
    return y


@wp.func
def solve_truncated(
    gram: wp.spatial_matrixd, error: wp.spatial_vectord, rows: int, least: wp.float64, share: wp.float64
) -> wp.spatial_vectord:
    """Solve ``A y = e`` by the truncated pseudo-inverse of a semidefinite ``A``.

    Eigenvalues whose roots, the singular values of ``J`` for ``A = J J^T``, are below ``least`` or ``share`` of the
    largest root are left out. The eigenvectors come from Jacobi's method: sweeps of plane rotations, each of which
    makes one pair of entries zero.
    """
    a = wp.spatial_matrixd(gram)
    v = wp.identity(n=6, dtype=wp.float64)
    small = _NONE * wp.trace(gram)
    sweep = wp.int32(0)
    turned = wp.int32(1)
    while turned == 1 and sweep < _SWEEPS:
        turned = wp.int32(0)
        sweep += 1
        for p in range(rows - 1):
            for q in range(p + 1, rows):
                if wp.abs(a[p, q]) > small * wp.float64(0.01):
                    turned = wp.int32(1)
                    # ``t`` is the tangent of the smaller of two possible angles, which makes the sweeps converge, in a
                    # form without cancellation.
                    slope = (a[q, q] - a[p, p]) / (wp.float64(2.0) * a[p, q])
                    t = wp.float64(1.0) / (wp.abs(slope) + wp.sqrt(slope * slope + wp.float64(1.0)))
                    if slope < wp.float64(0.0):
                        t = -t
                    c = wp.float64(1.0) / wp.sqrt(t * t + wp.float64(1.0))
                    s = t * c
                    for k in range(rows):
                        x = a[k, p]
                        y = a[k, q]
                        a[k, p] = c * x - s * y
                        a[k, q] = s * x + c * y
                    for k in range(rows):
                        x = a[p, k]
                        y = a[q, k]
                        a[p, k] = c * x - s * y
                        a[q, k] = s * x + c * y
                    for k in range(rows):
                        x = v[k, p]
                        y = v[k, q]
                        v[k, p] = c * x - s * y
                        v[k, q] = s * x + c * y
    largest = wp.float64(0.0)
    for k in range(rows):
        largest = wp.max(largest, a[k, k])
    bound = wp.max(least * least, share * share * largest)  # eigenvalues are squares of singular values
    out = wp.spatial_vectord()
    for k in range(rows):
        if a[k, k] > bound:
            part = wp.float64(0.0)
            for i in range(rows):
                part += v[i, k] * error[i]
            for i in range(rows):
                out[i] += v[i, k] * part / a[k, k]
    return out
