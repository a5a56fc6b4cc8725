"""An independent forward solver: the source problem (Δ + k²) u = χ_D by high-order finite elements, outgoing by a PML.

Nothing here uses the transform of the body. The domain is |x| < end: bodies lie within |x| < inner, the shell
inner < |x| < outer is where the far field is read off, and beyond it coordinates are stretched into the complex plane
so that outgoing waves die out. NGSolve does the work (extra `fem`).

The far field is the Kirchhoff integral u∞(x̂) = γ ∮_{|y|=r} (u ∂_r φ - φ ∂_r u) ds with φ = exp(-ik x̂·y) and the
amplitude γ of the outgoing Green's function at infinity. It is the same on every circle around the body; its mean over
the radii of the shell is an integral over elements, which the finite element solution gives to twice the order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import extras
from .fem_mesh import Shells

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Along the PML an outgoing wave falls by exp(-DECAY); what comes back from its end has done that twice.
DECAY = 6.0
# Integrands that are not polynomials (waves, curved elements) take this much more than their polynomial part.
BONUS = 8


def require_ngsolve() -> Any:
    """The ngsolve module, or `MissingDependencyError`."""
    return extras.require("finite elements", "ngsolve", "fem")


@dataclass(frozen=True, eq=False)
class Exterior:
    """A mesh with its finite elements, for any number of wavenumbers and bodies.

    Attributes
    ----------
    mesh : ngsolve.Mesh
        Of `fem_mesh`: regions body (where meshed), air, shell and pml, and the boundary outer.
    dim : int
        2 or 3.
    shells : Shells
        The radii of those regions.
    order : int
        Degree of the polynomials.
    mirrored : bool
        Whether the mesh is the octant x, y, z > 0 of a problem that is even in each of them.
    """

    mesh: Any
    dim: int
    shells: Shells
    order: int
    mirrored: bool = False

    def __post_init__(self) -> None:
        # Before anything else: points are looked up in the elements as they are at that time.
        self.mesh.Curve(self.order)

    @cached_property
    def space(self) -> Any:
        """The finite element space."""
        return require_ngsolve().H1(self.mesh, order=self.order, complex=True, dirichlet="outer")

    def load_of_region(self) -> Complex:
        """∫_D v of the body that the mesh was made around, per degree of freedom."""
        ng = require_ngsolve()
        form = ng.LinearForm(self.space.TestFunction() * ng.dx("body")).Assemble()
        return np.array(form.vec.FV().NumPy())

    def load_of(self, points: Floats, weights: Floats) -> Complex:
        """∫_D v of a body that the mesh does not know of, by a quadrature over the body, (Q, 2) and (Q,).

        That the elements do not follow the body's boundary costs accuracy near it, but hardly any in the far field,
        which is a smooth functional of the solution.
        """
        ng = require_ngsolve()
        places = self.mesh(points[:, 0], points[:, 1])
        load = np.zeros(self.space.ndof, dtype=np.complex128)
        order = np.argsort(places["nr"], kind="stable")
        for some in np.split(order, np.flatnonzero(np.diff(places["nr"][order])) + 1):
            number = ng.ElementId(ng.VOL, int(places["nr"][some[0]]))
            element = self.space.GetFE(number)
            shapes = [element.CalcShape(float(place["x"]), float(place["y"]), 0.0) for place in places[some]]
            load[list(self.space.GetDofNrs(number))] += weights[some] @ np.array(shapes)
        return load


class Waves:
    """Outgoing solutions at one wavenumber k [rad/m], factorised once for any number of bodies."""

    def __init__(self, exterior: Exterior, k: float) -> None:
        ng = require_ngsolve()
        self.exterior, self.k = exterior, float(k)
        shells, space = exterior.shells, exterior.space
        stretch = max(1.0, DECAY / (self.k * (shells.end - shells.outer)))
        layer = ng.pml.Radial(rad=shells.outer, alpha=1j * stretch, origin=(0.0,) * exterior.dim)
        exterior.mesh.SetPML(layer, "pml")
        u, v = space.TnT()
        # Weak form of (Δ + k²) u = f, times -1; unknowns inside elements are eliminated.
        self._form = ng.BilinearForm(space, symmetric=True, condense=True)
        self._form += (ng.grad(u) * ng.grad(v) - self.k**2 * u * v) * ng.dx
        self._form.Assemble()
        self._inverse = self._form.mat.Inverse(space.FreeDofs(True), "sparsecholesky")

    def solve(self, load: Complex) -> Any:
        """The solution for a load of `Exterior`, as a grid function."""
        solution = require_ngsolve().GridFunction(self.exterior.space)
        right = solution.vec.CreateVector()
        right.FV().NumPy()[:] = -load
        right.data += self._form.harmonic_extension_trans * right
        solution.vec.data = self._inverse * right
        solution.vec.data += self._form.inner_solve * right
        solution.vec.data += self._form.harmonic_extension * solution.vec
        return solution

    def far_fields(self, solutions: Sequence[Any], directions: Floats) -> Complex:
        """u∞ by the Kirchhoff integral: B solutions and unit vectors (J, dim) → (B, J)."""
        values = np.stack([solution.vec.FV().NumPy() for solution in solutions])
        return values @ np.stack([self._kirchhoff(direction) for direction in directions]).T

    def far_field_by_modes(self, solution: Any, angles: Floats) -> Complex:
        """u∞ from u on one circle: Σ_m c_m H_m(kr) exp(imθ) there is √(2/πk) exp(-iπ/4) Σ_m c_m (-i)^m exp(imθ).

        It uses neither derivatives nor Green's function, only that the solution is outgoing - which the Kirchhoff
        integral does not see, since waves that come back from the PML contribute nothing to it.
        """
        from scipy.special import hankel1

        radius, count = self.exterior.shells.middle, 512
        turn = 2 * np.pi * np.arange(count) / count
        trace = solution(self.exterior.mesh(radius * np.cos(turn), radius * np.sin(turn))).ravel()
        # Beyond kr modes are evanescent; 25 more are some 1e-12 of those that radiate.
        most = int(self.k * radius) + 25
        modes = np.arange(-most, most + 1)
        amplitudes = np.fft.fft(trace)[modes] / count / hankel1(modes, self.k * radius)
        waves = np.exp(1j * np.outer(angles, modes)) * (-1j) ** (modes % 4)
        return math.sqrt(2 / (math.pi * self.k)) * np.exp(-0.25j * np.pi) * (waves @ amplitudes)

    def monopole(self, solution: Any) -> complex:
        """u∞ in 3-D of a source that is symmetric about the origin: u = u∞ exp(ikr)/r, read at one point."""
        radius = self.exterior.shells.middle
        value = solution(self.exterior.mesh(*(radius / math.sqrt(3),) * 3))
        return complex(value * radius * np.exp(-1j * self.k * radius))

    def _kirchhoff(self, direction: Floats) -> Complex:
        """The mean over the shell as a linear form in the degrees of freedom."""
        ng = require_ngsolve()
        exterior = self.exterior
        v = exterior.space.TestFunction()
        wave, slope = self._plane_wave(direction)
        form = ng.LinearForm(exterior.space)
        form += (v * slope - wave * (ng.grad(v) * self._outward)) * ng.dx("shell", bonus_intorder=BONUS)
        form.Assemble()
        gamma = 1 / (4 * np.pi) if exterior.dim == 3 else np.exp(0.25j * np.pi) / np.sqrt(8 * np.pi * self.k)
        return np.asarray(gamma / (exterior.shells.outer - exterior.shells.inner) * form.vec.FV().NumPy())

    @cached_property
    def _outward(self) -> Any:
        ng = require_ngsolve()
        place = (ng.x, ng.y, ng.z)[: self.exterior.dim]
        return ng.CoefficientFunction(tuple(x / ng.sqrt(sum(y * y for y in place)) for x in place))

    def _plane_wave(self, direction: Floats) -> tuple[Any, Any]:
        """φ = exp(-ik x̂·y) and ∂_r φ; for a mirrored octant the sum of both over its eight images."""
        ng = require_ngsolve()
        kappa = [self.k * float(component) for component in direction]
        place, outward = (ng.x, ng.y, ng.z)[: self.exterior.dim], self._outward
        if not self.exterior.mirrored:
            wave = ng.exp(-1j * sum(kj * x for kj, x in zip(kappa, place, strict=True)))
            return wave, -1j * sum(kj * outward[j] for j, kj in enumerate(kappa)) * wave
        even = [ng.cos(kj * x) for kj, x in zip(kappa, place, strict=True)]
        odd = [-kj * ng.sin(kj * x) for kj, x in zip(kappa, place, strict=True)]
        slopes = [outward[j] * odd[j] * even[j - 1] * even[j - 2] for j in range(3)]
        return 8 * even[0] * even[1] * even[2], 8 * sum(slopes)
