"""Surfaces of fields: closed, outward, in the right place, and back to the same cells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from accel_shapegen.errors import ArgumentError, DtypeError, NonFiniteError, ShapeError, ShapegenError, SurfaceError
from accel_shapegen.geometry import Box, Grid, Polygons, TriangleMesh
from accel_shapegen.surface import extract_surface
from accel_shapegen.voxelize import voxelize

Field = np.ndarray[Any, Any]


def walled(field: Field) -> Field:
    """The field with its outermost samples at -1."""
    inner = (slice(1, -1),) * field.ndim
    result = np.full(field.shape, -1.0)
    result[inner] = field[inner]
    return result


def band_limited(seed: int, shape: tuple[int, ...]) -> Field:
    noise = np.fft.fftn(np.random.default_rng(seed).standard_normal(shape))
    for axis, n in enumerate(shape):
        keep = np.abs(np.fft.fftfreq(n)) < 0.2
        noise *= keep.reshape([-1 if j == axis else 1 for j in range(len(shape))])
    return walled(np.fft.ifftn(noise).real)


def white(seed: int, shape: tuple[int, ...]) -> Field:
    return walled(np.random.default_rng(seed).standard_normal(shape))


def integers(seed: int, shape: tuple[int, ...]) -> Field:
    """A third of the samples are ties."""
    return walled(np.random.default_rng(seed).integers(-1, 2, shape).astype(float))


def signs(seed: int, shape: tuple[int, ...]) -> Field:
    """Every ambiguous face is exactly balanced."""
    return walled(np.sign(np.random.default_rng(seed).standard_normal(shape)))


def nearly(seed: int, shape: tuple[int, ...]) -> Field:
    """Values of all sizes around the level, far below what float32 tells apart."""
    rng = np.random.default_rng(seed)
    return walled(rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-300, 0, shape))


FIELDS = [band_limited, white, integers, signs, nearly]


def uneven(seed: int, shape: tuple[int, ...]) -> Grid:
    rng = np.random.default_rng(seed)
    return Grid.from_axes([np.cumsum(rng.uniform(0.5, 1.5, n)) for n in shape])


@pytest.mark.parametrize("shape", [(3, 3, 3), (12, 17, 9), (24, 24, 24), (3, 19), (31, 24)])
@pytest.mark.parametrize("make", FIELDS)
@pytest.mark.parametrize("seed", range(3))
def test_random_fields_give_closed_surfaces(make: Callable[..., Field], shape: tuple[int, ...], seed: int) -> None:
    field = make(seed, shape)
    field[tuple(n // 2 for n in shape)] = 1.0  # something to find in the smallest grids
    surface = extract_surface(field, uneven(seed, shape), level=0.0)
    quality = surface.quality
    assert quality.closed
    assert quality.volume == surface.volume > 0
    assert quality.ties == np.count_nonzero(field == 0)
    if isinstance(surface, TriangleMesh):
        assert surface.is_closed
        assert len(np.unique(surface.faces)) == len(surface.vertices)
        corners = surface.vertices[surface.faces]
        assert np.all(np.any(corners != np.roll(corners, 1, axis=1), axis=-1))
    else:
        for ring in surface.rings:
            assert np.all(np.any(ring != np.roll(ring, 1, axis=0), axis=1))


@pytest.mark.parametrize("shape", [(12, 17, 9), (20, 20, 20), (31, 24)])
@pytest.mark.parametrize("make", [band_limited, white, signs])
def test_voxels_of_the_surface_are_the_cells_above(make: Callable[..., Field], shape: tuple[int, ...]) -> None:
    """Each sample is on its side of the surface: winding numbers at the samples give the region back."""
    field = make(5, shape)
    grid = Grid(Box(tuple(0.1 * n for n in shape)), shape)
    surface = extract_surface(field, grid, level=0.25)
    assert np.array_equal(voxelize(surface, grid).values, field > 0.25)


@pytest.mark.parametrize("shape", [(17, 12), (8, 9, 10)])
def test_ties_count_as_outside(shape: tuple[int, ...]) -> None:
    field = integers(3, shape)
    grid = Grid(Box(tuple(float(n) for n in shape)), shape)
    got = voxelize(extract_surface(field, grid, level=0.0), grid).values
    # The surface runs through ties, where which side voxelize takes is its own rule; elsewhere there is no doubt.
    assert np.array_equal(got[field != 0], field[field != 0] > 0)


@pytest.mark.parametrize("dim", [2, 3])
def test_bodies_that_touch_at_a_tie_are_two(dim: int) -> None:
    field = np.full((5, 5, 7)[-dim:], -1.0)
    line = field[(2,) * (dim - 1)]
    line[2:5] = 1, 0, 1
    surface = extract_surface(field, Grid.from_axes([np.arange(n) for n in field.shape]), level=0.0)
    assert (surface.quality.closed, surface.quality.components, surface.quality.ties) == (True, 2, 1)
    # Each is made of pyramids that reach 1/2 sideways and away, and 1 to the tie.
    base = 1.0 if dim == 2 else 0.5
    assert surface.volume == pytest.approx(2 * base * (0.5 + 1) / dim, rel=1e-6)  # float32 vertices
    np.testing.assert_allclose(surface.bounds[:, -1], [1.5, 4.5], rtol=1e-6)


@pytest.mark.parametrize("size", [1e-60, 1e-300])
def test_values_too_small_for_float32_keep_their_side(size: float) -> None:
    field = size * signs(4, (9, 10, 11))
    field[3:6, 3:6, 3:6] = size
    field[4, 4, 4] = 1.0
    grid = Grid(Box((9.0, 10.0, 11.0)), field.shape)
    assert np.array_equal(voxelize(extract_surface(field, grid, level=0.0), grid).values, field > 0)


def test_a_tie_in_the_middle_of_nothing_is_no_body() -> None:
    field = np.zeros((5, 5, 5))
    field[2, 2, 2] = 0.5
    with pytest.raises(SurfaceError, match="does not cross"):
        extract_surface(field, Grid(Box((1, 1, 1)), 5))
    field[2, 2, 2] = np.nextafter(0.5, 1)
    with pytest.raises(SurfaceError, match="too little to enclose"):
        extract_surface(field, Grid(Box((1, 1, 1)), 5))


@pytest.mark.parametrize(("shape", "exact"), [((40, 50, 45), 4 * np.pi / 3), ((64, 40), np.pi)])
def test_ball_and_disk(shape: tuple[int, ...], exact: float) -> None:
    grid = Grid(Box((2.6, 2.4, 2.5)[: len(shape)]), shape)
    distance = np.linalg.norm(grid.points(), axis=-1)
    surface = extract_surface(1.5 - distance, grid)
    quality = surface.quality
    assert (quality.closed, quality.components, quality.ties, quality.collapsed) == (True, 1, 0, 0)
    corners = surface.vertices if isinstance(surface, TriangleMesh) else surface.rings[0]
    radius = np.linalg.norm(corners, axis=-1)
    h = max(grid.spacing)
    # Along a grid edge of length h the distance bends by at most h²/(8·0.95); the surface cuts chords of up to √3 h.
    assert np.abs(radius - 1).max() < h**2 / 7
    assert abs(quality.volume / exact - 1) < h**2
    if isinstance(surface, TriangleMesh):
        a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
        assert np.all(np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0)


@pytest.mark.parametrize("shape", [(30, 31, 29), (57, 60)])
def test_cavity_and_second_body(shape: tuple[int, ...]) -> None:
    dim = len(shape)
    grid = Grid(Box((3.0,) * dim), shape)
    points = grid.points()
    shell = 0.3 - np.abs(np.linalg.norm(points, axis=-1) - 0.7)
    away = 0.25 - np.linalg.norm(points - 1.1, axis=-1)
    surface = extract_surface(np.maximum(shell, away), grid, level=0.0)
    assert surface.quality.components == 3
    ball = (lambda r: 4 / 3 * np.pi * r**3) if dim == 3 else (lambda r: np.pi * r**2)
    # A cavity counts negative. Three pieces, each within its surface times h²/(2·radius) or so: 5 % at radius 0.25.
    assert surface.quality.volume == pytest.approx(ball(1) - ball(0.4) + ball(0.25), rel=0.02)
    if isinstance(surface, Polygons):
        areas = sorted(Polygons([ring]).volume for ring in surface.rings)
        assert areas == pytest.approx([-ball(0.4), ball(0.25), ball(1)], rel=0.02)


def test_linear_field_is_exact_on_an_uneven_grid() -> None:
    """A cuboid's corner cut by a plane: the plane of a linear field is met exactly."""
    grid = uneven(1, (9, 8, 7))
    x, y, z = grid.axes
    middle = 0.5 * (x[3] + x[4])
    field = np.full(grid.shape, -1.0)
    field[1:-1, 1:-1, 1:-1] = np.minimum(1.0, middle - x)[1:-1, None, None]
    mesh = extract_surface(field, grid, level=0.0)
    cap = mesh.vertices[(mesh.vertices[:, 0] > x[3]) & (mesh.vertices[:, 1] > y[1]) & (mesh.vertices[:, 1] < y[-2])]
    cap = cap[(cap[:, 2] > z[1]) & (cap[:, 2] < z[-2])]
    assert len(cap)
    # Vertices come in float32 index units: 6e-8 of 9 samples up to 1.5 apart.
    np.testing.assert_allclose(cap[:, 0], middle, rtol=0, atol=6e-8 * 9 * 1.5 * 2)


def test_polygon_corners_are_float64() -> None:
    grid = uneven(2, (6, 7))
    field = np.full(grid.shape, -1.0)
    field[2, 3] = 2.0
    (ring,) = extract_surface(field, grid, level=0.0).rings
    (x, y), (i, j) = grid.axes, (2, 3)
    expected = {
        (x[i] - (x[i] - x[i - 1]) * 2 / 3, y[j]),
        (x[i] + (x[i + 1] - x[i]) * 2 / 3, y[j]),
        (x[i], y[j] - (y[j] - y[j - 1]) * 2 / 3),
        (x[i], y[j] + (y[j + 1] - y[j]) * 2 / 3),
    }
    np.testing.assert_allclose(sorted(map(tuple, ring)), sorted(expected), rtol=8 * np.finfo(float).eps)


@pytest.mark.parametrize("factor", [1e-30, 1e30, 1e300])
def test_scale_of_the_field_does_not_matter(factor: float) -> None:
    field, grid = band_limited(2, (16, 15, 14)), uneven(2, (16, 15, 14))
    plain, scaled = extract_surface(field, grid, 0.0), extract_surface(factor * field, grid, 0.0)
    assert np.array_equal(plain.faces, scaled.faces)
    # Values are rounded to float32 after different roundings to float64: one more float32 step in index units.
    np.testing.assert_allclose(plain.vertices, scaled.vertices, rtol=0, atol=16 * 1.5 * 2**-22)


@pytest.mark.parametrize("dtype", ["float32", "float64", "int16", "bool"])
def test_dtypes(dtype: str) -> None:
    field = np.zeros((6, 7, 8), dtype=dtype)
    field[2:4, 2:5, 2:6] = 1
    surface = extract_surface(field, Grid(Box((6, 7, 8)), field.shape))
    # Half-way faces of a 2 × 3 × 4 block, its edges and corners bevelled away: Minkowski sum with an octahedron of 1/2.
    inner, faces, edges = 1 * 2 * 3, 2 * (1 * 2 + 2 * 3 + 3 * 1), 4 * (1 + 2 + 3)
    exact = inner + faces * 0.5 + edges * 0.125 + (4 / 3) * 0.5**3
    assert surface.volume == pytest.approx(exact, rel=1e-6)  # float32 vertices


GRID = Grid(Box((1.0, 1.0, 1.0)), 4)
SPOT = np.zeros((4, 4, 4))
SPOT[1, 1, 1] = 1


def with_value(value: float, *index: int) -> Field:
    field = SPOT.copy()
    field[index] = value
    return field


@pytest.mark.parametrize(
    ("field", "grid", "level", "error", "message"),
    [
        (SPOT, GRID, 1.0, SurfaceError, r"field: spans \[0, 1\] and does not cross 1"),
        (SPOT, GRID, -0.5, SurfaceError, "does not cross -0.5"),
        (with_value(0.6, 0, 2, 1), GRID, 0.5, SurfaceError, r"at index \(0, 2, 1\), on the lower wall of axis 0"),
        (with_value(0.6, 2, 1, 3), GRID, 0.5, SurfaceError, r"at index \(2, 1, 3\), on the upper wall of axis 2"),
        (with_value(np.nan, 2, 1, 3), GRID, 0.5, NonFiniteError, r"field: is nan at index \(2, 1, 3\)"),
        (with_value(np.inf, 1, 1, 2), GRID, 0.5, NonFiniteError, r"field: is inf at index \(1, 1, 2\)"),
        (SPOT[None], GRID, 0.5, ShapeError, r"field: has shape \(1, 4, 4, 4\)"),
        (SPOT[0], GRID, 0.5, ShapeError, r"field: has shape \(4, 4\)"),
        (SPOT * 1j, GRID, 0.5, DtypeError, "field: has dtype complex128"),
        (SPOT, Box((1, 1, 1)), 0.5, DtypeError, "grid: is a Box"),
        (SPOT, GRID, np.nan, NonFiniteError, "level: is nan"),
        (SPOT, GRID, [0.5, 0.6], ArgumentError, r"level: has shape \(2,\)"),
        (SPOT, GRID, "half", DtypeError, "level: has dtype"),
        ([[0.0], [1.0], [0.0]], Grid(Box((1, 1)), (3, 1)), 0.5, SurfaceError, "on the lower wall of axis 1"),
    ],
)
def test_bad_input(field: Any, grid: Any, level: Any, error: type[ShapegenError], message: str) -> None:
    with pytest.raises(error, match=message):
        extract_surface(field, grid, level)
