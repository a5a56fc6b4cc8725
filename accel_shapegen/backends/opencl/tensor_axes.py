"""The matrices of `tensor_transform`: real cos/sin rows per axis, cut by symmetry into independent parts.

About the centre of a symmetric axis, cosines see only the even part of a grid function and sines only the odd part:
half the products. If the axis also spans exactly one period, each part splits once more by the parity of the frequency:
a quarter. What an axis allows is read off its points; nothing but speed and rounding depends on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl

from ..base import Array, TensorAxis, TensorSpec
from .runtime import Runtime


@dataclass(frozen=True)
class Layout:
    """How an axis is cut: `parts` matrices of `rows` frequencies by `half` points each.

    1 part: rows cos m then sin m, all points. 2 parts: cos and sin, m = 0..N. 4 parts: cos with even m, cos odd,
    sin odd, sin even. Parts count the points from the first one on. `trivial` is a single 1 without sines.
    """

    n: int
    order: int
    parts: int
    trivial: bool = False

    @property
    def half(self) -> int:
        """Points per part."""
        return -(-self.n // self.parts)

    @property
    def rows(self) -> int:
        """Rows per part; with 4 parts and an odd number of frequencies, the last row of two parts is zero."""
        return 1 if self.trivial else -(-2 * (self.order + 1) // self.parts)

    @property
    def total(self) -> int:
        """Rows of all parts."""
        return self.parts * self.rows

    @property
    def frequencies(self) -> int:
        """Frequencies m >= 0 that the rows have room for."""
        return max(self.total // 2, 1)


ABSENT = Layout(1, 0, 1, trivial=True)  # the middle axis of a 2-D grid


@dataclass(frozen=True)
class Table:
    """One table for all bodies of a chunk (stride 0), or one each, `stride` elements apart."""

    buffer: cl.Buffer
    stride: int

    @staticmethod
    def of(runtime: Runtime, bodies: Array, dtype: np.dtype[Any]) -> Table:
        """A device copy, rounded to `dtype`, of an array whose first axis is the bodies, or has length 1."""
        buffer = runtime.constant(bodies.astype(dtype, order="C"))
        return Table(buffer, math.prod(bodies.shape[1:]) if len(bodies) > 1 else 0)

    @property
    def arguments(self) -> tuple[cl.Buffer, int]:
        """As kernels take it."""
        return self.buffer, self.stride


@dataclass(frozen=True)
class Tables:
    """What a chunk of bodies multiplies by, axis by axis (three axes always, see `ABSENT`)."""

    forward: tuple[Table, ...]  # (parts, rows, half); the last axis (parts, half, rows): it multiplies from the right
    adjoint: tuple[Table, ...]  # the transposes
    masks: tuple[Table, ...]  # (n,)
    phases: cl.Buffer  # (N1+1 + N2+1 + N3+1) complex per body
    zero: Table | None  # (n1,) complex

    @staticmethod
    def of(runtime: Runtime, spec: TensorSpec, cuts: Sequence[Layout], bodies: slice) -> Tables:
        """Computed in float64 for this range of bodies and copied to the device."""
        real = np.dtype(spec.dtype)
        pairs = np.result_type(real, np.complex64)
        own = list(zip(spec.axes, cuts, strict=True))
        forward = [matrices(axis, cut, bodies) for axis, cut in own]
        factors = [masks(axis, bodies) for axis, _ in own]
        turns = [phases(axis, cut, bodies) for axis, cut in own]
        if len(own) == 2:
            forward.insert(1, np.ones((1, 1, 1, 1)))
            factors.insert(1, np.ones((1, 1)))
            turns.insert(1, np.ones((1, 1)))
        transposed = [matrix.swapaxes(2, 3) for matrix in forward]
        forward[2], transposed[2] = transposed[2], forward[2]
        # One set of phases per body always: they are small, and kernels then need no stride.
        count = bodies.stop - bodies.start
        together = np.concatenate([np.broadcast_to(turn, (count, turn.shape[1])) for turn in turns], axis=1)
        return Tables(
            forward=tuple(Table.of(runtime, matrix, real) for matrix in forward),
            adjoint=tuple(Table.of(runtime, matrix, real) for matrix in transposed),
            masks=tuple(Table.of(runtime, factor, real) for factor in factors),
            phases=runtime.constant(together.astype(pairs)),
            zero=None if spec.zero is None else Table.of(runtime, zero_row(spec, bodies), pairs),
        )


def layout(axis: TensorAxis, dtype: np.dtype[Any], most: int) -> Layout:
    """The finest cut that the points allow, of `most` parts at most."""
    n, reach = axis.size, abs(axis.step) * axis.order
    if n == 1 or most == 1:
        return Layout(n, axis.order, 1)
    points, slack = np.atleast_2d(axis.points), _slack(axis, dtype)
    centre = _centres(points)
    if reach * np.abs(points + points[:, ::-1] - 2 * centre[:, None]).max() > slack:
        return Layout(n, axis.order, 1)
    left = points[:, : n // 2]
    spans_period = n % 4 == 0 and reach * np.abs(left + left[:, ::-1] + np.pi / abs(axis.step)).max() <= slack
    centred = reach * np.abs(centre).max() <= slack
    return Layout(n, axis.order, min(most, 4 if spans_period and centred else 2))


def matrices(axis: TensorAxis, cut: Layout, bodies: slice) -> Array:
    """w_m times cos or sin of m step (x - centre), float64, shape (bodies or 1, parts, rows, half).

    The centre is 0 with 1 part, and the mask then multiplies; otherwise `masks` holds it.
    """
    points = _part(axis.points, bodies)
    weights = _part(axis.weights, bodies)[:, axis.order :]
    # Mirrored pairs share one angle. Not used with 1 part, where points need not be in pairs.
    y = ((points - points[:, ::-1]) / 2)[:, : cut.half]
    every, even, odd = (np.arange(start, axis.order + 1, step) for start, step in ((0, 1), (0, 2), (1, 2)))
    rows: dict[int, list[tuple[Callable[[Array], Array], Array, Array]]] = {
        1: [(np.cos, every, points), (np.sin, every, points)],
        2: [(np.cos, every, y), (np.sin, every, y)],
        4: [(np.cos, even, y), (np.cos, odd, y), (np.sin, odd, y), (np.sin, even, y)],
    }
    made = [
        _padded_rows(weights[:, m, None] * trigonometric(axis.step * m[:, None] * at[:, None, :]), cut)
        for trigonometric, m, at in rows[cut.parts]
    ]
    if cut.parts == 1:
        return np.concatenate(made, axis=1)[:, None] * masks(axis, bodies)[:, None, None, :]
    return np.stack(np.broadcast_arrays(*made), axis=1)


def masks(axis: TensorAxis, bodies: slice) -> Array:
    """The mask as factors 0 and 1, float64, shape (bodies or 1, n)."""
    return np.ones((1, axis.size)) if axis.mask is None else _part(axis.mask, bodies).astype(np.float64)


def centres(axis: TensorAxis, cut: Layout, bodies: slice) -> Array:
    """Where each body's matrix counts its angles from [m], shape (bodies or 1,); 0 where nothing is folded."""
    points = _part(axis.points, bodies)
    return _centres(points) if cut.parts == 2 else np.zeros(len(points))


def phases(axis: TensorAxis, cut: Layout, bodies: slice) -> Array:
    """exp(-i m step centre) for m = 0..N, complex128, shape (bodies or 1, N + 1)."""
    angles = axis.step * np.arange(axis.order + 1) * centres(axis, cut, bodies)[:, None]
    return np.asarray(np.exp(-1j * angles))


def is_shifted(axis: TensorAxis, cut: Layout, dtype: np.dtype[Any]) -> bool:
    """Whether leaving out `phases` would show in `dtype`."""
    reach = abs(axis.step) * axis.order
    return bool(reach * np.abs(centres(axis, cut, slice(None))).max() > _slack(axis, dtype))


def zero_row(spec: TensorSpec, bodies: slice) -> Array:
    """weight · exp(-i κ0 x) on the unmasked points of the first axis, complex128, shape (bodies or 1, n1)."""
    zero, axis = spec.zero, spec.axes[0]
    assert zero is not None
    weight = _part(np.reshape(zero.weight, (-1, 1)), bodies)
    row = weight * np.exp(-1j * zero.kappa * _part(axis.points, bodies))
    return np.asarray(row * masks(axis, bodies))


def _slack(axis: TensorAxis, dtype: np.dtype[Any]) -> float:
    """By how much the greatest angle may change [rad]: a few roundings of a coordinate, or an eighth of epsilon."""
    # A masked point far away has no matrix entry, and must not excuse those that have.
    counted = np.abs(axis.points) if axis.mask is None else np.where(axis.mask, np.abs(axis.points), 0)
    greatest = abs(axis.step) * axis.order * float(counted.max())
    return float(max(np.finfo(dtype).eps / 8, 4 * np.finfo(np.float64).eps * greatest))


def _centres(points: Array) -> Array:
    return np.asarray((points[:, 0] + points[:, -1]) / 2)


def _part(array: Array, bodies: slice) -> Array:
    array = np.atleast_2d(array)
    return array[bodies] if len(array) > 1 else array


def _padded_rows(matrix: Array, cut: Layout) -> Array:
    missing = cut.rows - matrix.shape[1] if cut.parts > 1 else 0
    return np.pad(matrix, ((0, 0), (0, missing), (0, 0)))
