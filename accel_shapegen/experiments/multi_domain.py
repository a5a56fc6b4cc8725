"""Two bodies at once, an apple at (-2, 2) and a rounded triangle at (2, -2): 11 × 11 training bodies, four others."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path

import numpy as np

from .. import bodies
from ..backends.base import Backend
from ..far_field import Body
from ..geometry import Box, Frame, Grid
from ..nodes import FourierLattice
from ..progress import Progress
from . import plane_section
from .page import Section
from .trial import Family, Setting, run_trial

SEGMENTS = 512


def family(values: int = 11, segments: int = SEGMENTS) -> Family:
    """β1 in [1, 2] and β2 in [0.5, 1.5] with `values` knots each, and the paper's queries.

    The paper prints [0.5, 1] for β2 in one place; one of its queries needs 1.47.
    """
    knots = np.linspace(1.0, 2.0, values).tolist(), np.linspace(0.5, 1.5, values).tolist()
    queries = [(1.13, 1.13), (1.94, 0.53), (1.88, 0.94), (1.96, 1.47)]
    pair = partial(bodies.multi_domain, segments=segments)
    return Family("multi-domain", ("β1", "β2"), knots, queries, pair, pair)


def paper_setting(order: int = 20, cells: int = 400) -> Setting:
    """A square of 10 m."""
    box = Box((10.0, 10.0))
    return Setting("paper", FourierLattice(box, order), Grid(box, cells))


def our_setting(pairs: Family, order: int = 20, cells: int = 400) -> Setting:
    """A V0 that fits all training bodies with 3 % to spare on each side, in full decimetres, moved to where they are.

    The two parts move apart from each other, which no frame can undo.
    """
    corners = [pairs.surface(*values).bounds for values in itertools.product(*((k[0], k[-1]) for k in pairs.knots))]
    low, high = np.min(corners, axis=0)[0], np.max(corners, axis=0)[1]
    place = Frame(((low + high) / 2).tolist(), (1.0, 1.0))

    def shared_centre(body: Body) -> Frame:
        return place

    lattice = FourierLattice(Box((np.ceil(10.6 * (high - low)) / 10).tolist()), order)
    return Setting("ours", lattice, paper_setting(order, cells).grid, frame=shared_centre)


def run(
    folder: Path,
    *,
    values: int = 11,
    order: int = 20,
    cells: int = 400,
    segments: int = SEGMENTS,
    backend: str | Backend | None = None,
    progress: Progress,
) -> Section:
    """The whole experiment; draws into `folder`."""
    pairs = family(values, segments)
    settings = paper_setting(order, cells), our_setting(pairs, order, cells)
    outcomes = [run_trial(pairs, setting, backend=backend, progress=progress) for setting in settings]
    text = (
        "An apple r = β1 (0.5 + 0.4 cos t + 0.1 sin 2t)/(1 + 0.7 cos t) about (-2, 2) and a rounded triangle "
        "r = β2 (1 + 0.15 cos 3t) about (2, -2), one body of two parts in a square V0 of 10 m. In our setting V0 "
        "is as small as all training bodies allow, so that the same number of nodes resolves more."
    )
    return plane_section.assemble("Two domains at once", text, "multi-domain", outcomes, folder)
