"""For tests, ours and other backends': closed-form transforms, and errors as this package measures them.

All transforms are ∫_D exp(-iκ·y) dy in float64 at nodes κ [rad/m] of shape (..., d); multiply by
`far_field_constant` for u∞. κ = 0 is allowed and gives the volume.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Complex = NDArray[np.complex128]


def box_transform(lengths: Sequence[float], kappa: ArrayLike, centre: ArrayLike = 0.0) -> Complex:
    """Box or rectangle with these side lengths [m]: Π_j e_j sinc(κ_j e_j/2π), times exp(-iκ·c)."""
    nodes = np.asarray(kappa, dtype=np.float64)
    sides = np.asarray(lengths, dtype=np.float64)
    return _moved(np.prod(sides * np.sinc(nodes * sides / (2 * np.pi)), axis=-1), nodes, centre)


def ellipsoid_transform(radii: Sequence[float], kappa: ArrayLike, centre: ArrayLike = 0.0) -> Complex:
    """Ellipsoid (three radii [m]) or ellipse (two): with t = |(κ_j r_j)_j|,

    4π r1 r2 r3 (sin t - t cos t)/t³  or  2π r1 r2 J1(t)/t,  times exp(-iκ·c).
    """
    from scipy.special import j1, spherical_jn

    nodes = np.asarray(kappa, dtype=np.float64)
    r: NDArray[np.float64] = np.asarray(radii, dtype=np.float64)
    t = np.sqrt(((nodes * r) ** 2).sum(axis=-1))
    safe = np.where(t == 0, 1.0, t)
    if len(r) == 3:
        # j1(t)/t with the spherical Bessel function is (sin t - t cos t)/t³, without its cancellation.
        value = 4 * np.pi * np.prod(r) * np.where(t == 0, 1 / 3, spherical_jn(1, safe) / safe)
    else:
        value = 2 * np.pi * np.prod(r) * np.where(t == 0, 1 / 2, j1(safe) / safe)
    return _moved(value, nodes, centre)


def relative_error(value: ArrayLike, exact: ArrayLike) -> float:
    """‖value - exact‖₂ / ‖exact‖₂ over everything, in float64; NaN counts as infinite."""
    a, b = np.asarray(value), np.asarray(exact)
    error = float(np.linalg.norm((a.astype(np.complex128) - b).ravel()) / np.linalg.norm(b.ravel()))
    return error if np.isfinite(error) else float("inf")


def off_centre(u: ArrayLike, zero_slot: tuple[int, ...]) -> NDArray[np.generic]:
    """A lattice array (..., *shape) without its zero slot: the slots that far-field errors are measured over.

    The zero slot is one to two orders larger than all others and would hide their errors.
    """
    array = np.asarray(u)
    shape = array.shape[array.ndim - len(zero_slot) :]
    flat = array.reshape(-1, int(np.prod(shape)))
    return np.delete(flat, np.ravel_multi_index(zero_slot, shape), axis=1)


def dot_test(forward: Complex, u: ArrayLike, values: ArrayLike, adjoint: ArrayLike) -> float:
    """|Re⟨A v, u⟩ - ⟨v, A* u⟩| relative to ‖A v‖ ‖u‖, given A v, u, v and A* u."""
    left = np.vdot(np.asarray(forward, dtype=np.complex128), u).real
    right = np.vdot(np.asarray(values, dtype=np.complex128), adjoint).real
    scale = float(np.linalg.norm(np.ravel(forward)) * np.linalg.norm(np.ravel(np.asarray(u))))
    return float(abs(left - right)) / scale


def _moved(value: NDArray[np.float64], kappa: NDArray[np.float64], centre: ArrayLike) -> Complex:
    place = np.broadcast_to(np.asarray(centre, dtype=np.float64), kappa.shape[-1:])
    return np.asarray(value * np.exp(-1j * kappa @ place), dtype=np.complex128)
