"""A picture of an assessment: where along the wavenumbers, and along the knots, a training set is too thin."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from .adequacy import Adequacy
from .report import FAINT, INK, require_matplotlib

COLOURS = ("#3b6ea5", "#c8553d", "#5b9279", "#8f6bb3", "#b08b2e", "#4f5d75")
# Errors below this are rounding, and drawn at it.
LEAST = 1e-8


def draw_adequacy(path: str | os.PathLike[str], assessed: Adequacy) -> Path:
    """Draw leave-one-out errors by wavenumber and by knot, and the moves of faces, to a png, pdf or svg file.

    Parameters
    ----------
    path : path
        Where to write to; its ending decides the format.
    assessed : Adequacy
        What `ShapeModel.adequacy` reports.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissingDependencyError
        Without matplotlib.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    panels = 2 if assessed.faces is None else 3
    figure = Figure(figsize=(4.6 * panels, 3.9), layout="constrained")
    plots = figure.subplots(1, panels)
    for plot in plots:
        plot.spines[["top", "right"]].set_visible(False)
        plot.tick_params(colors=INK, labelsize=9)
    _by_wavenumber(plots[0], assessed)
    _by_knot(plots[1], assessed)
    if assessed.faces is not None:
        _moves(plots[2], assessed)
    where = "of bodies in their frames" if assessed.framed else "of bodies as they lie"
    figure.suptitle(f"Adequacy of a training set {where}", color=INK, weight="bold", x=0.01, ha="left")
    target = Path(path)
    figure.savefig(target, dpi=150)
    return target


def _by_wavenumber(plot: Any, assessed: Adequacy) -> None:
    edges = assessed.band_edges
    middles, widths = (edges[:-1] + edges[1:]) / 2, np.diff(edges)
    plot.bar(middles, assessed.band_energy, widths * 0.94, color=FAINT, label="share of energy", zorder=1)
    for axis, colour in zip(assessed.axes, _colours(assessed), strict=True):
        if axis.errors.size:
            plot.plot(middles, _drawn(axis.bands), "o-", color=colour, label=f"error in {axis.name}", markersize=4)
    _log_scale(plot)
    plot.set(xlabel="wavenumber [rad/m]", title="Leave-one-out error by wavenumber", xlim=(edges[0], edges[-1]))
    plot.legend(framealpha=0.9, edgecolor="none", fontsize=9, loc="lower left")


def _by_knot(plot: Any, assessed: Adequacy) -> None:
    for axis, colour in zip(assessed.axes, _colours(assessed), strict=True):
        if not axis.errors.size:
            continue
        # Characteristic values have units of their own: knots are placed by their number among those left out.
        places = np.arange(1, len(axis.knots) + 1)
        errors = _drawn(axis.errors)
        plot.plot(np.repeat(places, errors.shape[1]), errors.ravel(), ".", color=colour, alpha=0.35, markersize=5)
        typical = _drawn(np.sqrt((axis.errors**2).mean(axis=1)))
        plot.plot(places, typical, "-", color=colour, label=axis.name)
        for place, knot, height in zip(places, axis.knots, typical, strict=True):
            plot.annotate(f"{knot:g}", (place, height), (0, 5), textcoords="offset points", fontsize=7.5, color=colour)
    _log_scale(plot)
    plot.xaxis.get_major_locator().set_params(integer=True)
    plot.set(xlabel="inner knot", title="Leave-one-out error by knot")
    if plot.get_legend_handles_labels()[0]:
        plot.legend(frameon=False, fontsize=9)


def _moves(plot: Any, assessed: Adequacy) -> None:
    faces = list(assessed.faces or ())[::-1]
    ratios = [face.move / face.limit if np.isfinite(face.move) else 0.0 for face in faces]
    colours = ["#c8553d" if face.exceeds else "#5b9279" for face in faces]
    plot.barh(range(len(faces)), ratios, color=colours, height=0.7)
    plot.axvline(1.0, color=INK, linewidth=1, linestyle=(0, (4, 3)))
    plot.set_yticks(range(len(faces)), [f"{face.name}, axis {face.axis}" for face in faces])
    for row, (face, ratio) in enumerate(zip(faces, ratios, strict=True)):
        plot.annotate(f"{1000 * face.move:.3g} mm", (ratio, row), (4, 0), textcoords="offset points", va="center",
                      fontsize=8, color=INK)  # fmt: skip
    plot.set(
        xlabel="move / half the shortest wavelength",
        title="Faces between neighbours",
        xlim=(0, 1.25 * max(1.1, *ratios)),
    )


def _drawn(errors: Any) -> Any:
    return np.clip(errors, LEAST, 1e3)


def _colours(assessed: Adequacy) -> list[str]:
    return [COLOURS[j % len(COLOURS)] for j in range(len(assessed.axes))]


def _log_scale(plot: Any) -> None:
    plot.set_yscale("log")
    low, high = plot.get_ylim()
    plot.set_ylim(max(low, LEAST / 2), max(high, 2.0))
