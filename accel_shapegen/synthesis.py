"""Shape generator → field: the zero node, the Fourier coefficients, and the truncated series on a grid.

Source: J. Li, H. Liu, W.-Y. Tsui, X. Wang, "An inverse scattering approach for geometric body generation" (2020).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments, backends, batches, voxel_transform
from .backends.base import Backend, TensorAxis, TensorPlan, TensorSpec
from .errors import DtypeError, ShapeError
from .geometry import Frame, Grid
from .nodes import FourierLattice, far_field_constant

Window = Literal["lanczos", "fejer"]


class ZeroNodeFormula:
    """f̂_0 from the zero node and the coefficients on the line ξ = (ξ1, 0[, 0]).

    f̂_0 = μπ/(|V0| sin μπ) · { u∞(x̂0,k0)/C_{d,k0} - Σ_{ξ≠0} f̂_ξ c_ξ },  c_ξ = -|V0| cos(πξ1) sin(πμ) / ((ξ1-μ)π).

    With d_ξ = 1/(|V0| C_{d,k}) for ξ ≠ 0 this is a fixed linear form in u∞ on that line: f̂_0 = Σ_ξ1 form[ξ1] u[ξ1].
    """

    def __init__(self, lattice: FourierLattice) -> None:
        self.line: tuple[Any, ...] = (slice(None), *lattice.zero_slot[1:])
        volume, mu = lattice.box.volume, lattice.mu
        xi = np.arange(-lattice.order[0], lattice.order[0] + 1)
        constant = far_field_constant(lattice.wavenumbers[self.line], lattice.dim)
        overlap = -volume * np.cos(np.pi * xi) * math.sin(math.pi * mu) / ((xi - mu) * math.pi)
        scale = mu * math.pi / (volume * math.sin(mu * math.pi))
        self.form = -scale * overlap / (volume * constant)
        self.form[lattice.zero_slot[0]] = scale / constant[lattice.zero_slot[0]]

    def apply(self, u: NDArray[Any]) -> NDArray[np.complex128]:
        """(b, *lattice.shape) → (b,); summed in float64 whatever the data's precision."""
        line: tuple[Any, ...] = (slice(None), *self.line)
        return np.asarray(u[line].astype(np.complex128) @ self.form)


def coefficient_factor(lattice: FourierLattice) -> NDArray[np.complex128]:
    """d_ξ = 1/(|V0| C_{d,k}), shape lattice.shape; 1 in the zero slot, which has a formula of its own."""
    factor = 1 / (lattice.box.volume * far_field_constant(lattice.wavenumbers, lattice.dim))
    factor[lattice.zero_slot] = 1
    return factor


def spectral_window(lattice: FourierLattice, window: Window | None) -> NDArray[np.float64]:
    """`lanczos`: Π_j sinc(ξ_j/(N_j+1)); `fejer`: Π_j (1 - |ξ_j|/(N_j+1)); None: ones. Shape lattice.shape."""
    if window is not None:
        arguments.choice("window", window, ("lanczos", "fejer"))
    result = np.ones(lattice.shape)
    for axis, order in enumerate(lattice.order):
        xi = np.arange(-order, order + 1) / (order + 1)
        factor = np.ones(len(xi)) if window is None else np.sinc(xi) if window == "lanczos" else 1 - np.abs(xi)
        result *= factor.reshape(-1, *(1,) * (lattice.dim - axis - 1))
    return result


def fourier_coefficients(u: ArrayLike, lattice: FourierLattice) -> NDArray[Any]:
    """f̂_ξ = u∞/(|V0| C_{d,k}) for ξ ≠ 0, and f̂_0 from the zero node in the centre.

    Parameters
    ----------
    u : array_like, shape (..., *lattice.shape)
        Shape generators.

    Returns
    -------
    array, shape (..., *lattice.shape), complex64 or complex128 as `u`
    """
    generators = _generators(u, lattice, check=True)
    flat = generators.reshape(-1, *lattice.shape)
    result = (flat * coefficient_factor(lattice)).astype(generators.dtype)
    centre: tuple[Any, ...] = (slice(None), *lattice.zero_slot)
    result[centre] = ZeroNodeFormula(lattice).apply(flat)
    return result.reshape(generators.shape)


class SynthesisPlan:
    """Fields of shape generators on a fixed grid; made by `plan_synthesis`.

    Attributes
    ----------
    lattice : FourierLattice
        Of the generators.
    grid : Grid
        Where the field is wanted.
    batch : int
        Bodies handled at once.
    dtype : dtype
        complex64 or complex128: of the generators; the field is real of the same precision.
    device : str
        What it runs on.
    """

    def __init__(
        self, lattice: FourierLattice, grid: Grid, batch: int, dtype: np.dtype[Any], plan: TensorPlan, exact: bool
    ) -> None:
        self.lattice = lattice
        self.grid = grid
        self.batch = batch
        self.dtype = dtype
        self.device = plan.device
        self._plan = plan
        self._zero_node = ZeroNodeFormula(lattice)
        self._frame_per_body = exact

    def apply(self, u: ArrayLike, *, out: NDArray[Any] | None = None, check: bool = True) -> NDArray[Any]:
        """f_N(x) = Re { f̂_0 + Σ_{1≤|ξ|∞≤N} f̂_ξ exp(2πi Σ_j ξ_j x_j/a_j) }, and 0 outside the box.

        Parameters
        ----------
        u : array_like, shape (..., *lattice.shape)
            Shape generators; they need not be Hermitian.
        out : array, shape (..., *grid.shape), optional
            Filled and returned: C-contiguous, real, of the plan's precision.
        check : bool
            Scan for NaN and infinities, in what comes in and in what comes out.

        Returns
        -------
        array, shape (..., *grid.shape), real
        """
        generators = arguments.complex_array("u", u, self.dtype, check=check)
        lead = batches.leading("u", generators.shape, self.lattice.shape)
        flat = generators.reshape(-1, *self.lattice.shape)
        mean = self._zero_node.apply(flat).astype(self.dtype)
        result = batches.output(out, (*lead, *self.grid.shape), arguments.real_dtype(self.dtype))
        batches.in_batches(
            lambda chunk, into, some: self._plan.adjoint(chunk, centre=mean[some], out=into),
            flat,
            result.reshape(-1, *self.grid.shape),
            self.batch,
            exact=self._frame_per_body,
        )
        if check:
            arguments.require_in_range("u", result, self.dtype)
        return result

    def adjoint(self, field: ArrayLike, *, out: NDArray[Any] | None = None, check: bool = True) -> NDArray[Any]:
        """The adjoint of `apply` with respect to Re⟨·,·⟩: (..., *grid.shape) → (..., *lattice.shape)."""
        values = arguments.real_array("field", field, arguments.real_dtype(self.dtype), check=check)
        lead = batches.leading("field", values.shape, self.grid.shape)
        result = batches.output(out, (*lead, *self.lattice.shape), self.dtype)
        flat = result.reshape(-1, *self.lattice.shape)
        batches.in_batches(
            lambda chunk, into, _: self._plan.forward(chunk, out=into),
            values.reshape(-1, *self.grid.shape),
            flat,
            self.batch,
            exact=self._frame_per_body,
        )
        # Only Re f̂_0 enters the field, so the centre's cotangent is the real sum of the field's.
        centre: tuple[Any, ...] = (slice(None), *self.lattice.zero_slot)
        mean = flat[centre].real.astype(np.float64)
        flat[centre] = 0
        line: tuple[Any, ...] = (slice(None), *self._zero_node.line)
        flat[line] += mean[:, None] * self._zero_node.form.conj()
        return result


def plan_synthesis(
    lattice: FourierLattice,
    grid: Grid,
    *,
    batch: int = 1,
    frame: Frame | Sequence[Frame] | None = None,
    window: Window | None = None,
    dtype: Any = "complex64",
    backend: str | Backend | None = None,
) -> SynthesisPlan:
    """Plan the synthesis of shape generators on `lattice` into fields on `grid`.

    Parameters
    ----------
    lattice : FourierLattice
        Of the generators.
    grid : Grid
        Any tensor grid; points outside the box get 0, never a periodic copy.
    batch : int
        Bodies handled at once; calls may bring any number.
    frame : Frame or sequence of Frame, optional
        The generators are of the body in frame coordinates: the field is f_N((x - c)/σ), and 0 where (x - c)/σ lies
        outside the box. A sequence gives each body of a batch its own and must have `batch` entries.
    window : "lanczos" or "fejer", optional
        Spectral window, applied after f̂_0 is found; none by default, as in the paper.
    dtype : "complex64" or "complex128"
        Precision of the computation; the field is real of the same precision.
    backend : str, optional
        See `accel_shapegen.backends.get`.
    """
    if not isinstance(lattice, FourierLattice):
        raise DtypeError("lattice", f"is a {type(lattice).__name__}", "give a FourierLattice")
    if not isinstance(grid, Grid):
        raise DtypeError("grid", f"is a {type(grid).__name__}", "give a Grid")
    if grid.dim != lattice.dim:
        raise ShapeError("grid", f"is {grid.dim}-D, the lattice is {lattice.dim}-D", "give both the same dimension")
    precision = arguments.complex_dtype("dtype", dtype)
    batch = arguments.count("batch", batch)
    frames = voxel_transform.frame_list(frame, lattice.dim, batch)
    axes = tuple(_axis(lattice, grid, j, frames) for j in range(lattice.dim))
    spec = TensorSpec(
        axes=axes,
        batch=batch,
        dtype=arguments.real_dtype(precision),
        # The operation's adjoint conjugates its weights.
        node_weights=(spectral_window(lattice, window) * coefficient_factor(lattice)).conj(),
    )
    plan = backends.get(backend, operation="tensor_transform").plan_tensor_transform(spec)
    return SynthesisPlan(lattice, grid, batch, precision, plan, exact=len(frames) > 1)


def synthesize(
    u: ArrayLike,
    lattice: FourierLattice,
    grid: Grid,
    *,
    frame: Frame | Sequence[Frame] | None = None,
    window: Window | None = None,
    backend: str | Backend | None = None,
    check: bool = True,
) -> NDArray[Any]:
    """The field of one or many shape generators on a grid; `plan_synthesis` and one `apply`.

    Parameters
    ----------
    u : array_like, shape (..., *lattice.shape), complex64 or complex128
        Shape generators; their precision is that of the computation.
    lattice, grid, window, backend
        As in `plan_synthesis`.
    frame : Frame or sequence of Frame, optional
        One for all bodies, or one per body in C order of the leading axes.

    Returns
    -------
    array, shape (..., *grid.shape), float32 or float64
    """
    generators = _generators(u, lattice, check=False)
    if not isinstance(grid, Grid):
        raise DtypeError("grid", f"is a {type(grid).__name__}", "give a Grid")
    count = math.prod(generators.shape[: -lattice.dim])
    per_body = frame is not None and not isinstance(frame, Frame)
    batch = count if per_body else batches.one_shot_batch(count, 8 * math.prod(grid.shape))
    plan = plan_synthesis(
        lattice, grid, batch=batch, frame=frame, window=window, dtype=generators.dtype, backend=backend
    )
    return plan.apply(generators, check=check)


def _generators(u: ArrayLike, lattice: FourierLattice, *, check: bool) -> NDArray[Any]:
    if not isinstance(lattice, FourierLattice):
        raise DtypeError("lattice", f"is a {type(lattice).__name__}", "give a FourierLattice")
    array = arguments.plain_array("u", u)
    if array.dtype.name not in arguments.REAL_OF:
        raise DtypeError("u", f"has dtype {array.dtype}", "give complex64 or complex128 values")
    batches.leading("u", array.shape, lattice.shape)
    return arguments.complex_array("u", array, array.dtype.newbyteorder("="), check=check)


def _axis(lattice: FourierLattice, grid: Grid, j: int, frames: list[Frame]) -> TensorAxis:
    centre = np.array([frame.centre[j] for frame in frames])[:, None]
    scale = np.array([frame.scale[j] for frame in frames])[:, None]
    points = (grid.axes[j] - centre) / scale
    inside = np.abs(points) <= lattice.box.lengths[j] / 2
    if len(frames) == 1:
        points, inside = points[0], inside[0]
    return TensorAxis(
        points=points,
        order=lattice.order[j],
        step=lattice.step[j],
        weights=np.ones(2 * lattice.order[j] + 1),
        mask=None if inside.all() else inside,
    )
