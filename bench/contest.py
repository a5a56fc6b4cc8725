"""What is compared: a case is one sum on fixed data, a contender one library's way to compute it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Run = Callable[[], Array]  # computes all items of a contender once and returns them, shape (items, ...)

# A transfer between caches or threads may go in lines, pages or vectors; a page fits them all.
ALIGNMENT = 4096


@dataclass(frozen=True)
class Settings:
    """What the command line asks of every case; None leaves a choice to the case."""

    grid: tuple[int, int, int] = (100, 100, 100)
    order: tuple[int, int, int] = (19, 19, 19)
    batch: int | None = None
    dtype: str = "float32"
    eps: float | None = None
    body: str | None = None
    devices: tuple[str, ...] = ()
    quick: bool = False

    @property
    def complex_dtype(self) -> np.dtype[Any]:
        """complex64 or complex128."""
        return np.result_type(np.dtype(self.dtype), np.complex64)

    def accuracy(self) -> float:
        """What is asked of contenders that approximate: near the best that the dtype allows."""
        return self.eps or (1e-6 if self.dtype == "float32" else 1e-12)


@dataclass(frozen=True)
class Contender:
    """One library's way to a case's output.

    Attributes
    ----------
    name : str
        Starts with the library's name.
    variants : mapping of str to callable
        Ways to set it up, each planning everything and returning a `Run`. The fastest that is accurate is timed.
    items : int
        Bodies or queries in one run; slow contenders bring fewer than the case's batch.
    eps : float, optional
        The accuracy asked of it; None where it sums to rounding.
    """

    name: str
    variants: Mapping[str, Callable[[], Run]]
    items: int
    eps: float | None = None


@dataclass(frozen=True)
class Skipped:
    """A contender that was left out, and why."""

    case: str
    contender: str
    reason: str


@dataclass(frozen=True)
class Work:
    """What one item costs at least: the arithmetic of plain real matrix products, and the data moved once."""

    read_bytes: int
    write_bytes: int
    flop: int | None = None


@dataclass(frozen=True)
class Case:
    """One sum on fixed data, its contenders, and how wrong an answer is.

    Attributes
    ----------
    out : array, shape (batch, ...)
        Where contenders put their output; its pages exist before anything is timed.
    error : callable
        Relative L2 error against the float64 reference of an output (items, ...), the worst of a few items.
    """

    name: str
    detail: str
    shape: dict[str, list[int]]
    batch: int
    dtype: str
    per: str
    contenders: Sequence[Contender]
    out: Array
    error: Callable[[Array], float]
    work: Work
    skipped: Sequence[Skipped] = field(default=())


def aligned_zeros(shape: tuple[int, ...], dtype: Any) -> Array:
    """A page-aligned array whose pages have been touched."""
    dtype = np.dtype(dtype)
    nbytes = math.prod(shape) * dtype.itemsize
    raw = np.empty(nbytes + ALIGNMENT, dtype=np.uint8)
    raw.fill(0)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + nbytes].view(dtype).reshape(shape)


def sampled_items(batch: int) -> list[int]:
    """Items whose error is measured: enough to catch one that was mixed up, few enough to be quick."""
    return sorted({0, min(2, batch - 1), batch // 2, batch - 1})


def relative_l2(result: Array, exact: Array) -> float:
    """‖result - exact‖ / ‖exact‖ in float64; infinite where the result holds a NaN or an infinity."""
    difference = float(np.linalg.norm((result - exact).ravel()))
    return difference / float(np.linalg.norm(exact.ravel())) if math.isfinite(difference) else math.inf
