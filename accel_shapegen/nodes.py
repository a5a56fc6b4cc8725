"""Where a far field is known: the admissible lattice, scattered receivers, and the constant between them and f̂.

A node is an observation direction x̂ with a wavenumber k; it is met everywhere as the vector κ = k x̂ [rad/m].
Source: J. Li, H. Liu, W.-Y. Tsui, X. Wang, "An inverse scattering approach for geometric body generation" (2020).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ArgumentError, DtypeError, ShapeError
from .geometry import Box


@dataclass(frozen=True)
class FourierLattice:
    """The admissible lattice of order N on a box: ξ_j = -N_j..N_j, κ_j = 2π ξ_j / a_j, C order.

    The slot ξ = 0 has no wavenumber k > 0; it holds the *zero node* at ξ0 = (μ, 0[, 0]) instead, so its κ here
    is (2πμ/a_1, 0[, 0]).

    Parameters
    ----------
    box : Box
        V0, side lengths a_j [m].
    order : int or sequence of int
        N_j ≥ 1, one for all axes or one per axis.
    mu : float
        Position of the zero node, 0 < μ < 1.
    """

    box: Box
    order: tuple[int, ...]
    mu: float = 0.01

    def __init__(self, box: Box, order: int | Sequence[int], mu: float = 0.01) -> None:
        if not isinstance(box, Box):
            raise DtypeError("box", f"is a {type(box).__name__}", "give a Box")
        if not _is_real(mu) or not 0 < mu < 1:
            raise ArgumentError("mu", f"is {mu!r}", "give 0 < mu < 1")
        object.__setattr__(self, "box", box)
        object.__setattr__(self, "order", arguments.counts("order", order, box.dim))
        object.__setattr__(self, "mu", float(mu))

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.box.dim

    @property
    def shape(self) -> tuple[int, ...]:
        """(2N_1+1, 2N_2+1[, 2N_3+1])."""
        return tuple(2 * n + 1 for n in self.order)

    @property
    def size(self) -> int:
        """Number of nodes, zero node included."""
        return math.prod(self.shape)

    @property
    def zero_slot(self) -> tuple[int, ...]:
        """Index of the slot ξ = 0."""
        return self.order

    @property
    def step(self) -> tuple[float, ...]:
        """Lattice constant 2π/a_j [rad/m] per axis."""
        return tuple(2 * math.pi / a for a in self.box.lengths)

    @property
    def zero_kappa(self) -> float:
        """Wavenumber 2πμ/a_1 [rad/m] of the zero node; its direction is the first axis."""
        return self.mu * self.step[0]

    @cached_property
    def xi(self) -> NDArray[np.int64]:
        """ξ, shape (*shape, dim); zero in the zero slot."""
        axes = [np.arange(-n, n + 1) for n in self.order]
        return _read_only(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))

    @cached_property
    def kappa(self) -> NDArray[np.float64]:
        """κ = k x̂ [rad/m], shape (*shape, dim); the zero node in the zero slot."""
        kappa = self.xi * np.array(self.step)
        kappa[self.zero_slot] = (self.zero_kappa, *(0.0,) * (self.dim - 1))
        return _read_only(kappa)

    @cached_property
    def wavenumbers(self) -> NDArray[np.float64]:
        """k = |κ| [rad/m], shape (*shape,), positive everywhere."""
        return _read_only(np.sqrt((self.kappa**2).sum(axis=-1)))

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """x̂ = κ/k, shape (*shape, dim)."""
        return _read_only(self.kappa / self.wavenumbers[..., None])

    def pack(self, u: ArrayLike, *, symmetry: Literal["far field", "fourier"] = "far field") -> NDArray[Any]:
        """The half of a Hermitian array that carries everything.

        A real body has û(-κ) = conj û(κ); with u∞ = C_{d,k} û this reads u∞(-κ) = conj u∞(κ) in 3-D and
        u∞(-κ) = i conj u∞(κ) in 2-D. Kept are the zero slot and the slots after it in C order.

        Parameters
        ----------
        u : array_like, shape (..., *shape)
            Shape generators, or Fourier coefficients with `symmetry="fourier"`.

        Returns
        -------
        array, shape (..., (size + 1) // 2)

        Raises
        ------
        ArgumentError
            Where `u` is not symmetric (noisy data is not): packing would lose the other half.
        """
        flat = self._flat("u", u)
        half = flat[..., self.size // 2 :]
        restored = self._mirror(half, symmetry)
        # Rounding may differ between a slot and its mirror: a few hundred ulp of the largest value.
        slack = 500 * np.finfo(flat.dtype).eps * (np.abs(flat).max() if flat.size else 0)
        bad = np.argwhere(~(np.abs(restored - flat[..., : self.size // 2]) <= slack))
        if len(bad):
            index = tuple(int(i) for i in bad[0])
            raise ArgumentError(
                "u", f"is not the mirror of its other half at flat index {index}", "keep the whole array"
            )
        return half.copy()

    def unpack(self, half: ArrayLike, *, symmetry: Literal["far field", "fourier"] = "far field") -> NDArray[Any]:
        """The inverse of `pack`: (..., (size + 1) // 2) → (..., *shape)."""
        values = arguments.plain_array("half", half)
        if values.dtype.kind != "c":
            raise DtypeError("half", f"has dtype {values.dtype}", "give complex values")
        if values.ndim < 1 or values.shape[-1] != (self.size + 1) // 2:
            raise ShapeError("half", f"has shape {values.shape}", f"give (..., {(self.size + 1) // 2})")
        whole = np.concatenate([self._mirror(values, symmetry), values], axis=-1)
        return whole.reshape(*values.shape[:-1], *self.shape)

    def _flat(self, name: str, u: ArrayLike) -> NDArray[Any]:
        array = arguments.plain_array(name, u)
        if array.dtype.kind != "c":
            raise DtypeError(name, f"has dtype {array.dtype}", "give complex values")
        if array.shape[-self.dim :] != self.shape:
            raise ShapeError(name, f"has shape {array.shape}", f"give (..., {', '.join(map(str, self.shape))})")
        return array.reshape(*array.shape[: -self.dim], self.size)

    def _mirror(self, half: NDArray[Any], symmetry: str) -> NDArray[Any]:
        arguments.choice("symmetry", symmetry, ("far field", "fourier"))
        mirrored = half[..., :0:-1].conj()
        # C/conj(C) = i in 2-D: the phase of -i exp(-iπ/4), doubled.
        return mirrored * half.dtype.type(1j) if self.dim == 2 and symmetry == "far field" else mirrored


@dataclass(frozen=True, eq=False)
class ScatteredNodes:
    """Any list of nodes (x̂, k): what a receiver array measures.

    Parameters
    ----------
    directions : array_like, shape (J, dim)
        Observation directions x̂, |x̂| = 1 to 1e-6; they are used as given.
    wavenumbers : array_like, shape (J,) or a number
        Wavenumbers k > 0 [rad/m].
    """

    directions: NDArray[np.float64] = field(repr=False)
    wavenumbers: NDArray[np.float64] = field(repr=False)

    def __init__(self, directions: ArrayLike, wavenumbers: ArrayLike) -> None:
        d = arguments.real_array("directions", directions, np.float64)
        if d.ndim != 2 or d.shape[1] not in (2, 3) or not len(d):
            raise ShapeError("directions", f"has shape {d.shape}", "give (J, 2) or (J, 3), at least one")
        k = arguments.real_array("wavenumbers", wavenumbers, np.float64)
        if k.ndim == 0:
            k = np.broadcast_to(k, (len(d),))
        if k.shape != (len(d),):
            raise ShapeError("wavenumbers", f"has shape {k.shape}", f"give ({len(d)},), one per direction")
        lengths = np.sqrt((d**2).sum(axis=1))
        wrong = np.flatnonzero(np.abs(lengths - 1) > 1e-6)
        if wrong.size:
            raise ArgumentError(
                "directions", f"has length {lengths[wrong[0]]:.9g} at index {wrong[0]}", "give unit vectors"
            )
        # Squares of k must neither vanish nor overflow; no body in metres needs a wavenumber outside.
        wrong = np.flatnonzero((k < 1e-100) | (k > 1e100))
        if wrong.size:
            raise ArgumentError("wavenumbers", f"is {k[wrong[0]]} at index {wrong[0]}", "give k > 0, 1e-100 to 1e100")
        object.__setattr__(self, "directions", _read_only(d.copy()))
        object.__setattr__(self, "wavenumbers", _read_only(k.copy()))

    @property
    def dim(self) -> int:
        """2 or 3."""
        return int(self.directions.shape[1])

    @property
    def shape(self) -> tuple[int, ...]:
        """(J,)."""
        return self.wavenumbers.shape

    @property
    def size(self) -> int:
        """J."""
        return len(self.wavenumbers)

    @cached_property
    def kappa(self) -> NDArray[np.float64]:
        """κ = k x̂ [rad/m], shape (J, dim)."""
        return _read_only(self.directions * self.wavenumbers[:, None])


Nodes = FourierLattice | ScatteredNodes


def require_nodes(nodes: object) -> None:
    """Raise `DtypeError` for anything that is neither a lattice nor scattered nodes."""
    if not isinstance(nodes, Nodes):
        raise DtypeError("nodes", f"is a {type(nodes).__name__}", "give a FourierLattice or ScatteredNodes")


def far_field_constant(
    k: ArrayLike, dim: int, convention: Literal["physical", "paper"] = "physical"
) -> NDArray[np.complex128]:
    """C_{d,k} = -i/√(8πk) · (k/2π)^((d-2)/2) · exp(-i(d-1)π/4): -1/(4π) in 3-D, -i/√(8πk)·exp(-iπ/4) in 2-D.

    It follows from the outgoing Green's function of Δ + k². The constant printed by Li, Liu, Tsui and Wang (2020)
    lacks the factor k^(-1/2); `convention="paper"` gives that one, for comparison only.

    Parameters
    ----------
    k : array_like
        Wavenumbers [rad/m], positive.
    dim : int
        2 or 3.

    Returns
    -------
    complex128 array of the shape of `k`
    """
    if dim not in (2, 3):
        raise ArgumentError("dim", f"is {dim!r}", "give 2 or 3")
    arguments.choice("convention", convention, ("physical", "paper"))
    wavenumbers = arguments.real_array("k", k, np.float64)
    if np.any(wavenumbers <= 0):
        raise ArgumentError("k", f"is {wavenumbers.min()}", "give positive wavenumbers")
    if dim == 3:
        constant = np.full(wavenumbers.shape, -1 / (4 * np.pi), dtype=np.complex128)
    else:
        constant = -1j / np.sqrt(8 * np.pi * wavenumbers) * np.exp(-0.25j * np.pi)
    return constant * np.sqrt(wavenumbers) if convention == "paper" else constant


def order_from_noise(delta: float, dim: int, tau: float | None = None) -> int:
    """N(δ): the largest integer smaller than τ δ^(-2/(2+d)) + 1 (Li, Liu, Tsui, Wang 2020, stability theorem).

    Parameters
    ----------
    delta : float
        Relative noise level, 0 < δ ≤ 1.
    dim : int
        d, 2 or 3.
    tau : float, optional
        τ ≥ d; d by default.
    """
    if dim not in (2, 3):
        raise ArgumentError("dim", f"is {dim!r}", "give 2 or 3")
    if not _is_real(delta) or not 0 < delta <= 1:
        raise ArgumentError("delta", f"is {delta!r}", "give 0 < delta <= 1")
    tau = float(dim) if tau is None else tau
    if not (_is_real(tau) and math.isfinite(tau) and tau >= dim):
        raise ArgumentError("tau", f"is {tau!r}", f"give tau >= {dim}")
    bound = tau * delta ** (-2 / (2 + dim))
    nearest = round(bound)
    # 2 · 0.01^(-1/2) comes out a few ulp above 20; the bound itself is an integer there.
    return nearest if abs(bound - nearest) <= 8 * math.ulp(bound) else math.ceil(bound)


def _is_real(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
