"""What devices with memory of their own do differently: copies, vload, many small work-items. Tried on any device."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accel_shapegen.backends.base import Backend, ScatteredSpec, SplineSpec, TensorAxis, TensorSpec, ZeroRow
from accel_shapegen.backends.opencl import OpenCLBackend
from accel_shapegen.errors import DeviceMemoryError
from accel_shapegen.testing import relative_error

# 64 eps: sums of at most 1344 terms, and angles up to 9 · 3 rad whose rounding, in the tables, is the reference's too.
TOLERANCE = {dtype: 64 * float(np.finfo(dtype).eps) for dtype in ("float32", "float64")}


@pytest.fixture
def discrete(opencl: Backend) -> OpenCLBackend:
    """The device, told that it cannot work in host arrays."""
    backend = OpenCLBackend(opencl.info)
    backend.runtime.shares_host_memory = False
    return backend


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...], dtype: Any = np.complex128) -> np.ndarray:
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype)


@pytest.mark.parametrize("grid", [(9, 12), (3, 5, 19), (8, 7, 24)], ids=str)
@pytest.mark.parametrize("dtype", TOLERANCE)
def test_tensor_transform(
    discrete: OpenCLBackend,
    reference: Backend,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    grid: tuple[int, ...],
    dtype: str,
) -> None:
    # Chunks of one body: each is to be fetched before the next is sent.
    monkeypatch.setattr("accel_shapegen.backends.opencl.tensor.CHUNK_BYTES", 1)
    axes = tuple(TensorAxis(np.linspace(-1, 0.9, n), 9, 3.0, np.ones(19)) for n in grid)
    lattice = (19,) * len(grid)
    zero = ZeroRow(0.4, np.array(1.5))
    spec = TensorSpec(axes, 3, np.dtype(dtype), complex_normal(rng, lattice), zero)
    plan, oracle = discrete.plan_tensor_transform(spec), reference.plan_tensor_transform(spec)
    values = rng.normal(size=(3, *grid)).astype(dtype)
    u = complex_normal(rng, (3, *lattice), np.result_type(dtype, np.complex64))
    assert relative_error(plan.forward(values), oracle.forward(values)) <= TOLERANCE[dtype]
    assert relative_error(plan.adjoint(u), oracle.adjoint(u)) <= TOLERANCE[dtype]


@pytest.mark.parametrize("grid", [(9, 12), (1, 5, 19), (8, 7, 24)], ids=str)
@pytest.mark.parametrize(("dtype", "eps"), [("float32", 1e-5), ("float64", 1e-11)])
def test_scattered_transform(
    discrete: OpenCLBackend,
    reference: Backend,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    grid: tuple[int, ...],
    dtype: str,
    eps: float,
) -> None:
    monkeypatch.setattr("accel_shapegen.backends.opencl.scattered.CHUNK_BYTES", 1)
    dim = len(grid)
    kappa, weights = rng.uniform(-20, 20, (100, dim)), complex_normal(rng, (100,))
    spec = ScatteredSpec(grid, (0.1,) * dim, (-0.3,) * dim, kappa, eps, 3, np.dtype(dtype), weights)
    plan, oracle = discrete.plan_scattered_transform(spec), reference.plan_scattered_transform(spec)
    values = rng.normal(size=(3, *grid)).astype(dtype)
    u = complex_normal(rng, (3, 100), np.result_type(dtype, np.complex64))
    assert relative_error(plan.forward(values), oracle.forward(values)) <= 3 * eps
    assert relative_error(plan.adjoint(u), oracle.adjoint(u)) <= 3 * eps


@pytest.mark.parametrize("dtype", TOLERANCE)
def test_spline_contract(discrete: OpenCLBackend, reference: Backend, rng: np.random.Generator, dtype: str) -> None:
    spec = SplineSpec(rng.normal(size=(12, 77)).astype(dtype), np.dtype(dtype))
    plan, oracle = discrete.plan_spline_contract(spec), reference.plan_spline_contract(spec)
    columns, weights = rng.integers(0, 12, (20, 4)).astype(np.int32), rng.normal(size=(20, 4))
    cotangent = rng.normal(size=(20, 77)).astype(dtype)
    for _ in range(2):
        assert relative_error(plan.forward(columns, weights), oracle.forward(columns, weights)) <= TOLERANCE[dtype]
        found, expected = (p.adjoint(columns, weights, cotangent) for p in (plan, oracle))
        assert relative_error(found, expected) <= TOLERANCE[dtype]
        plan._rows_at_once = 5  # as where the result is larger than one allocation


def test_a_cotangent_that_does_not_fit_beside_the_coefficients(discrete: OpenCLBackend) -> None:
    plan = discrete.plan_spline_contract(SplineSpec(np.ones((4, 6), np.float32), np.dtype("float32")))
    # 96 bytes of coefficients, 72 of the cotangent and 96 of the result.
    discrete.runtime.memory_bytes = 96 + 72 + 95
    columns, weights = np.zeros((3, 1), np.int32), np.ones((3, 1), np.float32)
    with pytest.raises(DeviceMemoryError, match=r"^cotangent: needs .*; give fewer queries$"):
        plan.adjoint(columns, weights, np.ones((3, 6), np.float32))
