"""`demo`: human bodies that were in no training set."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .. import demo as experiment
from ..progress import Progress
from . import output
from .options import AsJson, BackendName, Debug, DeviceName, choose_backend

# Said where hands are seen to come off.
NOTE = (
    "What even the exact far field does not show, hands and faces, is finer than half the shortest wavelength of these "
    "nodes, 6 cm. More nodes and a closer box mend it: accel-shapegen reproduce human.\n"
)


def demo(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where to write; files of an earlier demo there are replaced.")
    ] = Path("out/demo"),
    picture: Annotated[bool, typer.Option("--picture/--no-picture", help="Draw demo.png; needs matplotlib.")] = True,
    backend: BackendName = None,
    device: DeviceName = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Learn 25 human bodies from their far fields, and predict bodies that were not among them.

    Writes results.json, demo.png, the trained model, exact and predicted bodies as ply and a morph as glb.
    """
    with Progress(sys.stderr) as progress:
        results = experiment.run_demo(out, picture=picture, backend=choose_backend(backend, device), progress=progress)
    if as_json:
        output.print_json(results)
    else:
        _show(results, out)


def _show(results: dict[str, Any], out: Path) -> None:
    rows = [
        [
            f"{body['height']:.2f} m",
            f"{body['rw']:.2f}",
            f"{body['iou']:.3f}",
            f"{best:.3f}",
            f"{100 * body['far_field_relative_error']:.2f} %",
            f"{1000 * body['height_error_m']:+.1f} mm",
            f"{100 * body['volume_relative_error']:.1f} %",
        ]
        for body, best in zip(results["bodies"], results["iou_of_exact_far_fields"], strict=True)
    ]
    columns = [
        "height",
        "relative weight",
        "IoU",
        "IoU, exact far field",
        "far-field error",
        "height error",
        "volume error",
    ]
    screen = output.console()
    screen.print(output.table("Bodies that were in no training set", columns, rows, numbers=7))
    screen.print(NOTE, markup=False)
    lines: dict[str, object] = {
        "on": f"{results['device']}, {results['seconds']:.1f} s",
        "figures": out / "results.json",
    }
    for kind, name in {"picture": "demo.png", "model": "model.npz", "meshes": "*.ply", "morph": "morph.glb"}.items():
        if any(Path(file).match(name) for file in results["files"]):
            lines[kind] = out / name
    for kind, text in lines.items():
        screen.print(f"{kind:<8} {text}", markup=False)
