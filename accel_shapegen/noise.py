"""The noise model of the experiments: multiplicative in modulus, uniform in phase."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ArgumentError, DtypeError


def add_noise(u: ArrayLike, delta: float, seed: int) -> NDArray[Any]:
    """u + δ r1 |u| exp(iπ r2), with r1 and r2 uniform on (-1, 1), independent per entry.

    Noise model of Li, Liu, Tsui and Wang (2020). On a lattice the zero node, which is a measurement like any
    other, is noisy too. The result is in general not Hermitian.

    Parameters
    ----------
    u : array_like of complex64 or complex128, any shape
        Far field.
    delta : float
        Noise level δ, 0 < δ ≤ 1.
    seed : int
        Seed, at least 0, of NumPy's PCG64 generator: the same shape and seed draw the same noise, for
        complex64 as for complex128.

    Returns
    -------
    array
        New array, of the shape and dtype of `u`; its relative L2 distance from `u` is at most δ, about δ/√3.

    Raises
    ------
    DtypeError, NonFiniteError
        A far field that is not complex, or holds a NaN or infinity.
    ArgumentError
        A level outside (0, 1], or a seed that is not such an integer.
    """
    exact = arguments.plain_array("u", u)
    if exact.dtype.kind != "c":
        raise DtypeError("u", f"has dtype {exact.dtype}", "give complex64 or complex128 values")
    exact = arguments.complex_array("u", exact, arguments.complex_dtype("u", exact.dtype))
    if isinstance(delta, (bool, np.bool_)) or not isinstance(delta, Real) or not 0 < delta <= 1:
        raise ArgumentError("delta", f"is {delta!r}", "give a noise level with 0 < delta <= 1")
    generator = np.random.Generator(np.random.PCG64(arguments.count("seed", seed, least=0)))
    strength = generator.uniform(-1.0, 1.0, exact.shape)
    phase = generator.uniform(-1.0, 1.0, exact.shape)
    noise = float(delta) * strength * np.abs(exact) * np.exp(1j * math.pi * phase)
    return np.asarray(exact + noise, dtype=exact.dtype)
