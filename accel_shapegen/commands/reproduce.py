"""`reproduce`: the paper's experiments, with its parameters."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from ..experiments import reproduction
from ..progress import Progress
from . import output
from .options import AsJson, BackendName, Debug, DeviceName, choose_backend

NAMES = ", ".join(reproduction.EXPERIMENTS)


def reproduce(
    experiment: Annotated[str, typer.Argument(metavar="EXPERIMENT", help=f"{NAMES}, or all.")] = "all",
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where to write; files of an earlier run there are replaced.")
    ] = Path("out/reproduce"),
    backend: BackendName = None,
    device: DeviceName = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Repeat the experiments of Li, Liu, Tsui and Wang (2020).

    Writes index.html, which has everything on it, results.json and the pictures. forward and kite-fem need the extra
    fem; kite-fem is not part of all.
    """
    with Progress(sys.stderr) as progress:
        results = reproduction.run(experiment, out, backend=choose_backend(backend, device), progress=progress)
    if as_json:
        output.print_json(results)
    else:
        _show(results, out)


def _show(results: dict[str, Any], out: Path) -> None:
    rows = [row for name, record in results["experiments"].items() for row in _rows(name, record)]
    screen = output.console()
    if rows:
        columns = ["experiment", "body", "IoU", "truncation alone", "far-field error", "Hausdorff"]
        screen.print(output.table("Bodies that were in no training set", columns, rows, numbers=4))
    for name, seconds in results["seconds_by_experiment"].items():
        screen.print(f"{name:<13} {seconds:.1f} s", markup=False)
    screen.print(f"{'page':<13} {out / 'index.html'}", markup=False)


def _rows(name: str, record: dict[str, Any]) -> Iterator[list[str]]:
    """Of a record, or of records within it by setting or kind, those that hold the usual figures per query."""
    for key, inner in record.items():
        if isinstance(inner, dict):
            yield from _rows(f"{name}, {key}", inner)
        elif key == "queries":
            for query in inner:
                if "iou" in query:
                    values = ", ".join(f"{value:g}" for value in query["values"].values())
                    yield [
                        name,
                        values,
                        f"{query['iou']:.4f}",
                        f"{query['iou_truncation']:.4f}",
                        f"{query['far_field_relative_error']:.2e}",
                        f"{query['hausdorff_m']:.3f} m",
                    ]
