"""Voxels against winding numbers by solid angles, closed forms, and every kind of tie."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from accel_shapegen import metrics
from accel_shapegen.bodies.families import apple, ball, cuboid, disk, ellipsoid, kite, multi_domain, rectangle
from accel_shapegen.errors import ArgumentError, DtypeError, MeshError, OutsideBoxError, ShapeError, ShapegenError
from accel_shapegen.geometry import Box, Grid, Polygons, TriangleMesh
from accel_shapegen.voxelize import voxelize

SHAPES = [(1, 1, 1), (2, 3, 1), (17, 19, 24), (7, 31, 13), (40, 1, 9)]


def winding(body: TriangleMesh | Polygons, points: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Winding numbers by the sum of solid angles (van Oosterom and Strackee 1983), or of plane angles."""
    total = np.zeros(points.shape[:-1])
    if isinstance(body, Polygons):
        for ring in body.rings:
            for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                p, q = a - points, b - points
                total += np.arctan2(p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0], np.sum(p * q, axis=-1))
        return total / (2 * np.pi)
    for triangle in body.vertices[body.faces]:
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
        triple = np.einsum("...i,...i", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("...i,...i", x, y) for x, y in ((a, b), (b, c), (c, a)))
        total += 2 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb)
    return total / (4 * np.pi)


def oracle(body: TriangleMesh | Polygons, points: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    number = winding(body, points)
    # A closed surface winds a whole number of times: this fails if the oracle itself is in doubt.
    assert np.abs(number - np.round(number)).max() < 1e-6
    return np.round(number) > 0


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def moved(mesh: TriangleMesh, by: Any) -> TriangleMesh:
    return TriangleMesh(mesh.vertices + np.asarray(by), mesh.faces)


def reversed_(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])


def crumpled(seed: int) -> TriangleMesh:
    """A closed mesh that cuts through itself many times over."""
    sphere = ball(1, subdivisions=2)
    rng = np.random.default_rng(seed)
    return TriangleMesh(sphere.vertices * 0.6 + rng.normal(scale=0.12, size=sphere.vertices.shape), sphere.faces)


BODIES: dict[str, Callable[[], TriangleMesh]] = {
    "ball": lambda: ball(0.9, subdivisions=2),
    "cuboid": lambda: cuboid(1.9, 1.2, 1.4),
    "overlapping": lambda: joined(moved(ball(0.6, subdivisions=2), [0.2, 0, 0.1]), cuboid(0.8, 0.9, 1)),
    "nested": lambda: joined(ball(0.9, subdivisions=2), cuboid(0.7, 0.7, 0.7)),
    "cavity": lambda: joined(ball(0.9, subdivisions=2), reversed_(ball(0.5, subdivisions=1))),
    "crumpled": lambda: crumpled(1),
    "crumpled more": lambda: crumpled(2),
}  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", BODIES)
def test_against_solid_angles(name: str, shape: tuple[int, ...]) -> None:
    body = BODIES[name]()
    # A box without symmetry: no centre lies on the surface, which the oracle's own check would show.
    grid = Grid(Box((2.7, 2.3, 2.9)), shape)
    voxels = voxelize(body, grid)
    assert voxels.values.dtype == bool
    assert voxels.box == grid.box
    assert np.array_equal(voxels.values, oracle(body, grid.points()))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("scale", [2.0, 3.0, 5.0])
def test_ties_against_shifted_points(seed: int, scale: float) -> None:
    """Every vertex of the mesh is a cell centre, so columns run through vertices, edges and within faces."""
    n = 17
    grid = Grid(Box((n, n, n)), n)
    sphere = ball(1, subdivisions=1)
    rng = np.random.default_rng(seed)
    vertices = np.round(scale * sphere.vertices + rng.normal(scale=1.0, size=sphere.vertices.shape))
    body = TriangleMesh(vertices, sphere.faces)
    if body.volume <= 0:
        body = reversed_(body)
    # "Inside on the larger-coordinate side" is the body seen from points moved by ε_z ≫ ε_x ≫ ε_y > 0; slopes here are
    # ratios of integers below 17, so steps of 1e-3 keep the three apart.
    expected = oracle(body, grid.points() + np.array([1e-5, 1e-8, 1e-2]))
    # Rounding may put a centre that lies in a slanted face on either side of it - but none beside the surface.
    wrong = grid.points()[voxelize(body, grid).values != expected]
    pairs = np.repeat(wrong, len(body.faces), axis=0), np.tile(body.vertices[body.faces], (len(wrong), 1, 1))
    distance = metrics._distance(*pairs).reshape(len(wrong), len(body.faces)).min(axis=1)
    assert len(wrong) <= 3
    assert np.all(distance < 64 * np.finfo(float).eps)


def test_ties_of_polygons_against_shifted_points() -> None:
    grid = Grid(Box((21, 21)), 21)
    rng = np.random.default_rng(4)
    for _ in range(20):
        ring = np.round(rng.uniform(-9, 9, size=(9, 2)))
        ring = ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]
        body = Polygons([ring if Polygons([ring]).volume > 0 else ring[::-1]])
        if body.volume > 0:
            assert np.array_equal(voxelize(body, grid).values, oracle(body, grid.points() + np.array([1e-5, 1e-2])))


def test_faces_on_centres_belong_to_the_lower_side() -> None:
    inside = voxelize(cuboid(4, 4, 4), Grid(Box((9, 9, 9)), 9)).values
    assert inside.sum() == 4**3
    assert inside[2:6, 2:6, 2:6].all()
    plane = voxelize(rectangle(4, 2), Grid(Box((9, 9)), 9)).values
    assert plane.sum() == 8
    assert plane[2:6, 3:5].all()


def test_bodies_that_share_a_face_tile() -> None:
    grid = Grid(Box((9, 9, 9)), 9)
    left, right = (voxelize(moved(cuboid(2, 4, 4), [x, 0, 0]), grid).values for x in (-1, 1))
    assert not (left & right).any()
    assert np.array_equal(left | right, voxelize(cuboid(4, 4, 4), grid).values)


@pytest.mark.parametrize("n", [1, 2, 17, 31, 100])
def test_cuboid_counts_cells(n: int) -> None:
    grid = Grid(Box((3, 3, 3)), n)
    extents = (1.9, 1.2, 1.4)
    along = [np.abs(axis) < e / 2 for axis, e in zip(grid.axes, extents, strict=True)]
    expected = along[0][:, None, None] & along[1][:, None] & along[2]
    assert np.array_equal(voxelize(cuboid(*extents), grid).values, expected)


@pytest.mark.parametrize("shape", [(100, 100, 100), (97, 61, 83)])
def test_ellipsoid_volume(shape: tuple[int, ...]) -> None:
    body = ellipsoid(0.6, 0.25, 0.95, subdivisions=4)
    grid = Grid(Box((2.2, 2.2, 2.2)), shape)
    cell = float(np.prod(grid.spacing))
    volume = voxelize(body, grid).values.sum() * cell
    # Cells cut by the surface are in or out as if by chance: about area/h² of them, each wrong by up to half a cell; 3
    # standard deviations of that sum. The area of an ellipsoid is at most that of the ball around it.
    cut = 4 * np.pi * 0.95**2 / cell ** (2 / 3)
    assert abs(volume - body.volume) < 3 * cell * np.sqrt(cut / 12)


CURVES: dict[str, Callable[[], Polygons]] = {
    "kite": lambda: kite(0.93, 1.76, segments=256),
    "multi-domain": lambda: multi_domain(1.94, 0.53, segments=256),
    "ring": lambda: Polygons([disk(1.6, segments=97).rings[0], apple(1, segments=97).rings[0][::-1]]),
    "overlapping": lambda: Polygons([disk(1, (0.3, 0.1)).rings[0], disk(1.2, (-0.5, 0), segments=97).rings[0]]),
    "one segment across": lambda: Polygons([[[-3, -3], [3.1, -2.9], [0.2, 3]]]),
}  # fmt: skip


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (1, 40), (53, 89)])
@pytest.mark.parametrize("name", CURVES)
def test_polygons_against_angles(name: str, shape: tuple[int, ...]) -> None:
    body = CURVES[name]()
    grid = Grid(Box((7.1, 6.3)), shape)
    assert np.array_equal(voxelize(body, grid).values, oracle(body, grid.points()))


def test_slivers_and_vertical_triangles() -> None:
    """Every face split at a point a hair off an edge, and doubled by a flap of no volume: the body stays the same."""
    plain = cuboid(1.9, 1.2, 1.4)
    a, b, c = plain.faces.T
    middle = plain.vertices[a] * 0.5 + plain.vertices[b] * (0.5 - 1e-13) + plain.vertices[c] * 1e-13
    m = len(plain.vertices) + np.arange(len(a))
    split = np.concatenate([np.stack(f, axis=1) for f in ((a, b, m), (b, c, m), (c, a, m))])
    flaps = np.concatenate([plain.faces, plain.faces[:, ::-1]])
    body = TriangleMesh(np.concatenate([plain.vertices, middle]), np.concatenate([split, flaps]))
    assert body.is_closed
    for shape in ((20, 20, 20), (19, 31, 17)):
        grid = Grid(Box((3, 3, 3)), shape)
        assert np.array_equal(voxelize(body, grid).values, voxelize(plain, grid).values)


def test_blocks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = Grid(Box((2.7, 2.3, 2.9)), (31, 29, 23))
    bodies = crumpled(3), CURVES["ring"]()
    grids = grid, Grid(Box((7, 7)), (31, 29))
    whole = [voxelize(body, g).values for body, g in zip(bodies, grids, strict=True)]
    # By name in sys.modules: the package hands out the function under the same name.
    monkeypatch.setattr(sys.modules["accel_shapegen.voxelize"], "BLOCK", 5)
    for body, g, expected in zip(bodies, grids, whole, strict=True):
        assert np.array_equal(voxelize(body, g).values, expected)


def test_a_body_between_the_centres_is_no_cell() -> None:
    assert not voxelize(cuboid(0.1, 0.1, 0.1), Grid(Box((2, 2, 2)), 2)).values.any()


def test_a_body_as_large_as_its_box() -> None:
    assert voxelize(cuboid(3, 3, 3), Grid(Box((3, 3, 3)), 5)).values.all()


@pytest.mark.parametrize(
    ("body", "grid", "error", "message"),
    [
        (TriangleMesh(cuboid(1, 1, 1).vertices, cuboid(1, 1, 1).faces[:-1]), None, MeshError, "body: is an open mesh"),
        (reversed_(cuboid(1, 1, 1)), None, MeshError, "body: has volume -1 m³"),
        (joined(cuboid(1, 1, 1), reversed_(cuboid(1, 1, 1))), None, MeshError, "body: has volume 0 m³"),
        (moved(cuboid(1, 1, 1), [0, 1.6, 0]), None, OutsideBoxError, r"spans \[1.1, 2.1\] m on axis 1; .* ±2"),
        (Polygons([rectangle(1, 1).rings[0][::-1]]), Grid(Box((4, 4)), 4), MeshError, "body: has area -1 m²"),
        (disk(3), Grid(Box((7, 5)), 4), OutsideBoxError, r"on axis 1; the box ends at ±2.5"),
        (cuboid(1, 1, 1), Grid(Box((4, 4)), 4), ShapeError, "grid: has 2 axes for a body in 3-D"),
        (disk(1), None, ShapeError, "grid: has 3 axes for a body in 2-D"),
        (cuboid(1, 1, 1), Grid.from_axes([[0, 1]] * 3), ArgumentError, "grid: has no box"),
        (cuboid(1, 1, 1), Box((4, 4, 4)), DtypeError, "grid: is a Box"),
        (np.ones((3, 3)), None, DtypeError, "body: is a ndarray"),
    ],
)
def test_bad_input(body: Any, grid: Any, error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        voxelize(body, Grid(Box((4, 4, 4)), 4) if grid is None else grid)
