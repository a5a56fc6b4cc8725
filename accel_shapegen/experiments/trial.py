"""One experiment in one setting: train on a grid of bodies, predict others, and compare them with what they are."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import frames as body_frames
from .. import metrics
from ..backends.base import Backend
from ..far_field import Body, far_field
from ..geometry import Frame, Grid, Polygons, TriangleMesh
from ..model import ShapeModel
from ..nodes import FourierLattice
from ..noise import add_noise
from ..progress import Progress, Report
from ..surface import extract_surface
from ..synthesis import synthesize
from ..voxelize import voxelize

Surface = Polygons | TriangleMesh

DELTAS = (0.01, 0.05, 0.2)


@dataclass(frozen=True)
class Family:
    """Bodies over characteristic values.

    Attributes
    ----------
    title : str
        What progress calls it.
    names : sequence of str
        What the characteristic values are called.
    knots : sequence of sequences of float
        The training grid.
    queries : sequence of tuples of float
        Bodies to predict.
    surface : callable
        Characteristic values → Polygons or TriangleMesh, the exact body.
    body : callable
        Characteristic values → what `far_field` transforms.
    """

    title: str
    names: Sequence[str]
    knots: Sequence[Sequence[float]]
    queries: Sequence[tuple[float, ...]]
    surface: Callable[..., Surface]
    body: Callable[..., Body]

    @property
    def training(self) -> list[tuple[float, ...]]:
        """All points of the training grid, C order."""
        return list(itertools.product(*self.knots))

    def describe(self, query: Sequence[float]) -> str:
        """`height 1.55, rw 1.3`."""
        return ", ".join(f"{name} {value:g}" for name, value in zip(self.names, query, strict=True))


@dataclass(frozen=True)
class Setting:
    """Nodes, the grid on which bodies are compared, the distance of surface samples [m], and the rule of frames."""

    name: str
    lattice: FourierLattice
    grid: Grid
    spacing: float | None = None
    frame: body_frames.Rule | None = None


@dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted body beside the exact one; `record` holds the figures of merit."""

    query: tuple[float, ...]
    field: NDArray[Any]
    surface: Surface
    exact: Surface
    noisy: dict[float, NDArray[Any]]
    record: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Outcome:
    """All predictions of a family in one setting."""

    family: Family
    setting: Setting
    predictions: list[Prediction]
    device: str

    @property
    def record(self) -> dict[str, Any]:
        """For results.json."""
        lattice = self.setting.lattice
        return {
            "box_m": list(lattice.box.lengths),
            "order": list(lattice.order),
            "nodes": lattice.size,
            "cells": list(self.setting.grid.shape),
            "frame": getattr(self.setting.frame, "__name__", self.setting.frame),
            "training_bodies": len(self.family.training),
            "device": self.device,
            "queries": [prediction.record for prediction in self.predictions],
        }


def run_trial(
    family: Family,
    setting: Setting,
    *,
    deltas: Sequence[float] = DELTAS,
    backend: str | Backend | None = None,
    progress: Progress,
) -> Outcome:
    """Train, predict and compare.

    Per query: `far_field_relative_error` of the predicted generator (slots ξ ≠ 0; with frames: of the normalised body,
    each in its own frame), `iou` of f_N > 1/2 with the exact body at the cell centres, `iou_truncation` the same for
    the exact generator in the exact frame, `hausdorff_m` and `volume_relative_error` of the surface, and `noise`: the
    first two once every training generator carries noise δ.
    """
    lattice, grid, what = setting.lattice, setting.grid, f"{family.title}, {setting.name}"
    with progress.stage(f"{what}: training bodies") as report:
        training = Training(family)
        model = ShapeModel.fit_bodies(
            family.knots, training, lattice, frame=setting.frame, names=family.names, backend=backend, progress=report
        )
    with progress.stage(f"{what}: noise") as report:
        noisy = _under_noise(model, family, deltas, backend, report)
    frames = _predicted_frames(model, family.queries)
    exact_frames = _exact_frames(model, family, setting.frame)
    predictions = []
    with progress.stage(f"{what}: comparison") as report:
        for index, query in enumerate(family.queries):
            exact = far_field(family.body(*query), lattice, frame=exact_frames[index], backend=backend)
            surface = family.surface(*query)
            inside = voxelize(surface, grid)
            generators = {0.0: model.predict(query), **{delta: u[index] for delta, u in noisy.items()}}
            fields = {
                delta: synthesize(u, lattice, grid, frame=frames[index], backend=backend)
                for delta, u in generators.items()
            }
            best = synthesize(exact, lattice, grid, frame=exact_frames[index], backend=backend)
            predicted = extract_surface(fields[0.0], grid)
            merits = [
                {
                    "delta": delta,
                    "far_field_relative_error": float(metrics.far_field_error(u, exact, lattice)),
                    "iou": metrics.iou(fields[delta] > 0.5, inside),
                }
                for delta, u in generators.items()
            ]
            record = {
                "values": dict(zip(family.names, query, strict=True)),
                "far_field_relative_error": merits[0]["far_field_relative_error"],
                "iou": merits[0]["iou"],
                "iou_truncation": metrics.iou(best > 0.5, inside),
                "hausdorff_m": metrics.hausdorff(predicted, surface, spacing=setting.spacing),
                "volume_relative_error": metrics.volume_error(predicted, surface),
                "noise": merits[1:],
            }
            predictions.append(Prediction(query, fields.pop(0.0), predicted, surface, fields, record))
            report(index + 1, len(family.queries))
    return Outcome(family, setting, predictions, model.device)


@dataclass(frozen=True)
class Training:
    """The training bodies, made anew each time they are passed through: together they may not fit into memory."""

    family: Family

    def __iter__(self) -> Iterator[Body]:
        return (self.family.body(*values) for values in self.family.training)


def _predicted_frames(model: ShapeModel, queries: Sequence[tuple[float, ...]]) -> list[Frame | None]:
    if not model.framed:
        return [None] * len(queries)
    return [Frame(c, s) for c, s in zip(*model.frames(np.array(queries)), strict=True)]


def _exact_frames(model: ShapeModel, family: Family, rule: body_frames.Rule | None) -> list[Frame | None]:
    """Frames of the queries themselves, relative to the largest training body as the model's are."""
    if rule is None:
        return [None] * len(family.queries)
    first = family.training[0]
    # σ = s / max s: one training body tells what the largest was.
    largest = np.array(body_frames.frame_of(family.body(*first), rule).scale) / model.frames(first)[1]
    found = [body_frames.frame_of(family.body(*query), rule) for query in family.queries]
    return [Frame(frame.centre, (np.array(frame.scale) / largest).tolist()) for frame in found]


def _under_noise(
    model: ShapeModel, family: Family, deltas: Sequence[float], backend: str | Backend | None, report: Report
) -> dict[float, NDArray[Any]]:
    """Predictions of models whose training generators carry noise, by level; frames are as they were."""
    # The spline interpolates: at the training bodies it gives back their generators.
    clean = model.predict(np.array(family.training))
    shape = (*(len(axis) for axis in family.knots), *model.nodes.shape)
    result = {}
    for seed, delta in enumerate(deltas):
        u = add_noise(clean, delta, seed).reshape(shape)
        noisy = ShapeModel.fit(family.knots, u, model.nodes, names=family.names, backend=backend)
        result[delta] = noisy.predict(np.array(family.queries))
        report(seed + 1, len(deltas))
    return result
