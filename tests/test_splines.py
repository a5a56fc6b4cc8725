"""Splines against SciPy's, against the paper's formula, and against what splines must reproduce."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicSpline

from accel_shapegen import errors
from accel_shapegen.splines import (
    CARDINAL_KNOTS,
    SplineAxis,
    bases,
    coefficients,
    prefilter,
    tensor,
    tensor_terms,
)

EPS = np.finfo(np.float64).eps
BOUNDARIES = ("natural", "not-a-knot", "clamped")
FORMS = ("cardinal", "local")
COUNTS = (2, 3, 4, 5, 9, 20)


def irregular(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return np.cumsum(rng.uniform(0.1, 1.0, count)) - 2


def regular(count: int) -> NDArray[np.float64]:
    return np.linspace(-0.5, 1.3, count)


def tolerance(knots: NDArray[np.float64], values: NDArray[Any]) -> float:
    # A knot is known to eps·max|λ|, which moves a value by that times the slope, at most about max|value|/min h. The
    # factor is room for a dozen operations and the condition of the end conditions (largest seen: 11).
    return float(64 * EPS * np.abs(knots).max() / np.diff(knots).min() * np.abs(values).max())


def evaluate(axis: SplineAxis, data: NDArray[Any], points: NDArray[np.float64], **options: Any) -> NDArray[Any]:
    """Σ_j w_j c_j along the first axis of the data, written out."""
    starts, weights = axis.weights(points, **options)
    c = axis.prefilter(data)
    assert len(c) == axis.size and weights.shape == (len(points), axis.support)
    return np.stack([sum(w * c[s + j] for j, w in enumerate(row)) for s, row in zip(starts, weights, strict=True)])


def evaluate_grid(axes: Sequence[SplineAxis], data: NDArray[Any], points: NDArray[Any], **options: Any) -> NDArray[Any]:
    columns, weights = tensor_terms(axes, points, **options)
    c = prefilter(axes, data)
    return np.einsum("qt,qtk->qk", weights, c.reshape(-1, c.shape[-1])[columns])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("basis", ["cox-de-boor", "uniform"])
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_equals_scipy(count: int, boundary: str, basis: str, form: str, rng: np.random.Generator) -> None:
    knots = regular(count) if basis == "uniform" else irregular(rng, count)
    data = rng.standard_normal((count, 3)) + 1j * rng.standard_normal((count, 3))
    points = np.concatenate([rng.uniform(knots[0], knots[-1], 40), knots])
    mine = SplineAxis(knots, boundary, basis, form=form)
    theirs = CubicSpline(knots, data, bc_type=boundary)
    for derivative in (0, 1):
        expected = theirs(points, derivative)
        got = evaluate(mine, data, points, derivative=derivative)
        scale = expected if derivative == 0 else data / np.diff(knots).min()
        np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance(knots, scale))


@pytest.mark.parametrize(
    ("counts", "boundaries", "forms"),
    [
        ((5, 5), ("natural", "natural"), ("auto", "auto")),
        ((9, 3), ("natural", "clamped"), ("auto", "auto")),
        ((20, 12), ("not-a-knot", "natural"), ("auto", "auto")),
        ((4, 9, 2), ("clamped", "natural", "not-a-knot"), ("auto", "auto", "auto")),
        ((3, 5, 6), ("not-a-knot", "not-a-knot", "natural"), ("local", "cardinal", "local")),
    ],
)
def test_tensor_product_equals_scipy_axis_by_axis(
    counts: tuple[int, ...], boundaries: tuple[str, ...], forms: tuple[str, ...], rng: np.random.Generator
) -> None:
    knots = [irregular(rng, count) for count in counts]
    axes = [SplineAxis(k, b, form=f) for k, b, f in zip(knots, boundaries, forms, strict=True)]
    data = rng.standard_normal((*counts, 2)) + 1j * rng.standard_normal((*counts, 2))
    points = np.stack([rng.uniform(k[0], k[-1], 15) for k in knots], axis=1)
    for derivative_axis in (None, *range(len(counts))):
        expected = np.empty((len(points), 2), dtype=complex)
        for row, point in enumerate(points):
            values = data
            for j, (k, boundary) in enumerate(zip(knots, boundaries, strict=True)):
                values = CubicSpline(k, values, bc_type=boundary)(point[j], int(j == derivative_axis))
            expected[row] = values
        got = evaluate_grid(axes, data, points, derivative_axis=derivative_axis)
        # Tolerances of the axes add up; a derivative brings 1/h.
        slack = sum(tolerance(k, data) for k in knots) * (1 if derivative_axis is None else 10)
        np.testing.assert_allclose(got, expected, rtol=0, atol=slack)


def beta3(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The centred cubic B-spline by its two pieces."""
    t = np.abs(t)
    return np.where(t < 1, 2 / 3 - t**2 + t**3 / 2, np.where(t < 2, (2 - t) ** 3 / 6, 0))


@pytest.mark.parametrize("count", [2, 5, 14])
def test_model_two_is_the_papers_formula(count: int, rng: np.random.Generator) -> None:
    knots = regular(count)
    step = knots[1] - knots[0]
    points = np.concatenate([rng.uniform(knots[0], knots[-1], 30), knots])
    mine = SplineAxis(knots, basis="uniform", form="local")
    starts, weights = mine.weights(points)
    dense = np.zeros((len(points), mine.size))
    np.put_along_axis(dense, starts[:, None] + np.arange(4), weights, axis=1)
    g = np.arange(1, mine.size + 1)
    np.testing.assert_allclose(
        dense, beta3((points[:, None] - knots[0]) / step - (g - 2)), rtol=0, atol=16 * EPS * count
    )


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_model_one_is_the_full_multiplicity_basis(derivative: int, rng: np.random.Generator) -> None:
    knots = irregular(rng, 7)
    points = np.sort(rng.uniform(knots[0], knots[-1], 50))
    cells = np.searchsorted(knots, points, side="right") - 1
    values = bases.cox_de_boor(knots, cells, points, derivative)
    extended = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
    expected = BSpline(extended, np.eye(9), 3)(points, nu=derivative)
    dense = np.zeros_like(expected)
    np.put_along_axis(dense, cells[:, None] + np.arange(4), values, axis=1)
    np.testing.assert_allclose(dense, expected, rtol=0, atol=64 * EPS * np.abs(expected).max())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_models_one_and_two_agree(count: int, boundary: str, form: str, rng: np.random.Generator) -> None:
    knots = regular(count)
    data = rng.standard_normal((count, 4))
    points = np.concatenate([rng.uniform(knots[0] - 1, knots[-1] + 1, 40), knots])
    one, two = (SplineAxis(knots, boundary, basis, form=form) for basis in ("cox-de-boor", "uniform"))
    assert one.size == two.size
    for derivative in (0, 1):
        options: dict[str, Any] = {"derivative": derivative, "extrapolate": "linear"}
        a, b = (evaluate(model, data, points, **options) for model in (one, two))
        scale = np.abs(a).max() if derivative == 0 else np.abs(data).max() / np.diff(knots).min()
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance(knots, np.array(scale)))


def test_auto_takes_model_two_where_knots_are_equidistant_to_rounding() -> None:
    for knots in ([1.5, 1.6, 1.7, 1.8, 1.9], np.arange(0.5, 1.85, 0.1), np.linspace(-3, 1e3, 14), [7, 9]):
        assert SplineAxis(knots).basis == "uniform"
    for knots in ([1.5, 1.6, 1.7, 1.8, 1.9 + 1e-12], [0, 1, 3], np.linspace(0, 1, 4, dtype=np.float32)):
        assert SplineAxis(knots).basis == "cox-de-boor"
    # Four ulps of a large offset are not four equal steps.
    assert SplineAxis(1e6 + np.array([0, 2, 3, 6]) * np.spacing(1e6)).basis == "cox-de-boor"


def test_auto_takes_the_cardinal_form_up_to_its_limit() -> None:
    few, many = SplineAxis(range(CARDINAL_KNOTS)), SplineAxis(range(CARDINAL_KNOTS + 1))
    assert (few.form, few.size, few.support) == ("cardinal", CARDINAL_KNOTS, CARDINAL_KNOTS)
    assert (many.form, many.size, many.support) == ("local", CARDINAL_KNOTS + 3, 4)


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_local_and_cardinal_form_agree(count: int, boundary: str, rng: np.random.Generator) -> None:
    knots = irregular(rng, count)
    data = rng.standard_normal((count, 4))
    points = rng.uniform(knots[0] - 0.5, knots[-1] + 0.5, 40)
    for derivative in (0, 1):
        options: dict[str, Any] = {"derivative": derivative, "extrapolate": "linear"}
        a, b = (evaluate(SplineAxis(knots, boundary, form=form), data, points, **options) for form in FORMS)
        scale = np.maximum(np.abs(a).max(), np.abs(data).max() / np.diff(knots).min())
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance(knots, scale))


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_interpolation_is_exact_at_the_knots(count: int, boundary: str, rng: np.random.Generator) -> None:
    knots = irregular(rng, count)
    starts, weights = SplineAxis(knots, boundary, form="cardinal").weights(knots)
    assert not starts.any() and np.array_equal(weights, np.eye(count))
    data = rng.standard_normal((count, 2))
    local = evaluate(SplineAxis(knots, boundary, form="local"), data, knots)
    np.testing.assert_allclose(local, data, rtol=0, atol=tolerance(knots, data))


def test_grid_points_give_back_their_data_to_the_bit() -> None:
    axes = [SplineAxis([1.5, 1.6, 1.7, 1.8, 1.9]), SplineAxis([0.6, 0.7, 1.4], "clamped")]
    points = np.stack(np.meshgrid(axes[0].knots, axes[1].knots, indexing="ij"), axis=-1).reshape(-1, 2)
    columns, weights = tensor_terms(axes, points)
    assert np.array_equal(columns, np.tile(np.arange(15), (15, 1)))
    assert np.array_equal(weights, np.eye(15))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_reproduces_the_polynomials_it_must(count: int, boundary: str, form: str, rng: np.random.Generator) -> None:
    knots = irregular(rng, count)
    a, b = knots[0], knots[-1]
    polynomials = {
        "natural": [np.poly1d([2.0, -1])],
        "not-a-knot": [np.poly1d([1.0, -0.5, 2, 1][-count:])],
        # Any cubic that is flat at both ends.
        "clamped": [np.poly1d([3.0]), np.poly1d([2, -3 * (a + b), 6 * a * b, 1])],
    }[boundary]
    points = np.concatenate([rng.uniform(a, b, 30), knots])
    for p in polynomials:
        data = p(knots)[:, None]
        spline = SplineAxis(knots, boundary, form=form)
        got = evaluate(spline, data, points)[:, 0]
        np.testing.assert_allclose(got, p(points), rtol=0, atol=tolerance(knots, data))
        slope = evaluate(spline, data, points, derivative=1)[:, 0]
        np.testing.assert_allclose(slope, p.deriv()(points), rtol=0, atol=tolerance(knots, data / np.diff(knots).min()))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_weights_are_a_partition_of_unity(count: int, boundary: str, form: str, rng: np.random.Generator) -> None:
    knots = irregular(rng, count)
    spline = SplineAxis(knots, boundary, form=form)
    points = rng.uniform(knots[0] - 0.3, knots[-1] + 0.3, 50)
    # In the local form it is the coefficients of the constant that are constant.
    np.testing.assert_allclose(spline.prefilter(np.ones(count)), 1, rtol=0, atol=64 * EPS)
    _, weights = spline.weights(points, extrapolate="linear")
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=0, atol=64 * EPS * max(1, np.abs(weights).max()))
    _, slopes = spline.weights(points, derivative=1, extrapolate="linear")
    np.testing.assert_allclose(slopes.sum(axis=1), 0, rtol=0, atol=64 * EPS * np.abs(slopes).max())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_derivative_is_the_limit_of_differences(boundary: str, form: str, rng: np.random.Generator) -> None:
    axes = [SplineAxis(irregular(rng, 5), boundary, form=form), SplineAxis(regular(6), boundary, form=form)]
    data = rng.standard_normal((5, 6, 3))
    points = np.stack([rng.uniform(s.knots[0] - 0.2, s.knots[-1] + 0.2, 25) for s in axes], axis=1)
    h = 1e-6
    for j in range(2):
        shift = h * np.eye(2)[j]
        ahead, behind = (evaluate_grid(axes, data, points + d, extrapolate="linear") for d in (shift, -shift))
        got = evaluate_grid(axes, data, points, extrapolate="linear", derivative_axis=j)
        # eps/h of rounding, and h times a second derivative where the difference straddles a knot or an end.
        bound = 1e3 * (EPS / h + h) * np.abs(got).max()
        np.testing.assert_allclose((ahead - behind) / (2 * h), got, rtol=0, atol=bound)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("count", COUNTS)
def test_extrapolation_is_the_tangent(count: int, boundary: str, form: str, rng: np.random.Generator) -> None:
    knots = irregular(rng, count)
    data = rng.standard_normal((count, 2))
    spline, theirs = SplineAxis(knots, boundary, form=form), CubicSpline(knots, data, bc_type=boundary)
    far = np.array([0.01, 0.7, 30.0])
    for end, points in ((knots[0], knots[0] - far), (knots[-1], knots[-1] + far)):
        expected = theirs(end) + (points - end)[:, None] * theirs(end, 1)
        got = evaluate(spline, data, points, extrapolate="linear")
        # The slope is known to the tolerance of data/h, and is multiplied by the distance.
        reach = (1 + far[-1]) * np.abs(data).max() / np.diff(knots).min()
        np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance(knots, reach))
        slope = evaluate(spline, data, points, derivative=1, extrapolate="linear")
        expected = np.tile(theirs(end, 1), (3, 1))
        np.testing.assert_allclose(slope, expected, rtol=0, atol=tolerance(knots, data / np.diff(knots).min()))


def test_extrapolation_leaves_inner_queries_alone(rng: np.random.Generator) -> None:
    axes = [SplineAxis([0, 1, 3.0]), SplineAxis(range(12))]
    inside = np.stack([rng.uniform(0, 3, 9), rng.uniform(0, 11, 9)], axis=1)
    mixed = np.concatenate([inside, [[-1, 12], [4, 3]]])
    for derivative_axis in (None, 0, 1):
        c, w = tensor_terms(axes, inside, derivative_axis=derivative_axis)
        c2, w2 = tensor_terms(axes, mixed, extrapolate="linear", derivative_axis=derivative_axis)
        assert np.array_equal(c, c2[:9]) and np.array_equal(w, w2[:9])


def test_a_query_does_not_depend_on_its_batch(rng: np.random.Generator) -> None:
    axes = [SplineAxis(irregular(rng, 5)), SplineAxis(irregular(rng, 11)), SplineAxis(regular(12))]
    points = np.stack([rng.uniform(s.knots[0], s.knots[-1], 67) for s in axes], axis=1)
    columns, weights = tensor_terms(axes, points)
    assert columns.dtype == np.int32 and weights.dtype == np.float64 and columns.shape == (67, 5 * 4 * 4)
    for query in range(67):
        column, weight = tensor_terms(axes, points[query : query + 1])
        assert np.array_equal(column[0], columns[query]) and np.array_equal(weight[0], weights[query])


@pytest.mark.parametrize("dtype", ["float32", "float64", "complex64", "complex128"])
def test_prefilter_in_blocks_keeps_the_dtype(dtype: str, rng: np.random.Generator, monkeypatch: Any) -> None:
    axes = [SplineAxis(irregular(rng, 9)), SplineAxis(irregular(rng, 4)), SplineAxis(irregular(rng, 10), "clamped")]
    data = rng.standard_normal((9, 4, 10, 37)).astype(dtype)
    if dtype.startswith("complex"):
        data = data + (1j * rng.standard_normal(data.shape)).astype(dtype)
    whole = prefilter(axes, data)
    assert whole.dtype == dtype and whole.shape == (11, 4, 12, 37)
    step_by_step = axes[2].prefilter(axes[0].prefilter(data.astype(np.complex128)), axis=2)
    # One rounding to the dtype; the sums behind it are in float64.
    slack = 16 * np.finfo(dtype).eps * np.abs(whole).max()
    np.testing.assert_allclose(whole, step_by_step, rtol=0, atol=slack)
    monkeypatch.setattr(coefficients, "BLOCK_BYTES", 8 * 11 * 4 * 12 * 5)
    np.testing.assert_allclose(prefilter(axes, data), whole, rtol=0, atol=slack)
    monkeypatch.setattr(coefficients, "BLOCK_BYTES", 1)
    np.testing.assert_allclose(prefilter(axes, np.asfortranarray(data)), whole, rtol=0, atol=slack)


def test_prefilter_is_linear_and_does_not_mix_nodes(rng: np.random.Generator) -> None:
    axes = [SplineAxis(irregular(rng, 9)), SplineAxis(regular(10))]
    u, v = rng.standard_normal((2, 9, 10, 5))
    both = prefilter(axes, 2 * u - 3 * v)
    apart = 2 * prefilter(axes, u) - 3 * prefilter(axes, v)
    np.testing.assert_allclose(both, apart, rtol=0, atol=64 * EPS * np.abs(both).max())
    u[4, 4, 2] = np.nan
    assert np.array_equal(np.isnan(prefilter(axes, u)).any(axis=(0, 1)), [False, False, True, False, False])


def test_prefilter_of_cardinal_axes_is_the_data_themselves(rng: np.random.Generator) -> None:
    axes = [SplineAxis(range(3)), SplineAxis(range(8))]
    data = rng.standard_normal((3, 8, 5))
    assert prefilter(axes, data) is data and axes[1].prefilter(data, axis=1) is data
    assert SplineAxis(range(9)).prefilter(np.arange(9)).dtype == np.float64


def test_axis_prefilter_works_along_any_axis(rng: np.random.Generator) -> None:
    spline = SplineAxis(range(9))
    data = rng.standard_normal((3, 9, 2))
    got = spline.prefilter(data, axis=-2)
    expected = np.stack([spline.prefilter(block) for block in data])
    np.testing.assert_allclose(got, expected, rtol=0, atol=16 * EPS * np.abs(expected).max())


@pytest.mark.parametrize(
    ("knots", "options", "words"),
    [
        ([1.0], {}, "at least two"),
        ([], {}, "at least two"),
        ([[1.0, 2.0]], {}, "at least two"),
        ([1, 2, np.nan], {}, "nan at index 2"),
        ([1, np.inf], {}, "inf at index 1"),
        ([1, 2, 2, 3], {}, "2.0 at index 2 after 2.0"),
        ([3, 1], {}, "strictly increasing"),
        ([0, 1, 3], {"basis": "uniform"}, "not equidistant"),
    ],
)
def test_bad_knots_are_refused_by_the_axis_name(knots: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(errors.KnotError, match=words) as caught:
        SplineAxis(knots, name="height", **options)
    assert "height" in str(caught.value)


def test_bad_words_are_refused() -> None:
    for option in ("boundary", "basis", "form"):
        with pytest.raises(errors.ArgumentError, match=option):
            SplineAxis([0, 1], **{option: "periodic"})
    with pytest.raises(errors.ArgumentError, match="extrapolate"):
        SplineAxis([0, 1]).weights([0.5], extrapolate="cubic")  # type: ignore[arg-type]
    with pytest.raises(errors.ArgumentError, match="derivative"):
        SplineAxis([0, 1]).weights([0.5], derivative=2)  # type: ignore[arg-type]
    with pytest.raises(errors.DtypeError):
        SplineAxis(["a", "b"])


@pytest.mark.parametrize("outside", [1.4999, 2.05, np.nextafter(1.9, 2)])
def test_a_query_out_of_range_is_named(outside: float) -> None:
    axes = [SplineAxis([0.6, 1.4], name="rw"), SplineAxis([1.5, 1.9], name="height")]
    points = np.array([[1, 1.6], [1, 1.7], [0.7, outside], [1, 9]])
    with pytest.raises(errors.QueryRangeError) as caught:
        tensor_terms(axes, points)
    message = str(caught.value)
    for part in ("query 2", "height", repr(float(outside)), "[1.5, 1.9]", 'extrapolate="linear"'):
        assert part in message


def test_bad_queries_and_data_are_refused() -> None:
    axes = [SplineAxis([0, 1]), SplineAxis(range(9))]
    with pytest.raises(errors.NonFiniteError, match=r"\(1, 0\)"):
        tensor_terms(axes, [[0, 1], [np.nan, 1]])
    for points in ([0.5, 1], [[0.5, 1, 2]], 0.5):
        with pytest.raises(errors.ShapeError, match="lambdas"):
            tensor_terms(axes, points)
    with pytest.raises(errors.ShapeError, match="lambdas"):
        axes[0].weights([[0.5]])
    with pytest.raises(errors.ArgumentError, match="derivative_axis"):
        tensor_terms(axes, [[0, 1]], derivative_axis=2)
    with pytest.raises(errors.ShapeError, match=r"give \(2, 9, K\)"):
        prefilter(axes, np.zeros((9, 2, 3)))
    with pytest.raises(errors.ShapeError, match="data"):
        axes[1].prefilter(np.zeros((2, 8)), axis=1)
    with pytest.raises(errors.DtypeError):
        prefilter(axes, np.full((2, 9, 1), "a"))


def test_grids_and_queries_too_large_are_refused(monkeypatch: Any) -> None:
    big = SplineAxis(range(1300))
    with pytest.raises(errors.ArgumentError, match=r"1302 × 1302 × 1302"):
        tensor_terms([big] * 3, np.zeros((1, 3)))
    monkeypatch.setattr(tensor, "TERM_LIMIT_BYTES", 5 * 16 * 12)
    assert len(tensor_terms([big] * 2, np.zeros((5, 2)))[0]) == 5
    with pytest.raises(errors.ArgumentError, match="at most 5 queries"):
        tensor_terms([big] * 2, np.zeros((6, 2)))


def test_knots_are_a_copy_and_frozen() -> None:
    knots = np.array([0.0, 1, 3])
    spline = SplineAxis(knots)
    knots[1] = 2
    assert spline.knots[1] == 1
    with pytest.raises(ValueError, match="read-only"):
        spline.knots[0] = 5
    with pytest.raises(AttributeError):
        spline.boundary = "clamped"  # type: ignore[misc]
