"""The lattice sums in numbers: what every contender of the synthesis and of the lattice far field starts from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

import accel_shapegen as asg
from accel_shapegen.synthesis import ZeroNodeFormula

from ..contest import Array


@dataclass(frozen=True)
class LatticeSum:
    """A grid of equal cells that fill the lattice's box, in 3-D, where the far-field constant is one real number."""

    grid: asg.Grid
    lattice: asg.FourierLattice
    complex_dtype: np.dtype[Any]

    @property
    def real_dtype(self) -> np.dtype[Any]:
        """float32 or float64."""
        return np.empty(0, self.complex_dtype).real.dtype

    @cached_property
    def constant(self) -> float:
        """C_{3,k} = -1/(4π), whatever k."""
        return float(asg.far_field_constant(1.0, 3).real)

    @property
    def coefficient(self) -> float:
        """1/(|V0| C): a generator's value times this is its Fourier coefficient."""
        return 1 / (self.lattice.box.volume * self.constant)

    @cached_property
    def zero_form(self) -> Array:
        """Weights of the zero-node formula: f̂_0 = Σ_ξ1 form[ξ1] u[ξ1, 0, 0]."""
        return ZeroNodeFormula(self.lattice).form.astype(self.complex_dtype)

    def line(self, u: Array) -> Array:
        """u on ξ = (ξ1, 0, 0), shape (b, 2N_1+1)."""
        return u[:, :, self.lattice.order[1], self.lattice.order[2]]

    def angles(self, axis: int, least: int) -> Array:
        """κ_j x for ξ_j = least..N_j and all cell centres: (rows, n_j)."""
        xi = np.arange(least, self.lattice.order[axis] + 1)
        return np.outer(xi * self.lattice.step[axis], self.grid.axes[axis])

    def cell(self, axis: int, least: int) -> Array:
        """h_j sinc(κ_j h_j/2π), the transform of a cell along one axis, for ξ_j = least..N_j."""
        assert self.grid.spacing is not None
        return self._cell(axis, self.lattice.step[axis] * np.arange(least, self.lattice.order[axis] + 1))

    def zero_row(self) -> Array:
        """The zero node's row on the first axis, constant and all other cell factors included; (n_1,) complex."""
        assert self.grid.spacing is not None
        kappa = self.lattice.zero_kappa
        scale = self.constant * self._cell(0, np.array(kappa)) * self.grid.spacing[1] * self.grid.spacing[2]
        return np.asarray(scale * np.exp(-1j * kappa * self.grid.axes[0]))

    def _cell(self, axis: int, kappa: Array) -> Array:
        width = self.grid.spacing[axis]  # type: ignore[index]
        return np.asarray(width * np.sinc(kappa * width / (2 * np.pi)))
