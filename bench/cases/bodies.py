"""Voxel bodies of three kinds: nearly empty, an eighth full, and full."""

from __future__ import annotations

import numpy as np

import accel_shapegen as asg

from ..contest import Array, aligned_zeros

BOX_LENGTH = 2.2  # [m], around human bodies
KINDS = ("human", "ellipsoid", "dense")
SEED = 20


def box() -> asg.Box:
    """The cube that bodies and lattices share."""
    return asg.Box((BOX_LENGTH,) * 3)


def voxel_bodies(kind: str, grid: asg.Grid, count: int, dtype: str) -> Array:
    """`count` bodies that differ a little, (count, *grid.shape).

    Human bodies of 1.5 to 1.9 m and mixed weight; ellipsoids that fill about 12 % of the box; normal noise in every
    cell, of mean 0, which no contender can crop.
    """
    values = aligned_zeros((count, *grid.shape), dtype)
    rng = np.random.default_rng(SEED)
    if kind == "dense":
        values[...] = rng.standard_normal(values.shape, dtype=np.float64)
        return values
    spread = np.linspace(0, 1, count) if count > 1 else np.array([0.5])
    for body, t in enumerate(spread):
        values[body] = _human(grid, t) if kind == "human" else _ellipsoid(grid, t)
    return values


def _human(grid: asg.Grid, t: float) -> Array:
    # Weights run out of step with heights, so that a batch covers both.
    mesh = asg.bodies.human(1.5 + 0.4 * t, 0.6 + 0.8 * ((3 * t) % 1.0))
    return asg.voxelize(mesh, grid).values


def _ellipsoid(grid: asg.Grid, t: float) -> Array:
    # 4π/3 · 0.31 · 0.25 · 0.37 = 0.12 of the box.
    axes = BOX_LENGTH * np.array([0.31, 0.25, 0.37]) * (0.95 + 0.1 * t)
    return (grid.points() ** 2 / axes**2).sum(axis=-1) <= 1
