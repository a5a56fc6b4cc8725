"""What `generate` writes: fields, surfaces and pictures, one file each or one array for all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import report, volume_files
from ..bodies.files import save_mesh
from ..errors import ArgumentError
from ..geometry import Grid, Polygons, TriangleMesh
from ..surface import extract_surface

# Where the surface of a field lies: half way between outside and inside.
LEVEL = 0.5
ZARR = "volumes.zarr"
# Endings by format, for models in the plane and in space.
FORMATS = {
    2: {"npz": ".npz", "rings": ".rings.npz", "png": ".png"},
    3: {"npz": ".npz", "ply": ".ply", "stl": ".stl", "glb": ".glb", "obj": ".obj", "png": ".png"},
}
DEFAULT_FORMAT = {2: "rings", 3: "ply"}


class BodyFiles:
    """The files of generated bodies in one folder.

    Parameters
    ----------
    folder : Path
        Where they go.
    grid : Grid
        Cells of the fields.
    wanted : sequence of str, optional
        Formats as given by the user, several in one text separated by commas.

    Attributes
    ----------
    formats : list of str
        Each once, in the order given.
    """

    def __init__(self, folder: Path, grid: Grid, wanted: Sequence[str] | None) -> None:
        self.folder, self.grid = folder, grid
        self._endings = FORMATS[grid.dim]
        texts = wanted or [DEFAULT_FORMAT[grid.dim]]
        self.formats = list(dict.fromkeys(part.strip() for text in texts for part in text.split(",")))
        possible = [*self._endings, "zarr"]
        for name in self.formats:
            if name not in possible:
                elsewhere = any(name in endings for endings in FORMATS.values())
                problem = f"is {name!r}" + (f", not for models in {grid.dim}-D" if elsewhere else "")
                raise ArgumentError("--format", problem, "give some of " + ", ".join(possible))
        # What is not installed is said before the work, not after it.
        if "zarr" in self.formats:
            volume_files.require_zarr()
        if "png" in self.formats:
            report.require_matplotlib()
        self._volumes: volume_files.ZarrVolumes | None = None

    def names(self, index: int) -> dict[str, str]:
        """The files of one body by format."""
        return {name: f"body_{index:04d}{self._endings[name]}" for name in self.formats if name != "zarr"}

    def paths(self, count: int) -> list[Path]:
        """All that will be written for so many bodies."""
        names = [name for index in range(count) for name in self.names(index).values()]
        return [self.folder / name for name in ([ZARR] if "zarr" in self.formats else []) + names]

    def open(self, count: int, dtype: np.dtype[Any], attributes: dict[str, Any]) -> None:
        """Make what is shared by all bodies."""
        if "zarr" in self.formats:
            self._volumes = volume_files.ZarrVolumes(self.folder / ZARR, count, self.grid, dtype, attributes)

    def write(self, index: int, field: NDArray[Any], title: str) -> dict[str, Any] | None:
        """Write one body; what its surface is like, where a format needs one."""
        if self._volumes is not None:
            self._volumes.write(index, field)
        files = {name: self.folder / file for name, file in self.names(index).items()}
        if "npz" in files:
            volume_files.write_npz(files.pop("npz"), field, self.grid)
        if not files:
            return None
        surface = extract_surface(field, self.grid, LEVEL)
        if isinstance(surface, TriangleMesh):
            _write_mesh(files, surface, title)
        else:
            _write_region(files, surface, field, self.grid, title)
        quality = surface.quality
        return {
            "closed": quality.closed,
            "components": quality.components,
            "volume": quality.volume,
            "extent_m": np.ptp(surface.bounds, axis=0).tolist(),
        }


def replace_text(path: Path, text: str) -> None:
    """Write a text beside its place, then rename it: a reader never sees half of it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def _write_mesh(files: dict[str, Path], surface: TriangleMesh, title: str) -> None:
    for name, path in files.items():
        if name == "png":
            report.draw_body(path, title, surface)
        else:
            save_mesh(surface, path)


def _write_region(files: dict[str, Path], surface: Polygons, field: NDArray[Any], grid: Grid, title: str) -> None:
    if "png" in files:
        report.draw_region(files["png"], title, field, grid, surface)
    if "rings" in files:
        rings: dict[str, Any] = {f"ring_{i}": ring for i, ring in enumerate(surface.rings)}
        np.savez(files["rings"], **rings)
