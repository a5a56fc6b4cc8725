"""Lengths, strides and tables of everything between voxels and nodes, as the kernels of two files expect them.

parity_transform.cl has the layouts from voxels to the lattice, scattered_transform.cl a node's record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...kernel_window import Window
from ..base import Array
from .scattered_lattice import Band, CentredNodes, padded

Three = tuple[int, int, int]


@dataclass(frozen=True)
class Product:
    """One launch of `contract`: out[r, c] = Σ_t a[r, t] b[t, c] for two parities × rests × planes.

    Attributes
    ----------
    rows, columns, length : int
        Shape of the product, and the number of terms in its sums.
    planes, rests : int
        Products per parity; `rests` per body.
    a : tuple of int
        Strides, in reals, of parity, rest, plane, row and t.
    b : tuple of int
        Of parity, rest, plane and t; columns are contiguous.
    out : tuple of int
        Of parity, rest, plane and row.
    reach : tuple of int
        Of body, plane and row, where a row's number of terms is found.
    """

    rows: int
    columns: int
    length: int
    planes: int
    rests: int
    a: tuple[int, int, int, int, int]
    b: tuple[int, int, int, int]
    out: tuple[int, int, int, int]
    reach: Three = (0, 0, 0)


@dataclass(frozen=True)
class Sizes:
    """Lengths per axis, always three: a 2-D grid has a first axis of one point."""

    voxels: Three
    half: Three  # points from the centre out
    least: Three  # least |m|
    count: Three  # number of |m|
    low: Three  # first signed m
    high: Three
    width: Three  # lattice points that a node sees

    @classmethod
    def of(cls, bands: Sequence[Band], window: Window) -> Sizes:
        """From one band per axis."""
        x, y, z = bands
        low, high = zip(x.range(window), y.range(window), z.range(window), strict=True)
        least, count = zip(x.magnitudes(window), y.magnitudes(window), z.magnitudes(window), strict=True)
        return cls(
            voxels=(x.size, y.size, z.size),
            half=(x.half, y.half, z.half),
            least=least,
            count=count,
            low=low,
            high=high,
            width=(x.width(window), y.width(window), z.width(window)),
        )

    @property
    def leading(self) -> int:
        """Whether the first axis has more than one point, and so an odd half."""
        return int(self.voxels[0] > 1)

    @property
    def lanes(self) -> int:
        """Window points on the last axis, in whole vectors."""
        return padded(self.width[2])

    @property
    def span(self) -> Three:
        """Signed lattice points per axis."""
        x, y, z = (high - low + 1 for low, high in zip(self.low, self.high, strict=True))
        return x, y, z

    @property
    def row(self) -> int:
        """Length of a lattice row: the last node's vectors must end inside it."""
        return self.span[2] + self.lanes - self.width[2]

    @property
    def bins(self) -> tuple[int, int]:
        """First lattice points that a node can have on the first two axes."""
        return self.span[0] - self.width[0] + 1, self.span[1] - self.width[1] + 1

    @property
    def turns(self) -> tuple[int, int]:
        """Reals per body of the two buffers that stages read and write in turn, beginning with the first."""
        stages = self.stages if self.leading else (*self.stages[:3], self.stages[4])
        # The lattice is held beside what rounding took from it.
        return max(*stages[0::2], stages[-1]), max(*stages[1::2], stages[-1])

    @property
    def stages(self) -> tuple[int, ...]:
        """Reals per body: folded, after the last axis, after the middle, after the first, and on the lattice."""
        (hx, hy, hz), (mx, my, mz) = self.half, self.count
        first = 1 + self.leading
        columns = 2 * padded(mz)
        return (
            4 * first * hx * hy * padded(hz),
            2 * first * hx * hy * columns,
            2 * first * hx * my * columns,
            2 * first * mx * my * columns,
            self.span[0] * self.span[1] * 2 * self.row,
        )

    def forward(self) -> list[Product]:
        """Last axis, middle axis, and the first where it has more than one point."""
        (hx, hy, hz), (mx, my, mz) = self.half, self.count
        hz_row, mz_row, columns = padded(hz), padded(mz), 2 * padded(mz)
        first = 1 + self.leading
        part = hx * hy * hz_row
        last = Product(
            rows=hy, columns=mz_row, length=hz, planes=hx, rests=2 * first,
            a=(part, 2 * part, hy * hz_row, hz_row, 1),
            b=(hz * mz_row, 0, 0, mz_row),
            out=(mz_row, hx * hy * columns, hy * columns, columns),
            reach=(hx * hy, hy, 1),
        )  # fmt: skip
        middle = Product(
            rows=my, columns=columns, length=hy, planes=hx, rests=first,
            a=(hy * my, 0, 0, 1, my),
            b=(hx * hy * columns, 2 * hx * hy * columns, hy * columns, columns),
            out=(my * columns, 2 * hx * my * columns, 2 * my * columns, columns),
            reach=(hx, 1, 0),
        )  # fmt: skip
        outer = Product(
            rows=mx, columns=columns, length=hx, planes=2 * my, rests=1,
            a=(hx * mx, 0, 0, 1, mx),
            b=(2 * hx * my * columns, 4 * hx * my * columns, columns, 2 * my * columns),
            out=(2 * mx * my * columns, 4 * mx * my * columns, columns, 2 * my * columns),
            reach=(1, 0, 0),
        )  # fmt: skip
        return [last, middle, outer] if self.leading else [last, middle]

    def adjoint(self) -> list[Product]:
        """The transposes of `forward`, in reverse; the last axis comes with a transposed matrix."""
        last, *others = self.forward()
        transposed = [
            replace(p, rows=p.length, length=p.rows, a=(*p.a[:3], p.a[4], p.a[3]), b=p.out, out=p.b, reach=(0, 0, 0))
            for p in reversed(others)
        ]
        mz_row, hz_row = last.columns, last.a[3]
        first = replace(
            last, columns=hz_row, length=self.count[2], a=(*last.out, 1), b=(mz_row * hz_row, 0, 0, hz_row),
            out=last.a[:4], reach=(0, 0, 0),
        )  # fmt: skip
        return [*transposed, first]


def last_matrices(matrices: Array) -> tuple[Array, Array]:
    """cos and sin of the last axis, (2, half, number of |m|), and their transposes: rows in whole vectors."""
    _, half, count = matrices.shape
    wide = np.zeros((2, half, padded(count)))
    wide[:, :, :count] = matrices
    tall = np.zeros((2, padded(count), padded(half)))
    tall[:, :count, :half] = matrices.transpose(0, 2, 1)
    return wide, tall


def node_tables(sizes: Sizes, axes: Sequence[tuple[Array, Array]], nodes: CentredNodes) -> tuple[Array, Array, Array]:
    """Where the nodes are, sorted by their first lattice point; their records; and where each bin of them starts.

    Parameters
    ----------
    sizes : Sizes
    axes : sequence of (first, weights)
        Per axis, each node's first lattice point (J,), and its weights (J, width).
    nodes : CentredNodes

    Returns
    -------
    place : int32, shape (J, 4)
    records : float64, shape (J, lanes + width_x + width_y + 3)
    start : int32, shape (bins_x · bins_y + 1,)
    """
    (x, weights_x), (y, weights_y), (z, weights_z) = axes
    order = np.lexsort((z, y, x))
    padding = np.zeros((len(order), sizes.lanes - sizes.width[2]))
    factor = np.stack([nodes.factor.real, nodes.factor.imag, np.where(nodes.mirrored, -1.0, 1.0)], axis=1)
    records = np.concatenate([weights_z, padding, weights_x, weights_y, factor], axis=1)[order]
    place = np.stack([x[order], y[order], z[order], order], axis=1)
    counts = np.bincount(x * sizes.bins[1] + y, minlength=sizes.bins[0] * sizes.bins[1])
    start = np.concatenate([[0], np.cumsum(counts)])
    return place.astype(np.int32), records, start.astype(np.int32)
