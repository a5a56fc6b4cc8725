"""The packaged basis of human bodies: what it holds, and the checked way to load it. See PROVENANCE.md."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BodyFileError

FORMAT = 1
DTYPES = {
    "template": "int32",
    "people": "int16",
    "build": "int16",
    "stature": "int16",
    "stature_extra": "int16",
    "faces": "uint16",
    "midline": "int64",
}
TEMPLATE_UNIT = 1e-5
"""Unit [m] of `template`: base.obj has four decimals in decimetres."""
TARGET_UNIT = 1e-4
"""Unit [m] of every target: their text has three decimals in decimetres."""


@dataclass(frozen=True, eq=False)
class HumanBasis:
    """Half a skin (H vertices, x ≥ 0) and its displacements, as integers; x = left, y = back, z = up.

    Attributes
    ----------
    template : (H, 3) int32
        Base mesh [1e-5 m].
    people : (2, H, 3) int16
        Sum over MakeHuman's three races of the young female and the young male target [1e-4 m].
    build : (2, 2, 3, H, 3) int16
        Targets by gender (female, male) × muscle (minimum, average) × weight (minimum, average, maximum) [1e-4 m].
    stature : (2, H, 3) int16
        Minimum and maximum height at average weight and muscle, female [1e-4 m].
    stature_extra : (2, 2, 3, 2, H, 3) int16
        What the height targets of the other corners have beyond `stature`; nearly all zero.
    faces : (F, 3) uint16
        Triangles of the half, counter-clockwise from outside.
    midline : int
        How many of the H vertices, the first ones, lie on the plane of symmetry.
    """

    template: NDArray[Any]
    people: NDArray[Any]
    build: NDArray[Any]
    stature: NDArray[Any]
    stature_extra: NDArray[Any]
    faces: NDArray[Any]
    midline: int


def checksum(arrays: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """SHA-256 over names, dtypes, shapes and bytes, so that no flipped bit passes for a body."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape};".encode())
        digest.update(array.tobytes())
    return np.frombuffer(digest.digest(), dtype=np.uint8)


def parse_basis(data: bytes) -> HumanBasis:
    """The basis in the bytes of an npz; `BodyFileError` where they are damaged or of another format."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise BodyFileError("human_basis.npz", f"cannot be read ({error})", "reinstall accel-shapegen") from error
    stated = arrays.pop("sha256", None)
    if stated is None or not np.array_equal(stated, checksum(arrays)):
        raise BodyFileError("human_basis.npz", "does not match its checksum", "reinstall accel-shapegen")
    version = int(arrays.pop("format", np.int64(0)))
    found = {name: array.dtype.name for name, array in arrays.items()}
    if version != FORMAT or found != DTYPES:
        raise BodyFileError("human_basis.npz", f"has format {version}", f"use a file of format {FORMAT}")
    midline = int(arrays.pop("midline"))
    for array in arrays.values():
        array.setflags(write=False)
    return HumanBasis(**arrays, midline=midline)


@cache
def load_basis() -> HumanBasis:
    """The basis shipped in the package, read once per process."""
    from importlib import resources

    return parse_basis(resources.files(__name__).joinpath("human_basis.npz").read_bytes())
