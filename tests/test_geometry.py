"""Boxes, grids, frames and bodies: what they hold, and what they refuse."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest

from accel_shapegen.errors import ArgumentError, DtypeError, NonFiniteError, ShapeError, ShapegenError
from accel_shapegen.geometry import Box, Frame, Grid, Polygons, TriangleMesh, VoxelGrid

EPS = np.finfo(float).eps

SQUARE = [[0, 0], [2, 0], [2, 1], [0, 1]]
CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def test_box() -> None:
    box = Box((1.6, 0.8, 2.2))
    assert box.dim == 3
    assert box.lengths == (1.6, 0.8, 2.2)
    assert box.volume == pytest.approx(1.6 * 0.8 * 2.2, rel=4 * EPS)
    assert Box([2, 3]) == Box((2.0, 3.0))
    assert hash(Box([2, 3])) == hash(Box((2.0, 3.0)))


@pytest.mark.parametrize("shape", [(1, 2, 3), (17, 19, 24), (100, 7, 31)])
def test_grid_cells_fill_the_box(shape: tuple[int, ...]) -> None:
    box = Box((1.6, 0.8, 2.2))
    grid = Grid(box, shape)
    assert grid.shape == shape
    assert grid.spacing == tuple(a / n for a, n in zip(box.lengths, shape, strict=True))
    for axis, a, n in zip(grid.axes, box.lengths, shape, strict=True):
        # Two roundings, of numbers no larger than a/2.
        np.testing.assert_allclose(axis, [-a / 2 + (g + 0.5) * a / n for g in range(n)], rtol=0, atol=2 * EPS * a)
        assert np.array_equal(axis, -axis[::-1])
    points = grid.points()
    assert points.shape == (*shape, 3)
    assert np.array_equal(points[0, -1, 0], [grid.axes[0][0], grid.axes[1][-1], grid.axes[2][0]])


def test_grid_from_axes() -> None:
    uneven = Grid.from_axes([[0, 1, 3], np.array([2, 5], dtype=np.int32)])
    assert (uneven.dim, uneven.shape, uneven.box, uneven.spacing) == (2, (3, 2), None, None)
    even = Grid.from_axes([np.linspace(-1, 1, 11), np.linspace(0, 0.3, 4)])
    assert even.spacing == pytest.approx((0.2, 0.1), rel=8 * EPS)
    assert Grid.from_axes([[0.0], [0.0, 1.0]]).spacing is None
    boxed = Grid(Box((2, 3)), (4, 5))
    assert Grid.from_axes(boxed.axes) == boxed
    assert hash(Grid.from_axes(boxed.axes)) == hash(boxed)
    assert boxed != Grid(Box((2, 3)), (5, 4))


def test_frame() -> None:
    assert Frame((1, 2, 3), 2.0).scale == (2.0, 2.0, 2.0)
    assert Frame((1, 2), (2, 3)) == Frame(np.array([1.0, 2.0]), [2.0, 3.0])
    assert Frame((1, 2), 1.0).dim == 2


def test_voxel_grid() -> None:
    grid = VoxelGrid(np.ones((5, 4, 3, 2), dtype=np.uint8), Box((1, 1, 1)))
    assert (grid.dim, grid.batch_shape, grid.grid.shape) == (3, (5,), (4, 3, 2))
    assert VoxelGrid([[True, False]], Box((1, 1))).values.dtype == bool


def test_mesh_measures() -> None:
    mesh = TriangleMesh(np.array([*CORNERS, [9, 9, 9]]) + 1e6, TETRAHEDRON)
    assert mesh.is_closed
    # The unused vertex does not count; relative to the centre of the bounds the volume keeps its digits.
    np.testing.assert_array_equal(mesh.bounds, [[1e6] * 3, [1e6 + 1] * 3])
    assert mesh.volume == pytest.approx(1 / 6, rel=16 * EPS)
    inward = TriangleMesh(CORNERS, np.array(TETRAHEDRON)[:, ::-1])
    assert inward.is_closed
    assert inward.volume == pytest.approx(-1 / 6, rel=16 * EPS)


@pytest.mark.parametrize(
    "faces",
    [
        TETRAHEDRON[:3],
        [*TETRAHEDRON, [0, 1, 2]],
        [[0, 1, 2], *TETRAHEDRON[1:]],
        [*TETRAHEDRON, TETRAHEDRON[0]],
    ],
    ids=["missing", "fin", "flipped", "doubled"],
)
def test_open_mesh(faces: list[list[int]]) -> None:
    closed = TriangleMesh(CORNERS, faces).is_closed
    # A fin that is the reverse of a face closes that face with itself and opens the rest.
    assert not closed


def test_closed_with_shared_edge() -> None:
    """Two tetrahedra that share an edge: four triangles meet there, and every crossing still balances."""
    corners = np.array([*CORNERS, [-1, 0, 0], [0, -1, 0]])
    swap = {0: 0, 1: 4, 2: 5, 3: 3}
    second = [[swap[i] for i in face] for face in TETRAHEDRON]
    assert TriangleMesh(corners, [*TETRAHEDRON, *second]).is_closed


def test_polygons() -> None:
    body = Polygons([SQUARE, [[0.5, 0.25], [0.5, 0.75], [1.5, 0.75], [1.5, 0.25]]])
    assert body.volume == pytest.approx(2 - 0.5, rel=4 * EPS)
    np.testing.assert_array_equal(body.bounds, [[0, 0], [2, 1]])
    assert Polygons([SQUARE[::-1]]).volume == pytest.approx(-2, rel=4 * EPS)


@pytest.mark.parametrize(
    "arrays",
    [
        lambda a: Polygons([a]).rings[0],
        lambda a: TriangleMesh(np.pad(a, ((0, 0), (0, 1))), [[0, 1, 2]]).vertices,
        lambda a: Grid.from_axes([a[:2, 0], a[:2, 0]]).axes[0],
    ],
)
def test_arrays_are_read_only_copies(arrays: Callable[[Any], Any]) -> None:
    source = np.array(SQUARE, dtype=float)
    held = arrays(source)
    before = held.copy()
    source += 1
    assert np.array_equal(held, before)
    with pytest.raises(ValueError, match="read-only"):
        held[0] = 0


def test_objects_are_frozen() -> None:
    for thing, name in ((Box((1, 1)), "lengths"), (Grid(Box((1, 1)), 2), "axes"), (Polygons([SQUARE]), "rings")):
        with pytest.raises(FrozenInstanceError):
            setattr(thing, name, None)


def test_objects_survive_pickling() -> None:
    mesh = TriangleMesh(CORNERS, TETRAHEDRON)
    again = pickle.loads(pickle.dumps(mesh))
    assert np.array_equal(again.vertices, mesh.vertices)
    assert np.array_equal(again.faces, mesh.faces)
    for thing in (Box((1, 2)), Grid(Box((1, 2)), 3), Frame((1, 2), 3)):
        assert pickle.loads(pickle.dumps(thing)) == thing


BOX = Box((1.0, 1.0, 1.0))
BAD: list[tuple[str, Callable[[], Any], type[ShapegenError], str]] = [
    ("box of one length", lambda: Box((1.0,)), ShapeError, "lengths: has 1"),
    ("box of four lengths", lambda: Box((1, 1, 1, 1)), ShapeError, "lengths: has 4"),
    ("box of a zero length", lambda: Box((1.0, 0.0)), ArgumentError, "lengths: is 0.0 on axis 1"),
    ("box of a negative length", lambda: Box((-1.0, 1.0)), ArgumentError, "is -1.0 on axis 0"),
    ("box of a NaN", lambda: Box((1.0, float("nan"))), ArgumentError, "is nan on axis 1"),
    ("box of an infinity", lambda: Box((1.0, float("inf"))), ArgumentError, "is inf on axis 1"),
    ("box of None", lambda: Box(None), DtypeError, "lengths: has dtype object"),  # type: ignore[arg-type]
    ("box of a number", lambda: Box(2.0), ShapeError, "lengths: has shape"),  # type: ignore[arg-type]
    ("box of words", lambda: Box(("a", "b")), DtypeError, "lengths: has dtype"),  # type: ignore[arg-type]
    ("grid on a tuple", lambda: Grid((1, 1), 3), DtypeError, "box: is a tuple"),  # type: ignore[arg-type]
    ("grid of no cells", lambda: Grid(BOX, (3, 0, 3)), ArgumentError, r"shape\[1\]: is 0"),
    ("grid of half a cell", lambda: Grid(BOX, 2.5), ArgumentError, "shape: is 2.5"),  # type: ignore[arg-type]
    ("grid of a boolean", lambda: Grid(BOX, True), ArgumentError, "shape: is True"),
    ("grid of two counts in 3-D", lambda: Grid(BOX, (3, 3)), ShapeError, "shape: has 2"),
    ("one axis", lambda: Grid.from_axes([[0, 1]]), ShapeError, "axes: has 1"),
    ("empty axis", lambda: Grid.from_axes([[0, 1], []]), ShapeError, r"axes\[1\]: has shape \(0,\)"),
    ("flat axis", lambda: Grid.from_axes([[0, 1], [0, 0]]), ArgumentError, r"axes\[1\]: does not rise at index 1"),
    ("2-D axis", lambda: Grid.from_axes([[0, 1], [[0, 1]]]), ShapeError, r"axes\[1\]: has shape \(1, 2\)"),
    ("NaN axis", lambda: Grid.from_axes([[0, 1], [0, np.nan]]), NonFiniteError, r"axes\[1\]: is nan at index \(1,\)"),
    ("complex axis", lambda: Grid.from_axes([[0, 1j], [0, 1]]), DtypeError, r"axes\[0\]: has dtype complex"),
    ("frame in 1-D", lambda: Frame((1.0,), 1.0), ShapeError, r"centre: has shape \(1,\)"),
    ("frame of NaN", lambda: Frame((1.0, np.nan), 1.0), NonFiniteError, "centre: is nan"),
    ("frame of scale 0", lambda: Frame((1.0, 1.0), 0.0), ArgumentError, "scale: is 0.0"),
    ("frame of three scales", lambda: Frame((1.0, 1.0), (1, 1, 1)), ShapeError, "scale: has shape"),
    ("voxels in a tuple", lambda: VoxelGrid(np.ones((2, 2)), (1, 1)), DtypeError, "box: is a tuple"),  # type: ignore[arg-type]
    ("complex voxels", lambda: VoxelGrid(np.ones((2, 2, 2), complex), BOX), DtypeError, "values: has dtype complex"),
    ("half precision", lambda: VoxelGrid(np.ones((2, 2, 2), np.float16), BOX), DtypeError, "values: has dtype float16"),
    ("object voxels", lambda: VoxelGrid(np.ones((2, 2, 2), object), BOX), DtypeError, "values: has dtype object"),
    ("flat voxels", lambda: VoxelGrid(np.ones((2, 2)), BOX), ShapeError, r"values: has shape \(2, 2\)"),
    ("no voxels", lambda: VoxelGrid(np.ones((2, 0, 2)), BOX), ShapeError, "no cells"),
    ("flat vertices", lambda: TriangleMesh(SQUARE, [[0, 1, 2]]), ShapeError, r"vertices: has shape \(4, 2\)"),
    ("no vertices", lambda: TriangleMesh(np.empty((0, 3)), [[0, 1, 2]]), ShapeError, "vertices"),
    ("NaN vertex", lambda: TriangleMesh([[0, 0, np.nan]], [[0, 0, 0]]), NonFiniteError, r"nan at index \(0, 2\)"),
    ("real faces", lambda: TriangleMesh(CORNERS, [[0.0, 1, 2]]), DtypeError, "faces: has dtype float64"),
    ("quads", lambda: TriangleMesh(CORNERS, [[0, 1, 2, 3]]), ShapeError, r"faces: has shape \(1, 4\)"),
    ("no faces", lambda: TriangleMesh(CORNERS, np.empty((0, 3), int)), ShapeError, "faces"),
    ("index too large", lambda: TriangleMesh(CORNERS, [[0, 1, 2], [0, 4, 1]]), ArgumentError, "vertex 4 in triangle 1"),
    ("negative index", lambda: TriangleMesh(CORNERS, [[0, -1, 2]]), ArgumentError, "vertex -1 in triangle 0"),
    ("no rings", lambda: Polygons([]), ShapeError, "rings: is empty"),
    ("two corners", lambda: Polygons([SQUARE, SQUARE[:2]]), ShapeError, r"rings\[1\]: has shape \(2, 2\)"),
    ("corners in 3-D", lambda: Polygons([CORNERS]), ShapeError, r"rings\[0\]: has shape \(4, 3\)"),
    ("repeated corner", lambda: Polygons([[*SQUARE, SQUARE[0]]]), ArgumentError, "repeats its first corner"),
    ("NaN corner", lambda: Polygons([[*SQUARE, [np.nan, 0]]]), NonFiniteError, r"rings\[0\]: is nan at index \(4, 0\)"),
]


@pytest.mark.parametrize(("make", "error", "message"), [pytest.param(*case[1:], id=case[0]) for case in BAD])
def test_bad_input(make: Callable[[], Any], error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: TriangleMesh([[0, 0, 0], [1, 2]], [[0, 1, 2]]), ShapeError, "vertices: is not an array"),
        (lambda: TriangleMesh(np.eye(3), [[0, 1, 2], [0]]), ShapeError, "faces: is not an array"),
        (lambda: VoxelGrid([[1], [1, 2]], Box((1, 1))), ShapeError, "values: is not an array"),
        (lambda: VoxelGrid(np.ma.masked_equal([[1, 2]], 2), Box((1, 1))), ArgumentError, "values: has masked entries"),
        (lambda: Polygons(None), DtypeError, "rings: is a NoneType"),
        (lambda: Polygons(ring for ring in []), DtypeError, "rings: is a generator"),
        (lambda: Grid.from_axes(None), DtypeError, "axes: is a NoneType"),
        (lambda: Box("22"), DtypeError, "lengths: has dtype"),
        (lambda: Box((True, True)), DtypeError, "lengths: is"),
    ],
)
def test_what_is_no_array(make, error, message) -> None:
    with pytest.raises(error, match=message):
        make()


def test_numpy_scalars_are_lengths() -> None:
    assert Frame((0, 0), np.float32(2)).scale == Frame((0, 0), np.int64(2)).scale == (2.0, 2.0)


@pytest.mark.parametrize(
    ("made", "arrays"),
    [
        (TriangleMesh(np.eye(3), [[0, 1, 2]]), lambda mesh: [mesh.vertices, mesh.faces]),
        (Polygons([[[0, 0], [1, 0], [0, 1]]]), lambda region: list(region.rings)),
        (VoxelGrid(np.ones((2, 3)), Box((1, 1))), lambda body: [body.values]),
        (Grid(Box((1, 2)), 3), lambda grid: list(grid.axes)),
        (Grid.from_axes([[0.0, 1.0], [0.0, 3.0, 4.0]]), lambda grid: list(grid.axes)),
    ],
)
def test_pickles_come_back_equal_and_frozen(made: Any, arrays: Callable[[Any], list[Any]]) -> None:
    again = pickle.loads(pickle.dumps(made))
    for one, other in zip(arrays(again), arrays(made), strict=True):
        np.testing.assert_array_equal(one, other)
        assert not one.flags.writeable
