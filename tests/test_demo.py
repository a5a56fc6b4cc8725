"""The demo, small by default and as a user gets it when slow tests are asked for."""

from __future__ import annotations

import functools
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import cli, demo, shading
from accel_shapegen.errors import MissingDependencyError, QueryRangeError
from accel_shapegen.progress import Progress

SMALL: dict[str, Any] = {
    "heights": (1.5, 1.7),
    "weights": (0.6, 1.4),
    "held_out": ((1.55, 1.2), (1.65, 0.8)),
    "morph": 3,
    "order": 5,
    "voxels": 40,
    "cells": 24,
}
BOX = asg.Box((2.2, 2.2, 2.2))
FIGURES = {"height", "rw", "iou", "far_field_relative_error", "height_error_m", "volume_relative_error"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("demo") / "out" / "demo"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shading, "SUPERSAMPLING", 1)  # a quarter of the time, for a coarser outline
        return folder, demo.run_demo(folder, **SMALL)


def test_results_are_what_is_returned_and_promised(made: tuple[Path, dict[str, Any]]) -> None:
    folder, results = made
    assert json.loads((folder / "results.json").read_text()) == results
    assert [set(body) for body in results["bodies"]] == [FIGURES, FIGURES]
    assert [(body["height"], body["rw"]) for body in results["bodies"]] == list(SMALL["held_out"])
    assert results["device"] == asg.backends.get(operation="tensor_transform").info.label
    assert sorted(path.name for path in folder.iterdir()) == sorted([*results["files"], "results.json"])


def test_figures_follow_from_the_saved_model(made: tuple[Path, dict[str, Any]]) -> None:
    # The same figures, reckoned here from model.npz with the oracle: what differs is float32 and float64.
    folder, results = made
    model = asg.ShapeModel.load(folder / "model.npz", backend="reference")
    assert model.names == ("height", "rw")
    grid, fine = asg.Grid(BOX, 24), asg.Grid(BOX, 40)
    for body in results["bodies"]:
        query = (body["height"], body["rw"])
        exact = asg.bodies.human(*query)
        inside = model.generate(query, grid) > 0.5
        truth = asg.voxelize(exact, grid).values
        # A cell within rounding of 1/2 may fall on either side.
        assert body["iou"] == pytest.approx((inside & truth).sum() / (inside | truth).sum(), abs=2 / truth.sum())
        u = asg.far_field(asg.voxelize(exact, fine), model.nodes, dtype="complex128", backend="reference")
        off_centre = np.ones(model.nodes.shape, dtype=bool)
        off_centre[5, 5, 5] = False
        error = np.linalg.norm((model.predict(query) - u)[off_centre]) / np.linalg.norm(u[off_centre])
        # Both operations are held to 2e-6 in float32; the error itself is some 0.1.
        assert body["far_field_relative_error"] == pytest.approx(error, abs=4e-6)


def test_surfaces_are_those_of_the_model(made: tuple[Path, dict[str, Any]]) -> None:
    folder, results = made
    model = asg.ShapeModel.load(folder / "model.npz")
    for body in results["bodies"]:
        query = (body["height"], body["rw"])
        stem = f"height_{query[0]:.3f}_rw_{query[1]:.3f}.ply"
        surface, exact = asg.bodies.load(folder / f"predicted_{stem}"), asg.bodies.load(folder / f"exact_{stem}")
        grid = asg.Grid(BOX, 24)
        expected = asg.extract_surface(model.generate(query, grid), grid)
        assert isinstance(surface, asg.TriangleMesh)
        # PLY holds float32: half an ulp at 1 m is 6e-8.
        assert surface.bounds == pytest.approx(expected.bounds, abs=1e-7)
        assert body["height_error_m"] == pytest.approx(np.ptp(surface.bounds[:, 2]) - query[0], abs=2e-7)
        error = abs(surface.volume - exact.volume) / exact.volume
        assert body["volume_relative_error"] == pytest.approx(error, abs=1e-5)
        assert np.ptp(exact.bounds[:, 2]) == pytest.approx(query[0], abs=2e-7)


def test_a_loaded_model_answers_with_the_same_bits(made: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder, _ = made
    model = asg.ShapeModel.load(folder / "model.npz")
    again = asg.ShapeModel.load(model.save(tmp_path / "again.npz"))
    queries = [[1.55, 1.2], [1.5, 0.6], [1.69, 1.39]]
    assert model.predict(queries).tobytes() == again.predict(queries).tobytes()
    # At a training point, cardinal splines give back the generator itself.
    body = asg.voxelize(asg.bodies.human(1.5, 1.4), asg.Grid(BOX, 40))
    plan = asg.plan_far_field(asg.Grid(BOX, 40), model.nodes)
    assert np.array_equal(model.predict((1.5, 1.4)), plan.apply(body.values))


def test_the_morph_stands_in_a_row_on_the_ground_with_y_up(made: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = made
    row = asg.bodies.load(folder / "morph.glb")
    model, grid = asg.ShapeModel.load(folder / "model.npz"), asg.Grid(BOX, 24)
    fields = model.generate([[1.55, 1.2], [1.6, 1.0], [1.65, 0.8]], grid)
    surfaces = [asg.extract_surface(field, grid) for field in fields]
    widths, _, heights = np.transpose([np.ptp(surface.bounds, axis=0) for surface in surfaces])
    assert isinstance(row, asg.TriangleMesh)
    assert len(row.faces) == sum(len(surface.faces) for surface in surfaces)
    # glTF holds float32, and Λ half way is reckoned here by other roundings.
    assert row.bounds[:, 0] == pytest.approx([0, widths.sum() + 0.2], abs=1e-6)
    assert row.bounds[:, 1] == pytest.approx([0, heights.max()], abs=1e-6)
    assert row.volume == pytest.approx(sum(surface.volume for surface in surfaces), rel=1e-5)
    # The front of a body, at -y, looks towards +z, where a glTF viewer stands.
    fronts, backs = np.transpose([surface.bounds[:, 1] for surface in surfaces])
    assert row.bounds[:, 2] == pytest.approx([-backs.max(), -fronts.min()], abs=1e-6)


def test_the_picture_shows_bodies(made: tuple[Path, dict[str, Any]]) -> None:
    from matplotlib.image import imread

    image = imread(made[0] / "demo.png")[..., :3]
    assert image.shape[1] == 2400
    red, _, blue = np.moveaxis(image, -1, 0)
    # Exact bodies are warm, predicted ones cold; two rows of six views and a strip of three.
    assert np.mean(red > blue + 0.15) > 0.01
    assert np.mean(blue > red + 0.15) > 0.02


def test_another_run_gives_the_same_figures_and_replaces_the_files(
    made: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    for _ in range(2):
        results = demo.run_demo(tmp_path, **SMALL, picture=False)
        assert results["bodies"] == made[1]["bodies"]
    assert (tmp_path / "model.npz").read_bytes() == (made[0] / "model.npz").read_bytes()
    assert "demo.png" not in results["files"]


def test_stages_are_shown_and_timed(tmp_path: Path) -> None:
    with Progress(io.StringIO()) as progress:
        results = demo.run_demo(tmp_path, **SMALL, picture=False, progress=progress)
    stages = ["training bodies", "fit", "held-out bodies", "morph", "exact bodies", "meshes"]
    assert list(progress.seconds) == list(results["stages"]) == stages
    assert 0 < sum(results["stages"].values()) <= results["seconds"] + 0.001 * len(stages)


def test_the_picture_needs_matplotlib_and_says_so_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependencyError, match="plot"):
        demo.run_demo(tmp_path / "out", **SMALL)
    assert not (tmp_path / "out").exists()
    assert demo.run_demo(tmp_path / "out", **SMALL, picture=False)["bodies"]


def test_a_held_out_body_must_lie_within_the_training_grid(tmp_path: Path) -> None:
    with pytest.raises(QueryRangeError, match=r"height 1\.75"):
        demo.run_demo(tmp_path, **{**SMALL, "held_out": ((1.55, 1.2), (1.75, 1.0))}, picture=False)


def test_the_verb_prints_a_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(demo, "run_demo", functools.partial(demo.run_demo, **SMALL))
    assert cli.main(["demo", "--out", str(tmp_path), "--no-picture", "--backend", "reference"]) == 0
    output, errors = capsys.readouterr()
    assert errors == ""
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["device"].startswith("reference: ")
    for body in results["bodies"]:
        shown = [f"{body['height']:.2f} m", f"{body['rw']:.2f}", f"{body['iou']:.3f}"]
        assert any(all(text in line for text in shown) for line in output.splitlines())
    assert results["device"] in output
    assert str(tmp_path) in output.replace("\n", "")


def test_the_verb_prints_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(demo, "run_demo", functools.partial(demo.run_demo, **SMALL))
    assert cli.main(["demo", "--out", str(tmp_path), "--no-picture", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "results.json").read_text())


@pytest.mark.slow
def test_the_demo_as_a_user_gets_it(tmp_path: Path) -> None:
    assert cli.main(["demo", "--out", str(tmp_path / "demo")]) == 0
    results = json.loads((tmp_path / "demo" / "results.json").read_text())
    assert [(body["height"], body["rw"]) for body in results["bodies"]] == [(1.55, 1.3), (1.85, 1.1)]
    for body in results["bodies"]:
        assert body["iou"] >= 0.91
        assert body["far_field_relative_error"] <= 0.055
        # A cell is 22 mm: the surface ends within one of where the body does.
        assert abs(body["height_error_m"]) <= 0.022
    assert (tmp_path / "demo" / "demo.png").stat().st_size > 100_000
