"""Bodies from files and to files: meshes through trimesh, voxel bodies as npz.

A file is read as untrusted: what it declares is checked against what it holds before anything is allocated, no
reference to another file or address is followed, nothing is unpickled, and whatever a reader stumbles over is a
`BodyFileError` that names the file. trimesh alone reads an empty or cut STL as an empty scene, and a cut text
file as a smaller mesh.
"""

from __future__ import annotations

import io
import os
import re
import zipfile
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from .. import arguments
from ..errors import ArgumentError, BodyFileError, DtypeError, MissingFileError, ShapegenError
from ..geometry import Box, TriangleMesh, VoxelGrid

READABLE = (".stl", ".ply", ".obj", ".glb", ".off")
WRITABLE = (".stl", ".ply", ".obj", ".glb")
METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254}
MAX_BYTES = 4 << 30


def load(path: str | os.PathLike[str], *, unit: str = "m", max_bytes: int = MAX_BYTES) -> TriangleMesh | VoxelGrid:
    """A body from a file: a mesh (.stl, .ply, .obj, .glb, .off) or a voxel body (.npz).

    The parts of a scene become one mesh in world coordinates; points, lines, colours and textures are passed over.
    Vertices at exactly the same place become one - an STL, or a texture seam, would be open otherwise. Nothing else
    is merged, turned or repaired: whether the mesh is closed and outward is checked where that is needed. Axes stay as
    they are in the file (glTF means +Y to be up).

    Parameters
    ----------
    path : path-like
        The file; its suffix tells the kind.
    unit : {"m", "dm", "cm", "mm", "in"}
        Length unit of the file. glTF is in metres by definition; the other mesh formats do not say.
    max_bytes : int
        Refuse files, or arrays declared in them, of more bytes than this.

    Returns
    -------
    TriangleMesh or VoxelGrid
        In metres. An npz file holds `values` (..., n1, n2[, n3]), real or boolean, and `lengths`, the sides of
        the box they fill.

    Raises
    ------
    MissingFileError
        There is no such file.
    BodyFileError
        A folder, an unknown suffix, a file that is damaged, cut, too large, refers to others, or holds no surface.
    ArgumentError
        An unknown unit, or a limit that is not a positive integer.
    """
    scale = METRES[arguments.choice("unit", unit, tuple(METRES))]
    limit = arguments.count("max_bytes", max_bytes)
    file = Path(path)
    if file.is_dir():
        raise BodyFileError(str(file), "is a folder", "give a file")
    if not file.is_file():
        raise MissingFileError(str(file), "does not exist", "check the path")
    suffix = file.suffix.lower()
    if suffix not in (*READABLE, ".npz"):
        raise BodyFileError(str(file), f"has the suffix {suffix!r}", "give one of " + ", ".join((*READABLE, ".npz")))
    if file.stat().st_size > limit:
        raise BodyFileError(str(file), f"has {file.stat().st_size:,} bytes", f"raise max_bytes above {limit:,}")
    try:
        return _voxels(file, scale, limit) if suffix == ".npz" else _mesh(file, suffix, scale)
    except BodyFileError:
        raise
    except ShapegenError as error:
        raise BodyFileError(str(file), f"{error.subject} {error.problem}", error.remedy) from error
    except Exception as error:  # readers of untrusted bytes fail in any way; each means the same to the caller
        raise BodyFileError(
            str(file), f"cannot be read ({type(error).__name__}: {error})", f"give an intact {suffix} file"
        ) from error


def save_mesh(mesh: TriangleMesh, path: str | os.PathLike[str]) -> None:
    """Write a mesh as .ply, .stl, .glb or .obj, in metres, by the suffix of the path.

    Formats but obj hold coordinates as float32. Axes are written as they are, although glTF means +Y to be up.

    Raises
    ------
    DtypeError, ArgumentError
        Not a TriangleMesh; a suffix that names none of these formats.
    MissingFileError
        The folder does not exist.
    """
    if not isinstance(mesh, TriangleMesh):
        raise DtypeError("mesh", f"is a {type(mesh).__name__}", "give a TriangleMesh")
    file = _target(path, WRITABLE)
    import trimesh

    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    # 17 digits after the point tell any two doubles apart that are of the size of a body.
    options: dict[str, Any] = {"digits": 17} if file.suffix.lower() == ".obj" else {}
    content: Any = plain.export(file_type=file.suffix.lower()[1:], **options)
    file.write_bytes(content.encode() if isinstance(content, str) else content)


def save_voxels(grid: VoxelGrid, path: str | os.PathLike[str]) -> None:
    """Write a voxel body, or a batch of them, as a compressed .npz of `values` and `lengths` [m].

    Raises
    ------
    DtypeError, ArgumentError
        Not a VoxelGrid; a suffix other than .npz.
    MissingFileError
        The folder does not exist.
    """
    if not isinstance(grid, VoxelGrid):
        raise DtypeError("grid", f"is a {type(grid).__name__}", "give a VoxelGrid")
    np.savez_compressed(_target(path, (".npz",)), values=grid.values, lengths=np.array(grid.box.lengths))


def _target(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise ArgumentError("path", f"is {str(file)!r}", "give a name that ends in " + ", ".join(suffixes))
    if not file.parent.is_dir():
        raise MissingFileError(str(file.parent), "is not a folder", "create it first")
    return file


class _NoOtherFiles(dict[str, bytes]):
    """A trimesh resolver that follows nothing."""

    def __missing__(self, name: str) -> NoReturn:
        raise ValueError(f"it refers to {name!r}, and references are not followed")


def _mesh(file: Path, suffix: str, scale: float) -> TriangleMesh:
    from trimesh import load_scene

    data = file.read_bytes()
    fault = {".stl": _fault_stl, ".ply": _fault_ply, ".off": _fault_off, ".glb": _fault_glb}.get(suffix)
    problem = fault(data) if fault else None
    if problem:
        raise BodyFileError(str(file), problem, f"give an intact {suffix} file")
    # Given bytes and no name, trimesh has no folder to look for other files in; images are not decoded either.
    scene = load_scene(
        io.BytesIO(data), file_type=suffix[1:], resolver=_NoOtherFiles(), process=False, skip_materials=True
    )
    vertices, faces = _world(scene)
    if not len(faces):
        raise BodyFileError(str(file), "holds no triangles", "give a file with a surface in it")
    arguments.require_finite("vertices", vertices, suffix=" in world coordinates")
    merged, where = np.unique(vertices, axis=0, return_inverse=True)
    return TriangleMesh(merged * scale, where.reshape(-1)[faces])


def _world(scene: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """All triangles of a scene in world coordinates; mirrored instances are turned so that outside stays outside."""
    vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces"):
            continue
        points, corners = np.asarray(geometry.vertices), np.asarray(geometry.faces)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
            raise ValueError(f"part {name!r} names vertices that it does not hold")
        arguments.require_finite("vertices", points)
        mirrored = np.linalg.det(transform[:3, :3]) < 0
        vertices.append(points @ transform[:3, :3].T + transform[:3, 3])
        faces.append((corners[:, ::-1] if mirrored else corners) + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def _fault_stl(data: bytes) -> str | None:
    """What is wrong with an STL file, text or binary, or None."""
    if len(data) >= 84:
        declared = int.from_bytes(data[80:84], "little")
        if len(data) == 84 + 50 * declared:
            return None if declared else "declares no triangles"
    if data.lstrip()[:5].lower() != b"solid":
        if len(data) < 84:
            return f"has {len(data)} bytes, fewer than the header of an STL file"
        return f"declares {declared} triangles, which take {84 + 50 * declared} bytes, and has {len(data)}"
    facets, ends, corners, last = (
        len(re.findall(rb"^\s*" + word + rb"\b", data, flags=re.MULTILINE | re.IGNORECASE))
        for word in (b"facet", b"endfacet", b"vertex", b"endsolid")
    )
    if not last or not facets == ends == corners / 3:
        return f"is text with {facets} facet, {ends} endfacet, {corners} vertex and {last} endsolid lines: it is cut"
    return None


def _fault_ply(data: bytes) -> str | None:
    """What is wrong with the frame of a PLY file, or None; trimesh checks the length of a binary one."""
    header, mark, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not mark:
        return "has no PLY header"
    declared = sum(int(n) for n in re.findall(rb"^element\s+\w+\s+(\d+)\s*$", header, flags=re.MULTILINE))
    lines = sum(1 for line in body.splitlines() if line.strip())
    if re.search(rb"^format\s+ascii", header, flags=re.MULTILINE) and lines != declared:
        return f"declares {declared} elements and has {lines} lines of them"
    return None


def _fault_off(data: bytes) -> str | None:
    """What is wrong with an OFF file, or None."""
    text = re.sub(r"#.*", "", data.decode("utf-8"))
    start, mark, rest = text.partition("OFF")
    if not mark or start.strip() not in ("", "C"):
        return "has no OFF header"
    lines = [line.split() for line in rest.splitlines() if line.strip()]
    vertices, faces = (int(n) for n in lines[0][:2])
    polygons = lines[1 + vertices :]
    if len(polygons) != faces:
        return f"declares {vertices} vertices and {faces} faces and has {len(lines) - 1} lines of them"
    if any(not 3 <= int(line[0]) < len(line) for line in polygons):
        return "has a face with missing corners"
    return None


def _fault_glb(data: bytes) -> str | None:
    """What is wrong with the frame of a GLB file, or None."""
    if data[:4] != b"glTF" or len(data) < 20:
        return "has no GLB header"
    declared = int.from_bytes(data[8:12], "little")
    return None if declared == len(data) else f"declares {declared} bytes and has {len(data)}"


def _voxels(file: Path, scale: float, limit: int) -> VoxelGrid:
    with zipfile.ZipFile(file) as archive:
        missing = [name for name in ("values", "lengths") if f"{name}.npy" not in archive.namelist()]
        if missing:
            raise BodyFileError(str(file), f"holds no array {missing[0]!r}", "give an npz file of values and lengths")
        values, sides = (_array(archive, name, limit) for name in ("values", "lengths"))
    if sides.ndim != 1 or sides.dtype.kind not in "fiu":
        raise BodyFileError(
            str(file), f"has lengths of shape {sides.shape} and {sides.dtype}", "give 2 or 3 real lengths"
        )
    grid = VoxelGrid(values, Box([scale * float(side) for side in sides]))
    arguments.require_finite("values", grid.values)
    return grid


def _array(archive: zipfile.ZipFile, name: str, limit: int) -> NDArray[Any]:
    """One array, its declared size checked against the limit and the archive before a byte of it is read."""
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{name} has npy version {version}")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(member)
        if dtype.hasobject:
            raise ValueError(f"{name} holds pickled objects")
        size = dtype.itemsize
        for count in shape:
            size *= count
        if size > limit:
            raise ValueError(f"{name} has shape {shape}, {size:,} bytes, over the limit of {limit:,}")
        if info.file_size != member.tell() + size:
            raise ValueError(f"{name} declares {size} bytes of data and holds {info.file_size - member.tell()}")
        # Reading to the end makes zipfile check the checksum.
        flat = np.frombuffer(member.read(), dtype=dtype)
    return flat.reshape(shape, order="F" if fortran else "C")
