"""The window behind scattered nodes: its transform, what it leaves out, and the choice of width and oversampling."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("pyopencl")  # the window's package loads it

from accel_shapegen.backends.opencl.scattered import LEAST_EPS
from accel_shapegen.kernel_window import SIGMA_RANGE, Window, candidates

WINDOWS = [Window(2, 1.25), Window(3, 2.0), Window(5, 1.5), Window(8, 1.9), Window(13, 2.5), Window(16, 1.3)]
EPS64 = float(np.finfo(np.float64).eps)


@pytest.mark.parametrize("window", WINDOWS, ids=str)
def test_values(window: Window) -> None:
    half = window.width / 2
    values = window.values(np.array([0.0, half, -half, half + 1e-6, 0.6 * half]))
    assert values[0] == 1
    np.testing.assert_allclose(values[1:3], math.exp(-window.beta), rtol=8 * EPS64 * window.beta)
    assert values[3] == 0
    # 1 - 0.6² = 0.8²
    np.testing.assert_allclose(values[4], math.exp(-0.2 * window.beta), rtol=8 * EPS64 * window.beta)


@pytest.mark.parametrize("window", WINDOWS, ids=str)
def test_transform_is_the_integral(window: Window) -> None:
    from scipy.integrate import quad

    def integrand(x: float, theta: float) -> float:
        # t = w/2 (1 - x²) takes the square root's end point away, on which quad would lose digits.
        t = window.width / 2 * (1 - x * x)
        return 2 * window.width * x * float(window.values(np.array(t))) * math.cos(theta * t)

    for theta in (0.0, 0.3, math.pi / window.sigma, 2.0):
        exact, _ = quad(integrand, 0, 1, args=(theta,), epsabs=1e-13, epsrel=1e-13)
        # quad is asked for 1e-13, and the integral is of order 1.
        assert abs(window.transform(np.array(theta)) - exact) < 4e-13


@pytest.mark.parametrize("window", WINDOWS, ids=str)
def test_weights_are_all_that_a_position_sees(window: Window, rng: np.random.Generator) -> None:
    s = np.concatenate([rng.uniform(-50, 50, 200), np.arange(-3, 3) / 2])
    first, weights = window.first(s), window.weights(s)
    assert weights.shape == (len(s), window.width)
    around = np.arange(-30, 31)
    seen = window.values(s[:, None] - (first[:, None] + around))
    inside = (around >= 0) & (around < window.width)
    np.testing.assert_array_equal(seen[:, inside], weights)
    # Only a point that lies on both edges at once could be outside, with the edge's value.
    assert seen[:, ~inside].max() <= math.exp(-window.beta) * (1 + 1e-9)


@pytest.mark.parametrize("window", WINDOWS, ids=str)
def test_error_bounds_the_approximate_wave(window: Window, rng: np.random.Generator) -> None:
    s, theta = rng.uniform(-9, 9, 500), rng.uniform(-1, 1, 500) * math.pi / window.sigma
    m = window.first(s)[:, None] + np.arange(window.width)
    wave = (window.weights(s) * np.exp(-1j * m * theta[:, None])).sum(axis=1) / window.transform(theta)
    error = np.abs(wave - np.exp(-1j * s * theta)).max()
    # `error` is a maximum over samples: others may exceed it a little. Rounding adds a few eps for each term.
    assert error <= 1.2 * window.error() + 16 * window.width * EPS64
    # It is no empty bound either: a tenth of it is reached near the edge.
    assert error >= 0.1 * window.error()


def test_error_falls_with_width_and_oversampling() -> None:
    # From w = 14 and σ = 2 on rounding, 1e-15 or so, shows.
    by_width = [Window(w, 1.8).error() for w in range(2, 15)]
    assert all(b < 0.4 * a for a, b in pairwise(by_width))
    by_sigma = [Window(7, sigma).error() for sigma in (1.3, 1.5, 1.75, 2.0, 2.4)]
    assert all(b < 0.6 * a for a, b in pairwise(by_sigma))


@pytest.mark.parametrize(("sigma", "width"), [(1.5, 10), (2.0, 9), (2.5, 8), (1.75, 12)])
def test_rounding_is_what_float32_shows(sigma: float, width: int, rng: np.random.Generator) -> None:
    window = Window(width, sigma)
    unit = float(np.finfo(np.float32).eps) / 2
    s, theta = rng.uniform(-30, 30, 2000), math.pi / sigma
    m = window.first(s)[:, None] + np.arange(width)
    # Each lattice value carries its own rounding, as those of the matrix products do; the sum itself is exact.
    lattice = np.exp(-1j * m * theta) / window.transform(np.array(theta))
    noisy = lattice * (1 + unit * rng.choice([-1.0, 1.0], lattice.shape))
    error = np.abs((window.weights(s) * (noisy - lattice)).sum(axis=1))
    measured = float(np.sqrt(np.mean(error**2)))
    amplified = window.rounding(1, unit) - 2 * unit
    assert 0.8 * amplified < measured < 1.25 * amplified  # 2000 samples of a random sum: a few percent


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_candidates_keep_their_promise(dtype: str, axes: int) -> None:
    unit = float(np.finfo(dtype).eps) / 2
    for eps in (0.9, 0.1, 1e-3, 1e-6, LEAST_EPS[dtype]):
        found = candidates(2 * eps, axes, unit)
        assert found, f"no window for eps = {eps}"
        assert [w.width for w in found] == sorted({w.width for w in found})
        for window in found:
            assert axes * window.error() + window.rounding(axes, unit) <= 2 * eps
            assert SIGMA_RANGE[0] <= window.sigma <= SIGMA_RANGE[1]
            if window.sigma > SIGMA_RANGE[0] + 0.03:  # the search stops within 0.01 of the least σ
                less = Window(window.width, window.sigma - 0.03)
                assert axes * less.error() + less.rounding(axes, unit) > 2 * eps


def test_no_window_where_rounding_is_larger() -> None:
    unit = float(np.finfo(np.float32).eps) / 2
    assert candidates(2 * unit, 1, unit) == ()
