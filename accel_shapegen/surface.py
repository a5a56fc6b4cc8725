"""Field to surface: the boundary of the region where a field exceeds a level.

Marching cubes in 3-D (Lewiner, Lopes, Vieira and Tavares 2003), marching squares in 2-D, both by scikit-image.
A sample equal to the level counts as outside, so that the region is {field > level} exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ArgumentError, DtypeError, ShapeError, SurfaceError
from .geometry import Grid, Polygons, TriangleMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class SurfaceQuality:
    """What an extracted surface is like.

    Attributes
    ----------
    closed : bool
        Every directed edge has its opposite (3-D), every ring returns to its start (2-D).
    components : int
        Connected pieces of the surface; a shell with a cavity has two. Pieces that share a vertex are one in 3-D.
    volume : float
        Enclosed volume [m³], or area [m²] in 2-D; cavities count negative.
    ties : int
        Samples equal to the level. They count as outside, and the surface passes through those that border on the
        region.
    collapsed : int
        Triangles, or ring corners, left out because two of their corners fell on the same point, as happens at ties.
        Neither the region nor the closedness changes.
    """

    closed: bool
    components: int
    volume: float
    ties: int
    collapsed: int


def extract_surface(field: ArrayLike, grid: Grid, level: float = 0.5) -> TriangleMesh | Polygons:
    """The boundary of {field > level}, linear between samples, outward.

    Parameters
    ----------
    field : array_like, shape `grid.shape`
        Real samples at the points of the grid.
    grid : Grid
        Their coordinates [m]; need not be equidistant.
    level : float
        Where the boundary lies. The default is half way between outside (0) and inside (1) of an indicator.

    Returns
    -------
    TriangleMesh or Polygons
        In metres, triangles or rings facing outward from the values above the level (holes run clockwise), with
        `.quality`, a `SurfaceQuality`. Vertices of a mesh carry a rounding of 6e-8 of the grid's extent.

    Raises
    ------
    SurfaceError
        No sample, or only samples, above the level; or a sample above it on the wall of the grid, which would
        leave the surface open; or samples so near the level that what they enclose rounds to nothing.
    NonFiniteError, DtypeError, ShapeError, ArgumentError
        A field that is not finite, not real or not of the grid's shape; a level that is not a finite number.
    """
    if not isinstance(grid, Grid):
        raise DtypeError("grid", f"is a {type(grid).__name__}", "give a Grid")
    samples = arguments.real_array("field", field, np.float64)
    if samples.shape != grid.shape:
        raise ShapeError("field", f"has shape {samples.shape}", f"give {grid.shape}, as the grid, one body a call")
    height = arguments.real_array("level", level, np.float64)
    if height.ndim:
        raise ArgumentError("level", f"has shape {height.shape}", "give one number")
    # The difference of unequal floats is never 0, so this keeps the side of every sample.
    relative = samples - height
    _require_crossing(relative, samples, float(height))
    ties = int(np.count_nonzero(relative == 0))
    return _mesh(relative, grid, ties) if grid.dim == 3 else _rings(relative, grid, ties)


def _require_crossing(relative: Floats, samples: Floats, level: float) -> None:
    above = relative > 0
    if not above.any() or above.all():
        raise SurfaceError(
            "field",
            f"spans [{samples.min():.6g}, {samples.max():.6g}] and does not cross {level:.6g}",
            "choose a level between its extremes, on a grid that reaches beyond the body",
        )
    for axis in range(above.ndim):
        for end, side in ((0, "lower"), (-1, "upper")):
            wall = np.take(above, end, axis=axis)
            if wall.any():
                first = [int(i) for i in np.argwhere(wall)[0]]
                first.insert(axis, above.shape[axis] - 1 if end else 0)
                raise SurfaceError(
                    "field",
                    f"exceeds {level:.6g} at index {tuple(first)}, on the {side} wall of axis {axis}",
                    "sample it on a grid that reaches beyond the body",
                )


def _mesh(relative: Floats, grid: Grid, ties: int) -> TriangleMesh:
    from skimage.measure import marching_cubes

    # scikit-image works in float32 and weighs ends of an edge by 1/(2e-16 + |value|): scaled to 1, neither overflow
    # nor that constant shows, and what rounds to 0 keeps its side.
    values = (relative / np.abs(relative).max()).astype(np.float32)
    tiny = np.finfo(np.float32).tiny
    values[values == 0] = -tiny
    values[(relative > 0) & (values < tiny)] = tiny
    # "ascent" gives outward triangles around high values for axes in the order (0, 1, 2). Degenerate triangles are
    # left in, because scikit-image's own removal opens the surface.
    index, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="ascent", allow_degenerate=True)
    index, kept = _collapse(np.ascontiguousarray(index), faces.astype(np.int64))
    if not len(kept):
        raise _vanishing()
    points = np.stack([np.interp(c, np.arange(len(a)), a) for c, a in zip(index.T, grid.axes, strict=True)], axis=1)
    plain = TriangleMesh(points, kept)
    quality = SurfaceQuality(plain.is_closed, _pieces(kept, len(points)), plain.volume, ties, len(faces) - len(kept))
    return TriangleMesh(points, kept, quality)


def _collapse(points: NDArray[np.float32], faces: Ints) -> tuple[NDArray[np.float32], Ints]:
    """Merge the ends of edges of length zero, drop triangles that become edges, and unused points.

    Every directed edge moves along with its opposite, and the three edges of a dropped triangle cancel among
    themselves, so a closed surface stays closed.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    same = np.all(points[start] == points[end], axis=1)
    if not same.any():
        return points, faces
    target = _labels(start[same], end[same], len(points))
    faces = target[faces]
    faces = faces[np.all(faces != np.roll(faces, 1, axis=1), axis=1)]
    used, where = np.unique(faces, return_inverse=True)
    # Merged points coincide, so any member of a class stands for it.
    position = np.empty((target.max() + 1, 3), dtype=points.dtype)
    position[target] = points
    return position[used], where.reshape(-1, 3)


def _labels(start: Ints, end: Ints, count: int) -> Ints:
    """For each of `count` nodes, the number of its connected component under the given links."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _pieces(faces: Ints, count: int) -> int:
    """Connected pieces of a surface whose `count` points all belong to a face."""
    return int(_labels(faces[:, :2].ravel(), faces[:, 1:].ravel(), count).max()) + 1


def _rings(relative: Floats, grid: Grid, ties: int) -> Polygons:
    from skimage.measure import find_contours

    # On signs alone every crossing is a midpoint that names its edge, so contours link without rounding; where on the
    # edge the level lies is worked out afterwards.
    side = np.where(relative > 0, 1.0, -1.0)
    contours = find_contours(side, 0.0, fully_connected="low", positive_orientation="high")
    closed = all(np.array_equal(contour[0], contour[-1]) for contour in contours)
    rings, collapsed = [], 0
    for contour in contours:
        corners = _crossings(contour[:-1] if closed else contour, relative, grid)
        distinct = corners[np.any(corners != np.roll(corners, 1, axis=0), axis=1)]
        collapsed += len(corners) - len(distinct)
        if len(distinct) >= 3:
            rings.append(distinct)
        else:
            collapsed += len(distinct)
    if not rings:
        raise _vanishing()
    quality = SurfaceQuality(closed, len(rings), Polygons(rings).volume, ties, collapsed)
    return Polygons(rings, quality)


def _crossings(middles: Floats, relative: Floats, grid: Grid) -> Floats:
    """Where the level lies [m] on the grid edges with these midpoints (in index units), by linear interpolation."""
    low, high = np.floor(middles).astype(np.intp), np.ceil(middles).astype(np.intp)
    at_low, at_high = relative[tuple(low.T)], relative[tuple(high.T)]
    share = at_low / (at_low - at_high)
    start = np.stack([axis[i] for axis, i in zip(grid.axes, low.T, strict=True)], axis=1)
    end = np.stack([axis[i] for axis, i in zip(grid.axes, high.T, strict=True)], axis=1)
    # From the nearer end, so that a tie falls on its sample to the bit.
    near_end = (share > 0.5)[:, None]
    return np.where(near_end, end - (1 - share)[:, None] * (end - start), start + share[:, None] * (end - start))


def _vanishing() -> SurfaceError:
    return SurfaceError("field", "exceeds the level by too little to enclose anything", "choose a lower level")
