"""Many fields on one grid, written body by body: a Zarr array, or one npz file each."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import extras
from .bodies.files import save_voxels
from .errors import ArgumentError
from .geometry import Grid, VoxelGrid


def require_zarr() -> None:
    """Raise `MissingDependencyError` where Zarr is not installed: before the work, not after it."""
    extras.require("zarr volumes", "zarr", "zarr")


class ZarrVolumes:
    """One Zarr array of shape (count, *grid.shape), a chunk per body with a checksum.

    A body that was never written reads as NaN, a damaged chunk is an error. Attributes hold `lengths` [m], the sides
    of the box that the cells fill, and whatever else is given.

    Parameters
    ----------
    path : Path
        The array's folder; replaced if it exists.
    count : int
        Bodies.
    grid : Grid
        Cell centres that fill a box.
    dtype : dtype
        float32 or float64.
    attributes : dict
        Anything that JSON can hold.
    """

    def __init__(self, path: Path, count: int, grid: Grid, dtype: Any, attributes: dict[str, Any]) -> None:
        require_zarr()
        import zarr
        from zarr.codecs import Crc32cCodec, ZstdCodec

        box = _box(grid)
        if path.is_dir():
            shutil.rmtree(path)
        self._array: Any = zarr.create_array(
            store=path,
            shape=(count, *grid.shape),
            chunks=(1, *grid.shape),
            dtype=np.dtype(dtype),
            # Compression and then a checksum: Zstandard alone returns a flipped bit as data.
            compressors=(ZstdCodec(level=3), Crc32cCodec()),
            fill_value=np.nan,
            attributes={"lengths": list(box.lengths), **attributes},
        )

    def write(self, index: int, field: NDArray[Any]) -> None:
        """Store body `index`, shape `grid.shape`."""
        self._array[index] = field


def write_npz(path: Path, field: NDArray[Any], grid: Grid) -> None:
    """Write a field of shape `grid.shape` as `values` and `lengths` [m], for `bodies.load`; replaces a file there."""
    save_voxels(VoxelGrid(field, _box(grid)), path)


def _box(grid: Grid) -> Any:
    if grid.box is None:
        raise ArgumentError("grid", "has no box", "make it by Grid(box, shape)")
    return grid.box
