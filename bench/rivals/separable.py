"""NumPy: both lattice sums as real matrix products, one axis after the other, on half the lattice.

The field is real, so ξ1 ≥ 0 carries everything. cos and sin along the first two axes keep the products real and
need no more of them than there are numbers; along the third, complex numbers are read as pairs of reals. A complex
matrix product per axis takes 1.5 times as long, contracting x before z about as long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ..contest import Array, Run
from ..machine import thread_count, thread_pool
from .lattice import LatticeSum

Step = Callable[[Array, Array], None]  # fills the second array from the first, bodies along the first axis


class Synthesis:
    """u (b, *lattice) → out (b, *grid), for up to `bodies` at a time in buffers of its own."""

    def __init__(self, problem: LatticeSum, bodies: int) -> None:
        n1, n2, n3 = problem.grid.shape
        o1, o2, o3 = self._order = problem.lattice.order
        self._problem = problem
        real = problem.real_dtype
        self._x = _pairs(problem.angles(0, 0)).reshape(-1, n1).T.astype(real, order="C")
        self._y = _cos_sin(problem.angles(1, 0)).T.astype(real, order="C")
        cos, sin = (problem.coefficient * part(problem.angles(2, -o3)) for part in (np.cos, np.sin))
        # Rows: real and imaginary part of a coefficient. Columns: real part, then minus the imaginary part, per z.
        self._z = np.stack([np.hstack([cos, -sin]), np.hstack([-sin, -cos])], axis=1).reshape(-1, 2 * n3).astype(real)
        # The coefficient is in the matrix of z already.
        self._zero_form = problem.zero_form / problem.coefficient
        self._half = np.zeros((bodies, o1 + 1, 2 * o2 + 1, 2 * o3 + 1), problem.complex_dtype)
        self._folded = np.zeros_like(self._half)
        self._after_z = np.zeros((bodies, o1 + 1, 2 * o2 + 1, 2, n3), real)
        self._after_y = np.zeros((bodies, o1 + 1, 2, n2, n3), real)

    def __call__(self, u: Array, out: Array) -> None:
        b = len(u)
        self._fold(u, self._half[:b], self._folded[:b])
        z, y = self._after_z[:b], self._after_y[:b]
        pairs = self._folded[:b].view(z.dtype).reshape(-1, self._z.shape[0])
        np.matmul(pairs, self._z, out=z.reshape(-1, self._z.shape[1]))
        np.matmul(self._y, z.swapaxes(2, 3), out=y)
        np.matmul(self._x, y.reshape(b, self._x.shape[1], -1), out=out.reshape(b, len(self._x), -1))

    def _fold(self, u: Array, half: Array, folded: Array) -> None:
        """Add each ξ to the conjugate of -ξ, then ξ2 to -ξ2 (for cos) and subtract (for sin)."""
        o1, o2, o3 = self._order
        np.conj(u[:, o1 - 1 :: -1, ::-1, ::-1], out=half[:, 1:])
        half[:, 1:] += u[:, o1 + 1 :]
        half[:, 0] = u[:, o1]
        half[:, 0, o2, o3] = self._problem.line(u) @ self._zero_form
        plus, minus, sines = half[:, :, o2 + 1 :], half[:, :, o2 - 1 :: -1], folded[:, :, o2 + 1 :]
        folded[:, :, 0] = half[:, :, o2]
        np.add(plus, minus, out=folded[:, :, 1 : o2 + 1])
        np.subtract(plus, minus, out=sines)
        sines *= half.dtype.type(1j)


class FarField:
    """values (b, *grid) → out (b, *lattice): the transpose of the synthesis, with the zero node as one more row."""

    def __init__(self, problem: LatticeSum, bodies: int) -> None:
        n1, n2, n3 = problem.grid.shape
        o1, o2, o3 = self._order = problem.lattice.order
        real = problem.real_dtype
        zero = problem.zero_row()
        x = _pairs(problem.angles(0, 0)) * problem.cell(0, 0)[:, None, None]
        self._x = np.concatenate([x.reshape(-1, n1), [zero.real, zero.imag]]).astype(real)
        y_cell = np.concatenate([problem.cell(1, 0), problem.cell(1, 1)])
        self._y = (_cos_sin(problem.angles(1, 0)) * y_cell[:, None]).astype(real)
        z_cell = problem.constant * problem.cell(2, -o3)[:, None]
        cos, sin = (z_cell * part(problem.angles(2, -o3)) for part in (np.cos, np.sin))
        # Rows: the cos(κ1 x) part per z, then the sin part. Columns: real and imaginary part of a node.
        z = np.stack([np.hstack([cos, -sin]), np.hstack([-sin, -cos])], axis=1)
        self._z = z.reshape(-1, 2 * n3).T.astype(real, order="C")
        self._after_x = np.zeros((bodies, len(self._x), n2, n3), real)
        self._after_y = np.zeros((bodies, o1 + 1, 2 * o2 + 1, 2, n3), real)
        self._half = np.zeros((bodies, o1 + 1, 2 * o2 + 1, 2 * o3 + 1), problem.complex_dtype)

    def __call__(self, values: Array, out: Array) -> None:
        b, n1 = len(values), self._x.shape[1]
        o1, o2, o3 = self._order
        x, y, half = self._after_x[:b], self._after_y[:b], self._half[:b]
        np.matmul(self._x, values.reshape(b, n1, -1), out=x.reshape(b, len(self._x), -1))
        np.matmul(self._y, x[:, :-2].reshape(b, o1 + 1, 2, *x.shape[2:]), out=y.swapaxes(2, 3))
        pairs = half.view(x.dtype).reshape(-1, self._z.shape[1])
        np.matmul(y.reshape(-1, self._z.shape[0]), self._z, out=pairs)
        self._unfold(half, out)
        # NumPy's own sum loses less than a product with ones: the projection may all but cancel.
        zero = x[:, -2:].sum(axis=-1).sum(axis=-1)
        out[:, o1, o2, o3] = zero[:, 0] + 1j * zero[:, 1]

    def _unfold(self, half: Array, out: Array) -> None:
        """cos - i sin and cos + i sin for ξ2 and -ξ2, then the conjugates for ξ1 < 0."""
        o1, o2, _ = self._order
        cosines, sines, upper = half[:, :, 1 : o2 + 1], half[:, :, o2 + 1 :], out[:, o1:]
        sines *= half.dtype.type(1j)
        upper[:, :, o2] = half[:, :, 0]
        np.subtract(cosines, sines, out=upper[:, :, o2 + 1 :])
        np.add(cosines, sines, out=upper[:, :, o2 - 1 :: -1])
        np.conj(out[:, :o1:-1, ::-1, ::-1], out=out[:, :o1])


def variants(make: Callable[[int], Step], source: Array, out: Array) -> dict[str, Callable[[], Run]]:
    """Bodies one by one and a few at once with the BLAS's threads, or one in each of as many threads."""
    return {
        "one body at a time": partial(_in_turn, make, source, out, 1),
        "4 bodies at a time": partial(_in_turn, make, source, out, 4),
        "a thread per body": partial(_in_threads, make, source, out),
    }


def _in_turn(make: Callable[[int], Step], source: Array, out: Array, bodies: int) -> Run:
    step = make(min(bodies, len(source)))

    def run() -> Array:
        for start in range(0, len(source), bodies):
            step(source[start : start + bodies], out[start : start + bodies])
        return out

    return run


def _in_threads(make: Callable[[int], Step], source: Array, out: Array) -> Run:
    from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

    threads = thread_count()
    controller, pool, steps = ThreadpoolController(), thread_pool(), [make(1) for _ in range(threads)]

    def share(thread: int) -> None:
        for body in range(thread, len(source), threads):
            steps[thread](source[body : body + 1], out[body : body + 1])

    def run() -> Array:
        with controller.limit(limits=1, user_api="blas"):
            list(pool.map(share, range(threads)))
        return out

    return run


def _pairs(angles: Array) -> Array:
    """cos and sin, side by side per frequency: (rows, 2, n)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _cos_sin(angles: Array) -> Array:
    """cos of all frequencies from 0 on, then sin of those from 1 on: (2 rows - 1, n)."""
    return np.concatenate([np.cos(angles), np.sin(angles[1:])])
