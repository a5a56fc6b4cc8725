"""Training sets of the command line: bodies of a table of files, or of a family, one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import bodies
from ..errors import BackendError, MissingFileError, ShapegenError, TableError
from ..far_field import Body
from ..geometry import Grid, TriangleMesh
from ..model import ShapeModel
from ..nodes import FourierLattice
from ..progress import Report
from ..training_set import tensor_order
from ..voxelize import voxelize
from .families import Family
from .options import locate
from .tables import Table

FILE_COLUMN = "file"


@dataclass(frozen=True)
class TrainingSet:
    """Bodies on a full grid of characteristic values.

    Attributes
    ----------
    names : sequence of str
        Characteristic values.
    knots : sequence of M arrays
        Their grid.
    places : sequence of str
        What messages call each body, in C order of the grid.
    make : callable
        Number in that order to body.
    """

    names: Sequence[str]
    knots: Sequence[NDArray[np.float64]]
    places: Sequence[str]
    make: Callable[[int], Body]

    def fit(self, lattice: FourierLattice, progress: Report, **options: Any) -> ShapeModel:
        """`ShapeModel.fit_bodies`, with errors that name the body they are about."""
        bodies = _Bodies(self)
        try:
            return ShapeModel.fit_bodies(self.knots, bodies, lattice, names=self.names, progress=progress, **options)
        except BackendError:
            raise
        except ShapegenError as error:
            # A body is transformed before the next is read: what fails is about the one read last.
            if bodies.place is not None:
                raise locate(error, bodies.place) from error
            raise


class _Bodies:
    """The bodies of a training set, made anew each time they are passed through.

    Attributes
    ----------
    place : str or None
        What messages call the body made last; None once all have been.
    """

    def __init__(self, source: TrainingSet) -> None:
        self._source = source
        self.place: str | None = None

    def __iter__(self) -> Iterator[Body]:
        for index, where in enumerate(self._source.places):
            self.place = where
            yield self._source.make(index)
        self.place = None


def from_family(family: Family, knots: Sequence[NDArray[np.float64]], cells: Grid | None) -> TrainingSet:
    """A family over a grid, voxelised if cells are given."""
    points = [tuple(map(float, point)) for point in product(*knots)]

    def make(index: int) -> Body:
        body = family.make(*points[index])
        return body if cells is None else voxelize(body, cells)

    places = [", ".join(f"{n}={v:g}" for n, v in zip(family.names, point, strict=True)) for point in points]
    return TrainingSet(family.names, knots, places, make)


def from_table(rows: Table, cells: Grid) -> TrainingSet:
    """Files of a table, which must all be there; meshes are voxelised, voxels are taken as they are."""
    names = [column for column in rows.header if column != FILE_COLUMN]
    if not names:
        raise TableError(str(rows.path), "has no column but 'file'", "add one for each characteristic value")
    files = [rows.path.parent / text for text in rows.texts(FILE_COLUMN)]
    values = rows.numbers(names)
    try:
        knots, order = tensor_order(values, names)
    except TableError as error:
        raise TableError(str(rows.path), error.problem, error.remedy) from error
    for row, file in enumerate(files):
        if not file.is_file():
            raise MissingFileError(rows.place(row, FILE_COLUMN), f"names {file}, which is not there", "correct it")

    def make(index: int) -> Body:
        body = bodies.load(files[order[index]])
        return voxelize(body, cells) if isinstance(body, TriangleMesh) else body

    return TrainingSet(names, knots, [rows.place(int(row), FILE_COLUMN) for row in order], make)
