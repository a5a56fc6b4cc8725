"""The learning model: tensor-product cubic splines of shape generators over characteristic values.

T_Z(Λ) interpolates the generators of a training grid, node by node; it is linear in them and minimises the empirical
error of the training set at zero. Source: J. Li, H. Liu, W.-Y. Tsui, X. Wang, "An inverse scattering approach for
geometric body generation: a machine learning perspective" (2020), section 4.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments, backends, batches, splines
from .backends.base import Backend, SplinePlan, SplineSpec
from .body_generators import body_generators, checked_bounds, checked_frames
from .errors import ArgumentError, DtypeError, ShapeError
from .far_field import Body
from .fields import FieldPlan
from .frames import RULES, Rule
from .geometry import Box, Grid
from .nodes import FourierLattice, Nodes, require_nodes
from .synthesis import Window
from .training_set import Rows, in_grid_order, tensor_order

if TYPE_CHECKING:
    from .adequacy import Adequacy

Boundary = Literal["natural", "not-a-knot", "clamped"]
Basis = Literal["auto", "cox-de-boor", "uniform"]

Floats = NDArray[np.float64]

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
    bounds : float64, shape (n_1, .., n_M, 2, dim), or None
        Bounding boxes [m] of the training bodies; None for a model of generators that came without bodies.
    device : str
        What `predict` runs on.
    """

    def __init__(
        self,
        axes: Sequence[splines.SplineAxis],
        coefficients: NDArray[Any],
        nodes: Nodes,
        backend: str | Backend | None = None,
        *,
        frame_coefficients: Floats | None = None,
        bounds: Floats | None = None,
    ) -> None:
        """From prefiltered coefficients, shape (C_1, .., C_M, *nodes.shape); callers want `fit`.

        Those of the frames have shape (C_1, .., C_M, 2, dim): centre, then scale.
        """
        self.axes = tuple(axes)
        self.nodes = nodes
        self.coefficients = np.ascontiguousarray(coefficients)
        self.frame_coefficients = frame_coefficients
        self.bounds = bounds
        for array in (self.coefficients, frame_coefficients, bounds):
            if array is not None:
                array.setflags(write=False)
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

    @property
    def framed(self) -> bool:
        """Whether the generators are those of bodies in reference frames."""
        return self.frame_coefficients is not None

    @property
    def grid_points(self) -> Floats:
        """The training grid, shape (n_1 ⋯ n_M, M), C order."""
        return np.stack(np.meshgrid(*self.knots, indexing="ij"), axis=-1).reshape(-1, len(self.axes))

    @cached_property
    def extent(self) -> Box:
        """A box about the origin, in metres, that holds the lattice's box in the frame of every training body.

        It is the lattice's own, or a larger one where frames carry bodies out of that.
        """
        if not isinstance(self.nodes, FourierLattice):
            raise ArgumentError("model", "is over scattered nodes, which have no box", "fit on a FourierLattice")
        sides = np.array(self.nodes.box.lengths)
        centres, scales = self.frames(self.grid_points)
        reach = (2 * np.abs(centres) + scales * sides).max(axis=0)
        # The rounding of centres that are meant to be 0 does not make a box larger.
        return Box(np.where(reach > sides * (1 + 1e-9), reach, sides).tolist())

    @classmethod
    def fit(
        cls,
        knots: Sequence[ArrayLike],
        u: ArrayLike,
        nodes: Nodes,
        *,
        frames: tuple[ArrayLike, ArrayLike] | None = None,
        bounds: ArrayLike | None = None,
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
        frames : (centres, scales), array_like of shape (n_1, .., n_M, dim) each, optional
            c [m] and σ, if the generators are those of bodies in frames, y = (x - c)/σ with no factor |σ|. They are
            interpolated by the same spline.
        bounds : array_like, shape (n_1, .., n_M, 2, dim), optional
            Bounding boxes [m] of the bodies, in x; `adequacy` looks at how they move from body to body.
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
        require_nodes(nodes)
        generators = arguments.plain_array("u", u)
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
        grid = shape[: len(axes)]
        pairs = None if frames is None else splines.prefilter(axes, checked_frames(frames, grid, nodes.dim))
        return cls(
            axes,
            coefficients.reshape(*(axis.size for axis in axes), *nodes.shape),
            nodes,
            backend,
            frame_coefficients=None if pairs is None else pairs.reshape(*pairs.shape[:-1], 2, nodes.dim),
            bounds=None if bounds is None else checked_bounds(bounds, (*grid, 2, nodes.dim)),
        )

    @classmethod
    def fit_bodies(
        cls,
        knots: Sequence[ArrayLike],
        bodies: Iterable[Body],
        nodes: Nodes,
        *,
        frame: Rule | None = None,
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
        bodies : iterable of bodies, as `far_field` takes them
            One body per grid point, C order (the last characteristic value runs fastest). A generator is consumed
            body by body, so that they need not be in memory together - unless there are frames, which need to see
            every body twice: then give something that can be passed through again, or a generator's bodies are kept.
        frame : "height", "bbox", "moments" or callable, optional
            Learn each body in a reference frame y = (x - c)/σ of its own, and the frames by the same spline. Height:
            c is the centre of the bounding box, and one scale for all axes is that of its extent on the last axis;
            bbox: the same centre, each axis by its own extent; moments: centroid, and standard deviation per axis. A
            callable gets the body and gives (centre, size) or a Frame. Scales are σ_i = s_i / max_i s_i, per axis.
        eps, dtype, backend
            As in `far_field`.
        progress : callable, optional
            Called as progress(done, total) after each body; with frames, each body counts twice.

        Raises
        ------
        OutsideBoxError
            Naming the body that reaches out of the lattice's box (in its frame, if there are frames).
        """
        axes = _axes(knots, boundary, basis, names)
        if frame is not None and not callable(frame):
            arguments.choice("frame", frame, RULES)
        require_nodes(nodes)
        shape = tuple(len(axis.knots) for axis in axes)

        def place(body: int) -> str:
            point = zip(axes, np.unravel_index(body, shape), strict=True)
            return f"bodies[{body}] (" + ", ".join(f"{axis.name}={axis.knots[i]:g}" for axis, i in point) + ")"

        made = body_generators(
            bodies,
            math.prod(shape),
            nodes,
            rule=frame,
            place=place,
            eps=eps,
            dtype=arguments.complex_dtype("dtype", dtype),
            backend=backend,
            progress=progress,
        )
        return cls.fit(
            knots,
            made.u.reshape(*shape, *nodes.shape),
            nodes,
            frames=made.frames_on(shape),
            bounds=made.bounds.reshape(*shape, 2, nodes.dim),
            boundary=boundary,
            basis=basis,
            names=names,
            backend=backend,
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
            Passed on to `fit_bodies` or `fit`; `frames` and `bounds` of the latter are given row by row too.

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
            if options.get("frames") is not None:
                options["frames"] = tuple(in_grid_order("frames", part, order, shape) for part in options["frames"])
            if options.get("bounds") is not None:
                options["bounds"] = in_grid_order("bounds", options["bounds"], order, shape)
            u = in_grid_order("bodies_or_u", bodies_or_u, order, shape)
            return cls.fit(knots, u, nodes, names=names, **options)
        return cls.fit_bodies(knots, Rows(bodies_or_u, order), nodes, names=names, **options)

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

    def frames(
        self, lambdas: ArrayLike, extrapolate: Literal["linear"] | None = None, *, derivative: int | None = None
    ) -> tuple[Floats, Floats]:
        """The reference frames of predicted bodies, by the spline of their generators: y = (x - c)/σ.

        Parameters
        ----------
        lambdas, extrapolate, derivative
            As in `predict`, which gives the generators of the bodies in y.

        Returns
        -------
        centres, scales : float64, shape (Q, dim) each, or (dim,) for one query of shape (M,)
            c [m] and σ. 0 and 1 for a model without frames.

        Raises
        ------
        QueryRangeError
            Naming the characteristic value, its range and the query.
        ArgumentError
            A scale that is not positive, which only a spline far from its data gives.
        """
        queries = self._queries(lambdas)
        result = np.zeros((len(queries), 2, self.nodes.dim))
        for start in range(0, len(queries), QUERIES_AT_ONCE):
            some = slice(start, start + QUERIES_AT_ONCE)
            columns, weights = splines.tensor_terms(self.axes, queries[some], extrapolate, derivative)
            if self.frame_coefficients is not None:
                rows = self.frame_coefficients.reshape(-1, 2, self.nodes.dim)
                result[some] = np.einsum("qt,qtij->qij", weights, rows[columns])
            elif derivative is None:
                result[some, 1] = 1
        if derivative is None and np.any(result[:, 1] <= 0):
            query, axis = (int(i) for i in np.argwhere(result[:, 1] <= 0)[0])
            raise ArgumentError(
                "lambdas",
                f"query {query} has a frame of scale {result[query, 1, axis]:.6g} on axis {axis}",
                "stay nearer to the training range",
            )
        centres, scales = result[:, 0], result[:, 1]
        return (centres, scales) if np.ndim(lambdas) == 2 else (centres[0], scales[0])

    def plan_fields(
        self, grid: Grid, *, batch: int = batches.ONE_SHOT_BATCH, window: Window | None = None
    ) -> FieldPlan:
        """Plan `generate` on one grid, for many calls of up to `batch` queries."""
        return FieldPlan(self, grid, batch, window, self._requested)

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
            Where the fields are wanted, in metres, whatever the frames; 0 outside the lattice's box (with frames: that
            box carried along, c + σ V0).
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
        queries = self._queries(lambdas)
        batch = min(arguments.count("batch", batch), len(queries))
        plan = self.plan_fields(grid, batch=batch, window=window)
        result = batches.output(out, (len(queries), *grid.shape), arguments.real_dtype(self.dtype))
        # All queries are checked before the first body is made.
        self.frames(queries, extrapolate)
        for start in range(0, len(queries), batch):
            some = slice(start, start + batch)
            plan.apply(queries[some], extrapolate, out=result[some])
            if progress is not None:
                progress(min(start + batch, len(queries)), len(queries))
        return result if np.ndim(lambdas) == 2 else result[0]

    def adequacy(self) -> Adequacy:
        """Whether the training set is dense enough to be trusted between its bodies; see `adequacy.assess`.

        Warns
        -----
        AliasingWarning
            Where a face of the bounding box moves, from one body to the next, by more than half the shortest
            wavelength: the phase of the far field then turns by more than half a turn, and no interpolation can tell
            which way.
        """
        from . import adequacy

        report = adequacy.assess(self)
        for text in report.warnings:
            warnings.warn(text, adequacy.AliasingWarning, stacklevel=2)
        return report

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

        return cls(**model_file.read(Path(path)), backend=backend)


def _axes(
    knots: Sequence[ArrayLike], boundary: Boundary, basis: Basis, names: Sequence[str] | None
) -> tuple[splines.SplineAxis, ...]:
    arguments.sequence("knots", knots, "arrays, one per axis")
    if (isinstance(knots, np.ndarray) and knots.ndim == 1) or not len(knots):
        raise ShapeError("knots", f"is one {type(knots).__name__}", "give a sequence of arrays, one per axis")
    if names is None:
        names = [f"lambda_{j + 1}" for j in range(len(knots))]
    if len(arguments.sequence("names", names, "strings")) != len(knots):
        raise ShapeError("names", f"has {len(names)} entries", f"give {len(knots)}, one per axis")
    for j, name in enumerate(names):
        if not isinstance(name, str) or not name.strip() or name in names[:j]:
            raise ArgumentError(f"names[{j}]", f"is {name!r}", "give distinct non-empty strings")
    return tuple(
        splines.SplineAxis(axis, boundary=boundary, basis=basis, name=name)
        for axis, name in zip(knots, names, strict=True)
    )
