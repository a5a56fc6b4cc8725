"""`tensor_transform` on every OpenCL device against the float64 reference."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accel_shapegen.backends.base import Backend, TensorAxis, TensorSpec, ZeroRow
from accel_shapegen.backends.opencl.tensor_axes import layout
from accel_shapegen.errors import ArgumentError, DeviceMemoryError, DtypeError, ShapeError

# Relative L2. Measured: up to 3 eps in float32 and for values without a mean. With a mean, slots ξ ≠ 0 are the small
# remainder of large sums, and angles that the two sides round differently (a coordinate's last bit times the greatest
# wavenumber) show there: up to 40 eps in float64. 2e-6 is 17 eps, 256 eps in float64 is 6e-14.
TOLERANCE = {"float32": 2e-6, "float64": 256 * np.finfo(np.float64).eps}

# Grid and order, chosen for what the kernels treat apart: no full vector, vectors that overlap, rows that fill no
# block, one point, one frequency, axes of very different size, bands of a 2-D grid.
SHAPES = {
    "2d-tiny": ((2, 1), (1, 2)),
    "2d-orders-0": ((1, 5), (0, 0)),
    "2d": ((17, 24), (5, 3)),
    "2d-bands": ((101, 70), (20, 7)),
    "3d-two": ((2, 2, 2), (1, 1, 1)),
    "3d-point": ((1, 1, 1), (0, 0, 0)),
    "3d-orders-0": ((1, 6, 1), (0, 3, 0)),
    "3d-order-0": ((4, 1, 7), (2, 0, 3)),
    "3d-even": ((17, 19, 24), (3, 5, 4)),
    "3d-prime": ((13, 31, 7), (2, 1, 6)),
    "3d-long": ((3, 5, 67), (1, 9, 16)),
    "3d-quarters": ((12, 8, 16), (4, 5, 6)),
}
FULL = {"full": ((100, 100, 100), (19, 19, 19))}
# What may differ between axes and bodies: (points, per body, masked).
FLAVOURS = {
    "uniform": ("uniform", False, False),
    "shifted": ("shifted", False, False),
    "scattered": ("scattered", False, False),
    "mask": ("uniform", False, True),
    "body": ("shifted", True, False),
    "body-mask": ("shifted", True, True),
    "body-scattered": ("scattered", True, True),
}


def make_axis(rng: np.random.Generator, n: int, order: int, flavour: str, batch: int) -> TensorAxis:
    points, per_body, masked = FLAVOURS[flavour]
    length = rng.uniform(0.5, 3.0)
    x = (np.arange(n) + 0.5) / n * length - length / 2
    copies = (batch,) if per_body else ()
    if points == "shifted":
        x = x * rng.uniform(0.4, 1.0, (*copies, 1)) + rng.uniform(-0.2, 0.2, (*copies, 1)) * length
    elif points == "scattered":
        x = np.sort(rng.uniform(-length / 2, length / 2, (*copies, n)), axis=-1)
    half = rng.uniform(0.5, 1.5, (*copies, order + 1))
    weights = np.concatenate([half[..., :0:-1], half], axis=-1)
    mask = rng.uniform(size=x.shape) < 0.8 if masked else None
    return TensorAxis(x, order, 2 * np.pi / length, weights, mask)


def make_spec(
    rng: np.random.Generator, shape: str, flavour: str, batch: int, dtype: str, *, zero: bool = True
) -> TensorSpec:
    grid, orders = (SHAPES | FULL)[shape]
    axes = tuple(make_axis(rng, n, order, flavour, batch) for n, order in zip(grid, orders, strict=True))
    lattice = tuple(2 * order + 1 for order in orders)
    weight = rng.uniform(0.5, 1.5, (batch,) if FLAVOURS[flavour][1] else ())
    row = ZeroRow(0.3 * axes[0].step, weight) if zero else None
    return TensorSpec(axes, batch, np.dtype(dtype), complex_normal(rng, lattice), row)


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...], dtype: Any = np.complex128) -> np.ndarray:
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype)


def complex_of(dtype: str) -> np.dtype:
    return np.result_type(dtype, np.complex64)


def apart_from_zero(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(b, nodes less one) and (b,): everything but the slot ξ = 0, and that slot."""
    flat = u.reshape(len(u), -1)
    slot = flat.shape[1] // 2
    return np.delete(flat, slot, axis=1), flat[:, slot]


def assert_close(found: np.ndarray, expected: np.ndarray, dtype: str, scale: float = 0.0) -> None:
    """Relative L2 error within `TOLERANCE`; an expected 0 must be met exactly unless a scale is given."""
    error = np.linalg.norm((found - expected).ravel())
    assert error <= TOLERANCE[dtype] * max(np.linalg.norm(expected.ravel()), scale)


@pytest.mark.parametrize("zero", [True, False], ids=["zero", "plain"])
@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("shape", SHAPES)
def test_matches_the_reference(
    opencl: Backend, reference: Backend, rng: np.random.Generator, shape: str, flavour: str, dtype: str, zero: bool
) -> None:
    for batch in (1, 3, 5):
        spec = make_spec(rng, shape, flavour, batch, dtype, zero=zero)
        plan, oracle = opencl.plan_tensor_transform(spec), reference.plan_tensor_transform(spec)
        values = rng.uniform(size=(batch, *spec.grid_shape)).astype(dtype)
        found, expected = plan.forward(values), oracle.forward(values.astype(np.float64))
        assert found.dtype == complex_of(dtype) and found.shape == expected.shape
        for part, expected_part in zip(apart_from_zero(found), apart_from_zero(expected), strict=True):
            assert_close(part, expected_part, dtype)
        u = complex_normal(rng, (batch, *spec.lattice_shape), complex_of(dtype))
        for centre in (None, complex_normal(rng, (batch,), complex_of(dtype))):
            found, expected = plan.adjoint(u, centre), oracle.adjoint(u, centre)
            assert found.dtype == np.dtype(dtype) and found.shape == expected.shape
            # A grid of a few points may cancel to less than its terms: measured against their size then.
            assert_close(found, expected, dtype, scale=float(np.linalg.norm(u * spec.node_weights)))


@pytest.mark.parametrize("dtype", TOLERANCE)
def test_matches_the_reference_at_full_size(
    opencl: Backend, reference: Backend, rng: np.random.Generator, dtype: str
) -> None:
    spec = make_spec(rng, "full", "uniform", 2, dtype)
    plan, oracle = opencl.plan_tensor_transform(spec), reference.plan_tensor_transform(spec)
    values = (rng.uniform(size=(2, 100, 100, 100)) < 0.1).astype(dtype)
    found, expected = plan.forward(values), oracle.forward(values.astype(np.float64))
    for part, expected_part in zip(apart_from_zero(found), apart_from_zero(expected), strict=True):
        assert_close(part, expected_part, dtype)
    u = complex_normal(rng, (2, 39, 39, 39), complex_of(dtype))
    assert_close(plan.adjoint(u), oracle.adjoint(u), dtype)


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("most", [1, 2])
@pytest.mark.parametrize("shape", ["2d-bands", "3d-prime", "3d-quarters"])
def test_symmetry_changes_nothing(
    opencl: Backend, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, shape: str, most: int, dtype: str
) -> None:
    spec = make_spec(rng, shape, "mask", 3, dtype)
    values = rng.uniform(size=(3, *spec.grid_shape)).astype(dtype)
    u = complex_normal(rng, (3, *spec.lattice_shape), complex_of(dtype))
    plan = opencl.plan_tensor_transform(spec)
    monkeypatch.setattr("accel_shapegen.backends.opencl.tensor.MOST_PARTS", most)
    monkeypatch.setattr("accel_shapegen.backends.opencl.tensor.MOST_PARTS_LAST", most)
    plain = opencl.plan_tensor_transform(spec)
    for part, plain_part in zip(
        apart_from_zero(plan.forward(values)), apart_from_zero(plain.forward(values)), strict=True
    ):
        assert_close(part, plain_part, dtype)
    assert_close(plan.adjoint(u), plain.adjoint(u), dtype)


@pytest.mark.parametrize(
    ("n", "scale", "shift", "bump", "parts"),
    [
        (12, 1.0, 0.0, 0.0, 4),  # spans the period, divisible by 4
        (14, 1.0, 0.0, 0.0, 2),
        (13, 1.0, 0.0, 0.0, 2),
        (12, 0.9, 0.0, 0.0, 2),
        (12, 1.0, 0.1, 0.0, 2),
        (12, 1.0, 0.0, 1e-4, 1),
        (2, 1.0, 0.3, 0.0, 2),
        (1, 1.0, 0.0, 0.0, 1),
    ],
)
@pytest.mark.parametrize("dtype", TOLERANCE)
def test_symmetry_is_seen(n: int, scale: float, shift: float, bump: float, parts: int, dtype: str) -> None:
    points = ((np.arange(n) + 0.5) / n * 2.2 - 1.1) * scale + shift
    points[n // 3] += bump
    axis = TensorAxis(points, 5, 2 * np.pi / 2.2, np.ones(11))
    assert layout(axis, np.dtype(dtype), 4).parts == parts
    # One body out of symmetry and none is folded.
    bodies = np.stack([points, points + 0.01 * np.arange(n) ** 2])
    spoilt = TensorAxis(bodies, 5, 2 * np.pi / 2.2, np.ones(11))
    assert layout(spoilt, np.dtype(dtype), 4).parts == (1 if n > 2 else parts)


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("flavour", ["uniform", "body-mask"])
@pytest.mark.parametrize("shape", ["2d-bands", "3d-even", "3d-quarters"])
def test_adjoint_is_the_adjoint(
    opencl: Backend, rng: np.random.Generator, shape: str, flavour: str, dtype: str
) -> None:
    spec = make_spec(rng, shape, flavour, 3, dtype)
    plan = opencl.plan_tensor_transform(spec)
    values = rng.normal(size=(3, *spec.grid_shape)).astype(dtype)
    u = complex_normal(rng, (3, *spec.lattice_shape), complex_of(dtype))
    image, back = plan.forward(values), plan.adjoint(u)
    # In float64, so that the sums themselves add no error; bounded by Cauchy-Schwarz, whatever cancels.
    left = np.vdot(image.astype(np.complex128), u.astype(np.complex128)).real
    right = np.vdot(values.astype(np.float64), back.astype(np.float64))
    assert abs(left - right) <= TOLERANCE[dtype] * np.linalg.norm(image.ravel()) * np.linalg.norm(u.ravel())


@pytest.mark.parametrize("shape", ["2d-bands", "3d-even"])
def test_centre_replaces_the_zero_slot(opencl: Backend, rng: np.random.Generator, shape: str) -> None:
    spec = make_spec(rng, shape, "uniform", 3, "float64", zero=False)
    plan = opencl.plan_tensor_transform(spec)
    u = complex_normal(rng, (3, *spec.lattice_shape))
    slot = (slice(None), *(order // 2 for order in spec.lattice_shape))
    centre = u[slot].copy()
    expected = plan.adjoint(u)
    u[slot] = np.nan
    np.testing.assert_array_equal(plan.adjoint(u, centre), expected)
    np.testing.assert_array_equal(plan.adjoint(u, centre.copy()), expected)


@pytest.mark.parametrize("flavour", ["uniform", "body-mask"])
def test_repeats_bit_by_bit_in_any_company(
    opencl: Backend, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, flavour: str
) -> None:
    spec = make_spec(rng, "3d-prime", flavour, 5, "float32")
    plan = opencl.plan_tensor_transform(spec)
    values = rng.normal(size=(5, *spec.grid_shape)).astype("float32")
    u = complex_normal(rng, (5, *spec.lattice_shape), "complex64")
    image, back = plan.forward(values), plan.adjoint(u)
    for _ in range(3):
        np.testing.assert_array_equal(plan.forward(values), image)
        np.testing.assert_array_equal(plan.adjoint(u), back)
    # Neither the cut of a batch into chunks nor the number of groups may show.
    monkeypatch.setattr("accel_shapegen.backends.opencl.tensor.CHUNK_BYTES", 1)
    monkeypatch.setattr("accel_shapegen.backends.opencl.tensor.GROUPS", 3)
    piecemeal = opencl.plan_tensor_transform(spec)
    np.testing.assert_array_equal(piecemeal.forward(values), image)
    np.testing.assert_array_equal(piecemeal.adjoint(u), back)
    if not spec.per_body:
        np.testing.assert_array_equal(plan.forward(values[2:4]), image[2:4])
        np.testing.assert_array_equal(plan.adjoint(u[4:]), back[4:])


def test_a_nan_stays_in_its_body_and_its_call(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "3d-quarters", "uniform", 3, "float32")
    plan = opencl.plan_tensor_transform(spec)
    values = rng.normal(size=(3, *spec.grid_shape)).astype("float32")
    image = plan.forward(values)
    back = plan.adjoint(image)
    spoilt, spoilt_image = values.copy(), image.copy()
    spoilt[1], spoilt_image[1] = np.nan, np.nan
    np.testing.assert_array_equal(plan.forward(spoilt)[[0, 2]], image[[0, 2]])
    np.testing.assert_array_equal(plan.adjoint(spoilt_image)[[0, 2]], back[[0, 2]])
    # Scratch is kept between calls: nothing of the last one may show.
    np.testing.assert_array_equal(plan.forward(values), image)
    np.testing.assert_array_equal(plan.adjoint(image), back)


def test_out_is_filled_and_returned(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "3d-even", "uniform", 3, "float32")
    plan = opencl.plan_tensor_transform(spec)
    values = rng.normal(size=(2, *spec.grid_shape)).astype("float32")
    # One element into a larger array: aligned to its element only.
    nodes = np.full(2 * math.prod(spec.lattice_shape) + 2, np.nan, dtype="complex64")
    out = nodes[1:-1].reshape(2, *spec.lattice_shape)
    assert plan.forward(values, out) is out
    np.testing.assert_array_equal(out, plan.forward(values))
    assert np.isnan(nodes[[0, -1]]).all()
    cells = np.full(values.size + 2, np.nan, dtype="float32")
    back = cells[1:-1].reshape(values.shape)
    assert plan.adjoint(out, out=back) is back
    np.testing.assert_array_equal(back, plan.adjoint(out))
    assert np.isnan(cells[[0, -1]]).all()


def test_inputs_of_any_layout(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "3d-even", "uniform", 3, "float32")
    plan = opencl.plan_tensor_transform(spec)
    values = rng.normal(size=(2, *spec.grid_shape)).astype("float32")
    expected = plan.forward(values)
    read_only = values.copy()
    read_only.flags.writeable = False
    packed = np.zeros(values.shape, dtype=[("tag", "u1"), ("value", "f4")])  # five bytes apart
    packed["value"] = values
    for same in (np.asfortranarray(values), np.repeat(values, 2, axis=-1)[..., ::2], read_only, packed["value"]):
        np.testing.assert_array_equal(plan.forward(same), expected)
    u = np.asfortranarray(expected)
    np.testing.assert_array_equal(plan.adjoint(u), plan.adjoint(expected))


def test_refusals(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "3d-two", "uniform", 3, "float32")
    plan = opencl.plan_tensor_transform(spec)
    values, u = np.zeros((3, 2, 2, 2), "float32"), np.zeros((3, 3, 3, 3), "complex64")
    for bad in (values.astype("float64"), values.astype("complex64"), values.astype(">f4"), values.tolist()):
        with pytest.raises(DtypeError, match="values"):
            plan.forward(bad)
    with pytest.raises(DtypeError, match="u"):
        plan.adjoint(u.astype("complex128"))
    with pytest.raises(DtypeError, match="centre"):
        plan.adjoint(u, np.zeros(3, "float32"))
    for shape in ((3, 2, 2), (3, 2, 2, 3), (4, 2, 2, 2), (0, 2, 2, 2)):
        with pytest.raises(ShapeError, match="values"):
            plan.forward(np.zeros(shape, "float32"))
    with pytest.raises(ShapeError, match="centre"):
        plan.adjoint(u, np.zeros(2, "complex64"))
    with pytest.raises(DtypeError, match="out"):
        plan.forward(values, np.empty(u.shape, "complex128"))
    with pytest.raises(ShapeError, match="out"):
        plan.forward(values, np.empty((2, 3, 3, 3), "complex64"))
    with pytest.raises(ShapeError, match="out"):
        plan.forward(values, np.asfortranarray(u))
    shared = np.zeros(u.size, "complex64")
    inside = shared.view("float32")[: values.size].reshape(values.shape)
    with pytest.raises(ArgumentError, match="overlaps"):
        plan.forward(inside, shared.reshape(u.shape))


def test_per_body_plans_take_whole_batches(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "2d", "body", 3, "float64")
    plan = opencl.plan_tensor_transform(spec)
    with pytest.raises(ShapeError, match="exactly 3"):
        plan.forward(np.zeros((2, *spec.grid_shape)))


def test_a_plan_too_large_is_refused_unmade(opencl: Backend) -> None:
    n, order = 60_000, 30_000
    axis = TensorAxis(np.linspace(-1, 1, n), order, 1.0, np.ones(2 * order + 1))
    shape = (2 * order + 1, 2 * order + 1)
    weights = np.broadcast_to(np.complex128(1), shape)
    with pytest.raises(DeviceMemoryError, match=r"^transform: needs .* give fewer grid points or nodes"):
        opencl.plan_tensor_transform(TensorSpec((axis, axis), 1, np.dtype("float64"), weights))


def test_threads_share_a_plan(opencl: Backend, rng: np.random.Generator) -> None:
    spec = make_spec(rng, "3d-even", "uniform", 2, "float32")
    plan = opencl.plan_tensor_transform(spec)
    inputs = rng.normal(size=(4, 2, *spec.grid_shape)).astype("float32")
    expected = [plan.forward(values) for values in inputs]
    wrong: list[int] = []

    def work(index: int) -> None:
        wrong.extend(index for _ in range(50) if not np.array_equal(plan.forward(inputs[index]), expected[index]))

    threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_threads_share_a_device(opencl: Backend, rng: np.random.Generator) -> None:
    """Plans of one kind share kernel objects and the queue."""
    specs = [make_spec(rng, "3d-even", flavour, 2, "float32") for flavour in ("uniform", "mask", "scattered")]
    plans = [opencl.plan_tensor_transform(spec) for spec in specs]
    u = complex_normal(rng, (2, *specs[0].lattice_shape), "complex64")
    expected = [(plan.adjoint(u), plan.forward(plan.adjoint(u))) for plan in plans]

    def agrees(index: int) -> bool:
        back = plans[index].adjoint(u)
        image = plans[index].forward(back)
        return np.array_equal(back, expected[index][0]) and np.array_equal(image, expected[index][1])

    with ThreadPoolExecutor(6) as pool:
        assert all(pool.map(agrees, [0, 1, 2] * 40))


def test_builds_from_an_environment_in_a_folder_with_a_space(tmp_path: Path) -> None:
    """PoCL refuses an include path that holds a space, and pyopencl always passes its own."""
    import pyopencl

    folder = tmp_path / "my packages"
    folder.mkdir()
    (folder / "pyopencl").symlink_to(Path(str(pyopencl.__file__)).parent)
    code = """
import numpy as np, pyopencl
from accel_shapegen import backends
from accel_shapegen.backends.base import TensorAxis, TensorSpec
assert " " in pyopencl.__file__
axis = TensorAxis(np.zeros(1), 1, 1.0, np.ones(3))
spec = TensorSpec((axis, axis), 1, np.dtype("float32"), np.ones((3, 3), complex))
print(backends.get("opencl").plan_tensor_transform(spec).forward(np.ones((1, 1, 1), "float32")).sum().real)
"""
    env = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["9.0"], done.stderr
