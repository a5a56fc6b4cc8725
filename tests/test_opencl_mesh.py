"""`mesh_spread` on every OpenCL device: against the reference, and far fields of awkward bodies at every accuracy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import Box, FourierLattice, Frame, Polygons, ScatteredNodes, TriangleMesh, mesh_transform
from accel_shapegen.backends.base import Backend, MeshSpreadSpec, Surface
from accel_shapegen.errors import ArgumentError, DtypeError, ShapeError
from accel_shapegen.kernel_window import Window
from accel_shapegen.mesh_far_field import MeshFarFieldPlan
from accel_shapegen.quadrature import rules
from accel_shapegen.testing import off_centre, relative_error

LATTICE = FourierLattice(Box((2.2, 2.2, 2.2)), 6)
PLANE = FourierLattice(Box((3.0, 4.0)), (9, 7), mu=0.3)
IDENTITY = Frame((0.0, 0.0, 0.0), 1.0)
# A rotation that puts no face along an axis.
TURN = np.linalg.qr(np.array([[2.0, 1.0, 0.3], [-0.5, 1.5, 1.0], [0.7, -1.0, 1.7]]))[0]
TURN *= np.sign(np.linalg.det(TURN))
ACCURACIES = [("complex64", e) for e in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)] + [
    ("complex128", e) for e in (1e-2, 1e-6, 1e-8, 1e-10)
]


def block(sides: tuple[float, ...], centre: tuple[float, ...] = (0.0, 0.0, 0.0), turn: bool = True) -> TriangleMesh:
    mesh = asg.bodies.cuboid(*sides)
    return TriangleMesh((mesh.vertices @ TURN.T if turn else mesh.vertices) + centre, mesh.faces)


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def inside_out(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])


def fan(corners: int) -> TriangleMesh:
    """A prism over a finely cut rectangle, top and bottom as fans of slivers from one corner."""
    x = np.linspace(-0.5, 0.5, corners // 2)
    ring = np.concatenate([np.stack([x, np.full_like(x, -0.4)], 1), np.stack([x[::-1], np.full_like(x, 0.4)], 1)])
    count = len(ring)
    i = np.arange(1, count - 1)
    top, bottom = np.stack([0 * i, i, i + 1], 1), count + np.stack([0 * i, i + 1, i], 1)
    here, there = np.arange(count), (np.arange(count) + 1) % count
    sides = np.concatenate(
        [np.stack([here, count + here, count + there], 1), np.stack([here, count + there, there], 1)]
    )
    places = [np.column_stack([ring, np.full(count, z)]) for z in (0.3, -0.3)]
    return TriangleMesh(np.concatenate(places) @ TURN.T, np.concatenate([top, bottom, sides]))


BALL = asg.bodies.ball(0.6, subdivisions=2)
BODIES = {
    "huge triangles": block((1.0, 0.5, 1.4), (0.1, -0.2, 0.05), turn=False),
    "turned": block((1.0, 0.5, 1.4)),
    "ball": BALL,
    "slivers": fan(80),
    "a millimetre": block((1e-3, 2e-3, 1.5e-3), (0.3, 0.2, -0.8)),
    "far off centre": block((0.1, 0.2, 0.1), (0.95, 0.9, -0.9)),
    "plate": block((1.0, 1.0, 2e-3)),
    "needle": block((1e-3, 1e-3, 1.5)),
    "cavity": joined(BALL, inside_out(asg.bodies.ball(0.597, subdivisions=2))),
    "components": joined(block((0.2, 0.2, 0.2), (-0.6, -0.5, 0.3)), block((0.3, 0.1, 0.2), (0.6, 0.5, -0.6))),
    "overlap": joined(BALL, block((0.9, 0.9, 0.2))),
}


@cache
def exact(name: str) -> np.ndarray:
    return asg.far_field(BODIES[name], LATTICE, dtype="complex128", backend="reference")


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize(("dtype", "eps"), ACCURACIES)
def test_accuracy_is_met(opencl: Backend, name: str, dtype: str, eps: float) -> None:
    u = asg.far_field(BODIES[name], LATTICE, eps=eps, dtype=dtype, backend=opencl)
    zero = LATTICE.zero_slot
    assert relative_error(off_centre(u, zero), off_centre(exact(name), zero)) < 3 * eps
    assert abs(u[zero] / exact(name)[zero] - 1) < 3 * eps


@pytest.mark.parametrize("name", ["turned", "ball", "a millimetre", "plate"])
@pytest.mark.parametrize(("dtype", "eps"), [("complex64", 1e-3), ("complex64", 1e-6), ("complex128", 1e-10)])
def test_scattered_nodes(opencl: Backend, name: str, dtype: str, eps: float, rng: np.random.Generator) -> None:
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    small, large = np.geomspace(1e-8, 1e-2, 40), rng.uniform(1, 30, 260)
    nodes = ScatteredNodes(directions, np.concatenate([small, large]))
    u = asg.far_field(BODIES[name], nodes, eps=eps, dtype=dtype, backend=opencl)
    right = asg.far_field(BODIES[name], nodes, dtype="complex128", backend="reference")
    # The first are larger and would hide the errors of the others.
    assert relative_error(u[:40], right[:40]) < 3 * eps
    assert relative_error(u[40:], right[40:]) < 3 * eps


def test_all_nodes_at_vanishing_wavenumbers(opencl: Backend) -> None:
    nodes = ScatteredNodes(np.eye(3), [1e-8, 2e-8, 3e-9])
    u = asg.far_field(BALL, nodes, dtype="complex128", eps=1e-10, backend=opencl)
    # ∫ exp(-iκ·y) dy is the volume up to κ; -1/(4π) is the constant.
    np.testing.assert_allclose(u, -BALL.volume / (4 * np.pi), rtol=3e-10)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_spread_is_the_reference(opencl: Backend, reference: Backend, axis: int, dtype: str) -> None:
    real, greatest = np.dtype(dtype), mesh_transform.greatest_kappa(LATTICE)
    eps = 1e-6 if dtype == "float32" else 1e-10
    mesh = BODIES["turned"]
    grid = mesh_transform.smooth_grid(mesh.bounds, greatest, axis, eps, real, 10_000)
    surface = mesh_transform.surface(grid, greatest, mesh.vertices, mesh.faces, eps)
    spec = mesh_transform.spread_spec(grid, real)
    plan = opencl.plan_mesh_spread(spec)
    found, right = plan.forward([surface]), reference.plan_mesh_spread(spec).forward([surface])
    assert found.dtype == real and found.shape == (1, *grid.shape)
    # Rounding of thousands of terms and of polynomials, and their fit, a tenth of the window's error.
    assert np.abs(found - right).max() < (0.5 * eps * 4 + 50 * np.finfo(real).eps) * np.abs(right).max()
    np.testing.assert_array_equal(plan.forward([surface]), found)  # the same bits


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_spread_in_the_plane(opencl: Backend, reference: Backend, axis: int, dtype: str) -> None:
    real, greatest = np.dtype(dtype), mesh_transform.greatest_kappa(PLANE)
    ring = asg.bodies.kite(0.5, 0.6, segments=57).rings[0]
    edges = np.stack([np.arange(57), (np.arange(57) + 1) % 57], axis=1)
    bounds = np.stack([ring.min(axis=0), ring.max(axis=0)])
    grid = mesh_transform.smooth_grid(bounds, greatest, axis, 1e-6, real, 1000)
    surface = mesh_transform.surface(grid, greatest, ring, edges, 1e-6)
    spec = mesh_transform.spread_spec(grid, real)
    found = opencl.plan_mesh_spread(spec).forward([surface])
    right = reference.plan_mesh_spread(spec).forward([surface])
    assert np.abs(found - right).max() < 1e-5 * np.abs(right).max()


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
@pytest.mark.parametrize(("dtype", "eps"), [("complex64", 1e-2), ("complex64", 1e-6), ("complex128", 1e-10)])
def test_polygons_on_the_device(opencl: Backend, kind: str, dtype: str, eps: float, rng: np.random.Generator) -> None:
    directions = rng.normal(size=(80, 2))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    nodes = PLANE if kind == "lattice" else ScatteredNodes(directions, np.geomspace(1e-8, 20, 80))
    hole = 0.3 * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    body = Polygons([asg.bodies.kite(0.5, 0.6, segments=100).rings[0] * 1.5, hole - (0.4, 0.0)])
    right = asg.far_field(body, nodes, dtype="complex128", backend="reference")
    u = asg.far_field(body, nodes, eps=eps, dtype=dtype, backend=opencl)
    assert u.dtype == dtype
    if kind == "lattice":
        zero = nodes.zero_slot
        assert abs(u[zero] / right[zero] - 1) < 3 * eps
        u, right = off_centre(u, zero), off_centre(right, zero)
    # In the plane u∞ grows like 1/√k at small k: compare without the constant.
    scale = np.sqrt(nodes.wavenumbers) if kind == "scattered" else 1.0
    assert relative_error(u * scale, right * scale) < 3 * eps


def test_lists_frames_and_unused_vertices(opencl: Backend) -> None:
    frame = Frame((0.1, -0.2, 0.3), (0.8, 0.9, 1.1))
    stray = TriangleMesh(np.concatenate([BALL.vertices, [[50.0, 0.0, 0.0]]]), BALL.faces)
    bodies = [BALL, BODIES["turned"], stray, BODIES["a millimetre"]]
    together = asg.far_field(bodies, LATTICE, frame=[IDENTITY, frame, IDENTITY, IDENTITY], eps=1e-5, backend=opencl)
    assert together.shape == (4, *LATTICE.shape)
    turned = asg.far_field(bodies[1], LATTICE, frame=frame, dtype="complex128", backend="reference")
    for row, right in zip(together, (exact("ball"), turned, exact("ball"), exact("a millimetre")), strict=True):
        zero = LATTICE.zero_slot
        assert relative_error(off_centre(row, zero), off_centre(right, zero)) < 3e-5


def test_a_body_has_the_same_bits_in_any_batch(opencl: Backend) -> None:
    bodies = [BALL, BODIES["turned"], BALL, BODIES["slivers"], BALL]
    options = {"eps": 1e-5, "dtype": np.dtype("complex64"), "backend": opencl}
    frames = [IDENTITY] * len(bodies)
    in_twos = MeshFarFieldPlan(bodies, LATTICE, frames, batch=2, **options).apply(bodies)
    alone = MeshFarFieldPlan(bodies, LATTICE, frames, batch=1, **options).apply(bodies)
    np.testing.assert_array_equal(in_twos[0], in_twos[4])
    np.testing.assert_array_equal(in_twos, alone)


SPEC = MeshSpreadSpec((20, 21, 22), 2, (Window(6, 2.0),) * 3, rules(3), np.dtype("float32"))
PIECE = Surface(np.full((3, 3), 2.9), np.array([[0, 1, 2]]), np.ones(1), np.zeros(1, dtype=np.uint8))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda plan: plan.forward([PIECE]), ArgumentError, r"surfaces\[0\]: reaches from 2.9 to 2.9 cells on axis 0"),
        (lambda plan: plan.forward([], out=np.empty((0, 20, 21, 22))), DtypeError, "out"),
        (lambda plan: plan.forward([], out=np.empty((1, 20, 21, 22), np.float32)), ShapeError, "out"),
    ],
)
def test_bad_input(opencl: Backend, call, error, message) -> None:
    with pytest.raises(error, match=message):
        call(opencl.plan_mesh_spread(SPEC))


@pytest.mark.slow
def test_a_million_triangles(opencl: Backend) -> None:
    mesh = asg.bodies.cuboid(1.0, 0.5, 1.4)
    vertices, faces = mesh.vertices @ TURN.T, mesh.faces
    for _ in range(8):  # every triangle in four, without merging corners that coincide
        corners = vertices[faces]
        middles = (corners + np.roll(corners, -1, axis=1)) / 2
        (a, b, c), (ab, bc, ca) = np.moveaxis(corners, 1, 0), np.moveaxis(middles, 1, 0)
        split = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
        vertices, faces = np.unique(split.reshape(-1, 3).round(14), axis=0, return_inverse=True)
        faces = faces.reshape(-1, 3)
    assert len(faces) == 786_432
    fine = TriangleMesh(vertices, faces)
    for dtype, eps in (("complex64", 1e-6), ("complex128", 1e-10)):
        u = asg.far_field(fine, LATTICE, eps=eps, dtype=dtype, backend=opencl)
        zero = LATTICE.zero_slot
        assert relative_error(off_centre(u, zero), off_centre(exact("turned"), zero)) < 3 * eps
        assert abs(u[zero] / exact("turned")[zero] - 1) < 3 * eps


@pytest.mark.slow
def test_a_human_body(opencl: Backend, rng: np.random.Generator) -> None:
    mesh, lattice = asg.bodies.human(1.7, 1.0), FourierLattice(Box((2.2, 2.2, 2.2)), 19)
    right = asg.far_field(mesh, lattice, dtype="complex128", backend="reference")
    for dtype, eps, bound in (("complex64", 1e-6, 3e-6), ("complex128", 1e-6, 1e-6), ("complex128", 1e-10, 3e-10)):
        u = asg.far_field(mesh, lattice, eps=eps, dtype=dtype, backend=opencl)
        assert relative_error(off_centre(u, lattice.zero_slot), off_centre(right, lattice.zero_slot)) < bound
