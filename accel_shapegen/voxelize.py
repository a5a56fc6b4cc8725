"""Surface to voxels: cells whose centre has a positive winding number.

A line through each column of cell centres crosses the surface a few times; the winding number of a centre is the
signed count of crossings ahead of it. That is right on overlapping and nested shells, where the parity of the
count is not.

Which lines meet which triangle is decided by comparisons alone, with every interval half open, in two steps: the
plane of a row of columns cuts the mesh in segments whose end points, on the edges, come out bit for bit the same
from both triangles of an edge; then a column takes the segments that cover it. The cut is a closed polygon in
floating point too, so crossings balance exactly on every column - through vertices, along edges, in slivers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import ArgumentError, DtypeError, MeshError, OutsideBoxError, ShapeError
from .geometry import Box, Grid, Polygons, TriangleMesh, VoxelGrid

# Crossings worked on at once: bounds the temporaries to about 100 MB.
BLOCK = 1 << 18

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def voxelize(body: TriangleMesh | Polygons, grid: Grid) -> VoxelGrid:
    """The cells of a grid whose centre lies inside a closed surface.

    A centre is inside where the winding number of the surface about it is positive: overlapping parts count
    once, inward shells are cavities. A centre exactly on the surface is inside where the body lies on its
    larger-coordinate side, so that bodies which share a face share no cell: a cuboid has the centres on its lower
    faces, not those on its upper ones. (On slanted faces this holds to within rounding.)

    Parameters
    ----------
    body : TriangleMesh or Polygons
        A closed mesh that faces outward, or rings of positive total area.
    grid : Grid
        Cell centres that fill a box, as made by `Grid(box, shape)`; the body must lie in the box.

    Returns
    -------
    VoxelGrid
        Boolean values of shape `grid.shape`, on `grid.box`.

    Raises
    ------
    MeshError
        The mesh is open, faces inward, or encloses no volume.
    OutsideBoxError
        The body reaches out of the box.
    ArgumentError, ShapeError, DtypeError
        A grid without a box, a grid and a body of different dimension, or neither mesh nor polygons.
    """
    _require_body(body)
    box = _require_box(body, grid)
    inside = np.zeros(grid.shape, dtype=bool)
    # Only centres between the bounds can be inside; on a cropped block the counts stay in cache.
    lower, upper = body.bounds
    window = tuple(
        slice(*map(int, np.searchsorted(axis, (low, high))))
        for axis, low, high in zip(grid.axes, lower, upper, strict=True)
    )
    axes = tuple(axis[part] for axis, part in zip(grid.axes, window, strict=True))
    if all(len(axis) for axis in axes):
        steps = _mesh_steps(body, axes) if isinstance(body, TriangleMesh) else _polygon_steps(body, axes)
        # A step of s at cell k means s crossings beyond centre k: the sum from the far end is the winding number.
        inside[window] = np.cumsum(steps[..., ::-1], axis=-1)[..., ::-1] > 0
    return VoxelGrid(inside, box)


def _require_body(body: Any) -> None:
    if not isinstance(body, (TriangleMesh, Polygons)):
        raise DtypeError("body", f"is a {type(body).__name__}", "give a TriangleMesh or Polygons")
    if isinstance(body, TriangleMesh) and not body.is_closed:
        raise MeshError("body", "is an open mesh: some edges have no opposite", "close its holes")
    if not body.volume > 0:
        what, unit = ("volume", "m³") if isinstance(body, TriangleMesh) else ("area", "m²")
        raise MeshError(
            "body",
            f"has {what} {body.volume:.6g} {unit}, so it faces inward or encloses nothing",
            "reverse its triangles" if isinstance(body, TriangleMesh) else "run outer rings counter-clockwise",
        )


def _require_box(body: TriangleMesh | Polygons, grid: Grid) -> Box:
    if not isinstance(grid, Grid):
        raise DtypeError("grid", f"is a {type(grid).__name__}", "give a Grid")
    if grid.dim != body.dim:
        raise ShapeError("grid", f"has {grid.dim} axes for a body in {body.dim}-D", f"give a grid of {body.dim} axes")
    if grid.box is None:
        raise ArgumentError("grid", "has no box, so no cells", "make it by Grid(box, shape)")
    for axis, length in enumerate(grid.box.lengths):
        low, high = body.bounds[:, axis]
        if low < -length / 2 or high > length / 2:
            raise OutsideBoxError(
                "body",
                f"spans [{low:.6g}, {high:.6g}] m on axis {axis}; the box ends at ±{length / 2:.6g}",
                "give a larger box, or move the body",
            )
    return grid.box


def _mesh_steps(mesh: TriangleMesh, axes: tuple[Floats, ...]) -> NDArray[np.int32]:
    """Signed crossings of the lines along the last axis, at the last centre before each; shape of the axes."""
    x_axis, y_axis, z_axis = axes
    steps = np.zeros(tuple(map(len, axes)), dtype=np.int32)
    triangles = mesh.vertices[mesh.faces]
    heights = triangles[:, :, 1]
    first_row, rows = _covered(y_axis, heights.min(axis=1), heights.max(axis=1))
    for block in _blocks(rows):
        which, row = _expand(first_row[block], rows[block])
        falling, rising = _cut(triangles[block], which, y_axis[row])
        # Seen from above, a triangle that faces up has its rising edge on the right.
        turned = rising[0] < falling[0]
        (x_left, z_left), (x_right, z_right) = np.where(turned, rising, falling), np.where(turned, falling, rising)
        first_column, columns = _covered(x_axis, x_left, x_right)
        for part in _blocks(columns):
            segment, column = _expand(first_column[part], columns[part])
            left, right = x_left[part][segment], x_right[part][segment]
            low, high = z_left[part][segment], z_right[part][segment]
            z = low + (x_axis[column] - left) / (right - left) * (high - low)
            sign = 1 - 2 * turned[part][segment].astype(np.int32)
            _add(steps, (column, row[part][segment]), np.searchsorted(z_axis, z), sign)
    return steps


def _cut(triangles: Floats, which: Ints, y: Floats) -> tuple[Floats, Floats]:
    """Where triangles cross planes of constant y: (x, z) on the falling and on the rising edge, each (2, P).

    An edge rises if it runs, in the order of the face, from a corner at or below y to one above it.
    """
    under = triangles[which, :, 1] <= y[:, None]
    following = np.roll(under, -1, axis=1)
    ends = []
    for goes in (~under & following, under & ~following):
        corner = np.argmax(goes, axis=1)
        ends.append((triangles[which, corner], triangles[which, (corner + 1) % 3]))
    (above_f, below_f), (below_r, above_r) = ends
    return _on_edge(below_f, above_f, y), _on_edge(below_r, above_r, y)


def _on_edge(below: Floats, above: Floats, y: Floats) -> Floats:
    """(x, z) at height y, always reckoned from the lower end so that both triangles of an edge agree to the bit."""
    share = (y - below[:, 1]) / (above[:, 1] - below[:, 1])
    return np.stack([below[:, j] + share * (above[:, j] - below[:, j]) for j in (0, 2)])


def _polygon_steps(polygons: Polygons, axes: tuple[Floats, ...]) -> NDArray[np.int32]:
    """As `_mesh_steps`, for the lines x = const of the plane."""
    x_axis, y_axis = axes
    steps = np.zeros(tuple(map(len, axes)), dtype=np.int32)
    start = np.concatenate(polygons.rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in polygons.rings])
    leftward = end[:, 0] < start[:, 0]
    left, right = np.where(leftward[:, None], end, start), np.where(leftward[:, None], start, end)
    first, columns = _covered(x_axis, left[:, 0], right[:, 0])
    for block in _blocks(columns):
        edge, column = _expand(first[block], columns[block])
        near, far = left[block][edge], right[block][edge]
        y = near[:, 1] + (x_axis[column] - near[:, 0]) / (far[:, 0] - near[:, 0]) * (far[:, 1] - near[:, 1])
        sign = 2 * leftward[block][edge].astype(np.int32) - 1
        _add(steps, (column,), np.searchsorted(y_axis, y), sign)
    return steps


def _covered(axis: Floats, low: Floats, high: Floats) -> tuple[Ints, Ints]:
    """First index and number of the points of an axis in each [low, high)."""
    first = np.searchsorted(axis, low)
    return first, np.searchsorted(axis, high) - first


def _expand(first: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Pairs (i, first[i] + 0 .. first[i] + count[i] - 1) of all i, flat."""
    item = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(item)) - np.repeat(np.cumsum(count) - count, count)
    return item, first[item] + within


def _blocks(count: Ints) -> Iterator[slice]:
    """Consecutive slices whose counts sum to about BLOCK at most."""
    ends = np.cumsum(count)
    start = 0
    while start < len(count):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + BLOCK, side="right")))
        yield slice(start, stop)
        start = stop


def _add(steps: NDArray[np.int32], columns: tuple[Ints, ...], beyond: Ints, sign: NDArray[np.int32]) -> None:
    """Add each crossing at the last centre before it; `beyond` is how many centres lie before it."""
    hit = beyond > 0
    index = np.ravel_multi_index((*(column[hit] for column in columns), beyond[hit] - 1), steps.shape)
    np.add.at(steps.reshape(-1), index, sign[hit])
