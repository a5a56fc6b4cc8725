"""A training set: a table in any order of rows as a full tensor grid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ShapeError, TableError
from .far_field import Body

# Offending grid points listed in an error before it is cut short.
LISTED = 10


def tensor_order(
    lambdas: ArrayLike, names: Sequence[str] | None = None
) -> tuple[list[NDArray[np.float64]], NDArray[np.intp]]:
    """Knots per characteristic value, and which row of the table holds each grid point in C order.

    Parameters
    ----------
    lambdas : array_like, shape (rows, M)
        Each row is a grid point; values on one axis are equal only when they are the same float.
    names : sequence of str, optional
        What the characteristic values are called in errors.

    Raises
    ------
    TableError
        Listing the grid points that are missing or there more than once.
    """
    table = arguments.real_array("lambdas", lambdas, np.float64)
    if table.ndim != 2 or 0 in table.shape:
        raise ShapeError("lambdas", f"has shape {table.shape}", "give (rows, M), at least one of each")
    knots, places = zip(*(np.unique(column, return_inverse=True) for column in table.T), strict=True)
    shape = tuple(len(axis) for axis in knots)
    size = int(np.prod(shape, dtype=np.int64))
    if size > len(table) * 2 + LISTED:
        # A column of all-different values (noise in the last digit) would ask for a grid of astronomic size.
        counts = " × ".join(map(str, shape))
        raise TableError(
            "lambdas", f"has {len(table)} rows for a grid of {counts} distinct values", "give every combination once"
        )
    flat = np.ravel_multi_index(places, shape)
    count = np.bincount(flat, minlength=size)
    labels = list(names) if names is not None else [f"lambda_{j + 1}" for j in range(len(shape))]
    problems = [
        f"{len(points)} grid points are {what}: {_listed(points, knots, shape, labels)}"
        for what, points in (("missing", np.flatnonzero(count == 0)), ("repeated", np.flatnonzero(count > 1)))
        if len(points)
    ]
    if problems:
        raise TableError("lambdas", "; ".join(problems), "give every combination exactly once")
    return list(knots), np.argsort(flat)


def _listed(
    points: NDArray[np.intp], knots: Sequence[NDArray[np.float64]], shape: tuple[int, ...], names: Sequence[str]
) -> str:
    texts = []
    for point in points[:LISTED]:
        index = np.unravel_index(point, shape)
        texts.append("(" + ", ".join(f"{n}={k[i]:g}" for n, k, i in zip(names, knots, index, strict=True)) + ")")
    more = f", … {len(points) - LISTED} more" if len(points) > LISTED else ""
    return ", ".join(texts) + more


@dataclass(frozen=True)
class Rows:
    """Bodies of a table in another order, as often as they are asked for."""

    bodies: Sequence[Body]
    order: NDArray[np.intp]

    def __iter__(self) -> Iterator[Body]:
        return (self.bodies[row] for row in self.order)


def in_grid_order(name: str, rows: ArrayLike, order: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[Any]:
    """Rows of a table in C order of the grid, its axes in front."""
    array = np.asarray(rows)
    if array.ndim == 0 or len(array) != len(order):
        raise ShapeError(name, f"has shape {array.shape}", f"give {len(order)} rows, one per row of lambdas")
    return array[order].reshape(*shape, *array.shape[1:])
