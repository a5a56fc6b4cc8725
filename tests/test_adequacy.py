"""Adequacy of a training set: leave-one-out errors, the half-wavelength rule, the report and its picture."""

from __future__ import annotations

import json
import warnings
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import Box, FourierLattice, ScatteredNodes, ShapeModel, VoxelGrid
from accel_shapegen.adequacy import AliasingWarning, assess
from accel_shapegen.adequacy_plot import draw_adequacy

LATTICE = FourierLattice(Box((3.0, 3.0)), (9, 6))


def rectangles(knots: tuple[np.ndarray, ...]) -> list[VoxelGrid]:
    return [VoxelGrid(np.ones((1, 1)), Box((float(a), float(b)))) for a, b in product(*knots)]


def random_model(counts: tuple[int, ...], rng: np.random.Generator, nodes=LATTICE, **options) -> ShapeModel:
    knots = [np.sort(rng.uniform(0, 1, n)) + np.arange(n) for n in counts]
    u = rng.normal(size=(*counts, *nodes.shape, 2)).view(np.complex128)[..., 0]
    return ShapeModel.fit(knots, u, nodes, **options)


@pytest.mark.parametrize("boundary", ["natural", "not-a-knot", "clamped"])
@pytest.mark.parametrize("counts", [(5, 3), (4, 10), (3, 2)])
def test_leave_one_out_is_a_refit_without_the_bodies(counts, boundary: str, rng: np.random.Generator) -> None:
    """The error of every left-out body, knot by knot, against models that were really fitted without them."""
    model = random_model(counts, rng, boundary=boundary)
    u = model.predict(model.grid_points).reshape(*counts, *LATTICE.shape)
    report = assess(model)
    assert report.faces is None
    for j, axis in enumerate(report.axes):
        assert axis.name == f"lambda_{j + 1}"
        expected = []
        for left in range(1, counts[j] - 1):
            knots = list(model.knots)
            knots[j] = np.delete(knots[j], left)
            rest = ShapeModel.fit(knots, np.delete(u, left, axis=j), LATTICE, boundary=boundary)
            at = [np.array([model.knots[j][left]]) if m == j else k for m, k in enumerate(model.knots)]
            queries = np.array(list(product(*at)))
            true = np.take(u, [left], axis=j).reshape(-1, *LATTICE.shape)
            expected.append(asg.metrics.far_field_error(rest.predict(queries), true, LATTICE))
        assert axis.errors.shape == (counts[j] - 2, np.prod(counts) // counts[j])
        np.testing.assert_allclose(axis.errors, np.reshape(expected, axis.errors.shape), rtol=1e-10)
        np.testing.assert_array_equal(axis.knots, model.knots[j][1:-1])
        if axis.errors.size:
            assert axis.worst == axis.errors.max()
            assert axis.typical == pytest.approx(np.sqrt(np.mean(axis.errors**2)), rel=1e-12)
            assert axis.worst_at in [tuple(point) for point in model.grid_points.tolist()]
        else:
            assert np.isnan(axis.worst)
            assert axis.worst_at == ()


def test_the_worst_body_is_named(rng: np.random.Generator) -> None:
    knots = (np.arange(5.0), 10 + np.arange(4.0))
    u = np.ones((5, 4, *LATTICE.shape), dtype="complex128")
    u[2, 1] = 3
    report = assess(ShapeModel.fit(knots, u, LATTICE, names=["a", "b"]))
    assert report.axes[0].worst_at == (1.0, 11.0) or report.axes[0].worst_at == (3.0, 11.0)
    lone = assess(ShapeModel.fit([knots[0]], u[:, 1], LATTICE))
    assert len(lone.axes[0].worst_at) == 1
    assert lone.axes[0].errors.shape == (3, 1)


def test_bands_split_the_error_by_wavenumber() -> None:
    """Data linear in λ, but for a kink in the nodes of one band: only that band has an error, and it is the kink's."""
    kink = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    size = LATTICE.wavenumbers
    edges = np.linspace(0, size.max(), 9)
    in_band = (size >= edges[3]) & (size < edges[4])
    in_band[LATTICE.zero_slot] = False
    u = np.ones((5, *LATTICE.shape), dtype="complex128")
    u[:, in_band] += kink[:, None]
    u[:, *LATTICE.zero_slot] = 1e9 * kink
    report = assess(ShapeModel.fit([np.arange(5.0)], u, LATTICE))
    np.testing.assert_allclose(report.band_edges, edges, rtol=1e-14)
    bands = report.axes[0].bands
    assert np.all(bands[[0, 1, 2, 4, 5, 6, 7]] < 1e-12)
    assert 0.3 < bands[3] < 1
    inside, total = np.count_nonzero(in_band), np.count_nonzero(size > 0) - 1
    energy = inside * (4 + 4) / (inside * (4 + 4) + (total - inside) * 5)
    assert report.band_energy[3] == pytest.approx(energy, rel=1e-12)
    assert report.band_energy.sum() == pytest.approx(1.0, rel=1e-12)


def test_smooth_data_have_small_errors_that_fall_with_the_spacing() -> None:
    """sin λ, knots twice as dense: away from the ends, where S'' = 0 is wrong, the error falls by about 2⁴."""
    errors = []
    for count in (9, 17):
        knots = np.linspace(0, np.pi, count)  # sin'' is 0 at both ends, so that natural ends are right
        u = np.sin(knots)[:, None, None] * np.ones(LATTICE.shape)
        errors.append(assess(ShapeModel.fit([knots], u.astype(complex), LATTICE)).axes[0].typical)
    assert 12 < errors[0] / errors[1] < 20


def test_faces_that_move_too_far_are_warned_of() -> None:
    """Sides from 1 to 2 m: faces move by an eighth of a metre; half a wavelength is 3/18 and 3/12 m."""
    knots = (np.array([1.0, 1.25, 2.0]), np.linspace(1, 2, 5))
    model = ShapeModel.fit_bodies(knots, rectangles(knots), LATTICE, names=["a", "b"])
    with pytest.warns(
        AliasingWarning, match=r"a: between \(a=1\.25, b=1\) and \(a=2, b=1\) .* 0\.375 m on axis 0, .*0\.167"
    ):
        report = model.adequacy()
    assert len(report.warnings) == 1
    faces = {(face.name, face.axis): face for face in report.faces or ()}
    assert set(faces) == {("a", 0), ("a", 1), ("b", 0), ("b", 1)}
    assert faces["a", 0].move == pytest.approx(0.375, rel=1e-12)
    assert faces["a", 0].limit == pytest.approx(3 / 18, rel=1e-12)
    assert faces["a", 0].between == ((1.25, 1.0), (2.0, 1.0))
    assert faces["b", 1].move == pytest.approx(0.125, rel=1e-12)
    assert faces["b", 1].limit == pytest.approx(3 / 12, rel=1e-12)
    assert faces["a", 1].move == faces["b", 0].move == 0
    assert [face.exceeds for face in faces.values()] == [True, False, False, False]


def test_in_a_frame_the_faces_stand_still() -> None:
    knots = (np.array([1.0, 1.25, 2.0]), np.linspace(1, 2, 10))
    model = ShapeModel.fit_bodies(knots, rectangles(knots), LATTICE, frame="bbox", dtype="complex128")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = model.adequacy()
    assert report.framed
    assert max(face.move for face in report.faces or ()) < 1e-12
    assert max(axis.worst for axis in report.axes) < 1e-12
    assert "of the frame" not in str(report)


def test_given_bounds_scattered_nodes_and_empty_bodies(rng: np.random.Generator) -> None:
    nodes = ScatteredNodes([[1.0, 0.0], [0.6, 0.8], [0.0, 1.0]], [2.0, 5.0, 3.0])
    bounds = np.array([[[-1, -1], [1, 1]], [[-1, -1.5], [2, 1]], [[np.nan] * 2] * 2, [[-1, -1], [1, 1]]])
    u = rng.normal(size=(4, 3)).astype(complex)
    report = assess(ShapeModel.fit([np.arange(4.0)], u, nodes, bounds=bounds))
    first, second = report.faces or ()
    assert (first.move, second.move) == (1.0, 0.5)
    assert first.limit == pytest.approx(np.pi / 3)
    assert second.limit == pytest.approx(np.pi / 4)
    assert first.between == ((0.0,), (1.0,))
    only_empty = assess(ShapeModel.fit([np.arange(2.0)], u[:2], nodes, bounds=np.full((2, 2, 2), np.nan)))
    assert np.isnan((only_empty.faces or ())[0].move)
    assert not only_empty.warnings
    json.dumps(only_empty.to_dict(), allow_nan=False)


def test_a_body_without_far_field_has_no_finite_error() -> None:
    u = np.ones((4, *LATTICE.shape), dtype=complex)
    u[1] = 0
    report = assess(ShapeModel.fit([np.arange(4.0)], u, LATTICE))
    assert report.axes[0].worst == np.inf
    json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.parametrize("counts", [(5, 3), (3, 2)])
def test_the_report_reads_and_goes_to_json(counts, rng: np.random.Generator, tmp_path: Path) -> None:
    report = random_model(counts, rng).adequacy()
    text = str(report)
    assert "lambda_1: " in text
    assert "not checked" in text
    assert ("none can be left out" in text) == (2 in counts)
    told = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert told["faces"] is None
    assert len(told["leave_one_out"][0]["errors"]) == counts[0] - 2
    assert told["leave_one_out"][0]["bands"] == pytest.approx(report.axes[0].bands.tolist())


def test_a_loaded_model_has_the_same_adequacy(tmp_path: Path) -> None:
    knots = (np.linspace(1, 2, 3), np.linspace(1, 2, 10))
    model = ShapeModel.fit_bodies(knots, rectangles(knots), LATTICE)
    again = ShapeModel.load(model.save(tmp_path / "m.npz"))
    assert assess(again).to_dict() == assess(model).to_dict()


@pytest.mark.parametrize("frame", [None, "bbox"])
def test_the_picture(frame, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    knots = (np.array([1.0, 1.25, 2.0]), np.linspace(1, 2, 5))
    model = ShapeModel.fit_bodies(knots, rectangles(knots), LATTICE, frame=frame, names=["width", "depth"])
    path = draw_adequacy(tmp_path / "adequacy.png", assess(model))
    pixels = imread(path)
    assert pixels.shape[1] > 1500
    assert len(np.unique(pixels.reshape(-1, pixels.shape[-1]), axis=0)) > 50
    assert draw_adequacy(
        tmp_path / "a.svg", assess(ShapeModel.fit([[0, 1]], np.ones((2, *LATTICE.shape), complex), LATTICE))
    ).is_file()
