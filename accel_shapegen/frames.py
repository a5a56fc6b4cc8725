"""Reference frames of bodies: y = (x - c)/σ, by bounding box, by moments, or by a rule of one's own.

Bodies of a training set differ most in where they lie and how large they are. Both come out of the far field as phases
that turn quickly from body to body; in frames they are two small vectors per body instead, which a spline follows with
ease, and the far fields that are left to learn are those of bodies of one size in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import arguments
from .errors import ArgumentError, DtypeError, MeshError, ShapeError, ShapegenError
from .geometry import Box, Frame, Polygons, TriangleMesh, VoxelGrid

RULES = ("height", "bbox", "moments")

Body = VoxelGrid | Polygons | TriangleMesh
Rule = Literal["height", "bbox", "moments"] | Callable[[Any], Any]
Floats = NDArray[np.float64]


def frame_of(body: Body, rule: Rule) -> Frame:
    """The frame of one body, before it is compared with others: centre c [m] and size s per axis [m].

    Parameters
    ----------
    body : VoxelGrid, Polygons or TriangleMesh
        A single body.
    rule : "height", "bbox", "moments" or callable
        Height: the centre of the bounding box, and one size for all axes, the extent on the last one. Bbox: the same
        centre, and each axis its own extent. Moments: centroid, and standard deviation on each axis. A callable gets
        the body and gives a Frame, or (centre, size).

    Raises
    ------
    ArgumentError, ShapeError, DtypeError, MeshError
        A body without extent or weight, a batch of bodies, no body, an unknown rule.
    """
    _require_single(body)
    if callable(rule):
        return _own_frame(rule(body), body.dim)
    arguments.choice("frame", rule, RULES)
    if rule == "moments":
        centroid, deviation = moments_of(body)
        return Frame(centroid.tolist(), deviation.tolist())
    low, high = bounds_of(body)
    if np.isnan(low[0]):
        raise _empty()
    extent = high - low
    return Frame(((low + high) / 2).tolist(), extent.tolist() if rule == "bbox" else float(extent[-1]))


def bounds_of(body: Body) -> Floats:
    """Lower and upper corner [m] of the bounding box, shape (2, dim).

    Of voxels: the outer faces of the non-zero ones; NaN where all are zero, which is a body without one.
    """
    _require_single(body)
    if not isinstance(body, VoxelGrid):
        return body.bounds
    occupied = _occupied(body)
    if occupied is None:
        return np.full((2, body.dim), np.nan)
    # Faces are counted from the middle, as cell centres are, so that symmetric bodies have symmetric bounds.
    return np.stack([(face - np.array(body.values.shape) / 2) * _cell(body) for face in occupied])


def moments_of(body: Body) -> tuple[Floats, Floats]:
    """Centroid [m] and standard deviation on each axis [m], two arrays of shape (dim,).

    c = ∫x f / ∫f and s_j² = ∫(x_j - c_j)² f / ∫f, exact: voxels are boxes of their value (which is the h²/12), meshes
    and polygons are summed over the signed simplices that their faces span with one point (divergence theorem), where
    overlaps count as often as they overlap.

    Raises
    ------
    MeshError
        An open mesh, or a surface that faces inward.
    ArgumentError
        Voxels whose values do not add up to something positive, or spread by a negative square.
    """
    _require_single(body)
    total, first, second, origin = _voxel_moments(body) if isinstance(body, VoxelGrid) else _surface_moments(body)
    mean = first / total
    variance = second / total - mean**2
    if np.any(variance <= 0):
        axis = int(np.argmin(variance))
        raise ArgumentError("body", f"has variance {variance[axis]:.6g} m² on axis {axis}", "give values ≥ 0")
    return origin + mean, np.sqrt(variance)


def normalised(frames: Sequence[Frame]) -> tuple[Floats, Floats]:
    """Centres [m] and scales σ_i = s_i / max_i s_i, per axis, of a training set: two arrays (bodies, dim)."""
    sizes = np.array([frame.scale for frame in frames])
    return np.array([frame.centre for frame in frames]), sizes / sizes.max(axis=0)


def cropped(body: VoxelGrid) -> tuple[VoxelGrid, Floats]:
    """The voxels within the bounding box, on a box of their own about the origin; and where its centre lay [m].

    What is empty around a body must not count when its frame is asked to fit it into a box.
    """
    occupied = _occupied(body)
    if occupied is None:
        raise _empty()
    first, last = occupied
    part = body.values[tuple(slice(low, high) for low, high in zip(first, last, strict=True))]
    centre = ((first + last) - np.array(body.values.shape)) / 2 * _cell(body)
    return VoxelGrid(part, Box(((last - first) * _cell(body)).tolist())), centre


def _require_single(body: Any) -> None:
    if not isinstance(body, (VoxelGrid, Polygons, TriangleMesh)):
        raise DtypeError("body", f"is a {type(body).__name__}", "give a VoxelGrid, Polygons or a TriangleMesh")
    if isinstance(body, VoxelGrid) and body.batch_shape:
        raise ShapeError("body", f"is a batch of shape {body.batch_shape}", "give single bodies")


def _own_frame(answer: Any, dim: int) -> Frame:
    """What a callable gave, as a Frame."""
    if not isinstance(answer, Frame):
        try:
            centre, size = answer
        except (TypeError, ValueError):
            what = type(answer).__name__
            raise DtypeError("frame", f"gave a {what}", "let it return a Frame, or (centre, scale)") from None
        try:
            answer = Frame(centre, size)
        except ShapegenError as error:
            raise type(error)("frame", f"gave a {error.subject} that {error.problem}", error.remedy) from error
    if answer.dim != dim:
        raise ShapeError("frame", f"gave a {answer.dim}-D frame", f"let it return {dim} coordinates")
    return answer


def _empty() -> ArgumentError:
    return ArgumentError("values", "are zero everywhere: the body is empty", "give a body with a bounding box")


def _cell(body: VoxelGrid) -> Floats:
    return np.array(body.box.lengths) / body.values.shape


def _occupied(body: VoxelGrid) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """First index that is not zero and the one after the last, per axis; None where all are zero."""
    arguments.require_finite("values", body.values)
    occupied = body.values != 0 if body.values.dtype != np.bool_ else body.values
    # One pass over the voxels gives the shadow along the last axis, a second one the last axis itself.
    shadow = _any(occupied, (occupied.ndim - 1,))
    lines = [_any(shadow, tuple(k for k in range(shadow.ndim) if k != j)) for j in range(shadow.ndim)]
    lines.append(_any(occupied, tuple(range(shadow.ndim))))
    if not lines[0].any():
        return None
    first = np.array([int(line.argmax()) for line in lines])
    last = np.array([len(line) - int(line[::-1].argmax()) for line in lines])
    return first, last


def _any(values: NDArray[np.bool_], axes: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.asarray(np.any(values, axis=axes))


def _voxel_moments(body: VoxelGrid) -> tuple[float, Floats, Floats, Floats]:
    """∫f, ∫x f, ∫x_j² f about the middle of the occupied cells [in cells' volumes], and that middle."""
    block, origin = cropped(body)
    total, first, second = 0.0, [], []
    for j, (points, cell) in enumerate(zip(block.grid.axes, block.grid.spacing or (), strict=True)):
        others = tuple(k for k in range(block.dim) if k != j)
        weight = block.values.sum(axis=others, dtype=np.float64)
        total = float(weight.sum())
        first.append(weight @ points)
        second.append(weight @ (points**2 + cell**2 / 12))
    if not total > 0:
        raise ArgumentError("values", f"add up to {total:.6g}", "give values whose sum is positive")
    return total, np.array(first), np.array(second), origin


def _surface_moments(body: Polygons | TriangleMesh) -> tuple[float, Floats, Floats, Floats]:
    """∫1, ∫x, ∫x_j² about the middle of the bounds, and that middle.

    Over the simplex of volume V with corners 0, p_1, .., p_d:  ∫x = V Σp/(d+1)  and
    ∫x_j² = V (Σp_j² + (Σp_j)²)/((d+1)(d+2)).
    """
    origin = body.bounds.mean(axis=0)
    if isinstance(body, TriangleMesh):
        if not body.is_closed:
            raise MeshError("body", "is an open mesh: some edges have no opposite", "close its holes")
        corners = (body.vertices - origin)[body.faces]
        a, b, c = np.moveaxis(corners, 1, 0)
        volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    else:
        edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in body.rings]
        corners = np.concatenate(edges) - origin
        (x, y), (right, up) = corners.transpose(1, 2, 0)
        volumes = (x * up - y * right) / 2
    total, dim = float(volumes.sum()), body.dim
    if not total > 0:
        raise MeshError("body", f"encloses {total:.6g} m^{dim}, so it faces inward or encloses nothing", "reverse it")
    along = corners.sum(axis=1)
    first = volumes @ along / (dim + 1)
    second = volumes @ ((corners**2).sum(axis=1) + along**2) / ((dim + 1) * (dim + 2))
    return total, first, second, origin
