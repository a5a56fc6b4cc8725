"""The cases by name; each module's `cases(settings)` makes its data and lists its contenders."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..contest import Case, Settings
from . import lattice_far_field, mesh_far_field, scattered_far_field, spline, synthesis

CASES: dict[str, Callable[[Settings], Iterator[Case]]] = {
    "synthesis": synthesis.cases,
    "lattice_far_field": lattice_far_field.cases,
    "mesh_far_field": mesh_far_field.cases,
    "scattered_far_field": scattered_far_field.cases,
    "spline": spline.cases,
}
