"""Exact bodies, as smooth voxels: meshes and polygons → what the operations on grids need.

With the outward normal's component n_z along one axis, û(κ) = ∫_D exp(-iκ·y) dy = (i/κ_z) ∮ n_z exp(-iκ·y) dS. Spread
the quadrature points of n_z dS through a window φ onto a grid of spacing h, and sum along z: that is an anti-aliased
voxel body V, half a cell up, and

    û(κ) = h_x h_y h_z sinc(κ_z h_z/2π) / Π_j φ̂_j(κ_j h_j) · Σ_g V_g exp(-iκ·x_g),

without a division by κ_z: neither κ_z = 0 nor κ = 0 is a special case. The factors go into the matrices of
`tensor_transform` or the node weights of `scattered_transform`. Of the axes that with the least ∮ |n_j| dS serves as z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import arguments
from .backends.base import MeshSpreadSpec, ScatteredSpec, Surface, TensorAxis, TensorSpec, ZeroRow
from .errors import ArgumentError
from .kernel_window import WIDTHS, Window
from .nodes import FourierLattice, Nodes, ScatteredNodes, far_field_constant
from .quadrature import Pieces, choose, flux, rules

Array = NDArray[Any]

GAUSS_POINTS = 6
# A body far smaller than a wavelength still gets this many cells: on fewer, its two sides would be a dipole whose
# small difference drowns in the errors of the window.
LEAST_CELLS = 8
# The window's error is the worst over all places in a cell and at the band's edge; spread over a surface, and in the
# mean over the band, this many times less is seen.
WINDOW_SLACK = 4.0
# Of what the pieces may err by in all; where there are many, errors average out and pieces/MEAN_OUT times more is
# granted, within bounds.
QUADRATURE_SLACK, MEAN_OUT, MOST_MEAN = 0.5, 600.0, 40.0
# Windows whose transform is small at the band's edge magnify rounding there; so much of ε it may come to, in the corner
# of the band, where the worst is.
ROUNDING_SLACK = 4.0
# Narrower windows err at the centre of the band, where a body's transform is largest, as much as at its edge.
LEAST_WIDTH = 4
SIGMA_RANGE = (1.25, 4.0)
# The least eps whose three-fold is met on every body tried, rounding included.
LEAST_EPS = {"float32": 1e-6, "float64": 1e-12}
# Cost in cycles of a core: one vector of a point's window, a point apart from that, a cell of the grid.
VECTOR_COST, POINT_COST, CELL_COST = 1.5, 60.0, 10.0


@dataclass(frozen=True, eq=False)
class SmoothGrid:
    """The grid that surfaces are spread on.

    Attributes
    ----------
    shape, spacing, origin : per axis
        Cells, their size [m] and the place of the first [m].
    axis : int
        z, along which is summed.
    windows : tuple of Window
        φ_j.
    """

    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    axis: int
    windows: tuple[Window, ...]

    def points(self, j: int) -> Array:
        """Where V lives on one axis [m]: half a cell up on the axis of the sum."""
        return self.origin[j] + self.spacing[j] * (np.arange(self.shape[j]) + (0.5 if j == self.axis else 0.0))

    def factor(self, j: int, kappa: Array) -> Array:
        """h/φ̂(κh), and sinc(κh/2π) on the axis of the sum, float64 of the shape of `kappa` [rad/m]."""
        h = self.spacing[j]
        result = h / self.windows[j].transform(np.asarray(kappa * h))
        return result * np.sinc(kappa * h / (2 * np.pi)) if j == self.axis else result


def smooth_grid(bounds: Array, greatest: Array, axis: int, eps: float, dtype: np.dtype[Any], points: int) -> SmoothGrid:
    """The cheapest grid and windows for an accuracy.

    Parameters
    ----------
    bounds : float64, shape (2, d)
        Corners of a box around the bodies [m].
    greatest : float64, shape (d,)
        Largest |κ_j| per axis [rad/m].
    axis : int
        The axis of the sum.
    eps, dtype
        Accuracy, and the real dtype of the spread.
    points : int
        Quadrature points of a typical body.
    """
    extent = bounds[1] - bounds[0]
    lanes, unit = 32 // dtype.itemsize, float(np.finfo(dtype).eps) / 2

    def counts(windows: Sequence[Window]) -> list[int]:
        return [_cells(*of) for of in zip(windows, extent, greatest, strict=True)]

    def cost(windows: Sequence[Window]) -> float:
        vectors = math.prod(w.width for j, w in enumerate(windows) if j != axis)
        vectors *= -(-windows[axis].width // lanes)
        if unit * math.prod(window.edge_gain for window in windows) > ROUNDING_SLACK * eps:
            return math.inf
        return points * (vectors * VECTOR_COST + POINT_COST) + math.prod(counts(windows)) * CELL_COST

    windows = min(product(windows_for(WINDOW_SLACK * eps), repeat=len(extent)), key=cost)
    spacing = [_spacing(*of) for of in zip(windows, extent, greatest, strict=True)]
    shape = counts(windows)
    # Centred: what is left over of the cells lies on both sides.
    origin = (bounds[0] + bounds[1]) / 2 - np.array(spacing) * (np.array(shape) - 1) / 2
    return SmoothGrid(tuple(shape), tuple(spacing), tuple(map(float, origin)), axis, windows)


def rounding(grid: SmoothGrid, points: int, dtype: np.dtype[Any]) -> float:
    """About the rounding error of V from adding up this many points, which grows like a random walk."""
    terms = points * math.prod(window.width for window in grid.windows) / math.prod(grid.shape)
    return float(np.finfo(dtype).eps) / 2 * math.sqrt(terms)


def _spacing(window: Window, extent: float, greatest: float) -> float:
    finest = extent / LEAST_CELLS
    return float(min(finest, math.pi / (window.sigma * greatest))) if greatest > 0 else float(finest)


def _cells(window: Window, extent: float, greatest: float) -> int:
    # One more on either side, for the rounding of coordinates and for the half cell; in fours, which fold well.
    count = math.ceil(extent / _spacing(window, extent, greatest)) + window.width + 2
    return -(-count // 4) * 4


@lru_cache(maxsize=64)
def windows_for(error: float) -> tuple[Window, ...]:
    """Per width, the window of least σ whose error is at most `error`."""
    found = []
    for width in WIDTHS[WIDTHS.index(LEAST_WIDTH) :]:
        low, high = SIGMA_RANGE
        if Window(width, high).error() > error:
            continue
        if Window(width, low).error() <= error:
            found.append(Window(width, low))
            break  # a wider one costs more at the same σ
        while high - low > 0.02:
            middle = (low + high) / 2
            low, high = (low, middle) if Window(width, middle).error() <= error else (middle, high)
        found.append(Window(width, high))
    return tuple(found)


def greatest_kappa(nodes: Nodes) -> Array:
    """Largest |κ_j| per axis [rad/m]."""
    if isinstance(nodes, FourierLattice):
        return np.array(nodes.step) * nodes.order
    return np.abs(nodes.kappa).max(axis=0)


def spread_spec(grid: SmoothGrid, dtype: np.dtype[Any]) -> MeshSpreadSpec:
    """The spread onto this grid."""
    return MeshSpreadSpec(grid.shape, grid.axis, grid.windows, rules(len(grid.shape), GAUSS_POINTS), dtype)


def lattice_spec(grid: SmoothGrid, lattice: FourierLattice, batch: int, dtype: np.dtype[Any]) -> TensorSpec:
    """C_{d,k} û(κ) from V on a lattice, zero node included."""
    axes = []
    for j, order in enumerate(lattice.order):
        kappa = lattice.step[j] * np.arange(-order, order + 1)
        axes.append(TensorAxis(grid.points(j), order, lattice.step[j], grid.factor(j, kappa)))
    zero = np.array(lattice.zero_kappa)
    constant = far_field_constant(lattice.wavenumbers, lattice.dim)
    return TensorSpec(tuple(axes), batch, dtype, constant, ZeroRow(lattice.zero_kappa, grid.factor(0, zero)))


def scattered_spec(
    grid: SmoothGrid, nodes: ScatteredNodes, batch: int, dtype: np.dtype[Any], eps: float
) -> ScatteredSpec:
    """The same at scattered nodes."""
    factors = np.prod([grid.factor(j, nodes.kappa[:, j]) for j in range(nodes.dim)], axis=0)
    return ScatteredSpec(
        shape=grid.shape,
        spacing=grid.spacing,
        origin=tuple(float(grid.points(j)[0]) for j in range(nodes.dim)),
        kappa=nodes.kappa,
        eps=eps,
        batch=batch,
        dtype=dtype,
        node_weights=factors * far_field_constant(nodes.wavenumbers, nodes.dim),
    )


def surface(grid: SmoothGrid, greatest: Array, vertices: Array, simplices: Array, eps: float) -> Surface:
    """A mesh or the edges of polygons, cut where they are long against the waves, with a rule each."""
    pieces = _pieces(vertices, simplices, greatest, grid.axis, eps)
    face = math.prod(h for j, h in enumerate(grid.spacing) if j != grid.axis)
    places = (pieces.vertices - np.array(grid.origin)) / np.array(grid.spacing)
    return Surface(places, pieces.simplices, pieces.flux / -face, pieces.rule)


def point_count(vertices: Array, simplices: Array, greatest: Array, axis: int, eps: float) -> int:
    """How many quadrature points `surface` will have."""
    pieces = _pieces(vertices, simplices, greatest, axis, eps)
    counts = np.array([len(rule.weights) for rule in rules(vertices.shape[1], GAUSS_POINTS)])
    return int(counts[pieces.rule].sum())


def quadrature_points(
    vertices: Array, faces: Array, greatest: Array, axis: int | None, eps: float
) -> tuple[Array, Array]:
    """The points that `surface` stands for, (P, 3) [m], and n dS there, (P, 3) [m²], for transforms of other kinds.

    With an axis they are good for n_axis only: pieces that have none are left out.
    """
    pieces = _pieces(vertices, faces, greatest, axis, eps)
    places, fluxes = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for number, rule in enumerate(rules(3, GAUSS_POINTS)):
        own = pieces.simplices[pieces.rule == number]
        normal = np.stack([flux(pieces.vertices, own, j) for j in range(3)], axis=1)
        places.append(np.einsum("qc,tcj->tqj", rule.points, pieces.vertices[own]).reshape(-1, 3))
        fluxes.append((rule.weights[:, None] * normal[:, None, :]).reshape(-1, 3))
    return np.concatenate(places), np.concatenate(fluxes)


def _pieces(vertices: Array, simplices: Array, greatest: Array, axis: int | None, eps: float) -> Pieces:
    slack = QUADRATURE_SLACK * min(max(len(simplices) / MEAN_OUT, 1.0), MOST_MEAN)
    return choose(vertices, simplices, rules(vertices.shape[1], GAUSS_POINTS), greatest, slack * eps, axis)


def amplification(thick: float, bounds: Array, greatest: Array) -> float:
    """By how much more a body thinner than the waves, whose two sides nearly cancel, suffers from errors of each."""
    finest = float((bounds[1] - bounds[0]).max()) / LEAST_CELLS
    cell = min(finest, math.pi / (2 * float(greatest.max()))) if greatest.any() else finest
    return max(1.0, cell / thick)


def areas(vertices: Array, simplices: Array) -> Array:
    """∮ |n_j| dS per axis [m² or m]."""
    return np.array([np.abs(flux(vertices, simplices, j)).sum() for j in range(vertices.shape[1])])


def require_accuracy(eps: float, dtype: np.dtype[Any]) -> None:
    """Refuse an accuracy that the dtype cannot give."""
    real = arguments.real_dtype(dtype)
    least = LEAST_EPS[real.name]
    if eps < least:
        finer = ', or ask for dtype="complex128"' if real == np.float32 else ""
        raise ArgumentError("eps", f"is {eps}", f"give eps >= {least} for meshes with {dtype}{finer}")
