"""SciPy's FFT: exact for a grid of equal cells that fill the lattice's box, of at least 2N+1 cells per axis.

Cell centres lie half a cell off the points of an FFT: a phase per frequency. The transforms are real ones, so the
third axis needs ξ3 ≥ 0 only. `pruned` skips the columns of zeros that a padded transform would pay for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.fft

from ..contest import Array, Run
from ..machine import thread_count
from .lattice import LatticeSum

FFT: Any = scipy.fft  # its types tell apart precisions that are the caller's choice here


class _Layout:
    """Where a centred frequency lies in the order of an FFT, and the phases of the half lattice ξ3 ≥ 0."""

    def __init__(self, problem: LatticeSum) -> None:
        self.order, self.n, self.problem = problem.lattice.order, problem.grid.shape, problem
        for axis, (o, n) in enumerate(zip(self.order, self.n, strict=True)):
            if n < 2 * o + 1:
                raise ValueError(f"{n} cells on axis {axis} are fewer than {2 * o + 1} frequencies: an FFT aliases")
        phases = [
            np.exp(1j * np.pi * (1 - n) / n * np.arange(-o, o + 1)) for o, n in zip(self.order, self.n, strict=True)
        ]
        self.phase = phases[0][:, None, None] * phases[1][:, None] * phases[2][self.order[2] :]

    def spread(self, half: Array, padded: Array, axis: int) -> None:
        """Centred frequencies to the two ends of a longer axis (1 or 2); the middle of `padded` stays 0."""
        o, lead = self.order[axis - 1], (slice(None),) * axis
        padded[(*lead, slice(0, o + 1))] = half[(*lead, slice(o, None))]
        padded[(*lead, slice(-o, None))] = half[(*lead, slice(0, o))]

    def gather(self, padded: Array, half: Array, axis: int) -> None:
        """The inverse: the frequencies at the two ends of a longer axis, centred."""
        o, lead = self.order[axis - 1], (slice(None),) * axis
        half[(*lead, slice(o, None))] = padded[(*lead, slice(0, o + 1))]
        half[(*lead, slice(0, o))] = padded[(*lead, slice(-o, None))]


class Synthesis:
    """u (b, *lattice) → field (b, *grid), for exactly `bodies` at a time."""

    def __init__(self, problem: LatticeSum, bodies: int, pruned: bool) -> None:
        self._layout = layout = _Layout(problem)
        (o1, o2, o3), (n1, n2, n3) = layout.order, layout.n
        dtype = problem.complex_dtype
        # Half, since a coefficient is added to the conjugate of its mirror.
        self._weights = (layout.phase * problem.coefficient / 2).astype(dtype)
        self._half = np.zeros((bodies, 2 * o1 + 1, 2 * o2 + 1, o3 + 1), dtype)
        self._first = np.zeros((bodies, n1, 2 * o2 + 1, o3 + 1), dtype)
        self._padded = np.zeros((bodies, n1, n2, o3 + 1 if pruned else n3 // 2 + 1), dtype)
        self._pruned = pruned

    def __call__(self, u: Array) -> Array:
        layout, half, problem = self._layout, self._half, self._layout.problem
        o1, o2, o3 = layout.order
        np.conj(u[:, ::-1, ::-1, o3::-1], out=half)
        half += u[..., o3:]
        half *= self._weights
        half[:, o1, o2, 0] = (problem.line(u) @ problem.zero_form).real
        threads, scaling = thread_count(), "forward"  # none on the way back
        if self._pruned:
            layout.spread(half, self._first, 1)
            lines = FFT.ifft(self._first, axis=1, norm=scaling, workers=threads)
            layout.spread(lines, self._padded, 2)
            planes = FFT.ifft(self._padded, axis=2, norm=scaling, workers=threads)
            return FFT.irfft(planes, n=layout.n[2], axis=3, norm=scaling, workers=threads)
        layout.spread(half, self._first, 1)
        layout.spread(self._first, self._padded[..., : o3 + 1], 2)
        return FFT.irfftn(self._padded, s=layout.n, axes=(1, 2, 3), norm=scaling, workers=threads)


class FarField:
    """values (b, *grid) → u (b, *lattice), for exactly `bodies` at a time."""

    def __init__(self, problem: LatticeSum, bodies: int, pruned: bool) -> None:
        self._layout = layout = _Layout(problem)
        (o1, o2, o3), (n1, _, _) = layout.order, layout.n
        dtype = problem.complex_dtype
        cells = [problem.cell(axis, least) for axis, least in enumerate((-o1, -o2, 0))]
        voxel = problem.constant * cells[0][:, None, None] * cells[1][:, None] * cells[2]
        self._weights = (layout.phase.conj() * voxel).astype(dtype)
        # The line ξ2 = ξ3 = 0 holds the body's projection on the first axis, and that holds the zero node.
        self._zero = np.fft.ifft(problem.zero_row()).astype(dtype)
        self._first = np.zeros((bodies, n1, 2 * o2 + 1, o3 + 1), dtype)
        self._half = np.zeros((bodies, 2 * o1 + 1, 2 * o2 + 1, o3 + 1), dtype)
        self._pruned = pruned

    def __call__(self, values: Array, out: Array) -> Array:
        layout, first, half, threads = self._layout, self._first, self._half, thread_count()
        o1, o2, o3 = layout.order
        if self._pruned:
            rows = FFT.rfft(values, axis=3, workers=threads)[..., : o3 + 1]
            layout.gather(FFT.fft(rows, axis=2, workers=threads), first, 2)
            spectrum = FFT.fft(first, axis=1, workers=threads)
            layout.gather(spectrum, half, 1)
            line = spectrum[:, :, o2, 0]
        else:
            spectrum = FFT.rfftn(values, axes=(1, 2, 3), workers=threads)
            layout.gather(spectrum[..., : o3 + 1], first, 2)
            layout.gather(first, half, 1)
            line = spectrum[:, :, 0, 0]
        np.multiply(half, self._weights, out=out[..., o3:])
        np.conj(out[:, ::-1, ::-1, :o3:-1], out=out[..., :o3])
        out[:, o1, o2, o3] = line @ self._zero
        return out


def synthesis_variants(problem: LatticeSum, u: Array, out: Array, pruned: bool) -> dict[str, Callable[[], Run]]:
    """Bodies one by one, or a few in one call; SciPy makes its own output each time."""

    def prepare(bodies: int) -> Run:
        step = Synthesis(problem, bodies, pruned)
        if bodies == len(u):
            return lambda: step(u)

        def run() -> Array:
            for start in range(0, len(u), bodies):
                out[start : start + bodies] = step(u[start : start + bodies])
            return out

        return run

    return {f"{bodies} bodies a call": partial(prepare, bodies) for bodies in sorted({1, len(u)})}


def far_field_variants(problem: LatticeSum, values: Array, out: Array, pruned: bool) -> dict[str, Callable[[], Run]]:
    """Bodies one by one, or a few in one call."""

    def prepare(bodies: int) -> Run:
        step = FarField(problem, bodies, pruned)

        def run() -> Array:
            for start in range(0, len(values), bodies):
                step(values[start : start + bodies], out[start : start + bodies])
            return out

        return run

    return {f"{bodies} bodies a call": partial(prepare, bodies) for bodies in sorted({1, len(values)})}
