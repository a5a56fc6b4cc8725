"""FINUFFT in its three types, plans and points kept, as many transforms in a plan as there are bodies.

Both upsampling factors are tried where FINUFFT allows them; at 1.25 it needs fewer operations but, in float32,
cannot reach every accuracy that can be asked for, so the measured error decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

import accel_shapegen as asg

from ..contest import Array, Run
from ..machine import thread_count
from .lattice import LatticeSum

UPSAMPLING = (2.0, 1.25)

Prepare = Callable[[float], Run]


def variants(prepare: Prepare) -> dict[str, Callable[[], Run]]:
    """One per upsampling factor."""
    return {f"upsampfac={factor}": partial(prepare, factor) for factor in UPSAMPLING}


def plan(kind: int, modes: Any, count: int, eps: float, sign: int, dtype: Any, factor: float) -> Any:
    """A FINUFFT plan for `count` transforms at once with all threads."""
    import finufft

    options = {"nthreads": thread_count(), "upsampfac": factor}
    return finufft.Plan(kind, modes, n_trans=count, eps=eps, isign=sign, dtype=np.dtype(dtype).name, **options)


def type2_synthesis(problem: LatticeSum, u: Array, out: Array, eps: float) -> Prepare:
    """The lattice's coefficients at all grid points, real part taken: Hermitian or not, no folding is needed."""

    def prepare(factor: float) -> Run:
        transform = plan(2, problem.lattice.shape, len(u), eps, +1, u.dtype, factor)
        steps = problem.lattice.step
        points = [step * axis for step, axis in zip(steps, problem.grid.axes, strict=True)]
        transform.setpts(*_flat_mesh(points, problem.real_dtype))
        coefficients, field = np.empty_like(u), np.empty((len(u), out[0].size), u.dtype)
        i, j, k = problem.lattice.zero_slot
        scale = u.dtype.type(problem.coefficient)

        def run() -> Array:
            np.multiply(u, scale, out=coefficients)
            coefficients[:, i, j, k] = problem.line(u) @ problem.zero_form
            transform.execute(_stack(coefficients), out=_stack(field))
            np.copyto(out.reshape(len(u), -1), field.real)
            return out

        return run

    return prepare


def type1_far_field(problem: LatticeSum, values: Array, out: Array, eps: float) -> Prepare:
    """Voxels that any body fills, as points of strength; the zero node by itself, from the projection on its axis."""

    def prepare(factor: float) -> Run:
        transform = plan(1, problem.lattice.shape, len(values), eps, -1, out.dtype, factor)
        filled = np.flatnonzero(values.any(axis=0))
        points = [step * axis for step, axis in zip(problem.lattice.step, problem.grid.axes, strict=True)]
        transform.setpts(*(axis[filled] for axis in _flat_mesh(points, problem.real_dtype)))
        cells = [problem.cell(axis, -order) for axis, order in enumerate(problem.lattice.order)]
        weights = (problem.constant * cells[0][:, None, None] * cells[1][:, None] * cells[2]).astype(problem.real_dtype)
        row = np.repeat(problem.zero_row(), values[0, 0].size)[filled].astype(out.dtype)
        rows, (i, j, k) = values.reshape(len(values), -1), problem.lattice.zero_slot
        strengths = np.empty((len(values), filled.size), out.dtype)

        def run() -> Array:
            strengths[...] = rows if filled.size == rows.shape[1] else rows[:, filled]
            transform.execute(_stack(strengths), out=_stack(out))
            np.multiply(out, weights, out=out)
            out[:, i, j, k] = strengths @ row
            return out

        return run

    return prepare


def type2_scattered(grid: asg.Grid, nodes: asg.ScatteredNodes, values: Array, out: Array, eps: float) -> Prepare:
    """Voxels as Fourier coefficients, cropped to the box that holds all bodies, and the nodes as points."""

    def prepare(factor: float) -> Run:
        window = _bounding_window(values)
        cropped = values[(slice(None), *window)]
        transform = plan(2, cropped.shape[1:], len(values), eps, -1, out.dtype, factor)
        spacing = np.asarray(grid.spacing)
        angles = nodes.kappa * spacing
        transform.setpts(*(np.ascontiguousarray(a) for a in angles.T.astype(values.dtype)))
        # FINUFFT counts modes of an axis of n from -(n // 2) on.
        middle = [axis[part][(part.stop - part.start) // 2] for axis, part in zip(grid.axes, window, strict=True)]
        weights = (voxel_weights(nodes, spacing) * np.exp(-1j * nodes.kappa @ np.array(middle))).astype(out.dtype)
        modes = np.empty(cropped.shape, out.dtype)

        def run() -> Array:
            modes[...] = cropped
            transform.execute(_stack(modes), out=_stack(out))
            np.multiply(out, weights, out=out)
            return out

        return run

    return prepare


def type3_scattered(grid: asg.Grid, nodes: asg.ScatteredNodes, values: Array, out: Array, eps: float) -> Prepare:
    """Voxels that any body fills, as points of strength, to the nodes as frequencies."""

    def prepare(factor: float) -> Run:
        transform = plan(3, 3, len(values), eps, -1, out.dtype, factor)
        filled = np.flatnonzero(values.any(axis=0))
        points = [axis[filled] for axis in _flat_mesh(grid.axes, values.dtype)]
        transform.setpts(*points, *(np.ascontiguousarray(a) for a in nodes.kappa.T.astype(values.dtype)))
        weights = voxel_weights(nodes, np.asarray(grid.spacing)).astype(values.dtype)
        rows = values.reshape(len(values), -1)
        strengths = np.empty((len(values), filled.size), out.dtype)

        def run() -> Array:
            strengths[...] = rows if filled.size == rows.shape[1] else rows[:, filled]
            transform.execute(_stack(strengths), out=_stack(out))
            np.multiply(out, weights, out=out)
            return out

        return run

    return prepare


def voxel_weights(nodes: asg.ScatteredNodes, spacing: Array) -> Array:
    """C Π_j h_j sinc(κ_j h_j/2π) per node, real in 3-D."""
    voxel = np.prod(spacing * np.sinc(nodes.kappa * spacing / (2 * np.pi)), axis=1)
    return np.asarray(voxel * asg.far_field_constant(nodes.wavenumbers, 3).real)


def _bounding_window(values: Array) -> tuple[slice, ...]:
    filled = np.argwhere(values.any(axis=0))
    first, last = filled.min(axis=0), filled.max(axis=0)
    return tuple(slice(int(low), int(high) + 1) for low, high in zip(first, last, strict=True))


def _flat_mesh(axes: Sequence[Array], dtype: Any) -> list[Array]:
    return [part.ravel().astype(dtype) for part in np.meshgrid(*axes, indexing="ij")]


def _stack(array: Array) -> Array:
    """FINUFFT wants no leading axis for a single transform."""
    return array[0] if len(array) == 1 else array
