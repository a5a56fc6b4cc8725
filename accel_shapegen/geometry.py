"""Boxes, grids, frames and bodies: frozen data in metres, with the checks that make them well formed.

The arrays inside are read-only copies, so an object never changes under a plan that was made from it; only the values
of a VoxelGrid, which may be gigabytes, are a read-only view of the caller's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ArgumentError, DtypeError, ShapeError


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    frozen = np.ascontiguousarray(array)
    if frozen is array or np.may_share_memory(frozen, array):
        frozen = frozen.copy()
    frozen.setflags(write=False)
    return frozen


@dataclass(frozen=True)
class Box:
    """V0 = Π_j (-a_j/2, a_j/2), centred at the origin.

    Parameters
    ----------
    lengths : sequence of float
        Side lengths a_j [m], two or three of them, positive.
    """

    lengths: tuple[float, ...]

    def __init__(self, lengths: Sequence[float]) -> None:
        sides = arguments.lengths("lengths", lengths)
        if len(sides) not in (2, 3):
            raise ShapeError("lengths", f"has {len(sides)} entries", "give 2 or 3 side lengths")
        object.__setattr__(self, "lengths", sides)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return len(self.lengths)

    @property
    def volume(self) -> float:
        """|V0| [m^dim]."""
        return float(np.prod(self.lengths))


@dataclass(frozen=True)
class Grid:
    """A tensor grid of points; with a box, the centres of `shape` equal cells that fill it.

    Parameters
    ----------
    box : Box
        The box that the cells fill.
    shape : int or sequence of int
        Cells per axis (n_1, n_2[, n_3]).

    Attributes
    ----------
    axes : tuple of arrays
        Coordinates [m] per axis, ascending, shape (n_j,).
    spacing : tuple of float, or None
        Cell size h_j [m] per axis, or None on a grid that is not equidistant.
    box : Box, or None
        The box filled, or None for a grid made by `from_axes`.
    """

    box: Box | None
    axes: tuple[NDArray[np.float64], ...] = field(repr=False)
    shape: tuple[int, ...]

    def __init__(self, box: Box, shape: int | Sequence[int]) -> None:
        if not isinstance(box, Box):
            raise DtypeError("box", f"is a {type(box).__name__}", "give a Box")
        counts = arguments.counts("shape", shape, box.dim)
        axes = tuple(
            # (g + 1/2 - n/2) h is exactly antisymmetric about 0, which -a/2 + (g + 1/2) h is not.
            _frozen((np.arange(n) + 0.5 - n / 2) * (a / n))
            for a, n in zip(box.lengths, counts, strict=True)
        )
        self._set(box, axes)

    @classmethod
    def from_axes(cls, axes: Sequence[ArrayLike]) -> Grid:
        """A tensor grid from its coordinates [m], strictly ascending on each axis, one array per axis."""
        if len(arguments.sequence("axes", axes, "coordinate arrays")) not in (2, 3):
            raise ShapeError("axes", f"has {len(axes)} entries", "give 2 or 3 coordinate arrays")
        checked = []
        for j, axis in enumerate(axes):
            points = arguments.real_array(f"axes[{j}]", axis, np.float64)
            if points.ndim != 1 or points.size == 0:
                raise ShapeError(f"axes[{j}]", f"has shape {points.shape}", "give a non-empty 1-D array")
            falls = np.flatnonzero(np.diff(points) <= 0)
            if falls.size:
                raise ArgumentError(
                    f"axes[{j}]", f"does not rise at index {falls[0] + 1}", "give strictly ascending coordinates"
                )
            checked.append(_frozen(points))
        grid = cls.__new__(cls)
        grid._set(None, tuple(checked))
        return grid

    def _set(self, box: Box | None, axes: tuple[NDArray[np.float64], ...]) -> None:
        object.__setattr__(self, "box", box)
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "shape", tuple(len(axis) for axis in axes))

    def __reduce__(self) -> tuple[Any, ...]:
        return (Grid.from_axes, (self.axes,)) if self.box is None else (Grid, (self.box, self.shape))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Grid):
            return NotImplemented
        return self.shape == other.shape and all(map(np.array_equal, self.axes, other.axes))

    def __hash__(self) -> int:
        return hash(tuple(axis.tobytes() for axis in self.axes))

    @property
    def dim(self) -> int:
        """2 or 3."""
        return len(self.axes)

    @cached_property
    def spacing(self) -> tuple[float, ...] | None:
        """Cell size h_j [m] per axis, or None where an axis is not equidistant or has one point and no box."""
        if self.box is not None:
            return tuple(a / n for a, n in zip(self.box.lengths, self.shape, strict=True))
        steps = []
        for axis in self.axes:
            if len(axis) < 2:
                return None
            step = (axis[-1] - axis[0]) / (len(axis) - 1)
            # Coordinates carry rounding of their own size: 8 ulp of the largest is the slack.
            if np.any(np.abs(np.diff(axis) - step) > 8 * np.spacing(np.abs(axis).max())):
                return None
            steps.append(float(step))
        return tuple(steps)

    def points(self) -> NDArray[np.float64]:
        """All points [m], shape (*shape, dim), C order."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1)


@dataclass(frozen=True)
class Frame:
    """A reference frame: body coordinates are y = (x - centre) / scale.

    Parameters
    ----------
    centre : sequence of float
        Origin c_j [m] of the frame, per axis.
    scale : float or sequence of float
        Positive factor σ_j per axis (one number stands for all).
    """

    centre: tuple[float, ...]
    scale: tuple[float, ...]

    def __init__(self, centre: Sequence[float], scale: float | Sequence[float]) -> None:
        point = arguments.real_array("centre", centre, np.float64)
        if point.ndim != 1 or point.size not in (2, 3):
            raise ShapeError("centre", f"has shape {point.shape}", "give 2 or 3 coordinates")
        object.__setattr__(self, "centre", tuple(float(c) for c in point))
        object.__setattr__(self, "scale", arguments.lengths("scale", scale, dim=point.size))

    @property
    def dim(self) -> int:
        """2 or 3."""
        return len(self.centre)


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A body, or a batch of bodies, as a piecewise constant function on the cells of a box.

    Parameters
    ----------
    values : array_like, shape (..., n_1, n_2[, n_3])
        Cell values, any sign, fractional allowed; real float32 or float64, integer or boolean. Leading
        axes are a batch. NaN and infinities are refused where the values are used, by name and index.
    box : Box
        The box that the cells fill; it may be smaller than a lattice's.
    """

    values: NDArray[Any] = field(repr=False)
    box: Box

    def __init__(self, values: ArrayLike, box: Box) -> None:
        if not isinstance(box, Box):
            raise DtypeError("box", f"is a {type(box).__name__}", "give a Box")
        array = arguments.plain_array("values", values)
        if array.dtype.kind not in "fiub" or array.dtype == np.float16:
            raise DtypeError("values", f"has dtype {array.dtype}", "give real floats, integers or booleans")
        if array.ndim < box.dim:
            raise ShapeError(
                "values", f"has shape {array.shape}", f"give at least {box.dim} axes, one per axis of the box"
            )
        if 0 in array.shape:
            raise ShapeError("values", f"has shape {array.shape}, no cells", "give at least one cell per axis")
        view = array.view()
        view.setflags(write=False)
        object.__setattr__(self, "values", view)
        object.__setattr__(self, "box", box)

    def __reduce__(self) -> tuple[Any, ...]:
        return VoxelGrid, (self.values, self.box)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.box.dim

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading axes of `values`."""
        return self.values.shape[: -self.dim]

    @cached_property
    def grid(self) -> Grid:
        """The cell centres."""
        return Grid(self.box, self.values.shape[-self.dim :])


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangulated surface in 3-D, triangles counter-clockwise seen from outside.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
        Positions [m].
    faces : array_like of int, shape (F, 3)
        Vertex indices.
    quality : SurfaceQuality, optional
        Filled by `extract_surface`.
    """

    vertices: NDArray[np.float64] = field(repr=False)
    faces: NDArray[np.int64] = field(repr=False)
    quality: Any = None

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, quality: Any = None) -> None:
        points = arguments.real_array("vertices", vertices, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise ShapeError("vertices", f"has shape {points.shape}", "give (V, 3), at least one vertex")
        corners = arguments.plain_array("faces", faces)
        if corners.dtype.kind not in "iu":
            raise DtypeError("faces", f"has dtype {corners.dtype}", "give integer vertex indices")
        if corners.ndim != 2 or corners.shape[1] != 3 or not len(corners):
            raise ShapeError("faces", f"has shape {corners.shape}", "give (F, 3), at least one triangle")
        wrong = np.argwhere((corners < 0) | (corners >= len(points)))
        if len(wrong):
            face, corner = (int(i) for i in wrong[0])
            raise ArgumentError(
                "faces",
                f"names vertex {corners[face, corner]} in triangle {face}",
                f"vertex indices run from 0 to {len(points) - 1}",
            )
        object.__setattr__(self, "vertices", _frozen(points))
        object.__setattr__(self, "faces", _frozen(corners.astype(np.int64)))
        object.__setattr__(self, "quality", quality)

    def __reduce__(self) -> tuple[Any, ...]:
        # Arrays come out of a pickle writable; the constructor freezes them again. So for the other classes here.
        return TriangleMesh, (self.vertices, self.faces, self.quality)

    dim = 3

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner [m] of the bounding box of the triangles, shape (2, 3)."""
        in_use = np.zeros(len(self.vertices), dtype=bool)
        in_use[self.faces] = True
        used = self.vertices[in_use]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @cached_property
    def volume(self) -> float:
        """Signed volume [m³] by the divergence theorem; positive when the surface faces outward."""
        # Relative to the centre of the bounds, far bodies lose no digits.
        a, b, c = np.moveaxis((self.vertices - self.bounds.mean(axis=0))[self.faces], 1, 0)
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    @cached_property
    def is_closed(self) -> bool:
        """Whether every directed edge is met by as many edges in the opposite direction (winding is defined)."""
        start = self.faces.ravel()
        end = np.roll(self.faces, -1, axis=1).ravel()
        count = np.int64(len(self.vertices))
        forward, backward = np.sort(start * count + end), np.sort(end * count + start)
        return bool(np.array_equal(forward, backward))


@dataclass(frozen=True, eq=False)
class Polygons:
    """A region of the plane bounded by closed rings: outer rings counter-clockwise, holes clockwise.

    Parameters
    ----------
    rings : sequence of array_like, each (n, 2)
        Corners [m]; the last joins the first, which is not repeated. At least three corners a ring.
    quality : SurfaceQuality, optional
        Filled by `extract_surface`.
    """

    rings: tuple[NDArray[np.float64], ...] = field(repr=False)
    quality: Any = None

    def __init__(self, rings: Sequence[ArrayLike], quality: Any = None) -> None:
        if len(arguments.sequence("rings", rings, "corner arrays")) == 0:
            raise ShapeError("rings", "is empty", "give at least one ring")
        checked = []
        for i, ring in enumerate(rings):
            points = arguments.real_array(f"rings[{i}]", ring, np.float64)
            if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
                raise ShapeError(f"rings[{i}]", f"has shape {points.shape}", "give (n, 2) with at least 3 corners")
            if np.array_equal(points[0], points[-1]):
                raise ArgumentError(f"rings[{i}]", "repeats its first corner at the end", "leave the last corner out")
            checked.append(_frozen(points))
        object.__setattr__(self, "rings", tuple(checked))
        object.__setattr__(self, "quality", quality)

    def __reduce__(self) -> tuple[Any, ...]:
        return Polygons, (self.rings, self.quality)

    dim = 2

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner [m] of the bounding box, shape (2, 2)."""
        corners = np.concatenate(self.rings)
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    @cached_property
    def volume(self) -> float:
        """Signed area [m²]; positive when outer rings run counter-clockwise."""
        centre = self.bounds.mean(axis=0)
        total = 0.0
        for ring in self.rings:
            x, y = (ring - centre).T
            total += float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2
        return total
