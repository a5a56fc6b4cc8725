"""What a backend is: plans for the operations, and a report of the devices it found.

The specs below are complete descriptions in float64: units, constants, the zero node and all checks are settled
before a backend sees them. A backend turns a spec into a plan that owns its matrices, kernels and buffers for one
shape and precision, and the plan is then applied many times. Fixed summation order: the same device, the same bits.

Complex arrays are NumPy complex at this border; inside kernels they are pairs of reals. Every array that a plan is
applied to has the plan's precision, and may be read-only; `out`, where given, is C-contiguous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..kernel_window import Window
from ..quadrature import Rule

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class TensorAxis:
    """One axis of `tensor_transform`: the small matrix E[ξ, g] = w[ξ] m[g] exp(-i ξ step x[g]).

    Attributes
    ----------
    points : float64, shape (n,) or (batch, n)
        Coordinates x [m]; with a batch axis each body has its own matrix.
    order : int
        N; ξ = -N..N.
    step : float
        Wavenumber per ξ [rad/m].
    weights : float64, shape (2N+1,) or (batch, 2N+1)
        w, real and even in ξ.
    mask : bool, shape (n,) or (batch, n), or None
        m; where False the point takes no part (its value is 0 in the adjoint).
    """

    points: Array
    order: int
    step: float
    weights: Array
    mask: Array | None = None

    @property
    def size(self) -> int:
        """n."""
        return int(self.points.shape[-1])

    @property
    def per_body(self) -> bool:
        """Whether any part of the matrix differs between the bodies of a batch."""
        return self.points.ndim == 2 or self.weights.ndim == 2 or (self.mask is not None and self.mask.ndim == 2)


@dataclass(frozen=True, eq=False)
class ZeroRow:
    """The zero node as one more row of the first axis: weight · exp(-i kappa x[g]), for ξ = 0 alone."""

    kappa: float
    weight: Array  # float64, shape () or (batch,)


@dataclass(frozen=True, eq=False)
class TensorSpec:
    """F[b, ξ] = c[ξ] Σ_g v[b, g] Π_j E_j[ξ_j, g_j], v real; in 2-D or 3-D.

    With `zero` set, the slot ξ = 0 takes the zero row for E_1 instead. The adjoint with respect to Re⟨·,·⟩ is
    v[b, g] = Re Σ_ξ conj(c[ξ] Π_j E_j[ξ_j, g_j]) F[b, ξ].
    """

    axes: tuple[TensorAxis, ...]
    batch: int
    dtype: np.dtype[Any]  # float32 or float64
    node_weights: Array  # c, complex128, shape of the lattice
    zero: ZeroRow | None = None

    @property
    def grid_shape(self) -> tuple[int, ...]:
        """(n_1, .., n_d)."""
        return tuple(axis.size for axis in self.axes)

    @property
    def lattice_shape(self) -> tuple[int, ...]:
        """(2N_1+1, .., 2N_d+1)."""
        return tuple(2 * axis.order + 1 for axis in self.axes)

    @property
    def per_body(self) -> bool:
        """Whether bodies of a batch have matrices of their own; then every call brings exactly `batch` bodies."""
        return any(axis.per_body for axis in self.axes) or (self.zero is not None and self.zero.weight.ndim == 1)


@dataclass(frozen=True, eq=False)
class ScatteredSpec:
    """F[b, j] = c[j] Σ_g v[b, g] exp(-i κ_j·x_g), x_g = origin + g·spacing, v real; in 2-D or 3-D.

    The relative L2 error over the nodes is to be within a small multiple of `eps`, for mean-free v too.
    The adjoint with respect to Re⟨·,·⟩ is v[b, g] = Re Σ_j conj(c[j] exp(-i κ_j·x_g)) F[b, j].
    """

    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    origin: tuple[float, ...]  # centre of the first cell [m]
    kappa: Array  # float64, shape (J, d)
    eps: float
    batch: int
    dtype: np.dtype[Any]
    node_weights: Array  # c, complex128, shape (J,)


@dataclass(frozen=True, eq=False)
class SplineSpec:
    """out[q, :] = Σ_t weights[q, t] · coefficients[columns[q, t], :]: tensor splines at many queries at once.

    `coefficients` has shape (C, K), real; K counts complex nodes as pairs of reals. `columns` holds, for query q,
    the T grid points (flat, C order) whose coefficients it needs. Negative columns never occur; weights may be 0.
    """

    coefficients: Array
    dtype: np.dtype[Any]


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface in 3-D, or closed polygons in 2-D, as pieces with a quadrature rule each.

    Attributes
    ----------
    vertices : float64, shape (V, d)
        Corners in cells: index i of the grid is the coordinate i.
    simplices : int64, shape (T, d)
        Triangles, or edges.
    strengths : float64, shape (T,)
        What a piece adds to the sum in all, in faces of a cell: minus its outward normal's component along
        `MeshSpreadSpec.axis`, times its area.
    rule : uint8, shape (T,)
        Index into `MeshSpreadSpec.rules`.
    """

    vertices: Array
    simplices: Array
    strengths: Array
    rule: Array


@dataclass(frozen=True, eq=False)
class MeshSpreadSpec:
    """V[g] = Σ_{g' ≤ g along `axis`} Σ_p s_p Π_j φ_j(x_pj - g'_j): a closed surface as smooth voxels, in 2-D or 3-D.

    The points x_p [cells] are those of each piece's rule; s_p is the piece's strength times the rule's weight.
    Pieces lie so far inside that no window reaches out of the grid.
    """

    shape: tuple[int, ...]
    axis: int
    windows: tuple[Window, ...]  # φ_j
    rules: tuple[Rule, ...]
    dtype: np.dtype[Any]


class TensorPlan(Protocol):
    """`tensor_transform`, planned."""

    device: str

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *grid_shape) real → (b, *lattice_shape) complex, 1 ≤ b ≤ batch (b = batch when `per_body`)."""

    def adjoint(self, u: Array, centre: Array | None = None, out: Array | None = None) -> Array:
        """(b, *lattice_shape) complex → (b, *grid_shape) real; `centre`, (b,) of u's dtype, replaces the slot ξ = 0."""


class ScatteredPlan(Protocol):
    """`scattered_transform`, planned."""

    device: str

    def forward(self, values: Array, out: Array | None = None) -> Array:
        """(b, *shape) real → (b, J) complex, 1 ≤ b ≤ batch."""

    def adjoint(self, u: Array, out: Array | None = None) -> Array:
        """(b, J) complex → (b, *shape) real."""


class MeshSpreadPlan(Protocol):
    """`mesh_spread`, planned."""

    device: str

    def forward(self, surfaces: Sequence[Surface], out: Array | None = None) -> Array:
        """b surfaces → (b, *shape) real."""


class SplinePlan(Protocol):
    """`spline_contract`, planned."""

    device: str

    def forward(self, columns: Array, weights: Array, out: Array | None = None) -> Array:
        """(Q, T) int32 and (Q, T) real → (Q, K) real."""

    def adjoint(self, columns: Array, weights: Array, cotangent: Array) -> Array:
        """(Q, T), (Q, T) and (Q, K) → (C, K): the derivative of ⟨cotangent, out⟩ in the coefficients."""


@dataclass(frozen=True)
class DeviceInfo:
    """One device as a backend found it.

    `preference` orders devices when the caller names none: higher wins, ties go to the first found.
    `problems` are things a user should know and could mend; `usable` says whether plans can be made.
    """

    backend: str
    index: int
    name: str
    kind: str  # "cpu", "gpu" or "accelerator"; "none" where a platform has no device
    platform: str = ""
    version: str = ""
    memory_bytes: int = 0
    compute_units: int = 0
    usable: bool = True
    preference: int = 0
    problems: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """What plans, models and programs print: `opencl: cpu-znver3 (PoCL 3.1)`."""
        return f"{self.backend}: {self.name}" + (f" ({self.version})" if self.version else "")


@runtime_checkable
class Backend(Protocol):
    """A factory of plans on one device.

    `name` is the registry's; `operations` says which of `tensor_transform`, `scattered_transform`, `mesh_spread`,
    `spline_contract`, `polygon_transform` and `mesh_transform` it has. The last two are exact sums, for the reference.
    """

    name: ClassVar[str]
    operations: ClassVar[frozenset[str]]
    info: DeviceInfo

    @classmethod
    def probe(cls) -> Sequence[DeviceInfo]:
        """All devices found, usable or not, without building anything; raises nothing."""

    def __init__(self, info: DeviceInfo) -> None: ...

    def plan_tensor_transform(self, spec: TensorSpec) -> TensorPlan: ...

    def plan_scattered_transform(self, spec: ScatteredSpec) -> ScatteredPlan: ...

    def plan_spline_contract(self, spec: SplineSpec) -> SplinePlan: ...
