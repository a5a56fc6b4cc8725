"""Renderings of meshes whose picture is known, and the pictures made of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from accel_shapegen import bodies, report, shading
from accel_shapegen.errors import ArgumentError, DtypeError, MissingDependencyError, NonFiniteError, ShapeError
from accel_shapegen.geometry import Box, Grid, TriangleMesh
from accel_shapegen.surface import extract_surface


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)]
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def moved(mesh: TriangleMesh, *by: float) -> TriangleMesh:
    return TriangleMesh(mesh.vertices + np.array(by), mesh.faces)


def test_a_ball_covers_its_disk() -> None:
    picture = shading.render(moved(bodies.ball(0.5), 0.3, 0, -0.2), 0, pixels_per_metre=200)
    left, right, bottom, top = picture.extent
    rows, columns, _ = picture.image.shape
    assert (right - left, top - bottom) == pytest.approx((columns / 200, rows / 200))
    alpha = picture.image[..., 3]
    # The boundary crosses 2π·0.5·200 pixels; quarter pixels are counted, and their errors average out.
    assert alpha.sum() / 200**2 == pytest.approx(np.pi * 0.25, rel=1e-3)
    x = left + (np.arange(columns) + 0.5) / 200
    z = top - (np.arange(rows) + 0.5) / 200
    assert (alpha.sum(axis=0) @ x, alpha.sum(axis=1) @ z) / alpha.sum() == pytest.approx((0.3, -0.2), abs=1e-4)
    assert picture.image.min() >= 0
    assert picture.image.max() <= 1


@pytest.mark.parametrize(
    ("azimuth", "elevation", "axis", "sign"),
    [(0, 0, 1, -1), (90, 0, 0, 1), (180, 0, 1, 1), (270, 0, 0, -1), (0, 90, 2, 1), (33, -90, 2, -1)],
)
def test_the_viewer_sees_the_side_he_stands_on(azimuth: float, elevation: float, axis: int, sign: int) -> None:
    # Red towards him, blue away: the ball in front hides the one behind.
    shift = np.zeros(3)
    shift[axis] = 2 * sign
    pair = joined(moved(bodies.ball(0.5), *shift), bodies.ball(0.5))
    half = len(pair.vertices) // 2
    colours = np.repeat([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]], half, axis=0)
    image = shading.render(pair, azimuth, pixels_per_metre=60, colour=colours, elevation=elevation).image
    seen = image[..., 3] == 1
    assert np.all(image[seen, 0] > image[seen, 2])


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (37, 0), (-120, 25)])
def test_view_axes_are_a_right_handed_frame(azimuth: float, elevation: float) -> None:
    axes = shading.view_axes(azimuth, elevation)
    # Three products of sines and cosines: a few roundings of numbers up to 1.
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1, abs=1e-15)
    assert axes[1, 2] >= 0


def test_light_comes_from_the_upper_left() -> None:
    image = shading.render(bodies.ball(0.5), 0, pixels_per_metre=100).image
    brightness, rows, columns = image[..., 0], *image.shape[:2]
    upper_left = brightness[rows // 4 : rows // 2, columns // 4 : columns // 2].mean()
    lower_right = brightness[rows // 2 : 3 * rows // 4, columns // 2 : 3 * columns // 4].mean()
    assert upper_left > lower_right + 0.1


def test_what_stands_before_a_wall_darkens_it() -> None:
    wall = moved(bodies.cuboid(2, 0.1, 2), 0, 0.6, 0)
    bare = shading.render(wall, 0, pixels_per_metre=100).image
    with_ball = shading.render(joined(wall, bodies.ball(0.5)), 0, pixels_per_metre=100).image
    middle, beside = bare.shape[0] // 2, bare.shape[1] // 2 + 53
    assert with_ball[middle, beside, 0] < bare[middle, beside, 0] - 0.02
    assert with_ball[5, 5, 0] == bare[5, 5, 0]


def test_many_small_blocks_make_the_same_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = bodies.ellipsoid(0.3, 0.2, 0.5, subdivisions=3)
    whole = shading.render(mesh, 20, pixels_per_metre=80)
    monkeypatch.setattr(shading, "BLOCK", 50)
    assert np.array_equal(shading.render(mesh, 20, pixels_per_metre=80).image, whole.image)


def test_vertices_of_no_triangle_do_not_matter() -> None:
    ball = bodies.ball(0.5, subdivisions=2)
    strewn = TriangleMesh(np.concatenate([ball.vertices, [[9.0, 9, 9]]]), ball.faces)
    plain, odd = (shading.render(mesh, 0, pixels_per_metre=50) for mesh in (ball, strewn))
    assert np.array_equal(plain.image, odd.image)
    assert plain.extent == odd.extent


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"pixels_per_metre": 0}, ArgumentError, "pixels_per_metre"),
        ({"pixels_per_metre": 1e5}, ArgumentError, "pixels_per_metre.*100000"),
        ({"colour": (0.1, 0.2)}, ShapeError, r"colour.*\(2,\)"),
        ({"colour": (0.1, 0.2, 1.2)}, ArgumentError, "colour.*1.2"),
        ({"colour": (0.1, 0.2, np.nan)}, NonFiniteError, "colour"),
    ],
)
def test_bad_input(arguments: dict[str, object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        shading.render(bodies.cuboid(1, 1, 1), 0, **{"pixels_per_metre": 10, **arguments})  # type: ignore[arg-type]


def test_a_body_of_the_plane_is_refused() -> None:
    with pytest.raises(DtypeError, match=r"mesh.*Polygons"):
        shading.render(bodies.disk(1), 0, pixels_per_metre=10)  # type: ignore[arg-type]


@pytest.mark.parametrize("offset", [0.03, -0.03])
def test_signed_distance_of_parallel_surfaces(offset: float) -> None:
    exact = bodies.ball(0.5, subdivisions=4)
    # Samples are 0.04 apart: tangent planes miss the sphere by (0.02)²/(2·0.5) at most, the mesh by 0.5·1.2e-3.
    assert report.signed_distance(bodies.ball(0.5 + offset, subdivisions=3), exact) == pytest.approx(offset, abs=1e-3)


def test_signed_distance_of_cuboids_is_exact_beside_faces() -> None:
    outer, inner = bodies.cuboid(1.2, 1.2, 1.2), bodies.cuboid(1, 1, 1)
    middles = TriangleMesh(np.concatenate([outer.vertices, [[0, 0, 0.6]]]), outer.faces)
    assert report.signed_distance(middles, inner)[-1] == pytest.approx(0.1, abs=1e-15)


def test_pictures_are_files_that_show_something(tmp_path: Path) -> None:
    from matplotlib.image import imread

    grid = Grid(Box((2.0, 2.0)), 40)
    field = np.exp(-((grid.points() / 0.5) ** 2).sum(axis=-1))
    region = extract_surface(field, grid)
    ball, egg = bodies.ball(0.5, subdivisions=3), bodies.ellipsoid(0.5, 0.5, 0.6, subdivisions=3)
    comparison = report.Comparison("a ball", ["IoU 0.9"], ball, egg)
    report.draw_region(tmp_path / "region.png", "a hill [m]", field, grid, region)  # type: ignore[arg-type]
    report.draw_body(tmp_path / "body.png", "an egg", egg, dpi=40)
    counts: list[tuple[int, int]] = []
    morph = [("0", ball), ("1", egg)]
    report.draw_comparison(
        tmp_path / "with.png", "balls", "a note", [comparison], morph, dpi=40, progress=lambda *n: counts.append(n)
    )
    assert counts == [(view, 8) for view in range(1, 9)]
    report.draw_comparison(tmp_path / "without.png", "balls", "a note", [comparison, comparison], [], dpi=40)
    for name in ("region", "body", "with", "without"):
        image = imread(tmp_path / f"{name}.png")[..., :3]
        # More than paper and a line: a tenth of the pixels at least are of another colour than the corner.
        assert np.mean(np.abs(image - image[0, 0]).max(axis=-1) > 0.02) > 0.1, name


def test_without_matplotlib_the_error_is_the_command_that_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "accel-shapegen\[plot\]"'):
        report.require_matplotlib()
