"""The prefilter: from data at the knots to B-spline coefficients, by the interpolation and end conditions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bases import SUPPORT, Integers, Reals

BOUNDARIES = ("natural", "not-a-knot", "clamped")

# Temporaries of the prefilter stay near this size however many nodes the data have.
BLOCK_BYTES = 64 * 2**20

Basis = Callable[[Reals, Integers, Reals, int], Reals]


def prefilter_matrix(basis: Basis, knots: Reals, boundary: str) -> Reals:
    """P of shape (k+2, k): the coefficients of the spline through data y are P y.

    P solves k interpolation conditions and one condition at each end. A dense inverse is meant: k is the number
    of training bodies along one axis, and P times the data is then one matrix product.
    """
    count = len(knots)
    conditions = np.zeros((count + 2, count + 2))
    cells = np.minimum(np.arange(count), count - 2)
    at_knots = basis(knots, cells, knots, 0)
    for row, cell in enumerate(cells):
        conditions[row + 1, cell : cell + SUPPORT] = at_knots[row]
    first, last = _end_conditions(boundary, count)
    for row, (derivative, parts) in ((0, first), (-1, last)):
        for cell, knot, sign in parts:
            piece = basis(knots, np.array([cell]), knots[[knot]], derivative)
            conditions[row, cell : cell + SUPPORT] += sign * piece[0]
        # Derivatives carry the unit of λ; without it all rows weigh the same.
        conditions[row] /= np.abs(conditions[row]).max()
    return np.asarray(np.linalg.solve(conditions, np.eye(count + 2)[:, 1:-1]), dtype=np.float64)


Condition = tuple[int, tuple[tuple[int, int, int], ...]]


def _end_conditions(boundary: str, count: int) -> tuple[Condition, Condition]:
    """First and last condition as (derivative, ((cell, knot, sign), ...)): the signed sum there is 0."""
    last = count - 2
    if boundary == "clamped":
        return (1, ((0, 0, 1),)), (1, ((last, -1, 1),))
    if boundary == "natural" or count == 2:  # not-a-knot through two knots means the straight line
        return (2, ((0, 0, 1),)), (2, ((last, -1, 1),))
    if count == 3:  # both not-a-knot conditions would be the same one; the parabola is meant
        return (3, ((0, 0, 1),)), (3, ((last, -1, 1),))
    return (3, ((1, 1, 1), (0, 1, -1))), (3, ((last, -2, 1), (last - 1, -2, -1)))


def apply_matrices(matrices: Sequence[Reals | None], values: NDArray[Any]) -> NDArray[Any]:
    """Every axis of (n_1, .., n_M, K) values times its matrix; None leaves an axis alone.

    Computed in float64 on blocks of the last axis and rounded once, to the dtype of the values (integers to
    float64). With nothing to do the values themselves are returned.
    """
    if all(matrix is None for matrix in matrices):
        return values
    if values.dtype.kind not in "fc":
        values = values.astype(np.float64)
    parts = np.ascontiguousarray(values)
    parts = parts.view(parts.real.dtype)  # complex numbers as pairs of reals: the matrices are real
    sizes = [n if matrix is None else len(matrix) for n, matrix in zip(parts.shape, matrices, strict=False)]
    result = np.empty((*sizes, parts.shape[-1]), dtype=parts.dtype)
    width = max(1, BLOCK_BYTES // (8 * math.prod(sizes)))
    for start in range(0, parts.shape[-1], width):
        block = parts[..., start : start + width].astype(np.float64)
        for axis, matrix in enumerate(matrices):
            if matrix is not None:
                block = np.moveaxis(np.tensordot(matrix, block, axes=(1, axis)), 0, axis)
        result[..., start : start + width] = block
    return result.view(values.dtype)
