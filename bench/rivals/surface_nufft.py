"""FINUFFT on the quadrature points of closed meshes: type 1, from points of strength to the lattice.

Points and strengths are given; what is timed for a body is sorting its points, the transform, and the division. Either
only the normal's component n_z is transformed, û = (i/κ_z) Σ n_z w exp(-iκ·y), and in the plane κ_z = 0 the sum of
z n_z w in two dimensions; or all three, û = (i/|κ|²) Σ (κ·n) w exp(-iκ·y).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

import accel_shapegen as asg

from ..contest import Array, Run
from .nufft import Prepare, plan


@dataclass(frozen=True)
class Points:
    """Quadrature points of a mesh (P, 3) [m], n dS there (P, 3) [m²], and the axis of n_z, not the first."""

    places: Array
    flux: Array
    axis: int


def one_component(lattice: asg.FourierLattice, bodies: Sequence[Points], out: Array, eps: float) -> Prepare:
    """One transform in space and one in the plane."""

    def prepare(factor: float) -> Run:
        axis = bodies[0].axis
        order = [*(j for j in range(3) if j != axis), axis]
        shape = tuple(lattice.shape[j] for j in order)
        space = plan(1, shape, 1, eps, -1, out.dtype, factor)
        flat = plan(1, shape[:2], 1, eps, -1, out.dtype, factor)
        data = [_columns(lattice, body, order, out.dtype) for body in bodies]
        kappa = lattice.step[axis] * np.arange(-lattice.order[axis], lattice.order[axis] + 1)
        weights = (1j / np.where(kappa == 0, 1, kappa) * _constant(lattice)).astype(out.dtype)
        constant = out.dtype.type(_constant(lattice))
        middle = lattice.order[axis]

        def run() -> Array:
            for target, (angles, strength, moment, zero) in zip(out, data, strict=False):
                space.setpts(*angles)
                flat.setpts(*angles[:2])
                result = space.execute(strength) * weights
                result[:, :, middle] = flat.execute(moment) * constant
                target[...] = np.moveaxis(result, -1, axis)
                target[lattice.zero_slot] = zero
            return out[: len(data)]

        return run

    return prepare


def three_components(lattice: asg.FourierLattice, bodies: Sequence[Points], out: Array, eps: float) -> Prepare:
    """Three transforms."""

    def prepare(factor: float) -> Run:
        transform = plan(1, lattice.shape, 3, eps, -1, out.dtype, factor)
        data = [_columns(lattice, body, [0, 1, 2], out.dtype) for body in bodies]
        flux = [np.ascontiguousarray(body.flux.T).astype(out.dtype) for body in bodies]
        square = (lattice.kappa**2).sum(axis=-1)
        weights = (1j * _constant(lattice) * lattice.kappa / square[..., None]).astype(out.dtype)
        weights = np.ascontiguousarray(np.moveaxis(weights, -1, 0))

        def run() -> Array:
            for target, (angles, _, _, zero), strength in zip(out, data, flux, strict=False):
                transform.setpts(*angles)
                target[...] = (transform.execute(strength) * weights).sum(axis=0)
                target[lattice.zero_slot] = zero
            return out[: len(data)]

        return run

    return prepare


def variants(kind: str, *arguments: object) -> dict[str, partial[Run]]:
    """One per upsampling factor, of `one_component` or `three_components`."""
    prepare = {"one component": one_component, "three components": three_components}[kind](*arguments)  # type: ignore[arg-type]
    return {f"upsampfac={factor}": partial(prepare, factor) for factor in (2.0, 1.25)}


def _columns(
    lattice: asg.FourierLattice, body: Points, order: list[int], dtype: np.dtype[np.complexfloating]
) -> tuple[list[Array], Array, Array, complex]:
    """Angles per axis, strengths, strengths times place along the axis, and the zero node."""
    real = np.empty(0, dtype).real.dtype
    angles = [np.ascontiguousarray(body.places[:, j] * lattice.step[j]).astype(real) for j in order]
    strength, along = body.flux[:, body.axis], body.places[:, body.axis]
    # The zero node lies in the plane κ_z = 0.
    zero = (strength * along) @ np.exp(-1j * lattice.zero_kappa * body.places[:, 0]) * _constant(lattice)
    return angles, strength.astype(dtype), (strength * along).astype(dtype), complex(zero)


def _constant(lattice: asg.FourierLattice) -> float:
    return float(asg.far_field_constant(1.0, lattice.dim).real)
