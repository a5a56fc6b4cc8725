"""Body → shape generator: u∞(x̂,k) = C_{d,k} ∫_D exp(-i k x̂·y) dy over the nodes.

Source: J. Li, H. Liu, W.-Y. Tsui, X. Wang, "An inverse scattering approach for geometric body generation" (2020),
with the constant corrected (see `far_field_constant`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments, backends, batches, mesh_far_field, voxel_transform
from .backends.base import Backend, ScatteredPlan, TensorPlan
from .errors import ArgumentError, DtypeError, ShapeError
from .geometry import Frame, Grid, Polygons, TriangleMesh, VoxelGrid
from .nodes import FourierLattice, Nodes, far_field_constant, require_nodes

Body = VoxelGrid | Polygons | TriangleMesh


class FarFieldPlan:
    """Far fields of voxel bodies on one grid at fixed nodes; made by `plan_far_field`.

    Attributes
    ----------
    grid : Grid
        Cell centres of the bodies.
    nodes : FourierLattice or ScatteredNodes
        Where the far field is wanted.
    batch : int
        Bodies handled at once.
    dtype : dtype
        complex64 or complex128.
    device : str
        What it runs on.
    """

    def __init__(
        self,
        grid: Grid,
        nodes: Nodes,
        batch: int,
        dtype: np.dtype[Any],
        plan: TensorPlan | ScatteredPlan,
        frame_per_body: bool,
    ) -> None:
        self.grid = grid
        self.nodes = nodes
        self.batch = batch
        self.dtype = dtype
        self.device = plan.device
        self._plan = plan
        self._frame_per_body = frame_per_body

    def apply(self, values: ArrayLike, *, out: NDArray[Any] | None = None, check: bool = True) -> NDArray[Any]:
        """u∞ of voxel bodies: C_{d,k} Π_j h_j sinc(κ_j h_j/2π) Σ_g v_g exp(-iκ·x_g).

        Parameters
        ----------
        values : array_like, shape (..., *grid.shape)
            Cell values, real; converted to the plan's precision.
        out : array, shape (..., *nodes.shape), optional
            Filled and returned: C-contiguous, of the plan's dtype.
        check : bool
            Scan for NaN and infinities, in what comes in and in what comes out.

        Returns
        -------
        array, shape (..., *nodes.shape), of the plan's dtype
        """
        real = arguments.real_array("values", values, arguments.real_dtype(self.dtype), check=check)
        lead = batches.leading("values", real.shape, self.grid.shape)
        result = batches.output(out, (*lead, *self.nodes.shape), self.dtype)
        batches.in_batches(
            lambda chunk, into, _: self._plan.forward(chunk, out=into),
            real.reshape(-1, *self.grid.shape),
            result.reshape(-1, *self.nodes.shape),
            self.batch,
            exact=self._frame_per_body,
        )
        if check:
            arguments.require_in_range("values", result, self.dtype)
        return result

    def adjoint(self, u: ArrayLike, *, out: NDArray[Any] | None = None, check: bool = True) -> NDArray[Any]:
        """The adjoint of `apply` with respect to Re⟨·,·⟩: (..., *nodes.shape) → real (..., *grid.shape)."""
        values = arguments.complex_array("u", u, self.dtype, check=check)
        lead = batches.leading("u", values.shape, self.nodes.shape)
        result = batches.output(out, (*lead, *self.grid.shape), arguments.real_dtype(self.dtype))
        batches.in_batches(
            lambda chunk, into, _: self._plan.adjoint(chunk, out=into),
            values.reshape(-1, *self.nodes.shape),
            result.reshape(-1, *self.grid.shape),
            self.batch,
            exact=self._frame_per_body,
        )
        if check:
            arguments.require_in_range("u", result, self.dtype)
        return result


def plan_far_field(
    grid: Grid,
    nodes: Nodes,
    *,
    batch: int = 1,
    frame: Frame | Sequence[Frame] | None = None,
    eps: float = 1e-6,
    dtype: Any = "complex64",
    backend: str | Backend | None = None,
) -> FarFieldPlan:
    """Plan the far fields of voxel bodies on `grid`.

    Parameters
    ----------
    grid : Grid
        Cell centres, equidistant on each axis; within the lattice's box.
    nodes : FourierLattice or ScatteredNodes
        Where the far field is wanted.
    batch : int
        Bodies handled at once; calls may bring any number.
    frame : Frame or sequence of Frame, optional
        The far field is that of the body in frame coordinates y = (x - c)/σ, with no factor |σ|. A sequence gives
        each body of a batch its own (lattice nodes only) and must have `batch` entries.
    eps : float
        Relative accuracy at scattered nodes; a lattice is always summed to rounding. Phases carry an error of 2⁻⁵³ κ·x
        in float64 whatever is asked: no `eps` below that can be met.
    dtype : "complex64" or "complex128"
        Precision of the computation and of the result.
    backend : str, optional
        See `accel_shapegen.backends.get`.

    Raises
    ------
    ShapegenError
        A typed error naming the argument: dimensions that differ, a grid that is not equidistant or reaches out of
        the lattice's box, an accuracy that the dtype cannot give, a missing backend or too little memory.
    """
    if not isinstance(grid, Grid):
        raise DtypeError("grid", f"is a {type(grid).__name__}", "give a Grid")
    _require_nodes(nodes, grid.dim, "grid")
    precision = arguments.complex_dtype("dtype", dtype)
    batch = arguments.count("batch", batch)
    frames = voxel_transform.frame_list(frame, grid.dim, batch)
    _require_eps(eps)
    plan: TensorPlan | ScatteredPlan
    if isinstance(nodes, FourierLattice):
        tensor = voxel_transform.lattice_spec(grid, nodes, batch, precision, frames)
        plan = backends.get(backend, operation="tensor_transform").plan_tensor_transform(tensor)
    else:
        scattered = voxel_transform.scattered_spec(grid, nodes, batch, precision, frames, float(eps))
        plan = backends.get(backend, operation="scattered_transform").plan_scattered_transform(scattered)
    return FarFieldPlan(grid, nodes, batch, precision, plan, frame_per_body=len(frames) > 1)


def far_field(
    body: Body | Iterable[Body],
    nodes: Nodes,
    *,
    frame: Frame | Sequence[Frame] | None = None,
    eps: float = 1e-6,
    dtype: Any = "complex64",
    backend: str | Backend | None = None,
    check: bool = True,
) -> NDArray[Any]:
    """u∞(x̂,k) = C_{d,k} ∫_D exp(-i k x̂·y) dy of one body or many.

    Parameters
    ----------
    body : VoxelGrid, TriangleMesh, Polygons, or an iterable of them
        Voxel bodies are piecewise constant functions and are transformed as such, to rounding. A mesh must be closed
        and face outward; its transform is exact up to `eps`, and where surfaces overlap the density is the winding
        number. Polygons are transformed in closed form, unless a `backend` is named that only has `mesh_spread`.
        The reference integrates meshes to rounding, in seconds for a fine one.
    nodes : FourierLattice or ScatteredNodes
        Where the far field is wanted.
    frame : Frame or sequence of Frame, optional
        The far field is that of the body in frame coordinates y = (x - c)/σ, with no factor |σ|; one frame for all
        bodies, or one per body.
    eps : float
        Relative L2 accuracy of meshes over the nodes ξ ≠ 0, and of the zero node by itself, met to a factor of 3; and
        of voxels at scattered nodes. Meshes take 1e-6 or more in complex64, 1e-12 or more in complex128.
    dtype : "complex64" or "complex128"
        Precision of the computation and of the result.
    backend : str, optional
        See `accel_shapegen.backends.get`.
    check : bool
        Scan values for NaN and infinities.

    Returns
    -------
    array, shape (..., *nodes.shape)
        The batch axes of a VoxelGrid lead; a list of bodies adds one axis in front.
    """
    if isinstance(body, Body):
        if frame is not None and not isinstance(frame, Frame):
            raise DtypeError("frame", f"is a {type(frame).__name__}", "give one Frame for one body")
        return _alike([body], nodes, [frame], eps, dtype, backend, check)[0]
    if isinstance(body, (str, bytes, np.ndarray)) or not isinstance(body, Iterable):
        raise DtypeError(
            "body", f"is a {type(body).__name__}", "give a VoxelGrid, TriangleMesh or Polygons, or a list of them"
        )
    bodies = list(body)
    if not bodies:
        raise ShapeError("body", "is an empty list", "give at least one body")
    frames = [frame] * len(bodies) if frame is None or isinstance(frame, Frame) else list(frame)
    if len(frames) != len(bodies):
        raise ShapeError("frame", f"has {len(frames)} entries", f"give one, or {len(bodies)}, one per body")
    rows: list[NDArray[Any]] = []
    for _, group in groupby(zip(bodies, frames, strict=True), key=lambda pair: _plan_key(*pair)):
        some_bodies, some_frames = zip(*group, strict=True)
        rows += _alike(some_bodies, nodes, some_frames, eps, dtype, backend, check)
    if len({row.shape for row in rows}) > 1:
        raise ShapeError("body", "mixes batches of different shapes", "give bodies with the same leading axes")
    return np.stack(rows)


def _plan_key(body: Any, frame: Frame | None) -> tuple[Any, ...]:
    """Neighbours in a list that share this share a plan."""
    if isinstance(body, VoxelGrid):
        return (VoxelGrid, body.box, body.values.shape, frame)
    return (type(body),)


def _alike(
    bodies: Sequence[Any],
    nodes: Nodes,
    frames: Sequence[Frame | None],
    eps: float,
    dtype: Any,
    backend: str | Backend | None,
    check: bool,
) -> list[NDArray[Any]]:
    """Far fields of bodies of one kind: voxels on one grid in one frame, meshes or polygons in any."""
    first = bodies[0]
    if isinstance(first, Polygons):
        return _polygons(bodies, nodes, frames, eps, dtype, backend)
    if isinstance(first, TriangleMesh):
        return _meshes(bodies, nodes, frames, eps, dtype, backend)
    if not isinstance(first, VoxelGrid):
        raise DtypeError(
            "body", f"is a {type(first).__name__}", "give a VoxelGrid, TriangleMesh or Polygons, or a list of them"
        )
    cells, per_body = math.prod(first.grid.shape), max(1, math.prod(first.batch_shape))
    batch = batches.one_shot_batch(len(bodies) * per_body, 8 * cells)
    plan = plan_far_field(first.grid, nodes, batch=batch, frame=frames[0], eps=eps, dtype=dtype, backend=backend)
    if per_body >= batch:
        return [plan.apply(body.values, check=check) for body in bodies]
    rows: list[NDArray[Any]] = []
    together = batch // per_body
    for start in range(0, len(bodies), together):
        stacked = np.stack([body.values for body in bodies[start : start + together]])
        rows += list(plan.apply(stacked, check=check))
    return rows


def _meshes(
    bodies: Sequence[TriangleMesh],
    nodes: Nodes,
    frames: Sequence[Frame | None],
    eps: float,
    dtype: Any,
    backend: str | Backend | None,
) -> list[NDArray[Any]]:
    """Meshes through the spread; the reference sums the surface integral plainly, to rounding."""
    precision, own = _settled(nodes, 3, frames, eps, dtype)
    chosen: Any = backends.get(backend, operation="mesh_spread")
    if "mesh_transform" in chosen.operations:
        pairs = zip(bodies, own, strict=True)
        return [mesh_far_field.exact(body, nodes, frame, chosen).astype(precision) for body, frame in pairs]
    return mesh_far_field.far_fields(bodies, nodes, own, float(eps), precision, chosen)


def _polygons(
    bodies: Sequence[Polygons],
    nodes: Nodes,
    frames: Sequence[Frame | None],
    eps: float,
    dtype: Any,
    backend: str | Backend | None,
) -> list[NDArray[Any]]:
    """Polygons in closed form, or through the spread where a backend is asked for that has only that."""
    precision, own = _settled(nodes, 2, frames, eps, dtype)
    if backend is not None:
        named: Any = backends.get(backend)
        if "polygon_transform" not in named.operations and "mesh_spread" in named.operations:
            return mesh_far_field.far_fields(bodies, nodes, own, float(eps), precision, named)
    chosen: Any = backends.get(backend, operation="polygon_transform")
    constant = far_field_constant(nodes.wavenumbers, 2)
    kappa = nodes.kappa.reshape(-1, 2)
    results = []
    for body, frame in zip(bodies, own, strict=True):
        mesh_far_field.outline(body, nodes, frame)
        rings = [(ring - frame.centre) / frame.scale for ring in body.rings]
        if isinstance(nodes, FourierLattice):
            # The body is real: half of the lattice is the conjugate of the other half.
            half = chosen.polygon_transform(rings, kappa[nodes.size // 2 :])
            values = nodes.unpack(half, symmetry="fourier")
        else:
            values = chosen.polygon_transform(rings, kappa)
        results.append((values * constant).astype(precision))
    return results


def _settled(
    nodes: Nodes, dim: int, frames: Sequence[Frame | None], eps: float, dtype: Any
) -> tuple[np.dtype[Any], list[Frame]]:
    """Precision and frames of bodies with surfaces, after what is common to all has been checked."""
    _require_nodes(nodes, dim, "body")
    precision = arguments.complex_dtype("dtype", dtype)
    _require_eps(eps)
    return precision, [voxel_transform.frame_list(frame, dim, 1)[0] for frame in frames]


def _require_eps(eps: float) -> None:
    if not (isinstance(eps, (int, float, np.floating)) and 0 < eps < 1):
        raise ArgumentError("eps", f"is {eps!r}", "give 0 < eps < 1")


def _require_nodes(nodes: Nodes, dim: int, other: str) -> None:
    require_nodes(nodes)
    if nodes.dim != dim:
        raise ShapeError("nodes", f"is {nodes.dim}-D, {other} is {dim}-D", "give both the same dimension")
