"""`mesh_spread` on OpenCL: private grids per work-item, added in a fixed order, then summed along one axis.

The window's weights are polynomials in the place within a cell, one per point that the window sees, as in
A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41 (2019).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from ...errors import ArgumentError
from ...kernel_window import Window
from ..base import MeshSpreadSpec, Surface
from .runtime import Runtime, aligned_empty, output_array

Array = NDArray[Any]

# Two shares of the pieces per core, so that one that is late does not keep the others waiting for long; fewer where
# a share would be too small to pay for clearing and adding its grid.
ITEMS_PER_UNIT = 2
POINTS_PER_ITEM = 4096
MOST_ITEMS = 64
# Of the window's own error: what its polynomials may add.
FIT = 0.1
DEGREES = range(4, 22)


class OpenCLMeshSpreadPlan:
    """`mesh_spread` on one OpenCL device; see `MeshSpreadSpec` for the sum.

    Parameters
    ----------
    runtime : Runtime
        The device's queue and program cache.
    label : str
        What the device is called.
    spec : MeshSpreadSpec
        Grid, windows, rules and real dtype.

    Raises
    ------
    DeviceMemoryError
        The private grids do not fit the device.
    """

    def __init__(self, runtime: Runtime, label: str, spec: MeshSpreadSpec) -> None:
        self.device = label
        self._runtime, self._spec = runtime, spec
        # (u, v, w); in the plane u is a single point.
        self._order = [*(j for j in range(len(spec.shape)) if j != spec.axis), spec.axis]
        self._lanes = 32 // spec.dtype.itemsize
        self._items = min(ITEMS_PER_UNIT * runtime.compute_units, MOST_ITEMS)
        self._set_layout()
        self._set_rules()

    def _set_layout(self) -> None:
        spec, runtime, types = self._spec, self._runtime, cl.cltypes
        windows = [spec.windows[j] for j in self._order]
        flat = 3 - len(windows)
        shape = [1] * flat + [spec.shape[j] for j in self._order]
        strides = [0] * flat + [math.prod(spec.shape[j + 1 :]) for j in self._order]
        widths = [1] * flat + [window.width for window in windows]
        padded = [self._padded(width) for width in widths]
        # The last vector of a window may reach past the last point.
        row = self._padded(shape[2] + padded[2] - widths[2])
        grid = shape[0] * shape[1] * row * spec.dtype.itemsize
        values = math.prod(shape) * spec.dtype.itemsize
        private = self._items * grid
        runtime.require("eps", private + values, max(private, values), "give a larger eps, or smaller bodies or nodes")
        self._grids = runtime.scratch(private)
        self._rows = shape[0]
        self._shape, self._stride = types.make_int4(*shape, row), types.make_int4(*strides, 0)
        real4 = types.make_double4 if spec.dtype.itemsize == 8 else types.make_float4
        self._half = real4(*[0.0] * flat, *(window.width / 2 for window in windows), 0.0)
        fits = [np.ones((1, 1))] * flat + [weight_polynomials(window) for window in windows]
        degree = max(len(fit) for fit in fits) - 1
        tables = [_padded_to(fit, degree + 1, width) for fit, width in zip(fits, padded, strict=True)]
        self._polynomials = runtime.constant(np.concatenate(tables, axis=None).astype(spec.dtype))
        defines = {"WU": widths[0], "WV": widths[1], "DEGREE": degree, "LANES": self._lanes}
        defines |= dict(zip(("PU", "PV", "PW"), padded, strict=True))
        self._kernels = runtime.kernels("mesh_spread", spec.dtype, defines)

    def _set_rules(self) -> None:
        rules = self._spec.rules
        self._counts = np.array([len(rule.weights) for rule in rules])
        ends = np.cumsum(self._counts)
        self._rule_spans = self._runtime.constant(np.stack([ends - self._counts, ends], axis=1).astype(np.int32))
        points = np.zeros((int(ends[-1]), 4))
        # The first corner's coordinate is what the others leave of 1.
        points[:, : rules[0].points.shape[1] - 1] = np.concatenate([rule.points[:, 1:] for rule in rules])
        points[:, 2] = np.concatenate([rule.weights for rule in rules])
        self._rule_points = self._runtime.constant(points.astype(self._spec.dtype))

    def _padded(self, count: int) -> int:
        return -(-count // self._lanes) * self._lanes

    def forward(self, surfaces: Sequence[Surface], out: Array | None = None) -> Array:
        """b surfaces → (b, *shape) real.

        Raises `ArgumentError` where a surface does not lie far enough inside the grid, `ShapeError` or `DtypeError`
        for a wrong `out`.
        """
        out = output_array(out, self._spec.dtype, (len(surfaces), *self._spec.shape))
        runtime = self._runtime
        runtime.require_own_process()
        in_use: list[list[cl.Buffer]] = []  # kernels may work in the arrays behind these until the end
        with runtime.settled():
            pending = []
            for number, surface in enumerate(surfaces):
                target = runtime.output(out[number])
                in_use.append(self._enqueue(number, surface, target))
                if runtime.shares_host_memory:
                    pending.append((target, out[number]))
                else:
                    runtime.fetch(target, out[number])
            for target, home in pending:
                runtime.fetch(target, home)
        return out

    def _enqueue(self, number: int, surface: Surface, target: cl.Buffer) -> list[cl.Buffer]:
        """Both kernels for one body; returns the buffers that they read."""
        runtime = self._runtime
        cell, fraction = self._cells(number, surface.vertices)
        # Kernels read vectors of four: more than NumPy's own alignment is needed.
        pieces = aligned_empty((len(surface.simplices), 4), np.int32)
        corners = surface.simplices.shape[1]
        pieces[:, :corners] = surface.simplices
        pieces[:, corners:3] = surface.simplices[:, :1]
        pieces[:, 3] = surface.rule
        share = self._shares(surface.rule)
        items = len(share) - 1
        strengths = surface.strengths.astype(self._spec.dtype)
        held = [runtime.input(array) for array in (cell, fraction, pieces, strengths, share)]
        with runtime.lock:
            runtime.launch(
                self._kernels["spread"], (items,), *held[:4], self._rule_spans, self._rule_points, held[4],
                self._polynomials, self._grids, self._shape, self._half, group=(1,),
            )  # fmt: skip
            runtime.launch(
                self._kernels["accumulate"], (self._rows,), self._grids, items, target, self._shape, self._stride,
                group=(1,),
            )  # fmt: skip
        return held

    def _cells(self, number: int, vertices: Array) -> tuple[Array, Array]:
        """Corners as cells and places within them, which keeps digits on a fine grid, in the order (u, v, w)."""
        cell = aligned_empty((len(vertices), 4), np.int32)
        fraction = aligned_empty((len(vertices), 4), self._spec.dtype)
        cell[...], fraction[...] = 0, 0
        for at, j in enumerate(self._order, start=3 - len(self._order)):
            column, margin = vertices[:, j], self._spec.windows[j].width / 2
            low, high = column.min(), column.max()
            # A kernel would write outside its grid.
            if low < margin or high > self._spec.shape[j] - 1 - margin:
                raise ArgumentError(
                    f"surfaces[{number}]",
                    f"reaches from {low:.6g} to {high:.6g} cells on axis {j}",
                    f"stay {margin} cells inside 0..{self._spec.shape[j] - 1}",
                )
            below = np.floor(column)
            cell[:, at] = below
            fraction[:, at] = column - below
        return cell, fraction

    def _shares(self, rule: Array) -> Array:
        """Where each work-item's pieces begin, so that all have about as many points."""
        work = np.cumsum(self._counts[rule] + 1)
        items = int(np.clip(work[-1] // POINTS_PER_ITEM, 1, self._items))
        inner = np.searchsorted(work, np.arange(1, items) * work[-1] / items)
        return np.concatenate([[0], inner, [len(rule)]]).astype(np.int32)


@lru_cache(maxsize=64)
def weight_polynomials(window: Window) -> Array:
    """Coefficients (degree + 1, w), highest power first, of the weights φ(w/2 - f - m), m = 0..w-1, in x = 2f - 1."""
    x = np.cos(np.pi * np.arange(401) / 400)
    allowed = FIT * window.error()
    for degree in DEGREES:
        nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        chebyshev = np.polynomial.chebyshev.chebfit(nodes, _weights(window, nodes), degree)
        missed = np.abs(np.polynomial.chebyshev.chebval(x, chebyshev).T - _weights(window, x)).max()
        if missed <= allowed:
            break
    table = np.zeros((degree + 1, window.width))
    for m, column in enumerate(chebyshev.T):
        powers = np.polynomial.chebyshev.cheb2poly(column)
        table[: len(powers), m] = powers
    return np.ascontiguousarray(table[::-1])


def _weights(window: Window, x: Array) -> Array:
    return window.values((window.width - 1 - x[:, None]) / 2 - np.arange(window.width))


def _padded_to(table: Array, rows: int, columns: int) -> Array:
    """Zeros above, for the powers that are missing, and to the right."""
    return np.pad(table, ((rows - len(table), 0), (0, columns - table.shape[1])))
