"""Tensor-product natural cubic splines of the same data by SciPy and by one matrix product in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..contest import Array, Run


def gemm(knots: Sequence[Array], u: Array, queries: Array, out: Array) -> Run:
    """Cardinal weights (Q × bodies) times data (bodies × nodes), complex numbers as pairs of reals."""
    from scipy.interpolate import CubicSpline

    cardinal = [CubicSpline(axis, np.eye(len(axis)), bc_type="natural") for axis in knots]
    reals = np.ascontiguousarray(u).view(u.real.dtype).reshape(len(knots[0]) * len(knots[1]), -1)
    target = out.view(reals.dtype).reshape(len(out), -1)

    def run() -> Array:
        first, second = (spline(queries[:, j]) for j, spline in enumerate(cardinal))
        weights = (first[:, :, None] * second[:, None, :]).reshape(len(queries), -1).astype(reals.dtype)
        np.matmul(weights, reals, out=target)
        return out

    return run


def per_query(knots: Sequence[Array], u: Array, queries: Array, out: Array) -> Run:
    """The spline along the first axis is kept; the one along the second depends on the query and is made for it."""
    from scipy.interpolate import CubicSpline

    along_first = CubicSpline(knots[0], u.view(u.real.dtype).reshape(len(knots[0]), -1), bc_type="natural")
    target = out.view(u.real.dtype).reshape(len(out), -1)

    def run() -> Array:
        for row, (first, second) in zip(target, queries, strict=True):
            data = along_first(first).reshape(len(knots[1]), -1)
            row[...] = CubicSpline(knots[1], data, bc_type="natural")(second)
        return out

    return run


def tensor_b_spline(knots: Sequence[Array], u: Array, queries: Array, out: Array) -> Run:
    """B-spline coefficients kept, all queries in one call: SciPy's own way to a tensor-product spline."""
    from scipy.interpolate import NdBSpline, make_interp_spline

    coefficients = u.view(u.real.dtype).reshape(len(knots[0]), len(knots[1]), -1).astype(np.float64)
    vectors = []
    for axis, points in enumerate(knots):
        along = make_interp_spline(points, coefficients, k=3, bc_type="natural", axis=axis)
        vectors.append(along.t)
        # Whatever the axis, SciPy keeps the interpolated one first.
        coefficients = np.moveaxis(along.c, 0, axis)
    spline = NdBSpline(tuple(vectors), np.ascontiguousarray(coefficients), 3)
    target = out.view(u.real.dtype).reshape(len(out), -1)

    def run() -> Array:
        target[...] = spline(queries)
        return out

    return run
