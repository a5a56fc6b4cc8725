"""Lattice, scattered nodes, the constant, N(δ)."""

import numpy as np
import pytest

from accel_shapegen import Box, FourierLattice, ScatteredNodes, far_field_constant, order_from_noise
from accel_shapegen.errors import ArgumentError, DtypeError, NonFiniteError, ShapeError


def test_lattice_is_what_the_definition_says() -> None:
    lattice = FourierLattice(Box((2.0, 3.0, 5.0)), (1, 2, 3), mu=0.25)
    assert lattice.shape == (3, 5, 7)
    assert lattice.size == 105
    assert lattice.zero_slot == (1, 2, 3)
    np.testing.assert_array_equal(lattice.xi[0, 0, 0], (-1, -2, -3))
    np.testing.assert_array_equal(lattice.xi[2, 4, 5], (1, 2, 2))
    np.testing.assert_allclose(lattice.kappa[2, 1, 3], (2 * np.pi / 2, -2 * np.pi / 3, 0), rtol=1e-15)
    np.testing.assert_allclose(lattice.kappa[lattice.zero_slot], (2 * np.pi * 0.25 / 2, 0, 0), rtol=1e-15)
    np.testing.assert_allclose(lattice.directions * lattice.wavenumbers[..., None], lattice.kappa, rtol=1e-15)
    assert (lattice.wavenumbers > 0).all()


@pytest.mark.parametrize(
    ("delta", "dim", "tau", "order"),
    [
        (0.01, 2, None, 20),
        (0.01, 3, None, 19),
        (1.0, 3, None, 3),
        (1.0, 2, 2.5, 3),
        (0.05, 3, None, 10),
        (0.0001, 2, 2, 200),
    ],
)
def test_order_from_noise(delta: float, dim: int, tau: float | None, order: int) -> None:
    assert order_from_noise(delta, dim, tau) == order


def test_order_is_the_largest_integer_below_the_bound() -> None:
    for delta in np.geomspace(1e-4, 1, 50):
        bound = 3 * delta ** (-2 / 5) + 1
        order = order_from_noise(float(delta), 3)
        assert order < bound * (1 + 1e-12) <= order + 1 + 1e-9


def test_constant_is_the_physical_one() -> None:
    k = np.array([0.5, 3.0, 8.0])
    general = {
        dim: -1j / np.sqrt(8 * np.pi * k) * (k / (2 * np.pi)) ** ((dim - 2) / 2) * np.exp(-1j * (dim - 1) * np.pi / 4)
        for dim in (2, 3)
    }
    for dim, expected in general.items():
        np.testing.assert_allclose(far_field_constant(k, dim), expected, rtol=4e-16)
        np.testing.assert_allclose(far_field_constant(k, dim, "paper"), expected * np.sqrt(k), rtol=4e-16)
    np.testing.assert_array_equal(far_field_constant(2.0, 3), -1 / (4 * np.pi))


@pytest.mark.parametrize("dim", [2, 3])
def test_pack_keeps_everything(dim: int, rng: np.random.Generator) -> None:
    lattice = FourierLattice(Box((2.0, 3.0, 2.5)[:dim]), (3, 2, 4)[:dim])
    coefficients = rng.normal(size=(2, *lattice.shape)) + 1j * rng.normal(size=(2, *lattice.shape))
    flat = coefficients.reshape(2, -1)
    hermitian = (flat + flat[:, ::-1].conj()).reshape(coefficients.shape)
    half = lattice.pack(hermitian, symmetry="fourier")
    assert half.shape == (2, (lattice.size + 1) // 2)
    np.testing.assert_array_equal(lattice.unpack(half, symmetry="fourier"), hermitian)
    # A shape generator is C_{d,k} times a Hermitian array.
    generator = hermitian * far_field_constant(lattice.wavenumbers, dim)
    np.testing.assert_allclose(lattice.unpack(lattice.pack(generator)), generator, rtol=1e-14)


def test_pack_refuses_what_it_would_lose(rng: np.random.Generator) -> None:
    lattice = FourierLattice(Box((2.0, 3.0)), 2)
    u = rng.normal(size=lattice.shape) + 1j * rng.normal(size=lattice.shape)
    with pytest.raises(ArgumentError, match="u: is not the mirror"):
        lattice.pack(u)
    with pytest.raises(DtypeError, match="u: has dtype float64"):
        lattice.pack(u.real)
    with pytest.raises(ShapeError, match=r"half: has shape \(3,\)"):
        lattice.unpack(np.zeros(3, complex))
    with pytest.raises(ArgumentError, match="symmetry"):
        lattice.pack(u, symmetry="other")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: FourierLattice((1, 1), 3), DtypeError, "box: is a tuple"),
        (lambda: FourierLattice(Box((1, 1)), 0), ArgumentError, "order: is 0"),
        (lambda: FourierLattice(Box((1, 1)), (1, 2, 3)), ShapeError, "order: has 3 entries"),
        (lambda: FourierLattice(Box((1, 1)), 2.5), ArgumentError, "order: is 2.5"),
        (lambda: FourierLattice(Box((1, 1)), True), ArgumentError, "order"),
        (lambda: FourierLattice(Box((1, 1)), 2, mu=0), ArgumentError, "mu: is 0"),
        (lambda: FourierLattice(Box((1, 1)), 2, mu=float("nan")), ArgumentError, "mu: is nan"),
        (lambda: ScatteredNodes(np.ones((3, 3)), 1.0), ArgumentError, "directions: has length 1.73205081 at index 0"),
        (lambda: ScatteredNodes([[1.0, 0.0]], [0.0]), ArgumentError, "wavenumbers: is 0.0 at index 0"),
        (lambda: ScatteredNodes([[1.0, 0.0]], [1.0, 2.0]), ShapeError, "wavenumbers: has shape"),
        (lambda: ScatteredNodes([[np.nan, 0.0]], [1.0]), NonFiniteError, r"directions: is nan at index \(0, 0\)"),
        (lambda: ScatteredNodes([1.0, 0.0], [1.0]), ShapeError, "directions: has shape"),
        (lambda: far_field_constant(0.0, 3), ArgumentError, "k: is 0.0"),
        (lambda: far_field_constant(1.0, 4), ArgumentError, "dim: is 4"),
        (lambda: far_field_constant(1.0, 3, "printed"), ArgumentError, "convention"),
        (lambda: order_from_noise(0.0, 3), ArgumentError, "delta: is 0.0"),
        (lambda: order_from_noise(1.5, 3), ArgumentError, "delta: is 1.5"),
        (lambda: order_from_noise(0.1, 3, tau=2), ArgumentError, "tau: is 2"),
        (lambda: order_from_noise(0.1, 1), ArgumentError, "dim: is 1"),
        (lambda: order_from_noise("x", 2), ArgumentError, "delta: is 'x'"),
        (lambda: order_from_noise(0.1, 2, tau="x"), ArgumentError, "tau: is 'x'"),
        (lambda: FourierLattice(Box((1, 1)), 2, mu=None), ArgumentError, "mu: is None"),
        (lambda: FourierLattice(Box((1, 1)), 10**12), ArgumentError, "order: is 1000000000000"),
        (lambda: ScatteredNodes([[1.0, 0.0]], [1e-170]), ArgumentError, "wavenumbers: is 1e-170"),
        (lambda: Box((1e-110, 1.0)), ArgumentError, "lengths: is 1e-110"),
    ],
)
def test_bad_input(make, error, message) -> None:
    with pytest.raises(error, match=message):
        make()
