"""The learning model: tensor-product cubic splines of shape generators over characteristic values.

T_Z(Λ) interpolates the generators of a training grid, node by node; it is linear in them and minimises the empirical
error of the training set at zero. Source: J. Li, H. Liu, W.-Y. Tsui, X. Wang, "An inverse scattering approach for
geometric body generation: a machine learning perspective" (2020), section 4.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments, backends, batches, splines
from .backends.base import Backend, SplinePlan, SplineSpec
from .errors import ArgumentError, DtypeError, ShapeError
from .far_field import Body
from .geometry import Grid
from .nodes import FourierLattice, Nodes, ScatteredNodes
from .synthesis import Window, plan_synthesis
from .training_set import body_generators, tensor_order

Boundary = Literal["natural", "not-a-knot", "clamped"]
Basis = Literal["auto", "cox-de-boor", "uniform"]

# Queries whose spline weights are held at a time: 4^M or more numbers each, small beside the predictions themselves.
QUERIES_AT_ONCE = 1024


class ShapeModel:
    """Shape generators over characteristic values; made by `fit`, `fit_bodies`, `from_table` or `load`.

    Attributes
    ----------
    axes : tuple of SplineAxis
        One per characteristic value: knots, boundary condition, basis.
    names : tuple of str
        What the characteristic values are called, in errors and tables.
    nodes : FourierLattice or ScatteredNodes
        Where the generators are known.
    dtype : dtype
        complex64 or complex128.
    device : str
        What `predict` runs on.
    """

    def __init__(
        self,
        axes: Sequence[splines.SplineAxis],
        coefficients: NDArray[Any],
        nodes: Nodes,
        backend: str | Backend | None = None,
    ) -> None:
        """From prefiltered coefficients, shape (C_1, .., C_M, *nodes.shape); callers want `fit`."""
        self.axes = tuple(axes)
        self.nodes = nodes
        self.coefficients = np.ascontiguousarray(coefficients)
        self.coefficients.setflags(write=False)
        self._backend = backends.get(backend, operation="spline_contract")
        self._requested = backend
        self.device = self._backend.info.label

    @property
    def names(self) -> tuple[str, ...]:
        """What the characteristic values are called."""
        return tuple(axis.name for axis in self.axes)

    @property
    def knots(self) -> tuple[NDArray[np.float64], ...]:
        """Knots per characteristic value, strictly increasing."""
        return tuple(axis.knots for axis in self.axes)

    @property
    def dtype(self) -> np.dtype[Any]:
        """complex64 or complex128."""
        return self.coefficients.dtype

    @classmethod
    def fit(
        cls,
        knots: Sequence[ArrayLike],
        u: ArrayLike,
        nodes: Nodes,
        *,
        boundary: Boundary = "natural",
        basis: Basis = "auto",
        names: Sequence[str] | None = None,
        backend: str | Backend | None = None,
    ) -> ShapeModel:
        """Fit the generators of a full training grid.

        Parameters
        ----------
        knots : sequence of M array_like, each (n_j,)
            Strictly increasing characteristic values, at least two per axis.
        u : array_like, shape (n_1, .., n_M, *nodes.shape), complex64 or complex128
            One shape generator per grid point; its precision is the model's.
        nodes : FourierLattice or ScatteredNodes
            Where the generators are known.
        boundary : "natural", "not-a-knot" or "clamped"
            Natural: second derivative 0 at both ends of every axis; the others as SciPy's CubicSpline defines them.
        basis : "auto", "cox-de-boor" or "uniform"
            Model I, any knots; or Model II, equidistant ones. Auto takes Model II where it applies. Same spline.
        names : sequence of str, optional
            What the characteristic values are called; "lambda_1", .. by default.
        backend : str, optional
            See `accel_shapegen.backends.get`.
        """
        axes = _axes(knots, boundary, basis, names)
        if not isinstance(nodes, (FourierLattice, ScatteredNodes)):
            raise DtypeError("nodes", f"is a {type(nodes).__name__}", "give a FourierLattice or ScatteredNodes")
        generators = np.asarray(u)
        if generators.dtype.name not in arguments.REAL_OF:
            raise DtypeError("u", f"has dtype {generators.dtype}", "give complex64 or complex128 values")
        shape = (*(len(axis.knots) for axis in axes), *nodes.shape)
        if generators.shape != shape:
            raise ShapeError("u", f"has shape {generators.shape}", f"give {shape}: the knots, then the nodes")
        arguments.require_finite("u", generators)
        generators = generators.astype(generators.dtype.newbyteorder("="), copy=False)
        coefficients = splines.prefilter(axes, np.ascontiguousarray(generators).reshape(*shape[: len(axes)], -1))
        if np.may_share_memory(coefficients, generators):
            # The model freezes its coefficients; the caller's array stays the caller's.
            coefficients = coefficients.copy()
        return cls(axes, coefficients.reshape(*(axis.size for axis in axes), *nodes.shape), nodes, backend)

    @classmethod
    def fit_bodies(
        cls,
        knots: Sequence[ArrayLike],
        bodies: Iterable[Body],
        nodes: Nodes,
        *,
        eps: float = 1e-6,
        dtype: Any = "complex64",
        boundary: Boundary = "natural",
        basis: Basis = "auto",
        names: Sequence[str] | None = None,
        backend: str | Backend | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> ShapeModel:
        """Transform the bodies of a full training grid and fit their generators.

        Parameters
        ----------
        bodies : iterable of VoxelGrid or Polygons
            One body per grid point, C order (the last characteristic value runs fastest); a generator is consumed
            body by body, so that they need not be in memory together.
        eps, dtype, backend
            As in `far_field`.
        progress : callable, optional
            Called as progress(done, total) after each body.
        """
        axes = _axes(knots, boundary, basis, names)
        total = math.prod(len(axis.knots) for axis in axes)
        precision = arguments.complex_dtype("dtype", dtype)
        u = body_generators(bodies, total, nodes, eps=eps, dtype=precision, backend=backend, progress=progress)
        shape = tuple(len(axis.knots) for axis in axes)
        return cls.fit(
            knots, u.reshape(*shape, *nodes.shape), nodes, boundary=boundary, basis=basis, names=names, backend=backend
        )

    @classmethod
    def from_table(
        cls,
        lambdas: ArrayLike,
        bodies_or_u: Sequence[Body] | NDArray[Any],
        nodes: Nodes,
        *,
        names: Sequence[str] | None = None,
        **options: Any,
    ) -> ShapeModel:
        """Fit a table of (Λ, body) or (Λ, generator) rows that cover a full tensor grid, in any order.

        Parameters
        ----------
        lambdas : array_like, shape (rows, M)
            Characteristic values of each row.
        bodies_or_u : sequence of bodies, or array of shape (rows, *nodes.shape)
            What `fit_bodies` or `fit` takes, row by row.
        options
            Passed on to `fit_bodies` or `fit`.

        Raises
        ------
        TableError
            Listing the grid points that are missing or there twice.
        """
        knots, order = tensor_order(lambdas, names)
        if len(bodies_or_u) != len(order):
            raise ShapeError(
                "bodies_or_u", f"has {len(bodies_or_u)} rows", f"give {len(order)}, one per row of lambdas"
            )
        if isinstance(bodies_or_u, np.ndarray):
            shape = tuple(len(axis) for axis in knots)
            u = bodies_or_u[order].reshape(*shape, *bodies_or_u.shape[1:])
            return cls.fit(knots, u, nodes, names=names, **options)
        return cls.fit_bodies(knots, (bodies_or_u[row] for row in order), nodes, names=names, **options)

    @cached_property
    def _plan(self) -> SplinePlan:
        rows = math.prod(axis.size for axis in self.axes)
        reals = self.coefficients.reshape(rows, -1).view(arguments.real_dtype(self.dtype))
        return self._backend.plan_spline_contract(SplineSpec(reals, reals.dtype))

    def predict(
        self,
        lambdas: ArrayLike,
        extrapolate: Literal["linear"] | None = None,
        *,
        derivative: int | None = None,
        out: NDArray[Any] | None = None,
    ) -> NDArray[Any]:
        """T_Z(Λ): the generators of bodies that were in no training set.

        Parameters
        ----------
        lambdas : array_like, shape (Q, M) or (M,)
            Characteristic values of each query.
        extrapolate : "linear", optional
            Continue along the tangent, axis by axis, outside the training range; otherwise such a query is an error.
        derivative : int, optional
            The derivative of T_Z in this characteristic value (an axis, from 0) instead of T_Z.
        out : array, shape (Q, *nodes.shape), optional
            Filled and returned: C-contiguous, of the model's dtype.

        Returns
        -------
        array, shape (Q, *nodes.shape), or (*nodes.shape,) for one query of shape (M,)

        Raises
        ------
        QueryRangeError
            Naming the characteristic value, its range and the query.
        """
        queries = self._queries(lambdas)
        result = batches.output(out, (len(queries), *self.nodes.shape), self.dtype)
        reals = arguments.real_dtype(self.dtype)
        rows = result.reshape(len(queries), -1).view(reals)
        for start in range(0, len(queries), QUERIES_AT_ONCE):
            some = slice(start, start + QUERIES_AT_ONCE)
            columns, weights = splines.tensor_terms(self.axes, queries[some], extrapolate, derivative)
            self._plan.forward(columns, weights.astype(reals), out=rows[some])
        return result if np.ndim(lambdas) == 2 else result[0]

    def generate(
        self,
        lambdas: ArrayLike,
        grid: Grid,
        *,
        window: Window | None = None,
        extrapolate: Literal["linear"] | None = None,
        batch: int = batches.ONE_SHOT_BATCH,
        out: NDArray[Any] | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> NDArray[Any]:
        """Predict and synthesise: fields whose level 1/2 is the surface of the predicted bodies.

        Parameters
        ----------
        lambdas : array_like, shape (Q, M) or (M,)
            Characteristic values of each query.
        grid : Grid
            Where the fields are wanted; 0 outside the lattice's box.
        window : "lanczos" or "fejer", optional
            Spectral window.
        extrapolate : "linear", optional
            As in `predict`.
        batch : int
            Bodies handled at once.
        out : array, shape (Q, *grid.shape), optional
            Filled and returned; may be memory-mapped when fields are many.
        progress : callable, optional
            Called as progress(done, total) after each batch.

        Returns
        -------
        array, shape (Q, *grid.shape) or (*grid.shape,), real
        """
        if not isinstance(self.nodes, FourierLattice):
            raise ArgumentError("model", "is over scattered nodes", "fit on a FourierLattice to generate bodies")
        queries = self._queries(lambdas)
        batch = min(arguments.count("batch", batch), len(queries))
        plan = plan_synthesis(self.nodes, grid, batch=batch, window=window, dtype=self.dtype, backend=self._requested)
        result = batches.output(out, (len(queries), *grid.shape), arguments.real_dtype(self.dtype))
        # All queries are checked before the first body is made.
        for start in range(0, len(queries), QUERIES_AT_ONCE):
            splines.tensor_terms(self.axes, queries[start : start + QUERIES_AT_ONCE], extrapolate)
        for start in range(0, len(queries), batch):
            some = slice(start, start + batch)
            plan.apply(self.predict(queries[some], extrapolate), out=result[some], check=False)
            if progress is not None:
                progress(min(start + batch, len(queries)), len(queries))
        return result if np.ndim(lambdas) == 2 else result[0]

    def _queries(self, lambdas: ArrayLike) -> NDArray[np.float64]:
        queries = arguments.real_array("lambdas", lambdas, np.float64)
        if queries.ndim == 1:
            queries = queries[None]
        if queries.ndim != 2 or queries.shape[1] != len(self.axes) or not len(queries):
            raise ShapeError(
                "lambdas", f"has shape {np.shape(lambdas)}", f"give (Q, {len(self.axes)}): " + ", ".join(self.names)
            )
        return queries

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the model to one npz file with a format version and a checksum over all of it; see `load`."""
        from . import model_file

        return model_file.write(self, Path(path))

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, backend: str | Backend | None = None) -> ShapeModel:
        """Read a model that `save` wrote; it answers with the same bits on the same device.

        Raises
        ------
        MissingFileError, ModelFileError
            Where there is no file, or any byte of it is not as it was written. Nothing is ever unpickled.
        """
        from . import model_file

        return cls(*model_file.read(Path(path)), backend=backend)


def _axes(
    knots: Sequence[ArrayLike], boundary: Boundary, basis: Basis, names: Sequence[str] | None
) -> tuple[splines.SplineAxis, ...]:
    if (isinstance(knots, np.ndarray) and knots.ndim == 1) or not len(knots):
        raise ShapeError("knots", f"is one {type(knots).__name__}", "give a sequence of arrays, one per axis")
    if names is None:
        names = [f"lambda_{j + 1}" for j in range(len(knots))]
    if len(names) != len(knots):
        raise ShapeError("names", f"has {len(names)} entries", f"give {len(knots)}, one per axis")
    return tuple(
        splines.SplineAxis(axis, boundary=boundary, basis=basis, name=name)
        for axis, name in zip(knots, names, strict=True)
    )
