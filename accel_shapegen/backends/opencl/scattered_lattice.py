"""The lattice of wavenumbers behind scattered nodes: per axis its range and matrices, per node its window.

All of it is made once per plan, in float64. Coordinates y are taken from the grid's centre X, so that phases are
small and every axis has parity; exp(-i κ·X) goes into the node's factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...kernel_window import Window
from ..base import Array


def padded(count: int) -> int:
    """Rounded up to whole vectors of 8."""
    return -(-count // 8) * 8


@dataclass(frozen=True)
class Band:
    """The wavenumbers that nodes need on one axis of `size` points with this spacing [m]; κ in rad/m."""

    size: int
    spacing: float
    lowest: float
    highest: float

    @property
    def half(self) -> int:
        """Points from the centre outwards, the centre included."""
        return (self.size + 1) // 2

    def step(self, window: Window) -> float:
        """Lattice constant 2π/(σL) [rad/m]: the outermost points lie at θ = ±π/σ."""
        return 2 * math.pi / (window.sigma * max(self.size - 1, 1) * self.spacing)

    def width(self, window: Window) -> int:
        """Lattice points that a node sees. A single point at y = 0 has the same transform at every κ: one."""
        return window.width if self.size > 1 else 1

    def range(self, window: Window) -> tuple[int, int]:
        """First and last lattice index m."""
        if self.size == 1:
            return 0, 0
        ends = window.first(np.array([self.lowest, self.highest]) / self.step(window))
        return int(ends[0]), int(ends[1]) + window.width - 1

    def magnitudes(self, window: Window) -> tuple[int, int]:
        """Least |m| and the number of them."""
        low, high = self.range(window)
        least = max(low, -high, 0)
        return least, max(-low, high) - least + 1

    def matrices(self, window: Window) -> Array:
        """cos(|m| θ)/φ̂(θ) and sin(|m| θ)/φ̂(θ), shape (2, half, number of |m|)."""
        least, count = self.magnitudes(window)
        if self.size == 1:
            return np.array([1.0, 0.0]).reshape(2, 1, 1)
        theta = self.angles(window)
        phase = np.multiply.outer(theta, np.arange(least, least + count))
        return np.asarray(np.stack([np.cos(phase), np.sin(phase)]) / window.transform(theta)[:, None])

    def angles(self, window: Window) -> Array:
        """θ = y · step of the points from the centre outwards, shape (half,)."""
        offset = 0.5 if self.size % 2 == 0 else 0.0
        return (np.arange(self.half) + offset) * self.spacing * self.step(window)

    def places(self, window: Window, kappa: Array) -> tuple[Array, Array]:
        """Per node, the first lattice point it sees, counted from the lattice's first, and its weights."""
        if self.size == 1:
            return np.zeros(len(kappa), dtype=np.int64), np.ones((len(kappa), 1))
        s = kappa / self.step(window)
        return window.first(s) - self.range(window)[0], window.weights(s)


@dataclass(frozen=True)
class CentredNodes:
    """Nodes as the lattice serves them: in the grid's own period, mirrored to κ ≥ 0 on the last axis.

    Attributes
    ----------
    kappa : float64, shape (J, d)
        Wavenumbers [rad/m], |κ_j| ≤ π/h_j.
    factor : complex128, shape (J,)
        What the transform about the grid's centre, conjugated where `mirrored`, is to be multiplied by.
    mirrored : bool, shape (J,)
        Where κ stands for -κ; voxels are real, so the transform there is the conjugate.
    bands : tuple of Band
        One per axis.
    """

    kappa: Array
    factor: Array
    mirrored: Array
    bands: tuple[Band, ...]

    @classmethod
    def of(
        cls, kappa: Array, weights: Array, shape: Sequence[int], spacing: Sequence[float], origin: Sequence[float]
    ) -> CentredNodes:
        """From nodes κ [rad/m] and their factors on the grid origin + g · spacing [m]."""
        sizes, steps = np.array(shape), np.array(spacing)
        centre = np.array(origin) + (sizes - 1) / 2 * steps
        # A sum over points h apart has period 2π/h in κ, but for the centre's sign where it lies between points.
        periods = np.round(kappa * steps / (2 * np.pi))
        sign = 1 - 2 * ((periods * (sizes - 1)).sum(axis=1) % 2)
        reduced = kappa - periods * (2 * np.pi / steps)
        mirrored = reduced[:, -1] < 0
        reduced = np.where(mirrored[:, None], -reduced, reduced)
        bands = tuple(
            Band(int(n), float(h), float(band.min()), float(band.max()))
            for n, h, band in zip(shape, spacing, reduced.T, strict=True)
        )
        return cls(reduced, weights * sign * np.exp(-1j * (kappa @ centre)), mirrored, bands)


def cost(window: Window, bands: Sequence[Band], nodes: int) -> float:
    """Relative time of one transform: multiply-adds, of the window dearer than of the matrix products by its loads."""
    halves = [band.half for band in bands]
    counts = [band.magnitudes(window)[1] for band in bands]
    counts[-1] = padded(counts[-1])
    products = sum(math.prod(halves[: j + 1]) * math.prod(counts[j:]) for j in range(len(bands)))
    signed = math.prod(high - low + 1 for low, high in (band.range(window) for band in bands))
    seen = math.prod(band.width(window) for band in bands[:-1]) * padded(bands[-1].width(window))
    return 2 ** len(bands) * products + 8 * signed + 4 * nodes * seen


def crowding(window: Window, bands: Sequence[Band], firsts: Sequence[Array]) -> float:
    """Rounding error of the adjoint, in units of roundoff, if each lattice point adds up its nodes one by one.

    N terms of random sign leave √(N/3) roundings, which the deconvolution multiplies as it does every lattice value;
    `firsts` are the nodes' first lattice points per axis. The mean is taken over the points of the grid.
    """
    blocks = np.stack([first // band.width(window) for first, band in zip(firsts, bands, strict=True)])
    terms = np.unique(blocks, axis=1, return_counts=True)[1].max()
    squares = [np.mean(window.amplification(band.angles(window)) ** 2) for band in bands if band.size > 1]
    return math.sqrt(math.prod(squares) * terms / 3)
