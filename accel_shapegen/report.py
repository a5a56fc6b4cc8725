"""Pictures: exact beside predicted bodies, morph sequences, single bodies in 2-D and 3-D."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import extras
from .geometry import Grid, Polygons, TriangleMesh
from .progress import Report
from .shading import render, vertex_normals, view_axes

PAPER, INK, FADED, FAINT = "#f7f5f2", "#33312e", "#7d786f", "#b9b4ab"
EXACT_COLOUR = (0.80, 0.59, 0.46)
PREDICTED_COLOUR = (0.42, 0.58, 0.75)
# Differences beyond this [m] have the colour of this.
MOST_DIFFERENCE = 0.02
FRONT, SIDE, BETWEEN = 0.0, 90.0, 28.0
# A comparison in inches: its width, and what the heading and the labels under the morph take.
INCHES, HEADING, LABELS = 16.0, 0.70, 0.62
# And in metres: the text beside each row, and the air above heads and below feet.
TEXT_WIDTH, ABOVE, BELOW = 1.12, 0.19, 0.12


@dataclass(frozen=True, eq=False)
class Comparison:
    """A body that was in no training set, as it is and as it was predicted.

    Attributes
    ----------
    title : str
        Its characteristic values.
    caption : sequence of str
        Lines below the title.
    exact, predicted : TriangleMesh
    """

    title: str
    caption: Sequence[str]
    exact: TriangleMesh
    predicted: TriangleMesh


def require_matplotlib() -> None:
    """Raise `MissingDependencyError` where no picture can be drawn: before the work, not after it."""
    extras.require("pictures", "matplotlib", "plot")


def draw_comparison(
    path: str | os.PathLike[str],
    heading: str,
    note: str,
    comparisons: Sequence[Comparison],
    morph: Sequence[tuple[str, TriangleMesh]],
    *,
    dpi: int = 150,
    progress: Report | None = None,
) -> Path:
    """One row per comparison - exact, predicted and their difference from the front and from the side - and the morph.

    All bodies of the rows have one scale, all bodies of the morph another. Colours of the difference show the signed
    distance of the predicted surface from the exact one.

    Parameters
    ----------
    path : path
        Of a PNG, SVG or PDF file; replaced if it exists.
    heading, note : str
        First line of the picture, and what is small at its right end.
    comparisons : sequence of Comparison
    morph : sequence of (label, mesh)
        May be empty.
    dpi : int
        Pixels per inch, of 16 inches.
    progress : callable, optional
        Called as progress(done, total) after each body drawn.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    views = _Counter(6 * len(comparisons) + len(morph), progress)
    widths = _column_widths(comparisons)
    across = TEXT_WIDTH + sum(widths) + 0.1
    talls = [float(np.ptp(comparison.exact.bounds[:, 2])) for comparison in comparisons]
    rows = [INCHES / across * (tall + ABOVE + BELOW) for tall in talls]
    strip_across = _strip_width(morph)
    strip = INCHES / strip_across * (_tallest(morph) + BELOW) + LABELS if morph else 0.0
    height = HEADING + sum(rows) + strip
    figure = Figure(figsize=(INCHES, height), facecolor=PAPER)
    figure.text(0.021, 1 - 0.28 / height, heading, size=19, color=INK, weight="bold", va="top")
    figure.text(0.979, 1 - 0.33 / height, note, size=11, color=FADED, ha="right", va="top")
    bottom = height - HEADING
    for index, (comparison, tall, row) in enumerate(zip(comparisons, talls, rows, strict=True)):
        bottom -= row
        axes = _stage(figure, (0, bottom / height, 1, row / height), (0, across), (-BELOW, tall + ABOVE))
        _draw_row(axes, comparison, widths, INCHES / across * dpi, views, first=index == 0)
        if index == 0:
            _colour_bar(figure, axes, TEXT_WIDTH + sum(widths[:2]) + widths[2] / 2)
    if morph:
        place = (0, LABELS / height, 1, (strip - LABELS) / height)
        axes = _stage(figure, place, (0, strip_across), (0, _tallest(morph) + BELOW))
        _draw_strip(axes, morph, INCHES / strip_across * dpi, views)
    target = Path(path)
    figure.savefig(target, dpi=dpi, facecolor=PAPER)
    return target


def draw_body(path: str | os.PathLike[str], title: str, mesh: TriangleMesh, *, dpi: int = 110) -> Path:
    """A single body in 3-D from the front, from between and from the side; replaced if it exists."""
    require_matplotlib()
    from matplotlib.figure import Figure

    views = (FRONT, BETWEEN, SIDE)
    reaches = [mesh.vertices @ view_axes(azimuth)[0] for azimuth in views]
    spans = [float(np.ptp(reach)) for reach in reaches]
    tall = float(np.ptp(mesh.bounds[:, 2]))
    gap = 0.1 * max(*spans, tall)
    across, up = sum(spans) + 4 * gap, tall + 2.5 * gap
    # Twelve inches wide, or nine tall, whichever is reached first.
    inches = min(12 / across, 9 / up)
    figure = Figure(figsize=(inches * across, inches * up), facecolor=PAPER)
    axes = _stage(figure, (0, 0, 1, 1), (0, across), (-gap, up - gap))
    axes.text(across / 2, tall + 0.7 * gap, title, ha="center", va="center", size=13, color=INK)
    left = gap
    for azimuth, reach, span in zip(views, reaches, spans, strict=True):
        _place(axes, mesh, azimuth, left - float(reach.min()), inches * dpi, PREDICTED_COLOUR)
        left += span + gap
    figure.savefig(Path(path), dpi=dpi, facecolor=PAPER)
    return Path(path)


def draw_region(
    path: str | os.PathLike[str],
    title: str,
    field: NDArray[Any],
    grid: Grid,
    surface: Polygons,
    *,
    dpi: int = 150,
) -> Path:
    """A field in the plane, shape `grid.shape`, with the boundary drawn on it; replaced if it exists."""
    require_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 6.2), facecolor=PAPER, layout="constrained")
    axes = figure.add_subplot()
    shown = axes.pcolormesh(*grid.axes, field.T, cmap="Blues", vmin=0, vmax=1.2, shading="nearest", rasterized=True)
    for ring in surface.rings:
        axes.plot(*np.concatenate([ring, ring[:1]]).T, color="#8a3b12", linewidth=1.4)
    axes.set(aspect="equal", title=title, xlabel="x [m]", ylabel="y [m]", facecolor=PAPER)
    figure.colorbar(shown, ax=axes, label="field", shrink=0.85)
    figure.savefig(Path(path), dpi=dpi, facecolor=PAPER)
    return Path(path)


def signed_distance(mesh: TriangleMesh, exact: TriangleMesh) -> NDArray[np.float64]:
    """Distance [m] of each vertex of `mesh` from another surface, positive outside it, shape (V,).

    To the tangent plane at the nearest of its vertices and triangle centres: exact for flat surfaces, and off by the
    curvature times the square of the sampling distance for curved ones. For pictures; `metrics.hausdorff` measures.
    """
    from scipy.spatial import cKDTree

    corners = exact.vertices[exact.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), np.finfo(float).tiny)
    samples = np.concatenate([exact.vertices, corners.mean(axis=1)])
    normals = np.concatenate([vertex_normals(exact), flat])
    _, nearest = cKDTree(samples).query(mesh.vertices)
    return np.asarray(np.einsum("ij,ij->i", mesh.vertices - samples[nearest], normals[nearest]))


class _Counter:
    """Reports views as they are drawn."""

    def __init__(self, total: int, progress: Report | None) -> None:
        self._done, self._total, self._progress = 0, total, progress

    def one(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)


def _column_widths(comparisons: Sequence[Comparison]) -> list[float]:
    """Metres given to exact, predicted and difference from the front, and the same from the side."""
    spans = np.max([np.ptp(c.exact.bounds, axis=0) for c in comparisons], axis=0)
    return [float(spans[0]) + 0.10] * 3 + [float(spans[1]) + 0.16] * 3


def _strip_width(morph: Sequence[tuple[str, TriangleMesh]]) -> float:
    return sum(_strip_column(mesh) for _, mesh in morph) + 0.3


def _strip_column(mesh: TriangleMesh) -> float:
    return float(np.ptp(mesh.bounds[:, 0])) + 0.05


def _tallest(morph: Sequence[tuple[str, TriangleMesh]]) -> float:
    return max(float(np.ptp(mesh.bounds[:, 2])) for _, mesh in morph)


def _stage(
    figure: Any, place: tuple[float, float, float, float], across: tuple[float, float], up: tuple[float, float]
) -> Any:
    """Axes in metres without a frame, with the ground at 0."""
    axes = figure.add_axes(place)
    axes.set(xlim=across, ylim=up)
    axes.axis("off")
    axes.axhline(0, xmin=0.02, xmax=0.98, color=FAINT, linewidth=0.8, zorder=0, clip_on=False)
    return axes


def _place(
    axes: Any, mesh: TriangleMesh, azimuth: float, x: float, scale: float, colour: Any, ground: float | None = None
) -> None:
    """Draw a mesh with its origin at x, `ground` (or else its lowest point) on the ground, `scale` pixels a metre."""
    picture = render(mesh, azimuth, pixels_per_metre=scale, colour=colour)
    left, right, bottom, top = picture.extent
    lowest = float(mesh.bounds[0, 2]) if ground is None else ground
    limits = axes.get_xlim(), axes.get_ylim()
    axes.imshow(
        picture.image, extent=(left + x, right + x, bottom - lowest, top - lowest), aspect="auto",
        interpolation="antialiased", zorder=2,
    )  # fmt: skip
    axes.set(xlim=limits[0], ylim=limits[1])


def _draw_row(
    axes: Any, comparison: Comparison, widths: Sequence[float], scale: float, views: _Counter, *, first: bool
) -> None:
    exact, predicted = comparison.exact, comparison.predicted
    ground, top = exact.bounds[0, 2], float(np.ptp(exact.bounds[:, 2]))
    left = 0.021 * axes.get_xlim()[1]
    axes.text(left, top - 0.02, comparison.title, size=20, color=INK, va="top", weight="bold")
    # Line by line: in one text, a line's height would depend on its letters.
    for line, text in enumerate(comparison.caption):
        axes.text(left, top - 0.23 - 0.085 * line, text, size=12, color=INK, va="baseline")
    across = [TEXT_WIDTH, TEXT_WIDTH + sum(widths)]
    axes.plot(across, [top, top], color=FAINT, linewidth=0.8, linestyle=(0, (1, 3)), zorder=1)
    x, drawn = (
        TEXT_WIDTH,
        [
            ("exact", exact, EXACT_COLOUR),
            ("predicted", predicted, PREDICTED_COLOUR),
            ("difference", predicted, _difference_colours(predicted, exact)),
        ],
    )
    for column, width in enumerate(widths):
        name, mesh, colour = drawn[column % 3]
        _place(axes, mesh, FRONT if column < 3 else SIDE, x + width / 2, scale, colour, ground)
        views.one()
        if first:
            axes.text(x + width / 2, top + 0.05, name, ha="center", size=13, color=INK)
        x += width


def _draw_strip(axes: Any, morph: Sequence[tuple[str, TriangleMesh]], scale: float, views: _Counter) -> None:
    x = 0.15
    for index, (label, mesh) in enumerate(morph):
        width = _strip_column(mesh)
        share = index / max(1, len(morph) - 1)
        colour = (1 - share) * np.array(PREDICTED_COLOUR) + share * np.array((0.36, 0.62, 0.58))
        _place(axes, mesh, BETWEEN, x + width / 2, scale, colour)
        views.one()
        axes.text(x + width / 2, -0.04, label, ha="center", va="top", size=11.5, color=INK, linespacing=1.4)
        x += width


def _difference_colours(predicted: TriangleMesh, exact: TriangleMesh) -> NDArray[np.float64]:
    import matplotlib

    scaled = np.clip(signed_distance(predicted, exact) / MOST_DIFFERENCE, -1, 1)
    return np.asarray(matplotlib.colormaps["RdBu_r"]((scaled + 1) / 2))[:, :3]


def _colour_bar(figure: Any, beside: Any, x: float) -> None:
    """Under a column's first row: which colour is which distance."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    left, bottom = figure.transFigure.inverted().transform(beside.transData.transform((x - 0.4, -0.060)))
    right, top = figure.transFigure.inverted().transform(beside.transData.transform((x + 0.4, -0.042)))
    millimetres = 1000 * MOST_DIFFERENCE
    bar = figure.colorbar(
        ScalarMappable(Normalize(-millimetres, millimetres), "RdBu_r"),
        cax=figure.add_axes((left, bottom, right - left, top - bottom)),
        orientation="horizontal",
        ticks=[-millimetres, 0, millimetres],
    )
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=9, labelcolor=INK, pad=2)
    bar.ax.set_xticklabels([f"{millimetres:.0f} mm inside", "0", f"{millimetres:.0f} mm outside"])
