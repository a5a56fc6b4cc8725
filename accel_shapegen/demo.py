"""The human experiment of Li, Liu, Tsui and Wang (2020) on real bodies.

A model learns the shape generators of 25 bodies over height and relative weight, predicts bodies that were in no
training set, and is compared with what they really look like.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import bodies, metrics, report
from .backends.base import Backend
from .bodies.files import save_mesh
from .far_field import FarFieldPlan, plan_far_field
from .geometry import Box, Grid, TriangleMesh
from .model import ShapeModel
from .nodes import FourierLattice
from .progress import Progress, Report
from .surface import extract_surface
from .synthesis import SynthesisPlan, plan_synthesis
from .voxelize import voxelize

HEIGHTS = (1.5, 1.6, 1.7, 1.8, 1.9)
WEIGHTS = (0.6, 0.8, 1.0, 1.2, 1.4)
HELD_OUT = ((1.55, 1.3), (1.85, 1.1))
NAMES = ("height", "rw")


@dataclass(frozen=True)
class Body:
    """A predicted body: its characteristic values (height [m], relative weight), field f_N and surface."""

    values: tuple[float, float]
    field: NDArray[Any]
    surface: TriangleMesh

    @property
    def stem(self) -> str:
        """What its files are called."""
        height, weight = self.values
        return f"height_{height:.3f}_rw_{weight:.3f}"


def run_demo(
    out: str | os.PathLike[str],
    *,
    heights: Sequence[float] = HEIGHTS,
    weights: Sequence[float] = WEIGHTS,
    held_out: Sequence[tuple[float, float]] = HELD_OUT,
    morph: int = 7,
    side: float = 2.2,
    order: int = 19,
    voxels: int = 200,
    cells: int = 100,
    picture: bool = True,
    backend: str | Backend | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Train on heights × weights, predict the held-out bodies and a morph from the first to the last of them.

    Files of an earlier run in the same folder are replaced.

    Parameters
    ----------
    out : path
        Folder for results.json, model.npz, predicted and exact bodies as ply, morph.glb and demo.png; it is made.
    heights, weights : sequences of float
        Training grid: heights [m] and relative weights of MakeHuman's slider.
    held_out : sequence of (height, relative weight)
        Bodies to predict, within the training grid.
    morph : int
        Bodies of the morph, ends included.
    side, order, voxels, cells : float, int, int, int
        Side [m] of the cube V0, order N of the lattice, and voxels and synthesis cells per axis.
    picture : bool
        Whether to draw demo.png, which needs matplotlib.
    backend : str, optional
        See `accel_shapegen.backends.get`.
    progress : Progress, optional
        Where stages are shown.

    Returns
    -------
    dict
        What results.json holds. Per body: `iou` of f_N > 1/2 with the exact body at the cell centres,
        `far_field_relative_error` against the transform of the exact body made the same way (slots ξ ≠ 0),
        `height_error_m` of the surface (signed) and `volume_relative_error` of the surface (unsigned).
    """
    if picture:
        report.require_matplotlib()
    started = time.perf_counter()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    box = Box((side,) * 3)
    lattice, fine, grid = FourierLattice(box, order), Grid(box, voxels), Grid(box, cells)
    with contextlib.ExitStack() as stack:
        shown = progress if progress is not None else stack.enter_context(Progress())
        transform = plan_far_field(fine, lattice, backend=backend)
        synthesis = plan_synthesis(lattice, grid, backend=backend)
        model = _train(heights, weights, transform, backend, shown)
        model.save(folder / "model.npz")
        predicted = _predict(model, held_out, synthesis, shown)
        between = _predict(model, _morph_values(held_out, morph), synthesis, shown, what="morph")
        exact = [bodies.human(*values) for values in held_out]
        with shown.stage("exact bodies"):
            compared = [_compare(b, e, model, transform, synthesis) for b, e in zip(predicted, exact, strict=True)]
            figures, best = [figure for figure, _ in compared], [reachable for _, reachable in compared]
        with shown.stage("meshes"):
            files = ["model.npz", *_write_meshes(folder, predicted, exact, between)]
        if picture:
            with shown.stage("picture") as report_count:
                _draw(folder / "demo.png", predicted, exact, between, figures, best, model, synthesis, report_count)
                files.append("demo.png")
        stages = {what: round(seconds, 3) for what, seconds in shown.seconds.items()}
    results = {
        "device": synthesis.device,
        "bodies": figures,
        "iou_of_exact_far_fields": best,
        "seconds": round(time.perf_counter() - started, 3),
        "stages": stages,
        "training": {"height": list(heights), "rw": list(weights), "kind": "slider", "voxels": voxels},
        "lattice": {"box_m": list(box.lengths), "order": list(lattice.order)},
        "cells": cells,
        "devices": {"far_field": transform.device, "spline": model.device, "synthesis": synthesis.device},
        "files": files,
    }
    (folder / "results.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return results


def _train(
    heights: Sequence[float],
    weights: Sequence[float],
    transform: FarFieldPlan,
    backend: str | Backend | None,
    progress: Progress,
) -> ShapeModel:
    total = len(heights) * len(weights)
    u = np.empty((total, *transform.nodes.shape), dtype=transform.dtype)
    with progress.stage("training bodies") as report_count:
        for index, (height, weight) in enumerate((h, w) for h in heights for w in weights):
            transform.apply(voxelize(bodies.human(height, weight), transform.grid).values, out=u[index])
            report_count(index + 1, total)
    with progress.stage("fit"):
        grid_of_u = u.reshape(len(heights), len(weights), *transform.nodes.shape)
        return ShapeModel.fit((heights, weights), grid_of_u, transform.nodes, names=NAMES, backend=backend)


def _predict(
    model: ShapeModel,
    values: Sequence[tuple[float, float]],
    synthesis: SynthesisPlan,
    progress: Progress,
    what: str = "held-out bodies",
) -> list[Body]:
    result = []
    with progress.stage(what) as report_count:
        for done, query in enumerate(values, start=1):
            field = synthesis.apply(model.predict(query))
            surface = extract_surface(field, synthesis.grid)
            assert isinstance(surface, TriangleMesh)  # the grid has three axes
            result.append(Body(query, field, surface))
            report_count(done, len(values))
    return result


def _morph_values(held_out: Sequence[tuple[float, float]], count: int) -> list[tuple[float, float]]:
    first, last = np.array(held_out[0]), np.array(held_out[-1])
    return [(float(h), float(w)) for h, w in (first + s * (last - first) for s in np.linspace(0, 1, count))]


def _compare(
    body: Body, exact: TriangleMesh, model: ShapeModel, transform: FarFieldPlan, synthesis: SynthesisPlan
) -> tuple[dict[str, float], float]:
    """Figures of a predicted body, and the IoU that the exact one's far field gives: what these nodes can show."""
    height, weight = body.values
    cells = voxelize(exact, synthesis.grid)
    truth = transform.apply(voxelize(exact, transform.grid).values)
    low, high = body.surface.bounds[:, 2]
    figures = {
        "height": height,
        "rw": weight,
        "iou": metrics.iou(body.field > 0.5, cells),
        "far_field_relative_error": float(metrics.far_field_error(model.predict(body.values), truth, transform.nodes)),
        "height_error_m": float(high - low - height),
        "volume_relative_error": metrics.volume_error(body.surface, exact),
    }
    return figures, metrics.iou(synthesis.apply(truth) > 0.5, cells)


def _write_meshes(
    folder: Path, predicted: Sequence[Body], exact: Sequence[TriangleMesh], between: Sequence[Body]
) -> list[str]:
    meshes = {f"predicted_{body.stem}.ply": body.surface for body in predicted}
    meshes |= {f"exact_{body.stem}.ply": mesh for body, mesh in zip(predicted, exact, strict=True)}
    if between:
        meshes["morph.glb"] = _side_by_side([body.surface for body in between])
    for name, mesh in meshes.items():
        save_mesh(mesh, folder / name)
    return list(meshes)


def _side_by_side(surfaces: Sequence[TriangleMesh]) -> TriangleMesh:
    """One mesh of many, standing on one ground beside each other, turned so that +Y is up as glTF wants it."""
    vertices, faces, count, x = [], [], 0, 0.0
    for surface in surfaces:
        low, high = surface.bounds
        vertices.append(surface.vertices + np.array([x - low[0], 0.0, -low[2]]))
        faces.append(surface.faces + count)
        count += len(surface.vertices)
        x += high[0] - low[0] + 0.1
    points = np.concatenate(vertices)
    return TriangleMesh(np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1), np.concatenate(faces))


def _draw(
    path: Path,
    predicted: Sequence[Body],
    exact: Sequence[TriangleMesh],
    between: Sequence[Body],
    figures: Sequence[dict[str, float]],
    best: Sequence[float],
    model: ShapeModel,
    synthesis: SynthesisPlan,
    progress: Report,
) -> None:
    comparisons = [
        report.Comparison(f"{body.values[0]:.2f} m", _caption(figure, reachable), mesh, body.surface)
        for body, mesh, figure, reachable in zip(predicted, exact, figures, best, strict=True)
    ]
    morph = [(f"{body.values[0]:.2f} m\nrel. weight {body.values[1]:.2f}", body.surface) for body in between]
    trained = math.prod(len(knots) for knots in model.knots)
    heading = f"Human bodies, predicted from the far fields of {trained} others"
    nodes, cells = (" × ".join(map(str, shape)) for shape in (synthesis.lattice.shape, synthesis.grid.shape))
    note = f"{nodes} nodes, {cells} cells\n{synthesis.device}"
    report.draw_comparison(path, heading, note, comparisons, morph, progress=progress)


def _caption(figure: dict[str, float], reachable: float) -> list[str]:
    return [
        f"relative weight {figure['rw']:.2f}",
        "",
        f"IoU {figure['iou']:.3f}",
        f"  at best {reachable:.3f}",
        f"far-field error {100 * figure['far_field_relative_error']:.1f} %",
        f"height {1000 * figure['height_error_m']:+.1f} mm".replace("-", "−"),
        f"volume error {100 * figure['volume_relative_error']:.1f} %",
    ]
