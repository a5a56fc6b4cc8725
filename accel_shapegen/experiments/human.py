"""Human bodies by height and relative weight, of two kinds: 5 × 5 training bodies, two others to predict."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import bodies, report
from ..backends.base import Backend
from ..geometry import Box, Grid, TriangleMesh
from ..nodes import FourierLattice
from ..progress import Progress
from . import summary
from .page import Figure, Section, Table
from .trial import Family, Outcome, Setting, run_trial

KINDS = {"slider": "MakeHuman's slider", "mass": "mass"}
PAPER_BOX, OUR_BOX = Box((2.2, 2.2, 2.2)), Box((1.6, 0.8, 2.2))
# Scaled to one height, bodies are 1.24 × 0.54 × 1.9 m at most.
NARROW_BOX = Box((1.5, 0.72, 2.1))


def family(kind: str, values: int = 5) -> Family:
    """`values` heights in [1.5, 1.9] m and relative weights in [0.6, 1.4], and the queries; exact meshes."""
    knots = np.linspace(1.5, 1.9, values).tolist(), np.linspace(0.6, 1.4, values).tolist()
    human = partial(bodies.human, kind=kind)
    return Family(f"human, {kind}", ("height", "rw"), knots, [(1.55, 1.3), (1.85, 1.1)], human, human)


def paper_setting(order: int = 19, cells: int = 100) -> Setting:
    """A cube of 2.2 m."""
    return Setting("paper", FourierLattice(PAPER_BOX, order), Grid(PAPER_BOX, cells))


def our_setting(
    name: str = "ours",
    order: tuple[int, ...] = (21, 11, 30),
    cells: tuple[int, ...] = (120, 60, 180),
    box: Box = OUR_BOX,
) -> Setting:
    """A V0 as broad and deep as bodies are, nodes where they are needed, and each body scaled to one height."""
    return Setting(name, FourierLattice(box, order), Grid(OUR_BOX, cells), frame="height")


def settings() -> list[Setting]:
    """The paper's; ours with as many nodes; and ours with five times as many."""
    return [paper_setting(), our_setting(), our_setting("ours, more nodes", (37, 18, 52), box=NARROW_BOX)]


def run(
    folder: Path,
    *,
    values: int = 5,
    chosen: list[Setting] | None = None,
    backend: str | Backend | None = None,
    progress: Progress,
) -> Section:
    """The whole experiment, in the settings `chosen`; draws into `folder`."""
    tables: list[Table] = []
    shown: list[Figure] = []
    record: dict[str, Any] = {}
    for kind, weight in KINDS.items():
        bodies_of_kind = family(kind, values)
        outcomes = [
            run_trial(bodies_of_kind, setting, backend=backend, progress=progress) for setting in chosen or settings()
        ]
        for number, outcome in enumerate(outcomes, start=1):
            name = f"human_{kind}_{number}.png"
            with progress.stage(f"human, {kind}, {outcome.setting.name}: picture") as count:
                _draw(folder / name, f"Weight by {weight}, setting: {outcome.setting.name}", outcome, count)
            shown.append(
                Figure(name, f"Weight by {weight}, {summary.describe(outcome)}: exact, predicted, difference.")
            )
        tables.append(summary.table(outcomes, f"Bodies that were in no training set, weight by {weight}"))
        record[kind] = summary.record(outcomes)
    text = [
        "MakeHuman bodies by height and relative weight. The paper's weight is most likely MakeHuman's slider, which "
        "moves the mass by about ±10 %; a second set takes true masses instead.",
        "Their generators are exact to 1e-6, by the surface integral over 24,876 triangles. In the paper's setting the "
        "band limit is the weak part: wrists and fingers are thinner than the shortest wavelength, 0.11 m, and hands "
        "come off. Ours has a box that is as narrow and shallow as bodies are, so that the nodes lie further out, and "
        "scales all bodies to one height.",
        summary.settings(outcomes),
    ]
    return Section("Human bodies", text, tables, shown, record)


def _draw(path: Path, heading: str, outcome: Outcome, count: Any) -> None:
    comparisons = []
    for prediction in outcome.predictions:
        exact, predicted = prediction.exact, prediction.surface
        assert isinstance(exact, TriangleMesh) and isinstance(predicted, TriangleMesh)  # three axes
        height, weight = prediction.query
        caption = [f"relative weight {weight:.2f}", "", *summary.caption(prediction.record)]
        comparisons.append(report.Comparison(f"{height:.2f} m", caption, exact, predicted))
    report.draw_comparison(path, heading, outcome.device, comparisons, [], progress=count)
