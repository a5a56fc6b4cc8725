"""`tensor_transform` on OpenCL: real cos/sin matrices per axis, three products, and a change of basis at the nodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl as cl

from ...errors import ShapeError
from ..base import Array, TensorSpec
from . import tensor_axes
from .runtime import Runtime, input_array, output_array, require_bodies
from .tensor_axes import ABSENT, Table, Tables

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
        matrix = min(copies, self._chunk) * max(c.total * c.half for c in self._cuts) * self._real.itemsize
        scratch, rooms = self._chunk * self._per_body, self._groups * self._slot * self._real.itemsize
        weights = self._nodes * self._complex.itemsize
        total = 2 * scratch + rooms + tables + weights + values + nodes
        # All but the tables is held for one chunk, and a chunk of one body may be too much.
        smaller = "a smaller batch" if tables > total - tables else "fewer grid points or nodes"
        largest = max(scratch, rooms, values, nodes, matrix, weights)
        self._runtime.require("transform", total, largest, f"give {smaller}")
        if max(self._nodes, self._slot, *self.spec.grid_shape) >= 2**31:
            raise ShapeError("nodes", f"are {self._nodes}", "give fewer than 2**31: kernels count in 32 bits")

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *grid_shape) real → (b, *lattice_shape) complex, 1 ≤ b ≤ batch (b = batch when per body).

        Raises `ShapeError` or `DtypeError` for a wrong shape or dtype of `values` or `out`.
        """
        spec = self.spec
        values = input_array("values", values, self._real, (None, *spec.grid_shape))
        self._require_bodies("values", len(values))
        out = output_array(out, self._complex, (len(values), *spec.lattice_shape), values)
        return self._runtime.in_chunks(self._chunk, self._enqueue_forward, [values], out)

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
        return self._runtime.in_chunks(self._chunk, self._enqueue_adjoint, [u, centre], out)

    def _require_bodies(self, name: str, count: int) -> None:
        batch = self.spec.batch
        if self.spec.per_body and count != batch:
            raise ShapeError(name, f"holds {count} bodies", f"give exactly {batch}: each has matrices of its own")
        require_bodies(name, count, batch)

    def _of(self, part: slice) -> tuple[int, Tables]:
        """Number of bodies in a chunk, and its tables: its own where bodies have matrices of their own."""
        return part.stop - part.start, self._tables[part.start // self._chunk % len(self._tables)]

    def _enqueue_forward(self, part: slice, values: cl.Buffer, out: cl.Buffer) -> None:
        count, tables = self._of(part)
        self._planes("planes_forward", count, tables.forward, tables.masks, values, self._by_x)
        self._first("first_forward", count, tables.forward, tables.masks, self._by_x, self._by_frequency)
        first, middle, _ = self._cuts
        size = (middle.order + 1, first.order + 1, count)
        self._launch("combine", size, *self._axes, self._h, self._by_frequency, self._weights, tables.phases, out)
        if tables.zero is not None:
            zero = (first.n, self._columns, *tables.zero.arguments, self._weights, self._nodes)
            self._launch("zero_forward", (count,), *zero, self._by_x, out)

    def _enqueue_adjoint(self, part: slice, u: cl.Buffer, centre: cl.Buffer, out: cl.Buffer) -> None:
        count, tables = self._of(part)
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
