"""Kites (β1 (cos t + 0.65 cos 2t - 0.65), 1.5 β2 sin t): 14 × 14 training bodies, four others to predict."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from .. import bodies
from ..backends.base import Backend
from ..geometry import Box, Grid
from ..nodes import FourierLattice
from ..progress import Progress
from . import plane_section
from .page import Section
from .trial import Family, Setting, run_trial

# A polygon of 512 sides misses the kite by 7e-5 m at most, and 2.5e-5 of its area.
SEGMENTS = 512


def family(values: int = 14, segments: int = SEGMENTS) -> Family:
    """The paper's training grid with `values` knots per axis in [0.5, 1.8], and its queries."""
    knots = np.linspace(0.5, 1.8, values).tolist()
    queries = [(0.93, 1.76), (1.58, 0.87), (0.95, 0.95), (1.65, 1.65)]
    kite = partial(bodies.kite, segments=segments)
    return Family("kite", ("β1", "β2"), (knots, knots), queries, kite, kite)


def paper_setting(order: int = 20, cells: int = 400) -> Setting:
    """A square of 7 m."""
    box = Box((7.0, 7.0))
    return Setting("paper", FourierLattice(box, order), Grid(box, cells))


def our_setting(order: int = 20, cells: int = 400) -> Setting:
    """Each kite in the frame of its bounding box, and a V0 that fits the largest; compared where the paper's are."""
    box = Box((5.0, 6.0))
    return Setting("ours", FourierLattice(box, order), paper_setting(order, cells).grid, frame="bbox")


def run(
    folder: Path,
    *,
    values: int = 14,
    order: int = 20,
    cells: int = 400,
    segments: int = SEGMENTS,
    backend: str | Backend | None = None,
    progress: Progress,
) -> Section:
    """The whole experiment; draws into `folder`."""
    kites = family(values, segments)
    settings = paper_setting(order, cells), our_setting(order, cells)
    outcomes = [run_trial(kites, setting, backend=backend, progress=progress) for setting in settings]
    text = (
        "Kites x(t) = (β1 (cos t + 0.65 cos 2t - 0.65), 1.5 β2 sin t) in a square V0 of 7 m. Their generators are "
        f"those of polygons of {segments} sides on the curve, in closed form. In our setting each is learned in the "
        "frame of its bounding box: all kites are then the same, and their generators agree to rounding."
    )
    return plane_section.assemble("Kites", text, "kite", outcomes, folder)
