"""Checks on arguments at the public boundary: what is refused, and how the refusal reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ArgumentError, DtypeError, NonFiniteError, ShapeError

# Counts above this overflow the 32-bit indices of kernels, and no machine holds such arrays.
MOST = 2**31 - 1
REAL_OF = {"complex64": "float32", "complex128": "float64"}


def complex_dtype(name: str, dtype: Any) -> np.dtype[Any]:
    """The requested precision as complex64 or complex128; anything else is refused."""
    try:
        resolved = np.dtype(dtype).newbyteorder("=")
    except TypeError:
        resolved = None
    if resolved is None or resolved.name not in REAL_OF:
        raise DtypeError(name, f"is {dtype!r}", 'give "complex64" or "complex128"')
    return resolved


def real_dtype(dtype: Any) -> np.dtype[Any]:
    """The real dtype of the same precision as complex64 or complex128."""
    return np.dtype(REAL_OF[np.dtype(dtype).name])


def plain_array(name: str, value: ArrayLike) -> NDArray[Any]:
    """`value` as an array of whatever dtype it has; ragged nests and masked entries are refused by name."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise ArgumentError(name, "has masked entries", "fill them, for instance with value.filled(0)")
    try:
        return np.asarray(value)
    except ValueError as error:
        raise ShapeError(name, f"is not an array ({error})", "give rows of equal length") from error


def real_array(name: str, value: ArrayLike, dtype: Any, *, check: bool = True) -> NDArray[Any]:
    """`value` as a real array of `dtype`: floats, integers and booleans are converted to it.

    Complex, float16, object and string arrays raise `DtypeError`; a value that is not finite
    raises `NonFiniteError` with its first index, unless `check` is false.
    """
    array = plain_array(name, value)
    if array.dtype.kind not in "fiub" or array.dtype == np.float16:
        raise DtypeError(name, f"has dtype {array.dtype}", "give float32, float64, integer or boolean values")
    if check:
        require_finite(name, array)
    with np.errstate(over="ignore"):  # an overflow becomes an infinity, which the second scan names
        converted = array.astype(dtype, copy=False)
    if check and converted.dtype.kind == "f" and converted.itemsize < array.itemsize:
        require_finite(name, converted, suffix=f" once converted to {converted.dtype}")
    return converted


def complex_array(name: str, value: ArrayLike, dtype: Any, *, check: bool = True) -> NDArray[Any]:
    """`value` as a complex array of `dtype`; real values are taken as complex ones."""
    array = plain_array(name, value)
    if array.dtype.kind not in "cfiub" or array.dtype == np.float16:
        raise DtypeError(name, f"has dtype {array.dtype}", "give complex64 or complex128 values")
    if check:
        require_finite(name, array)
    with np.errstate(over="ignore"):
        converted = array.astype(dtype, copy=False)
    if check and converted.itemsize < array.itemsize:
        require_finite(name, converted, suffix=f" once converted to {converted.dtype}")
    return converted


def require_finite(name: str, array: NDArray[Any], *, suffix: str = "") -> None:
    """Raise `NonFiniteError` naming the first index of a NaN or infinity."""
    if array.dtype.kind not in "fc" or array.size == 0:
        return
    # One pass without a temporary: a sum is finite when all values are (overflow is settled below).
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(array.sum()):
            return
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise NonFiniteError(name, f"is {array[index]} at index {index}{suffix}", "give finite values")


def require_in_range(name: str, result: NDArray[Any], dtype: Any) -> None:
    """Raise `ArgumentError` where finite input gave a result that `dtype` cannot hold."""
    try:
        require_finite(name, result)
    except NonFiniteError as error:
        raise ArgumentError(
            name, f"overflows {np.dtype(dtype)} on the way", "scale it down, or use complex128"
        ) from error


def lengths(name: str, value: Sequence[float] | float, *, dim: int | None = None) -> tuple[float, ...]:
    """Positive finite lengths, one per axis; with `dim`, one number stands for all axes."""
    array = real_array(name, value, np.float64, check=False)
    if plain_array(name, value).dtype.kind == "b":
        raise DtypeError(name, f"is {value!r}", "give numbers, in metres")
    if array.ndim == 0 and dim is not None:
        array = np.broadcast_to(array, (dim,))
    if array.ndim != 1 or (dim is not None and len(array) != dim):
        raise ShapeError(name, f"has shape {array.shape}", f"give {dim or '2 or 3'} numbers, one per axis")
    for axis, length in enumerate(array):
        if not (math.isfinite(length) and length > 0):
            raise ArgumentError(name, f"is {length} on axis {axis}", "give a positive finite length")
        if not 1e-50 <= length <= 1e50:
            # Volumes and their reciprocals would leave the range of float64.
            raise ArgumentError(name, f"is {length} on axis {axis}", "give a length between 1e-50 and 1e50")
    return tuple(float(length) for length in array)


def sequence(name: str, value: Any, what: str) -> Sequence[Any]:
    """A sequence with a length; generators, None and strings are refused."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__") or not hasattr(value, "__getitem__"):
        raise DtypeError(name, f"is a {type(value).__name__}", f"give a list of {what}")
    result: Sequence[Any] = value
    return result


def count(name: str, value: Any, *, least: int = 1, most: int | None = None) -> int:
    """An integer of at least `least`; booleans and fractions are refused."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise ArgumentError(name, f"is {value!r}", f"give an integer of at least {least}")
    if most is not None and value > most:
        raise ArgumentError(name, f"is {value}", f"give an integer of at most {most}")
    if value < least:
        raise ArgumentError(name, f"is {value}", f"give an integer of at least {least}")
    return int(value)


def counts(name: str, value: Any, dim: int, *, least: int = 1) -> tuple[int, ...]:
    """One count per axis; a single integer stands for all axes."""
    if isinstance(value, (int, np.integer)):
        return (count(name, value, least=least, most=MOST),) * dim
    try:
        items = tuple(value)
    except TypeError:
        raise ArgumentError(name, f"is {value!r}", f"give an integer or {dim} of them") from None
    if len(items) != dim:
        raise ShapeError(name, f"has {len(items)} entries", f"give one integer or {dim}, one per axis")
    return tuple(count(f"{name}[{axis}]", item, least=least, most=MOST) for axis, item in enumerate(items))


def choice(name: str, value: Any, options: Sequence[str]) -> str:
    """One of a few words."""
    if value not in options:
        raise ArgumentError(name, f"is {value!r}", "give one of " + ", ".join(repr(o) for o in options))
    return str(value)
