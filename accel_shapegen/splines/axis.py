"""One characteristic axis: its knots, end conditions and basis, and the weights of its spline at queries."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import arguments
from ..errors import ArgumentError, KnotError, QueryRangeError, ShapeError
from . import bases
from .coefficients import BOUNDARIES, apply_matrices, prefilter_matrix

# Up to here an axis keeps the data as coefficients. A query then touches at most twice as many of them as the four of
# the local form, and in exchange there is nothing to prefilter, the data come back to the bit at the knots, and all
# queries share their coefficients, so that the contraction is one dense matrix product.
CARDINAL_KNOTS = 8
# A gap this much smaller than the one beside it is a repeated knot with noise in its last digits. Slopes across it
# divide the data's rounding by it, and complex64 data have no digit left at about 1e-7.
LEAST_GAP = 1e-6

Extrapolate = Literal["linear"] | None


@dataclass(frozen=True, eq=False)
class SplineAxis:
    """The cubic spline through data at the knots of one axis, S(λ) = Σ_i w_i(λ) c_i.

    Parameters
    ----------
    knots : array_like, shape (k,)
        Characteristic values, k ≥ 2, finite, strictly increasing.
    boundary : str
        "natural" (S'' = 0 at both ends), "not-a-knot" (the first two cells share one cubic, so do the last two;
        two knots give the straight line, three the parabola) or "clamped" (S' = 0 at both ends).
    basis : str
        "cox-de-boor" is Model I of Li, Liu, Tsui and Wang (2020), "uniform" their Model II, which needs equidistant
        knots; "auto" takes Model II where it can. They span the same splines and agree to rounding.
    name : str
        What messages call the axis.
    form : str
        "cardinal": the coefficients are the data, the support is all k knots, and at a knot the weights are exactly
        0 and 1. "local": k+2 prefiltered B-spline coefficients, support 4. "auto": cardinal up to
        `CARDINAL_KNOTS` knots.

    Raises
    ------
    KnotError
        Too few, unsorted, repeated or non-finite knots, or knots not equidistant where they must be.
    """

    knots: NDArray[np.float64] = field(repr=False)
    boundary: str = "natural"
    basis: str = "auto"
    name: str = "axis"
    form: str = "auto"

    def __init__(
        self,
        knots: ArrayLike,
        boundary: str = "natural",
        basis: str = "auto",
        *,
        name: str = "axis",
        form: str = "auto",
    ) -> None:
        values = _checked_knots(f"knots of {name}", knots)
        arguments.choice("boundary", boundary, BOUNDARIES)
        arguments.choice("basis", basis, ("auto", "uniform", "cox-de-boor"))
        arguments.choice("form", form, ("auto", "cardinal", "local"))
        regular = bases.equidistant(values)
        if basis == "uniform" and not regular:
            raise KnotError(f"knots of {name}", "are not equidistant", 'space them evenly, or pass basis="cox-de-boor"')
        if basis == "auto":
            basis = "uniform" if regular else "cox-de-boor"
        if form == "auto":
            form = "cardinal" if len(values) <= CARDINAL_KNOTS else "local"
        settled = {"knots": values, "boundary": boundary, "basis": basis, "name": name, "form": form}
        for attribute, value in settled.items():
            object.__setattr__(self, attribute, value)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.knots) + (0 if self.form == "cardinal" else 2)

    @property
    def support(self) -> int:
        """Number of consecutive coefficients that a query takes part of."""
        return self.size if self.form == "cardinal" else bases.SUPPORT

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """P, shape (k+2, k): data at the knots to B-spline coefficients."""
        basis = bases.uniform if self.basis == "uniform" else bases.cox_de_boor
        matrix = prefilter_matrix(basis, self.knots, self.boundary)
        matrix.setflags(write=False)
        return matrix

    @property
    def prefilter_matrix(self) -> NDArray[np.float64] | None:
        """What data are multiplied with to become coefficients; None where they are the coefficients."""
        return None if self.form == "cardinal" else self.matrix

    def prefilter(self, data: ArrayLike, axis: int = 0) -> NDArray[Any]:
        """Coefficients from data at the knots, along one axis of an array.

        Computed in float64 and rounded once to the dtype of the data (integers to float64). Memory beyond data and
        result is bounded.

        Parameters
        ----------
        data : array_like, shape (.., k, ..)
            Real or complex.

        Returns
        -------
        array, shape (.., size, ..)
        """
        values = np.asarray(data)
        if not -values.ndim <= axis < values.ndim or values.shape[axis] != len(self.knots):
            raise ShapeError("data", f"has shape {values.shape}", f"give {len(self.knots)} entries along axis {axis}")
        if self.prefilter_matrix is None:
            return values
        moved = np.moveaxis(values, axis, 0)
        flat = apply_matrices([self.prefilter_matrix], moved.reshape(len(self.knots), -1))
        return np.moveaxis(flat.reshape(self.size, *moved.shape[1:]), 0, axis)

    def weights(
        self, lambdas: ArrayLike, derivative: Literal[0, 1] = 0, extrapolate: Extrapolate = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """S(λ_q) = Σ_j weights[q, j] c[starts[q] + j], or S'(λ_q) with `derivative=1`.

        Parameters
        ----------
        lambdas : array_like, shape (Q,)
            Queries, within the first and last knot.
        derivative : 0 or 1
        extrapolate : "linear", optional
            Outside the knots: the tangent at the nearer end.

        Returns
        -------
        starts : int64, shape (Q,)
        weights : float64, shape (Q, support)

        Raises
        ------
        QueryRangeError
            A query outside the knots without `extrapolate`.
        """
        points = arguments.real_array("lambdas", lambdas, np.float64)
        if points.ndim != 1:
            raise ShapeError("lambdas", f"has shape {points.shape}", "give (Q,)")
        if derivative not in (0, 1):
            raise ArgumentError("derivative", f"is {derivative!r}", "give 0 or 1")
        if extrapolate is not None:
            arguments.choice("extrapolate", extrapolate, ("linear",))
        inside = np.clip(points, self.knots[0], self.knots[-1])
        outside = np.flatnonzero(inside != points)
        if outside.size and extrapolate is None:
            query = outside[0]
            raise QueryRangeError(
                "lambdas",
                f"query {query} has {self.name} {points[query]}, outside [{self.knots[0]}, {self.knots[-1]}]",
                'stay inside or pass extrapolate="linear"',
            )
        starts, values = self._weights(inside, derivative)
        if outside.size and derivative == 0:
            slopes = self._weights(inside[outside], 1)[1]
            values[outside] += (points - inside)[outside, None] * slopes
        return starts, values

    def _weights(self, points: NDArray[np.float64], derivative: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        basis = bases.uniform if self.basis == "uniform" else bases.cox_de_boor
        cells = np.clip(np.searchsorted(self.knots, points, side="right") - 1, 0, len(self.knots) - 2)
        local = basis(self.knots, cells, points, derivative)
        if self.form == "local":
            return cells, local
        cardinal = np.zeros((len(points), self.size))
        for offset in range(bases.SUPPORT):
            cardinal += local[:, offset, None] * self.matrix[cells + offset]
        if derivative == 0:
            # True in exact arithmetic; rounding would turn data into nearly the data.
            nearest = cells + (points == self.knots[-1])
            at_knot = np.flatnonzero(points == self.knots[nearest])
            cardinal[at_knot] = np.eye(self.size)[nearest[at_knot]]
        return np.zeros(len(points), dtype=np.int64), cardinal


def _checked_knots(subject: str, knots: ArrayLike) -> NDArray[np.float64]:
    given = np.asarray(knots)
    values = arguments.real_array(subject, given, np.float64, check=False).copy()
    if values.ndim != 1 or len(values) < 2:
        raise KnotError(subject, f"have shape {values.shape}", "give at least two in a sequence")
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        raise KnotError(subject, f"hold {values[wrong[0]]} at index {wrong[0]}", "give finite values")
    wrong = np.flatnonzero(np.diff(values) <= 0)
    if wrong.size:
        i = int(wrong[0]) + 1
        raise KnotError(
            subject, f"hold {values[i]} at index {i} after {values[i - 1]}", "give strictly increasing values"
        )
    gaps = np.diff(values)
    beside = np.maximum(np.append(gaps[1:], 0), np.insert(gaps[:-1], 0, 0))
    wrong = np.flatnonzero(gaps < LEAST_GAP * beside)
    if wrong.size:
        i = int(wrong[0])
        raise KnotError(
            subject,
            f"hold {float(values[i])!r} and {float(values[i + 1])!r}, nearly equal, at index {i}",
            "merge them: rounding of the data would be divided by their distance",
        )
    values.setflags(write=False)
    return values
