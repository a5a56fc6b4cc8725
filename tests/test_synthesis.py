"""Fourier coefficients, the zero-node formula, windows, and synthesis on every device against the reference."""

from __future__ import annotations

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import Box, FourierLattice, Frame, Grid, VoxelGrid, far_field_constant
from accel_shapegen.backends.base import Backend
from accel_shapegen.errors import ArgumentError, BackendError, DtypeError, NonFiniteError, ShapeError
from accel_shapegen.testing import box_transform, dot_test, relative_error

BOXES = {2: Box((2.2, 3.1)), 3: Box((2.2, 1.7, 2.9))}
ORDERS = {2: (6, 9), 3: (5, 4, 3)}
SUMS = 100 * np.finfo(float).eps  # rounding of sums of some thousand terms


def plain_series(coefficients: np.ndarray, lattice: FourierLattice, grid: Grid) -> np.ndarray:
    """Re Σ f̂_ξ exp(2πi Σ_j ξ_j x_j/a_j), 0 outside the box: the definition, term by term."""
    points = grid.points()
    phase = np.tensordot(points / lattice.box.lengths, lattice.xi, axes=(-1, -1))
    axes = lattice.dim
    field = np.tensordot(np.exp(2j * np.pi * phase), coefficients, axes=axes).real
    inside = (np.abs(points) <= np.array(lattice.box.lengths) / 2).all(axis=-1)
    return np.where(inside, field, 0.0)


def band_limited(lattice: FourierLattice, rng: np.random.Generator) -> np.ndarray:
    """Fourier coefficients of a real field in the lattice's band."""
    raw = rng.normal(size=lattice.shape) + 1j * rng.normal(size=lattice.shape)
    return (raw + np.flip(raw).conj()) / 2


def generator_of(coefficients: np.ndarray, lattice: FourierLattice) -> np.ndarray:
    """u∞ of the field with these coefficients: at the zero node by the overlap integrals of exponentials."""
    c = far_field_constant(lattice.wavenumbers, lattice.dim)
    u = coefficients * lattice.box.volume * c
    line = coefficients[(slice(None), *lattice.zero_slot[1:])]
    xi = np.arange(-lattice.order[0], lattice.order[0] + 1)
    # ∫ exp(2πi(ξ-μ)x/a) dx over (-a/2, a/2) = a sinc(ξ-μ); the other axes give their lengths.
    u[lattice.zero_slot] = c[lattice.zero_slot] * lattice.box.volume * (line * np.sinc(xi - lattice.mu)).sum()
    return u


@pytest.mark.parametrize("mu", [0.01, 0.5, 0.9])
@pytest.mark.parametrize("dim", [2, 3])
def test_zero_node_formula_gives_the_mean(dim: int, mu: float, rng: np.random.Generator) -> None:
    lattice = FourierLattice(BOXES[dim], ORDERS[dim], mu=mu)
    exact = band_limited(lattice, rng)
    found = asg.fourier_coefficients(generator_of(exact, lattice), lattice)
    # At μ = 0.9 the overlap with ξ = 1 is ten times that with 0: the formula loses one digit.
    assert abs(found[lattice.zero_slot] - exact[lattice.zero_slot]) < 10 * SUMS * np.abs(exact).max()
    assert relative_error(found, exact) < 10 * SUMS


def test_zero_node_of_a_body_gives_its_mean() -> None:
    """With a body the series is cut at N; near μ = 0 its tail does not touch the real part."""
    lattice = FourierLattice(Box((2.2, 2.2, 2.2)), 12)
    sides = (1.1, 0.7, 0.9)
    u = far_field_constant(lattice.wavenumbers, 3) * box_transform(sides, lattice.kappa, (0.1, 0.2, -0.05))
    mean = np.prod(sides) / lattice.box.volume
    assert abs(asg.fourier_coefficients(u, lattice)[lattice.zero_slot].real - mean) < 1e-6 * mean


@pytest.mark.parametrize("window", [None, "lanczos", "fejer"])
@pytest.mark.parametrize("dim", [2, 3])
def test_reference_is_the_plain_series(dim: int, window, rng: np.random.Generator) -> None:
    """μ = 0.5, not Hermitian, an anisotropic box, and a grid that is larger than the box."""
    lattice = FourierLattice(BOXES[dim], ORDERS[dim], mu=0.5)
    grid = Grid(Box((3.0, 3.4, 3.2)[:dim]), (9, 11, 7)[:dim])
    u = rng.normal(size=lattice.shape) + 1j * rng.normal(size=lattice.shape)
    coefficients = asg.fourier_coefficients(u, lattice)
    factor = np.ones(lattice.shape)
    for axis, order in enumerate(lattice.order):
        xi = lattice.xi[..., axis] / (order + 1)
        factor = factor * {None: np.ones_like(xi), "lanczos": np.sinc(xi), "fejer": 1 - np.abs(xi)}[window]
    field = asg.synthesize(u, lattice, grid, window=window, backend="reference")
    expected = plain_series(coefficients * factor, lattice, grid)
    assert field.dtype == np.float64
    assert (expected[0] == 0).all()
    np.testing.assert_array_equal(field[0], 0.0)
    assert relative_error(field, expected) < SUMS


@pytest.mark.parametrize("dtype", ["complex64", "complex128"])
@pytest.mark.parametrize("dim", [2, 3])
def test_opencl_is_the_reference(opencl: Backend, dim: int, dtype: str, rng: np.random.Generator) -> None:
    lattice = FourierLattice(BOXES[dim], ORDERS[dim], mu=0.5)
    grid = Grid(Box((3.0, 3.4, 3.2)[:dim]), (17, 19, 24)[:dim])
    u = (rng.normal(size=(3, *lattice.shape)) + 1j * rng.normal(size=(3, *lattice.shape))).astype(dtype)
    field = asg.synthesize(u, lattice, grid, backend=opencl)
    exact = asg.synthesize(u.astype("complex128"), lattice, grid, backend="reference")
    assert field.dtype == {"complex64": "float32", "complex128": "float64"}[dtype]
    assert relative_error(field, exact) < {"complex64": 2e-6, "complex128": 1e-12}[dtype]
    assert (field[exact == 0] == 0).all()


@pytest.mark.parametrize("per_body", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_plan_adjoint_and_frames(opencl: Backend, dim: int, per_body: bool, rng: np.random.Generator) -> None:
    lattice = FourierLattice(BOXES[dim], ORDERS[dim], mu=0.5)
    grid = Grid(Box((2.4,) * dim), (9, 8, 7)[:dim])
    frames = [Frame((0.1 * b, -0.2, 0.05)[:dim], (0.6 + 0.2 * b, 1.1, 0.9)[:dim]) for b in range(2)]
    plan = asg.plan_synthesis(
        lattice,
        grid,
        batch=2,
        frame=frames if per_body else frames[0],
        window="fejer",
        dtype="complex128",
        backend=opencl,
    )
    u = rng.normal(size=(4, *lattice.shape)) + 1j * rng.normal(size=(4, *lattice.shape))
    values = rng.normal(size=(4, *grid.shape))
    field, back = plan.apply(u), plan.adjoint(values)
    assert dot_test(back, u, values, field) < SUMS
    for body in range(4):
        frame = frames[body % 2] if per_body else frames[0]
        moved = Grid.from_axes([(x - c) / s for x, c, s in zip(grid.axes, frame.centre, frame.scale, strict=True)])
        alone = asg.synthesize(u[body], lattice, moved, window="fejer", backend="reference")
        assert relative_error(field[body], alone) < 1e-12


@pytest.mark.parametrize("dim", [2, 3])
def test_round_trip(opencl: Backend, dim: int, rng: np.random.Generator) -> None:
    """A body that is band-limited comes back: sample it finely, transform the samples, synthesise."""
    lattice = FourierLattice(BOXES[dim], (2, 3, 2)[:dim], mu=0.01)
    exact = band_limited(lattice, rng)
    u = generator_of(exact, lattice)
    grid = Grid(lattice.box, (12, 16, 12)[:dim])
    field = asg.synthesize(u, lattice, grid, backend=opencl)
    assert relative_error(field, plain_series(exact, lattice, grid)) < 1e-12
    # The voxel transform of those samples is u up to the voxels' sinc, at all nodes but the zero node.
    again = asg.far_field(VoxelGrid(field, lattice.box), lattice, dtype="complex128", backend=opencl)
    h = np.array(lattice.box.lengths) / grid.shape
    sinc = np.prod(np.sinc(lattice.kappa * h / (2 * np.pi)), axis=-1)
    wrong = again - u * sinc
    wrong[lattice.zero_slot] = 0
    assert np.linalg.norm(wrong) < 1e-12 * np.linalg.norm(u)


LATTICE = FourierLattice(Box((1.0, 2.0)), (2, 3))
GRID = Grid(Box((1.0, 2.0)), (4, 5))
U = np.ones(LATTICE.shape, dtype=np.complex64)
NAN = U.copy()
NAN[1, 2] = np.nan


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: asg.synthesize(U.real, LATTICE, GRID), DtypeError, "u: has dtype float32"),
        (lambda: asg.synthesize(U[:-1], LATTICE, GRID), ShapeError, r"u: has shape \(4, 7\)"),
        (lambda: asg.synthesize(U[None][:0], LATTICE, GRID), ShapeError, "empty batch"),
        (lambda: asg.synthesize(NAN, LATTICE, GRID), NonFiniteError, r"u: is .*nan.* at index \(1, 2\)"),
        (lambda: asg.fourier_coefficients(NAN, LATTICE), NonFiniteError, "u: is"),
        (lambda: asg.synthesize(U, "lattice", GRID), DtypeError, "lattice: is a str"),
        (lambda: asg.synthesize(U, LATTICE, (4, 5)), DtypeError, "grid: is a tuple"),
        (lambda: asg.synthesize(U, LATTICE, Grid(Box((1, 1, 1)), 3)), ShapeError, "grid: is 3-D, the lattice is 2-D"),
        (lambda: asg.synthesize(U, LATTICE, GRID, window="hann"), ArgumentError, "window: is 'hann'"),
        (lambda: asg.synthesize(U, LATTICE, GRID, frame=Frame((0, 0, 0), 1)), ShapeError, "frame"),
        (lambda: asg.synthesize(U, LATTICE, GRID, frame=[Frame((0, 0), 1)] * 2), ShapeError, "frame: has 2 entries"),
        (lambda: asg.synthesize(U, LATTICE, GRID, backend="none"), BackendError, "'none' is not registered"),
        (lambda: asg.plan_synthesis(LATTICE, GRID, dtype="float32"), DtypeError, "dtype"),
        (lambda: asg.plan_synthesis(LATTICE, GRID, batch=1.5), ArgumentError, "batch: is 1.5"),
        (lambda: asg.plan_synthesis(LATTICE, GRID).apply(U, out=np.ones((4, 5))), DtypeError, "out: is float64"),
        (lambda: asg.plan_synthesis(LATTICE, GRID).adjoint(np.ones((5, 4))), ShapeError, "field: has shape"),
        (
            lambda: asg.plan_synthesis(LATTICE, GRID, batch=2, frame=[Frame((0, 0), 1)] * 2).apply(np.stack([U] * 3)),
            ShapeError,
            "batch: has 3 bodies",
        ),
    ],
)
def test_bad_input(call, error, message) -> None:
    with pytest.raises(error, match=message):
        call()
