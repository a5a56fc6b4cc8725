"""`spline_contract` on every OpenCL device against the reference, bit for bit where bits are promised."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from accel_shapegen import errors
from accel_shapegen.backends.base import Backend, SplineSpec
from accel_shapegen.backends.opencl import spline
from accel_shapegen.splines import SplineAxis, prefilter, tensor_terms

DTYPES = ("float32", "float64")
# Local alone, local with cardinal, cardinal alone and three axes with both forms.
GRIDS = {"1": (12,), "2": (14, 5), "2-dense": (5, 5), "3": (9, 3, 10), "3-dense": (3, 4, 5)}

Case = tuple[NDArray[Any], NDArray[np.int32], NDArray[np.float64]]


def case(rng: np.random.Generator, grid: tuple[int, ...], queries: int, stride: int, dtype: str) -> Case:
    """Coefficients, columns and weights of random queries on irregular knots."""
    axes = [SplineAxis(np.cumsum(rng.uniform(0.2, 1, count))) for count in grid]
    points = np.stack([rng.uniform(a.knots[0], a.knots[-1], queries) for a in axes], axis=1)
    coefficients = prefilter(axes, rng.standard_normal((*grid, stride)))
    return (coefficients.reshape(-1, stride).astype(dtype), *tensor_terms(axes, points))


def plan(backend: Backend, coefficients: NDArray[Any]) -> Any:
    return backend.plan_spline_contract(SplineSpec(coefficients, coefficients.dtype))


def bound(backend: Backend, c: NDArray[Any], columns: Any, weights: Any, g: Any | None = None) -> NDArray[Any]:
    """4 eps √T Σ|w||c| for every result.

    T terms carry T+2 roundings of up to eps/2 each (weight and coefficient once, then every sum), of either sign:
    eps √T has room for them, and four times that for the extremes of many results and the float64 oracle's own.
    """
    absolute = plan(backend, np.abs(c).astype(np.float64))
    if g is None:
        terms, scale = columns.shape[1], absolute.forward(columns, np.abs(weights))
    else:
        terms = np.bincount(columns.ravel()).max()
        scale = absolute.adjoint(columns, np.abs(weights), np.abs(g).astype(np.float64))
    result: NDArray[Any] = 4 * np.finfo(c.dtype).eps * np.sqrt(terms) * scale
    return result


@pytest.mark.parametrize("stride", [1, 2, 3, 17, 1000])
@pytest.mark.parametrize("queries", [1, 2, 7, 33, 200])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
@pytest.mark.parametrize("dtype", DTYPES)
def test_equals_the_reference(
    opencl: Backend, reference: Backend, rng: Any, dtype: str, grid: tuple[int, ...], queries: int, stride: int
) -> None:
    c, columns, weights = case(rng, grid, queries, stride, dtype)
    mine, oracle = plan(opencl, c), plan(reference, c.astype(np.float64))
    got = mine.forward(columns, weights)
    assert got.dtype == dtype and got.shape == (queries, stride)
    assert np.all(np.abs(got - oracle.forward(columns, weights)) <= bound(reference, c, columns, weights))
    g = rng.standard_normal((queries, stride)).astype(dtype)
    got = mine.adjoint(columns, weights, g)
    assert got.dtype == dtype and got.shape == c.shape
    # Where no query reaches a coefficient the bound is 0, and so must the adjoint be.
    expected = oracle.adjoint(columns, weights, g.astype(np.float64))
    assert np.all(np.abs(got - expected) <= bound(reference, c, columns, weights, g))


@pytest.mark.parametrize("dtype", DTYPES)
def test_equals_the_reference_at_full_size(opencl: Backend, reference: Backend, rng: Any, dtype: str) -> None:
    c, columns, weights = case(rng, (5, 5), 7, 2 * 59319, dtype)
    got = plan(opencl, c).forward(columns, weights)
    expected = plan(reference, c.astype(np.float64)).forward(columns, weights)
    assert np.all(np.abs(got - expected) <= bound(reference, c, columns, weights))
    # Over many results errors add in squares; what the package promises users is this.
    assert np.linalg.norm(got - expected) <= {"float32": 2e-6, "float64": 1e-12}[dtype] * np.linalg.norm(expected)


@pytest.mark.parametrize("lanes", [2, 4, 8, 16])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_vector_width_is_right(
    opencl: Backend, reference: Backend, rng: Any, dtype: str, lanes: int, monkeypatch: Any
) -> None:
    # Another CPU would choose another width than this one does.
    monkeypatch.setattr(spline, "vector_lanes", lambda device, dtype: lanes)
    c, columns, weights = case(rng, (14, 5), 23, 75, dtype)
    mine, oracle = plan(opencl, c), plan(reference, c.astype(np.float64))
    difference = mine.forward(columns, weights) - oracle.forward(columns, weights)
    assert np.all(np.abs(difference) <= bound(reference, c, columns, weights))
    g = rng.standard_normal((23, 75)).astype(dtype)
    difference = mine.adjoint(columns, weights, g) - oracle.adjoint(columns, weights, g.astype(np.float64))
    assert np.all(np.abs(difference) <= bound(reference, c, columns, weights, g))


@pytest.mark.parametrize("terms", [0, 1, 5, 300])
@pytest.mark.parametrize("dtype", DTYPES)
def test_any_columns_will_do(opencl: Backend, reference: Backend, rng: Any, dtype: str, terms: int) -> None:
    """Unsorted columns that repeat within a query and partly agree between queries: more than splines ask for."""
    c = rng.standard_normal((40, 37)).astype(dtype)
    columns = rng.integers(0, 40, (50, terms))
    columns[10:29] = columns[5]
    if terms > 1:
        columns[30] = columns[31]
        columns[30, -1] = (columns[30, -1] + 1) % 40
        columns[33] = columns[34][::-1]
    weights = rng.standard_normal(columns.shape)
    mine, oracle = plan(opencl, c), plan(reference, c.astype(np.float64))
    difference = mine.forward(columns, weights) - oracle.forward(columns, weights)
    assert np.all(np.abs(difference) <= bound(reference, c, columns, weights))
    g = rng.standard_normal((50, 37)).astype(dtype)
    got = mine.adjoint(columns, weights, g)
    if not terms:
        assert not got.any()
        return
    expected = oracle.adjoint(columns, weights, g.astype(np.float64))
    assert np.all(np.abs(got - expected) <= bound(reference, c, columns, weights, g))


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
@pytest.mark.parametrize("dtype", DTYPES)
def test_adjoint_is_adjoint(opencl: Backend, rng: Any, dtype: str, grid: tuple[int, ...]) -> None:
    c, columns, weights = case(rng, grid, 33, 101, dtype)
    g = rng.standard_normal((33, 101)).astype(dtype)
    p = plan(opencl, c)
    out, back = p.forward(columns, weights).astype(np.float64), p.adjoint(columns, weights, g).astype(np.float64)
    # Both sides round sums of the terms g w c; their total size is |g|·|w||c|.
    size = np.sum(np.abs(g) * plan(opencl, np.abs(c)).forward(columns, np.abs(weights)))
    assert abs(np.vdot(g, out) - np.vdot(back, c)) <= 4 * np.finfo(dtype).eps * size


@pytest.mark.parametrize("stride", [3, 53, 1000])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
@pytest.mark.parametrize("dtype", DTYPES)
def test_bits_depend_on_nothing_but_the_query(
    opencl: Backend, rng: Any, dtype: str, grid: tuple[int, ...], stride: int, monkeypatch: Any
) -> None:
    c, columns, weights = case(rng, grid, 45, stride, dtype)
    p = plan(opencl, c)
    whole = p.forward(columns, weights)
    assert np.array_equal(p.forward(columns, weights), whole)
    for query in range(45):
        assert np.array_equal(p.forward(columns[query : query + 1], weights[query : query + 1])[0], whole[query])
    some = rng.integers(0, 45, 60)
    assert np.array_equal(p.forward(columns[some], weights[some]), whole[some])
    g = rng.standard_normal((45, stride)).astype(dtype)
    back = p.adjoint(columns, weights, g)
    assert np.array_equal(p.adjoint(columns, weights, g), back)
    # Nor on how the work is cut into strips and pieces.
    monkeypatch.setattr(spline, "STRIP_BYTES", 1)
    p._rows_at_once = 7
    assert np.array_equal(p.forward(columns, weights), whole)
    assert np.array_equal(p.adjoint(columns, weights, g), back)


@pytest.mark.parametrize("dtype", DTYPES)
def test_knots_give_back_the_data_to_the_bit(opencl: Backend, rng: Any, dtype: str) -> None:
    axes = [SplineAxis(np.linspace(1.5, 1.9, 5)), SplineAxis([0.6, 0.9, 1.4])]
    points = np.stack(np.meshgrid(*(a.knots for a in axes), indexing="ij"), axis=-1).reshape(-1, 2)
    data = rng.standard_normal((15, 333)).astype(dtype)
    assert np.array_equal(plan(opencl, data).forward(*tensor_terms(axes, points)), data)


@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_may_lie_anywhere(opencl: Backend, rng: Any, dtype: str) -> None:
    c, columns, weights = case(rng, (5, 5), 9, 41, dtype)
    expected = plan(opencl, c).forward(columns, weights)
    shifted = np.empty(c.size + 1, dtype)[1:].reshape(c.shape)  # aligned to its element and no more
    shifted[...] = c
    shifted.setflags(write=False)
    around = np.full(expected.size + 2, 7, dtype)
    out = around[1:-1].reshape(expected.shape)
    assert plan(opencl, shifted).forward(columns, weights, out=out) is out
    assert np.array_equal(out, expected) and around[0] == around[-1] == 7
    strided = plan(opencl, np.asfortranarray(c)).forward(np.asfortranarray(columns), weights[:, ::-1][:, ::-1])
    assert np.array_equal(strided, expected)


def test_threads_may_share_a_plan(opencl: Backend, rng: Any) -> None:
    c, columns, weights = case(rng, (5, 5), 40, 500, "float32")
    p = plan(opencl, c)
    pieces = [slice(start, start + 5) for start in range(0, 40, 5)] * 4
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda piece: p.forward(columns[piece], weights[piece]), pieces))
    whole = p.forward(columns, weights)
    assert all(np.array_equal(result, whole[piece]) for piece, result in zip(pieces, results, strict=True))


def test_no_queries_is_no_work(opencl: Backend) -> None:
    p = plan(opencl, np.ones((4, 6), np.float32))
    none = np.empty((0, 3), np.int32), np.empty((0, 3))
    assert p.forward(*none).shape == (0, 6)
    assert not p.adjoint(*none, np.empty((0, 6), np.float32)).any()


def test_bad_input_is_refused(opencl: Backend) -> None:
    p = plan(opencl, np.ones((4, 6), np.float32))
    columns, weights = np.zeros((2, 3), np.int32), np.ones((2, 3))
    for wrong in (-1, 4):
        beyond = columns.copy()
        beyond[1, 2] = wrong
        for call in (p.forward, lambda c, w: p.adjoint(c, w, np.ones((2, 6), np.float32))):
            with pytest.raises(errors.ArgumentError, match=rf"hold {wrong} at index \(1, 2\)"):
                call(beyond, weights)
    with pytest.raises(errors.ShapeError, match="columns"):
        p.forward(columns, weights[:, :2])
    with pytest.raises(errors.DtypeError, match="columns"):
        p.forward(columns.astype(float), weights)
    with pytest.raises(errors.ShapeError, match="out"):
        p.forward(columns, weights, out=np.empty((3, 6), np.float32))
    with pytest.raises(errors.DtypeError, match="out"):
        p.forward(columns, weights, out=np.empty((2, 6)))
    with pytest.raises(errors.ShapeError, match="cotangent"):
        p.adjoint(columns, weights, np.ones((3, 6), np.float32))
    with pytest.raises(errors.ShapeError, match="coefficients"):
        plan(opencl, np.ones((4, 0), np.float32))


def test_too_large_a_model_is_refused_before_it_is_copied(opencl: Backend) -> None:
    huge = np.broadcast_to(np.float32(0), (2**22, 2**22))
    with pytest.raises(errors.DeviceMemoryError, match="coefficients"):
        plan(opencl, huge)
