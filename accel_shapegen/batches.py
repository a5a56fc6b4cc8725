"""Leading axes as a batch: how arrays of any lead go through a plan that takes so many bodies at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import ArgumentError, DtypeError, ShapeError

# A one-shot call plans for this many bodies, or for as many as fit in BATCH_BYTES: more gain nothing.
ONE_SHOT_BATCH = 16
BATCH_BYTES = 2**28


def one_shot_batch(count: int, bytes_per_body: int) -> int:
    """Bodies to plan for when a call brings `count` of them."""
    return max(1, min(count, ONE_SHOT_BATCH, BATCH_BYTES // bytes_per_body))


def leading(name: str, shape: tuple[int, ...], tail: tuple[int, ...]) -> tuple[int, ...]:
    """The axes before `tail`; a `ShapeError` where the shape ends otherwise or holds nothing."""
    if len(shape) < len(tail) or shape[len(shape) - len(tail) :] != tail:
        raise ShapeError(name, f"has shape {shape}", f"give (..., {', '.join(map(str, tail))})")
    if 0 in shape:
        raise ShapeError(name, f"has shape {shape}, an empty batch", "give at least one body")
    return shape[: len(shape) - len(tail)]


def output(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The caller's `out` if it is fit to be written, or a new array."""
    if out is None:
        return np.empty(shape, dtype=dtype)
    if not isinstance(out, np.ndarray) or out.dtype != dtype:
        raise DtypeError("out", f"is {getattr(out, 'dtype', type(out).__name__)}", f"give an array of {dtype}")
    if not out.flags.writeable:
        raise ArgumentError("out", "is read-only", "give a writable array")
    if out.shape != shape or not out.flags.c_contiguous:
        raise ShapeError("out", f"has shape {out.shape}", f"give a C-contiguous array of shape {shape}")
    return out


def in_batches(
    operation: Callable[[NDArray[Any], NDArray[Any], slice], object],
    source: NDArray[Any],
    target: NDArray[Any],
    batch: int,
    *,
    exact: bool = False,
) -> None:
    """Run `operation(source[s], target[s], s)` over slices of at most `batch`; of exactly `batch` if `exact`."""
    if exact and len(source) % batch:
        raise ShapeError("batch", f"has {len(source)} bodies", f"the plan has frames for {batch} at a time")
    if np.may_share_memory(source, target):
        # A later batch would read what an earlier one wrote.
        raise ArgumentError("out", "shares memory with the input", "give an array of its own")
    for start in range(0, len(source), batch):
        some = slice(start, min(start + batch, len(source)))
        operation(source[some], target[some], some)
