"""Characteristic values → fields: a model's prediction and synthesis on one grid, batch by batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .backends.base import Backend
from .errors import ArgumentError
from .geometry import Frame, Grid
from .nodes import FourierLattice
from .synthesis import SynthesisPlan, Window, plan_synthesis

if TYPE_CHECKING:
    from .model import ShapeModel


class FieldPlan:
    """Fields of a model's bodies on a fixed grid; made by `ShapeModel.plan_fields`.

    A model without frames has one synthesis plan for all its bodies. Where bodies have frames of their own, the axis
    matrices are new for every batch, and so is the plan: the last one is as small as the last batch.

    Attributes
    ----------
    grid : Grid
        Where the fields are wanted.
    batch : int
        Most bodies of one call.
    device : str
        What the synthesis runs on.
    """

    def __init__(
        self, model: ShapeModel, grid: Grid, batch: int, window: Window | None, backend: str | Backend | None
    ) -> None:
        if not isinstance(model.nodes, FourierLattice):
            raise ArgumentError("model", "is over scattered nodes", "fit on a FourierLattice to generate bodies")
        self._model = model
        self._lattice = model.nodes
        self._options: dict[str, Any] = {"window": window, "dtype": model.dtype, "backend": backend}
        self.grid = grid
        self.batch = arguments.count("batch", batch)
        # With frames this one is never applied: it finds what is wrong with the grid before the first body is made.
        first = self._plan(1 if model.framed else self.batch, None)
        self._shared = None if model.framed else first
        self.device = first.device

    def _plan(self, batch: int, frames: list[Frame] | None) -> SynthesisPlan:
        return plan_synthesis(self._lattice, self.grid, batch=batch, frame=frames, **self._options)

    def apply(
        self, lambdas: ArrayLike, extrapolate: Literal["linear"] | None = None, *, out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Predict and synthesise.

        Parameters
        ----------
        lambdas : array_like, shape (Q, M), 1 ≤ Q ≤ batch
            Characteristic values of each query.
        extrapolate : "linear", optional
            As in `ShapeModel.predict`.
        out : array, shape (Q, *grid.shape), optional
            Filled and returned: C-contiguous, real, of the model's precision.

        Returns
        -------
        array, shape (Q, *grid.shape), real
        """
        queries = np.atleast_2d(arguments.real_array("lambdas", lambdas, np.float64))
        if len(queries) > self.batch:
            raise ArgumentError("lambdas", f"has {len(queries)} queries", f"the plan takes {self.batch} at once")
        plan = self._shared
        if plan is None:
            centres, scales = self._model.frames(queries, extrapolate)
            frames = [Frame(c, s) for c, s in zip(centres.tolist(), scales.tolist(), strict=True)]
            plan = self._plan(len(frames), frames)
        return plan.apply(self._model.predict(queries, extrapolate), out=out, check=False)
