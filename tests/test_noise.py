"""The noise model: its law, its seed, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accel_shapegen.errors import ArgumentError, DtypeError, NonFiniteError, ShapegenError
from accel_shapegen.noise import add_noise


def far_field(shape: tuple[int, ...], dtype: str = "complex128") -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(7)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)


@pytest.mark.parametrize("delta", [0.001, 0.1, 1.0])
def test_law(delta: float) -> None:
    u = far_field((200, 300))
    relative = (add_noise(u, delta, seed=3) - u) / (delta * np.abs(u))
    # r1 exp(iπ r2) is symmetric about 0 and has mean square 1/3; 5 standard errors of 60,000 draws, whose
    # variances are 1/6 per part and E r1⁴ - 1/9 = 4/45. The subtraction adds an error of eps/δ at most.
    assert np.abs(relative).max() <= 1 + 4 * np.finfo(float).eps / delta
    assert abs(relative.mean().real) < 5 * np.sqrt(1 / 6 / u.size)
    assert abs(relative.mean().imag) < 5 * np.sqrt(1 / 6 / u.size)
    assert abs(np.mean(np.abs(relative) ** 2) - 1 / 3) < 5 * np.sqrt(4 / 45 / u.size)
    # |r1| is uniform on (0, 1), the phase on the circle: each tenth holds a tenth.
    for part in (np.abs(relative), np.angle(relative) / (2 * np.pi) + 0.5):
        counts = np.histogram(part, bins=10, range=(0, 1))[0]
        assert np.abs(counts - u.size / 10).max() < 5 * np.sqrt(u.size * 0.09)


def test_formula() -> None:
    u = far_field((3, 4))
    generator = np.random.Generator(np.random.PCG64(8))
    r1, r2 = generator.uniform(-1, 1, (3, 4)), generator.uniform(-1, 1, (3, 4))
    np.testing.assert_array_equal(add_noise(u, 0.3, seed=8), u + 0.3 * r1 * np.abs(u) * np.exp(1j * np.pi * r2))


def test_every_node_has_its_own() -> None:
    noise = add_noise(np.ones((5, 7, 9), complex), 0.5, seed=1) - 1
    assert len(np.unique(noise)) == noise.size


def test_seeded() -> None:
    u = far_field((41, 41))
    assert np.array_equal(add_noise(u, 0.1, seed=5), add_noise(u, 0.1, seed=np.int64(5)))
    assert not np.array_equal(add_noise(u, 0.1, seed=5), add_noise(u, 0.1, seed=6))


def test_single_precision_is_the_same_noise_rounded() -> None:
    u = far_field((41, 41), "complex64")
    single, double = add_noise(u, 0.1, seed=5), add_noise(u.astype("complex128"), 0.1, seed=5)
    assert single.dtype == np.complex64
    assert double.dtype == np.complex128
    # |u| is taken in single precision, and the result is rounded once: 2 eps of a sum of modulus below 1.1 |u|.
    assert np.all(np.abs(single - double) <= 2.2 * np.finfo(np.float32).eps * np.abs(u))


def test_input_is_untouched_and_zero_stays_zero() -> None:
    u = far_field((4, 4))
    u[1, 2] = 0
    before = u.copy()
    assert add_noise(u, 1, seed=0)[1, 2] == 0
    assert np.array_equal(u, before)


@pytest.mark.parametrize(
    ("u", "delta", "seed", "error", "message"),
    [
        ([1.0, 2.0], 0.1, 0, DtypeError, "u: has dtype float64"),
        (["a"], 0.1, 0, DtypeError, "u: has dtype"),
        ([1j, complex(0, np.nan)], 0.1, 0, NonFiniteError, r"u: is .*nan.* at index \(1,\)"),
        ([1j], 0.0, 0, ArgumentError, "delta: is 0.0"),
        ([1j], -0.1, 0, ArgumentError, "delta: is -0.1"),
        ([1j], 1.01, 0, ArgumentError, "delta: is 1.01"),
        ([1j], float("nan"), 0, ArgumentError, "delta: is nan"),
        ([1j], True, 0, ArgumentError, "delta: is True"),
        ([1j], "0.1", 0, ArgumentError, "delta: is '0.1'"),
        ([1j], 0.1, -1, ArgumentError, "seed: is -1"),
        ([1j], 0.1, 1.5, ArgumentError, "seed: is 1.5"),
        ([1j], 0.1, None, ArgumentError, "seed: is None"),
    ],
)
def test_bad_input(u: Any, delta: Any, seed: Any, error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        add_noise(u, delta, seed)
