"""`scattered_transform` on OpenCL: voxels → arbitrary nodes κ, and the adjoint.

A non-uniform Fourier transform of type 2 whose padded FFT is a few small matrix products: contract the voxels,
axis by axis, onto a lattice of wavenumbers that covers just the band of the nodes, then let each node read the
w^d lattice points around it through a window. The matrices hold the window's deconvolution. The adjoint is the
transpose of each step, in reverse; lattice points gather their nodes, so that there are no atomics and the
summation order is fixed.

Source: A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41 (2019), for the method with an FFT.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl as cl

from ...errors import ArgumentError
from ...kernel_window import Window, candidates
from ..base import Array, ScatteredSpec
from .runtime import Runtime, input_array, output_array, require_bodies
from .scattered_lattice import Band, CentredNodes, cost, crowding, padded
from .scattered_layout import Product, Sizes, last_matrices, node_tables

# The worst voxel still has a window here, rounding included (see `Window.rounding`), and a third of 3 eps covers the
# growth of rounding with the length of sums up to some 500 points per axis.
LEAST_EPS = {"float32": 5e-7, "float64": 1e-13}
# Bodies transformed together: as many as leave the scratch in a core's caches; small problems share their launches.
CHUNK_BYTES = 4 * 2**20
ROWS = 5  # of a block, as written out in `contract`


def choose_window(spec: ScatteredSpec, bands: tuple[Band, ...]) -> Window:
    """The cheapest window for `eps`; refuses an `eps` that the dtype's rounding does not allow."""
    least = LEAST_EPS[spec.dtype.name]
    if not least <= spec.eps < 1:
        finer = ', or ask for dtype="complex128"' if spec.dtype == np.float32 and 0 < spec.eps < 1 else ""
        raise ArgumentError("eps", f"is {spec.eps}", f"give {least} <= eps < 1 with {spec.dtype.name} values{finer}")
    # The bound holds for a voxel in the grid's corner, where it is worst. Twice eps there leaves a third of the 3 eps
    # that are allowed to bodies whose transform is small against Σ|v|; most bodies come out far below eps.
    axes = max(sum(band.size > 1 for band in bands), 1)
    windows = candidates(2 * spec.eps, axes, float(np.finfo(spec.dtype).eps) / 2)
    return min(windows, key=lambda window: cost(window, bands, len(spec.kappa)))


class OpenCLScatteredPlan:
    """`scattered_transform` on one OpenCL device; see `ScatteredSpec` for the sum.

    Parameters
    ----------
    runtime : Runtime
        The device's queue and program cache.
    label : str
        What the device is called.
    spec : ScatteredSpec
        Grid, nodes, accuracy, batch and real dtype.

    Raises
    ------
    ArgumentError
        `eps` is not below 1, or below what rounding in the dtype allows.
    DeviceMemoryError
        The lattice and its scratch do not fit the device.
    """

    def __init__(self, runtime: Runtime, label: str, spec: ScatteredSpec) -> None:
        self.device = label
        self._runtime, self._spec = runtime, spec
        self._complex = np.result_type(spec.dtype, np.complex64)
        nodes = CentredNodes.of(spec.kappa, spec.node_weights, spec.shape, spec.spacing, spec.origin)
        window = choose_window(spec, nodes.bands)
        flat = [Band(1, 1.0, 0.0, 0.0)] * (3 - len(spec.shape))
        self._sizes = Sizes.of([*flat, *nodes.bands], window)
        self._allocate()
        self._upload([*flat, *nodes.bands], window, nodes)
        self._build()

    def _allocate(self) -> None:
        runtime, spec, sizes = self._runtime, self._spec, self._sizes
        real, nodes, (hx, hy, _) = spec.dtype.itemsize, len(spec.kappa), sizes.half
        per_body = (sum(sizes.turns) + 2 * nodes) * real + 4 * (hx * hy + hx + 1)
        self._chunk = min(max(CHUNK_BYTES // per_body, 1), spec.batch)
        records = nodes * (sizes.lanes + sizes.width[0] + sizes.width[1] + 3) * real
        # Where the device has its own memory, a chunk of bodies and of transforms is there at once.
        bodies = 0 if runtime.shares_host_memory else self._chunk
        values, transforms = bodies * math.prod(spec.shape) * real, bodies * 2 * nodes * real
        matrices = [2 * half * padded(count) * real for half, count in zip(sizes.half, sizes.count, strict=True)]
        tables = sum(matrices) + matrices[2] + records + 16 * nodes + 4 * math.prod(sizes.bins)
        largest = max(self._chunk * max(sizes.turns) * real, records, values, transforms, *matrices)
        total = self._chunk * per_body + tables + values + transforms
        # One body makes a chunk where it has to, so that a smaller batch would need no less.
        runtime.require("transform", total, largest, "give fewer grid points, fewer nodes or a larger eps")
        self._turns = [runtime.scratch(self._chunk * turn * real) for turn in sizes.turns]
        self._strengths = runtime.scratch(self._chunk * 2 * nodes * real)
        self._reach = [runtime.scratch(4 * self._chunk * count) for count in (hx * hy, hx, 1)]

    def _upload(self, bands: list[Band], window: Window, nodes: CentredNodes) -> None:
        def table(array: Array) -> cl.Buffer:
            return self._runtime.constant(array.astype(self._spec.dtype))

        x, y, z = (band.matrices(window) for band in bands)
        wide, tall = last_matrices(z)
        self._x, self._y, self._z, self._z_transposed = table(x), table(y), table(wide), table(tall)
        # The adjoint sums over all wavenumbers, whatever the body.
        self._all = [self._runtime.constant(np.array([p.length], dtype=np.int32)) for p in self._sizes.adjoint()]
        kappa = [np.zeros(len(nodes.kappa))] * (3 - nodes.kappa.shape[1]) + list(nodes.kappa.T)
        axes = [band.places(window, along) for band, along in zip(bands, kappa, strict=True)]
        # Adding them one by one is good enough but where thousands of nodes share a few lattice points.
        lost = np.finfo(self._spec.dtype).eps / 2 * crowding(window, bands, [first for first, _ in axes])
        self._compensated = int(lost > self._spec.eps)
        place, records, start = node_tables(self._sizes, axes, nodes)
        self._place, self._records, self._start = (
            self._runtime.constant(place),
            table(records),
            self._runtime.constant(start),
        )

    def _build(self) -> None:
        runtime, sizes, types = self._runtime, self._sizes, cl.cltypes
        vector = {"LANES": 32 // self._spec.dtype.itemsize}
        # A processor core wants work-items of some length, a GPU many of them.
        nodes, rows = (16, 32) if runtime.shares_host_memory else (1, 1)
        self._per_item = {"NODES_PER_ITEM": nodes, "ROWS_PER_ITEM": rows}
        self._parity = runtime.kernels("parity_transform", self._spec.dtype, {"LEADING": sizes.leading, **vector})
        self._products = runtime.kernels("parity_products", self._spec.dtype, vector)
        defines = {"WINDOW_Z": sizes.lanes, "COMPENSATED": self._compensated, **self._per_item, **vector}
        self._window = runtime.kernels("scattered_transform", self._spec.dtype, defines)
        self._shape = (types.make_int4(*sizes.voxels, 0), types.make_int4(*sizes.half, padded(sizes.half[2])))
        self._lattice = (
            types.make_int4(*sizes.low, sizes.row),
            types.make_int4(*sizes.high, 0),
            types.make_int4(*sizes.least, padded(sizes.count[2])),
            types.make_int2(*sizes.count[:2]),
        )
        self._width = types.make_int2(*sizes.width[:2])
        self._span, self._bins = types.make_int2(*sizes.span[:2]), types.make_int2(*sizes.bins)

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *shape) real → (b, J) complex, 1 ≤ b ≤ batch.

        Raises `ShapeError` or `DtypeError` for a wrong shape or dtype of `values` or `out`.
        """
        spec = self._spec
        values = input_array("values", values, spec.dtype, (None, *spec.shape))
        require_bodies("values", len(values), spec.batch)
        out = output_array(out, self._complex, (len(values), len(spec.kappa)), values)
        return self._runtime.in_chunks(self._chunk, self._enqueue_forward, [values], out)

    def adjoint(self, u: Array, out: Array | None = None) -> Array:
        """(b, J) complex → (b, *shape) real, 1 ≤ b ≤ batch: the transpose of what `forward` computes, for Re⟨·,·⟩.

        Raises `ShapeError` or `DtypeError` for a wrong shape or dtype of `u` or `out`.
        """
        spec = self._spec
        u = input_array("u", u, self._complex, (None, len(spec.kappa)))
        require_bodies("u", len(u), spec.batch)
        out = output_array(out, spec.dtype, (len(u), *spec.shape), u)
        return self._runtime.in_chunks(self._chunk, self._enqueue_adjoint, [u], out)

    def _enqueue_forward(self, part: slice, values: cl.Buffer, out: cl.Buffer) -> None:
        sizes, bodies = self._sizes, part.stop - part.start
        (hx, hy, _), (here, there) = sizes.half, self._turns
        self._launch(self._parity["fold"], hy, hx, bodies, values, here, self._reach[0], *self._shape)
        for inner, outer, rows, count in zip(self._reach, self._reach[1:], (hx, 1), (hy, hx), strict=False):
            self._runtime.launch(self._products["last_nonzero"], (rows * bodies,), inner, outer, count, group=(1,))
        matrices = (self._z, self._y, self._x)
        for product, matrix, reach in zip(sizes.forward(), matrices, self._reach, strict=False):
            # On the last axis the voxels stand on the left of the product, on the others on the right.
            factors = (here, matrix) if matrix is self._z else (matrix, here)
            self._contract(product, bodies, *factors, there, reach)
            here, there = there, here
        self._launch(self._parity["combine"], sizes.span[1], sizes.span[0], bodies, here, there, *self._lattice)
        nodes = len(self._spec.kappa)
        self._launch_nodes(
            "gather", bodies, there, self._place, self._records, out, nodes, self._span, self._width, sizes.row
        )

    def _enqueue_adjoint(self, part: slice, u: cl.Buffer, out: cl.Buffer) -> None:
        sizes, bodies, nodes = self._sizes, part.stop - part.start, len(self._spec.kappa)
        (hx, hy, _), (here, there) = sizes.half, self._turns
        if sizes.leading == 0:
            here, there = there, here
        self._launch_nodes("weigh", bodies, u, self._place, self._records, self._strengths, nodes, self._width)
        groups = -(-sizes.span[1] // self._per_item["ROWS_PER_ITEM"])
        self._runtime.launch(
            self._window["spread"], (groups, sizes.span[0], bodies), self._strengths, self._place, self._records,
            self._start, here, there, nodes, self._span, self._width, self._bins, sizes.row, group=(1, 1, 1),
        )  # fmt: skip
        self._launch(self._parity["split"], sizes.count[1], sizes.count[0], bodies, here, there, *self._lattice)
        matrices = (self._x, self._y, self._z_transposed)[1 - sizes.leading :]
        for product, matrix, reach in zip(sizes.adjoint(), matrices, self._all, strict=True):
            here, there = there, here
            factors = (here, matrix) if matrix is self._z_transposed else (matrix, here)
            self._contract(product, bodies, *factors, there, reach)
        self._launch(self._parity["unfold"], hy, hx, bodies, there, out, *self._shape)

    def _contract(
        self, product: Product, bodies: int, left: cl.Buffer, right: cl.Buffer, out: cl.Buffer, reach: cl.Buffer
    ) -> None:
        blocks = -(-product.rows // ROWS)
        types = cl.cltypes
        self._launch(
            self._products["contract"], blocks, product.planes, 2 * product.rests * bodies, left, right, out, reach,
            types.make_long8(*product.a, 0, 0, 0), types.make_long4(*product.b), types.make_long4(*product.out),
            types.make_long4(*product.reach, 0), types.make_int4(product.rows, product.columns, product.rests, 0),
        )  # fmt: skip

    def _launch_nodes(self, name: str, bodies: int, *arguments: Any) -> None:
        groups = -(-len(self._spec.kappa) // self._per_item["NODES_PER_ITEM"])
        self._runtime.launch(self._window[name], (groups, bodies), *arguments, group=(1, 1))

    def _launch(self, kernel: cl.Kernel, rows: int, planes: int, last: int, *arguments: Any) -> None:
        """Kernels that step through rows: a CPU does a plane's rows in one work-item, so that groups are not tiny."""
        size = (1 if self._runtime.shares_host_memory else rows, planes, last)
        self._runtime.launch(kernel, size, *arguments, group=(1, 1, 1))
