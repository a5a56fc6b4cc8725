"""The exponential-of-semicircle window: how a plane wave is read off a lattice of few plane waves.

For a window φ of width w, with transform φ̂(θ) = ∫ φ(t) cos(θt) dt, Poisson's sum gives

    e^{-isθ} ≈ 1/φ̂(θ) · Σ_m φ(s - m) e^{-imθ},        |θ| ≤ π/σ, σ > 1,

a sum of w terms. What is left out is φ̂(θ + 2πp)/φ̂(θ), p ≠ 0, which falls exponentially with w and grows with
|θ|: the oversampling σ keeps θ away from π, where φ̂ and its first copy are equal.

Source: A. H. Barnett, J. Magland, L. af Klinteberg, "A parallel nonuniform fast Fourier transform library based
on an 'exponential of semicircle' kernel", SIAM J. Sci. Comput. 41 (2019), for φ, its β and its transform.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# With matrix products in the place of an FFT, σ is free. Wider windows than the last cannot be told from it in
# float64; a larger σ than the greatest costs more than one more point of width.
WIDTHS = range(2, 17)
SIGMA_RANGE = (1.25, 2.5)
# β / (π w (1 - 1/(2σ))), found by minimising `error` over σ = 1.3 .. 2.3; 0.98, the value of the source, from 8 on.
_SHARPNESS = {2: 0.83, 3: 0.86, 4: 0.90, 5: 0.94, 6: 0.96, 7: 0.97}


@dataclass(frozen=True)
class Window:
    """φ(t) = exp(β (√(1 - (2t/w)²) - 1)) for |t| ≤ w/2, else 0.

    Attributes
    ----------
    width : int
        w, in lattice steps.
    sigma : float
        σ: the window serves |θ| ≤ π/σ.
    """

    width: int
    sigma: float

    @property
    def beta(self) -> float:
        """β, just below π w (1 - 1/(2σ)), where the first copy would begin at the cut-off of φ̂."""
        return _SHARPNESS.get(self.width, 0.98) * math.pi * self.width * (1 - 0.5 / self.sigma)

    def values(self, t: Float) -> Float:
        """φ(t), same shape as `t`."""
        inside = 1 - (2 * t / self.width) ** 2
        # A point that rounding put just outside the edge has the edge's value, e^-β.
        return np.where(inside < -1e-12, 0.0, np.exp(self.beta * (np.sqrt(np.maximum(inside, 0)) - 1)))

    def first(self, s: Float) -> NDArray[np.int64]:
        """The first of the w lattice points that see position `s`."""
        return np.ceil(s - self.width / 2).astype(np.int64)

    def weights(self, s: Float) -> Float:
        """φ(s - m) for m = first, first + 1, .., shape (*s.shape, w)."""
        return self.values((s - self.first(s))[..., None] - np.arange(self.width))

    @cached_property
    def _rule(self) -> tuple[Float, Float]:
        # In t = (w/2) sin u the integrand is analytic: without the root at the edge, Gauss's rule converges fast.
        u, weight = _gauss()
        shape = np.cos(u) * np.exp(self.beta * (np.cos(u) - 1))
        return self.width / 2 * np.sin(u), self.width / 2 * weight * shape

    def transform(self, theta: Float) -> Float:
        """φ̂(θ) = ∫ φ(t) cos(θt) dt, same shape as `theta`."""
        t, weight = self._rule
        return np.asarray(np.cos(np.multiply.outer(theta, t)) @ weight)

    def error(self) -> float:
        """max over |θ| ≤ π/σ and s of |Σ_m φ(s - m) e^{i(s-m)θ} / φ̂(θ) - 1|, sampled."""
        # The error grows towards the edge of θ, and its phase turns once with s: few samples find the maximum.
        theta = np.pi / self.sigma * np.array([0.0, 0.5, 0.75, 0.875, 0.9375, 1.0])
        s = np.arange(16) / 16
        offset = (s - self.first(s))[:, None] - np.arange(self.width)
        sums = (self.weights(s)[:, None, :] * np.exp(1j * offset[:, None, :] * theta[:, None])).sum(axis=-1)
        return float(np.abs(sums / self.transform(theta) - 1).max())

    @cached_property
    def edge_gain(self) -> float:
        """φ̂(0)/φ̂(π/σ): how much more is deconvolved at the edge of the band than at its centre."""
        middle, edge = self.transform(np.array([0.0, np.pi / self.sigma]))
        return float(middle / edge)

    def rounding(self, axes: int, unit: float) -> float:
        """Rounding error, for a unit roundoff, of the transform of a voxel at θ = π/σ on every axis.

        The deconvolution there makes the lattice's values φ̂(0)/φ̂(π/σ) times larger than their sum through the
        window, which does not cancel their rounding: that averages to |φ|_2 / |φ|_1 of it on each axis.
        """
        return unit * float(2 + self.amplification(np.array(np.pi / self.sigma)) ** axes)

    def amplification(self, theta: Float) -> Float:
        """φ̂(0)/φ̂(θ) · |φ|_2/|φ|_1: rounding of lattice values as it appears at θ, same shape as `theta`."""
        t, weight = self._rule
        return math.sqrt(float(weight @ self.values(t))) / self.transform(theta)


@cache
def _gauss() -> tuple[Float, Float]:
    """Nodes and weights on [-π/2, π/2]; 100 are enough for θ t up to 16 π and β up to 50, to 1e-15."""
    u, weight = np.polynomial.legendre.leggauss(100)
    return u * math.pi / 2, weight * math.pi / 2


@lru_cache(maxsize=64)
def candidates(error: float, axes: int, unit: float) -> tuple[Window, ...]:
    """Per width, the window of least σ whose error is at most `error` over so many axes, rounding included.

    Parameters
    ----------
    error : float
        Bound, relative to Σ|v|: for the worst voxel, one at θ = π/σ on all axes.
    axes : int
        Number of axes, whose errors add up.
    unit : float
        Unit roundoff of the dtype that the transform is done in.
    """

    def good(window: Window) -> bool:
        return axes * window.error() + window.rounding(axes, unit) <= error

    found = []
    for width in WIDTHS:
        low, high = SIGMA_RANGE
        if not good(Window(width, high)):
            continue
        if good(Window(width, low)):
            found.append(Window(width, low))
            break  # a wider one costs more at the same σ
        while high - low > 0.01:
            middle = (low + high) / 2
            low, high = (low, middle) if good(Window(width, middle)) else (middle, high)
        found.append(Window(width, high))
    return tuple(found)
