"""Voxel bodies on the grid → far fields at scattered nodes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import accel_shapegen as asg
from accel_shapegen.backends.base import Backend

from ..contest import Array, Case, Contender, Run, Settings, Work, aligned_zeros, relative_l2, sampled_items
from ..rivals import nufft
from . import own
from .bodies import KINDS, SEED, box, voxel_bodies

NAME = "scattered_far_field"
BATCH, QUICK_BATCH = 8, 3
# Exact sums over all nodes would take minutes.
SAMPLED_NODES = 500


def cases(settings: Settings) -> Iterator[Case]:
    """One case per kind of body: how much of the grid is empty decides what can be saved."""
    for kind in (settings.body,) if settings.body else KINDS:
        yield _case(settings, kind)


def _case(settings: Settings, kind: str) -> Case:
    grid, nodes = asg.Grid(box(), settings.grid), random_nodes(settings.order)
    batch = settings.batch or (QUICK_BATCH if settings.quick else BATCH)
    values = voxel_bodies(kind, grid, batch, settings.dtype)
    out = aligned_zeros((batch, nodes.size), settings.complex_dtype)
    eps = settings.accuracy()

    def prepare(backend: Backend) -> Run:
        plan = asg.plan_far_field(grid, nodes, batch=batch, eps=eps, dtype=out.dtype, backend=backend)
        return lambda: plan.apply(values, out=out, check=False)

    ours, skipped = own.contenders(NAME, settings, prepare, batch, math.prod(grid.shape), eps)
    return Case(
        name=NAME,
        detail=f"{kind}, {'×'.join(map(str, grid.shape))} cells to {nodes.size} nodes",
        shape={"grid": list(grid.shape), "nodes": [nodes.size]},
        batch=batch,
        dtype=settings.dtype,
        per="body",
        contenders=[*ours, *_rivals(grid, nodes, values, out, eps)],
        out=out,
        error=_Error(grid, nodes, values),
        work=Work(values[0].nbytes, out[0].nbytes),
        skipped=skipped,
    )


def random_nodes(order: tuple[int, int, int]) -> asg.ScatteredNodes:
    """As many nodes as half a lattice of this order has, uniform over the lattice's band."""
    lattice = asg.FourierLattice(box(), order)
    reach = np.array(lattice.step) * lattice.order
    kappa = np.random.default_rng(SEED).uniform(-reach, reach, ((lattice.size + 1) // 2, 3))
    wavenumbers = np.sqrt((kappa**2).sum(axis=1))
    return asg.ScatteredNodes(kappa / wavenumbers[:, None], wavenumbers)


def _rivals(grid: asg.Grid, nodes: asg.ScatteredNodes, values: Array, out: Array, eps: float) -> list[Contender]:
    every = len(values)
    return [
        Contender("finufft-type2", nufft.variants(nufft.type2_scattered(grid, nodes, values, out, eps)), every, eps),
        Contender("finufft-type3", nufft.variants(nufft.type3_scattered(grid, nodes, values, out, eps)), every, eps),
    ]


class _Error:
    """Against exact sums at sampled nodes."""

    def __init__(self, grid: asg.Grid, nodes: asg.ScatteredNodes, values: Array) -> None:
        count = min(SAMPLED_NODES, nodes.size)
        self._sample = np.sort(np.random.default_rng(SEED + 1).choice(nodes.size, count, replace=False))
        sampled = asg.ScatteredNodes(nodes.directions[self._sample], nodes.wavenumbers[self._sample])
        plan = asg.plan_far_field(grid, sampled, dtype="complex128", backend=own.reference())
        self._exact = {item: plan.apply(values[item]) for item in sampled_items(len(values))}

    def __call__(self, result: Array) -> float:
        pairs = [(result[item][self._sample], exact) for item, exact in self._exact.items() if item < len(result)]
        # All nodes are looked at for what is not a number, whether sampled or not.
        return max(relative_l2(*pair) for pair in pairs) if np.isfinite(result).all() else np.inf
