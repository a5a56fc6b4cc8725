"""Error against noise: the theorem's rate for a smooth source, and the slower one that an indicator can have.

For f ∈ H^σ, σ ≥ 1, and N = N(δ), ‖f^δ - f‖² falls at least like δ^(4/(2+d)) (Li, Liu, Tsui, Wang 2020). An indicator is
in H^s for s < 1/2 only: its truncation error² falls like 1/N, so that δ^(2/(2+d)) is what can be seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import bodies
from ..backends.base import Backend
from ..far_field import far_field
from ..geometry import Box
from ..nodes import FourierLattice, far_field_constant, order_from_noise
from ..noise import add_noise
from ..progress import Progress, Report
from ..synthesis import fourier_coefficients
from . import figures
from .page import Figure, Section, Table

Generator = Callable[[FourierLattice], NDArray[np.complex128]]

# How far the slope of an indicator may be from 2/(2+d).
TOLERANCE = 0.1
RADIUS = 1.0


@dataclass(frozen=True)
class Source:
    """A density f with its generator, ‖f‖² and the rate that is expected of it."""

    name: str
    box: Box
    generator: Generator
    square_norm: float
    rate: float
    smooth: bool


def run(
    folder: Path,
    *,
    deltas: Sequence[float] = tuple(np.geomspace(0.002, 0.3, 16)),
    deltas_3d: Sequence[float] = tuple(np.geomspace(0.004, 0.3, 12)),
    seeds: int = 4,
    backend: str | Backend | None = None,
    progress: Progress,
) -> Section:
    """Both sources in the plane and in space."""
    curves = []
    for dim, levels in ((2, deltas), (3, deltas_3d)):
        for source in _sources(dim, backend):
            with progress.stage(f"stability: {source.name}, d = {dim}") as report:
                curves.append(sweep(source, levels, seeds, report))
    figures.draw_stability(folder / "stability.png", curves)
    heads = ["source", "d", "slope measured", "slope expected", "orders N"]
    rows = [
        [
            curve["body"],
            str(curve["dim"]),
            f"{curve['slope']:.3f}",
            f"≥ {curve['rate']:.3f}" if curve["smooth"] else f"{curve['rate']:.3f} ± {TOLERANCE}",
            f"{min(curve['order'])} to {max(curve['order'])}",
        ]
        for curve in curves
    ]
    text = [
        "Noise δ on every node, N = N(δ) with τ = d. Errors are over all of space, by Parseval's theorem: those of the "
        f"coefficients and what lies beyond the lattice; mean of {seeds} draws.",
        "The bump (1 - |x|²)⁴ meets the theorem's δ^(4/(2+d)) and more. An indicator is outside the theorem, and falls "
        "like δ^(2/(2+d)), the rate of its truncation.",
    ]
    shown = [Figure("stability.png", "Squared error against noise, and lines of the expected rates.")]
    return Section("Stability", text, [Table("Slopes of ‖f^δ - f‖²", heads, rows)], shown, {"curves": curves})


def sweep(source: Source, deltas: Sequence[float], seeds: int, report: Report) -> dict[str, Any]:
    """Relative squared errors over noise levels, and the slope of their logarithms."""
    dim = source.box.dim
    orders = [order_from_noise(float(delta), dim) for delta in deltas]
    errors = []
    for done, (delta, order) in enumerate(zip(deltas, orders, strict=True), start=1):
        lattice = FourierLattice(source.box, order)
        exact = source.generator(lattice)
        draws = [_square_error(source, lattice, exact, float(delta), seed) for seed in range(seeds)]
        errors.append(float(np.mean(draws)) / source.square_norm)
        report(done, len(orders))
    slope = float(np.polyfit(np.log(deltas), np.log(errors), 1)[0])
    return {
        "body": source.name,
        "dim": dim,
        "smooth": source.smooth,
        "delta": [float(delta) for delta in deltas],
        "order": orders,
        "relative_error_squared": errors,
        "slope": slope,
        "rate": source.rate,
        "as_expected": slope >= source.rate if source.smooth else abs(slope - source.rate) <= TOLERANCE,
    }


def _square_error(
    source: Source, lattice: FourierLattice, exact: NDArray[np.complex128], delta: float, seed: int
) -> float:
    """‖f^δ_N - f‖² = |V0| Σ_ξ |f̂^δ - f̂|² + ‖f‖² - |V0| Σ_ξ |f̂|²."""
    clean = fourier_coefficients(exact, lattice)
    noisy = fourier_coefficients(add_noise(exact, delta, seed), lattice)
    # The synthesis is real: it takes the Hermitian part.
    hermitian = (noisy + np.flip(noisy).conj()) / 2
    kept = float((np.abs(clean) ** 2).sum())
    return lattice.box.volume * (float((np.abs(hermitian - clean) ** 2).sum()) - kept) + source.square_norm


def _sources(dim: int, backend: str | Backend | None) -> tuple[Source, Source]:
    indicator: Source
    theorem, truncation = 4 / (2 + dim), 2 / (2 + dim)
    if dim == 2:
        kite = bodies.kite(1.2, 1.2, segments=512)

        def of_kite(lattice: FourierLattice) -> NDArray[np.complex128]:
            return far_field(kite, lattice, dtype="complex128", backend=backend)

        indicator = Source("indicator of a kite", Box((7.0, 7.0)), of_kite, kite.volume, truncation, False)
    else:
        ball = bump_generator(0)
        indicator = Source("indicator of a ball", Box((3.0,) * 3), ball, bump_norm(0, 3), truncation, False)
    side = Box((3.0,) * dim)
    return indicator, Source("smooth bump", side, bump_generator(4), bump_norm(4, dim), theorem, True)


def bump_generator(power: int) -> Generator:
    """Of (1 - |x|²/R²)^m on |x| < R: u∞ = C (2π)^(d/2) R^d 2^m m! J_{d/2+m}(t)/t^(d/2+m), t = |κ| R."""

    def generator(lattice: FourierLattice) -> NDArray[np.complex128]:
        from scipy.special import jv

        k = lattice.wavenumbers
        index = lattice.dim / 2 + power
        scale = (2 * math.pi) ** (lattice.dim / 2) * RADIUS**lattice.dim * 2**power * math.factorial(power)
        t = k * RADIUS
        return far_field_constant(k, lattice.dim) * scale * jv(index, t) / t**index

    return generator


def bump_norm(power: int, dim: int) -> float:
    """∫ (1 - |x|²/R²)^(2m) dx = π^(d/2) R^d (2m)!/Γ(d/2 + 2m + 1)."""
    return math.pi ** (dim / 2) * RADIUS**dim * math.factorial(2 * power) / math.gamma(dim / 2 + 2 * power + 1)
