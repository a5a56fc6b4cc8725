"""Tensor products of axes: coefficients of a whole grid of data, and the terms of each query's sum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import arguments
from ..errors import ArgumentError, DtypeError, ShapeError
from .axis import Extrapolate, SplineAxis
from .coefficients import apply_matrices

# Twelve bytes a term (int32 column, float64 weight): what one call may return before it asks for fewer queries.
TERM_BYTES = 12
TERM_LIMIT_BYTES = 2**31


def prefilter(axes: Sequence[SplineAxis], values: ArrayLike) -> NDArray[Any]:
    """Coefficients from data on the tensor grid of the axes' knots.

    Computed in float64 on blocks of nodes and rounded once to the dtype of the values (integers to float64);
    memory beyond values and result is bounded. Where all axes are cardinal the values themselves are returned.
    Nodes do not mix: a NaN spoils its own node only.

    Parameters
    ----------
    axes : sequence of SplineAxis, length M
    values : array_like, shape (k_1, .., k_M, K)
        Real or complex data, k_j knots along axis j.

    Returns
    -------
    array, shape (size_1, .., size_M, K)
    """
    array = np.asarray(values)
    knots = tuple(len(axis.knots) for axis in axes)
    if array.ndim != len(axes) + 1 or array.shape[:-1] != knots:
        raise ShapeError("values", f"has shape {array.shape}", f"give ({', '.join(map(str, knots))}, K)")
    if array.dtype.kind not in "fciub":
        raise DtypeError("values", f"has dtype {array.dtype}", "give real or complex values")
    return apply_matrices([axis.prefilter_matrix for axis in axes], array)


def tensor_terms(
    axes: Sequence[SplineAxis],
    lambdas: ArrayLike,
    extrapolate: Extrapolate = None,
    derivative_axis: int | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The terms of T(Λ_q) = Σ_t weights[q, t] c[columns[q, t]], c being the coefficients in C order.

    The weight of a coefficient is the product of its weights along the axes. A query's terms do not depend on the
    other queries: they may be asked for in pieces. They take 12·Q·T bytes, T = Π support; beyond 2 GiB the call is
    refused.

    Parameters
    ----------
    axes : sequence of SplineAxis, length M
    lambdas : array_like, shape (Q, M)
        Characteristic values of the queries.
    extrapolate : "linear", optional
        Outside the knots: the tangent, axis by axis.
    derivative_axis : int, optional
        Terms of ∂T/∂λ_j for this axis j instead.

    Returns
    -------
    columns : int32, shape (Q, T)
    weights : float64, shape (Q, T)

    Raises
    ------
    QueryRangeError
        A query outside the knots without `extrapolate`.
    """
    points = arguments.real_array("lambdas", lambdas, np.float64)
    if points.ndim != 2 or points.shape[1] != len(axes):
        raise ShapeError("lambdas", f"has shape {points.shape}", f"give (Q, {len(axes)})")
    if derivative_axis is not None and derivative_axis not in range(len(axes)):
        raise ArgumentError("derivative_axis", f"is {derivative_axis!r}", f"give 0..{len(axes) - 1}")
    _require_room(axes, len(points))
    columns = np.zeros((len(points), 1), dtype=np.int32)
    weights = np.ones((len(points), 1))
    for j, axis in enumerate(axes):
        starts, along = axis.weights(points[:, j], derivative=1 if j == derivative_axis else 0, extrapolate=extrapolate)
        index = (starts[:, None] + np.arange(axis.support)).astype(np.int32)
        columns = (columns[:, :, None] * np.int32(axis.size) + index[:, None, :]).reshape(len(points), -1)
        weights = (weights[:, :, None] * along[:, None, :]).reshape(len(points), -1)
    return columns, weights


def _require_room(axes: Sequence[SplineAxis], queries: int) -> None:
    if math.prod(axis.size for axis in axes) > np.iinfo(np.int32).max:
        sizes = " × ".join(str(axis.size) for axis in axes)
        raise ArgumentError("axes", f"make a grid of {sizes} coefficients", "give fewer than 2^31")
    per_query = TERM_BYTES * math.prod(axis.support for axis in axes)
    if queries * per_query > TERM_LIMIT_BYTES:
        raise ArgumentError(
            "lambdas",
            f"holds {queries} queries of {per_query} bytes of terms each",
            f"give at most {TERM_LIMIT_BYTES // per_query} queries at a time",
        )
