"""A trained model → shape generators at new characteristic values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import accel_shapegen as asg
from accel_shapegen.backends.base import Backend

from ..contest import Array, Case, Contender, Run, Settings, Work, aligned_zeros, relative_l2, sampled_items
from ..rivals import splines
from . import own
from .bodies import SEED, box

NAME = "spline"
BATCH, QUICK_BATCH = 32, 5
CUBIC_SPLINE_ITEMS = 4  # queries; each takes tens of milliseconds
KNOTS = (np.linspace(1.5, 1.9, 5), np.linspace(0.6, 1.4, 5))  # heights [m] and relative weights


def cases(settings: Settings) -> Iterator[Case]:
    """One case: 5×5 training bodies, natural ends, noise for data - the arithmetic is the same."""
    lattice = asg.FourierLattice(box(), settings.order)
    batch = settings.batch or (QUICK_BATCH if settings.quick else BATCH)
    rng = np.random.default_rng(SEED)
    u = aligned_zeros((*(len(axis) for axis in KNOTS), *lattice.shape), settings.complex_dtype)
    u.real, u.imag = rng.standard_normal((2, *u.shape))
    queries = rng.uniform([axis[0] for axis in KNOTS], [axis[-1] for axis in KNOTS], (batch, 2))
    out = aligned_zeros((batch, *lattice.shape), u.dtype)

    def prepare(backend: Backend) -> Run:
        model = asg.ShapeModel.fit(KNOTS, u, lattice, backend=backend)
        return lambda: model.predict(queries, out=out)

    ours, skipped = own.contenders(NAME, settings, prepare, batch, lattice.size)
    bodies = u.shape[0] * u.shape[1]
    yield Case(
        name=NAME,
        detail=f"{u.shape[0]}×{u.shape[1]} bodies of {lattice.size} complex nodes",
        shape={"bodies": list(u.shape[:2]), "nodes": list(lattice.shape)},
        batch=batch,
        dtype=settings.dtype,
        per="query",
        contenders=[*ours, *_rivals(u, queries, out)],
        out=out,
        error=_Error(u, lattice, queries),
        # The data are read once for all queries.
        work=Work(u.nbytes // batch, out[0].nbytes, 2 * bodies * 2 * lattice.size),
        skipped=skipped,
    )


def _rivals(u: Array, queries: Array, out: Array) -> list[Contender]:
    few = min(len(queries), CUBIC_SPLINE_ITEMS)
    return [
        Contender("numpy-gemm", {"cardinal weights": lambda: splines.gemm(KNOTS, u, queries, out)}, len(queries)),
        Contender(
            "scipy-cubicspline",
            {"one query at a time": lambda: splines.per_query(KNOTS, u, queries[:few], out[:few])},
            few,
        ),
        Contender(
            "scipy-ndbspline",
            {"all queries at once": lambda: splines.tensor_b_spline(KNOTS, u, queries, out)},
            len(queries),
        ),
    ]


class _Error:
    """Against the reference backend's spline of the same data in float64."""

    def __init__(self, u: Array, lattice: asg.FourierLattice, queries: Array) -> None:
        model = asg.ShapeModel.fit(KNOTS, u.astype(np.complex128), lattice, backend=own.reference())
        items = sampled_items(len(queries))
        self._exact = dict(zip(items, model.predict(queries[items]), strict=True))

    def __call__(self, result: Array) -> float:
        pairs = [(result[item], exact) for item, exact in self._exact.items() if item < len(result)]
        return max(relative_l2(*pair) for pair in pairs)
