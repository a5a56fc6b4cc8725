"""Pictures of experiments: contours with the exact boundary dotted, solids, error against noise and wavenumber."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry import Polygons, TriangleMesh
from ..progress import Report
from ..report import EXACT_COLOUR, FADED, INK, PAPER, PREDICTED_COLOUR, require_matplotlib
from ..shading import render
from .trial import Outcome

DPI = 120
BLUE, RUST, GREEN, OCHRE = "#2f5d86", "#8a3b12", "#3f7d62", "#b08a2e"
PLANE_CAPTION = (
    "The predicted field f_N, its level 1/2 in red (the predicted body), the exact boundary dotted; below each, "
    "the same once every training generator carries 20 % noise."
)
NOISE_CAPTION = "Error against noise on the training generators: 1 - IoU on the left, far-field error on the right."


def draw_plane(path: Path, outcomes: Sequence[Outcome]) -> None:
    """A column per query; per setting a row without noise and one with the strongest."""
    queries = outcomes[0].family.queries
    figure = _figure(3.1 * len(queries), 6.4 * len(outcomes))
    grid = figure.subplots(2 * len(outcomes), len(queries), squeeze=False)
    for row, outcome in enumerate(outcomes):
        for column, prediction in enumerate(outcome.predictions):
            assert isinstance(prediction.exact, Polygons) and isinstance(prediction.surface, Polygons)
            delta = max(prediction.noisy)
            merits, noise = prediction.record, prediction.record["noise"][-1]
            clean, noisy = grid[2 * row, column], grid[2 * row + 1, column]
            _field(clean, outcome, prediction.field, prediction.exact)
            _field(noisy, outcome, prediction.noisy[delta], prediction.exact)
            clean.set_title(
                f"{outcome.family.describe(prediction.query)}\n{outcome.setting.name}: IoU {merits['iou']:.4f}",
                size=10,
                color=INK,
            )
            noisy.set_title(
                f"{outcome.setting.name}, δ = {100 * delta:g} %, IoU {noise['iou']:.4f}", size=10, color=INK
            )
    _save(figure, path)


def draw_solids(path: Path, outcomes: Sequence[Outcome], progress: Report) -> None:
    """A column per query: exact above, then one row per setting."""
    queries = outcomes[0].family.queries
    figure = _figure(2.9 * len(queries), 2.9 * (1 + len(outcomes)))
    grid = figure.subplots(1 + len(outcomes), len(queries), squeeze=False)
    half = 0.5 * max(outcomes[0].setting.lattice.box.lengths)
    done = 0
    for column, prediction in enumerate(outcomes[0].predictions):
        others = [outcome.predictions[column] for outcome in outcomes]
        for row, mesh in enumerate([prediction.exact, *(other.surface for other in others)]):
            axes = grid[row, column]
            assert isinstance(mesh, TriangleMesh)
            colour = EXACT_COLOUR if row == 0 else PREDICTED_COLOUR
            scale = 2.9 * DPI / (2 * half)
            picture = render(
                _facets(mesh) if row == 0 else mesh, 32, elevation=22, pixels_per_metre=scale, colour=colour
            )
            axes.imshow(picture.image, extent=picture.extent, interpolation="antialiased")
            axes.set(xlim=(-half, half), ylim=(-half, half))
            axes.axis("off")
            title = outcomes[0].family.describe(prediction.query).replace(", ", "\n", 1)
            merits = f"{outcomes[row - 1].setting.name}: IoU {others[row - 1].record['iou']:.3f}" if row else title
            axes.set_title(merits, size=9.5, color=INK)
            done += 1
            progress(done, grid.size)
    _save(figure, path)


def draw_noise(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Both errors of every query against δ."""
    figure = _figure(11.0, 3.6)
    left, right = figure.subplots(1, 2)
    for outcome, line in zip(outcomes, ("-", "--", ":"), strict=False):
        for prediction, colour in zip(outcome.predictions, (BLUE, RUST, GREEN, OCHRE), strict=False):
            merits = prediction.record
            deltas = [0.0, *(entry["delta"] for entry in merits["noise"])]
            label = f"{outcome.setting.name}: {outcome.family.describe(prediction.query)}"
            for axes, key in ((left, "iou"), (right, "far_field_relative_error")):
                values = np.array([merits[key], *(entry[key] for entry in merits["noise"])])
                shown = 1 - values if key == "iou" else values
                axes.plot([100 * delta for delta in deltas], shown, line, marker="o", ms=4, color=colour, label=label)
    left.set(ylabel="1 - IoU", ylim=(0, None))
    right.set(ylabel="far-field error", ylim=(0, None))
    figure.legend(*right.get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8)
    for axes in (left, right):
        _plain(axes, "noise δ [%]")
    _save(figure, path)


def draw_stability(path: Path, curves: Sequence[dict[str, Any]]) -> None:
    """Squared error against δ per dimension, with the theorem's rates."""
    dims = sorted({curve["dim"] for curve in curves})
    figure = _figure(4.8 * len(dims), 4.0)
    for axes, dim in zip(figure.subplots(1, len(dims), squeeze=False)[0], dims, strict=True):
        for curve, colour in zip([c for c in curves if c["dim"] == dim], (RUST, BLUE), strict=True):
            deltas, errors = np.array(curve["delta"]), np.array(curve["relative_error_squared"])
            label = f"{curve['body']}: slope {curve['slope']:.2f}"
            axes.loglog(deltas, errors, "o", ms=4, color=colour, label=label)
            rate = curve["rate"]
            reference = np.exp(np.mean(np.log(errors))) * (deltas / np.exp(np.mean(np.log(deltas)))) ** rate
            axes.loglog(deltas, reference, "-", lw=1, color=colour, label=f"rate δ^{rate:.2g}")
        axes.set_title(f"d = {dim}", size=11, color=INK)
        axes.set_ylabel("‖f^δ - f‖² / ‖f‖²")
        axes.legend(frameon=False, fontsize=8.5)
        _plain(axes, "noise δ")
    _save(figure, path)


def draw_forward(path: Path, rows: Sequence[dict[str, Any]], bar: float) -> None:
    """Differences between finite elements and transform against k."""
    figure = _figure(7.4, 4.0)
    axes = figure.subplots()
    names = list(dict.fromkeys(row["body"] for row in rows))
    for name, colour in zip(names, (BLUE, RUST, GREEN, OCHRE), strict=False):
        some = [row for row in rows if row["body"] == name]
        k = [row["k"] for row in some]
        axes.loglog(k, [row["kirchhoff_error"] for row in some], "o-", color=colour, ms=5, label=name)
        axes.loglog(k, [row["modes_error"] for row in some], "o--", color=colour, ms=5, mfc=PAPER)
    axes.axhline(bar, color=FADED, lw=1)
    axes.set_ylabel("relative difference")
    axes.legend(frameon=False, fontsize=9)
    _plain(axes, "k [rad/m]")
    _save(figure, path)


def _figure(width: float, height: float) -> Any:
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), facecolor=PAPER, layout="constrained")


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=DPI, facecolor=PAPER)


def _plain(axes: Any, label: str) -> None:
    axes.set_xlabel(label)
    axes.set_facecolor(PAPER)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK, labelsize=9)


def _field(axes: Any, outcome: Outcome, field: Any, exact: Polygons) -> None:
    grid = outcome.setting.grid
    # From the outer face of the first cell to that of the last, on each axis.
    ends = [(1.5 * axis[0] - 0.5 * axis[1], 1.5 * axis[-1] - 0.5 * axis[-2]) for axis in grid.axes]
    extent = (*ends[0], *ends[1])
    axes.imshow(field.T, origin="lower", extent=extent, cmap="Blues", vmin=0, vmax=1.3, interpolation="antialiased")
    axes.contour(*grid.axes, field.T, levels=[0.5], colors=[RUST], linewidths=1.5)
    for ring in exact.rings:
        axes.plot(*np.concatenate([ring, ring[:1]]).T, color=INK, linewidth=1.3, linestyle=(0, (1, 1.6)))
    axes.set(aspect="equal", xlim=ends[0], ylim=ends[1])
    axes.tick_params(labelsize=7, colors=FADED)


def _facets(mesh: TriangleMesh) -> TriangleMesh:
    """The same triangles with corners of their own: normals are averaged at shared ones, which would round edges."""
    return TriangleMesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
