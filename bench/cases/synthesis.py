"""Shape generators on the lattice → fields on the grid."""

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
from .bodies import SEED, box

NAME = "synthesis"
BATCH, QUICK_BATCH = 64, 5
# A general FFT's run of many bodies leaves the caches, and a non-uniform one takes seconds.
FFT_ITEMS, NUFFT_ITEMS = 8, 2


def cases(settings: Settings) -> Iterator[Case]:
    """One case: noise on the lattice, not Hermitian, which the zero-node formula and the real part must handle."""
    grid, lattice = asg.Grid(box(), settings.grid), asg.FourierLattice(box(), settings.order)
    batch = settings.batch or (QUICK_BATCH if settings.quick else BATCH)
    rng = np.random.default_rng(SEED)
    u = aligned_zeros((batch, *lattice.shape), settings.complex_dtype)
    u.real, u.imag = rng.standard_normal((2, *u.shape))
    out = aligned_zeros((batch, *grid.shape), settings.dtype)

    def prepare(backend: Backend) -> Run:
        plan = asg.plan_synthesis(lattice, grid, batch=batch, dtype=u.dtype, backend=backend)
        return lambda: plan.apply(u, out=out, check=False)

    ours, skipped = own.contenders(NAME, settings, prepare, batch, math.prod(grid.shape))
    yield Case(
        name=NAME,
        detail=f"{'×'.join(map(str, lattice.shape))} nodes to {'×'.join(map(str, grid.shape))} cells",
        shape={"nodes": list(lattice.shape), "grid": list(grid.shape)},
        batch=batch,
        dtype=settings.dtype,
        per="body",
        contenders=[*ours, *_rivals(settings, LatticeSum(grid, lattice, u.dtype), u, out)],
        out=out,
        error=_Error(lattice, grid, u),
        work=Work(u[0].nbytes, out[0].nbytes, separable_flop(lattice, grid)),
        skipped=skipped,
    )


def separable_flop(lattice: asg.FourierLattice, grid: asg.Grid) -> int:
    """A real matrix product per axis, the longest last: 2 Σ_j (points made) · (terms of each)."""
    nodes, cells = lattice.shape, grid.shape
    return 2 * sum(math.prod(cells[j:]) * math.prod(nodes[: j + 1]) for j in range(3))


def _rivals(settings: Settings, problem: LatticeSum, u: Array, out: Array) -> list[Contender]:
    few, fewer = (min(len(u), items) for items in (FFT_ITEMS, NUFFT_ITEMS))
    eps = settings.accuracy()
    own_loop = separable.variants(lambda bodies: separable.Synthesis(problem, bodies), u, out)
    return [
        Contender("numpy-separable", own_loop, len(u)),
        Contender("scipy-irfftn", fft.synthesis_variants(problem, u[:few], out[:few], pruned=False), few),
        Contender("scipy-irfft-pruned", fft.synthesis_variants(problem, u[:few], out[:few], pruned=True), few),
        Contender(
            "finufft-type2",
            nufft.variants(nufft.type2_synthesis(problem, u[:fewer], out[:fewer], eps)),
            fewer,
            eps,
        ),
    ]


class _Error:
    """Against the reference, relative to the field less its mean: a large mean would hide everything else."""

    def __init__(self, lattice: asg.FourierLattice, grid: asg.Grid, u: Array) -> None:
        plan = asg.plan_synthesis(lattice, grid, dtype="complex128", backend=own.reference())
        self._exact = {item: plan.apply(u[item]) for item in sampled_items(len(u))}

    def __call__(self, result: Array) -> float:
        errors = []
        for item, exact in self._exact.items():
            if item < len(result):
                mean = exact.mean()
                errors.append(relative_l2(result[item] - mean, exact - mean))
        return max(errors)
