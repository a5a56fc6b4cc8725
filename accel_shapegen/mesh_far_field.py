"""Far fields of meshes and polygons: the plan that spreads and transforms them, and the exact sums of the reference.

Source of the surface form: the divergence theorem; of the spread: A. Dutt, V. Rokhlin, SIAM J. Sci. Comput. 14 (1993),
with the window of A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41 (2019).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments, backends, batches, mesh_transform, voxel_transform
from .backends.base import Surface
from .errors import ArgumentError, MeshError, ShapeError
from .geometry import Frame, Polygons, TriangleMesh
from .mesh_transform import SmoothGrid
from .nodes import FourierLattice, Nodes, far_field_constant

Array = NDArray[Any]
Outline = tuple[Array, Array]  # corners in frame coordinates and pieces between them, all corners used

# Bodies share a plan where the box around all is at most so much larger than the largest box around one.
SHARED_GROWTH = 4.0
# A plan serves bodies down to this fraction of the thickness of those it was made for.
THINNER = 0.5
# Below this accuracy the spread and what follows are done in float64 even where complex64 is asked for.
LEAST_IN_FLOAT32 = 9e-7
# Of eps: more estimated rounding of the spread than this calls for float64 too, as for meshes of millions of triangles.
MOST_ROUNDING = 2.5
POINTS_AT_ONCE = 2048
# Least accuracy that scattered nodes are planned with.
LEAST_SCATTERED = {"float32": 5e-7, "float64": 1e-13}


class MeshFarFieldPlan:
    """Far fields of meshes, or of polygons, at fixed nodes; for bodies like those it is made for.

    It owns the voxels in between, so one thread at a time.

    Parameters
    ----------
    bodies : sequence of TriangleMesh, or of Polygons
        Their bounds and thickness decide grid and windows. Bodies to come must lie in the box around these, and be at
        least half as thick as the thinnest, in the mean along the axis of the sum: 2 volume / ∮ |n_z| dS.
    nodes : FourierLattice or ScatteredNodes
        Where the far field is wanted.
    frames : sequence of Frame
        One per body.
    eps : float
        Relative L2 accuracy over the nodes ξ ≠ 0, and of the zero node by itself.
    dtype : complex64 or complex128
        Of the result. Bodies so thin, or meshes so fine, that float32 would not do are computed in float64.
    batch : int
        Bodies handled at once.
    backend : Backend
        One with `mesh_spread`.

    Attributes
    ----------
    grid : SmoothGrid
        What bodies are spread on.
    device : str
        What it runs on.
    """

    def __init__(
        self,
        bodies: Sequence[TriangleMesh | Polygons],
        nodes: Nodes,
        frames: Sequence[Frame],
        *,
        eps: float,
        dtype: np.dtype[Any],
        batch: int,
        backend: Any,
    ) -> None:
        mesh_transform.require_accuracy(eps, dtype)
        self.nodes, self.dtype, self.batch, self.eps = nodes, dtype, batch, eps
        outlines = [outline(body, nodes, frame) for body, frame in zip(bodies, frames, strict=True)]
        corners = [(at.min(axis=0), at.max(axis=0)) for at, _ in outlines]
        self._bounds = np.stack(
            [np.min([low for low, _ in corners], axis=0), np.max([top for _, top in corners], axis=0)]
        )
        areas = np.array([mesh_transform.areas(*some) for some in outlines])
        volumes = np.array([_volume(*of) for of in zip(bodies, frames, strict=True)])
        self._axis = int(areas.sum(axis=0).argmin())
        # Mean lengths of the bodies, along the axis of the sum and along that where they are shortest.
        self._thickness = float((2 * volumes / areas[:, self._axis]).min())
        shortest = float((2 * volumes / areas.max(axis=1)).min())
        self._greatest = mesh_transform.greatest_kappa(nodes)
        own = eps / mesh_transform.amplification(shortest, self._bounds, self._greatest)
        self._own_eps = max(own, mesh_transform.LEAST_EPS["float64"])
        self._real, self.grid = self._choose_grid(outlines, own)
        self._spread = backend.plan_mesh_spread(mesh_transform.spread_spec(self.grid, self._real))
        if isinstance(nodes, FourierLattice):
            tensor = mesh_transform.lattice_spec(self.grid, nodes, batch, self._real)
            self._transform = backend.plan_tensor_transform(tensor)
        else:
            accuracy = max(eps / 3, LEAST_SCATTERED[self._real.name])
            scattered = mesh_transform.scattered_spec(self.grid, nodes, batch, self._real, accuracy)
            self._transform = backend.plan_scattered_transform(scattered)
        self.device: str = self._spread.device
        self._voxels = np.empty((batch, *self.grid.shape), dtype=self._real)

    def _choose_grid(self, outlines: Sequence[Outline], own: float) -> tuple[np.dtype[Any], SmoothGrid]:
        """In the precision of the result where that is enough, else in float64."""
        points = max(mesh_transform.point_count(*some, self._greatest, self._axis, self._own_eps) for some in outlines)
        for real in (arguments.real_dtype(self.dtype), np.dtype(np.float64)):
            grid = mesh_transform.smooth_grid(self._bounds, self._greatest, self._axis, self._own_eps, real, points)
            lost = mesh_transform.rounding(grid, points, real)
            if own >= LEAST_IN_FLOAT32 and lost <= MOST_ROUNDING * self.eps:
                break
        return real, grid

    def apply(
        self,
        bodies: Sequence[TriangleMesh | Polygons],
        frames: Sequence[Frame] | None = None,
        *,
        out: Array | None = None,
    ) -> Array:
        """u∞ of bodies, shape (len(bodies), *nodes.shape).

        Raises `MeshError` for an open or inward body, `OutsideBoxError` where one leaves the lattice's box, and
        `ArgumentError` for one that the plan was not made for.
        """
        identity = Frame((0.0,) * self.nodes.dim, 1.0)
        chosen = [identity] * len(bodies) if frames is None else list(frames)
        if len(chosen) != len(bodies):
            raise ShapeError("frames", f"has {len(chosen)} entries", f"give {len(bodies)}, one per body")
        result = batches.output(out, (len(bodies), *self.nodes.shape), self.dtype)
        for start in range(0, len(bodies), self.batch):
            some = slice(start, min(start + self.batch, len(bodies)))
            pairs = zip(bodies[some], chosen[some], strict=True)
            surfaces = [self._surface(number, *pair) for number, pair in enumerate(pairs, start)]
            voxels = self._spread.forward(surfaces, out=self._voxels[: len(surfaces)])
            if self._real == arguments.real_dtype(self.dtype):
                self._transform.forward(voxels, out=result[some])
            else:
                result[some] = self._transform.forward(voxels)
        return result

    def _surface(self, number: int, body: TriangleMesh | Polygons, frame: Frame) -> Surface:
        vertices, simplices = outline(body, self.nodes, frame)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        slack = voxel_transform.BOX_SLACK * np.abs(self._bounds).max()
        if np.any(low < self._bounds[0] - slack) or np.any(high > self._bounds[1] + slack):
            raise ArgumentError(
                f"bodies[{number}]", "leaves the box around the bodies that the plan was made for", "plan for it too"
            )
        surface = mesh_transform.surface(self.grid, self._greatest, vertices, simplices, self._own_eps)
        face = math.prod(h for j, h in enumerate(self.grid.spacing) if j != self._axis)
        area = face * float(np.abs(surface.strengths).sum())
        if 2 * _volume(body, frame) < THINNER * self._thickness * area:
            raise ArgumentError(
                f"bodies[{number}]", "is far thinner than the bodies that the plan was made for", "plan for it too"
            )
        return surface


def far_fields(
    bodies: Sequence[TriangleMesh | Polygons],
    nodes: Nodes,
    frames: Sequence[Frame],
    eps: float,
    dtype: np.dtype[Any],
    backend: Any,
) -> list[Array]:
    """u∞ of each body, through as few plans as their places allow."""
    boxes = [(body.bounds - frame.centre) / frame.scale for body, frame in zip(bodies, frames, strict=True)]
    union = np.stack([np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)])
    largest = max(float(np.prod(b[1] - b[0])) for b in boxes)
    together = float(np.prod(union[1] - union[0])) <= SHARED_GROWTH * largest
    groups = [range(len(bodies))] if together else [range(i, i + 1) for i in range(len(bodies))]
    rows: list[Array] = []
    for group in groups:
        some, own = [bodies[i] for i in group], [frames[i] for i in group]
        batch = min(len(some), batches.ONE_SHOT_BATCH)
        plan = MeshFarFieldPlan(some, nodes, own, eps=eps, dtype=dtype, batch=batch, backend=backend)
        rows += list(plan.apply(some, own))
    return rows


def outline(body: TriangleMesh | Polygons, nodes: Nodes, frame: Frame) -> Outline:
    """Corners in frame coordinates y = (x - c)/σ and the pieces between them, checked.

    Raises `MeshError` for a surface that is open or faces inward, `OutsideBoxError` for one that leaves the lattice's
    box.
    """
    if body.volume <= 0:
        kind, unit, remedy = (
            ("volume", "m³", "turn the triangles round, so that they run counter-clockwise seen from outside")
            if isinstance(body, TriangleMesh)
            else ("area", "m²", "order outer rings counter-clockwise, holes clockwise")
        )
        raise MeshError("body", f"has {kind} {body.volume:.6g} {unit}", remedy)
    if isinstance(body, TriangleMesh) and not body.is_closed:
        raise MeshError("body", "is not closed: an edge lacks its opposite", "close the holes of the mesh")
    if isinstance(nodes, FourierLattice):
        for axis, reach in enumerate(((body.bounds - frame.centre) / frame.scale).T):
            voxel_transform.require_within("body", reach, axis, nodes)
    if isinstance(body, Polygons):
        corners, pieces = np.concatenate(body.rings), _edges([len(ring) for ring in body.rings])
    else:
        corners, pieces = _used(body.vertices, body.faces)
    return (corners - frame.centre) / frame.scale, pieces


def _volume(body: TriangleMesh | Polygons, frame: Frame) -> float:
    """In frame coordinates."""
    return body.volume / math.prod(frame.scale)


def _edges(counts: Sequence[int]) -> Array:
    """Edges of rings of so many corners each, (E, 2)."""
    starts = np.concatenate([[0], np.cumsum(counts)])
    ends = [np.roll(np.arange(a, b), -1) for a, b in pairwise(starts)]
    return np.stack([np.arange(starts[-1]), np.concatenate(ends)], axis=1)


def _used(vertices: Array, faces: Array) -> Outline:
    """The mesh without vertices that no triangle has: they may lie anywhere."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return (vertices, faces) if used.all() else (vertices[used], (np.cumsum(used) - 1)[faces])


def exact(body: TriangleMesh, nodes: Nodes, frame: Frame, backend: Any) -> Array:
    """u∞ by converged quadrature of the surface integral in float64, complex128, shape (*nodes.shape)."""
    vertices, faces = outline(body, nodes, frame)
    constant = far_field_constant(nodes.wavenumbers, 3)
    if not isinstance(nodes, FourierLattice):
        return np.asarray(backend.mesh_transform(vertices, faces, nodes.kappa) * constant)
    axes = [step * np.arange(-n, n + 1) for step, n in zip(nodes.step, nodes.order, strict=True)]
    # The body is real: half of the lattice is the conjugate of the other half.
    half = backend.mesh_transform_tensor(vertices, faces, [axes[0][nodes.order[0] :], *axes[1:]])
    whole = np.concatenate([half[:0:-1, ::-1, ::-1].conj(), half])
    whole[nodes.zero_slot] = backend.mesh_transform(vertices, faces, nodes.kappa[nodes.zero_slot][None])[0]
    return np.asarray(whole * constant)


def far_field_vertex_gradient(
    body: TriangleMesh, nodes: Nodes, cotangent: ArrayLike, *, frame: Frame | None = None
) -> NDArray[np.float64]:
    """Derivative of Re⟨cotangent, far_field(body, nodes)⟩ in the vertices, in float64.

    Moving the surface by δv changes ∫_D exp(-iκ·y) dy by ∮ exp(-iκ·y) (δv·n) dS (Reynolds's transport theorem), and δv
    is linear on each triangle. Quadrature is converged, as the reference's: seconds for a fine mesh.

    Parameters
    ----------
    body : TriangleMesh
        Closed, outward.
    nodes : FourierLattice or ScatteredNodes
        3-D.
    cotangent : array_like, shape (*nodes.shape,)
        c, in Re Σ conj(c) u∞.
    frame : Frame, optional
        As in `far_field`.

    Returns
    -------
    float64 array, shape (V, 3)
        Per metre, of the vertices as they are given, not in frame coordinates.

    Raises
    ------
    ShapeError, NonFiniteError, MeshError, OutsideBoxError
        A cotangent of another shape or not finite, and what `far_field` refuses.
    """
    if nodes.dim != 3:
        raise ShapeError("nodes", f"is {nodes.dim}-D", "give 3-D nodes")
    values = arguments.complex_array("cotangent", cotangent, np.complex128)
    if values.shape != nodes.shape:
        raise ShapeError("cotangent", f"has shape {values.shape}", f"give {nodes.shape}")
    (chosen,) = voxel_transform.frame_list(frame, 3, 1)
    outline(body, nodes, chosen)
    strengths = values.conj() * far_field_constant(nodes.wavenumbers, 3)
    vertices = (body.vertices - chosen.centre) / chosen.scale
    wave = partial(_lattice_wave, nodes, strengths) if isinstance(nodes, FourierLattice) else None
    field = wave or partial(_scattered_wave, nodes.kappa, strengths)
    reference: Any = backends.get("reference", device=0)
    gradient = reference.mesh_gradient(vertices, body.faces, mesh_transform.greatest_kappa(nodes), field)
    return np.asarray(gradient / chosen.scale)


def _lattice_wave(lattice: FourierLattice, strengths: Array, points: Array) -> Array:
    """Re Σ_κ s_κ exp(-iκ·y), one axis after the other, points a few thousand at a time."""
    inside = strengths.copy()
    inside[lattice.zero_slot] = 0
    result = (strengths[lattice.zero_slot] * np.exp(-1j * lattice.zero_kappa * points[:, 0])).real
    kappa = [step * np.arange(-n, n + 1) for step, n in zip(lattice.step, lattice.order, strict=True)]
    for start in range(0, len(points), POINTS_AT_ONCE):
        some = slice(start, start + POINTS_AT_ONCE)
        first, second, third = (np.exp(-1j * np.outer(points[some, j], axis)) for j, axis in enumerate(kappa))
        plane = (first @ inside.reshape(len(inside), -1)).reshape(-1, *inside.shape[1:])
        line = np.einsum("pj,pjk->pk", second, plane)
        result[some] += np.einsum("pk,pk->p", third, line).real
    return np.asarray(result)


def _scattered_wave(kappa: Array, strengths: Array, points: Array) -> Array:
    parts = [
        (np.exp(-1j * points[start : start + POINTS_AT_ONCE] @ kappa.T) @ strengths).real
        for start in range(0, len(points), POINTS_AT_ONCE)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)
