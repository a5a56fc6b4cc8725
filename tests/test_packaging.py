"""The kernels and the data travel: into a wheel, into an sdist, and to where they are used from."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from accel_shapegen import kernels

ROOT = Path(__file__).resolve().parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = PROJECT["tool"]["setuptools"]["packages"]

# What a wheel carries of the source tree; anything else in a package's folder is a mistake or a cache.
CARRIED = {".py", ".cl", ".h", ".npz", ".md", ".typed"}
CACHES = {"__pycache__", ".DS_Store"}


def installed_files() -> dict[str, Path]:
    """Every file of the two source folders, keyed by its path in an installation."""
    files = {}
    for folder, prefix in (("accel_shapegen", "accel_shapegen"), ("kernels", "accel_shapegen/kernels")):
        for path in (ROOT / folder).rglob("*"):
            relative = path.relative_to(ROOT / folder)
            if path.is_file() and CACHES.isdisjoint(relative.parts):
                files[f"{prefix}/{relative.as_posix()}"] = path
    return files


def run(*command: str | Path, cwd: Path) -> str:
    """Standard output of a command that must succeed, in a folder, with no path of the checkout handed down."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the sdist of a copy of the checkout, and the wheel that was built from that sdist."""
    # A copy, since a build leaves build/lib behind, from which deleted modules would come back.
    source, out = tmp_path_factory.mktemp("source") / "tree", tmp_path_factory.mktemp("dist")
    left_behind = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "out", "build", "dist")
    shutil.copytree(ROOT, source, ignore=left_behind)
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, source, cwd=out)
    return out


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel installed into a folder of its own; what it depends on is taken from this environment."""
    target = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install"]
    run(*pip, "--quiet", "--no-deps", "--no-index", "--target", target, wheel, cwd=target)
    return target


@pytest.fixture
def elsewhere(site: Path, tmp_path: Path) -> Iterator[Any]:
    """Runs statements on the installed wheel, from a folder that is not the checkout; returns the JSON they print."""

    def call(statements: str) -> Any:
        # First on the path, so that it wins over the editable install that these tests may run on.
        code = f"import sys; sys.path.insert(0, {str(site)!r}); import json\n{statements}"
        return json.loads(run(sys.executable, "-c", code, cwd=tmp_path))

    yield call


def test_the_packages_listed_are_the_folders_that_exist() -> None:
    folders = {path.rpartition("/")[0].replace("/", ".") for path in installed_files()}
    assert sorted(folders) == PACKAGES


def test_every_file_is_of_a_kind_that_travels() -> None:
    assert [
        name for name, path in installed_files().items() if path.suffix not in CARRIED and path.name != "py.typed"
    ] == []


def test_the_wheel_holds_the_tree_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        contents = {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}
    expected = installed_files()
    assert sorted(contents) == sorted(expected)
    assert [name for name, path in expected.items() if contents[name] != path.read_bytes()] == []
    assert any(name.startswith("accel_shapegen/kernels/opencl/") and name.endswith(".cl") for name in contents)


def test_the_wheel_says_what_it_is(wheel: Path) -> None:
    project = PROJECT["project"]
    assert wheel.name == f"accel_shapegen-{project['version']}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        info = f"accel_shapegen-{project['version']}.dist-info"
        metadata = archive.read(f"{info}/METADATA").decode()
        licence = archive.read(f"{info}/licenses/LICENSE")
    assert "License-Expression: BSD-3-Clause\n" in metadata
    assert licence == (ROOT / "LICENSE").read_bytes()


def test_the_sdist_holds_what_the_wheel_is_made_of(built: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        contents = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {path.relative_to(ROOT).as_posix() for path in installed_files().values()}
    assert wanted | {"pyproject.toml", "README.md", "LICENSE"} <= contents


def test_the_installed_wheel_works_from_another_folder(elsewhere: Any, site: Path) -> None:
    where, sources, alone = elsewhere(
        "import importlib.util, accel_shapegen.kernels as k\n"
        "alone = importlib.util.find_spec('kernels') is None\n"
        "print(json.dumps([k.__file__, {name: k.source(name) for name in k.names()}, alone]))"
    )
    assert Path(where) == site / "accel_shapegen" / "kernels" / "__init__.py"
    assert sources == {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "kernels/opencl").glob("*.cl")}
    assert alone, "the wheel must not bring a top-level module `kernels`"


def test_the_installed_wheel_computes_a_far_field_on_opencl(elsewhere: Any, site: Path) -> None:
    # Built from the installed kernel sources; the mean of an all-ones body over its box is its volume.
    where, error = elsewhere(
        "import accel_shapegen as asg, numpy as np\n"
        "box = asg.Box((1.0, 1.5, 2.0)); lattice = asg.FourierLattice(box, 2)\n"
        "body = asg.VoxelGrid(np.ones((4, 5, 6)), box)\n"
        "u = asg.far_field(body, lattice, dtype='complex128', backend='opencl')\n"
        "f = asg.fourier_coefficients(u, lattice); f[lattice.zero_slot] -= 1\n"
        "print(json.dumps([asg.__file__, float(abs(f).max())]))"
    )
    assert Path(where) == site / "accel_shapegen" / "__init__.py"
    # Sums of 120 unit terms in float64, through two chains of a few operations each.
    assert error < 1e-13


@pytest.mark.parametrize("group", ["console_scripts", "accel_shapegen.backends"])
def test_entry_points_load(group: str) -> None:
    project = PROJECT["project"]
    declared = project["scripts"] if group == "console_scripts" else project["entry-points"][group]
    found = {point.name: point for point in entry_points(group=group) if point.value.startswith("accel_shapegen.")}
    assert {name: point.value for name, point in found.items()} == declared
    assert all(callable(point.load()) for point in found.values())


def test_the_version_has_one_source() -> None:
    import accel_shapegen

    assert accel_shapegen.__version__ == PROJECT["project"]["version"]


def test_kernel_sources_are_read_by_name() -> None:
    folder = ROOT / "kernels" / "opencl"
    assert kernels.include_dir() == folder
    assert kernels.names() == tuple(sorted(path.stem for path in folder.glob("*.cl")))
    assert kernels.source("tensor_transform") == (folder / "tensor_transform.cl").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["tensor_transfrom", "../__init__", "real.h", "", "tensor_transform.cl"])
def test_an_unknown_kernel_is_an_error_that_lists_those_there_are(name: str) -> None:
    with pytest.raises(LookupError) as caught:
        kernels.source(name)
    assert repr(name) in str(caught.value)
    assert ", ".join(kernels.names()) in str(caught.value)


@pytest.mark.parametrize("read", [kernels.names, kernels.include_dir, lambda backend: kernels.source("real", backend)])
def test_an_unknown_backend_has_no_sources(read: Any) -> None:
    with pytest.raises(kernels.KernelNotFoundError, match=r"'cuda'.*opencl"):
        read("cuda")
