"""`train`: bodies of a table of files, or of a family, to a model."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .. import adequacy, backends
from ..errors import ArgumentError, MissingFileError
from ..geometry import Box, Grid
from ..model import ShapeModel
from ..nodes import FourierLattice
from ..progress import Progress
from . import families, output, training
from .options import (
    AsJson,
    BackendName,
    Debug,
    DeviceName,
    Overwrite,
    about,
    choose_backend,
    knots,
    one_or_all,
    per_axis,
    require_new,
)
from .tables import read_table

# Voxels per axis for meshes, whose far field is that of their voxels.
VOXELS = 200


def train(
    table: Annotated[
        Path | None,
        typer.Argument(
            metavar="TABLE",
            help="CSV file: one column for each characteristic value, and a column 'file' with a mesh (stl, ply, obj, "
            "glb, off) or voxels (npz), relative to the table. Rows in any order, a full grid.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The model, as npz.")] = Path("model.npz"),
    family: Annotated[
        str | None, typer.Option("--family", metavar="NAME", help="Instead of a table: " + ", ".join(families.FAMILIES))
    ] = None,
    grid: Annotated[
        list[str] | None,
        typer.Option(
            "--grid", metavar="NAME=FIRST:LAST:COUNT", help="With --family, for each of its values; or NAME=A,B,…"
        ),
    ] = None,
    box: Annotated[
        str | None,
        typer.Option(
            "--box", metavar="METRES", help="Sides of the box, one for a cube or one per axis; families have one."
        ),
    ] = None,
    order: Annotated[
        str | None,
        typer.Option("--order", metavar="N", help="Order of the lattice, one or one per axis; families have one."),
    ] = None,
    voxels: Annotated[
        str | None,
        typer.Option(
            "--voxels",
            metavar="CELLS",
            help=f"Voxels per axis for meshes, {VOXELS} by default; plane families are exact.",
        ),
    ] = None,
    boundary: Annotated[
        Literal["natural", "not-a-knot", "clamped"], typer.Option("--boundary", help="End condition of the splines.")
    ] = "natural",
    frame: Annotated[
        Literal["none", "height", "bbox", "moments"],
        typer.Option(
            "--frame",
            help="Learn bodies in reference frames: scaled to one height, to one bounding box, or to one spread of "
            "mass. Bodies come back in metres.",
        ),
    ] = "none",
    dtype: Annotated[Literal["complex64", "complex128"], typer.Option("--dtype", help="Precision.")] = "complex64",
    backend: BackendName = None,
    device: DeviceName = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Learn the shape generators of bodies over their characteristic values.

    From files:  train bodies.csv --box 2.2 --order 19 --out model.npz

    Without any:  train --family human --grid height=1.5:1.9:5 --grid rw=0.6:1.4:5 --out human.npz
    """
    if (table is None) == (family is None):
        raise ArgumentError("train", "needs one source of bodies", "give either a TABLE or --family with --grid")
    if not out.parent.is_dir():
        raise MissingFileError("--out", f"names the folder {out.parent}, which does not exist", "make it first")
    require_new([out], overwrite)
    chosen = choose_backend(backend, device)
    bodies: training.TrainingSet
    cells: Grid | None
    if table is not None:
        bodies, lattice, cells = _from_files(table, grid, box, order, voxels)
    else:
        bodies, lattice, cells = _from_family(str(family), grid, box, order, voxels)
    with Progress(sys.stderr) as progress:
        with progress.stage("training bodies") as report:
            rule = None if frame == "none" else frame
            model = bodies.fit(lattice, report, frame=rule, boundary=boundary, dtype=dtype, backend=chosen)
        with progress.stage("adequacy"):
            assessed = adequacy.assess(model)
        with progress.stage("saving"):
            model.save(out)
    operation = "polygon_transform" if cells is None else "tensor_transform"
    summary = {
        "model": str(out),
        "bytes": out.stat().st_size,
        "device": backends.get(chosen, operation=operation).info.label,
        "seconds": round(sum(progress.seconds.values()), 3),
        **_describe(model, lattice, cells),
        "frame": rule,
        "adequacy": assessed.to_dict(),
    }
    if as_json:
        output.print_json(summary)
    else:
        _show(summary, assessed)


def _from_files(
    table: Path, grid: Sequence[str] | None, box: str | None, order: str | None, voxels: str | None
) -> tuple[training.TrainingSet, FourierLattice, Grid]:
    if grid:
        raise ArgumentError("--grid", "goes with --family", "a table has its grid in its columns")
    rows = read_table(table)
    sides, orders = _box_and_order(box, order)
    # One number for each says nothing of the dimension: bodies in files are solids unless told otherwise.
    axes = max(len(sides), len(orders))
    lattice = _lattice(sides, orders, axes if axes > 1 else 3)
    cells = _cells(lattice, voxels)
    return training.from_table(rows, cells), lattice, cells


def _from_family(
    name: str, grid: Sequence[str] | None, box: str | None, order: str | None, voxels: str | None
) -> tuple[training.TrainingSet, FourierLattice, Grid | None]:
    family = families.find(name)
    axes = families.grid_of(name, family, [knots("--grid", text) for text in grid or []])
    sides, orders = _box_and_order(box, order, family)
    lattice = _lattice(sides, orders, family.dim)
    # Regions of the plane are voxelised only if asked to, since their transform is exact.
    cells = _cells(lattice, voxels) if voxels or family.dim == 3 else None
    return training.from_family(family, axes, cells), lattice, cells


def _box_and_order(
    box: str | None, order: str | None, family: families.Family | None = None
) -> tuple[list[float], list[int]]:
    """What is given, or else what the family has: one number or one per axis."""
    sides = [family.box] if box is None and family and family.box else None
    orders = [family.order] if order is None and family and family.order else None
    if box is None and sides is None:
        raise ArgumentError("--box", "is missing", "give the sides in metres of a box that holds every body, as 2.2")
    if order is None and orders is None:
        raise ArgumentError("--order", "is missing", "give the order of the lattice, as 19")
    return (
        sides or per_axis("--box", str(box), float, "a length in metres"),
        orders or per_axis("--order", str(order), int, "an integer"),
    )


def _lattice(sides: list[float], orders: list[int], dim: int) -> FourierLattice:
    for option, values in (("--box", sides), ("--order", orders)):
        if len(values) not in (1, dim):
            raise ArgumentError(option, f"has {len(values)} numbers in {dim}-D", f"give 1 or {dim}")
    with about("--box"):
        space = Box(sides * dim if len(sides) == 1 else sides)
    with about("--order"):
        return FourierLattice(space, one_or_all(orders))


def _cells(lattice: FourierLattice, voxels: str | None) -> Grid:
    counts = one_or_all(per_axis("--voxels", voxels or str(VOXELS), int, "an integer"))
    with about("--voxels"):
        return Grid(lattice.box, counts)


def _describe(model: ShapeModel, lattice: FourierLattice, cells: Grid | None) -> dict[str, Any]:
    return {
        "bodies": math.prod(len(axis) for axis in model.knots),
        "values": {name: axis.tolist() for name, axis in zip(model.names, model.knots, strict=True)},
        "boundary": model.axes[0].boundary,
        "box_m": list(lattice.box.lengths),
        "order": list(lattice.order),
        "voxels": None if cells is None else list(cells.shape),
        "dtype": model.dtype.name,
    }


def _show(summary: dict[str, Any], assessed: adequacy.Adequacy) -> None:
    screen = output.console()
    rows = [[name, f"{len(axis)}", f"{axis[0]:g} … {axis[-1]:g}"] for name, axis in summary["values"].items()]
    screen.print(output.table("Characteristic values", ["value", "knots", "range"], rows))
    sides, orders = (" × ".join(f"{v:g}" for v in summary[key]) for key in ("box_m", "order"))
    voxels = "exact" if summary["voxels"] is None else " × ".join(map(str, summary["voxels"])) + " voxels for meshes"
    in_frames = f", in frames by {summary['frame']}" if summary["frame"] else ""
    lines = {
        "bodies": f"{summary['bodies']}, {voxels}{in_frames}",
        "box": f"{sides} m, order {orders}",
        "on": f"{summary['device']}, {summary['seconds']:.1f} s",
        "model": f"{summary['model']}, {summary['bytes'] / 2**20:.1f} MiB",
    }
    for name, text in lines.items():
        screen.print(f"{name:<7} {text}", markup=False)
    screen.print(f"\n{assessed}", markup=False, soft_wrap=True)
