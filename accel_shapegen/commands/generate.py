"""`generate`: characteristic values to volumes, surfaces and pictures."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from .. import batches
from ..errors import ArgumentError, SurfaceError, TableError
from ..geometry import Grid
from ..model import ShapeModel
from ..nodes import FourierLattice
from ..progress import Progress
from ..synthesis import Window
from . import output
from .body_files import LEVEL, ZARR, BodyFiles, replace_text
from .options import (
    AsJson,
    BackendName,
    Debug,
    DeviceName,
    Overwrite,
    about,
    assignments,
    choose_backend,
    locate,
    one_or_all,
    per_axis,
    require_new,
)
from .tables import read_table

CELLS = 100
MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Queries:
    """Characteristic values, shape (Q, M), and what messages call each of them."""

    values: NDArray[np.float64]
    place: Callable[[int], str]


def generate(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="A model that train wrote.")],
    table: Annotated[
        Path | None,
        typer.Argument(metavar="TABLE", help="CSV file with a column for each characteristic value of the model."),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option("--at", metavar="NAME=NUMBER,…", help="One body, as height=1.62,rw=0.9; may be given again."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to; it is made.")] = Path(
        "out/generated"
    ),
    grid: Annotated[
        str,
        typer.Option(
            "--grid",
            metavar="CELLS",
            help="Cells over the model's box, one number or one per axis; if reference frames carry bodies out of "
            "that, over a box that holds them.",
        ),
    ] = str(CELLS),
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="NAME,…",
            help="npz or zarr (fields), png (picture); ply, stl, glb, obj (surfaces of 3-D models); rings (boundaries "
            "of 2-D models). Default: ply, or rings.",
        ),
    ] = None,
    window: Annotated[Window | None, typer.Option("--window", help="Spectral window: smoother, less sharp.")] = None,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Go on along the tangent outside the training range.")
    ] = False,
    backend: BackendName = None,
    device: DeviceName = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Make bodies from a model: fields, surfaces, pictures, and a manifest.json that says what is where."""
    started = time.perf_counter()
    chosen = choose_backend(backend, device)
    loaded = ShapeModel.load(model, backend=chosen)
    if not isinstance(loaded.nodes, FourierLattice):
        raise ArgumentError(str(model), "is over scattered nodes", "train on a lattice to generate bodies")
    counts = one_or_all(per_axis("--grid", grid, int, "an integer"))
    with about("--grid"):
        cells = Grid(loaded.extent, counts)
    files = BodyFiles(out, cells, formats)
    queries = _queries(loaded, table, at)
    tangent: Literal["linear"] | None = "linear" if extrapolate else None
    _require_range(loaded, queries, tangent)
    require_new([out / MANIFEST, *files.paths(len(queries.values))], overwrite)
    out.mkdir(parents=True, exist_ok=True)
    # A manifest that is there is true: the old one goes before the first file changes, the new one comes last.
    (out / MANIFEST).unlink(missing_ok=True)
    with Progress(sys.stderr) as progress:
        entries, synthesis_device = _generate(loaded, queries, files, window, tangent, progress)
    manifest = {
        "model": str(model),
        "device": synthesis_device,
        "names": list(loaded.names),
        "box_m": list(loaded.extent.lengths),
        "cells": list(cells.shape),
        "level": LEVEL,
        "window": window,
        "extrapolate": extrapolate,
        "volumes": ZARR if "zarr" in files.formats else None,
        "bodies": entries,
        "seconds": round(time.perf_counter() - started, 3),
    }
    replace_text(out / MANIFEST, json.dumps(manifest, indent=2, allow_nan=False) + "\n")
    if as_json:
        output.print_json(manifest)
    else:
        _show(manifest, out)


def _queries(model: ShapeModel, table: Path | None, at: Sequence[str] | None) -> Queries:
    if (table is None) == (not at):
        raise ArgumentError("generate", "needs one source of characteristic values", "give either a TABLE or --at")
    if table is not None:
        rows = read_table(table)
        unknown = [column for column in rows.header if column not in model.names]
        if unknown:
            raise TableError(str(table), f"has the column {unknown[0]!r}", "the model has " + ", ".join(model.names))
        return Queries(rows.numbers(model.names), rows.place)
    values = []
    for text in at or []:
        point = assignments("--at", text)
        if set(point) != set(model.names):
            raise ArgumentError("--at", f"gives {', '.join(point)}", f"give {', '.join(model.names)}, all of them")
        values.append([point[name] for name in model.names])
    return Queries(np.array(values), lambda row: f"--at {(at or [])[row]}")


def _require_range(model: ShapeModel, queries: Queries, extrapolate: Literal["linear"] | None) -> None:
    """Refuse queries outside the training range before the first file is written."""
    if extrapolate is not None:
        return
    for j, axis in enumerate(model.axes):
        low, high = axis.knots[0], axis.knots[-1]
        column = queries.values[:, j]
        outside = np.flatnonzero((column < low) | (column > high))
        if outside.size:
            row = int(outside[0])
            raise ArgumentError(
                queries.place(row),
                f"has {axis.name} {column[row]:g}, outside [{low:g}, {high:g}]",
                "stay inside, or --extrapolate",
            )


def _generate(
    model: ShapeModel,
    queries: Queries,
    files: BodyFiles,
    window: Window | None,
    extrapolate: Literal["linear"] | None,
    progress: Progress,
) -> tuple[list[dict[str, Any]], str]:
    """Entries of the manifest, and the device; batch by batch, so that memory does not grow with the bodies."""
    total = len(queries.values)
    batch = batches.one_shot_batch(total, 8 * math.prod(files.grid.shape))
    plan = model.plan_fields(files.grid, batch=batch, window=window)
    fields = np.empty((batch, *files.grid.shape), dtype=model.dtype.type(0).real.dtype)
    files.open(total, fields.dtype, {"names": list(model.names), "values": queries.values.tolist(), "level": LEVEL})
    entries = []
    with progress.stage("bodies") as report:
        for start in range(0, total, batch):
            some = queries.values[start : start + batch]
            plan.apply(some, extrapolate, out=fields[: len(some)])
            for index, field in enumerate(fields[: len(some)], start=start):
                point = dict(zip(model.names, map(float, queries.values[index]), strict=True))
                try:
                    surface = files.write(index, field, ", ".join(f"{name} {value:g}" for name, value in point.items()))
                except SurfaceError as error:
                    raise locate(error, queries.place(index)) from error
                entries.append({"index": index, "values": point, "files": files.names(index), "surface": surface})
                report(index + 1, total)
    return entries, plan.device


def _show(manifest: dict[str, Any], out: Path) -> None:
    bodies, shown = manifest["bodies"], 20
    rows = [
        [*(f"{value:g}" for value in body["values"].values()), *_measures(body["surface"])] for body in bodies[:shown]
    ]
    screen = output.console()
    columns = [*manifest["names"], "extent [m]", "volume", "pieces"]
    screen.print(output.table("Bodies", columns, rows, numbers=len(columns)))
    if len(bodies) > shown:
        screen.print(f"… and {len(bodies) - shown} more", markup=False)
    kinds = [*([ZARR] if manifest["volumes"] else []), *(bodies[0]["files"].values() if bodies else [])]
    screen.print(f"on  {manifest['device']}, {manifest['seconds']:.1f} s", markup=False)
    screen.print(f"in  {out}: {MANIFEST}, {', '.join(kinds)}{', …' if len(bodies) > 1 else ''}", markup=False)


def _measures(surface: dict[str, Any] | None) -> list[str]:
    if surface is None:
        return ["–"] * 3
    extent = " × ".join(f"{length:.3f}" for length in surface["extent_m"])
    return [extent, f"{surface['volume']:.4g}", str(surface["components"])]
