"""Families of bodies that `train` knows by name: their characteristic values, and where they fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import bodies
from ..errors import ArgumentError, KnotError
from ..geometry import Polygons, TriangleMesh


@dataclass(frozen=True)
class Family:
    """A family of bodies.

    Attributes
    ----------
    make : callable
        Characteristic values to body.
    names : tuple of str
        What they are called, in that order.
    dim : int
        2 or 3.
    box, order : float and int, optional
        For the families of Li, Liu, Tsui and Wang (2020): side [m] of a cube or square that holds their bodies, and
        the order of their lattice.
    """

    make: Callable[..., Polygons | TriangleMesh]
    names: tuple[str, ...]
    dim: int
    box: float | None = None
    order: int | None = None


FAMILIES = {
    "human": Family(bodies.human, ("height", "rw"), 3, 2.2, 19),
    "cuboid": Family(bodies.cuboid, ("e0", "e1", "e2"), 3, 3.0, 19),
    "ball": Family(bodies.ball, ("r",), 3),
    "ellipsoid": Family(bodies.ellipsoid, ("r0", "r1", "r2"), 3),
    "kite": Family(bodies.kite, ("b1", "b2"), 2, 7.0, 20),
    "multi_domain": Family(bodies.multi_domain, ("b1", "b2"), 2, 10.0, 20),
    "apple": Family(bodies.apple, ("b",), 2),
    "rounded_triangle": Family(bodies.rounded_triangle, ("b",), 2),
    "disk": Family(bodies.disk, ("r",), 2),
    "rectangle": Family(bodies.rectangle, ("e0", "e1"), 2),
}


def find(name: str) -> Family:
    """A family by its name."""
    if name not in FAMILIES:
        raise ArgumentError("--family", f"is {name!r}", "give one of " + ", ".join(FAMILIES))
    return FAMILIES[name]


def grid_of(name: str, family: Family, given: Sequence[tuple[str, NDArray[np.float64]]]) -> list[NDArray[np.float64]]:
    """Knots in the family's order from `--grid` options in any order."""
    wanted = ", ".join(family.names)
    knots: dict[str, NDArray[np.float64]] = {}
    for axis, values in given:
        if axis not in family.names:
            raise ArgumentError("--grid", f"names {axis!r}", f"the values of {name} are {wanted}")
        if axis in knots:
            raise ArgumentError("--grid", f"gives {axis} twice", "give it once")
        if len(values) < 2 or np.any(np.diff(values) <= 0):
            raise KnotError(
                "--grid", f"gives {axis} the values {list(map(float, values))}", "give two or more, ascending"
            )
        knots[axis] = values
    missing = [axis for axis in family.names if axis not in knots]
    if missing:
        raise ArgumentError("--grid", f"for {missing[0]} is missing", f"give one each for {wanted}")
    return [knots[axis] for axis in family.names]
