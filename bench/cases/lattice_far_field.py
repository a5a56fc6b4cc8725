"""Voxel bodies on the grid → shape generators on the lattice, zero node included."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import accel_shapegen as asg
from accel_shapegen.backends.base import Backend

from ..contest import Array, Case, Contender, Run, Settings, Work, aligned_zeros, relative_l2, sampled_items
from ..rivals import fft, nufft, separable
from ..rivals.lattice import LatticeSum
from . import own
from .bodies import box, voxel_bodies
from .synthesis import BATCH, FFT_ITEMS, NUFFT_ITEMS, QUICK_BATCH, separable_flop

NAME = "lattice_far_field"


def cases(settings: Settings) -> Iterator[Case]:
    """One case; only FINUFFT would take advantage of empty voxels, so bodies are dense unless asked otherwise."""
    grid, lattice = asg.Grid(box(), settings.grid), asg.FourierLattice(box(), settings.order)
    batch = settings.batch or (QUICK_BATCH if settings.quick else BATCH)
    kind = settings.body or "dense"
    values = voxel_bodies(kind, grid, batch, settings.dtype)
    out = aligned_zeros((batch, *lattice.shape), settings.complex_dtype)

    def prepare(backend: Backend) -> Run:
        plan = asg.plan_far_field(grid, lattice, batch=batch, dtype=out.dtype, backend=backend)
        return lambda: plan.apply(values, out=out, check=False)

    ours, skipped = own.contenders(NAME, settings, prepare, batch, math.prod(grid.shape))
    yield Case(
        name=NAME,
        detail=f"{kind}, {'×'.join(map(str, grid.shape))} cells to {'×'.join(map(str, lattice.shape))} nodes",
        shape={"grid": list(grid.shape), "nodes": list(lattice.shape)},
        batch=batch,
        dtype=settings.dtype,
        per="body",
        contenders=[*ours, *_rivals(settings, LatticeSum(grid, lattice, out.dtype), values, out)],
        out=out,
        error=_Error(lattice, grid, values),
        work=Work(values[0].nbytes, out[0].nbytes, separable_flop(lattice, grid)),
        skipped=skipped,
    )


def _rivals(settings: Settings, problem: LatticeSum, values: Array, out: Array) -> list[Contender]:
    few, fewer = (min(len(values), items) for items in (FFT_ITEMS, NUFFT_ITEMS))
    eps = settings.accuracy()
    own_loop = separable.variants(lambda bodies: separable.FarField(problem, bodies), values, out)
    return [
        Contender("numpy-separable", own_loop, len(values)),
        Contender("scipy-rfftn", fft.far_field_variants(problem, values[:few], out[:few], pruned=False), few),
        Contender("scipy-rfft-pruned", fft.far_field_variants(problem, values[:few], out[:few], pruned=True), few),
        Contender(
            "finufft-type1",
            nufft.variants(nufft.type1_far_field(problem, values[:fewer], out[:fewer], eps)),
            fewer,
            eps,
        ),
    ]


class _Error:
    """Against the reference over the slots ξ ≠ 0; the zero node, on its own scale, counts where it is worse."""

    def __init__(self, lattice: asg.FourierLattice, grid: asg.Grid, values: Array) -> None:
        plan = asg.plan_far_field(grid, lattice, dtype="complex128", backend=own.reference())
        self._slot = lattice.zero_slot
        self._exact = {item: plan.apply(values[item]) for item in sampled_items(len(values))}

    def __call__(self, result: Array) -> float:
        errors = []
        for item, exact in self._exact.items():
            if item < len(result):
                scale = max(abs(exact[self._slot]), float(np.sqrt(np.mean(np.abs(exact) ** 2))))
                zero = abs(complex(result[item][self._slot]) - exact[self._slot]) / scale
                others = result[item].copy(), exact.copy()
                for array in others:
                    array[self._slot] = 0
                errors.append(max(relative_l2(*others), zero))
        return max(errors)
