"""`spline_contract` on OpenCL: sparse rows times dense coefficients, rows with equal columns taken together.

Forward and adjoint are the same kernel: the adjoint's sparse matrix is the transpose, made here in a fixed order, so
that there are no atomics and the same bits each time. Only indices and weights are sorted; results go straight to
their own row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from ...errors import ArgumentError, DtypeError, ShapeError
from ..base import Array, SplineSpec
from .runtime import aligned_empty, input_array, output_array

if TYPE_CHECKING:
    from .runtime import Runtime

ROWS = 6  # of a block, as in the kernel

# A strip of all the coefficient rows of a group should stay in the nearest caches while its blocks use it.
STRIP_BYTES = 64 * 1024
# Work items per compute unit, so that none waits long for the last.
ITEMS_PER_UNIT = 8


class OpenCLSplinePlan:
    """out[q, :] = Σ_t weights[q, t] coefficients[columns[q, t], :] on one device.

    The coefficients are sent once; on CPU devices they are used where they lie and must not change while the plan
    lives. Weights are rounded to the plan's dtype. A query's bits do not depend on the other queries of a call.

    Parameters
    ----------
    runtime : Runtime
    label : str
        What `device` says.
    spec : SplineSpec
        Coefficients of shape (C, K), and the dtype in which they and the weights are used.
    """

    def __init__(self, runtime: Runtime, label: str, spec: SplineSpec) -> None:
        self.device = label
        self._runtime = runtime
        self._dtype = np.dtype(spec.dtype)
        self._lanes = vector_lanes(runtime.device, self._dtype)
        self._kernel = runtime.kernels("spline_contract", self._dtype, {"LANES": self._lanes})["spline_contract"]
        if len(spec.coefficients.shape) != 2 or not spec.coefficients.size:
            raise ShapeError("coefficients", f"have shape {spec.coefficients.shape}", "give (C, K), neither of them 0")
        count, stride = spec.coefficients.shape
        row_bytes = stride * self._dtype.itemsize
        remedy = "fit fewer bodies or nodes"
        runtime.require("coefficients", (count + 1) * row_bytes, count * row_bytes, remedy)
        self._coefficients = np.require(spec.coefficients, dtype=self._dtype, requirements=["C", "A"])
        left = runtime.memory_bytes - count * row_bytes
        # Half of what the coefficients leave: an adjoint's cotangent lies beside the rows that are being made.
        self._rows_at_once = max(min(int(runtime.device.max_mem_alloc_size), left // 2) // row_bytes, 1)
        self._source = runtime.input(self._coefficients)

    def forward(self, columns: Array, weights: Array, out: Array | None = None) -> Array:
        """(Q, T) integers and (Q, T) real → (Q, K) real."""
        self._check(columns, weights)
        queries, terms = columns.shape
        shape = (queries, self._coefficients.shape[1])
        rows = SparseRows(
            np.arange(queries + 1, dtype=np.int64) * terms,
            columns.astype(np.int32, copy=False).ravel(),
            weights.astype(self._dtype, copy=False).ravel(),
        )
        return self._contract(rows, self._source, output_array(out, self._dtype, shape, self._coefficients))

    def adjoint(self, columns: Array, weights: Array, cotangent: Array) -> Array:
        """(Q, T), (Q, T) and (Q, K) → (C, K): the derivative of ⟨cotangent, out⟩ in the coefficients."""
        self._check(columns, weights)
        count, stride = self._coefficients.shape
        values = input_array("cotangent", cotangent, self._dtype, (len(columns), stride))
        result = aligned_empty((count, stride), self._dtype)
        if not columns.size:
            result[...] = 0
            return result
        rows_made = min(self._rows_at_once, count) * values.itemsize * stride
        held = self._coefficients.nbytes + values.nbytes + rows_made
        self._runtime.require("cotangent", held, values.nbytes, "give fewer queries")
        rows = transposed(columns, weights.astype(self._dtype, copy=False), count)
        return self._contract(rows, self._runtime.input(values), result)

    def _check(self, columns: Array, weights: Array) -> None:
        if columns.ndim != 2 or columns.shape != weights.shape:
            raise ShapeError("columns", f"have shape {columns.shape}", f"give (Q, T), as weights {weights.shape} have")
        if columns.dtype.kind not in "iu" or weights.dtype.kind != "f":
            raise DtypeError("columns, weights", f"are {columns.dtype}, {weights.dtype}", "give integers and reals")
        # The kernel follows these numbers without looking.
        wrong = np.argwhere((columns < 0) | (columns >= len(self._coefficients)))
        if len(wrong):
            index = tuple(int(i) for i in wrong[0])
            last = len(self._coefficients) - 1
            raise ArgumentError("columns", f"hold {columns[index]} at index {index}", f"give 0..{last}")

    def _contract(self, rows: SparseRows, source: cl.Buffer, out: Array) -> Array:
        """Fill `out` in as few pieces of rows as the device's largest allocation allows."""
        for start in range(0, len(out), self._rows_at_once):
            piece = out[start : start + self._rows_at_once]
            self._launch(block_rows(rows.some(start, start + len(piece)), ROWS), source, piece)
        return out

    def _launch(self, work: Blocks, source: cl.Buffer, out: Array) -> None:
        runtime, stride = self._runtime, out.shape[1]
        groups = len(work.groups) - 1
        strip = self._strip(work, groups, stride)
        result = runtime.output(out)
        tables = [runtime.input(t) for t in (work.blocks, work.groups, work.columns, work.packed, work.targets)]
        # One work item is a CPU core's worth of vectors; left to itself PoCL would vectorise across items instead.
        item = (1, 1) if runtime.shares_host_memory else None
        size = (groups, -(-stride // strip))
        with runtime.settled():
            runtime.launch(self._kernel, size, *tables, source, result, stride, strip, group=item)
            runtime.fetch(result, out)

    def _strip(self, work: Blocks, groups: int, stride: int) -> int:
        """Columns per work item; it moves no bit of the result."""
        longest = max(1, int(work.blocks[:, 1].max()))
        cached = STRIP_BYTES // (self._dtype.itemsize * longest)
        shared = -(-stride * groups // (ITEMS_PER_UNIT * self._runtime.compute_units))
        width = 2 * self._lanes
        return max(width, min(cached, shared) // width * width)


def vector_lanes(device: cl.Device, dtype: np.dtype[Any]) -> int:
    """Reals in a register, 16 to 64 bytes of them: the kernel's accumulators then just fill the register file."""
    double = dtype == np.float64
    native = int(device.native_vector_width_double if double else device.native_vector_width_float)
    return min(max(native, 16 // dtype.itemsize), 64 // dtype.itemsize)


@dataclass(frozen=True, eq=False)
class SparseRows:
    """Row i has the terms pointers[i]..pointers[i+1] of columns and weights (compressed sparse rows)."""

    pointers: NDArray[np.int64]
    columns: NDArray[np.int32]
    weights: Array

    def some(self, start: int, stop: int) -> SparseRows:
        """Rows start..stop, without copies."""
        pointers = self.pointers[start : stop + 1]
        terms = slice(pointers[0], pointers[-1])
        return SparseRows(pointers - pointers[0], self.columns[terms], self.weights[terms])


def transposed(columns: Array, weights: Array, count: int) -> SparseRows:
    """The transpose of Q rows of T terms: `count` rows, each summing over queries in ascending order."""
    flat = columns.ravel()
    order = np.argsort(flat, kind="stable")
    pointers = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.bincount(flat, minlength=count), out=pointers[1:])
    return SparseRows(pointers, (order // columns.shape[1]).astype(np.int32), weights.ravel()[order])


@dataclass(frozen=True, eq=False)
class Blocks:
    """What the kernel reads; see its source."""

    blocks: NDArray[np.uint64]  # (B, 5)
    groups: NDArray[np.int32]  # (G + 1,)
    columns: NDArray[np.int32]
    packed: Array
    targets: NDArray[np.int32]


def block_rows(rows: SparseRows, limit: int) -> Blocks:
    """Sort rows so that equal column lists are neighbours, and cut each run of them into blocks of ≤ `limit` rows."""
    rows, order = _neighbours(rows)
    lengths = np.diff(rows.pointers)
    group_first = np.flatnonzero(_differs_from_previous(rows, lengths))
    sizes = np.diff(group_first, append=len(order))
    counts = -(-sizes // limit)
    groups = np.concatenate([[0], np.cumsum(counts)])
    # Blocks of a group are as equal as can be: 32 rows are 6+6+5+5+5+5, not five times 6 and a slow 2.
    group = np.repeat(np.arange(len(sizes)), counts)
    place = np.arange(len(group)) - groups[group]
    heights = sizes[group] // counts[group] + (place < sizes[group] % counts[group])
    first_row = np.cumsum(heights) - heights
    terms = lengths[first_row]
    first_weight = (np.cumsum(terms) - terms) * limit
    row_block = np.repeat(np.arange(len(group)), heights)
    slot = np.arange(len(order)) - first_row[row_block]
    row = np.repeat(np.arange(len(order)), lengths)
    term = np.arange(len(row)) - rows.pointers[row]
    packed = np.zeros(max(int(terms.sum()) * limit, 1), dtype=rows.weights.dtype)
    packed[first_weight[row_block[row]] + term * limit + slot[row]] = rows.weights
    blocks = np.stack([rows.pointers[first_row], terms, first_weight, first_row, heights], axis=1)
    columns = rows.columns if len(rows.columns) else np.zeros(1, dtype=np.int32)
    return Blocks(blocks.astype(np.uint64), groups.astype(np.int32), columns, packed, order.astype(np.int32))


def _neighbours(rows: SparseRows) -> tuple[SparseRows, NDArray[np.int64]]:
    """The rows sorted by first column, then length, then sum of columns; stable. And the order they came from."""
    lengths = np.diff(rows.pointers)
    first = np.full(len(lengths), -1, dtype=np.int64)
    first[lengths > 0] = rows.columns[rows.pointers[:-1][lengths > 0]]
    sums = np.diff(np.concatenate([[0], np.cumsum(rows.columns, dtype=np.int64)])[rows.pointers])
    order = np.lexsort((sums, lengths, first))
    pointers = np.concatenate([[0], np.cumsum(lengths[order])])
    row = np.repeat(np.arange(len(order)), lengths[order])
    taken = rows.pointers[order][row] + np.arange(len(row)) - pointers[row]
    return SparseRows(pointers, rows.columns[taken], rows.weights[taken]), order


def _differs_from_previous(rows: SparseRows, lengths: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each row has other columns than the row before it; the first one does."""
    previous = np.concatenate([[-1], lengths[:-1]])
    differs = previous != lengths
    row = np.repeat(np.arange(len(lengths)), np.where(differs, 0, lengths))
    if len(row):
        at = np.flatnonzero(np.repeat(~differs, lengths))
        changed = rows.columns[at] != rows.columns[at - lengths[row]]
        differs[row[changed]] = True
    return np.asarray(differs, dtype=np.bool_)
