"""`scattered_transform` on every OpenCL device against the float64 reference."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from accel_shapegen.backends.base import Backend, ScatteredSpec
from accel_shapegen.errors import ArgumentError, DeviceMemoryError, DtypeError, ShapeError
from accel_shapegen.testing import relative_error

# What is promised: relative L2 error over the nodes, for every kind of body.
TIMES_EPS = 3

EPS = [("float32", 1e-2), ("float32", 1e-4), ("float32", 1e-6)]
EPS += [("float64", 1e-4), ("float64", 1e-8), ("float64", 1e-10), ("float64", 1e-12)]

# Points and spacing [m]: chosen for what the kernels treat apart - one point, no whole vector, odd and even axes
# (centre on or between points), axes of very different size, a first axis of one point in 3-D, each axis of one point.
GRIDS: dict[str, tuple[tuple[int, ...], tuple[float, ...]]] = {
    "2d-one": ((1, 1), (0.3, 0.2)),
    "2d-two": ((2, 2), (0.3, 0.2)),
    "2d-column": ((13, 1), (0.07, 0.2)),
    "2d-row": ((1, 24), (0.07, 0.05)),
    "2d": ((37, 50), (0.05, 0.03)),
    "3d-one": ((1, 1, 1), (0.1, 0.1, 0.1)),
    "3d-two": ((2, 2, 2), (0.2, 0.3, 0.4)),
    "3d-flat": ((1, 8, 9), (0.2, 0.1, 0.1)),
    "3d-wall": ((11, 1, 6), (0.1, 0.2, 0.1)),
    "3d-plate": ((12, 7, 1), (0.1, 0.1, 0.2)),
    "3d": ((17, 19, 24), (0.08, 0.05, 0.06)),
    "3d-prime": ((5, 31, 13), (0.2, 0.03, 0.07)),
}
NODES = 300


def complex_of(dtype: str) -> np.dtype[Any]:
    return np.result_type(dtype, np.complex64)


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...], dtype: Any = np.complex128) -> np.ndarray:
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype)


def make_spec(
    rng: np.random.Generator,
    grid: str | tuple[tuple[int, ...], tuple[float, ...]],
    eps: float,
    dtype: str,
    *,
    kappa: np.ndarray | None = None,
    batch: int = 1,
) -> ScatteredSpec:
    """An off-centre grid with random nodes in half of the band that it resolves."""
    shape, spacing = GRIDS[grid] if isinstance(grid, str) else grid
    if kappa is None:
        kappa = rng.uniform(-0.5, 0.5, (NODES, len(shape))) * np.pi / np.array(spacing)
    origin = tuple(rng.uniform(-1, 1, len(shape)))
    weights = complex_normal(rng, (len(kappa),))
    return ScatteredSpec(shape, spacing, origin, kappa, eps, batch, np.dtype(dtype), weights)


def bodies(rng: np.random.Generator, shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """An ellipsoid of ones, normal values, and values ±1 about 0; shape (3, *shape)."""
    centred = np.meshgrid(*((np.arange(n) - (n - 1) / 2) / n for n in shape), indexing="ij")
    ellipsoid = sum(x**2 for x in centred) < 0.4**2
    # A grid of two points per axis has all its points outside the ellipsoid.
    ellipsoid = ellipsoid if ellipsoid.any() else np.ones(shape)
    return np.stack([ellipsoid, rng.normal(size=shape), rng.choice([-1.0, 1.0], shape)]).astype(dtype)


def check_forward(plan: Any, exact: Any, values: np.ndarray, eps: float, names: list[str]) -> None:
    u, expected = plan.forward(values), exact.forward(values.astype(np.float64))
    for name, body, body_expected in zip(names, u, expected, strict=True):
        error = relative_error(body, body_expected)
        assert error <= TIMES_EPS * eps, f"{name}: {error / eps:.2f} eps"


def exact_plan(reference: Backend, spec: ScatteredSpec) -> Any:
    """The reference, without rounding its result to float32."""
    double = ScatteredSpec(
        spec.shape, spec.spacing, spec.origin, spec.kappa, spec.eps, spec.batch, np.dtype(np.float64), spec.node_weights
    )
    return reference.plan_scattered_transform(double)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize(("dtype", "eps"), EPS)
def test_both_directions_within_eps(
    opencl: Backend, reference: Backend, rng: np.random.Generator, grid: str, dtype: str, eps: float
) -> None:
    spec = make_spec(rng, grid, eps, dtype, batch=3)
    plan, exact = opencl.plan_scattered_transform(spec), exact_plan(reference, spec)
    check_forward(plan, exact, bodies(rng, spec.shape, dtype), eps, ["ellipsoid", "normal", "signs"])
    u = complex_normal(rng, (3, NODES), complex_of(dtype))
    values = plan.adjoint(u)
    assert values.dtype == dtype
    assert relative_error(values, exact.adjoint(u.astype(np.complex128))) <= TIMES_EPS * eps


@pytest.mark.parametrize(
    ("dtype", "eps"), [("float32", 1e-2), ("float32", 1e-4), ("float32", 1e-6), ("float64", 1e-12)]
)
def test_full_size(opencl: Backend, reference: Backend, rng: np.random.Generator, dtype: str, eps: float) -> None:
    # Order 19 on a box of 2.2 m, between the lattice's nodes.
    n, box = 100, 2.2
    kappa = rng.uniform(-19, 19, (500, 3)) * 2 * np.pi / box
    spec = make_spec(rng, ((n,) * 3, (box / n,) * 3), eps, dtype, kappa=kappa, batch=3)
    values = bodies(rng, spec.shape, dtype)
    check_forward(
        opencl.plan_scattered_transform(spec),
        exact_plan(reference, spec),
        values,
        eps,
        ["ellipsoid", "normal", "signs"],
    )


@pytest.mark.parametrize(("dtype", "eps"), [*EPS, ("float32", 5e-7), ("float64", 1e-13)])
def test_voxels_where_the_error_is_largest(
    opencl: Backend, reference: Backend, rng: np.random.Generator, dtype: str, eps: float
) -> None:
    # A voxel in a corner sees the window's full error and rounding on all axes; a box of ones has transforms that are
    # small against the sum of its values.
    shape = (24, 17, 20)
    spec = make_spec(rng, (shape, (0.05, 0.07, 0.06)), eps, dtype, batch=4)
    values = np.zeros((4, *shape), dtype=dtype)
    values[0, 0, 0, 0] = values[1, -1, 0, -1] = 1
    values[2, :3, :3, :3] = rng.normal(size=(3, 3, 3))
    values[3] = 1
    names = ["corner", "other corner", "corner region", "ones"]
    check_forward(opencl.plan_scattered_transform(spec), exact_plan(reference, spec), values, eps, names)


def band(name: str, rng: np.random.Generator, cutoff: np.ndarray) -> np.ndarray:
    """Nodes κ (J, 3) [rad/m]; `cutoff` is π/h."""
    everywhere = rng.uniform(-1, 1, (200, 3))
    return {
        "one": everywhere[:1] * cutoff,
        "repeated": np.repeat(everywhere[:5], 20, axis=0) * cutoff,
        "zero": np.zeros((3, 3)),
        "tiny": everywhere * 1e-3,
        "edge": np.sign(everywhere) * cutoff,
        "full": everywhere * cutoff,
        "beyond": everywhere * cutoff * 4.3,
        "far": everywhere + 40 * cutoff,
        "narrow": (0.02 * everywhere + [0.7, -0.6, -0.5]) * cutoff,
        "two-sided": np.where(everywhere[:, :1] > 0, 1, -1) * (0.05 * everywhere + 0.6) * cutoff,
        "plane": everywhere * [1, 0, 1] * cutoff,
        "axis": everywhere * [0, 0, 1] * cutoff,
        "positive": np.abs(everywhere) * cutoff,
        "negative": -np.abs(everywhere) * cutoff,
    }[name]


@pytest.mark.parametrize(
    "name",
    ["one", "repeated", "zero", "tiny", "edge", "full", "beyond", "far", "narrow", "two-sided", "plane", "axis",
     "positive", "negative"],
)  # fmt: skip
@pytest.mark.parametrize(("dtype", "eps"), [("float32", 1e-6), ("float64", 1e-10)])
def test_bands(
    opencl: Backend, reference: Backend, rng: np.random.Generator, name: str, dtype: str, eps: float
) -> None:
    shape, spacing = (14, 9, 11), (0.1, 0.15, 0.07)
    kappa = band(name, rng, np.pi / np.array(spacing))
    spec = make_spec(rng, (shape, spacing), eps, dtype, kappa=kappa)
    plan, exact = opencl.plan_scattered_transform(spec), exact_plan(reference, spec)
    check_forward(plan, exact, rng.normal(size=(1, *shape)).astype(dtype), eps, [name])
    u = complex_normal(rng, (1, len(kappa)), complex_of(dtype))
    assert relative_error(plan.adjoint(u), exact.adjoint(u.astype(np.complex128))) <= TIMES_EPS * eps


def test_crowded_nodes(opencl: Backend, reference: Backend, rng: np.random.Generator) -> None:
    # Thousands of nodes share each lattice point: added up one by one in float32, the adjoint would err by 5e-6.
    eps, shape = 1e-6, (3, 2, 3)
    spec = make_spec(rng, (shape, (0.2, 0.2, 0.2)), eps, "float32", kappa=rng.uniform(-7, 7, (5000, 3)))
    u = complex_normal(rng, (1, 5000), np.complex64)
    values = opencl.plan_scattered_transform(spec).adjoint(u)
    assert relative_error(values, exact_plan(reference, spec).adjoint(u.astype(np.complex128))) <= TIMES_EPS * eps


@pytest.mark.parametrize("grid", ["2d", "3d"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_sparse_bodies(opencl: Backend, reference: Backend, rng: np.random.Generator, grid: str, dtype: str) -> None:
    # Products stop where a body's voxels end: rows, planes and halves that are empty, in every combination.
    shape, eps = GRIDS[grid][0], 1e-5
    values = np.zeros((24, *shape), dtype=dtype)
    for body in values[1:]:
        low = [rng.integers(n) for n in shape]
        part = tuple(slice(a, rng.integers(a, n) + 1) for a, n in zip(low, shape, strict=True))
        body[part] = rng.normal(size=body[part].shape) * (rng.uniform(size=body[part].shape) < 0.5)
        body[tuple(low)] = -0.5
    spec = make_spec(rng, grid, eps, dtype, batch=len(values))
    plan, exact = opencl.plan_scattered_transform(spec), exact_plan(reference, spec)
    assert not plan.forward(values[:1]).any()
    check_forward(plan, exact, values[1:], eps, [f"body {i}" for i in range(1, len(values))])


@pytest.mark.parametrize("grid", ["2d-two", "2d-column", "2d", "3d-two", "3d-flat", "3d-wall", "3d-plate", "3d"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_adjoint_is_the_transpose_of_what_forward_computes(
    opencl: Backend, rng: np.random.Generator, grid: str, dtype: str
) -> None:
    # At this eps a transpose of the exact sum instead would differ by 1e-2; what may differ is rounding, which the
    # window multiplies by less than 10 here, on both sides: 64 units.
    spec = make_spec(rng, grid, 1e-2, dtype, batch=2)
    plan = opencl.plan_scattered_transform(spec)
    values = rng.normal(size=(2, *spec.shape)).astype(dtype)
    u = complex_normal(rng, (2, NODES), complex_of(dtype))
    forward, adjoint = plan.forward(values).astype(np.complex128), plan.adjoint(u).astype(np.float64)
    left, right = np.vdot(forward, u).real, np.vdot(values.astype(np.float64), adjoint)
    assert abs(left - right) <= 64 * np.finfo(dtype).eps * np.linalg.norm(forward) * np.linalg.norm(u)


@pytest.mark.parametrize("grid", ["2d", "3d"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_same_bits_in_any_batch(
    opencl: Backend, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, grid: str, dtype: str
) -> None:
    spec = make_spec(rng, grid, 1e-5, dtype, batch=7)
    values = rng.normal(size=(7, *spec.shape)).astype(dtype)
    u = complex_normal(rng, (7, NODES), complex_of(dtype))
    plan = opencl.plan_scattered_transform(spec)
    forward, adjoint = plan.forward(values), plan.adjoint(u)
    for body in range(7):
        np.testing.assert_array_equal(plan.forward(values[body : body + 1])[0], forward[body])
        np.testing.assert_array_equal(plan.adjoint(u[body : body + 1])[0], adjoint[body])
    monkeypatch.setattr("accel_shapegen.backends.opencl.scattered.CHUNK_BYTES", 1)
    one_by_one = opencl.plan_scattered_transform(spec)
    np.testing.assert_array_equal(one_by_one.forward(values), forward)
    np.testing.assert_array_equal(one_by_one.adjoint(u), adjoint)


def test_threads_share_a_plan(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "3d", 1e-5, "float32", batch=2)
    plan = opencl.plan_scattered_transform(spec)
    values = rng.normal(size=(6, 2, *spec.shape)).astype(np.float32)
    expected = [plan.forward(part) for part in values]
    got: list[np.ndarray | None] = [None] * len(values)

    def work(index: int) -> None:
        for _ in range(10):
            got[index] = plan.forward(values[index])

    threads = [threading.Thread(target=work, args=(index,)) for index in range(len(values))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for have, want in zip(got, expected, strict=True):
        np.testing.assert_array_equal(have, want)


@pytest.mark.parametrize("eps", [0.0, -1e-3, 1.0, 2.0, float("nan"), float("inf"), 1e-14])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_eps_that_makes_no_sense(opencl: Backend, rng: np.random.Generator, dtype: str, eps: float) -> None:
    with pytest.raises(ArgumentError, match=rf"^eps: is {eps}; give (5e-07|1e-13) <= eps < 1"):
        opencl.plan_scattered_transform(make_spec(rng, "2d", eps, dtype))


def test_eps_beyond_single_precision_points_to_double(opencl: Backend, rng: np.random.Generator) -> None:
    with pytest.raises(ArgumentError, match="complex128"):
        opencl.plan_scattered_transform(make_spec(rng, "2d", 1e-8, "float32"))
    opencl.plan_scattered_transform(make_spec(rng, "2d", 1e-8, "float64"))


def test_out_is_filled_and_returned(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "2d", 1e-4, "float32", batch=2)
    plan = opencl.plan_scattered_transform(spec)
    values, u = rng.normal(size=(2, *spec.shape)).astype(np.float32), complex_normal(rng, (2, NODES), np.complex64)
    out, back = np.full((2, NODES), np.nan, np.complex64), np.full((2, *spec.shape), np.nan, np.float32)
    assert plan.forward(values, out) is out
    assert plan.adjoint(u, back) is back
    np.testing.assert_array_equal(out, plan.forward(values))
    np.testing.assert_array_equal(back, plan.adjoint(u))
    # Rows that are not contiguous are read all the same.
    np.testing.assert_array_equal(plan.forward(np.asfortranarray(values)), out)


def test_wrong_arrays(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "2d", 1e-4, "float32", batch=2)
    plan = opencl.plan_scattered_transform(spec)
    values, u = np.zeros((2, *spec.shape), np.float32), np.zeros((2, NODES), np.complex64)
    for wrong in (values[0], values[:, :-1], values[:0], np.zeros((3, *spec.shape), np.float32)):
        with pytest.raises(ShapeError, match=r"^values: "):
            plan.forward(wrong)
    for wrong in (u[0], u[:, :-1], u[:0], np.zeros((3, NODES), np.complex64)):
        with pytest.raises(ShapeError, match=r"^u: "):
            plan.adjoint(wrong)
    with pytest.raises(DtypeError, match=r"^values: "):
        plan.forward(values.astype(np.float64))
    with pytest.raises(DtypeError, match=r"^u: "):
        plan.adjoint(u.astype(np.complex128))
    with pytest.raises(ShapeError, match=r"^out: "):
        plan.forward(values, u[:1])
    with pytest.raises(DtypeError, match=r"^out: "):
        plan.adjoint(u, values.astype(np.float64))


def test_too_large_for_the_device(opencl: Backend, rng: np.random.Generator) -> None:
    # 20,000³ voxels: 32 TB of folded voxels, refused before anything is allocated.
    kappa = rng.uniform(-1, 1, (10, 3))
    with pytest.raises(DeviceMemoryError, match="give fewer grid points"):
        opencl.plan_scattered_transform(make_spec(rng, ((20000,) * 3, (1e-4,) * 3), 1e-3, "float32", kappa=kappa))


def test_device_is_named(opencl: Backend, rng: np.random.Generator) -> None:
    plan = opencl.plan_scattered_transform(make_spec(rng, "2d", 1e-4, "float32"))
    assert plan.device == opencl.info.label
