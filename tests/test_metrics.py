"""Metrics against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accel_shapegen import metrics
from accel_shapegen.bodies.families import ball, cuboid, disk, rectangle
from accel_shapegen.errors import ArgumentError, DtypeError, NonFiniteError, ShapeError, ShapegenError
from accel_shapegen.geometry import Box, Polygons, TriangleMesh, VoxelGrid
from accel_shapegen.metrics import far_field_error, hausdorff, iou, volume_error
from accel_shapegen.nodes import FourierLattice, ScatteredNodes

EPS = np.finfo(float).eps


def moved(body: Any, by: Any) -> Any:
    if isinstance(body, TriangleMesh):
        return TriangleMesh(body.vertices + np.asarray(by), body.faces)
    return Polygons([ring + np.asarray(by) for ring in body.rings])


def test_iou_counts_cells() -> None:
    a = np.zeros((4, 5, 6), dtype=bool)
    b = a.copy()
    a[:2], b[1:3] = True, True
    assert iou(a, b) == 1 / 3
    assert iou(a, a) == 1.0
    assert iou(a, ~a) == 0.0
    box = Box((1, 2, 3))
    assert iou(VoxelGrid(a, box), VoxelGrid(b, box)) == 1 / 3
    assert iou(VoxelGrid(a, box), b) == 1 / 3
    assert iou(a.tolist(), b) == 1 / 3


@pytest.mark.parametrize(
    ("a", "b", "error", "message"),
    [
        ([True], [1.0], DtypeError, "b: has dtype float64; give booleans, as in b > 0.5"),
        (VoxelGrid(np.ones((2, 2)), Box((1, 1))), [True], DtypeError, "a: has dtype float64"),
        ([True, False], [True], ShapeError, r"b: has shape \(1,\)"),
        ([False, False], [False, False], ArgumentError, "a, b: are both empty"),
        (VoxelGrid([[True]], Box((1, 1))), VoxelGrid([[True]], Box((1, 2))), ArgumentError, "b: fills Box"),
    ],
)
def test_bad_iou(a: Any, b: Any, error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        iou(a, b)


def test_volume_error() -> None:
    assert volume_error(cuboid(1, 1, 1.1), cuboid(1, 1, 1)) == pytest.approx(0.1, rel=32 * EPS)
    assert volume_error(rectangle(1, 0.9), rectangle(1, 1)) == pytest.approx(0.1, rel=32 * EPS)
    flat = Polygons([[[0, 0], [1, 1], [2, 2]]])
    with pytest.raises(ArgumentError, match="exact: encloses no volume"):
        volume_error(rectangle(1, 1), flat)
    with pytest.raises(ShapeError, match="exact: is a body in 3-D"):
        volume_error(rectangle(1, 1), cuboid(1, 1, 1))
    with pytest.raises(DtypeError, match="body: is a float"):
        volume_error(1.0, cuboid(1, 1, 1))  # type: ignore[arg-type]


LATTICE = FourierLattice(Box((1.0, 2.0, 1.5)), (2, 1, 3))
RECEIVERS = ScatteredNodes(np.eye(3), [1.0, 2.0, 3.0])


def random_field(shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(3)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize("dtype", ["complex64", "complex128"])
def test_far_field_error_leaves_the_zero_slot_out(dtype: str) -> None:
    exact = random_field((2, *LATTICE.shape)).astype(dtype)
    exact[(..., *LATTICE.zero_slot)] = 1e6
    u = exact * np.array([1.1, 0.75], dtype=dtype)[:, None, None, None]
    u[(..., *LATTICE.zero_slot)] = -5
    error = far_field_error(u, exact, LATTICE)
    assert isinstance(error, np.ndarray)
    # u is rounded entry by entry; the sum is not.
    np.testing.assert_allclose(error, [0.1, 0.25], rtol=0, atol=4 * float(np.finfo(dtype).eps))
    single = far_field_error(u[1], exact[1], LATTICE)
    assert isinstance(single, float)
    assert single == error[1]


def test_far_field_error_on_receivers_counts_all() -> None:
    exact = random_field((4, 5, 3))
    u = exact.copy()
    u[2, 3, 0] += 0.3j
    error = far_field_error(u, exact, RECEIVERS)
    expected = np.zeros((4, 5))
    expected[2, 3] = 0.3 / np.linalg.norm(exact[2, 3])
    np.testing.assert_allclose(error, expected, rtol=8 * EPS)


@pytest.mark.parametrize(
    ("u", "exact", "error", "message"),
    [
        (np.ones(LATTICE.shape), np.ones((3, 5)), ShapeError, r"u_exact: has shape \(3, 5\)"),
        (np.ones(LATTICE.shape[1:]), np.ones(LATTICE.shape[1:]), ShapeError, "u_exact: has shape"),
        (np.ones((2, *LATTICE.shape)), np.ones(LATTICE.shape), ShapeError, "u: has shape"),
        (np.full(LATTICE.shape, np.nan), np.ones(LATTICE.shape), NonFiniteError, r"u: is .*nan.* at index \(0, 0, 0\)"),
        (np.ones(LATTICE.shape), np.zeros(LATTICE.shape), ArgumentError, "u_exact: is zero at every node that counts"),
        (np.ones((2, *LATTICE.shape)), np.zeros((2, *LATTICE.shape)), ArgumentError, r"for body \(0,\)"),
        ("u", np.ones(LATTICE.shape), DtypeError, "u: has dtype"),
    ],
)
def test_bad_far_field_error(u: Any, exact: Any, error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        far_field_error(u, exact, LATTICE)


def test_hausdorff_of_cuboids() -> None:
    # The corner of the larger one is farthest from the smaller one's; distances at corners carry no sampling error.
    a, b = cuboid(1, 2, 3), cuboid(1.2, 2.4, 3.6)
    exact = np.sqrt(0.1**2 + 0.2**2 + 0.3**2)
    for spacing in (0.1, 10.0):
        assert hausdorff(a, b, spacing=spacing) == pytest.approx(exact, rel=16 * EPS)
        assert hausdorff(b, a, spacing=spacing) == hausdorff(a, b, spacing=spacing)


def test_hausdorff_is_two_sided() -> None:
    part, whole = rectangle(1, 1), Polygons([*rectangle(1, 1).rings, *moved(rectangle(1, 1), [5, 0]).rings])
    # Every corner of the part lies on the whole; from the whole's far corner it is 5.
    assert hausdorff(part, whole) == pytest.approx(5, rel=16 * EPS)
    assert hausdorff(whole, part) == pytest.approx(5, rel=16 * EPS)


def test_hausdorff_of_equal_surfaces_is_zero() -> None:
    # A subdivided surface is the same set: sampled points lie on the plane of a face to rounding.
    coarse = cuboid(1, 1, 1)
    middle = coarse.vertices[coarse.faces].mean(axis=1)
    m = len(coarse.vertices) + np.arange(len(middle))
    a, b, c = coarse.faces.T
    fine = TriangleMesh(
        np.concatenate([coarse.vertices, middle]),
        np.concatenate([np.stack(f, axis=1) for f in ((a, b, m), (b, c, m), (c, a, m))]),
    )
    assert hausdorff(coarse, fine, spacing=0.1) < 4 * EPS
    assert hausdorff(disk(1), disk(1)) < 4 * EPS


def test_hausdorff_of_balls_and_disks() -> None:
    assert hausdorff(ball(1, subdivisions=3), ball(1.1, subdivisions=3), spacing=0.05) == pytest.approx(0.1, rel=1e-3)
    # The circles differ from their polygons by 4.7e-6 of the radius at most.
    assert hausdorff(disk(1), disk(1.5)) == pytest.approx(0.5, abs=1e-5)
    assert hausdorff(disk(1), disk(1, (0.2, 0.1))) == pytest.approx(np.hypot(0.2, 0.1), abs=1e-5)


@pytest.mark.parametrize("spacing", [0.4, 0.1, 0.05])
def test_hausdorff_to_the_middle_of_a_face(spacing: float) -> None:
    """Farthest in the middle of a face: a roof over a flat one."""
    flat = cuboid(2, 2, 2)
    top = [i for i, v in enumerate(flat.vertices) if v[2] > 0]
    vertices = np.concatenate([flat.vertices, [[0.13, -0.07, 1.3]]])
    faces = [f for f in flat.faces.tolist() if not set(f) <= set(top)]
    ring = sorted(top, key=lambda i: np.arctan2(flat.vertices[i, 1], flat.vertices[i, 0]))
    faces += [[ring[i], ring[(i + 1) % 4], 8] for i in range(4)]
    roof = TriangleMesh(vertices, faces)
    assert roof.is_closed
    # The ridge is a corner of the roof, so it is a sample; of the flat face, the foot below it is none.
    assert hausdorff(roof, flat, spacing=spacing) == pytest.approx(0.3, rel=16 * EPS)


@pytest.mark.parametrize("spacing", [0.5, 0.2, 0.07])
def test_hausdorff_within_spacing(spacing: float) -> None:
    """Farthest at a point of a straight side that is a sample only by chance, over a notch."""
    straight = rectangle(2, 2)
    notch = Polygons([[[-1, -1], [0.1, -0.7], [1, -1], [1, 1], [-1, 1]]])
    # From (x, -1) the slopes are (x + 1) sin α and (1 - x) sin β away; they are equal at the farthest point.
    sines = 0.3 / np.hypot(1.1, 0.3), 0.3 / np.hypot(0.9, 0.3)
    exact = 2 / (1 / sines[0] + 1 / sines[1])
    # The notch's tip is 0.3 from the straight side, farther than that: look one way only.
    pieces = metrics._pieces(straight), metrics._pieces(notch)
    samples = [metrics._sample(p, spacing) for p in pieces]
    got = metrics._reach(samples[0][0], samples[1], pieces[1])
    assert exact - spacing / 2 <= got <= exact + 4 * EPS
    assert hausdorff(straight, notch, spacing=spacing) == pytest.approx(0.3, rel=16 * EPS)


@pytest.mark.parametrize("seed", range(4))
def test_distance_to_triangles(seed: int) -> None:
    """Against a fine search over the triangle, slivers and needles included."""
    rng = np.random.default_rng(seed)
    triangles = rng.standard_normal((40, 3, 3))
    triangles[:10, 2] = 0.5 * (triangles[:10, 0] + triangles[:10, 1])  # collinear
    triangles[10:15, 1] = triangles[10:15, 0]  # a corner twice
    triangles[15:17] = triangles[15:17, :1]  # a point
    points = 2 * rng.standard_normal((40, 3))
    n = 400
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    weights = np.stack([n - i - j, i, j], axis=1) / n
    sampled = np.array([np.linalg.norm(weights @ t - p, axis=1).min() for t, p in zip(triangles, points, strict=True)])
    got = metrics._distance(points, triangles)
    # The best sample is no nearer than the triangle, and farther by less than the sampling distance, 8/400.
    assert np.all(got <= sampled + 16 * EPS)
    assert np.all(sampled - got < 0.02)


@pytest.mark.parametrize(
    ("a", "b", "spacing", "error", "message"),
    [
        (cuboid(1, 1, 1), disk(1), None, ShapeError, "b: is a body in 2-D"),
        (np.ones((3, 3)), disk(1), None, DtypeError, "a: is a ndarray"),
        (disk(1), VoxelGrid([[True]], Box((1, 1))), None, DtypeError, "b: is a VoxelGrid"),
        (disk(1), disk(1), 0.0, ArgumentError, "spacing: is 0.0"),
        (disk(1), disk(1), np.nan, ArgumentError, "spacing: is nan"),
        (disk(1), disk(1), "1", ArgumentError, "spacing: is '1'"),
        (cuboid(1, 1, 1), cuboid(1, 1, 1), 1e-9, ArgumentError, "spacing: is 1e-09, which takes .* samples"),
    ],
)
def test_bad_hausdorff(a: Any, b: Any, spacing: Any, error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        hausdorff(a, b, spacing=spacing)
