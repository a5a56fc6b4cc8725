"""Kites learned from finite element data, so that no transform makes both the training data and the test.

5 × 5 kites on a lattice of order 8. All bodies share one mesh that follows none of them, so that each wavenumber of the
lattice is factorised once; the zero node is at μ = 0.1, since a PML cannot end waves of hundreds of metres.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import bodies, metrics
from ..backends.base import Backend
from ..far_field import far_field
from ..geometry import Box, Grid, Polygons
from ..model import ShapeModel
from ..nodes import FourierLattice
from ..progress import Progress, Report
from ..synthesis import synthesize
from ..voxelize import voxelize
from .fem import Exterior, Waves, require_ngsolve
from .fem_mesh import Shells, body_quadrature, plane_mesh, reach_of
from .kite import family
from .page import Section, Table

ORDER_OF_ELEMENTS = 8
SEGMENTS = 256
MU = 0.1


def run(
    folder: Path,
    *,
    values: int = 5,
    order: int = 8,
    cells: int = 400,
    backend: str | Backend | None = None,
    progress: Progress,
) -> Section:
    """Train on finite elements and on the transform, and compare both models with the exact bodies."""
    require_ngsolve()
    kites = family(values, SEGMENTS)
    kite = partial(bodies.kite, segments=SEGMENTS)
    lattice, grid = FourierLattice(Box((7.0, 7.0)), order, MU), Grid(Box((7.0, 7.0)), cells)
    training = [kite(*pair) for pair in kites.training]
    with progress.stage("finite elements: training bodies") as report:
        by_elements = far_fields(training, lattice, report)
    by_transform = far_field(training, lattice, dtype="complex128", backend=backend)
    errors = metrics.far_field_error(by_elements, by_transform, lattice)
    shape = (*(len(axis) for axis in kites.knots), *lattice.shape)
    models = [
        ShapeModel.fit(kites.knots, u.reshape(shape), lattice, names=kites.names, backend=backend)
        for u in (by_elements, by_transform)
    ]
    queries = []
    for query in kites.queries:
        body = kite(*query)
        exact = far_field(body, lattice, dtype="complex128", backend=backend)
        inside = voxelize(body, grid)
        merits: dict[str, Any] = {"values": dict(zip(kites.names, query, strict=True))}
        for name, model in zip(("elements", "transform"), models, strict=True):
            u = model.predict(query)
            merits[f"iou_{name}"] = metrics.iou(synthesize(u, lattice, grid, backend=backend) > 0.5, inside)
            merits[f"far_field_relative_error_{name}"] = float(metrics.far_field_error(u, exact, lattice))
        merits["iou_truncation"] = metrics.iou(synthesize(exact, lattice, grid, backend=backend) > 0.5, inside)
        queries.append(merits)
    worst = float(np.max(errors))
    wavenumbers = len(np.unique(np.round(lattice.wavenumbers, 9)))
    record = {"training_far_field_relative_error": worst, "wavenumbers": wavenumbers, "queries": queries}
    heads = ["body", "elements", "transform", "truncation alone", "elements", "transform"]
    rows = [
        [
            kites.describe(query),
            *(f"{merits[key]:.4f}" for key in ("iou_elements", "iou_transform", "iou_truncation")),
            *(f"{merits[f'far_field_relative_error_{name}']:.2e}" for name in ("elements", "transform")),
        ]
        for query, merits in zip(kites.queries, queries, strict=True)
    ]
    table = Table("Kites by training data", heads, rows, [("", 1), ("IoU", 3), ("far-field error", 2)])
    text = [
        f"{len(training)} kites on a lattice of order {order}, their generators from finite elements: {wavenumbers} "
        "wavenumbers, one factorisation each. They differ from the transforms of the bodies by "
        f"{worst:.1e} at most (relative L2), and the models predict alike.",
    ]
    return Section("Kites learned from finite elements", text, [table], [], record)


def far_fields(some: list[Polygons], lattice: FourierLattice, report: Report) -> NDArray[np.complex128]:
    """Generators by finite elements, (B, *lattice.shape): a factorisation per wavenumber, a solution per body."""
    shells = Shells.around(max(reach_of(body) for body in some), layer=1.2)
    k = lattice.wavenumbers.ravel()
    exterior = Exterior(plane_mesh(shells, k.max(), ORDER_OF_ELEMENTS), 2, shells, ORDER_OF_ELEMENTS)
    loads = [exterior.load_of(*body_quadrature(body)) for body in some]
    # Half of the lattice is enough, the bodies being real.
    half = np.arange(lattice.size // 2, lattice.size)
    groups: dict[float, list[int]] = {}
    for node in half:
        groups.setdefault(round(float(k[node]), 9), []).append(int(node))
    u = np.empty((len(some), len(half)), dtype=np.complex128)
    directions = lattice.directions.reshape(-1, 2)
    for done, nodes in enumerate(groups.values(), start=1):
        waves = Waves(exterior, float(k[nodes[0]]))
        solutions = [waves.solve(load) for load in loads]
        u[:, np.array(nodes) - half[0]] = waves.far_fields(solutions, directions[nodes])
        report(done, len(groups))
    return lattice.unpack(u)
