"""Bodies in closed form: curves of the plane as polygons, simple solids as triangle meshes.

Curves γ(t) are sampled at equal steps of t, with the corners on the curve. A polygon of n segments misses
the curve by at most max|γ''| (2π/n)²/8 [m], which at the default n = 1024 is 4.7e-6 r for a disk, 1.7e-5 b1 +
0.7e-5 b2 for a kite, 1.0e-5 b for an apple and 1.2e-5 b for a rounded triangle. A disk or kite lacks 2π²/(3n²)
of its area, 6.3e-6 at the default. Both errors fall by four when n doubles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import combinations
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import arguments
from ..errors import ArgumentError, ShapeError
from ..geometry import Polygons, TriangleMesh

SEGMENTS = 1024
SUBDIVISIONS = 5
MOST_SUBDIVISIONS = 9

Array = NDArray[np.float64]


def kite(b1: float, b2: float, *, segments: int = SEGMENTS) -> Polygons:
    """The kite (b1 (cos t + 0.65 cos 2t - 0.65), 1.5 b2 sin t), 0 ≤ t < 2π.

    Family of Li, Liu, Tsui and Wang (2020), first used by Colton and Kress.

    Parameters
    ----------
    b1, b2 : float
        Positive sizes [m] along the first and the second axis.
    segments : int
        Sides of the polygon, at least 8.

    Returns
    -------
    Polygons
        One ring, counter-clockwise, corners on the curve; its exact area is 1.5π b1 b2 [m²].

    Raises
    ------
    ArgumentError
        A size that is not positive and finite, or too few segments.
    """
    first, second = _positive("b1", b1), _positive("b2", b2)
    t = _parameter(segments)
    return Polygons([np.stack([first * (np.cos(t) + 0.65 * np.cos(2 * t) - 0.65), 1.5 * second * np.sin(t)], axis=1)])


def apple(b: float, centre: Sequence[float] = (0.0, 0.0), *, segments: int = SEGMENTS) -> Polygons:
    """The apple r(t) = b (0.5 + 0.4 cos t + 0.1 sin 2t) / (1 + 0.7 cos t) about `centre`.

    Family of Li, Liu, Tsui and Wang (2020).

    Parameters
    ----------
    b : float
        Positive size [m].
    centre : sequence of 2 float
        Where r is measured from [m].
    segments : int
        Sides of the polygon, at least 8.

    Returns
    -------
    Polygons
        One ring, counter-clockwise, corners on the curve.

    Raises
    ------
    ArgumentError, ShapeError
        A size that is not positive and finite, a centre that is not a point, too few segments.
    """
    size = _positive("b", b)

    def radius(t: Array) -> Array:
        return size * (0.5 + 0.4 * np.cos(t) + 0.1 * np.sin(2 * t)) / (1 + 0.7 * np.cos(t))

    return _star(radius, centre, segments)


def rounded_triangle(b: float, centre: Sequence[float] = (0.0, 0.0), *, segments: int = SEGMENTS) -> Polygons:
    """The rounded triangle r(t) = b (1 + 0.15 cos 3t) about `centre`.

    Family of Li, Liu, Tsui and Wang (2020). Its exact area is π b² (1 + 0.15²/2) [m²]. Parameters, result and
    errors as for `apple`.
    """
    size = _positive("b", b)
    return _star(lambda t: size * (1 + 0.15 * np.cos(3 * t)), centre, segments)


def multi_domain(b1: float, b2: float, *, segments: int = SEGMENTS) -> Polygons:
    """An apple of size b1 about (-2, 2) and a rounded triangle of size b2 about (2, -2), as one body.

    Family of Li, Liu, Tsui and Wang (2020).

    Parameters
    ----------
    b1, b2 : float
        Positive sizes [m], small enough that the two parts cannot touch.
    segments : int
        Sides of each ring, at least 8.

    Returns
    -------
    Polygons
        Two rings, the apple first.

    Raises
    ------
    ArgumentError
        Sizes that are not positive and finite, or so large that the parts' circles about their centres meet.
    """
    sizes = _positive("b1", b1), _positive("b2", b2)
    centres = (-2.0, 2.0), (2.0, -2.0)
    parts = (
        apple(sizes[0], centres[0], segments=segments).rings[0],
        rounded_triangle(sizes[1], centres[1], segments=segments).rings[0],
    )
    reach = sum(float(np.hypot(*(ring - c).T).max()) for ring, c in zip(parts, centres, strict=True))
    # Where two rings overlapped, the far field would count the density twice.
    if reach >= math.dist(*centres):
        raise ArgumentError(
            "b1, b2",
            f"are {sizes[0]} and {sizes[1]}: the parts reach {reach:.3g} m towards each other",
            f"their centres are {math.dist(*centres):.4g} m apart; give smaller sizes",
        )
    return Polygons(parts)


def disk(r: float, centre: Sequence[float] = (0.0, 0.0), *, segments: int = SEGMENTS) -> Polygons:
    """The disk of radius r [m] about `centre`. Result and errors as for `apple`; its exact area is π r²."""
    radius = _positive("r", r)
    return _star(lambda t: np.full_like(t, radius), centre, segments)


def rectangle(e0: float, e1: float) -> Polygons:
    """The rectangle [-e0/2, e0/2] × [-e1/2, e1/2], exact, counter-clockwise from its lower left corner.

    Parameters
    ----------
    e0, e1 : float
        Positive extents [m] on axes 0 and 1; anything else is an `ArgumentError`.
    """
    half = np.array([_positive("e0", e0), _positive("e1", e1)]) / 2
    return Polygons([half * [[-1, -1], [1, -1], [1, 1], [-1, 1]]])


def cuboid(e0: float, e1: float, e2: float) -> TriangleMesh:
    """The cuboid Π_j [-e_j/2, e_j/2], exact, as 12 triangles that face outward.

    Parameters
    ----------
    e0, e1, e2 : float
        Positive extents [m] on axes 0, 1 and 2; anything else is an `ArgumentError`.
    """
    half = np.array([_positive("e0", e0), _positive("e1", e1), _positive("e2", e2)]) / 2
    # Corner i lies on the upper side of axis j where bit j of i is set.
    corners = (np.arange(8)[:, None] >> np.arange(3) & 1) * 2 - 1
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    faces = [corner for a, b, c, d in quads for corner in ((a, b, c), (a, c, d))]
    return TriangleMesh(half * corners, faces)


def ball(r: float, *, subdivisions: int = SUBDIVISIONS) -> TriangleMesh:
    """The ball of radius r about the origin, as a subdivided icosahedron with its vertices on the sphere.

    Parameters
    ----------
    r : float
        Positive radius [m].
    subdivisions : int
        Each one splits every triangle in four, 0 to 9. At the default, 5: 20,480 triangles, which stay within
        2.9e-4 r of the sphere and enclose 5.4e-4 less than 4π r³/3. Both errors fall by four per subdivision.

    Returns
    -------
    TriangleMesh
        20·4^subdivisions triangles, closed, outward.

    Raises
    ------
    ArgumentError
        A radius that is not positive and finite, or subdivisions out of range.
    """
    vertices, faces = _sphere(_subdivisions(subdivisions))
    return TriangleMesh(_positive("r", r) * vertices, faces)


def ellipsoid(r0: float, r1: float, r2: float, *, subdivisions: int = SUBDIVISIONS) -> TriangleMesh:
    """The ellipsoid Σ_j (y_j/r_j)² ≤ 1: the `ball` of radius 1, stretched by its semi-axes r_j [m].

    Its exact volume is 4π r0 r1 r2/3 [m³]; subdivisions, relative volume error and errors as for `ball`.
    """
    vertices, faces = _sphere(_subdivisions(subdivisions))
    axes = np.array([_positive("r0", r0), _positive("r1", r1), _positive("r2", r2)])
    return TriangleMesh(axes * vertices, faces)


def _positive(name: str, value: Any) -> float:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise ArgumentError(name, f"is {value!r}", "give a positive length in metres")
    length = float(value)
    if not (math.isfinite(length) and length > 0):
        raise ArgumentError(name, f"is {length}", "give a positive finite length in metres")
    return length


def _parameter(segments: int) -> Array:
    n = arguments.count("segments", segments, least=8)
    return np.linspace(0, 2 * np.pi, n, endpoint=False)


def _star(radius: Callable[[Array], Array], centre: Sequence[float], segments: int) -> Polygons:
    """The ring centre + r(t) (cos t, sin t)."""
    t = _parameter(segments)
    point = arguments.real_array("centre", centre, np.float64)
    if point.shape != (2,):
        raise ShapeError("centre", f"has shape {point.shape}", "give two coordinates in metres")
    return Polygons([point + radius(t)[:, None] * np.stack([np.cos(t), np.sin(t)], axis=1)])


def _subdivisions(value: int) -> int:
    levels = arguments.count("subdivisions", value, least=0)
    if levels > MOST_SUBDIVISIONS:
        raise ArgumentError(
            "subdivisions", f"is {levels}: {20 * 4**levels:,} triangles", f"give {MOST_SUBDIVISIONS} at most"
        )
    return levels


@lru_cache(maxsize=4)
def _sphere(subdivisions: int) -> tuple[Array, NDArray[np.int64]]:
    """Vertices on the unit sphere and outward faces of an icosahedron, subdivided."""
    golden = (1 + math.sqrt(5)) / 2
    rectangle_corners = np.array([(0.0, s, g) for s in (-1, 1) for g in (-golden, golden)])
    vertices = np.concatenate([np.roll(rectangle_corners, shift, axis=1) for shift in range(3)])
    # Neighbours on the icosahedron are 2 apart: its faces are the triples of mutual neighbours.
    near = np.abs(np.linalg.norm(vertices[:, None] - vertices, axis=-1) - 2) < 1e-9
    faces = np.array([(a, b, c) for a, b, c in combinations(range(12), 3) if near[a, b] and near[b, c] and near[c, a]])
    inward = np.linalg.det(vertices[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(subdivisions):
        vertices, faces = _split(vertices, faces)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces


def _split(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Every triangle in four, the new vertices pushed out to the unit sphere."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    middles = vertices[unique].sum(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
    a, b, c = faces.T
    children = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    split = np.stack([np.stack(child, axis=1) for child in children], axis=1).reshape(-1, 3)
    return np.concatenate([vertices, middles]), split
