"""The oracle: every operation as its plain float64 sum in NumPy, to be read beside the formula.

Nothing here approximates and nothing is clever; the only liberty is to factor exp(-iκ·x) into its axes, which is
exact. Results are rounded to the plan's precision at the very end.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from . import reference_mesh
from .base import Array, DeviceInfo, MeshSpreadSpec, ScatteredSpec, SplineSpec, TensorSpec

# Nodes handled at a time by the scattered sum: bounds the temporaries (nodes × n_1 × n_2 complex) to ~100 MB at 100³.
NODES_AT_ONCE = 512


class ReferenceBackend:
    """NumPy in float64 on the CPU."""

    name: ClassVar[str] = "reference"
    operations: ClassVar[frozenset[str]] = frozenset(
        {
            "tensor_transform",
            "scattered_transform",
            "mesh_spread",
            "spline_contract",
            "polygon_transform",
            "mesh_transform",
        }
    )

    @classmethod
    def probe(cls) -> Sequence[DeviceInfo]:
        """One device: the CPU that NumPy runs on."""
        return [
            DeviceInfo("reference", 0, platform.machine(), "cpu", "NumPy", f"NumPy {np.__version__}", preference=10)
        ]

    def __init__(self, info: DeviceInfo) -> None:
        self.info = info

    def plan_tensor_transform(self, spec: TensorSpec) -> ReferenceTensorPlan:
        """Contraction of a tensor grid with one small matrix per axis."""
        return ReferenceTensorPlan(spec, self.info.label)

    def plan_scattered_transform(self, spec: ScatteredSpec) -> ReferenceScatteredPlan:
        """Voxel grid to arbitrary nodes; exact, whatever `eps` asks."""
        return ReferenceScatteredPlan(spec, self.info.label)

    def plan_mesh_spread(self, spec: MeshSpreadSpec) -> reference_mesh.ReferenceMeshSpreadPlan:
        """Closed surfaces to smooth voxels."""
        return reference_mesh.ReferenceMeshSpreadPlan(spec, self.info.label)

    def plan_spline_contract(self, spec: SplineSpec) -> ReferenceSplinePlan:
        """Spline coefficients to queries."""
        return ReferenceSplinePlan(spec, self.info.label)

    def polygon_transform(self, rings: Sequence[Array], kappa: Array) -> Array:
        """∫_D exp(-iκ·y) dy for the polygon with these rings; see `polygon_transform` below."""
        return polygon_transform(rings, kappa)

    def mesh_transform(self, vertices: Array, faces: Array, kappa: Array) -> Array:
        """∫_D exp(-iκ·y) dy for the body inside a closed mesh; see `reference_mesh`."""
        return reference_mesh.mesh_transform(vertices, faces, kappa)

    def mesh_transform_tensor(self, vertices: Array, faces: Array, axes: Sequence[Array]) -> Array:
        """The same on a tensor grid of wavenumbers."""
        return reference_mesh.mesh_transform_tensor(vertices, faces, axes)

    def mesh_gradient(self, vertices: Array, faces: Array, greatest: Array, wave: Callable[[Array], Array]) -> Array:
        """The derivative of ∫_D p(y) dy in the vertices, for a field p of waves."""
        return reference_mesh.mesh_gradient(vertices, faces, greatest, wave)


class ReferenceTensorPlan:
    """F[ξ] = c[ξ] Σ_g v[g] Π_j E_j[ξ_j, g_j], one body and one axis at a time."""

    def __init__(self, spec: TensorSpec, device: str) -> None:
        self.spec = spec
        self.device = device
        self._zero_slot = tuple(axis.order for axis in spec.axes)

    def _matrices(self, body: int) -> list[Array]:
        matrices = []
        for axis in self.spec.axes:
            xi = np.arange(-axis.order, axis.order + 1)
            points = axis.points[body] if axis.points.ndim == 2 else axis.points
            weights = axis.weights[body] if axis.weights.ndim == 2 else axis.weights
            matrix = weights[:, None] * np.exp(-1j * axis.step * xi[:, None] * points[None, :])
            if axis.mask is not None:
                matrix = matrix * (axis.mask[body] if axis.mask.ndim == 2 else axis.mask)
            matrices.append(matrix)
        return matrices

    def _zero_rows(self, body: int, matrices: list[Array]) -> list[Array] | None:
        """One row per axis whose outer product gives the zero node, or None."""
        zero, first = self.spec.zero, self.spec.axes[0]
        if zero is None:
            return None
        points = first.points[body] if first.points.ndim == 2 else first.points
        weight = zero.weight[body] if np.ndim(zero.weight) == 1 else zero.weight
        row = weight * np.exp(-1j * zero.kappa * points)
        if first.mask is not None:
            row = row * (first.mask[body] if first.mask.ndim == 2 else first.mask)
        return [row] + [m[axis.order] for m, axis in zip(matrices[1:], self.spec.axes[1:], strict=True)]

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *grid_shape) real → (b, *lattice_shape) complex."""
        result = np.empty((len(values), *self.spec.lattice_shape), dtype=np.complex128)
        for body, body_values in enumerate(values):
            matrices = self._matrices(body)
            result[body] = _contract(body_values.astype(np.complex128), matrices)
            rows = self._zero_rows(body, matrices)
            if rows is not None:
                result[(body, *self._zero_slot)] = _contract(body_values, [row[None, :] for row in rows]).item()
            result[body] *= self.spec.node_weights
        return _finish(result, np.result_type(self.spec.dtype, np.complex64), out)

    def adjoint(self, u: Array, centre: Array | None = None, out: Array | None = None) -> Array:
        """(b, *lattice_shape) complex → (b, *grid_shape) real."""
        result = np.empty((len(u), *self.spec.grid_shape))
        for body, body_u in enumerate(u):
            coefficients = body_u.astype(np.complex128)
            if centre is not None:
                coefficients[self._zero_slot] = centre[body]
            coefficients *= self.spec.node_weights.conj()
            matrices = self._matrices(body)
            rows = self._zero_rows(body, matrices)
            at_zero = coefficients[self._zero_slot]
            if rows is not None:
                coefficients[self._zero_slot] = 0
            result[body] = _contract(coefficients, [matrix.conj().T for matrix in matrices]).real
            if rows is not None:
                corner = np.full((1,) * len(rows), at_zero)
                result[body] += _contract(corner, [row.conj()[:, None] for row in rows]).real
        return _finish(result, self.spec.dtype, out)


def _contract(tensor: Array, matrices: Sequence[Array]) -> Array:
    """Σ over every axis j of tensor with matrices[j][·, g_j]."""
    for matrix in matrices:
        # Each contraction eats the leading axis and appends the new one: after all axes the order is restored.
        tensor = np.tensordot(tensor, matrix, axes=(0, 1))
    return tensor


class ReferenceScatteredPlan:
    """F[j] = c[j] Σ_g v[g] exp(-iκ_j·x_g), node by node."""

    def __init__(self, spec: ScatteredSpec, device: str) -> None:
        self.spec = spec
        self.device = device

    def _phases(self, nodes: slice) -> list[Array]:
        """exp(-iκ_j x) per axis, (nodes, n_j) each."""
        spec = self.spec
        axes = [o + h * np.arange(n) for o, h, n in zip(spec.origin, spec.spacing, spec.shape, strict=True)]
        return [np.exp(-1j * spec.kappa[nodes, j, None] * x) for j, x in enumerate(axes)]

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *shape) real → (b, J) complex."""
        spec = self.spec
        result = np.empty((len(values), len(spec.kappa)), dtype=np.complex128)
        for body, body_values in enumerate(values):
            body_values = body_values.astype(np.float64)
            for nodes in _blocks(len(spec.kappa)):
                phases = self._phases(nodes)
                # Two real products instead of a complex one with a zero imaginary part.
                last = phases[-1]
                partial = np.tensordot(last.real, body_values, (1, -1)) + 1j * np.tensordot(
                    last.imag, body_values, (1, -1)
                )
                for phase in reversed(phases[:-1]):
                    partial = np.einsum("j...g,jg->j...", partial, phase)
                result[body, nodes] = partial
            result[body] *= spec.node_weights
        return _finish(result, np.result_type(spec.dtype, np.complex64), out)

    def adjoint(self, u: Array, out: Array | None = None) -> Array:
        """(b, J) complex → (b, *shape) real."""
        spec = self.spec
        result = np.zeros((len(u), *spec.shape))
        for body, body_u in enumerate(u):
            coefficients = body_u.astype(np.complex128) * spec.node_weights.conj()
            for nodes in _blocks(len(spec.kappa)):
                phases = [phase.conj() for phase in self._phases(nodes)]
                partial = coefficients[nodes]
                for phase in phases[:-1]:
                    partial = np.einsum("j...,jg->j...g", partial, phase)
                last = phases[-1]
                result[body] += np.tensordot(partial.real, last.real, (0, 0)) - np.tensordot(
                    partial.imag, last.imag, (0, 0)
                )
        return _finish(result, spec.dtype, out)


def _blocks(count: int) -> list[slice]:
    return [slice(start, min(start + NODES_AT_ONCE, count)) for start in range(0, count, NODES_AT_ONCE)]


class ReferenceSplinePlan:
    """out[q] = Σ_t weights[q, t] · coefficients[columns[q, t]]."""

    def __init__(self, spec: SplineSpec, device: str) -> None:
        self.spec = spec
        self.device = device

    def forward(self, columns: Array, weights: Array, out: Array | None = None) -> Array:
        """(Q, T) and (Q, T) → (Q, K)."""
        result = np.zeros((len(columns), self.spec.coefficients.shape[1]))
        for query in range(len(columns)):
            for column, weight in zip(columns[query], weights[query], strict=True):
                result[query] += np.float64(weight) * self.spec.coefficients[column]
        return _finish(result, self.spec.dtype, out)

    def adjoint(self, columns: Array, weights: Array, cotangent: Array) -> Array:
        """(Q, T), (Q, T) and (Q, K) → (C, K)."""
        result = np.zeros(self.spec.coefficients.shape)
        for query in range(len(columns)):
            for column, weight in zip(columns[query], weights[query], strict=True):
                result[column] += np.float64(weight) * cotangent[query]
        return _finish(result, self.spec.dtype, None)


def polygon_transform(rings: Sequence[Array], kappa: Array) -> Array:
    """∫_D exp(-iκ·y) dy in closed form, by the divergence theorem along the edges.

    For an edge from p to q with midpoint m:  (i/|κ|²) (κ_1 (q-p)_2 - κ_2 (q-p)_1) [exp(-iκ·m) sinc(κ·(q-p)/2π) - 1],
    summed over all edges. The -1 adds nothing to the sum of a closed ring and removes the cancellation at small κ.

    Parameters
    ----------
    rings : sequence of float64 arrays, each (n, 2)
        Corners [m]; outer rings counter-clockwise, holes clockwise.
    kappa : float64, shape (J, 2)
        Nodes [rad/m], none of them zero.

    Returns
    -------
    complex128, shape (J,)
    """
    corners = np.concatenate(rings)
    # About the polygon's own centre the phases are small; its place is one exact factor.
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    total = np.zeros(len(kappa), dtype=np.complex128)
    for ring in rings:
        start = ring - centre
        edge = np.roll(start, -1, axis=0) - start
        middle = start + edge / 2
        flux = np.outer(kappa[:, 0], edge[:, 1]) - np.outer(kappa[:, 1], edge[:, 0])
        total += (flux * _phase_minus_one(kappa @ middle.T, kappa @ edge.T / 2)).sum(axis=1)
    return 1j * total / (kappa**2).sum(axis=1) * np.exp(-1j * kappa @ centre)


def _phase_minus_one(theta: Array, half: Array) -> Array:
    """exp(-iθ) sin(t)/t - 1 with full relative accuracy near 0."""
    ratio = np.sinc(half / np.pi)
    square = half * half
    # Below 0.1 the series to t⁸ is exact to 3e-18; sin(t)/t - 1 there loses half of the digits.
    series = -square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    ratio_minus_one = np.where(square < 0.01, series, ratio - 1)
    sine, cosine = np.sin(theta / 2), np.cos(theta / 2)
    result = np.empty(theta.shape, dtype=np.complex128)
    result.real = ratio_minus_one - 2 * sine * sine * ratio
    result.imag = -2 * sine * cosine * ratio
    return result


def _finish(result: Array, dtype: np.dtype | type, out: Array | None) -> Array:
    if out is None:
        return result.astype(dtype, copy=False)
    out[...] = result
    return out
