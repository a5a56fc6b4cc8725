"""Orthographic pictures of triangle meshes in NumPy: a depth buffer, smooth normals, soft light.

Lengths stay lengths: a picture knows where in metres its edges lie, so that bodies drawn beside each other have one
scale and one ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments
from .errors import ArgumentError, DtypeError, ShapeError
from .geometry import TriangleMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Samples per pixel and axis: what smooths the outline.
SUPERSAMPLING = 2
# Largest picture, in samples: 8000 × 8000.
MOST_SAMPLES = 64_000_000
# Candidate samples tested at once: bounds the temporaries to some 200 MB.
BLOCK = 1 << 21
# Directions in view coordinates (right, up, towards the viewer), and how strong each light is.
KEY, FILL = np.array([-0.48, 0.62, 0.62]), np.array([0.85, 0.05, 0.52])
AMBIENT_LIGHT, SKY_LIGHT, KEY_LIGHT, FILL_LIGHT, RIM_LIGHT, GLOSS = 0.18, 0.24, 0.70, 0.20, 0.18, 0.05


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered view.

    Attributes
    ----------
    image : float array, shape (rows, columns, 4)
        sRGB and alpha in [0, 1], not premultiplied; the first row is the top.
    extent : tuple of float
        (left, right, bottom, top) [m] in the plane of the view, as matplotlib's `imshow` takes it.
    """

    image: Floats
    extent: tuple[float, float, float, float]


def render(
    mesh: TriangleMesh,
    azimuth: float,
    *,
    pixels_per_metre: float,
    colour: ArrayLike = (0.72, 0.72, 0.72),
    elevation: float = 0.0,
) -> Picture:
    """A mesh seen from far away.

    Parameters
    ----------
    mesh : TriangleMesh
        Outward; triangles that face away are not drawn.
    azimuth : float
        Degrees by which the viewer walks round the last axis. At 0 he stands at -y, with x to the right and z up,
        where a human body's front is seen; at 90 he stands at +x.
    pixels_per_metre : float
        Scale of the picture.
    colour : array_like, shape (3,) or (V, 3)
        sRGB in [0, 1], one for all or one per vertex.
    elevation : float
        Degrees by which he looks down.

    Returns
    -------
    Picture

    Raises
    ------
    ShapegenError
        A scale that is not positive or makes a picture beyond 64 million samples, colours of another shape.
    """
    if not isinstance(mesh, TriangleMesh):
        raise DtypeError("mesh", f"is a {type(mesh).__name__}", "give a TriangleMesh")
    (scale,) = arguments.lengths("pixels_per_metre", pixels_per_metre, dim=1)
    paint = _linear(_vertex_colours(colour, len(mesh.vertices)))
    axes = view_axes(azimuth, elevation)
    seen = mesh.vertices @ axes.T
    used = seen[np.unique(mesh.faces)]
    # One pixel of margin keeps the smoothed outline within the picture.
    low = np.floor(used[:, :2].min(axis=0) * scale) - 1
    size = (np.ceil(used[:, :2].max(axis=0) * scale) + 1 - low).astype(np.int64)
    if size.prod() * SUPERSAMPLING**2 > MOST_SAMPLES:
        raise ArgumentError("pixels_per_metre", f"is {scale:g}: {size[0]} × {size[1]} pixels", "give a smaller scale")
    samples = np.stack([*((seen[:, :2] * scale - low) * SUPERSAMPLING).T, seen[:, 2]], axis=1)
    face, weights, near = _visible(samples, mesh.faces, tuple(size * SUPERSAMPLING))
    covered = face >= 0
    corners = mesh.faces[face[covered]]
    share = weights[covered][:, :, None]
    normals = _unit((vertex_normals(mesh) @ axes.T)[corners] * share)
    light = _light(normals) * _openness(near, covered, scale * SUPERSAMPLING)[covered]
    shaded = (paint[corners] * share).sum(axis=1) * light[:, None] + _gloss(normals)[:, None]
    (left, bottom), (right, top) = low / scale, (low + size) / scale
    return Picture(_picture(shaded, covered), (float(left), float(right), float(bottom), float(top)))


def view_axes(azimuth: float, elevation: float = 0.0) -> Floats:
    """Rows: right, up, and towards the viewer, as unit vectors of the body's axes."""
    a, e = math.radians(azimuth), math.radians(elevation)
    right = np.array([math.cos(a), math.sin(a), 0.0])
    toward = np.array([math.sin(a) * math.cos(e), -math.cos(a) * math.cos(e), math.sin(e)])
    return np.stack([right, np.cross(toward, right), toward])


def vertex_normals(mesh: TriangleMesh) -> Floats:
    """Outward unit normals, shape (V, 3): means over the triangles at a vertex, weighted by their areas."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.zeros_like(mesh.vertices)
    flat = np.cross(b - a, c - a)
    for corner in mesh.faces.T:
        np.add.at(normals, corner, flat)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)


def _unit(weighted: Floats) -> Floats:
    total = weighted.sum(axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(float).tiny)


def _vertex_colours(colour: ArrayLike, count: int) -> Floats:
    values = arguments.real_array("colour", colour, np.float64)
    if values.shape not in ((3,), (count, 3)):
        raise ShapeError("colour", f"has shape {values.shape}", f"give (3,) or ({count}, 3)")
    if values.min() < 0 or values.max() > 1:
        raise ArgumentError("colour", f"spans [{values.min():g}, {values.max():g}]", "give values in [0, 1]")
    return np.broadcast_to(values, (count, 3))


def _visible(samples: Floats, faces: Ints, size: tuple[int, int]) -> tuple[Ints, Floats, Floats]:
    """The nearest triangle at each sample of a (rows, columns) picture, -1 for none; its weights; its nearness."""
    columns, rows = size
    face, near = np.full(rows * columns, -1, dtype=np.int64), np.full(rows * columns, -np.inf)
    weights = np.zeros((rows * columns, 3))
    corners = samples[faces]
    edges = corners[:, 1:, :2] - corners[:, :1, :2]
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    for which, x, y in _candidates(corners, np.flatnonzero(area > 0)):
        point = np.stack([x, y], axis=1) + 0.5 - corners[which, 0, :2]
        first, second = edges[which, 0], edges[which, 1]
        b = (point[:, 0] * second[:, 1] - point[:, 1] * second[:, 0]) / area[which]
        c = (first[:, 0] * point[:, 1] - first[:, 1] * point[:, 0]) / area[which]
        a = 1 - b - c
        inside = np.flatnonzero((a >= 0) & (b >= 0) & (c >= 0))
        share = np.stack([a[inside], b[inside], c[inside]], axis=1)
        pixel, triangle = (y * columns + x)[inside], which[inside]
        depth = np.einsum("ij,ij->i", share, corners[triangle, :, 2])
        wins = np.flatnonzero(depth > near[pixel])
        # Assignment keeps the last of equal indices: in ascending order that is the nearest.
        wins = wins[np.argsort(depth[wins], kind="stable")]
        target = pixel[wins]
        face[target], near[target], weights[target] = triangle[wins], depth[wins], share[wins]
    shape = (rows, columns)
    return face.reshape(shape), weights.reshape(*shape, 3), near.reshape(shape)


def _candidates(corners: Floats, chosen: Ints) -> Iterator[tuple[Ints, Ints, Ints]]:
    """(triangle, column, row) of every sample in the bounding box of each chosen triangle, in blocks."""
    low = np.ceil(corners[chosen, :, :2].min(axis=1) - 0.5).astype(np.int64)
    sides = np.maximum(np.floor(corners[chosen, :, :2].max(axis=1) - 0.5).astype(np.int64) - low + 1, 0)
    counts = sides.prod(axis=1)
    ends = np.cumsum(counts)
    start = 0
    while start < len(chosen):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + BLOCK, side="right")))
        item = np.repeat(np.arange(start, stop), counts[start:stop])
        within = np.arange(len(item)) - (ends[item] - counts[item] - done)
        yield chosen[item], low[item, 0] + within % sides[item, 0], low[item, 1] + within // sides[item, 0]
        start = stop


def _light(normals: Floats) -> Floats:
    """Diffuse light: two lamps, a sky, and a rim that lifts the outline from the background."""
    key = np.clip(normals @ (KEY / np.linalg.norm(KEY)), 0, None)
    fill = np.clip(normals @ (FILL / np.linalg.norm(FILL)), 0, None)
    rim = (1 - np.clip(normals[:, 2], 0, 1)) ** 3
    sky = (1 + normals[:, 1]) / 2
    return AMBIENT_LIGHT + SKY_LIGHT * sky + KEY_LIGHT * key + FILL_LIGHT * fill + RIM_LIGHT * rim


def _gloss(normals: Floats) -> Floats:
    half = KEY / np.linalg.norm(KEY) + [0, 0, 1]
    result: Floats = GLOSS * np.clip(normals @ (half / np.linalg.norm(half)), 0, 1) ** 24
    return result


def _openness(near: Floats, covered: NDArray[np.bool_], samples_per_metre: float) -> Floats:
    """How little of the surroundings stands nearer to the viewer: darkens armpits, necks and gaps."""
    from scipy.ndimage import uniform_filter

    if not covered.any():
        return np.ones_like(near)
    reach = max(covered.any(axis=0).sum(), covered.any(axis=1).sum()) / samples_per_metre
    depth = np.where(covered, near, 0.0)
    result = np.ones_like(near)
    for radius, strength in ((0.008 * reach, 0.25), (0.03 * reach, 0.35)):
        width = max(3, round(2 * radius * samples_per_metre))
        blurred, weight = depth, covered.astype(np.float64)
        for _ in range(2):  # twice a box is close to a Gaussian, at a cost that does not grow with its width
            blurred = uniform_filter(blurred, width, mode="constant")
            weight = uniform_filter(weight, width, mode="constant")
        nearer = blurred / np.maximum(weight, 1e-9) - depth
        result *= 1 - strength * np.clip(nearer / radius, 0, 1)
    return result


def _linear(srgb: Floats) -> Floats:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _srgb(linear: Floats) -> Floats:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _picture(shaded: Floats, covered: NDArray[np.bool_]) -> Floats:
    """Samples averaged to pixels in linear light, encoded, top row first."""
    rows, columns = covered.shape
    premultiplied = np.zeros((rows, columns, 4))
    premultiplied[covered, :3], premultiplied[covered, 3] = np.clip(shaded, 0, 1), 1
    s = SUPERSAMPLING
    mean = np.add.reduce([premultiplied[i::s, j::s] for i in range(s) for j in range(s)])[::-1] / s**2
    drawn = mean[..., 3] > 0
    mean[drawn, :3] = _srgb(mean[drawn, :3] / mean[drawn, 3:])
    return mean
