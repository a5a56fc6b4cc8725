"""How far a generated body is from the exact one: overlap, distance of surfaces, volume, far-field error."""

from __future__ import annotations

from numbers import Real
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ArgumentError, DtypeError, ShapeError
from .geometry import Polygons, TriangleMesh, VoxelGrid

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Nearest samples whose triangles are tried for the exact distance to a surface.
CANDIDATES = 8
# More would take gigabytes and minutes.
MOST_SAMPLES = 2e7
# Points whose exact distance is worked out at once.
BLOCK = 1 << 14


class Nodes(Protocol):
    """A lattice, which has a `zero_slot`, or scattered nodes, which have none."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a far field on these nodes."""


def iou(a: ArrayLike | VoxelGrid, b: ArrayLike | VoxelGrid) -> float:
    """Intersection over union |A ∩ B| / |A ∪ B| of two bodies by cells.

    Parameters
    ----------
    a, b : boolean array or VoxelGrid of booleans
        Membership per cell, of the same shape; two voxel bodies must also fill the same box.

    Returns
    -------
    float
        Between 0 (disjoint) and 1 (equal).

    Raises
    ------
    DtypeError, ShapeError, ArgumentError
        Values that are not boolean, different shapes or boxes, or two empty bodies, whose quotient is 0/0.
    """
    if isinstance(a, VoxelGrid) and isinstance(b, VoxelGrid) and a.box != b.box:
        raise ArgumentError("b", f"fills {b.box}", f"compare on one grid: a fills {a.box}")
    first, second = (np.asarray(x.values if isinstance(x, VoxelGrid) else x) for x in (a, b))
    for name, values in (("a", first), ("b", second)):
        if values.dtype != np.bool_:
            raise DtypeError(name, f"has dtype {values.dtype}", f"give booleans, as in {name} > 0.5")
    if first.shape != second.shape:
        raise ShapeError("b", f"has shape {second.shape}", f"give the shape of a, {first.shape}")
    union = np.count_nonzero(first | second)
    if union == 0:
        raise ArgumentError("a, b", "are both empty", "give at least one body with a cell in it")
    return np.count_nonzero(first & second) / union


def volume_error(body: TriangleMesh | Polygons, exact: TriangleMesh | Polygons) -> float:
    """Relative error |V - V_exact| / |V_exact| of the enclosed volumes (areas in the plane).

    Raises
    ------
    DtypeError, ArgumentError
        Bodies that are not surfaces of one dimension, or an exact one that encloses nothing.
    """
    _require_surfaces(("body", body), ("exact", exact))
    if exact.volume == 0:
        raise ArgumentError("exact", "encloses no volume", "give a body to compare with")
    return abs(body.volume - exact.volume) / abs(exact.volume)


def far_field_error(u: ArrayLike, u_exact: ArrayLike, nodes: Nodes) -> NDArray[np.float64] | float:
    """Relative L2 error ‖u - u_exact‖ / ‖u_exact‖ of far fields.

    On a lattice the sums run over ξ ≠ 0: the zero slot is one to two orders larger than the rest and would hide
    everything else. On scattered nodes they run over all.

    Parameters
    ----------
    u, u_exact : array_like, shape (..., *nodes.shape)
        Complex or real values; leading axes are a batch.
    nodes : FourierLattice or ScatteredNodes
        The nodes of both.

    Returns
    -------
    float, or array of the batch shape
        Sums are taken in float64.

    Raises
    ------
    ShapeError, NonFiniteError, DtypeError
        Shapes that differ or do not end in `nodes.shape`; values that are not finite numbers.
    ArgumentError
        An exact far field that is zero wherever it counts.
    """
    shape = tuple(nodes.shape)
    got, exact = (arguments.complex_array(n, x, np.complex128) for n, x in (("u", u), ("u_exact", u_exact)))
    if exact.ndim < len(shape) or exact.shape[exact.ndim - len(shape) :] != shape:
        raise ShapeError("u_exact", f"has shape {exact.shape}", f"give (..., {', '.join(map(str, shape))})")
    if got.shape != exact.shape:
        raise ShapeError("u", f"has shape {got.shape}", f"give the shape of u_exact, {exact.shape}")
    weight = np.ones(shape)
    zero_slot = getattr(nodes, "zero_slot", None)
    if zero_slot is not None:
        weight[zero_slot] = 0.0
    axes = tuple(range(exact.ndim - len(shape), exact.ndim))
    size = np.sqrt(np.sum(weight * np.abs(exact) ** 2, axis=axes))
    if np.any(size == 0):
        first = tuple(int(i) for i in np.argwhere(size == 0)[0])
        where = f" for body {first}" if first else ""
        raise ArgumentError("u_exact", f"is zero at every node that counts{where}", "compare absolute errors instead")
    error = np.sqrt(np.sum(weight * np.abs(got - exact) ** 2, axis=axes)) / size
    return error if error.ndim else float(error)


def hausdorff(a: TriangleMesh | Polygons, b: TriangleMesh | Polygons, *, spacing: float | None = None) -> float:
    """Hausdorff distance max(sup_{x∈A} d(x, B), sup_{y∈B} d(y, A)) [m] of two surfaces.

    Parameters
    ----------
    a, b : TriangleMesh or Polygons
        Two surfaces of the same dimension.
    spacing : float, optional
        Each surface is sampled so that every point of it is within this distance [m] of a sample, corners
        included. The default is 1/250 of the diagonal of the bounding box of both.

    Returns
    -------
    float
        Right to within `spacing`; much nearer where the largest distance is taken at a corner, because distances from
        the samples of one surface are to the triangles of the other, not to its samples.

    Raises
    ------
    DtypeError, ArgumentError
        Bodies that are not surfaces of one dimension; a spacing that is not positive, or so small that it takes more
        than 20 million samples.
    """
    _require_surfaces(("a", a), ("b", b))
    if spacing is None:
        corners = np.concatenate([a.bounds, b.bounds])
        spacing = float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0))) / 250
    if isinstance(spacing, (bool, np.bool_)) or not isinstance(spacing, Real) or not 0 < float(spacing) < np.inf:
        raise ArgumentError("spacing", f"is {spacing!r}", "give a positive length in metres")
    pieces_a, pieces_b = _pieces(a), _pieces(b)
    samples_a, samples_b = _sample(pieces_a, float(spacing)), _sample(pieces_b, float(spacing))
    return max(_reach(samples_a[0], samples_b, pieces_b), _reach(samples_b[0], samples_a, pieces_a))


def _require_surfaces(*named: tuple[str, Any]) -> None:
    for name, value in named:
        if not isinstance(value, (TriangleMesh, Polygons)):
            raise DtypeError(name, f"is a {type(value).__name__}", "give a TriangleMesh or Polygons")
    (_, first), (name, second) = named
    if first.dim != second.dim:
        raise ShapeError(name, f"is a body in {second.dim}-D", f"compare it with one in {second.dim}-D")


def _pieces(surface: TriangleMesh | Polygons) -> Floats:
    """Triangles (n, 3, 3), or segments (n, 2, 2)."""
    if isinstance(surface, TriangleMesh):
        return surface.vertices[surface.faces]
    return np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in surface.rings])


def _sample(pieces: Floats, step: float) -> tuple[Floats, Ints]:
    """Points on the pieces, corners included, no farther apart than `step`, and the piece each is on."""
    edges = np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=-1).max(axis=1)
    divisions = np.maximum(np.ceil(edges / step), 1)
    count = float(np.sum((divisions + 1) * (divisions + 2) / 2 if pieces.shape[1] == 3 else divisions + 1))
    if count > MOST_SAMPLES:
        raise ArgumentError("spacing", f"is {step}, which takes {count:.2g} samples", "give a larger one")
    divisions = divisions.astype(np.int64)
    points, owners = [], []
    for n in np.unique(divisions):
        members = np.flatnonzero(divisions == n)
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        if pieces.shape[1] == 3:
            i, j = i[i + j <= n], j[i + j <= n]
            weights = np.stack([n - i - j, i, j], axis=1) / n
        else:
            weights = np.stack([n - i[:, 0], i[:, 0]], axis=1) / n
        points.append(np.einsum("wc,mcd->mwd", weights, pieces[members]).reshape(-1, pieces.shape[2]))
        owners.append(np.repeat(members, len(weights)))
    return np.concatenate(points), np.concatenate(owners)


def _reach(points: Floats, target: tuple[Floats, Ints], pieces: Floats) -> float:
    """The largest distance of the points from a surface."""
    from scipy.spatial import cKDTree

    samples, owners = target
    # Samples lie on lattices, which SciPy's default median splits and tight boxes serve badly.
    tree: Any = cKDTree(samples, leafsize=32, balanced_tree=False, compact_nodes=False)
    coarse = tree.query(points)[0]
    order = np.argsort(-coarse)
    largest = 0.0
    for start in range(0, len(points), BLOCK):
        block = order[start : start + BLOCK]
        # The distance to the samples bounds the one to the surface: from here on none can be larger.
        if coarse[block[0]] <= largest:
            break
        nearest = owners[tree.query(points[block], k=min(CANDIDATES, len(samples)))[1].reshape(len(block), -1)]
        tried = nearest.shape[1]
        exact = _distance(np.repeat(points[block], tried, axis=0), pieces[nearest.ravel()])
        largest = max(largest, float(exact.reshape(-1, tried).min(axis=1).max()))
    return largest


def _distance(points: Floats, pieces: Floats) -> Floats:
    """Distance of each point from the segment or triangle beside it, degenerate ones included."""
    sides = [_to_segment(points, pieces[:, i], pieces[:, (i + 1) % 3]) for i in range(3 if pieces.shape[1] == 3 else 1)]
    nearest = np.minimum.reduce(sides)
    if pieces.shape[1] == 2:
        return nearest
    normal = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
    length = np.linalg.norm(normal, axis=1)
    over = length > 0
    for i in range(3):
        left = np.cross(pieces[:, (i + 1) % 3] - pieces[:, i], points - pieces[:, i])
        over &= np.einsum("ij,ij->i", left, normal) >= 0
    height = np.abs(np.einsum("ij,ij->i", points - pieces[:, 0], normal))
    nearest[over] = height[over] / length[over]
    return nearest


def _to_segment(points: Floats, start: Floats, end: Floats) -> Floats:
    along = end - start
    square = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", points - start, along) / np.where(square > 0, square, 1)
    return np.asarray(np.linalg.norm(start + np.clip(share, 0, 1)[:, None] * along - points, axis=1))
