"""The paper's experiments, each at a reduced size, and the page and numbers they leave behind."""

from __future__ import annotations

import base64
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import cli
from accel_shapegen.errors import ArgumentError
from accel_shapegen.experiments import cuboid, human, kite, kite_fem, multi_domain, reproduction, stability, trial
from accel_shapegen.experiments.page import Figure, Section, Table, write_page
from accel_shapegen.progress import Progress
from accel_shapegen.testing import box_transform

PLANE = {"order": 8, "cells": 100, "segments": 64}


def run(name: str, folder: Path, **sizes: Any) -> dict[str, Any]:
    results = reproduction.run(name, folder, sizes={name: sizes})
    assert json.loads((folder / "results.json").read_text(encoding="utf-8")) == results
    page = (folder / "index.html").read_text(encoding="utf-8")
    sources = re.findall(r'<img src="([^"]{0,30})', page)
    assert len(sources) == len(results["files"]) - 1
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    return results["experiments"][name]


def require_plausible(record: dict[str, Any], queries: int, least: float) -> None:
    assert len(record["queries"]) == queries
    for query in record["queries"]:
        assert least < query["iou"] <= 1 and least < query["iou_truncation"] <= 1
        assert 0 < query["far_field_relative_error"] < 0.5
        assert 0 < query["hausdorff_m"] < 0.6
        assert [entry["delta"] for entry in query["noise"]] == [0.01, 0.05, 0.2]
        errors = [entry["far_field_relative_error"] for entry in query["noise"]]
        # Noise of 20 % adds to whatever the spline does wrong.
        assert errors[2] > errors[0]


def test_kites(tmp_path: Path) -> None:
    record = run("kite", tmp_path, values=7, **PLANE)
    require_plausible(record["paper"], 4, 0.93)
    require_plausible(record["ours"], 4, 0.95)
    # All kites are one in the frames of their bounding boxes, to the rounding of complex64 through the spline.
    assert max(query["far_field_relative_error"] for query in record["ours"]["queries"]) < 1e-5


def test_multi_domain(tmp_path: Path) -> None:
    record = run("multi-domain", tmp_path, values=6, **PLANE)
    require_plausible(record["paper"], 4, 0.75)
    require_plausible(record["ours"], 4, 0.8)
    for paper, ours in zip(record["paper"]["queries"], record["ours"]["queries"], strict=True):
        assert ours["iou_truncation"] > paper["iou_truncation"]


def test_cuboids(tmp_path: Path) -> None:
    record = run("cuboid", tmp_path, values=4, order=7, cells=32)
    require_plausible(record["paper"], 4, 0.8)
    assert max(query["far_field_relative_error"] for query in record["ours"]["queries"]) < 1e-5
    assert min(query["iou"] for query in record["ours"]["queries"]) > 0.9


def test_humans(tmp_path: Path) -> None:
    settings = [human.paper_setting(11, 48), human.our_setting("ours", (12, 6, 17), (48, 24, 66))]
    record = run("human", tmp_path, values=3, chosen=settings)
    assert set(record) == {"slider", "mass"}
    for kind in record.values():
        require_plausible(kind["paper"], 2, 0.75)
        require_plausible(kind["ours"], 2, 0.8)


def test_stability_slopes(tmp_path: Path) -> None:
    levels = tuple(np.geomspace(0.003, 0.3, 10))
    record = run("stability", tmp_path, deltas=levels, deltas_3d=tuple(np.geomspace(0.01, 0.3, 8)), seeds=2)
    assert len(record["curves"]) == 4
    for curve in record["curves"]:
        expected = 4 / (2 + curve["dim"]) if curve["smooth"] else 2 / (2 + curve["dim"])
        assert math.isclose(curve["rate"], expected)
        assert curve["as_expected"], curve["slope"]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("power", [0, 1, 4])
def test_a_bump_is_what_its_generator_says(dim: int, power: int) -> None:
    # Parseval over a lattice that holds all but a little: Σ|f̂|² |V0| = ‖f‖², and f̂_0 the mean over the box.
    lattice = asg.FourierLattice(asg.Box((3.0,) * dim), 20, mu=1e-4)
    f = asg.fourier_coefficients(stability.bump_generator(power)(lattice), lattice)
    norm = stability.bump_norm(power, dim)
    assert lattice.box.volume * (np.abs(f) ** 2).sum() == pytest.approx(norm, rel=0.03 if power == 0 else 2e-4)
    radial = np.linspace(0, 1, 20001)
    shell = 2 * np.pi * radial if dim == 2 else 4 * np.pi * radial**2
    mass = np.trapezoid((1 - radial**2) ** power * shell, radial)
    # Trapezoid of step 5e-5, and a mean taken from a node at 1e-4 of the first lattice wavenumber.
    assert f[lattice.zero_slot].real * lattice.box.volume == pytest.approx(mass, rel=1e-6)


def test_a_cuboid_of_one_voxel_is_exact() -> None:
    lattice = asg.FourierLattice(asg.Box((3.0,) * 3), 5)
    extents = (1.9, 1.2, 1.4)
    u = asg.far_field(cuboid.exact_body(*extents), lattice, dtype="complex128")
    exact = asg.far_field_constant(lattice.wavenumbers, 3) * box_transform(extents, lattice.kappa)
    assert np.abs(u - exact).max() < 1e-14


def test_the_papers_numbers() -> None:
    kites, pairs, cuboids = kite.family(), multi_domain.family(), cuboid.family()
    assert [len(family.training) for family in (kites, pairs, cuboids)] == [196, 121, 125]
    for family in (kites, pairs, cuboids):
        assert len(family.queries) == 4
        for query in family.queries:
            assert query not in family.training
            assert all(axis[0] <= value <= axis[-1] for axis, value in zip(family.knots, query, strict=True))
    assert kite.paper_setting().lattice.order == (20, 20) and multi_domain.paper_setting().lattice.order == (20, 20)
    assert cuboid.paper_setting().lattice.size == 39**3
    assert [setting.lattice.size for setting in human.settings()] == [39**3, 60329, 291375]


def test_noise_is_on_the_training_generators() -> None:
    family = trial.Family(
        "t", ("a", "b"), ([0.5, 0.9, 1.3], [0.5, 1.0]), [(0.9, 1.0)], asg.bodies.kite, asg.bodies.kite
    )
    lattice = asg.FourierLattice(asg.Box((7.0, 7.0)), 4)
    with Progress() as progress:
        setting = trial.Setting("s", lattice, asg.Grid(lattice.box, 60))
        outcome = trial.run_trial(family, setting, deltas=[0.2], progress=progress)
    record = outcome.predictions[0].record
    # At a training body the prediction is that body: without noise to rounding, with it off by δ/√3 or so.
    assert record["far_field_relative_error"] < 1e-6
    assert 0.05 < record["noise"][0]["far_field_relative_error"] < 0.2


def test_a_page_escapes_what_it_is_given(tmp_path: Path) -> None:
    picture = b"\x89PNG not really"
    (tmp_path / "a.png").write_bytes(picture)
    table = Table("x < y", ["a & b"], [["<script>"]], [("1 > 0", 1)])
    write_page(tmp_path / "p.html", "<t>", ["p<q"], [Section("s<", ["u<"], [table], [Figure("a.png", 'q"')], {})], "<")
    page = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert base64.b64encode(picture).decode() in page
    assert "<script>" not in page and "&lt;script&gt;" in page and 'alt="q&quot;"' in page


def test_an_unknown_experiment_lists_those_there_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ArgumentError, match="'kite', 'multi-domain'"):
        reproduction.run("kites", tmp_path / "out")
    assert cli.main(["reproduce", "kites", "--out", str(tmp_path / "out")]) == 2
    assert "'kite'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_verb_prints_what_it_wrote(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def small(folder: Path, **options: Any) -> Section:
        return kite.run(folder, values=4, **PLANE, **options)

    monkeypatch.setitem(reproduction.EXPERIMENTS, "kite", small)
    assert cli.main(["reproduce", "kite", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert cli.main(["reproduce", "kite", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "0.93, 1.76" in shown and "kite, paper" in shown


def test_all_leaves_out_what_is_only_by_name() -> None:
    assert set(reproduction.ONLY_BY_NAME) == {"kite-fem"} < set(reproduction.EXPERIMENTS)


def test_kites_learned_from_finite_elements(tmp_path: Path) -> None:
    pytest.importorskip("ngsolve", reason='needs ngsolve: pip install "accel-shapegen[fem]"')
    with Progress() as progress:
        record = kite_fem.run(tmp_path, values=2, order=2, cells=50, progress=progress).record
    assert record["training_far_field_relative_error"] < 1e-3
    for query in record["queries"]:
        assert abs(query["iou_elements"] - query["iou_transform"]) < 5e-3


@pytest.mark.slow
def test_kites_and_cuboids_at_the_papers_size(tmp_path: Path) -> None:
    record = run("kite", tmp_path / "kite")
    assert min(query["iou"] for query in record["paper"]["queries"]) >= 0.993
    assert max(query["far_field_relative_error"] for query in record["ours"]["queries"]) <= 1e-5
    record = run("cuboid", tmp_path / "cuboid")
    assert max(query["far_field_relative_error"] for query in record["ours"]["queries"]) <= 1e-5
    for query in record["paper"]["queries"]:
        # Five knots alias the phase: the paper's setting is no better than this.
        assert 0.89 < query["iou"] < 0.95
        assert query["iou_truncation"] > 0.99
