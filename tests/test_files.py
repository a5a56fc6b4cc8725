"""Files: round trips, what trimesh would let pass, and damage of every kind."""

from __future__ import annotations

import io
import json
import struct
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accel_shapegen.bodies.families import ball, cuboid, disk
from accel_shapegen.bodies.files import METRES, load, save_mesh, save_voxels
from accel_shapegen.errors import ArgumentError, BodyFileError, DtypeError, MissingFileError
from accel_shapegen.geometry import Box, TriangleMesh, VoxelGrid

BODY = ball(0.9, subdivisions=1)
SUFFIXES = (".stl", ".ply", ".glb", ".obj")
# What other programs write, beside what save_mesh writes.
FOREIGN: dict[str, tuple[str, dict[str, str]]] = {
    "ascii.stl": ("stl_ascii", {}),
    "ascii.ply": ("ply", {"encoding": "ascii"}),
    "plain.off": ("off", {}),
}
KINDS = [*(f"own{suffix}" for suffix in SUFFIXES), *FOREIGN, "voxels.npz"]
VOXELS = VoxelGrid(np.random.default_rng(0).standard_normal((2, 4, 5, 6)), Box((0.4, 0.5, 0.6)))


def write(folder: Path, kind: str) -> Path:
    """A file of some kind, with BODY or VOXELS in it."""
    import trimesh

    path = folder / kind
    if kind in FOREIGN:
        file_type, options = FOREIGN[kind]
        content: Any = trimesh.Trimesh(BODY.vertices, BODY.faces, process=False).export(file_type=file_type, **options)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    elif kind.endswith(".npz"):
        save_voxels(VOXELS, path)
    else:
        save_mesh(BODY, path)
    return path


def same(a: TriangleMesh | VoxelGrid, b: TriangleMesh | VoxelGrid) -> bool:
    if isinstance(a, VoxelGrid) and isinstance(b, VoxelGrid):
        return a.box == b.box and np.array_equal(a.values, b.values)
    assert isinstance(a, TriangleMesh)
    assert isinstance(b, TriangleMesh)
    return np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)


@pytest.mark.parametrize("kind", KINDS[:-1])
def test_meshes_come_back(kind: str, tmp_path: Path) -> None:
    mesh = load(write(tmp_path, kind))
    assert isinstance(mesh, TriangleMesh)
    assert mesh.is_closed
    assert (len(mesh.vertices), len(mesh.faces)) == (len(BODY.vertices), len(BODY.faces))
    # float32 in most formats, ten digits in trimesh's OFF, all digits in OBJ and text STL.
    exact = kind in ("own.obj", "ascii.stl")
    tolerance = 0 if exact else 2**-24
    nearest = np.linalg.norm(mesh.vertices[:, None] - BODY.vertices, axis=-1).min(axis=1)
    assert nearest.max() <= 2 * tolerance
    assert mesh.volume == pytest.approx(BODY.volume, rel=1e-14 if exact else 1e-6)


@pytest.mark.parametrize("unit", METRES)
def test_units(unit: str, tmp_path: Path) -> None:
    scale = {"m": 1, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254}[unit]
    mesh = load(write(tmp_path, "own.stl"), unit=unit)
    assert isinstance(mesh, TriangleMesh)
    assert mesh.bounds[1, 0] == pytest.approx(scale * BODY.bounds[1, 0], rel=1e-6)
    voxels = load(write(tmp_path, "voxels.npz"), unit=unit)
    assert isinstance(voxels, VoxelGrid)
    assert voxels.box.lengths == pytest.approx([scale * a for a in VOXELS.box.lengths], rel=1e-15)


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int64", "float32", "float64"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_voxels_come_back(dtype: str, order: Any, tmp_path: Path) -> None:
    values = np.asarray(np.arange(24).reshape(2, 3, 4) % 3, dtype=dtype, order=order)
    save_voxels(VoxelGrid(values, Box((0.1, 0.2, 0.3))), tmp_path / "v.npz")
    back = load(str(tmp_path / "v.npz"))
    assert isinstance(back, VoxelGrid)
    assert back.values.dtype == dtype
    assert np.array_equal(back.values, values)
    assert back.box == Box((0.1, 0.2, 0.3))


def test_uncompressed_and_2d_voxels(tmp_path: Path) -> None:
    np.savez(tmp_path / "v.npz", values=np.eye(3), lengths=[1, 2], author=np.array("somebody"))
    back = load(tmp_path / "v.npz")
    assert isinstance(back, VoxelGrid)
    assert back.box == Box((1, 2))


def test_scene_in_world_coordinates(tmp_path: Path) -> None:
    """Instances of one mesh: moved, turned, and mirrored, which would turn it inside out."""
    import trimesh

    shape = trimesh.Trimesh(cuboid(1, 2, 3).vertices, cuboid(1, 2, 3).faces, process=False)
    scene = trimesh.Scene()
    turned = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turned[:3, 3] = [10, 0, 0]
    mirrored = np.diag([-1.0, 1, 1, 1])
    mirrored[:3, 3] = [0, 20, 0]
    for i, transform in enumerate((np.eye(4), turned, mirrored)):
        scene.add_geometry(shape, node_name=f"n{i}", geom_name="shape", transform=transform)
    content: Any = scene.export(file_type="glb")
    (tmp_path / "s.glb").write_bytes(content)
    mesh = load(tmp_path / "s.glb")
    assert isinstance(mesh, TriangleMesh)
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(3 * 6, rel=1e-6)
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -1, -1.5], [11, 21, 1.5]], atol=1e-5)


def test_texture_seams_close_and_quads_split(tmp_path: Path) -> None:
    corners = cuboid(1, 2, 3).vertices
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    lines = ["mtllib missing.mtl", *(f"v {x} {y} {z}" for x, y, z in corners)]
    lines += [f"vt {i / 24} {i / 24}" for i in range(24)]
    lines += ["usemtl skin"]
    lines += ["f " + " ".join(f"{c + 1}/{4 * q + i + 1}" for i, c in enumerate(quad)) for q, quad in enumerate(quads)]
    (tmp_path / "b.obj").write_text("\n".join(lines))
    mesh = load(tmp_path / "b.obj")
    assert isinstance(mesh, TriangleMesh)
    assert mesh.is_closed
    assert (len(mesh.vertices), len(mesh.faces), mesh.volume) == (8, 12, pytest.approx(6))
    (tmp_path / "b.off").write_text(
        "OFF # a comment\n8 6 0\n"
        + "\n".join(f"{x} {y} {z}" for x, y, z in corners)
        + "\n\n"
        + "\n".join(f"4 {a} {b} {c} {d} # face" for a, b, c, d in quads)
    )
    again = load(tmp_path / "b.off")
    assert isinstance(again, TriangleMesh)
    assert again.is_closed
    assert again.volume == pytest.approx(6)


def test_only_equal_vertices_merge(tmp_path: Path) -> None:
    """Two tetrahedra a float32 step apart stay apart; -0 and 0 are one place."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    near = corners.copy()
    near[:, 0] = np.nextafter(near[:, 0], np.float32(2))
    triangles = np.concatenate([corners[faces], near[faces]])
    triangles[0, 0] = -0.0
    record = np.zeros(8, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    record["corners"] = triangles
    (tmp_path / "t.stl").write_bytes(bytes(80) + struct.pack("<I", 8) + record.tobytes())
    mesh = load(tmp_path / "t.stl")
    assert isinstance(mesh, TriangleMesh)
    assert (len(mesh.vertices), len(mesh.faces), mesh.is_closed) == (8, 8, True)


@pytest.mark.parametrize("kind", KINDS)
def test_cut_anywhere(kind: str, tmp_path: Path) -> None:
    """A cut file is an error. A text format may lose its end unnoticed, never so that the rest passes for a body."""
    path = write(tmp_path, kind)
    whole, content = load(path), path.read_bytes()
    text = kind in ("own.obj", *FOREIGN)
    lengths = {*range(0, len(content), max(1, len(content) // 150)), *range(len(content) - 20, len(content))}
    errors = 0
    for length in sorted(lengths):
        path.write_bytes(content[:length])
        try:
            body = load(path)
        except BodyFileError as error:
            errors += 1
            assert str(path) in str(error)
        else:
            assert text, f"{length} of {len(content)} bytes passed"
            assert isinstance(body, TriangleMesh)
            assert same(body, whole) or not body.is_closed
    assert errors >= len(lengths) / 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_flipped_bit_is_an_error_of_ours_or_a_mesh(kind: str, tmp_path: Path) -> None:
    path = write(tmp_path, kind)
    whole, content = load(path), path.read_bytes()
    rng = np.random.default_rng(3)
    errors = 0
    for turn in range(200):
        damaged = bytearray(content)
        # Half of the flips go to the header, where they do most.
        damaged[rng.integers(0, 150 if turn % 2 else len(content))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            body = load(path)
        except BodyFileError:
            errors += 1
        else:
            # Voxel files carry checksums; what is not covered by one is not data.
            assert isinstance(body, TriangleMesh) or same(body, whole)
    if kind not in ("own.stl", "ascii.stl"):  # whose headers are free text
        assert errors > 20


def glb(header: dict[str, Any], blob: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if blob:
        chunks += struct.pack("<II", len(blob), 0x004E4942) + blob
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def triangle_glb(**buffer: Any) -> bytes:
    """One triangle, in a buffer given by `buffer`."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4").tobytes()
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, **buffer}],
    }
    return glb(header, b"" if "uri" in buffer else points)


class OpenedFiles:
    """Names of files opened while it is on, by an audit hook."""

    def __init__(self) -> None:
        self.on, self.names = False, []
        sys.addaudithook(self.see)

    def see(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.on and event in ("open", "socket.connect", "socket.getaddrinfo"):
            self.names.append(str(arguments[0]))


OPENED = OpenedFiles()


def test_references_are_not_followed(tmp_path: Path) -> None:
    import PIL.Image  # noqa: F401
    import trimesh  # noqa: F401  # loaded, so that only the loading of bodies opens files

    for name in ("skin.mtl", "skin.png", "points.bin"):
        (tmp_path / name).write_bytes(bytes(36))
    (tmp_path / "good.glb").write_bytes(triangle_glb())
    (tmp_path / "bad.glb").write_bytes(triangle_glb(uri="points.bin"))
    (tmp_path / "web.glb").write_bytes(triangle_glb(uri="http://127.0.0.1:9/points.bin"))
    text = write(tmp_path, "own.obj").read_text()
    (tmp_path / "own.obj").write_text("mtllib skin.mtl\nusemtl skin\n" + text)
    text = write(tmp_path, "ascii.ply").read_text()
    (tmp_path / "ascii.ply").write_text(text.replace("element vertex", "comment TextureFile skin.png\nelement vertex"))
    bodies = [tmp_path / name for name in ("good.glb", "own.obj", "ascii.ply")]
    for path in bodies:
        load(path)
    OPENED.names.clear()
    OPENED.on = True
    try:
        for path in bodies:
            load(path)
        for name in ("bad.glb", "web.glb"):
            with pytest.raises(BodyFileError, match=r"refers to .*points.bin.*references are not followed"):
                load(tmp_path / name)
    finally:
        OPENED.on = False
    assert set(OPENED.names) == {str(path) for path in (*bodies, tmp_path / "bad.glb", tmp_path / "web.glb")}


NAN_STL = (
    bytes(80) + struct.pack("<I", 1) + np.array([0, 0, 1, 0, 0, 0, 1, 0, np.nan, 0, 1, 0], "<f4").tobytes() + bytes(2)
)
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACED = PLY + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
MANY = "vertex 999999999999"
EMPTY_SCENE = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
CYCLIC_SCENE = EMPTY_SCENE | {"scenes": [{"nodes": [0]}], "nodes": [{"children": [0]}]}
DAMAGED: list[tuple[str, bytes | str, str]] = [
    ("empty.stl", b"", "has 0 bytes"),
    ("header.stl", bytes(84), "declares no triangles"),
    ("short.stl", bytes(80) + struct.pack("<I", 2) + bytes(50), "2 triangles, which take 184 bytes, and has 134"),
    ("long.stl", bytes(80) + struct.pack("<I", 1) + bytes(100), "declares 1 triangles"),
    ("huge.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), "declares 4294967295 triangles"),
    ("nan.stl", NAN_STL, r"vertices is nan at index"),
    ("nothing.stl", "solid nothing\nendsolid nothing\n", "holds no triangles"),
    ("cut.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "1 facet, 0 endfacet, 1 vertex"),
    ("other.stl", "PK\x03\x04" * 40, "declares"),
    ("points.ply", PLY + "end_header\n0 0 0\n1 0 0\n0 1 0\n", "holds no triangles"),
    ("index.ply", FACED + "3 0 1 9\n", "names vertices that it does not hold"),
    ("negative.ply", FACED + "3 0 1 -1\n", "names vertices that it does not hold"),
    ("infinite.ply", FACED.replace("1 0 0", "inf 0 0") + "3 0 1 2\n", r"vertices is inf at index \(1, 0\)"),
    ("many.ply", PLY.replace("vertex 3", MANY) + "end_header\n0 0 0\n", "declares 999999999999 elements and has 1"),
    ("huge.ply", PLY.replace("ascii", "binary_little_endian").replace("vertex 3", MANY) + "end_header\n", "read"),
    ("magic.ply", "poly\n", "has no PLY header"),
    ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds no triangles"),
    ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read|does not hold"),
    ("empty.obj", "", "cannot be read|holds no triangles"),
    ("noise.obj", bytes(range(256)) * 4, "cannot be read|holds no triangles"),
    ("magic.glb", b"GLTF" + bytes(40), "has no GLB header"),
    ("short.glb", triangle_glb()[:-4], "declares"),
    ("json.glb", glb({})[:20] + b"{" * (len(glb({})) - 20), "cannot be read"),
    ("nothing.glb", glb(EMPTY_SCENE), "cannot be read|holds no triangles"),
    ("cycle.glb", glb(CYCLIC_SCENE), "cannot be read|holds no triangles"),
    ("magic.off", "8 12 0\n", "has no OFF header"),
    ("few.off", "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "declares 3 vertices and 2 faces"),
    ("thin.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "a face with missing corners"),
    ("huge.off", "OFF\n999999999999 1 0\n0 0 0\n", "declares 999999999999 vertices"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "message"), DAMAGED, ids=[case[0] for case in DAMAGED])
def test_damaged_mesh_files(name: str, content: bytes | str, message: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(BodyFileError, match=message) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))


def npz(**members: Any) -> bytes:
    """An npz of arrays, or of raw bytes where a member is bytes."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in members.items():
            if not isinstance(value, bytes):
                buffer = io.BytesIO()
                np.lib.format.write_array(buffer, np.asarray(value), allow_pickle=True)
                value = buffer.getvalue()
            archive.writestr(f"{name}.npy", value)
    return memory.getvalue()


def npy(shape: tuple[int, ...], data: bytes, version: tuple[int, int] = (1, 0), descr: str = "<f8") -> bytes:
    """An npy file that declares one thing and holds another."""
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    header += " " * (-(len(header) + 11) % 64) + "\n"
    return b"\x93NUMPY" + bytes(version) + struct.pack("<H", len(header)) + header.encode() + data


LENGTHS = np.array([1.0, 1.0, 1.0])
CUBE = np.ones((2, 2, 2))


class Trap:
    """Unpickling this fails the test."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return pytest.fail, ("unpickled",)


VOXEL_FILES: list[tuple[str, bytes, str]] = [
    ("not a zip", b"values", "cannot be read"),
    ("empty", b"", "cannot be read"),
    ("no values", npz(lengths=LENGTHS), "holds no array 'values'"),
    ("no lengths", npz(values=CUBE), "holds no array 'lengths'"),
    ("pickled", npz(values=np.array([Trap()]), lengths=LENGTHS), "pickled objects"),
    ("bomb", npz(values=npy((10**4,) * 3, bytes(10**6)), lengths=LENGTHS), "over the limit"),
    ("overflow", npz(values=npy((2**33,) * 3, bytes(8)), lengths=LENGTHS), "over the limit"),
    ("too few", npz(values=npy((2, 2, 2), bytes(56)), lengths=LENGTHS), "declares 64 bytes of data and holds 56"),
    ("too many", npz(values=npy((2, 2, 2), bytes(72)), lengths=LENGTHS), "declares 64 bytes of data and holds 72"),
    ("negative", npz(values=npy((-2, -2, 2), bytes(64)), lengths=LENGTHS), "cannot be read"),
    ("new version", npz(values=npy((2, 2, 2), bytes(64), (9, 0)), lengths=LENGTHS), "cannot be read"),
    ("code", npz(values=npy((2, 2, 2), bytes(64), descr="__import__"), lengths=LENGTHS), "cannot be read"),
    ("complex", npz(values=CUBE * 1j, lengths=LENGTHS), "values has dtype complex128"),
    ("NaN", npz(values=CUBE * np.nan, lengths=LENGTHS), r"values is nan at index \(0, 0, 0\)"),
    ("flat", npz(values=CUBE[0], lengths=LENGTHS), r"values has shape \(2, 2\)"),
    ("no cells", npz(values=CUBE[:0], lengths=LENGTHS), "no cells"),
    ("four lengths", npz(values=CUBE, lengths=np.ones(4)), "lengths has 4 entries"),
    ("lengths of words", npz(values=CUBE, lengths=np.array(["a", "b", "c"])), "has lengths of shape"),
    ("lengths in rows", npz(values=CUBE, lengths=np.ones((3, 1))), "has lengths of shape"),
    ("a negative length", npz(values=CUBE, lengths=-LENGTHS), "lengths is -1.0 on axis 0"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "message"), [pytest.param(*case[1:], id=case[0]) for case in VOXEL_FILES])
def test_damaged_voxel_files(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "v.npz"
    path.write_bytes(content)
    with pytest.raises(BodyFileError, match=message) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))


def test_places_that_are_no_files(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"none.stl: does not exist"):
        load(tmp_path / "none.stl")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.stl")
    with pytest.raises(BodyFileError, match="is a folder"):
        load(tmp_path)
    (tmp_path / "a.zip").write_bytes(b"")
    with pytest.raises(BodyFileError, match=r"has the suffix '.zip'; give one of .stl, "):
        load(tmp_path / "a.zip")


def test_limits_and_units(tmp_path: Path) -> None:
    path = write(tmp_path, "own.stl")
    with pytest.raises(BodyFileError, match=r"has 4,084 bytes; raise max_bytes above 4,083"):
        load(path, max_bytes=4083)
    load(path, max_bytes=4084)
    with pytest.raises(BodyFileError, match="over the limit of 1,900"):
        # 2·4·5·6 doubles are 1,920 bytes; random values do not compress, but the archive's file is larger anyway.
        np.savez_compressed(tmp_path / "z.npz", values=np.zeros((4, 5, 12)), lengths=LENGTHS)
        load(tmp_path / "z.npz", max_bytes=1900)
    with pytest.raises(ArgumentError, match="unit: is 'ft'"):
        load(path, unit="ft")
    with pytest.raises(ArgumentError, match="max_bytes: is 0"):
        load(path, max_bytes=0)


@pytest.mark.parametrize("suffix", [s.upper() for s in SUFFIXES])
def test_suffixes_in_capitals(suffix: str, tmp_path: Path) -> None:
    save_mesh(BODY, tmp_path / f"a{suffix}")
    assert isinstance(load(tmp_path / f"a{suffix}"), TriangleMesh)


def test_saving_degenerate_triangles_keeps_the_mesh_closed(tmp_path: Path) -> None:
    tiny = TriangleMesh(BODY.vertices * 1e-9 + 1.0, BODY.faces)  # float32 makes all its vertices one
    flat = TriangleMesh(BODY.vertices * [1, 1, 0], BODY.faces)
    for suffix in SUFFIXES:
        for mesh in (tiny, flat):
            save_mesh(mesh, tmp_path / f"a{suffix}")
            back = load(tmp_path / f"a{suffix}")
            assert isinstance(back, TriangleMesh)
            assert back.is_closed
            assert len(back.faces) == len(mesh.faces)


def test_bad_saving(tmp_path: Path) -> None:
    with pytest.raises(DtypeError, match="mesh: is a Polygons"):
        save_mesh(disk(1), tmp_path / "a.stl")  # type: ignore[arg-type]
    with pytest.raises(DtypeError, match="grid: is a ndarray"):
        save_voxels(np.ones((2, 2)), tmp_path / "a.npz")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"path: is .*a.npz'; give a name that ends in .stl"):
        save_mesh(BODY, tmp_path / "a.npz")
    with pytest.raises(ArgumentError, match=r"give a name that ends in .npz"):
        save_voxels(VOXELS, tmp_path / "a")
    with pytest.raises(MissingFileError, match="is not a folder; create it first"):
        save_mesh(BODY, tmp_path / "none" / "a.stl")
    assert list(tmp_path.iterdir()) == []
