"""Meshes as exact bodies: the oracle against closed forms, quadrature rules, and what `far_field` refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import Box, FourierLattice, Frame, ScatteredNodes, TriangleMesh, far_field_constant, quadrature
from accel_shapegen.backends.base import Backend
from accel_shapegen.errors import ArgumentError, DtypeError, MeshError, OutsideBoxError, ShapeError
from accel_shapegen.mesh_far_field import MeshFarFieldPlan, far_field_vertex_gradient
from accel_shapegen.testing import box_transform, ellipsoid_transform, off_centre, relative_error

LATTICE = FourierLattice(Box((2.2, 1.7, 2.9)), (4, 3, 5), mu=0.01)
# Sums of a few thousand rounded terms, and quadrature to 2e-13 of ∮ |n| dS.
CONVERGED = 2e-13
IDENTITY = Frame((0.0, 0.0, 0.0), 1.0)


def scattered(count: int, reach: float, rng: np.random.Generator) -> ScatteredNodes:
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return ScatteredNodes(directions, np.geomspace(1e-8, reach, count))


@pytest.mark.parametrize("corners", [2, 3])
def test_rules_are_exact_up_to_their_degree(corners: int) -> None:
    for rule in quadrature.rules(corners, 8 if corners == 3 else 6):
        assert np.all(rule.weights > 0) and np.all(rule.points > 0)
        for p in range(rule.degree + 1):
            for q in range(rule.degree + 1 - p):
                # The mean of a^p b^q over a simplex: (d-1)! p! q! / (p + q + d - 1)! with d corners.
                exact = math.factorial(corners - 1) * math.factorial(p) * math.factorial(q)
                exact /= math.factorial(p + q + corners - 1)
                found = rule.weights @ (rule.points[:, 0] ** p * rule.points[:, 1] ** q)
                assert abs(found - exact) < 1e-14  # digits of the printed rules, and rounding


@pytest.mark.parametrize("corners", [2, 3])
def test_error_constants_bound_the_error(corners: int) -> None:
    for rule in quadrature.rules(corners, 8 if corners == 3 else 6):
        phases = np.geomspace(0.05, quadrature.LARGEST_PHASE, 24)
        errors = np.array([rule.error(phase) for phase in phases])
        ratios = errors / (rule.constant * phases ** (rule.degree + 1))
        seen = errors > 1e-12  # below, it is rounding
        assert ratios[seen].max() <= 1
        # Near its rounding the bound cannot be seen to be tight.
        assert ratios[seen].max() > 0.9 or rule.degree >= 13


def test_large_pieces_are_halved_and_nothing_is_lost() -> None:
    mesh = asg.bodies.cuboid(1.0, 0.5, 1.4)
    greatest = np.full(3, 60.0)
    pieces = quadrature.choose(mesh.vertices, mesh.faces, quadrature.rules(3), greatest, 1e-9, None)
    assert len(pieces.simplices) > 200
    assert TriangleMesh(pieces.vertices, pieces.simplices).volume == pytest.approx(0.7, rel=1e-14)
    middles = np.concatenate(pieces.parents)
    np.testing.assert_allclose(pieces.vertices[8:], pieces.vertices[middles].mean(axis=1), atol=1e-15)


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_reference_cuboid_in_closed_form(kind: str, rng: np.random.Generator) -> None:
    nodes = LATTICE if kind == "lattice" else scattered(61, 60.0, rng)
    mesh, centre = asg.bodies.cuboid(1.0, 0.5, 1.4), np.array([0.1, -0.2, 0.3])
    u = asg.far_field(TriangleMesh(mesh.vertices + centre, mesh.faces), nodes, dtype="complex128", backend="reference")
    exact = far_field_constant(nodes.wavenumbers, 3) * box_transform((1.0, 0.5, 1.4), nodes.kappa, centre)
    np.testing.assert_allclose(u, exact, atol=CONVERGED * np.abs(exact).max(), rtol=0)
    if kind == "scattered":
        # κ → 0 is no special case.
        np.testing.assert_allclose(u[:20], exact[:20], rtol=1e-14)


def test_reference_ball_converges_to_the_ball() -> None:
    exact = far_field_constant(LATTICE.wavenumbers, 3) * ellipsoid_transform((0.6,) * 3, LATTICE.kappa)
    errors = []
    for subdivisions in (2, 3, 4):
        ball = asg.bodies.ball(0.6, subdivisions=subdivisions)
        errors.append(relative_error(asg.far_field(ball, LATTICE, dtype="complex128", backend="reference"), exact))
    # A mesh inscribed with edges e is off by O(e²).
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_reference_subdivided_is_the_same(rng: np.random.Generator) -> None:
    mesh = asg.bodies.ball(0.5, subdivisions=1)
    a, b, c = mesh.faces.T
    middles = [(mesh.vertices[p] + mesh.vertices[q]) / 2 for p, q in ((a, b), (b, c), (c, a))]
    ab, bc, ca = (len(mesh.vertices) + len(a) * i + np.arange(len(a)) for i in range(3))
    faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    fine = (np.concatenate([mesh.vertices, *middles]), faces)
    backend = asg.backends.get("reference")
    kappa = rng.uniform(-50, 50, (40, 3))
    coarse = backend.mesh_transform(mesh.vertices, mesh.faces, kappa)
    np.testing.assert_allclose(backend.mesh_transform(*fine, kappa), coarse, atol=CONVERGED * mesh.volume, rtol=0)


def test_both_reference_sums_agree() -> None:
    mesh, backend = asg.bodies.ball(0.5, subdivisions=1), asg.backends.get("reference")
    axes = [np.array([-3.0, 0.0, 20.0]), np.array([0.0, 1.0]), np.array([-40.0, 0.0, 2.0, 30.0])]
    together = backend.mesh_transform_tensor(mesh.vertices + 0.2, mesh.faces, axes)
    kappa = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    nonzero = (kappa != 0).any(axis=-1)
    single = backend.mesh_transform(mesh.vertices + 0.2, mesh.faces, kappa[nonzero])
    np.testing.assert_allclose(together[nonzero], single, atol=CONVERGED * mesh.volume, rtol=0)
    assert together[~nonzero].item() == pytest.approx(mesh.volume, rel=1e-13)


def test_frames_move_the_vertices() -> None:
    mesh = asg.bodies.ball(0.4, subdivisions=1)
    frame = Frame((0.3, -0.2, 0.1), (0.5, 1.0, 2.0))
    there = TriangleMesh(mesh.vertices * frame.scale + frame.centre, mesh.faces)
    u = asg.far_field(there, LATTICE, frame=frame, dtype="complex128", backend="reference")
    exact = asg.far_field(mesh, LATTICE, dtype="complex128", backend="reference")
    assert relative_error(u, exact) < CONVERGED


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_vertex_gradient_by_finite_differences(kind: str, rng: np.random.Generator) -> None:
    nodes = FourierLattice(Box((2.2, 1.7, 2.9)), (3, 2, 4)) if kind == "lattice" else scattered(40, 20.0, rng)
    ball = asg.bodies.ball(0.5, subdivisions=1)
    frame = Frame((0.05, 0.0, -0.1), (0.9, 1.1, 1.0))
    cotangent = rng.normal(size=nodes.shape) + 1j * rng.normal(size=nodes.shape)

    def value(vertices: np.ndarray) -> float:
        mesh = TriangleMesh(vertices, ball.faces)
        u = asg.far_field(mesh, nodes, frame=frame, dtype="complex128", backend="reference")
        return float(np.vdot(cotangent, u).real)

    gradient = far_field_vertex_gradient(ball, nodes, cotangent, frame=frame)
    assert gradient.shape == ball.vertices.shape
    direction, step = rng.normal(size=ball.vertices.shape), 1e-4
    # Central differences with one extrapolation: O(step⁴) and rounding 1e-16/step.
    slopes = [(value(ball.vertices + h * direction) - value(ball.vertices - h * direction)) / (2 * h)
              for h in (step, step / 2)]  # fmt: skip
    expected = (4 * slopes[1] - slopes[0]) / 3
    scale = np.linalg.norm(gradient) * np.linalg.norm(direction)
    assert abs((gradient * direction).sum() - expected) < 1e-9 * scale


def test_moving_a_whole_body_is_a_phase(rng: np.random.Generator) -> None:
    nodes, mesh = scattered(20, 20.0, rng), asg.bodies.cuboid(0.5, 0.7, 0.9)
    cotangent = rng.normal(size=20) + 1j * rng.normal(size=20)
    u = asg.far_field(mesh, nodes, dtype="complex128", backend="reference")
    expected = [np.vdot(cotangent, -1j * nodes.kappa[:, j] * u).real for j in range(3)]
    found = far_field_vertex_gradient(mesh, nodes, cotangent).sum(axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())


CUBOID = asg.bodies.cuboid(1.0, 0.5, 1.4)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: asg.far_field(TriangleMesh(CUBOID.vertices, CUBOID.faces[:-1]), LATTICE), MeshError, "not closed"),
        (
            lambda: asg.far_field(TriangleMesh(CUBOID.vertices, CUBOID.faces[:, ::-1]), LATTICE),
            MeshError,
            "volume -0.7 m³; turn the triangles",
        ),
        (
            lambda: asg.far_field(TriangleMesh(CUBOID.vertices * 3, CUBOID.faces), LATTICE),
            OutsideBoxError,
            "body: reaches from -1.5 to 1.5 m on axis 0",
        ),
        (lambda: asg.far_field(CUBOID, FourierLattice(Box((2, 2)), 3)), ShapeError, "nodes: is 2-D"),
        (
            lambda: asg.far_field(CUBOID, LATTICE, eps=1e-7, backend="opencl"),
            ArgumentError,
            "eps: is 1e-07.*complex128",
        ),
        (
            lambda: asg.far_field(CUBOID, LATTICE, eps=1e-13, dtype="complex128", backend="opencl"),
            ArgumentError,
            "eps >= 1e-12",
        ),
        (lambda: asg.far_field(CUBOID, LATTICE, eps=2.0), ArgumentError, "eps: is 2.0"),
        (lambda: asg.far_field(CUBOID, LATTICE, dtype="float32"), DtypeError, "dtype"),
        (lambda: asg.far_field(CUBOID, LATTICE, frame=Frame((0, 0), 1)), ShapeError, "frame"),
        (lambda: far_field_vertex_gradient(CUBOID, LATTICE, np.ones(3)), ShapeError, "cotangent: has shape"),
    ],
)
def test_bad_input(call, error, message) -> None:
    with pytest.raises(error, match=message):
        call()


def test_a_plan_refuses_what_it_was_not_made_for(opencl: Backend) -> None:
    options = {"eps": 1e-4, "dtype": np.dtype("complex64"), "batch": 2, "backend": opencl}
    plan = MeshFarFieldPlan([CUBOID], LATTICE, [IDENTITY], **options)
    with pytest.raises(ArgumentError, match=r"bodies\[1\]: leaves the box"):
        plan.apply([CUBOID, TriangleMesh(CUBOID.vertices * 1.1, CUBOID.faces)])
    with pytest.raises(ArgumentError, match=r"bodies\[0\]: is far thinner"):
        plan.apply([TriangleMesh(CUBOID.vertices * 0.01, CUBOID.faces)])
    with pytest.raises(ShapeError, match="frames: has 2 entries"):
        plan.apply([CUBOID], [IDENTITY] * 2)


def test_eps_promises_hold_off_the_zero_slot(opencl: Backend) -> None:
    mesh = asg.bodies.ball(0.6, subdivisions=2)
    exact = asg.far_field(mesh, LATTICE, dtype="complex128", backend="reference")
    for dtype, eps in (("complex64", 1e-2), ("complex64", 1e-6), ("complex128", 1e-10)):
        u = asg.far_field(mesh, LATTICE, eps=eps, dtype=dtype, backend=opencl)
        assert u.dtype == dtype
        zero = LATTICE.zero_slot
        assert relative_error(off_centre(u, zero), off_centre(exact, zero)) < 3 * eps
        assert abs(u[zero] / exact[zero] - 1) < 3 * eps
