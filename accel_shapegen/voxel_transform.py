"""What a voxel body's transform asks of the operations: axis matrices for a lattice, sources for scattered nodes.

A body in frame coordinates y = (x - c)/σ has cells of h/σ at (x_g - c)/σ; nothing else changes, so frames stay
separable.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import arguments
from .backends.base import ScatteredSpec, TensorAxis, TensorSpec, ZeroRow
from .errors import ArgumentError, DtypeError, OutsideBoxError, ShapeError
from .geometry import Frame, Grid
from .nodes import FourierLattice, ScatteredNodes, far_field_constant

# A body may touch its box: coordinates may stick out by this fraction of the side, which is rounding.
BOX_SLACK = 1e-12


def lattice_spec(
    grid: Grid, lattice: FourierLattice, batch: int, dtype: np.dtype[Any], frames: list[Frame]
) -> TensorSpec:
    """C_{d,k} Π_j h_j sinc(κ_j h_j/2π) Σ_g v_g exp(-iκ·y_g) on a lattice, zero node included."""
    spacing, centre, scale = _cells(grid, frames)
    axes = []
    for j, points in enumerate(grid.axes):
        y = (points - centre[:, j, None]) / scale[:, j, None]
        width = spacing[j] / scale[:, j, None]
        require_within("grid", np.stack([y[:, :1] - width / 2, y[:, -1:] + width / 2]), j, lattice)
        kappa = lattice.step[j] * np.arange(-lattice.order[j], lattice.order[j] + 1)
        weights = width * np.sinc(kappa * width / (2 * np.pi))
        axes.append(TensorAxis(_shared(y), lattice.order[j], lattice.step[j], _shared(weights)))
    first = spacing[0] / scale[:, 0]
    return TensorSpec(
        axes=tuple(axes),
        batch=batch,
        dtype=arguments.real_dtype(dtype),
        node_weights=far_field_constant(lattice.wavenumbers, lattice.dim),
        zero=ZeroRow(lattice.zero_kappa, _shared(first * np.sinc(lattice.zero_kappa * first / (2 * np.pi)))),
    )


def scattered_spec(
    grid: Grid, nodes: ScatteredNodes, batch: int, dtype: np.dtype[Any], frames: list[Frame], eps: float
) -> ScatteredSpec:
    """The same sum at scattered nodes."""
    if len(frames) > 1:
        raise ArgumentError("frame", "is a sequence, with scattered nodes", "give one frame, or plan body by body")
    spacing, centre, scale = _cells(grid, frames)
    width = np.array(spacing) / scale[0]
    voxel = np.prod(width * np.sinc(nodes.kappa * width / (2 * np.pi)), axis=1)
    first = np.array([axis[0] for axis in grid.axes])
    return ScatteredSpec(
        shape=grid.shape,
        spacing=tuple(float(w) for w in width),
        origin=tuple(float(x) for x in (first - centre[0]) / scale[0]),
        kappa=nodes.kappa,
        eps=eps,
        batch=batch,
        dtype=arguments.real_dtype(dtype),
        node_weights=voxel * far_field_constant(nodes.wavenumbers, nodes.dim),
    )


def frame_list(frame: Frame | Sequence[Frame] | None, dim: int, batch: int) -> list[Frame]:
    """One frame for all bodies, or one for each of `batch`; no frame is the identity."""
    if frame is None:
        return [Frame((0.0,) * dim, 1.0)]
    frames = [frame] if isinstance(frame, Frame) else list(frame)
    if not isinstance(frame, Frame) and len(frames) != batch:
        raise ShapeError("frame", f"has {len(frames)} entries", f"give one Frame, or {batch}, one per body of a batch")
    for index, entry in enumerate(frames):
        if not isinstance(entry, Frame):
            raise DtypeError(f"frame[{index}]", f"is a {type(entry).__name__}", "give a Frame")
        if entry.dim != dim:
            raise ShapeError(f"frame[{index}]", f"is {entry.dim}-D", f"give a {dim}-D frame")
    return frames


def require_within(name: str, reach: NDArray[np.float64], axis: int, lattice: FourierLattice) -> None:
    """A body's coordinates on one axis must lie in the lattice's box."""
    half = lattice.box.lengths[axis] / 2
    low, high = float(reach.min()), float(reach.max())
    if max(-low, high) > half * (1 + BOX_SLACK):
        raise OutsideBoxError(
            name,
            f"reaches from {low:.6g} to {high:.6g} m on axis {axis}, outside the lattice's box ±{half:.6g} m",
            "use a larger box, or a frame",
        )


def _cells(grid: Grid, frames: list[Frame]) -> tuple[tuple[float, ...], NDArray[np.float64], NDArray[np.float64]]:
    if grid.spacing is None:
        raise ArgumentError("grid", "is not equidistant", "give a grid with equal cells: Grid(box, shape)")
    return grid.spacing, np.array([f.centre for f in frames]), np.array([f.scale for f in frames])


def _shared(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """One row for all bodies where there is only one frame."""
    shared: NDArray[np.float64] = rows[0] if len(rows) == 1 else rows
    return np.asarray(shared)
