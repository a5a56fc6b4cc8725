"""The command line as a user calls it: what it prints, what it writes, and how it fails."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import batches, cli, commands, shading
from accel_shapegen.backends.base import DeviceInfo
from accel_shapegen.bodies.files import save_mesh, save_voxels

PROGRAM = Path(sys.executable).with_name("accel-shapegen")
KITES = ["--family", "kite", "--grid", "b1=0.8:1.2:3", "--grid", "b2=0.8,1.0,1.3", "--order", "6"]
CUBOIDS = ["--family", "cuboid", "--grid", "e0=1:1.5:2", "--grid", "e1=1:1.5:2", "--grid", "e2=1:2:2"]
COARSE = ["--order", "4", "--voxels", "24"]


class Answer(NamedTuple):
    """What a run left behind."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        assert self.status == 0, self.err
        return json.loads(self.out)


Call = Callable[..., Answer]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Call:
    """Runs the command line in an empty folder, on the oracle unless a test says otherwise."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "reference")
    monkeypatch.delenv("ACCEL_SHAPEGEN_DEVICE", raising=False)

    def run(*words: object) -> Answer:
        capsys.readouterr()
        status = cli.main([str(word) for word in words])
        return Answer(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with kite.npz and cuboid.npz."""
    folder = tmp_path_factory.mktemp("models")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ACCEL_SHAPEGEN_BACKEND", "reference")
        assert cli.main(["train", *KITES, "--out", str(folder / "kite.npz")]) == 0
        assert cli.main(["train", *CUBOIDS, *COARSE, "--out", str(folder / "cuboid.npz")]) == 0
    return folder


def start(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """The installed program in a process of its own."""
    return subprocess.run(
        [PROGRAM, *map(str, words)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def write_table(path: Path, header: Sequence[object], rows: Sequence[Sequence[object]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    return path


# Help and errors


def test_the_program_without_words_lists_its_verbs(call: Call) -> None:
    answer = call()
    assert answer.status == 0
    for verb in commands.VERBS:
        assert f" {verb.__name__} " in answer.out


@pytest.mark.parametrize("verb", [verb.__name__ for verb in commands.VERBS])
def test_every_verb_has_help(call: Call, verb: str) -> None:
    answer = call(verb, "--help")
    assert answer.status == 0
    assert f"accel-shapegen {verb}" in answer.out
    assert "--json" in answer.out
    assert "--debug" in answer.out
    # Square brackets of texts would be taken for markup, and vanish.
    assert "\\[" not in answer.out


def test_the_version_is_that_of_the_package(call: Call) -> None:
    assert call("--version").out == f"accel-shapegen {asg.__version__}\n"


def test_the_installed_program_runs() -> None:
    done = start("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"accel-shapegen {asg.__version__}\n", "")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["genrate"], ["genrate", "generate"]),
        (["generate"], ["MODEL"]),
        (["demo", "--ot", "x"], ["--ot", "--out"]),
        (["train", "--boundary", "periodic"], ["--boundary", "periodic", "natural"]),
        (["demo", "--backend", "cuda"], ["cuda", "opencl", "reference"]),
        (["demo", "--backend", "reference", "--device", "nine"], ["device", "nine"]),
        (["train"], ["TABLE", "--family"]),
        (["train", "t.csv", "--family", "kite"], ["TABLE", "--family"]),
        (["train", "t.csv", "--box", "2", "--order", "3"], ["t.csv"]),
        (["train", "t.csv", "--box", "2", "--order", "3", "--grid", "a=1:2:3"], ["--grid", "--family"]),
        (["train", "--family", "dragon"], ["--family", "dragon", "human"]),
        (["train", "--family", "ball", "--grid", "r=1:2:3", "--order", "3"], ["--box"]),
        (["train", "--family", "ball", "--grid", "r=1:2:3", "--box", "5"], ["--order"]),
        (["train", "--family", "kite", "--grid", "b1=1:2:3"], ["--grid", "b2"]),
        (["train", *KITES, "--grid", "b1=1:2:3"], ["--grid", "b1", "twice"]),
        (["train", *KITES, "--grid", "b3=1:2:3"], ["--grid", "b3", "b1, b2"]),
        (["train", "--family", "kite", "--grid", "b1=2:1:3"], ["--grid", "b1", "ascending"]),
        (["train", "--family", "kite", "--grid", "b1=1"], ["--grid", "b1", "two"]),
        (["train", "--family", "kite", "--grid", "b1=1:2"], ["--grid", "b1=1:2", "COUNT"]),
        (["train", "--family", "kite", "--grid", "b1=1:2:1"], ["--grid", "b1=1:2:1"]),
        (["train", "--family", "kite", "--grid", "b1=1:nan:3"], ["--grid", "nan"]),
        (["train", "--family", "kite", "--grid", "1:2:3"], ["--grid", "NAME"]),
        (["train", "--family", "kite", "--grid", "b1=1,x,3"], ["--grid", "'x'", "b1"]),
        (["train", *KITES, "--box", "a"], ["--box", "'a'", "metres"]),
        (["train", *KITES, "--box", "-1"], ["--box", "-1"]),
        (["train", *KITES, "--box", "7,7,7"], ["--box", "3", "2-D"]),
        (["train", *KITES, "--order", "2.5"], ["--order", "2.5"]),
        (["train", *KITES, "--order", "0"], ["--order", "0"]),
        (["train", *KITES, "--voxels", "10,10,10"], ["--voxels", "3"]),
        (["train", *KITES, "--box", "3"], ["b1=0.8, b2=1.3", "box"]),
        (["train", *KITES, "--out", "no/where.npz"], ["--out", "no"]),
        (["train", *CUBOIDS, *COARSE, "--box", "1.8"], ["e0=1, e1=1, e2=2", "box"]),
        (["generate", "none.npz", "--at", "a=1"], ["none.npz"]),
    ],
)
def test_what_is_wrong_is_one_line(call: Call, tmp_path: Path, words: list[str], parts: list[str]) -> None:
    answer = call(*words)
    assert (answer.status, answer.out) == (2, "")
    assert answer.err.startswith("error: ")
    assert answer.err.count("\n") == 1
    for part in parts:
        assert part in answer.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words", [["generate", "none.npz", "--debug"], ["generate", "--debug", "none.npz", "--at", "a"]]
)
def test_debug_shows_where_it_was_noticed(call: Call, words: list[str]) -> None:
    answer = call(*words)
    assert answer.status == 2
    assert "Traceback" in answer.err
    assert answer.err.splitlines()[-1].startswith("error: none.npz: does not exist")


def test_an_error_of_the_system_is_one_line_too(call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    answer = call("demo", "--out", "file/out", "--no-picture")
    assert answer.status == 2
    assert answer.err.startswith("error: ")
    assert "file/out" in answer.err


def test_an_interrupted_run_says_so(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("accel_shapegen.demo.run_demo", interrupt)
    assert call("demo").status == 130


def test_the_installed_program_fails_with_status_2() -> None:
    done = start("train")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


# devices


def test_devices_in_json() -> None:
    done = start("devices", "--json", ACCEL_SHAPEGEN_BACKEND="", ACCEL_SHAPEGEN_DEVICE="", POCL_MAX_PTHREAD_COUNT="2")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found) == {"devices", "order", "chosen", "environment", "remarks"}
    expected = {(info.backend, info.index, info.label, info.usable) for info in asg.backends.available()}
    assert {(d["backend"], d["index"], d["label"], d["usable"]) for d in found["devices"]} == expected
    for device in found["devices"]:
        assert set(device["operations"]) <= set(asg.backends.OPERATIONS)
        assert bool(device["operations"]) == device["usable"]
        assert isinstance(device["problems"], list)
        assert device["memory_bytes"] >= 0
    assert list(found["chosen"]) == list(asg.backends.OPERATIONS)
    for operation, choice in found["chosen"].items():
        info = asg.backends.get(operation=operation).info
        assert (choice["backend"], choice["index"], choice["label"]) == (info.backend, info.index, info.label)
        assert choice["why"]
        assert choice["error"] is None
    assert found["environment"]["POCL_MAX_PTHREAD_COUNT"] == "2"


def test_devices_fit_a_hundred_columns(call: Call) -> None:
    answer = call("devices")
    assert answer.status == 0
    assert max(map(len, answer.out.splitlines())) <= 100
    for word in ("reference 0", *asg.backends.OPERATIONS, "asked for by", "NumPy"):
        assert word in answer.out


@pytest.mark.parametrize(
    ("backend", "device", "why"),
    [
        ("reference", None, "asked for by ACCEL_SHAPEGEN_BACKEND=reference"),
        ("reference", "0", "asked for by ACCEL_SHAPEGEN_BACKEND=reference and ACCEL_SHAPEGEN_DEVICE=0"),
        (None, "numpy", "asked for by ACCEL_SHAPEGEN_DEVICE=numpy"),
    ],
)
def test_devices_say_whose_wish_it_was(
    call: Call, monkeypatch: pytest.MonkeyPatch, backend: str | None, device: str | None, why: str
) -> None:
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", backend or "")
    monkeypatch.setenv("ACCEL_SHAPEGEN_DEVICE", device or "")
    for choice in call("devices", "--json").json["chosen"].values():
        assert (choice["backend"], choice["why"]) == ("reference", why)


def test_devices_say_when_a_wish_cannot_be_met(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "opencl")
    if not any(info.backend == "opencl" and info.usable for info in asg.backends.available()):
        pytest.skip("no OpenCL device")
    chosen = call("devices", "--json").json["chosen"]
    assert chosen["tensor_transform"]["why"] == "asked for by ACCEL_SHAPEGEN_BACKEND=opencl"
    assert "lacks it" in chosen["polygon_transform"]["why"]


def test_devices_fail_after_showing_what_there_is(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "cuda")
    answer = call("devices", "--json")
    assert answer.status == 2
    found = json.loads(answer.out)
    assert found["devices"]
    assert all("'cuda' is not registered" in choice["error"] for choice in found["chosen"].values())


def test_devices_name_traps(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = (
        DeviceInfo("opencl", index, "a cpu", "cpu", "P", version, usable=usable, problems=problems)
        for index, version, usable, problems in (
            (0, "PoCL 3.0", False, ("a folder cannot be written", "old")),
            (1, "PoCL 5.0", False, ("a folder cannot be written",)),
        )
    )
    monkeypatch.setattr(asg.backends, "available", lambda: [old, new])
    monkeypatch.setenv("POCL_OTHER", "1")
    monkeypatch.setenv("POCL_CACHE_DIR", "/a/cache")
    text = " ".join(call("devices").out.split())
    assert "! opencl 0 1: a folder cannot be written ! opencl 0: old" in text
    assert "a cpu (not usable)" in text
    assert "POCL_OTHER 1" in text
    assert "delete PoCL's kernel cache /a/cache" in text


# train


def test_training_a_family_is_what_the_library_does(call: Call, models: Path) -> None:
    model = asg.ShapeModel.load(models / "kite.npz", backend="reference")
    assert model.names == ("b1", "b2")
    assert [axis.tolist() for axis in model.knots] == [[0.8, 1.0, 1.2], [0.8, 1.0, 1.3]]
    lattice = asg.FourierLattice(asg.Box((7.0, 7.0)), 6)
    assert model.nodes == lattice
    u = asg.far_field(asg.bodies.kite(1.2, 0.8), lattice, backend="reference")
    assert np.array_equal(model.predict((1.2, 0.8)), u)


def test_training_says_what_it_did(call: Call, tmp_path: Path) -> None:
    told = call(
        "train",
        *CUBOIDS,
        "--order",
        "3,2,4",
        "--voxels",
        "12",
        "--dtype",
        "complex128",
        "--boundary",
        "clamped",
        "--json",
    ).json
    assert told["model"] == "model.npz"
    assert told["bytes"] == (tmp_path / "model.npz").stat().st_size
    assert told["device"] == asg.backends.get("reference").info.label
    assert (told["bodies"], told["voxels"], told["order"]) == (8, [12, 12, 12], [3, 2, 4])
    assert told["box_m"] == [3.0, 3.0, 3.0]
    assert told["values"] == {"e0": [1.0, 1.5], "e1": [1.0, 1.5], "e2": [1.0, 2.0]}
    assert (told["dtype"], told["boundary"]) == ("complex128", "clamped")
    model = asg.ShapeModel.load("model.npz")
    assert (model.dtype, model.axes[0].boundary) == (np.complex128, "clamped")


def test_training_prints_a_table_and_the_device(call: Call) -> None:
    answer = call("train", *KITES)
    assert answer.status == 0
    assert "9, exact" in answer.out
    assert "7 × 7 m, order 6 × 6" in answer.out
    assert asg.backends.get("reference").info.label in answer.out


def test_a_family_of_the_plane_is_voxelised_if_asked(call: Call) -> None:
    assert call("train", *KITES, "--voxels", "50", "--json").json["voxels"] == [50, 50]
    model = asg.ShapeModel.load("model.npz")
    body = asg.voxelize(asg.bodies.kite(0.8, 1.3), asg.Grid(model.nodes.box, 50))
    assert np.array_equal(model.predict((0.8, 1.3)), asg.far_field(body, model.nodes))


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A table of cuboids in no order: half of them meshes, half of them voxels, in a folder beside it."""
    folder = tmp_path / "shelf"
    (folder / "files").mkdir(parents=True)
    cells = asg.Grid(asg.Box((3.0, 3.0, 3.0)), 24)
    rows = []
    for index, (e0, e1, e2) in enumerate((x, y, z) for x in (1.0, 1.5) for y in (1.0, 1.5) for z in (1.0, 2.0)):
        mesh = asg.bodies.cuboid(e0, e1, e2)
        name = f"files/{index}.{'ply' if index % 2 else 'npz'}"
        if index % 2:
            save_mesh(mesh, folder / name)
        else:
            save_voxels(asg.voxelize(mesh, cells), folder / name)
        rows.append([e2, name, e0, e1])
    write_table(folder / "bodies.csv", ["e2", "file", "e0", "e1"], [rows[i] for i in (3, 0, 6, 7, 1, 5, 2, 4)])
    return folder


def test_a_table_of_files_gives_the_model_of_its_family(call: Call, models: Path, shelf: Path) -> None:
    told = call("train", shelf / "bodies.csv", "--box", "3", *COARSE, "--json").json
    assert list(told["values"]) == ["e2", "e0", "e1"]
    of_files, of_family = asg.ShapeModel.load("model.npz"), asg.ShapeModel.load(models / "cuboid.npz")
    # Extents of 1, 1.5 and 2 are exact in the files' float32.
    assert np.array_equal(of_files.predict((1.3, 1.1, 1.4)), of_family.predict((1.1, 1.4, 1.3)))


@pytest.mark.parametrize(
    ("header", "rows", "parts"),
    [
        ([], [], ["t.csv", "empty"]),
        (["a", "file"], [], ["t.csv", "no rows"]),
        (["a", "b"], [[1, 2]], ["t.csv", "'file'"]),
        (["file"], [["1.ply"]], ["t.csv", "file"]),
        (["a", "a", "file"], [[1, 2, "x"]], ["t.csv", "'a'", "twice"]),
        (["a", "", "file"], [[1, 2, "x"]], ["t.csv", "column 2"]),
        (["a", "file"], [[1, "good.ply"], ["two", "good.ply"]], ["row 2 (line 3)", "'a'", "'two'"]),
        (["a", "file"], [["inf", "good.ply"], [2, "good.ply"]], ["row 1 (line 2)", "'a'", "'inf'"]),
        (["a", "file"], [[1, "good.ply"], ["", "good.ply"]], ["row 2 (line 3)", "'a'", "empty"]),
        (["a", "file"], [[1, "good.ply"], [2]], ["row 2 (line 3)", "1 cells for 2"]),
        (["a", "file"], [[1, "good.ply"], [2, ""]], ["row 2 (line 3)", "'file'", "empty"]),
        (["a", "file"], [[1, "good.ply"], [2, "gone.ply"]], ["row 2 (line 3)", "'file'", "gone.ply"]),
        (["a", "file"], [[2, "good.ply"], [1, "cut.stl"]], ["row 2 (line 3)", "'file'", "cut.stl"]),
        (["a", "file"], [[2, "good.ply"], [1, "open.ply"]], ["row 2 (line 3)", "'file'", "open"]),
        (["a", "file"], [[2, "large.ply"], [1, "good.ply"]], ["row 1 (line 2)", "'file'", "box"]),
        (["a", "file"], [[2, "plane.npz"], [1, "good.ply"]], ["row 1 (line 2)", "'file'", "2-D"]),
        (["a", "file"], [[2, "many.npz"], [1, "good.ply"]], ["row 1 (line 2)", "'file'", "batch"]),
        (["a", "file"], [[1, "good.ply"], [1, "good.ply"]], ["t.csv", "repeated", "a=1"]),
        (["a", "b", "file"], [[1, 1, "good.ply"], [2, 2, "good.ply"]], ["t.csv", "missing", "a=1, b=2"]),
        (["a", "file"], [[1, "good.ply"]], ["a"]),
    ],
)
def test_faults_of_a_training_table(
    call: Call, tmp_path: Path, header: list[str], rows: list[list[object]], parts: list[str]
) -> None:
    cube, space = asg.bodies.cuboid(1, 1, 1), asg.Box((3.0, 3.0, 3.0))
    save_mesh(cube, tmp_path / "good.ply")
    save_mesh(asg.bodies.cuboid(4, 1, 1), tmp_path / "large.ply")
    save_mesh(asg.TriangleMesh(cube.vertices, cube.faces[1:]), tmp_path / "open.ply")
    save_voxels(asg.VoxelGrid(np.ones((4, 4)), asg.Box((1.0, 1.0))), tmp_path / "plane.npz")
    save_voxels(asg.VoxelGrid(np.ones((2, 4, 4, 4)), space), tmp_path / "many.npz")
    (tmp_path / "cut.stl").write_bytes(b"\0" * 90)
    table = tmp_path / "t.csv"
    if header:
        write_table(table, header, rows)
    else:
        table.write_text("\n")
    answer = call("train", table, "--box", "3", "--order", "3", "--voxels", "12")
    assert (answer.status, answer.out, answer.err.count("\n")) == (2, "", 1)
    for part in parts:
        assert part in answer.err
    assert not (tmp_path / "model.npz").exists()


@pytest.mark.parametrize("content", [b"a,file\n\xff\xfe,x\n", b'a,file\n"1,x\n'])
def test_a_file_that_is_no_table(call: Call, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "t.csv").write_bytes(content)
    answer = call("train", "t.csv", "--box", "3", "--order", "3")
    assert answer.status == 2
    assert "t.csv" in answer.err
    assert "UTF-8" in answer.err


def test_a_model_is_not_replaced_unasked(call: Call, tmp_path: Path) -> None:
    (tmp_path / "model.npz").write_text("mine")
    answer = call("train", *KITES)
    assert answer.status == 2
    assert "--overwrite" in answer.err
    assert (tmp_path / "model.npz").read_text() == "mine"
    assert call("train", *KITES, "--overwrite").status == 0
    assert asg.ShapeModel.load("model.npz").names == ("b1", "b2")


def test_an_explicit_backend_without_the_operation_is_an_error(call: Call) -> None:
    if not any(info.backend == "opencl" and info.usable for info in asg.backends.available()):
        pytest.skip("no OpenCL device")
    answer = call("train", *KITES, "--backend", "opencl")
    assert answer.status == 2
    assert "polygon_transform" in answer.err


# generate


def test_regions_of_the_plane_in_every_format(call: Call, models: Path, tmp_path: Path) -> None:
    import zarr

    words = ["--at", "b1=0.93,b2=1.1", "--at", "b2=1.3, b1=0.8", "--grid", "40,32", "--format", "rings,npz", "--format"]
    told = call("generate", models / "kite.npz", *words, "zarr,png", "--out", "made", "--json").json
    assert json.loads((tmp_path / "made" / "manifest.json").read_text()) == told
    assert (told["cells"], told["box_m"], told["level"]) == ([40, 32], [7.0, 7.0], 0.5)
    assert [body["values"] for body in told["bodies"]] == [{"b1": 0.93, "b2": 1.1}, {"b1": 0.8, "b2": 1.3}]
    model = asg.ShapeModel.load(models / "kite.npz")
    grid = asg.Grid(model.nodes.box, (40, 32))
    fields = model.generate([[0.93, 1.1], [0.8, 1.3]], grid)
    volumes = zarr.open_array(tmp_path / "made" / told["volumes"], mode="r")
    assert np.array_equal(volumes[:], fields)
    assert volumes.attrs["values"] == [[0.93, 1.1], [0.8, 1.3]]
    assert (volumes.attrs["names"], volumes.attrs["lengths"]) == (["b1", "b2"], [7.0, 7.0])
    for field, body in zip(fields, told["bodies"], strict=True):
        files = {name: tmp_path / "made" / file for name, file in body["files"].items()}
        assert set(files) == {"rings", "npz", "png"}
        loaded = asg.bodies.load(files["npz"])
        assert isinstance(loaded, asg.VoxelGrid)
        assert np.array_equal(loaded.values, field)
        assert loaded.box == model.nodes.box
        surface = asg.extract_surface(field, grid)
        with np.load(files["rings"]) as rings:
            assert len(rings.files) == len(surface.rings)
            assert all(np.array_equal(rings[f"ring_{i}"], ring) for i, ring in enumerate(surface.rings))
        assert body["surface"]["volume"] == surface.volume
        assert files["png"].stat().st_size > 1000


def test_solids_in_every_format(call: Call, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shading, "SUPERSAMPLING", 1)  # a quarter of the time, for a coarser outline
    formats = "ply,stl,glb,obj,png"
    told = call(
        "generate", models / "cuboid.npz", "--at", "e0=1.2,e1=1.3,e2=1.7", "--grid", "24", "--format", formats, "--json"
    ).json
    (body,) = told["bodies"]
    assert told["device"] == asg.backends.get("reference").info.label
    assert told["volumes"] is None
    grid = asg.Grid(asg.Box((3.0, 3.0, 3.0)), 24)
    field = asg.ShapeModel.load(models / "cuboid.npz").generate((1.2, 1.3, 1.7), grid)
    surface = asg.extract_surface(field, grid)
    assert body["surface"]["closed"] is True
    assert (body["surface"]["volume"], body["surface"]["components"]) == (surface.volume, surface.quality.components)
    assert body["surface"]["extent_m"] == np.ptp(surface.bounds, axis=0).tolist()
    for name in ("ply", "stl", "glb", "obj"):
        mesh = asg.bodies.load(Path("out/generated") / body["files"][name])
        assert isinstance(mesh, asg.TriangleMesh)
        assert mesh.is_closed
        # Formats hold float32: some 1e-7 of each length.
        assert mesh.volume == pytest.approx(surface.volume, rel=1e-5)
        assert mesh.bounds == pytest.approx(surface.bounds, abs=2e-7)
    assert (tmp_path / "out/generated" / body["files"]["png"]).stat().st_size > 1000


@pytest.mark.parametrize(("model", "expected"), [("kite.npz", "rings"), ("cuboid.npz", "ply")])
def test_the_default_format_is_a_surface(call: Call, models: Path, model: str, expected: str) -> None:
    names = asg.ShapeModel.load(models / model).names
    told = call(
        "generate", models / model, "--at", ",".join(f"{name}=1.2" for name in names), "--grid", "30", "--json"
    ).json
    assert list(told["bodies"][0]["files"]) == [expected]


def test_a_table_in_any_order_of_columns_and_batches(
    call: Call, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batches, "ONE_SHOT_BATCH", 2)
    rows = [[1.3, 0.8], [0.9, 1.1], [1.0, 1.0], [1.25, 0.85], [0.8, 1.2]]
    table = write_table(tmp_path / "q.csv", ["b2", "b1"], rows)
    answer = call("generate", models / "kite.npz", table, "--out", "made", "--grid", "30", "--format", "npz")
    assert answer.status == 0
    grid = asg.Grid(asg.Box((7.0, 7.0)), 30)
    expected = asg.ShapeModel.load(models / "kite.npz").generate([[b1, b2] for b2, b1 in rows], grid)
    found = [asg.bodies.load(tmp_path / "made" / f"body_{index:04d}.npz") for index in range(5)]
    assert np.array_equal([body.values for body in found], expected)
    # Fields alone need no surface, and none is shown.
    assert "–" in answer.out
    assert asg.backends.get("reference").info.label in answer.out


def test_a_window_and_extrapolation_are_passed_on(call: Call, models: Path, tmp_path: Path) -> None:
    words = ["--at", "b1=1.25,b2=1.0", "--grid", "30", "--format", "npz", "--window", "fejer", "--extrapolate"]
    told = call("generate", models / "kite.npz", *words, "--out", "made", "--json").json
    assert (told["window"], told["extrapolate"]) == ("fejer", True)
    expected = asg.ShapeModel.load(models / "kite.npz").generate(
        (1.25, 1.0), asg.Grid(asg.Box((7.0, 7.0)), 30), window="fejer", extrapolate="linear"
    )
    assert np.array_equal(asg.bodies.load(tmp_path / "made/body_0000.npz").values, expected)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([], ["TABLE", "--at"]),
        (["q.csv", "--at", "b1=1,b2=1"], ["TABLE", "--at"]),
        (["gone.csv"], ["gone.csv"]),
        (["--at", "b1=1"], ["--at", "b1, b2"]),
        (["--at", "b1=1,b2=1,b3=1"], ["--at", "b3"]),
        (["--at", "b1=1,b1=1"], ["--at", "b1 twice"]),
        (["--at", "b1=1,b2=x"], ["--at", "b2=x"]),
        (["--at", "b1=1,b2"], ["--at", "'b2'"]),
        (["--at", "b1=1,b2=2"], ["b1=1,b2=2", "b2 2", "[0.8, 1.3]", "--extrapolate"]),
        (["q.csv"], ["q.csv", "row 2 (line 3)", "b1 1.5", "[0.8, 1.2]"]),
        (["--at", "b1=1,b2=1", "--format", "ply"], ["--format", "ply", "2-D", "rings"]),
        (["--at", "b1=1,b2=1", "--format", "npz,vtk"], ["--format", "vtk", "zarr"]),
        (["--at", "b1=1,b2=1", "--grid", "1.5"], ["--grid", "1.5"]),
        (["--at", "b1=1,b2=1", "--grid", "0"], ["--grid", "0"]),
        (["--at", "b1=1,b2=1", "--grid", "3,3,3"], ["--grid", "3"]),
        (["--at", "b1=1,b2=1", "--window", "hann"], ["--window", "hann"]),
        (["wide.csv"], ["wide.csv", "'c'", "b1, b2"]),
        (["narrow.csv"], ["narrow.csv", "'b2'"]),
    ],
)
def test_faults_of_a_request(call: Call, models: Path, tmp_path: Path, words: list[str], parts: list[str]) -> None:
    write_table(tmp_path / "q.csv", ["b1", "b2"], [[1, 1], [1.5, 1]])
    write_table(tmp_path / "wide.csv", ["b1", "b2", "c"], [[1, 1, 1]])
    write_table(tmp_path / "narrow.csv", ["b1"], [[1]])
    answer = call("generate", models / "kite.npz", *words, "--out", "made")
    assert (answer.status, answer.out, answer.err.count("\n")) == (2, "", 1)
    for part in parts:
        assert part in answer.err
    assert not (tmp_path / "made").exists()


def test_a_format_of_the_plane_is_none_of_solids(call: Call, models: Path) -> None:
    answer = call("generate", models / "cuboid.npz", "--at", "e0=1,e1=1,e2=1", "--format", "rings")
    assert answer.status == 2
    assert "'rings', not for models in 3-D" in answer.err


def test_a_body_without_a_surface_is_named_and_no_manifest_is_left(call: Call, models: Path, tmp_path: Path) -> None:
    # Two cells a side average nothing: far below the body's size, every sample may lie inside, and none does outside.
    table = write_table(tmp_path / "q.csv", ["b1", "b2"], [[1, 1], [1.1, 1]])
    made = tmp_path / "made"
    made.mkdir()
    (made / "manifest.json").write_text("{}")
    answer = call("generate", models / "kite.npz", table, "--out", made, "--grid", "2", "--overwrite")
    assert answer.status == 2
    assert "row 1 (line 2)" in answer.err
    assert not (made / "manifest.json").exists()


def test_files_are_not_replaced_unasked(call: Call, models: Path, tmp_path: Path) -> None:
    words = ["generate", models / "kite.npz", "--out", "made", "--grid", "30", "--format", "npz,zarr", "--at"]
    assert call(*words, "b1=1,b2=1").status == 0
    before = (tmp_path / "made/body_0000.npz").read_bytes()
    answer = call(*words, "b1=1.1,b2=1")
    assert answer.status == 2
    assert "--overwrite" in answer.err
    assert (tmp_path / "made/body_0000.npz").read_bytes() == before
    (tmp_path / "made/manifest.json").unlink()
    assert call(*words, "b1=1.1,b2=1").status == 2, "files without their manifest are kept too"
    assert call(*words, "b1=1.1,b2=1", "--overwrite").status == 0
    assert (tmp_path / "made/body_0000.npz").read_bytes() != before


@pytest.mark.parametrize(("module", "name"), [("zarr", "zarr"), ("matplotlib", "png")])
def test_what_is_not_installed_is_said_before_the_work(
    call: Call, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, name: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    answer = call("generate", models / "kite.npz", "--at", "b1=1,b2=1", "--format", name, "--out", "made")
    assert answer.status == 2
    assert f'pip install "accel-shapegen[{"plot" if name == "png" else "zarr"}]"' in answer.err
    assert not (tmp_path / "made").exists()


def test_damage_to_zarr_volumes_is_seen(call: Call, models: Path, tmp_path: Path) -> None:
    import zarr

    call("generate", models / "kite.npz", "--at", "b1=1,b2=1", "--grid", "30", "--format", "zarr", "--out", "made")
    folder = tmp_path / "made" / "volumes.zarr"
    (chunk,) = (path for path in folder.rglob("*") if path.is_file() and path.name != "zarr.json")
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(Exception, match=r"(?i)checksum"):
        zarr.open_array(folder, mode="r")[:]


def test_a_damaged_model_is_one_line(call: Call, models: Path, tmp_path: Path) -> None:
    content = bytearray((models / "kite.npz").read_bytes())
    content[1000] ^= 1
    (tmp_path / "bad.npz").write_bytes(content)
    answer = call("generate", "bad.npz", "--at", "b1=1,b2=1")
    assert (answer.status, answer.err.count("\n")) == (2, 1)
    assert "bad.npz" in answer.err


def test_a_model_over_scattered_nodes_cannot_generate(call: Call, tmp_path: Path) -> None:
    nodes = asg.ScatteredNodes([[1.0, 0.0], [0.0, 1.0]], 2.0)
    asg.ShapeModel.fit([[0.0, 1.0]], np.ones((2, 2), dtype=np.complex64), nodes, names=["a"]).save("scattered.npz")
    answer = call("generate", "scattered.npz", "--at", "a=0.5")
    assert answer.status == 2
    assert "scattered" in answer.err


def test_train_and_generate_as_processes_on_the_best_device(tmp_path: Path) -> None:
    model, made = tmp_path / "model.npz", tmp_path / "made"
    train = start("train", *CUBOIDS, *COARSE, "--out", model, "--json", ACCEL_SHAPEGEN_BACKEND="")
    assert train.returncode == 0, train.stderr
    assert json.loads(train.stdout)["device"] == asg.backends.get(operation="tensor_transform").info.label
    words = ["generate", model, "--at", "e0=1.2,e1=1.2,e2=1.5", "--out", made, "--grid", "24", "--json"]
    done = start(*words, ACCEL_SHAPEGEN_BACKEND="")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert json.loads(done.stdout)["bodies"][0]["surface"]["closed"]
    assert sorted(path.name for path in made.iterdir()) == ["body_0000.ply", "manifest.json"]
