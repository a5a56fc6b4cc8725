"""Reference frames: of bodies, of models, and what comes back through them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import (
    Box,
    FourierLattice,
    Frame,
    Grid,
    Polygons,
    ScatteredNodes,
    ShapeModel,
    TriangleMesh,
    VoxelGrid,
)  # fmt: skip
from accel_shapegen.backends.base import Backend
from accel_shapegen.errors import (
    ArgumentError,
    DtypeError,
    MeshError,
    NonFiniteError,
    OutsideBoxError,
    QueryRangeError,
    ShapeError,
    ShapegenError,
)  # fmt: skip
from accel_shapegen.frames import bounds_of, cropped, frame_of, moments_of, normalised
from accel_shapegen.testing import box_transform, ellipsoid_transform, relative_error

EPS = float(np.finfo(np.float64).eps)
KITE_LATTICE = FourierLattice(Box((7.0, 7.0)), 20)


def boxes(*knots: np.ndarray) -> list[VoxelGrid]:
    """Cuboids (rectangles) as one voxel each, which is exact."""
    return [VoxelGrid(np.ones((1,) * len(e)), Box([float(v) for v in e])) for e in product(*knots)]


def block(lower: tuple[int, ...], upper: tuple[int, ...], shape: tuple[int, ...], lengths: tuple[float, ...]):
    values = np.zeros(shape)
    values[tuple(map(slice, lower, upper))] = 2.5
    return VoxelGrid(values, Box(lengths))


def framed_box_far_field(lattice: FourierLattice, sides: tuple[float, ...]) -> np.ndarray:
    """u∞ of a box at the origin in closed form, zero node included."""
    kappa = lattice.kappa
    assert kappa[lattice.zero_slot][0] == lattice.zero_kappa
    return asg.far_field_constant(lattice.wavenumbers, lattice.dim) * box_transform(sides, kappa)


# Bounds and moments


def test_bounds_of_voxels_are_outer_faces() -> None:
    body = block((2, 5, 1), (4, 6, 5), (7, 8, 5), (0.7, 0.8, 0.5))
    np.testing.assert_allclose(bounds_of(body), [[-0.15, 0.1, -0.15], [0.05, 0.2, 0.25]], atol=EPS)
    part, centre = cropped(body)
    np.testing.assert_array_equal(part.values, np.full((2, 1, 4), 2.5))
    np.testing.assert_allclose(part.box.lengths, (0.2, 0.1, 0.4), rtol=4 * EPS)
    np.testing.assert_allclose(centre, (-0.05, 0.15, 0.05), atol=EPS)
    assert np.isnan(bounds_of(VoxelGrid(np.zeros((3, 3)), Box((1, 1))))).all()


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float32])
def test_the_dtype_of_voxels_does_not_matter(dtype: type) -> None:
    values = block((2, 5), (4, 6), (7, 8), (0.7, 0.8)).values > 0
    for rule in ("height", "bbox", "moments"):
        assert frame_of(VoxelGrid(values.astype(dtype), Box((0.7, 0.8))), rule) == frame_of(
            VoxelGrid(values.astype(float), Box((0.7, 0.8))), rule
        )


def test_rules_on_a_box_off_centre() -> None:
    """Extents 0.2 × 0.1 × 0.4 at (-0.05, 0.15, 0.05), as voxels and as a mesh; a box deviates by its side over √12."""
    voxels = block((2, 5, 1), (4, 6, 5), (7, 8, 5), (0.7, 0.8, 0.5))
    cuboid = asg.bodies.cuboid(0.2, 0.1, 0.4)
    mesh = TriangleMesh(cuboid.vertices + np.array([-0.05, 0.15, 0.05]), cuboid.faces)
    sides = np.array([0.2, 0.1, 0.4])
    for body in (voxels, mesh):
        for rule, size in (("height", 0.4), ("bbox", sides), ("moments", sides / np.sqrt(12))):
            frame = frame_of(body, rule)
            np.testing.assert_allclose(frame.centre, (-0.05, 0.15, 0.05), atol=4 * EPS)
            np.testing.assert_allclose(frame.scale, np.broadcast_to(size, 3), rtol=32 * EPS)


def test_moments_of_signed_voxels_by_hand() -> None:
    """Weights 3 and 1 on two cells of 1 × 2; and weights that have no centroid, or a negative variance."""
    centre, deviation = moments_of(VoxelGrid(np.array([[3.0], [1.0]]), Box((2.0, 2.0))))
    np.testing.assert_allclose(centre, (-0.25, 0.0), atol=EPS)
    # x: 3/4 at -1/2 and 1/4 at +1/2 have variance 3/16, and h²/12; y: one cell of height 2.
    np.testing.assert_allclose(deviation**2, (3 / 16 + 1 / 12, 4 / 12), rtol=8 * EPS)
    with pytest.raises(ArgumentError, match=r"add up to -1"):
        moments_of(VoxelGrid(np.array([[1.0], [-2.0]]), Box((2.0, 2.0))))
    with pytest.raises(ArgumentError, match=r"has variance -\S+ m² on axis 0"):
        moments_of(VoxelGrid(np.array([[-1.0], [3.0], [-1.0]]), Box((3.0, 2.0))))


def test_moments_of_surfaces_in_closed_form() -> None:
    """An ellipse as a polygon, and a tetrahedron: closed forms."""
    radii, centre = np.array([0.3, 0.8]), np.array([1.0, -2.0])
    t = 2 * np.pi * np.arange(4096) / 4096
    ellipse = Polygons([centre + radii * np.stack([np.cos(t), np.sin(t)], axis=1)])
    c, s = moments_of(ellipse)
    # The polygon misses second moments by 2π²/n² ~ 1e-6 of themselves.
    np.testing.assert_allclose(c, centre, rtol=1e-12)
    np.testing.assert_allclose(s, radii / 2, rtol=2e-6)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    tetrahedron = TriangleMesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    c, s = moments_of(tetrahedron)
    # Of the simplex with legs L: mean L/4, variance 3 L²/80.
    np.testing.assert_allclose(c, (1 / 4, 2 / 4, 3 / 4), rtol=16 * EPS)
    np.testing.assert_allclose(s, np.sqrt(3 / 80) * np.array([1, 2, 3]), rtol=16 * EPS)


def test_moments_of_surfaces_against_their_voxels() -> None:
    human = asg.bodies.human(1.7, 1.1)
    cells = Grid(Box((1.6, 0.8, 2.2)), (200, 100, 275))
    c, s = moments_of(human)
    voxel_c, voxel_s = moments_of(asg.voxelize(human, cells))
    # Cells of 8 mm, in or out by their centre.
    np.testing.assert_allclose(voxel_c, c, atol=1e-3)
    np.testing.assert_allclose(voxel_s, s, atol=1e-3)
    ring = [
        np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]),
        np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]]),
    ]
    c, s = moments_of(Polygons(ring))
    np.testing.assert_allclose(c, 0, atol=EPS)
    np.testing.assert_allclose(s**2, (4 / 3 - 1 / 12) / 3, rtol=16 * EPS)


def test_scales_are_relative_to_the_largest() -> None:
    centres, scales = normalised([Frame((0, 1), (1, 4)), Frame((2, 3), (2, 1))])
    np.testing.assert_array_equal(centres, [[0, 1], [2, 3]])
    np.testing.assert_array_equal(scales, [[0.5, 1], [1, 0.25]])


# Models


def test_framed_cuboids_are_exact(opencl: Backend) -> None:
    """Five knots per extent, which alias the phase without frames; in frames all cuboids are one."""
    knots = (np.linspace(1, 2, 5),) * 3
    lattice = FourierLattice(Box((3.0, 3.0, 3.0)), (9, 8, 7))
    model = ShapeModel.fit_bodies(knots, boxes(*knots), lattice, frame="bbox", backend=opencl)
    queries = np.array([(1.9, 1.2, 1.4), (1.2, 1.5, 1.8), (1.6, 1.8, 1.3), (1.8, 1.8, 1.8)])
    exact = framed_box_far_field(lattice, (2.0, 2.0, 2.0))
    for row in model.predict(queries):
        # float32 data, weights that sum to 1: some roundings.
        assert asg.metrics.far_field_error(row, exact, lattice) < 5e-7
    centres, scales = model.frames(queries)
    np.testing.assert_allclose(centres, 0, atol=EPS)
    np.testing.assert_allclose(scales, queries / 2, rtol=32 * EPS)
    grid = Grid(lattice.box, (30, 29, 31))
    fields = model.generate(queries, grid, batch=3)
    for field, query in zip(fields, queries, strict=True):
        expected = asg.synthesize(exact, lattice, grid, frame=Frame((0, 0, 0), (query / 2).tolist()))
        np.testing.assert_allclose(field, expected, atol=2e-5)  # amplitude ~1, thousands of terms in float32


@pytest.mark.parametrize("rule", ["bbox", "moments"])
def test_framed_kites_are_exact(rule: str) -> None:
    knots = (np.linspace(0.5, 1.8, 4), np.linspace(0.5, 1.8, 3))
    bodies = [asg.bodies.kite(float(a), float(b), segments=128) for a, b in product(*knots)]
    model = ShapeModel.fit_bodies(knots, bodies, KITE_LATTICE, frame=rule)
    queries = np.array([(0.93, 1.76), (1.58, 0.87)])
    for query, centre, scale, row in zip(queries, *model.frames(queries), model.predict(queries), strict=True):
        kite = asg.bodies.kite(*map(float, query), segments=128)
        exact = asg.far_field(kite, KITE_LATTICE, frame=Frame(centre.tolist(), scale.tolist()), dtype="complex128")
        assert asg.metrics.far_field_error(row, exact, KITE_LATTICE) < 5e-7
        np.testing.assert_allclose(scale, query / 1.8, rtol=1e-12)


def test_the_far_field_of_voxels_in_frames_is_the_closed_form() -> None:
    """Off-centre blocks of several cells, whose empty surroundings would not fit the box once normalised."""
    lattice = FourierLattice(Box((1.0, 0.9)), (6, 5))
    bodies = [
        block((2, 1), (7, 8), (10, 10), (1.0, 1.0)),
        block((0, 4), (4, 10), (8, 10), (1.0, 1.5)),
        block((1, 1), (2, 2), (3, 3), (0.9, 0.3)),
    ]
    model = ShapeModel.fit_bodies([[0, 1, 3]], bodies, lattice, frame="bbox", dtype="complex128")
    sides = np.array([np.ptp(bounds_of(body), axis=0) for body in bodies])
    exact = 2.5 * framed_box_far_field(lattice, tuple(sides.max(axis=0)))
    for row in model.predict([[0.0], [1.0], [3.0]]):
        assert relative_error(row, exact) < 64 * EPS
    centres, scales = model.frames([[0.0], [1.0], [3.0]])
    np.testing.assert_allclose(scales, sides / sides.max(axis=0), rtol=16 * EPS)
    np.testing.assert_allclose(centres, [bounds_of(body).mean(axis=0) for body in bodies], atol=4 * EPS)
    np.testing.assert_array_equal(model.bounds, [bounds_of(body) for body in bodies])


def test_scattered_nodes_have_frames_too(rng: np.random.Generator) -> None:
    directions = rng.normal(size=(40, 3))
    nodes = ScatteredNodes(directions / np.linalg.norm(directions, axis=1)[:, None], rng.uniform(0.1, 9, 40))
    knots = (np.array([0.5, 1.0, 2.0]),)
    bodies = [block((1, 1, 0), (4, 3, 2), (5, 4, 3), (0.5 * float(k), 0.4, 0.3)) for k in knots[0]]
    model = ShapeModel.fit_bodies(knots, bodies, nodes, frame="bbox", dtype="complex128", eps=1e-10)
    exact = 2.5 * asg.far_field_constant(nodes.wavenumbers, 3) * box_transform((0.6, 0.2, 0.2), nodes.kappa)
    for row in model.predict([[0.5], [0.7], [2.0]]):
        assert relative_error(row, exact) < 1e-9
    with pytest.raises(ArgumentError, match="scattered"):
        _ = model.extent


def test_a_callable_and_given_frames_agree_with_a_rule(tmp_path: Path) -> None:
    knots = (np.linspace(1, 2, 3), np.linspace(1, 2, 11))
    lattice = FourierLattice(Box((2.0, 2.0)), 3)
    bodies = boxes(*knots)
    model = ShapeModel.fit_bodies(knots, bodies, lattice, frame="bbox")
    own = ShapeModel.fit_bodies(knots, bodies, lattice, frame=lambda body: ((0, 0), body.box.lengths))
    whole = ShapeModel.fit_bodies(knots, bodies, lattice, frame=lambda body: Frame((0, 0), body.box.lengths))
    points = model.grid_points
    u = model.predict(points).reshape(3, 11, *lattice.shape)
    frames = tuple(part.reshape(3, 11, 2) for part in model.frames(points))
    given = ShapeModel.fit(knots, u, lattice, frames=frames, bounds=model.bounds)
    query = np.array([[1.3, 1.77]])
    for other in (own, whole, given):
        for a, b in zip(model.frames(query), other.frames(query), strict=True):
            np.testing.assert_allclose(a, b, atol=64 * EPS)
    np.testing.assert_array_equal(own.predict(query), model.predict(query))
    shuffled = np.random.default_rng(3).permutation(33)
    table = ShapeModel.from_table(
        points[shuffled], u.reshape(33, *lattice.shape)[shuffled], lattice,
        frames=[part.reshape(33, 2)[shuffled] for part in frames], bounds=model.bounds.reshape(33, 2, 2)[shuffled],
    )  # fmt: skip
    np.testing.assert_array_equal(table.frames(query), given.frames(query))
    np.testing.assert_array_equal(table.bounds, given.bounds)
    of_bodies = ShapeModel.from_table(points[shuffled], [bodies[i] for i in shuffled], lattice, frame="bbox")
    np.testing.assert_array_equal(of_bodies.frames(query), model.frames(query))
    np.testing.assert_array_equal(of_bodies.predict(query), model.predict(query))


def test_bodies_may_come_once_or_as_often_as_asked() -> None:
    knots = (np.linspace(1, 2, 3),)
    bodies = [VoxelGrid(np.ones((1, 1)), Box((float(e), 1.0))) for e in knots[0]]
    lattice = FourierLattice(Box((2.0, 2.0)), 3)
    passes, counts = [], []

    class Again:
        def __iter__(self) -> Iterator[VoxelGrid]:
            passes.append(1)
            return iter(bodies)

    model = ShapeModel.fit_bodies(knots, bodies, lattice, frame="bbox")
    again = ShapeModel.fit_bodies(
        knots, Again(), lattice, frame="bbox", progress=lambda done, total: counts.append((done, total))
    )
    once = ShapeModel.fit_bodies(knots, iter(bodies), lattice, frame="bbox")
    assert len(passes) == 3  # one of them only to see that it is no iterator
    assert counts == [(k, 6) for k in range(1, 7)]
    for other in (again, once):
        np.testing.assert_array_equal(other.coefficients, model.coefficients)


def test_models_without_frames_have_the_identity() -> None:
    knots = (np.linspace(1, 2, 3),)
    lattice = FourierLattice(Box((2.0, 2.0)), 3)
    model = ShapeModel.fit_bodies(knots, [VoxelGrid(np.ones((1, 1)), Box((1.0, 1.0)))] * 3, lattice)
    assert not model.framed
    centre, scale = model.frames([1.5])
    np.testing.assert_array_equal((centre, scale), ((0, 0), (1, 1)))
    np.testing.assert_array_equal(model.frames([[1.5]], derivative=0), np.zeros((2, 1, 2)))
    assert model.extent == lattice.box
    with pytest.raises(QueryRangeError):
        model.frames([3.0])


def test_frames_have_derivatives_and_tangents() -> None:
    knots = (np.array([0.0, 1.0, 3.0, 4.0]),)
    lattice = FourierLattice(Box((2.0, 2.0)), 1)
    centres, scales = np.array([[0, 1], [2, 3], [-1, 0.5], [0, 0.0]]), np.array([[1, 2], [0.5, 1], [1, 1], [1, 0.2]])
    model = ShapeModel.fit(knots, np.ones((4, *lattice.shape), "complex64"), lattice, frames=(centres, scales))
    step = 1e-6
    slope = np.array(model.frames([2.0], derivative=0))
    difference = (np.array(model.frames([2.0 + step])) - model.frames([2.0 - step])) / (2 * step)
    np.testing.assert_allclose(slope, difference, atol=1e-8)
    end = np.array(model.frames([4.0], derivative=0))
    np.testing.assert_allclose(
        np.array(model.frames([4.1], "linear")), np.array(model.frames([4.0])) + 0.1 * end, atol=1e-14
    )
    with pytest.raises(ArgumentError, match=r"lambdas: query 1 has a frame of scale -\S+ on axis 1"):
        model.frames([[4.0], [9.0]], "linear")


def test_generated_bodies_are_in_metres_and_only_there() -> None:
    """A square that moves and grows, learned in its frame from three knots; no periodic copies on a far wider grid."""
    knots = (np.array([0.0, 1.0, 2.0]),)
    lattice = FourierLattice(Box((1.2, 1.2)), 24)

    def square(at: float) -> Polygons:
        side, middle = 0.5 + 0.25 * at, np.array([3 * at, -at])
        return Polygons([middle + side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])])

    model = ShapeModel.fit_bodies(knots, [square(float(k)) for k in knots[0]], lattice, frame="height")
    np.testing.assert_allclose(model.extent.lengths, (13.2, 5.2), rtol=1e-12)
    grid = Grid.from_axes([np.linspace(-4, 8, 601), np.linspace(-4, 3, 351)])
    for at, field in zip((0.5, 1.7), model.generate([[0.5], [1.7]], grid), strict=True):
        surface = asg.extract_surface(field, grid)
        assert surface.quality.components == 1
        # The corner of a band-limited square is rounded; half a wavelength is 25 mm in y.
        np.testing.assert_allclose(surface.bounds, square(at).bounds, atol=0.01)
        outside = np.abs(grid.axes[0] - 3 * at) > 0.6 * (0.5 + 0.25 * at)
        assert not field[outside].any()


@pytest.mark.parametrize("batch", [1, 2, 3, 7])
def test_batches_with_frames_of_their_own(opencl: Backend, batch: int) -> None:
    knots = (np.linspace(1, 2, 3), np.linspace(1, 2, 3))
    lattice = FourierLattice(Box((2.0, 2.0)), (5, 4))
    model = ShapeModel.fit_bodies(knots, boxes(*knots), lattice, frame="bbox", backend=opencl)
    queries = np.random.default_rng(1).uniform(1, 2, (5, 2))
    grid = Grid(Box((2.5, 2.0)), (21, 20))
    seen = []
    fields = model.generate(queries, grid, batch=batch, progress=lambda done, total: seen.append(done))
    assert seen[-1] == 5
    frames = [Frame(c.tolist(), s.tolist()) for c, s in zip(*model.frames(queries), strict=True)]
    expected = asg.synthesize(model.predict(queries), lattice, grid, frame=frames, backend="reference")
    np.testing.assert_allclose(fields, expected, atol=1e-6)
    np.testing.assert_array_equal(model.generate(queries[3], grid), model.generate(queries[3:4], grid)[0])


@pytest.mark.parametrize("counts", [(3, 4), (3, 11)])
def test_framed_models_are_saved_to_the_bit(tmp_path: Path, counts: tuple[int, int]) -> None:
    knots = tuple(np.linspace(1, 2, n) for n in counts)
    lattice = FourierLattice(Box((2.0, 2.0)), 3)
    model = ShapeModel.fit_bodies(knots, boxes(*knots), lattice, frame="moments")
    again = ShapeModel.load(model.save(tmp_path / "model.npz"))
    queries = np.random.default_rng(2).uniform(1, 2, (9, 2))
    assert again.framed
    np.testing.assert_array_equal(again.frames(queries), model.frames(queries))
    np.testing.assert_array_equal(again.predict(queries), model.predict(queries))
    np.testing.assert_array_equal(again.bounds, model.bounds)
    grid = Grid(lattice.box, 15)
    np.testing.assert_array_equal(again.generate(queries, grid), model.generate(queries, grid))
    u = model.predict(model.grid_points).reshape(*counts, *lattice.shape)
    plain = ShapeModel.load(ShapeModel.fit(knots, u, lattice).save(tmp_path / "plain.npz"))
    assert not plain.framed
    assert plain.bounds is None


# Boxes and orders per axis, finer grids


def test_an_ellipsoid_in_a_human_like_box_through_a_model() -> None:
    """Sides 1.6 × 0.8 × 2.2 and orders 21 : 11 : 30, at a third: every axis keeps its own."""
    lattice = FourierLattice(Box((1.6, 0.8, 2.2)), (7, 4, 10))
    assert lattice.shape == (15, 9, 21)
    exact = asg.far_field_constant(lattice.wavenumbers, 3) * ellipsoid_transform((0.6, 0.3, 0.9), lattice.kappa)
    # The spline of a constant is that constant.
    knots = (np.linspace(0, 1, 3),)
    model = ShapeModel.fit(
        knots, np.stack([exact] * 3), lattice, frames=(np.zeros((3, 3)), np.array([[0.5] * 3, [0.75] * 3, [1.0] * 3]))
    )
    grid = Grid(lattice.box, (48, 24, 66))
    field = model.generate([0.5], grid)
    inside = ((grid.points() / (0.75 * np.array([0.6, 0.3, 0.9]))) ** 2).sum(axis=-1) < 1
    # Truncated at N: a shell of half a cell of the band, 0.06 m of 0.4 m, is uncertain.
    assert asg.metrics.iou(field > 0.5, inside) > 0.9
    thin = np.argwhere(field > 0.5)
    assert np.all(np.ptp(thin, axis=0) < np.array([48, 24, 66]) - 2)


def test_synthesis_on_a_grid_far_finer_than_the_training_grid() -> None:
    """A body of 39³ cells, learned at order 19 (39³ nodes), comes out at 300³ (here its middle slab): same function."""
    lattice = FourierLattice(Box((2.2, 2.2, 2.2)), 19)
    ball = asg.voxelize(asg.bodies.ball(0.7), Grid(lattice.box, 39))
    model = ShapeModel.fit_bodies([[0, 1]], [ball, ball], lattice)
    fine = Grid(lattice.box, 300)
    slab = Grid.from_axes([fine.axes[0], fine.axes[1][148:152], fine.axes[2]])
    field = model.generate([0.5], slab)
    assert field.shape == (300, 4, 300)
    # On points that both grids have (300 = 3·100), one function.
    coarse = Grid.from_axes([slab.axes[0][1::3], slab.axes[1], slab.axes[2][1::3]])
    np.testing.assert_allclose(field[1::3, :, 1::3], model.generate([0.5], coarse), atol=2e-5)
    radius = np.hypot(*np.meshgrid(slab.axes[0], slab.axes[2], indexing="ij"))
    assert asg.metrics.iou(field[:, 2] > 0.5, radius < 0.7) > 0.97  # cells of 56 mm along 4.4 m of edge


@pytest.mark.slow
def test_300_cubed() -> None:
    lattice = FourierLattice(Box((2.2, 2.2, 2.2)), 19)
    ball = asg.voxelize(asg.bodies.ball(0.7), Grid(lattice.box, 39))
    model = ShapeModel.fit_bodies([[0, 1]], [ball, ball], lattice)
    grid = Grid(lattice.box, 300)
    field = model.generate([0.5], grid)
    assert asg.metrics.iou(field > 0.5, asg.voxelize(asg.bodies.ball(0.7), grid).values) > 0.96


# Faults


SQUARE = VoxelGrid(np.ones((1, 1)), Box((1.0, 1.0)))
PLANE = FourierLattice(Box((1.0, 1.0)), 2)
CUBE = asg.bodies.cuboid(1, 1, 1)
OPEN = TriangleMesh(CUBE.vertices, CUBE.faces[1:])
INWARD = TriangleMesh(CUBE.vertices, CUBE.faces[:, ::-1])


def fit(*bodies: object, frame: object = "bbox", lattice: FourierLattice = PLANE, **options: object) -> ShapeModel:
    return ShapeModel.fit_bodies([[0, 1]], bodies, lattice, frame=frame, names=["a"], **options)  # type: ignore[arg-type]


def given(centres: object, scales: object, **options: object) -> ShapeModel:
    u = np.ones((2, *PLANE.shape), dtype="complex64")
    return ShapeModel.fit([[0, 1]], u, PLANE, frames=(centres, scales), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: fit(SQUARE, SQUARE, frame="width"), ArgumentError, "frame: is 'width'; give one of 'height', 'bbox'"),
        (lambda: fit(SQUARE, SQUARE, frame=3), ArgumentError, "frame: is 3"),
        (lambda: fit(SQUARE, 3), DtypeError, r"bodies\[1\] \(a=1\): body is a int"),
        (lambda: fit(SQUARE), ShapeError, "bodies: has 1 entries"),
        (lambda: fit(SQUARE, SQUARE, SQUARE), ShapeError, "more than 2"),
        (
            lambda: fit(SQUARE, VoxelGrid(np.zeros((2, 2)), Box((1, 1)))),
            ArgumentError,
            r"bodies\[1\] \(a=1\): values are zero everywhere",
        ),
        (
            lambda: fit(SQUARE, VoxelGrid(np.ones((5, 2, 2)), Box((1, 1)))),
            ShapeError,
            r"bodies\[1\] \(a=1\): body is a batch of shape \(5,\)",
        ),
        (
            lambda: fit(SQUARE, VoxelGrid(np.array([[1, np.nan]]), Box((1, 1)))),
            NonFiniteError,
            r"bodies\[1\] \(a=1\): values is nan at index \(0, 1\)",
        ),
        (lambda: fit(CUBE, CUBE), ShapeError, r"bodies\[0\] \(a=0\): is 3-D, the nodes are 2-D"),
        (lambda: fit(OPEN, CUBE, frame="moments"), MeshError, r"bodies\[0\] \(a=0\): body is an open mesh"),
        (lambda: fit(INWARD, CUBE, frame="moments"), MeshError, r"bodies\[0\] \(a=0\): body encloses -1"),
        (
            lambda: fit(SQUARE, VoxelGrid(np.ones((1, 1)), Box((1.0, 1.1)))),
            OutsideBoxError,
            r"bodies\[0\] \(a=0\): reaches from -0\.55 to 0\.55 m on axis 1 of its frame, .* ±0\.5 m; use a larger box",
        ),
        (
            lambda: fit(SQUARE, SQUARE, frame=lambda body: ((0.1, 0), 1)),
            OutsideBoxError,
            r"bodies\[0\] \(a=0\): reaches from -0\.6 to 0\.4 m on axis 0",
        ),
        (lambda: fit(SQUARE, SQUARE, frame=lambda body: None), DtypeError, r"a=0\): frame gave a NoneType"),
        (lambda: fit(SQUARE, SQUARE, frame=lambda body: (1, 2, 3)), DtypeError, r"a=0\): frame gave a tuple"),
        (lambda: fit(SQUARE, SQUARE, frame=lambda body: ((0, 0), 0)), ArgumentError, "gave a scale that is 0.0"),
        (lambda: fit(SQUARE, SQUARE, frame=lambda body: ((0, 0, 0), 1)), ShapeError, "gave a 3-D frame"),
        (lambda: given(np.zeros((2, 3)), np.ones((2, 2))), ShapeError, r"frames: centres: has shape \(2, 3\)"),
        (
            lambda: given(np.zeros((2, 2)), np.array([[1, 1], [1, 0]])),
            ArgumentError,
            r"scales: is 0.0 at index \(1, 1\)",
        ),
        (lambda: given(np.full((2, 2), np.nan), np.ones((2, 2))), NonFiniteError, "frames: centres: is nan"),
        (lambda: given(np.zeros((2, 2)), np.ones((2, 2)), bounds=np.ones((2, 2))), ShapeError, "bounds: has shape"),
        (
            lambda: ShapeModel.fit([[0, 1]], np.ones((2, 5, 5), "complex64"), PLANE, frames=np.ones((2, 2, 2))),
            ShapeError,
            "frames: is not a pair",
        ),
        (
            lambda: ShapeModel.from_table(
                [[0.0], [1.0]], np.ones((2, 5, 5), "complex64"), PLANE, frames=(np.zeros((3, 2)), np.ones((3, 2)))
            ),
            ShapeError,
            r"frames: has shape \(3, 2\); give 2 rows",
        ),
    ],
)
def test_faults(call: Callable[[], object], error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        call()


def test_a_forged_frame_in_a_file_is_refused(tmp_path: Path) -> None:
    from accel_shapegen.errors import ModelFileError

    model = fit(SQUARE, SQUARE)
    for name, array in (
        ("frame_coefficients", np.ones((2, 2, 3))),
        ("frame_coefficients", np.full((2, 2, 2), np.inf)),
        ("bounds", np.ones((2, 2, 2), dtype=np.float32)),
    ):
        forged = ShapeModel(
            model.axes, model.coefficients, model.nodes,
            **{"frame_coefficients": model.frame_coefficients, "bounds": model.bounds, name: array},
        )  # fmt: skip
        with pytest.raises(ModelFileError, match=name):
            ShapeModel.load(forged.save(tmp_path / "forged.npz"))


# Command line


def test_train_in_frames_and_generate_in_metres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import json

    from accel_shapegen import cli

    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "reference")
    monkeypatch.chdir(tmp_path)
    words = ["train", "--family", "rectangle", "--grid", "e0=1:2:3", "--grid", "e1=1:2:3", "--box", "3", "--order", "8"]
    assert cli.main([*words, "--frame", "bbox", "--out", "framed.npz", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frame"] == "bbox"
    assert told["adequacy"]["framed"]
    assert told["adequacy"]["warnings"] == []
    assert told["adequacy"]["leave_one_out"][0]["worst"] < 1e-6
    assert cli.main([*words, "--out", "plain.npz"]) == 0
    out = capsys.readouterr().out
    assert "Leave-one-out error" in out
    assert "Warning: e0: between (e0=1, e1=1) and (e0=1.5, e1=1) a face of the bounding box moves by 0.25 m" in out
    assert ShapeModel.load("framed.npz").framed
    assert not ShapeModel.load("plain.npz").framed
    assert cli.main(["generate", "framed.npz", "--at", "e0=1.9,e1=1.2", "--grid", "60", "--json"]) == 0
    extent = json.loads(capsys.readouterr().out)["bodies"][0]["surface"]["extent_m"]
    np.testing.assert_allclose(extent, (1.9, 1.2), rtol=0.03)
    # Errors of frames name the body as the family does.
    assert cli.main([*words, "--frame", "bbox", "--box", "1.8", "--out", "small.npz"]) != 0
    assert "e0=1, e1=1" in capsys.readouterr().err
