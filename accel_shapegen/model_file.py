"""Models on disk: one npz (a zip of plain arrays), readable with NumPy alone, checked to the last byte.

The zip's comment, which is the end of the file, is `sha256:` and the digest of everything before it. Members:

    header          UTF-8 JSON as bytes: format, version, the axes' names, boundaries, bases, forms; the nodes
    coefficients    (C_1, .., C_M, *nodes.shape) complex
    knots_0, ..     (n_j,) float64
    frame_coefficients    (C_1, .., C_M, 2, dim) float64, centre and scale; models with frames only
    bounds                (n_1, .., n_M, 2, dim) float64, of the training bodies; models of bodies only
    directions, wavenumbers                  scattered nodes only
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import uuid
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from . import arguments
from .errors import MissingFileError, ModelFileError
from .geometry import Box
from .nodes import FourierLattice, Nodes, ScatteredNodes
from .splines import SplineAxis

if TYPE_CHECKING:
    from .model import ShapeModel

FORMAT = "accel_shapegen model"
VERSION = 2
MARK = b"sha256:"
TRAILER = len(MARK) + 64
# Arrays that a model may lack; the header lists those that it has.
OPTIONAL = ("frame_coefficients", "bounds")


def write(model: ShapeModel, path: Path) -> Path:
    """Write beside the target, flush to disk, then rename: a reader never sees half a model."""
    arrays: dict[str, NDArray[Any]] = {"header": _bytes(_header(model)), "coefficients": model.coefficients}
    arrays |= {f"knots_{j}": axis.knots for j, axis in enumerate(model.axes)}
    arrays |= {name: getattr(model, name) for name in OPTIONAL if getattr(model, name) is not None}
    if isinstance(model.nodes, ScatteredNodes):
        arrays |= {"directions": model.nodes.directions, "wavenumbers": model.nodes.wavenumbers}
    if path.exists() and not path.is_file():
        raise ModelFileError(str(path), "is there and is not a file", "give another path")
    if not path.parent.is_dir():
        raise MissingFileError(str(path), "is in a folder that does not exist", f"make {path.parent} first")
    with _replacing(path) as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            # The comment's length is part of what the digest covers, so a blank one goes in first.
            archive.comment = MARK + b"0" * 64
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
        digest = _digest(file)
        file.seek(-64, os.SEEK_END)
        file.write(digest.encode())
    return path


def read(path: Path) -> dict[str, Any]:
    """The arguments of `ShapeModel` from a model file, after its checksum has been verified."""
    if not path.exists():
        raise MissingFileError(str(path), "does not exist", "give a file that ShapeModel.save wrote")
    if not path.is_file():
        raise ModelFileError(str(path), "is not a file", "give a file that ShapeModel.save wrote")
    with path.open("rb") as file:
        _verify(file, path)
        try:
            _require_plain(file)
            with np.load(file, allow_pickle=False) as arrays:
                header = json.loads(bytes(arrays["header"]).decode())
                _require_format(header, path)
                axes, nodes = _axes(header, arrays), _nodes(header["nodes"], arrays)
                coefficients = arrays["coefficients"]
                _require_coefficients(coefficients, axes, nodes)
                optional = {name: arrays[name] for name in OPTIONAL if name in header["optional"]}
                _require_optional(optional, axes, nodes)
                return {"axes": axes, "coefficients": coefficients, "nodes": nodes, **optional}
        except ModelFileError:
            raise
        except Exception as error:  # whatever forged bytes make the parsers raise, the file is at fault
            raise ModelFileError(str(path), f"is not a model ({error})", "save it again") from error


def _header(model: ShapeModel) -> dict[str, Any]:
    nodes: dict[str, Any] = {"kind": "scattered"}
    if isinstance(model.nodes, FourierLattice):
        lattice = model.nodes
        nodes = {"kind": "lattice", "box": lattice.box.lengths, "order": lattice.order, "mu": lattice.mu}
    axes = [{key: getattr(axis, key) for key in ("name", "boundary", "basis", "form")} for axis in model.axes]
    optional = [name for name in OPTIONAL if getattr(model, name) is not None]
    return {"format": FORMAT, "version": VERSION, "axes": axes, "nodes": nodes, "optional": optional}


def _axes(header: dict[str, Any], arrays: Any) -> tuple[SplineAxis, ...]:
    return tuple(
        SplineAxis(arrays[f"knots_{j}"], axis["boundary"], axis["basis"], name=axis["name"], form=axis["form"])
        for j, axis in enumerate(header["axes"])
    )


def _nodes(header: dict[str, Any], arrays: Any) -> Nodes:
    if header["kind"] == "scattered":
        return ScatteredNodes(arrays["directions"], arrays["wavenumbers"])
    if header["kind"] == "lattice":
        return FourierLattice(Box(header["box"]), header["order"], mu=header["mu"])
    raise ValueError(f"nodes of kind {header['kind']!r}")


def _require_plain(file: BinaryIO) -> None:
    """Members as `write` stores them: each once, not compressed, so that none is larger than the file it came in."""
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise ValueError("a member is compressed")
    if len({member.filename for member in members}) < len(members):
        raise ValueError("a member is there twice")
    file.seek(0)


def _require_coefficients(coefficients: NDArray[Any], axes: tuple[SplineAxis, ...], nodes: Nodes) -> None:
    """A checksum proves that the file is as it was written, not who wrote it."""
    shape = (*(axis.size for axis in axes), *nodes.shape)
    if not axes or not all(isinstance(axis.name, str) for axis in axes):
        raise ValueError("no named characteristic values")
    if coefficients.dtype not in (np.complex64, np.complex128) or coefficients.shape != shape:
        raise ValueError(f"coefficients are {coefficients.dtype} of shape {coefficients.shape}, not complex of {shape}")
    arguments.require_finite("coefficients", coefficients)


def _require_optional(optional: dict[str, NDArray[Any]], axes: tuple[SplineAxis, ...], nodes: Nodes) -> None:
    grids = {"frame_coefficients": (axis.size for axis in axes), "bounds": (len(axis.knots) for axis in axes)}
    for name, array in optional.items():
        shape = (*grids[name], 2, nodes.dim)
        if array.dtype != np.float64 or array.shape != shape:
            raise ValueError(f"{name} are {array.dtype} of shape {array.shape}, not float64 of {shape}")
    if "frame_coefficients" in optional:
        arguments.require_finite("frame_coefficients", optional["frame_coefficients"])


def _require_format(header: Any, path: Path) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ModelFileError(str(path), "is not a model of this package", "give a file that ShapeModel.save wrote")
    if header.get("version") != VERSION:
        raise ModelFileError(
            str(path), f"has format version {header.get('version')}", f"this release reads version {VERSION}"
        )


def _verify(file: BinaryIO, path: Path) -> None:
    size = file.seek(0, os.SEEK_END)
    if size < TRAILER:
        raise ModelFileError(str(path), f"has {size} bytes, too few for a model", "save it again")
    file.seek(-TRAILER, os.SEEK_END)
    trailer = file.read()
    if not trailer.startswith(MARK):
        raise ModelFileError(str(path), "is cut short, or is not a model", "save it again")
    if _digest(file) != trailer[len(MARK) :].decode(errors="replace"):
        raise ModelFileError(str(path), "does not match its checksum: it was damaged", "save it again")
    file.seek(0)


def _digest(file: BinaryIO) -> str:
    """SHA-256 of everything before the digest itself."""
    left = file.seek(0, os.SEEK_END) - 64
    file.seek(0)
    digest = hashlib.sha256()
    while left:
        block = file.read(min(left, 1 << 20))
        digest.update(block)
        left -= len(block)
    return digest.hexdigest()


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with temporary.open("x+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _bytes(header: dict[str, Any]) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
