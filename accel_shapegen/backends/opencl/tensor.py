"""`tensor_transform` on OpenCL: real cos/sin matrices per axis, three products, and a change of basis at the nodes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from ...errors import ShapeError
from ..base import TensorSpec
from . import tensor_axes
from .runtime import Runtime, input_array, output_array
from .tensor_axes import ABSENT, Table, Tables

Array = NDArray[Any]

# The two intermediate tensors of a chunk of bodies: large enough to hide launches, small enough for the cache.
CHUNK_BYTES = 8 * 2**20
# Groups per compute unit: enough for an even share when another program takes a core for a while.
GROUPS = 16
# Columns of one task along the first axis; rows of one task of a 2-D grid.
COLUMN_BAND, ROW_BAND = 64, 48
# Cuts by symmetry: the last axis keeps its frequencies in order, which 4 parts would not.
MOST_PARTS, MOST_PARTS_LAST = 4, 2


class OpenCLTensorPlan:
    """F[ξ] = c[ξ] Σ_g v[g] Π_j E_j[ξ_j, g_j] for real v, and its adjoint, for up to `spec.batch` bodies a call.

    Each axis is a real matrix with rows w_m cos(m s x) and w_m sin(m s x), 0 <= m <= N, split into parts where the
    points are symmetric. The grid is contracted axis by axis with these, and the 2^d products of cosines and sines
    give the nodes of all sign combinations; the adjoint walks back. Angles are computed in float64, whatever the
    precision of the sums.

    Inputs that are not C-contiguous are copied; `out` must be. Threads may share a plan.

    Parameters
    ----------
    runtime : Runtime
        The device.
    label : str
        What `device` reads.
    spec : TensorSpec
        Axes, precision, node weights, zero row.

    Raises
    ------
    DeviceMemoryError
        The plan does not fit; nothing has been allocated.
    BackendError
        The device lacks float64, or the kernels cannot be built.
    """

    def __init__(self, runtime: Runtime, label: str, spec: TensorSpec) -> None:
        self.device = label
        self.spec = spec
        self._runtime = runtime
        self._real = np.dtype(spec.dtype)
        self._complex = np.result_type(self._real, np.complex64)
        self._cut_axes()
        self._size_chunks()
        defines = {"DIM": len(spec.axes), "LANES": self._lanes}
        shifted = any(tensor_axes.is_shifted(a, c, self._real) for a, c in zip(spec.axes, self._own, strict=True))
        self._kernels = runtime.kernels("tensor_transform", self._real, defines) | runtime.kernels(
            "tensor_nodes", self._real, defines | {"SHIFTED": int(shifted)}
        )
        self._by_x = runtime.scratch(self._chunk * self._per_body)  # (chunk, n1, P2, P3)
        self._by_frequency = runtime.scratch(self._chunk * self._per_body)  # (chunk, P1, P2, P3)
        self._rooms = runtime.scratch(self._groups * self._slot * self._real.itemsize)
        self._weights = runtime.constant(spec.node_weights.astype(self._complex))
        starts = range(0, spec.batch if spec.per_body else 1, self._chunk)
        self._tables = [
            Tables.of(runtime, spec, self._own, slice(start, min(start + self._chunk, spec.batch))) for start in starts
        ]

    def _cut_axes(self) -> None:
        """Layouts of the axes, and the same as kernel arguments."""
        *others, last = self.spec.axes
        cuts = [tensor_axes.layout(axis, self._real, MOST_PARTS) for axis in others]
        self._own = (*cuts, tensor_axes.layout(last, self._real, MOST_PARTS_LAST))
        self._cuts = self._own if len(self._own) == 3 else (self._own[0], ABSENT, self._own[1])
        self._axes = tuple(_int4(cut.n, cut.parts, cut.half, cut.rows) for cut in self._cuts)
        self._h = _int4(*(cut.order + 1 for cut in self._cuts), 0)
        self._nodes = math.prod(self.spec.lattice_shape)

    def _size_chunks(self) -> None:
        """Bodies per chunk, groups, and scratch; refuses what does not fit before anything is allocated."""
        first, middle, last = self._cuts
        size = self._real.itemsize
        self._lanes = 32 // size
        self._columns = middle.total * last.total
        self._per_body = max(first.n, first.total) * self._columns * size
        self._chunk = min(self.spec.batch, max(1, CHUNK_BYTES // (2 * self._per_body)))
        self._groups = GROUPS * self._runtime.compute_units
        padded = -(-last.n // self._lanes) * self._lanes
        # Of a group: a plane after one contraction and a folded one (2-D: a folded band of rows), or a folded band of
        # the first axis.
        if len(self._own) == 3:
            plane = middle.total * padded + max(middle.parts * middle.half * padded, middle.total * 2 * last.half)
        else:
            plane = ROW_BAND * 2 * last.half
        self._slot = max(plane, first.parts * first.half * COLUMN_BAND)
        self._require()

    def _require(self) -> None:
        """Count what a call holds on the device: scratch, tables, and one chunk of input and output."""
        copies = self.spec.batch if self.spec.per_body else 1
        values = self._chunk * math.prod(self.spec.grid_shape) * self._real.itemsize
        nodes = self._chunk * self._nodes * self._complex.itemsize
        per_body = sum(2 * c.total * c.half + c.n + 2 * (c.order + 1) for c in self._cuts) + 2 * self._cuts[0].n
        tables = copies * per_body * self._real.itemsize
        scratch, rooms = self._chunk * self._per_body, self._groups * self._slot * self._real.itemsize
        weights = self._nodes * self._complex.itemsize
        total = 2 * scratch + rooms + tables + weights + values + nodes
        self._runtime.require("batch", total, max(scratch, rooms, values, nodes, tables, weights))

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *grid_shape) real → (b, *lattice_shape) complex, 1 ≤ b ≤ batch (b = batch when per body).

        Raises `ShapeError` or `DtypeError` for a wrong shape or dtype of `values` or `out`.
        """
        spec = self.spec
        values = input_array("values", values, self._real, (None, *spec.grid_shape))
        self._require_bodies("values", len(values))
        out = output_array(out, self._complex, (len(values), *spec.lattice_shape), values)
        with self._runtime.gather() as gather:
            for part, tables in self._chunks(len(values)):
                source, target = self._runtime.input(values[part]), self._runtime.output(out[part])
                with self._runtime.lock:
                    self._enqueue_forward(len(out[part]), tables, source, target)
                gather(target, out[part])
        return out

    def adjoint(self, u: Array, centre: Array | None = None, out: Array | None = None) -> Array:
        """(b, *lattice_shape) complex → (b, *grid_shape) real; `centre` (b,) replaces the slot ξ = 0 of u.

        Raises `ShapeError` or `DtypeError` for a wrong shape or dtype of `u`, `centre` or `out`.
        """
        spec = self.spec
        u = input_array("u", u, self._complex, (None, *spec.lattice_shape))
        self._require_bodies("u", len(u))
        if centre is not None:
            centre = input_array("centre", centre, self._complex, (len(u),))
        else:
            centre = u.reshape(len(u), -1)[:, self._nodes // 2].copy()
        out = output_array(out, self._real, (len(u), *spec.grid_shape), u, centre)
        with self._runtime.gather() as gather:
            for part, tables in self._chunks(len(u)):
                sources = self._runtime.input(u[part]), self._runtime.input(centre[part])
                target = self._runtime.output(out[part])
                with self._runtime.lock:
                    self._enqueue_adjoint(len(out[part]), tables, *sources, target)
                gather(target, out[part])
        return out

    def _require_bodies(self, name: str, count: int) -> None:
        batch = self.spec.batch
        if self.spec.per_body and count != batch:
            raise ShapeError(name, f"holds {count} bodies", f"give exactly {batch}: each has matrices of its own")
        if not 1 <= count <= batch:
            raise ShapeError(name, f"holds {count} bodies", f"give 1 to {batch}, or plan a larger batch")

    def _chunks(self, count: int) -> Iterator[tuple[slice, Tables]]:
        for index, start in enumerate(range(0, count, self._chunk)):
            yield slice(start, min(start + self._chunk, count)), self._tables[index % len(self._tables)]

    def _enqueue_forward(self, count: int, tables: Tables, values: cl.Buffer, out: cl.Buffer) -> None:
        self._planes("planes_forward", count, tables.forward, tables.masks, values, self._by_x)
        self._first("first_forward", count, tables.forward, tables.masks, self._by_x, self._by_frequency)
        first, middle, _ = self._cuts
        size = (middle.order + 1, first.order + 1, count)
        self._launch("combine", size, *self._axes, self._h, self._by_frequency, self._weights, tables.phases, out)
        if tables.zero is not None:
            zero = (first.n, self._columns, *tables.zero.arguments, self._weights, self._nodes)
            self._launch("zero_forward", (count,), *zero, self._by_x, out)

    def _enqueue_adjoint(self, count: int, tables: Tables, u: cl.Buffer, centre: cl.Buffer, out: cl.Buffer) -> None:
        first, middle, _ = self._cuts
        size = (middle.frequencies, first.frequencies, count)
        nodes = (*self._axes, self._h, u, self._weights, tables.phases, centre, int(tables.zero is not None))
        self._launch("split", size, *nodes, self._by_frequency)
        self._first("first_adjoint", count, tables.adjoint, tables.masks, self._by_frequency, self._by_x)
        if tables.zero is not None:
            zero = (first.n, self._columns, *tables.zero.arguments, self._weights, self._nodes, centre)
            self._launch("zero_adjoint", (first.n, count), *zero, self._by_x)
        self._planes("planes_adjoint", count, tables.adjoint, tables.masks, self._by_x, out)

    def _planes(
        self, name: str, count: int, matrices: tuple[Table, ...], masks: tuple[Table, ...], *ends: cl.Buffer
    ) -> None:
        n = self._cuts[0].n
        tasks = count * (n if len(self._own) == 3 else -(-n // ROW_BAND))
        tables = [argument for j in (1, 2) for table in (matrices[j], masks[j]) for argument in table.arguments]
        self._share_out(name, tasks, *self._axes, ROW_BAND, *tables, self._rooms, self._slot, *ends)

    def _first(
        self, name: str, count: int, matrices: tuple[Table, ...], masks: tuple[Table, ...], *ends: cl.Buffer
    ) -> None:
        tasks = count * -(-self._columns // COLUMN_BAND)
        tables = (*matrices[0].arguments, *masks[0].arguments)
        self._share_out(name, tasks, self._axes[0], self._columns, COLUMN_BAND, *tables, self._rooms, self._slot, *ends)

    def _share_out(self, name: str, tasks: int, *arguments: Any) -> None:
        self._runtime.launch(self._kernels[name], (min(tasks, self._groups),), tasks, *arguments, group=(1,))

    def _launch(self, name: str, size: tuple[int, ...], *arguments: Any) -> None:
        # One group size for all shapes: PoCL compiles a kernel anew for each that it meets.
        self._runtime.launch(self._kernels[name], size, *arguments, group=(1,) * len(size))


def _int4(*values: int) -> Any:
    return cl.cltypes.make_int4(*values)
