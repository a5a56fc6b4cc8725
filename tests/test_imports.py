"""Imports are lazy and point one way."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

HEAVY = (
    "pyopencl", "warp", "torch", "dask", "trimesh", "skimage", "matplotlib", "zarr", "scipy.interpolate", "rich",
    "typer",
)  # fmt: skip


def heavy_modules_after(statement: str, tmp_path: Path) -> list[str]:
    """Which of `HEAVY` a fresh interpreter has loaded after running a statement outside the checkout."""
    code = f"import sys\n{statement}\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    "statement",
    [
        "import accel_shapegen",
        "import accel_shapegen as asg; asg.FourierLattice(asg.Box((2.2, 2.2, 2.2)), 3)",
        "import accel_shapegen as asg; asg.far_field, asg.synthesize, asg.ShapeModel, asg.extract_surface",
        "import accel_shapegen as asg; dir(asg), asg.__version__",
        "import accel_shapegen.bodies, accel_shapegen.backends, accel_shapegen.cli",
    ],
)
def test_import_loads_nothing_heavy(statement: str, tmp_path: Path) -> None:
    assert heavy_modules_after(statement, tmp_path) == []


def test_a_heavy_import_would_be_seen(tmp_path: Path) -> None:
    assert heavy_modules_after("import scipy.interpolate, rich", tmp_path) == ["scipy.interpolate", "rich"]


# A layer may import itself and the layers after the arrow. Every module has its layer: a new one is added here.
MAY_IMPORT = {
    "kernels": set(),
    "foundation": set(),
    "numerics": {"foundation"},
    "backends": {"foundation", "kernels"},
    "bodies": {"foundation", "numerics"},
    "operations": {"foundation", "numerics", "bodies", "backends"},
    "drivers": {"foundation", "numerics", "bodies", "backends", "operations", "front"},
    "cli": {"foundation", "numerics", "bodies", "backends", "operations", "drivers", "front"},
    # The package's own __init__ hands out what users call; nothing below the drivers may go through it.
    "front": {"foundation", "numerics", "bodies", "backends", "operations"},
}  # fmt: skip
LAYERS = {
    "foundation": ["errors", "extras", "arguments", "geometry", "nodes", "kernel_window", "quadrature"],
    "numerics": [
        "batches", "frames", "metrics", "noise", "progress", "shading", "splines", "surface", "testing",
        "voxelize",
    ],
    "backends": ["backends"],
    "bodies": ["bodies"],
    "kernels": ["kernels"],
    "operations": [
        "adequacy", "adequacy_report", "body_generators", "far_field", "fields", "mesh_far_field", "mesh_transform",
        "model", "model_file", "synthesis", "training_set", "voxel_transform",
    ],
    "drivers": ["adequacy_plot", "dataset", "demo", "experiments", "interop", "report", "volume_files"],
    "cli": ["cli", "commands"],
}  # fmt: skip
LAYER_OF = {"accel_shapegen": "front"} | {
    f"accel_shapegen.{module}": layer for layer, modules in LAYERS.items() for module in modules
}


def layer_of(module: str) -> str | None:
    """Layer of a dotted module name inside the package, by its first name under the package."""
    return LAYER_OF.get(".".join(module.split(".")[:2]))


def imported(source: str, module: str, modules: set[str], *, package: bool) -> Iterator[tuple[int, str]]:
    """(line, absolute module) for every import in a module, at any depth and under TYPE_CHECKING too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = module.split(".")
            up = node.level - package
            base = ".".join(parents[: len(parents) - up]) if node.level else ""
            origin = ".".join(filter(None, [base, node.module]))
            for alias in node.names:
                # `from . import nodes` names a module, `from .nodes import order_from_noise` something in one.
                inner = f"{origin}.{alias.name}"
                yield node.lineno, inner if inner in modules else origin


def violations(sources: dict[str, str], packages: set[str]) -> list[str]:
    """Imports that point the wrong way, as "module:line imports module" lines."""
    wrong = []
    for module, source in sources.items():
        layer = layer_of(module)
        for line, target in imported(source, module, set(sources), package=module in packages):
            if target.split(".")[0] == "kernels":
                wrong.append(f"{module}:{line} imports {target}, a second copy of accel_shapegen.kernels")
            elif layer is not None and target.split(".")[0] == "accel_shapegen":
                allowed = MAY_IMPORT[layer] | {layer}
                if layer_of(target) not in allowed:
                    wrong.append(f"{module}:{line} ({layer}) imports {target} ({layer_of(target)})")
    return wrong


def read_tree() -> tuple[dict[str, str], set[str]]:
    """Sources of the package by their installed names, of everything else by path; and which are packages."""
    sources, packages = {}, set()
    for folder in ("accel_shapegen", "kernels", "bench", "tests", "docs", "examples"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = list(path.relative_to(ROOT).with_suffix("").parts)
            if folder == "kernels":
                parts.insert(0, "accel_shapegen")
            if parts[-1] == "__init__":
                parts.pop()
                packages.add(".".join(parts))
            sources[".".join(parts)] = path.read_text(encoding="utf-8")
    return sources, packages


def test_imports_point_one_way() -> None:
    assert violations(*read_tree()) == []


def test_every_module_has_a_layer() -> None:
    sources, _ = read_tree()
    homeless = [name for name in sources if name.startswith("accel_shapegen") and layer_of(name) is None]
    assert homeless == [], "add them to LAYERS"


@pytest.mark.parametrize(
    ("module", "source", "count"),
    [
        ("accel_shapegen.geometry", "from .backends import get", 1),
        ("accel_shapegen.geometry", "from . import backends, errors", 1),
        ("accel_shapegen.nodes", "def f():\n    import accel_shapegen.kernels", 1),
        ("accel_shapegen.nodes", "from .errors import ArgumentError\nimport numpy", 0),
        ("accel_shapegen.backends.reference", "from ..far_field import far_field", 1),
        ("accel_shapegen.backends.reference", "from .. import model", 1),
        ("accel_shapegen.backends.reference", "from . import base\nfrom ..kernels import source", 0),
        ("accel_shapegen.backends", "from .base import Backend\nfrom ..errors import BackendError", 0),
        ("accel_shapegen.backends", "if TYPE_CHECKING:\n    from ..synthesis import Plan", 1),
        ("accel_shapegen.bodies.human", "from ..backends import get", 1),
        ("accel_shapegen.bodies.human", "from ..geometry import TriangleMesh", 0),
        ("accel_shapegen.far_field", "from .kernels import source", 1),
        ("accel_shapegen.far_field", "from . import Box", 1),
        ("accel_shapegen.model", "from .cli import main\nfrom .dataset.plan import Plan", 2),
        ("accel_shapegen.kernels", "from ..errors import ShapegenError", 1),
        ("accel_shapegen.kernels", "import kernels", 1),
        ("accel_shapegen.cli", "from . import model\nfrom .far_field import far_field", 0),
        ("bench.case", "from kernels.opencl import anything", 1),
        ("tests.test_case", "import accel_shapegen.kernels\nfrom accel_shapegen import Box", 0),
    ],
)
def test_the_checker_sees(module: str, source: str, count: int) -> None:
    others = dict.fromkeys(
        f"accel_shapegen.{name}"
        for name in ("errors", "geometry", "backends", "backends.base", "model", "far_field", "kernels")
    )
    sources = {"accel_shapegen": ""} | {name: "" for name in others} | {module: source}
    packages = {"accel_shapegen", "accel_shapegen.backends", "accel_shapegen.kernels"}
    assert len(violations(sources, packages)) == count
