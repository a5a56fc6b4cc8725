"""The oracle for meshes: converged quadrature of the surface integral, its derivative, and the spread as a plain sum.

By the divergence theorem ∫_D exp(-iκ·y) dy = (i/|κ|²) ∮ (κ·n) exp(-iκ·y) dS. Everything is in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..quadrature import Pieces, choose, rules
from .base import Array, MeshSpreadSpec, Surface

# Error of the mean of a wave over a triangle: they add up to no more than this of ∮ |n| dS.
TOLERANCE = 2e-13
GAUSS_POINTS = 8
# Bounds the temporaries: points × nodes at a time, in complex numbers.
AT_ONCE = 2**22


def mesh_transform(vertices: Array, faces: Array, kappa: Array) -> Array:
    """∫_D exp(-iκ·y) dy at any nodes, D inside a closed mesh; where surfaces overlap the density is the winding number.

    exp(-iκ·y) - 1 is integrated: the -1 adds nothing over a closed surface and removes the cancellation at small κ.

    Parameters
    ----------
    vertices, faces : float64 (V, 3) and int (F, 3)
        The mesh [m].
    kappa : float64, shape (J, 3)
        Nodes [rad/m], none of them zero.

    Returns
    -------
    complex128, shape (J,)
    """
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    points, flux = surface_points(vertices - centre, faces, np.abs(kappa).max(axis=0))
    result = np.zeros(len(kappa), dtype=np.complex128)
    for nodes in _blocks(len(kappa), 512):
        for part in _blocks(len(points), AT_ONCE // 512):
            half = kappa[nodes] @ points[part].T / 2
            sine, cosine = np.sin(half), np.cos(half)
            strength = kappa[nodes] @ flux[part].T
            result.real[nodes] += (-2 * sine * sine * strength).sum(axis=1)
            result.imag[nodes] += (-2 * sine * cosine * strength).sum(axis=1)
    return 1j * result / (kappa**2).sum(axis=1) * np.exp(-1j * kappa @ centre)


def mesh_transform_tensor(vertices: Array, faces: Array, axes: Sequence[Array]) -> Array:
    """`mesh_transform` on a tensor grid of wavenumbers, as matrix products; κ = 0 gives the volume.

    Parameters
    ----------
    vertices, faces : float64 (V, 3) and int (F, 3)
        The mesh [m].
    axes : three float64 arrays, shapes (n_1,), (n_2,), (n_3,)
        Wavenumbers [rad/m] per axis.

    Returns
    -------
    complex128, shape (n_1, n_2, n_3)
    """
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    points, flux = surface_points(vertices - centre, faces, np.array([np.abs(axis).max() for axis in axes]))
    shape = tuple(len(axis) for axis in axes)
    sums = np.zeros((3, shape[0] * shape[1], shape[2]), dtype=np.complex128)
    for part in _blocks(len(points), max(AT_ONCE // (shape[0] * shape[1]), 64)):
        first, second, third = (np.exp(-1j * np.outer(points[part, j], axis)) for j, axis in enumerate(axes))
        plane = (first[:, :, None] * second[:, None, :]).reshape(len(first), -1)
        for j in range(3):
            sums[j] += plane.T @ (flux[part, j, None] * third)
    sums -= flux.sum(axis=0)[:, None, None]
    kappa = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    square = (kappa**2).sum(axis=-1)
    total = np.einsum("...j,j...->...", kappa, sums.reshape(3, *shape))
    result = 1j * total / np.where(square == 0, 1, square) * np.exp(-1j * kappa @ centre)
    # At κ = 0 the divergence theorem for y/3 instead.
    result[square == 0] = (points * flux).sum() / 3
    return np.asarray(result)


def mesh_gradient(vertices: Array, faces: Array, greatest: Array, wave: Callable[[Array], Array]) -> Array:
    """∂/∂v of ∫_D p(y) dy for a field p of waves with |κ_j| ≤ greatest[j]: corner c gets Σ_T n_T ∫_T p λ_c dS.

    Parameters
    ----------
    vertices, faces : float64 (V, 3) and int (F, 3)
        The mesh [m].
    greatest : float64, shape (3,)
        Largest wavenumber per axis [rad/m].
    wave : callable
        Points (P, 3) [m] → p, (P,) real.

    Returns
    -------
    float64, shape (V, 3)
    """
    pieces = _pieces(vertices, faces, greatest)
    gradient = np.zeros_like(pieces.vertices)
    for number, rule in enumerate(rules(3, GAUSS_POINTS)):
        own = pieces.simplices[pieces.rule == number]
        corners = pieces.vertices[own]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        points = np.einsum("qc,tcj->tqj", rule.points, corners)
        values = wave(points.reshape(-1, 3)).reshape(points.shape[:2])
        share = values @ (rule.weights[:, None] * rule.points)
        np.add.at(gradient, own, share[:, :, None] * normal[:, None, :])
    # A middle moves by half of what either end of its edge moves; later middles may lie between earlier ones.
    end = len(gradient)
    for ends in reversed(pieces.parents):
        start = end - len(ends)
        np.add.at(gradient, ends, gradient[start:end, None, :] / 2)
        end = start
    return gradient[: len(vertices)]


def surface_points(vertices: Array, faces: Array, greatest: Array) -> tuple[Array, Array]:
    """Quadrature points (P, 3) [m] and n dS (P, 3) [m²] of a mesh for |κ_j| ≤ greatest[j]."""
    pieces = _pieces(vertices, faces, greatest)
    points, flux = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for number, rule in enumerate(rules(3, GAUSS_POINTS)):
        corners = pieces.vertices[pieces.simplices[pieces.rule == number]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        points.append(np.einsum("qc,tcj->tqj", rule.points, corners).reshape(-1, 3))
        flux.append((rule.weights[None, :, None] * normal[:, None, :]).reshape(-1, 3))
    return np.concatenate(points), np.concatenate(flux)


def _pieces(vertices: Array, faces: Array, greatest: Array) -> Pieces:
    return choose(vertices, faces, rules(3, GAUSS_POINTS), greatest, TOLERANCE, None)


class ReferenceMeshSpreadPlan:
    """V[g] = Σ_{g' ≤ g along axis} Σ_p s_p Π_j φ_j(x_pj - g'_j), point by point."""

    def __init__(self, spec: MeshSpreadSpec, device: str) -> None:
        self.spec = spec
        self.device = device

    def forward(self, surfaces: Sequence[Surface], out: Array | None = None) -> Array:
        """b surfaces → (b, *shape) real."""
        result = np.empty((len(surfaces), *self.spec.shape), dtype=self.spec.dtype) if out is None else out
        for body, surface in enumerate(surfaces):
            grid = np.zeros(int(np.prod(self.spec.shape)))
            for points, strengths in self._points(surface):
                for part in _blocks(len(points), 2**14):
                    self._add(grid, points[part], strengths[part])
            result[body] = np.cumsum(grid.reshape(self.spec.shape), axis=self.spec.axis)
        return result

    def _points(self, surface: Surface) -> list[tuple[Array, Array]]:
        found = []
        for number, rule in enumerate(self.spec.rules):
            own = surface.rule == number
            points = np.einsum("qc,tcj->tqj", rule.points, surface.vertices[surface.simplices[own]])
            strengths = surface.strengths[own][:, None] * rule.weights
            found.append((points.reshape(-1, points.shape[-1]), strengths.ravel()))
        return found

    def _add(self, grid: Array, points: Array, strengths: Array) -> None:
        index = np.zeros((len(points), 1), dtype=np.int64)
        values = strengths[:, None]
        for j, (window, size) in enumerate(zip(self.spec.windows, self.spec.shape, strict=True)):
            along = window.first(points[:, j])[:, None] + np.arange(window.width)
            index = (index[:, :, None] * size + along[:, None, :]).reshape(len(points), -1)
            values = (values[:, :, None] * window.weights(points[:, j])[:, None, :]).reshape(len(points), -1)
        grid += np.bincount(index.ravel(), values.ravel(), minlength=len(grid))


def _blocks(count: int, size: int) -> list[slice]:
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
