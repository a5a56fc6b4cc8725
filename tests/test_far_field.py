"""Far fields against closed forms, physical identities, and every device against the reference."""

from __future__ import annotations

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import Box, FourierLattice, Frame, Grid, Polygons, ScatteredNodes, VoxelGrid, far_field_constant
from accel_shapegen.backends.base import Backend
from accel_shapegen.errors import (
    ArgumentError,
    BackendError,
    DtypeError,
    MeshError,
    NonFiniteError,
    OutsideBoxError,
    ShapeError,
)
from accel_shapegen.testing import box_transform, dot_test, ellipsoid_transform, off_centre, relative_error

LATTICES = {
    2: FourierLattice(Box((2.2, 3.1)), (6, 9), mu=0.5),
    3: FourierLattice(Box((2.2, 1.7, 2.9)), (5, 4, 6), mu=0.01),
}
# Sums of a few thousand rounded terms: errors grow like the square root of their number, tens of eps at most.
CLOSED_FORM = 100 * np.finfo(float).eps
# What the issue of a backend's life is: float32 and float64 against the reference, zero slot apart.
BACKEND = {"complex64": 2e-6, "complex128": 1e-12}


def scattered(dim: int, count: int, reach: float, rng: np.random.Generator) -> ScatteredNodes:
    directions = rng.normal(size=(count, dim))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return ScatteredNodes(directions, reach * rng.uniform(0.01, 1, size=count))


def nodes_of(kind: str, dim: int, rng: np.random.Generator):
    return LATTICES[dim] if kind == "lattice" else scattered(dim, 57, 40.0, rng)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_voxels_that_fill_a_box_are_that_box(dim: int, kind: str, rng: np.random.Generator) -> None:
    nodes = nodes_of(kind, dim, rng)
    box = Box((1.0, 1.5, 1.2)[:dim])
    shape = (5, 6, 4)[:dim]
    values = np.zeros(shape)
    values[(slice(1, 4),) * dim] = 2.0
    corner = [a / n for a, n in zip(box.lengths, shape, strict=True)]
    sides = [3 * h for h in corner]
    centre = [-a / 2 + 2.5 * h for a, h in zip(box.lengths, corner, strict=True)]
    exact = 2 * far_field_constant(nodes.wavenumbers, dim) * box_transform(sides, nodes.kappa, centre)
    u = asg.far_field(VoxelGrid(values, box), nodes, dtype="complex128", backend="reference")
    assert u.shape == nodes.shape
    assert relative_error(u, exact) < CLOSED_FORM


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_polygons_against_closed_forms(kind: str, rng: np.random.Generator) -> None:
    nodes = nodes_of(kind, 2, rng)
    constant = far_field_constant(nodes.wavenumbers, 2)
    rectangle = np.array([[-0.3, -0.4], [0.5, -0.4], [0.5, 0.1], [-0.3, 0.1]])
    exact = constant * box_transform((0.8, 0.5), nodes.kappa, (0.1, -0.15))
    assert relative_error(asg.far_field(Polygons([rectangle]), nodes, dtype="complex128"), exact) < CLOSED_FORM
    # An inscribed n-gon of a disk is off by O(1/n²): 1 - area ratio is 2π²/(3n²).
    t = 2 * np.pi * np.arange(2048) / 2048
    disk = 0.6 * np.stack([np.cos(t), np.sin(t)], axis=1)
    exact = constant * ellipsoid_transform((0.6, 0.6), nodes.kappa)
    error = relative_error(asg.far_field(Polygons([disk]), nodes, dtype="complex128"), exact)
    assert error < 4 * 2 * np.pi**2 / (3 * 2048**2)
    ring = Polygons([disk, rectangle[::-1]])
    both = asg.far_field(Polygons([disk]), nodes, dtype="complex128") - asg.far_field(
        Polygons([rectangle]), nodes, dtype="complex128"
    )
    assert relative_error(asg.far_field(ring, nodes, dtype="complex128"), both) < CLOSED_FORM


def test_polygon_at_vanishing_wavenumbers_is_its_area() -> None:
    triangle = np.array([[1.0, 1.0], [1.5, 1.0], [1.0, 1.4]])
    k = np.array([1e-12, 1e-8, 1e-5])
    nodes = ScatteredNodes(np.tile([0.6, 0.8], (3, 1)), k)
    u = asg.far_field(Polygons([triangle]), nodes, dtype="complex128") / far_field_constant(k, 2)
    # The body is within 2 m of the origin, so the integral differs from the area by at most 2k.
    np.testing.assert_allclose(u, 0.1, rtol=1e-14, atol=0.1 * 2e-5)
    np.testing.assert_allclose(u[0], 0.1, rtol=1e-11)


def test_voxels_converge_to_a_ball() -> None:
    lattice = FourierLattice(Box((2.0, 2.0, 2.0)), 4)
    exact = far_field_constant(lattice.wavenumbers, 3) * ellipsoid_transform((0.7, 0.8, 0.6), lattice.kappa)
    errors = []
    for n in (20, 40, 80):
        grid = Grid(lattice.box, n)
        inside = ((grid.points() / (0.7, 0.8, 0.6)) ** 2).sum(axis=-1) < 1
        u = asg.far_field(VoxelGrid(inside, lattice.box), lattice, dtype="complex128", backend="reference")
        errors.append(relative_error(off_centre(u, lattice.zero_slot), off_centre(exact, lattice.zero_slot)))
    # A voxelised boundary is rough at the scale of h; its transform converges at least linearly.
    assert errors[1] < errors[0] * 0.7
    assert errors[2] < errors[1] * 0.7
    assert errors[2] < 0.02


@pytest.mark.parametrize("dim", [2, 3])
def test_identities(dim: int, rng: np.random.Generator) -> None:
    lattice = LATTICES[dim]
    box = Box((1.0, 0.9, 1.1)[:dim])
    a, b = rng.normal(size=(2, *(7, 4, 5)[:dim]))

    def transform(values, **options):
        return asg.far_field(VoxelGrid(values, box), lattice, dtype="complex128", backend="reference", **options)

    u = transform(a)
    assert relative_error(transform(2 * a - 3 * b), 2 * u - 3 * transform(b)) < CLOSED_FORM
    # The integral at -κ is the conjugate of that at κ: pack checks it and unpack restores it.
    assert relative_error(lattice.unpack(lattice.pack(u)), u) < CLOSED_FORM
    # y = x - c: a shift is a phase.
    shift = (0.1, -0.2, 0.15)[:dim]
    moved = transform(a, frame=Frame(shift, 1.0))
    assert relative_error(moved, u * np.exp(1j * lattice.kappa @ np.array(shift))) < CLOSED_FORM
    # y = x / s: in the frame the body is smaller, so û(κ) = û_x(κ/s)/Π s.
    scale = (2.0, 1.5, 1.25)[:dim]
    shrunk = transform(a, frame=Frame((0.0,) * dim, scale))
    small = VoxelGrid(a, Box(tuple(a / s for a, s in zip(box.lengths, scale, strict=True))))
    assert relative_error(shrunk, asg.far_field(small, lattice, dtype="complex128", backend="reference")) < CLOSED_FORM


def test_frames_of_scattered_nodes_and_polygons(rng: np.random.Generator) -> None:
    nodes = scattered(2, 31, 20.0, rng)
    frame = Frame((0.2, -0.1), (0.5, 2.0))
    ring = np.array([[-0.3, -0.4], [0.5, -0.4], [0.5, 0.1], [-0.3, 0.1]])
    voxels = VoxelGrid(np.ones((4, 5)), Box((0.8, 0.5)))
    exact = far_field_constant(nodes.wavenumbers, 2) * box_transform((1.6, 0.25), nodes.kappa, (-0.2 / 0.5, 0.1 / 2))
    u = asg.far_field(voxels, nodes, frame=frame, dtype="complex128", backend="reference")
    assert relative_error(u, exact) < CLOSED_FORM
    centred = Polygons([ring - (0.1, -0.15)])
    assert relative_error(asg.far_field(centred, nodes, frame=frame, dtype="complex128"), exact) < CLOSED_FORM


@pytest.mark.parametrize("dtype", ["complex64", "complex128"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_opencl_is_the_reference(opencl: Backend, kind: str, dim: int, dtype: str, rng: np.random.Generator) -> None:
    nodes = nodes_of(kind, dim, rng)
    body = VoxelGrid(rng.normal(size=(3, *(17, 19, 24)[:dim])), Box((2.0, 1.6, 2.5)[:dim]))
    eps = 1e-6 if dtype == "complex64" else 1e-12
    u = asg.far_field(body, nodes, dtype=dtype, eps=eps, backend=opencl)
    exact = asg.far_field(body, nodes, dtype="complex128", backend="reference")
    assert u.dtype == dtype
    if kind == "lattice":
        zero = nodes.zero_slot
        assert relative_error(off_centre(u, zero), off_centre(exact, zero)) < BACKEND[dtype]
        assert relative_error(u[(..., *zero)], exact[(..., *zero)]) < 10 * BACKEND[dtype]
    else:
        assert relative_error(u, exact) < 3 * eps


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_plan_and_adjoint(opencl: Backend, kind: str, dim: int, rng: np.random.Generator) -> None:
    nodes = nodes_of(kind, dim, rng)
    grid = Grid(Box((2.0, 1.6, 2.5)[:dim]), (8, 5, 9)[:dim])
    plan = asg.plan_far_field(grid, nodes, batch=2, dtype="complex128", eps=1e-10, backend=opencl)
    assert plan.device == opencl.info.label
    values = rng.normal(size=(5, *grid.shape))  # two and a half batches
    u = rng.normal(size=(5, *nodes.shape)) + 1j * rng.normal(size=(5, *nodes.shape))
    applied, back = plan.apply(values), plan.adjoint(u)
    assert dot_test(applied, u, values, back) < CLOSED_FORM
    out = np.empty_like(applied)
    assert plan.apply(values, out=out) is out
    np.testing.assert_array_equal(out, applied)
    np.testing.assert_array_equal(plan.apply(values[3]), applied[3])


def test_bodies_in_a_list_and_in_a_batch_are_the_same(rng: np.random.Generator) -> None:
    lattice = LATTICES[3]
    values = rng.normal(size=(4, 5, 6, 7))
    box, other = Box((1.0, 1.0, 1.0)), Box((0.5, 1.0, 1.0))
    bodies = [VoxelGrid(v, b) for v, b in zip(values, [box, box, other, box], strict=True)]
    together = asg.far_field(bodies, lattice)
    for row, body in zip(together, bodies, strict=True):
        np.testing.assert_array_equal(row, asg.far_field(body, lattice))
    batch = asg.far_field(VoxelGrid(values.reshape(2, 2, 5, 6, 7), box), lattice)
    assert batch.shape == (2, 2, *lattice.shape)
    np.testing.assert_array_equal(batch[0, 1], together[1])
    per_body = asg.far_field(bodies[:2], lattice, frame=[Frame((0.1, 0, 0), 1.0), Frame((0, 0, 0), 2.0)])
    np.testing.assert_array_equal(per_body[1], asg.far_field(bodies[1], lattice, frame=Frame((0, 0, 0), 2.0)))


def test_integers_and_booleans_are_converted() -> None:
    lattice = LATTICES[2]
    ones = np.ones((4, 3))
    expected = asg.far_field(VoxelGrid(ones, Box((1, 1))), lattice)
    for dtype in (bool, np.uint8, np.int64, np.float32):
        np.testing.assert_array_equal(asg.far_field(VoxelGrid(ones.astype(dtype), Box((1, 1))), lattice), expected)


L2, L3 = LATTICES[2], LATTICES[3]
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: asg.far_field(np.ones((3, 3)), L2), DtypeError, "body: is a ndarray"),
        (lambda: asg.far_field([], L2), ShapeError, "body: is an empty list"),
        (lambda: asg.far_field([3], L2), DtypeError, "body: is a int"),
        (lambda: asg.far_field(VoxelGrid(np.ones((3, 3)), Box((1, 1))), L3), ShapeError, "nodes: is 3-D"),
        (lambda: asg.far_field(VoxelGrid(np.ones((3, 3)), Box((1, 1))), "L"), DtypeError, "nodes: is a str"),
        (lambda: asg.far_field(VoxelGrid(np.ones((3, 3)), Box((9, 1))), L2), OutsideBoxError, "axis 0.*outside"),
        (lambda: asg.far_field(VoxelGrid(np.ones((3, 3)), Box((1, 1))), L2, dtype="float32"), DtypeError, "dtype"),
        (lambda: asg.far_field(VoxelGrid(np.ones((3, 3)), Box((1, 1))), L2, eps=0), ArgumentError, "eps: is 0"),
        (lambda: asg.far_field(VoxelGrid([[1.0, np.nan]], Box((1, 1))), L2), NonFiniteError, r"values.*nan at index"),
        (lambda: asg.far_field(VoxelGrid([[1e300]], Box((1, 1))), L2), NonFiniteError, "once converted to float32"),
        (
            lambda: asg.far_field(VoxelGrid(np.ones((3, 3)), Box((1, 1))), L2, backend="cuda"),
            BackendError,
            "'cuda' is not",
        ),
        (lambda: asg.far_field(Polygons([SQUARE]), L2, eps=1e-9, backend="opencl"), ArgumentError, "eps: is 1e-09"),
        (lambda: asg.far_field(Polygons([SQUARE[::-1]]), L2), MeshError, "area -1"),
        (lambda: asg.far_field(Polygons([SQUARE * 4]), L2), OutsideBoxError, "body: reaches from 0 to 4"),
        (lambda: asg.far_field(asg.bodies.cuboid(1, 1, 3), L3), OutsideBoxError, "body: reaches from -1.5 to 1.5"),
        (lambda: asg.far_field(Polygons([SQUARE]), L2, frame=Frame((0, 0, 0), 1)), ShapeError, "frame"),
        (lambda: asg.far_field([Polygons([SQUARE])], L2, frame=[]), ShapeError, "frame: has 0 entries"),
        (
            lambda: asg.plan_far_field(Grid.from_axes([[0, 1, 3], [0, 1]]), L2),
            ArgumentError,
            "grid: is not equidistant",
        ),
        (lambda: asg.plan_far_field("grid", L2), DtypeError, "grid: is a str"),
        (lambda: asg.plan_far_field(Grid(Box((1, 1)), 3), L2, batch=0), ArgumentError, "batch: is 0"),
        (lambda: asg.plan_far_field(Grid(Box((1, 1)), 3), L2).apply(np.ones((3, 4))), ShapeError, "values: has shape"),
        (lambda: asg.plan_far_field(Grid(Box((1, 1)), 3), L2).apply(np.ones((0, 3, 3))), ShapeError, "empty batch"),
        (
            lambda: asg.plan_far_field(Grid(Box((1, 1)), 3), L2).apply(np.ones((3, 3)) * 1j),
            DtypeError,
            "values: has dtype",
        ),
        (
            lambda: asg.plan_far_field(Grid(Box((1, 1)), 3), L2).apply(np.ones((3, 3)), out=np.ones(L2.shape)),
            DtypeError,
            "out: is float64",
        ),
    ],
)
def test_bad_input(call, error, message) -> None:
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("backend", ["opencl", "reference"])
def test_out_that_overlaps_the_input_is_refused(backend: str, rng: np.random.Generator) -> None:
    """With a batch of one, the first result would overwrite the second body before it is read."""
    plan = asg.plan_far_field(Grid(Box((1, 1)), 8), L2, dtype="complex128", backend=backend)
    store = np.zeros(2**13)
    values = store[:256].reshape(4, 8, 8)
    values[...] = rng.normal(size=values.shape)
    out = store[64 : 64 + 2 * 4 * L2.size].view(np.complex128).reshape(4, *L2.shape)
    with pytest.raises(ArgumentError, match="out: shares memory with the input"):
        plan.apply(values, out=out)


def test_a_far_point_outside_the_box_does_not_loosen_the_others(opencl: Backend, rng: np.random.Generator) -> None:
    """Nearly symmetric points may be folded only within rounding of the points that count."""
    half = np.array([0.1, 0.3, 0.55, 0.8])
    inner = np.concatenate([-half[::-1], half + 1e-9])
    grid = Grid.from_axes([[-1e9, *inner, 1e9], inner])
    u = rng.normal(size=L2.shape) + 1j * rng.normal(size=L2.shape)
    field, exact = (asg.synthesize(u, L2, grid, backend=backend) for backend in (opencl, "reference"))
    assert relative_error(field, exact) < 1e-12


def test_masked_generators_are_refused() -> None:
    masked = np.ma.masked_array(np.ones(L2.shape, complex), mask=True)
    for call in (
        asg.fourier_coefficients,
        lambda u, lattice: asg.add_noise(u, 0.1, 0),
        lambda u, lattice: lattice.pack(u),
    ):
        with pytest.raises(ArgumentError, match="u: has masked entries"):
            call(masked, L2)


def test_a_sum_that_overflows_is_an_error(opencl: Backend) -> None:
    body = VoxelGrid(np.full((16, 16), 3e38), Box((1.0, 1.0)))
    with pytest.raises(ArgumentError, match=r"values: overflows complex64 on the way.*complex128"):
        asg.far_field(body, L2, backend=opencl)
    assert np.isfinite(asg.far_field(body, L2, dtype="complex128", backend=opencl)).all()
