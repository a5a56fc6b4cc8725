"""Meshes for the finite element solver: the plane with or without a body's edges, an octant around a ball; Netgen."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Polygons

Floats = NDArray[np.float64]

# Elements of PER_WAVE · order / k_max: the far field at k_max is then right to about 1e-5.
PER_WAVE = 0.55
# Degree and element size [m] of the quadrature over a body.
BODY_DEGREE, BODY_SIZE = 4, 0.3


@dataclass(frozen=True)
class Shells:
    """Radii [m]: bodies within `inner`, far field read between `inner` and `outer`, PML from there to `end`."""

    inner: float
    outer: float
    end: float

    @classmethod
    def around(cls, reach: float, layer: float = 0.8) -> Shells:
        """For bodies within |x| ≤ reach, with a PML of thickness `layer` [m]."""
        return cls(reach + 0.1, reach + 0.4, reach + 0.4 + layer)

    @property
    def middle(self) -> float:
        """Of the shell that the far field is read from."""
        return (self.inner + self.outer) / 2


def reach_of(body: Polygons) -> float:
    """Largest distance [m] of a body from the origin."""
    return max(float(np.hypot(*ring.T).max()) for ring in body.rings)


def plane_mesh(shells: Shells, k_max: float, order: int, body: Polygons | None = None) -> Any:
    """The plane, for wavenumbers up to `k_max` [rad/m], around the edges of a body if one is given."""
    import ngsolve
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    geometry.AddCircle((0, 0), shells.inner, leftdomain=1, rightdomain=2)
    geometry.AddCircle((0, 0), shells.outer, leftdomain=2, rightdomain=3)
    geometry.AddCircle((0, 0), shells.end, leftdomain=3, rightdomain=0, bc="outer")
    materials = ["air", "shell", "pml"]
    if body is not None:
        _add_rings(geometry, body, inside=4, outside=1)
        materials.append("body")
    for number, material in enumerate(materials, start=1):
        geometry.SetMaterial(number, material)
    return ngsolve.Mesh(geometry.GenerateMesh(maxh=PER_WAVE * order / k_max))


def octant_mesh(radius: float, shells: Shells, k_max: float, order: int) -> Any:
    """The octant x, y, z > 0 around a ball about the origin, for wavenumbers up to `k_max` [rad/m]."""
    import ngsolve
    from netgen.occ import Box, Glue, OCCGeometry, Pnt, Sphere

    centre = Pnt(0, 0, 0)
    spheres = [Sphere(centre, r) for r in (radius, shells.inner, shells.outer, shells.end)]
    spheres[-1].faces[0].name = "outer"
    octant = Box(centre, Pnt(*(2 * shells.end,) * 3))
    hollow = [large - small for small, large in pairwise(spheres)]
    parts = [solid * octant for solid in (spheres[0], *hollow)]
    for part, material in zip(parts, ("body", "air", "shell", "pml"), strict=True):
        part.mat(material)
    return ngsolve.Mesh(OCCGeometry(Glue(parts)).GenerateMesh(maxh=PER_WAVE * order / k_max))


def body_quadrature(body: Polygons) -> tuple[Floats, Floats]:
    """Points (Q, 2) within a body and weights (Q,) [m²], exact to degree 4 on each triangle of a mesh of its own."""
    import ngsolve
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    _add_rings(geometry, body, inside=1, outside=0)
    mesh = ngsolve.Mesh(geometry.GenerateMesh(maxh=BODY_SIZE))
    corners = np.array([vertex.point for vertex in mesh.vertices])
    triangles = corners[[[vertex.nr for vertex in element.vertices] for element in mesh.Elements(ngsolve.VOL)]]
    rule = ngsolve.IntegrationRule(ngsolve.TRIG, BODY_DEGREE)
    sides = triangles[:, 1:] - triangles[:, :1]
    points = triangles[:, :1] + np.einsum("qj,tjc->tqc", [point.point[:2] for point in rule], sides)
    weights = np.abs(np.linalg.det(sides))[:, None] * np.array([point.weight for point in rule])
    return points.reshape(-1, 2), weights.ravel()


def _add_rings(geometry: Any, body: Polygons, *, inside: int, outside: int) -> None:
    for ring in body.rings:
        corners = [geometry.AppendPoint(float(x), float(y)) for x, y in ring]
        for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
            geometry.Append(["line", start, end], leftdomain=inside, rightdomain=outside)
