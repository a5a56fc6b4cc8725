"""Where bodies come from: families in closed form, human bodies, files.

kite, apple, rounded_triangle, multi_domain, disk, rectangle give Polygons; cuboid, ball, ellipsoid and human give a
TriangleMesh; load gives a TriangleMesh or a VoxelGrid.
"""

from __future__ import annotations

from .families import (
    apple,
    ball,
    cuboid,
    disk,
    ellipsoid,
    kite,
    multi_domain,
    rectangle,
    rounded_triangle,
)
from .files import load
from .human import human

__all__ = [
    "apple",
    "ball",
    "cuboid",
    "disk",
    "ellipsoid",
    "human",
    "kite",
    "load",
    "multi_domain",
    "rectangle",
    "rounded_triangle",
]
