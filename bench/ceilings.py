"""What the machine could do at most, measured in the same rounds as the contenders."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .contest import Array, Case, aligned_zeros
from .machine import thread_count, thread_pool

# Large enough for full speed, small enough to run in a few milliseconds.
GEMM_SIZE, QUICK_GEMM_SIZE = 1024, 64
# Beyond the last-level cache of a core complex, so that memory is what is measured.
COPY_BYTES, QUICK_COPY_BYTES = 128 * 2**20, 2**20


@dataclass(frozen=True)
class Ceiling:
    """A probe: `run` takes a time t, of which `value(t)` makes the figure in the unit its name ends with."""

    name: str
    run: Callable[[], object]
    value: Callable[[float], float]


def probes(case: Case, quick: bool) -> list[Ceiling]:
    """GEMM rates of NumPy's BLAS, copy bandwidth each way, and the time to write one output of the case."""
    size = QUICK_GEMM_SIZE if quick else GEMM_SIZE
    pool = thread_pool()
    source, target = (aligned_zeros((QUICK_COPY_BYTES if quick else COPY_BYTES,), np.uint8) for _ in range(2))
    written = aligned_zeros((case.out.nbytes,), np.uint8)
    return [
        *(_gemm(size, dtype) for dtype in ("float32", "float64")),
        Ceiling("copy_bytes_per_s", lambda: _copy(pool, source, target), lambda t: source.nbytes / t),
        Ceiling("stream_write_s", lambda: _write(pool, written), lambda t: t / case.batch),
    ]


def fractions(case: Case, ceilings: dict[str, float], median: float) -> dict[str, float | None]:
    """Each ceiling's time for one item over the time taken; 1 is the ceiling.

    The arithmetic is that of plain real matrix products, so a way that needs less of it can exceed 1.
    """
    moved = (case.work.read_bytes + case.work.write_bytes) / (2 * ceilings["copy_bytes_per_s"])
    rate = ceilings[f"gemm_{case.dtype}_flop_per_s"]
    return {
        "write": ceilings["stream_write_s"] / median,
        "copy": moved / median,
        "gemm": None if case.work.flop is None else case.work.flop / rate / median,
    }


def _gemm(size: int, dtype: str) -> Ceiling:
    rng = np.random.default_rng(0)
    a, b = (rng.standard_normal((size, size)).astype(dtype) for _ in range(2))
    out = np.empty_like(a)
    return Ceiling(f"gemm_{dtype}_flop_per_s", lambda: np.matmul(a, b, out=out), lambda t: 2 * size**3 / t)


def _copy(pool: ThreadPoolExecutor, source: Array, target: Array) -> None:
    # NumPy's copy and the C library's memset release the interpreter's lock.
    list(pool.map(lambda part: np.copyto(target[part], source[part]), _parts(source.size)))


def _write(pool: ThreadPoolExecutor, target: Array) -> None:
    # memset turns to streaming stores for large blocks, which NumPy's fill never does.
    address = target.ctypes.data
    list(pool.map(lambda part: ctypes.memset(address + part.start, 0, part.stop - part.start), _parts(target.size)))


def _parts(size: int) -> list[slice]:
    edges = np.linspace(0, size, thread_count() + 1).astype(int)
    return [slice(int(start), int(stop)) for start, stop in pairwise(edges)]
