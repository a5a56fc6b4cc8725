"""The benchmarks run, compute the right thing and report it in full; no time is looked at."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accel_shapegen import backends

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # bench is run from the checkout and never installed

from bench.__main__ import main  # noqa: E402
from bench.contest import Case, Contender, Run, Skipped, Work, aligned_zeros  # noqa: E402
from bench.run import ACCURACY_SLACK, WRONG, Entry, contest, enter  # noqa: E402
from bench.table import duration  # noqa: E402
from bench.timing import LEAST_ROUNDS, Ratio, interleave, strides  # noqa: E402

RIVALS = {
    "synthesis": {"numpy-separable", "scipy-irfftn", "scipy-irfft-pruned", "finufft-type2"},
    "lattice_far_field": {"numpy-separable", "scipy-rfftn", "scipy-rfft-pruned", "finufft-type1"},
    "mesh_far_field": {"finufft-type1, one component", "finufft-type1, three components"},
    "scattered_far_field": {"finufft-type2", "finufft-type3"},
    "spline": {"numpy-gemm", "scipy-cubicspline", "scipy-ndbspline"},
}
BODIES = {"synthesis": 1, "lattice_far_field": 1, "mesh_far_field": 1, "scattered_far_field": 3, "spline": 1}

# Sums to rounding: products of a few hundred terms and the cancellation of a mean-free body's projection.
ROUNDING = 50
# The package's own promise for scattered nodes.
OWN_EPS = 3

Report = dict[str, Any]


def bench(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bench", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where one quick run of all cases in both precisions left its files and what it printed."""
    folder = tmp_path_factory.mktemp("bench")
    precisions = ("--dtype", "float32", "--dtype", "float64")
    done = bench("--case", "all", "--quick", *precisions, "--json", folder / "report.json", "--out-dir", folder / "out")
    assert done.returncode == 0, done.stdout + done.stderr
    (folder / "printed").write_text(done.stdout, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def report(folder: Path) -> Report:
    loaded: Report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return loaded


def is_number(value: Any, *, least: float = 0.0) -> bool:
    return isinstance(value, float) and math.isfinite(value) and value >= least


@pytest.mark.parametrize("case", RIVALS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_every_contender_takes_part(report: Report, case: str, dtype: str) -> None:
    devices = {info.label for info in backends.available() if info.backend == "opencl" and info.usable}
    assert devices, 'no OpenCL device: pip install "accel-shapegen[pocl]"'
    records = [record for record in report["records"] if (record["case"], record["dtype"]) == (case, dtype)]
    assert {record["contender"] for record in records} == devices | {"reference"} | RIVALS[case]
    assert len(records) == BODIES[case] * (len(devices) + 1 + len(RIVALS[case]))


def test_nothing_is_left_out_in_silence_or_otherwise(report: Report) -> None:
    # Where a contender cannot run in one of two variants, the record says so; none of these may fail in all.
    assert report["skipped"] == []


def test_records_fit_the_schema(report: Report) -> None:
    for record in report["records"]:
        assert record["case"] in RIVALS
        assert isinstance(record["contender"], str) and isinstance(record["batch"], int) and record["batch"] > 0
        assert record["dtype"] in ("float32", "float64")
        assert record["eps"] is None or is_number(record["eps"])
        assert all(isinstance(n, int) for sizes in record["shape"].values() for n in sizes)
        assert all(is_number(record[key]) for key in ("median_s", "p5_s", "p95_s", "error"))
        assert 0 < record["p5_s"] <= record["median_s"] <= record["p95_s"]
        assert record["per"] == ("query" if record["case"] == "spline" else "body")
        assert record["variants"][record["variant"]]["error"] == record["error"]
        assert is_number(record["ratio_to_best_opencl"]["median"])
        # One round decides nothing.
        assert record["repetitions"] == 1 and not record["ratio_to_best_opencl"]["claimed"]


def test_each_table_has_one_best_opencl(report: Report) -> None:
    tables: dict[tuple[str, ...], int] = {}
    for record in report["records"]:
        key = (record["case"], record["detail"], record["dtype"])
        tables[key] = tables.get(key, 0) + record["best_opencl"]
    assert set(tables.values()) == {1}
    assert len(tables) == 2 * sum(BODIES.values())


def test_ceilings_fit_the_schema(report: Report) -> None:
    ceilings = report["ceilings"]
    for name in ("gemm_float32_flop_per_s", "gemm_float64_flop_per_s", "copy_bytes_per_s"):
        assert is_number(ceilings[name], least=1.0)
    assert len(ceilings["stream_write_s"]) == 2 * len(RIVALS)
    assert all(is_number(value) for value in ceilings["stream_write_s"].values())


def test_errors_are_small(report: Report) -> None:
    for record in report["records"]:
        rounding = ROUNDING * np.finfo(record["dtype"]).eps
        slack = OWN_EPS if record["contender"].startswith("opencl") else ACCURACY_SLACK
        bound = rounding if record["eps"] is None else slack * record["eps"]
        assert record["error"] <= bound, (record["case"], record["contender"], record["detail"], record["dtype"])


def test_the_machine_is_described(report: Report) -> None:
    machine = report["machine"]
    assert machine["cpu"] and machine["threads"] > 0 and machine["devices"] and machine["blas"]
    assert machine["versions"].keys() >= {"numpy", "scipy", "finufft", "pyopencl"}


def test_the_report_is_written_and_printed(folder: Path, report: Report) -> None:
    assert json.loads((folder / "out" / "all.json").read_text(encoding="utf-8")) == report
    written = (folder / "out" / "all.md").read_text(encoding="utf-8")
    printed = (folder / "printed").read_text(encoding="utf-8")
    for record in report["records"]:
        title = f"{record['case']}: {record['detail']}, {record['dtype']}, per {record['per']}"
        assert f"## {title}\n" in written and title in printed
        assert f"| {record['contender']} | {record['batch']} |" in written


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--case", "synthesise"], "invalid choice: 'synthesise'"),
        (["--grid", "5,5"], "'5,5' is not one positive number or three"),
        (["--order", "0"], "'0' is not one positive number or three"),
        (["--batch", "2.5"], "'2.5' is not a positive integer"),
        (["--seconds", "nan"], "'nan' is not a positive number"),
        (["--eps", "2"], "'2' exceeds 0.001"),
    ],
)
def test_bad_arguments_are_refused(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert message in capsys.readouterr().err


def test_a_device_that_is_not_there_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    assert main(["--case", "spline", "--quick", "--device", "no such device", "--json", str(path)]) == 0
    report = json.loads(path.read_text(encoding="utf-8"))
    (skip,) = report["skipped"]
    assert skip["contender"] == "opencl" and "no such device" in skip["reason"]
    assert {record["ratio_to_best_opencl"] for record in report["records"]} == {None}


EXACT = np.arange(1.0, 9.0).reshape(2, 4)


def small_case(*contenders: Contender) -> Case:
    """A case whose right output is `EXACT`."""
    out = aligned_zeros(EXACT.shape, np.float64)
    return Case(
        "case", "detail", {"grid": [4]}, 2, "float64", "body", contenders, out,
        lambda result: float(np.abs(result - EXACT[: len(result)]).max()), Work(32, 32),
    )  # fmt: skip


def giving(result: np.ndarray, work: int = 0) -> Callable[[], Run]:
    """A way to set up a run that does some work and returns `result`."""
    return lambda: lambda: (sum(range(work)), result)[1]


def failing() -> Run:
    raise RuntimeError("no licence")


def test_the_fastest_accurate_variant_is_kept() -> None:
    variants = {
        "slow": giving(EXACT, 200_000),
        "fast": giving(EXACT + 1e-9),
        "sloppy": giving(EXACT + 1e-3),
        "broken": failing,
        "wrong": giving(EXACT + 2 * WRONG),
    }
    entry = enter(small_case(), Contender("rival", variants, 2, eps=1e-9))
    assert isinstance(entry, Entry)
    assert entry.variant == "fast" and entry.error == pytest.approx(1e-9, rel=1e-6)
    assert entry.tried["sloppy"]["error"] == pytest.approx(1e-3)
    assert entry.tried["broken"] == {"problem": "RuntimeError: no licence"}
    assert "computes something else" in entry.tried["wrong"]["problem"]


def test_where_none_is_accurate_the_most_accurate_is_kept() -> None:
    variants = {"worse": giving(EXACT + 1e-3), "better": giving(EXACT + 1e-4, 200_000)}
    entry = enter(small_case(), Contender("rival", variants, 2, eps=1e-9))
    assert isinstance(entry, Entry) and entry.variant == "better"


def test_output_that_was_not_written_is_noticed() -> None:
    case = small_case()
    case.out[...] = EXACT  # what an earlier contender left there
    skipped = enter(case, Contender("idle", {"only": lambda: lambda: case.out}, 2))
    assert isinstance(skipped, Skipped) and "nan" in skipped.reason


def test_a_contender_that_cannot_run_is_reported_with_its_reason() -> None:
    case = small_case(
        Contender("lame", {"a": failing, "b": failing}, 2), Contender("opencl: x", {"c": giving(EXACT)}, 2)
    )
    result = contest(case, seconds=0.01, quick=True)
    assert result["skipped"] == [{"case": "case", "contender": "lame", "reason": "RuntimeError: no licence"}]
    assert [record["contender"] for record in result["records"]] == ["opencl: x"]


def test_every_contender_gets_its_rounds_and_meets_the_others() -> None:
    # An equal share of 1 s is 0.25 s: 250 and 50 runs, then the least there is.
    rounds, stride = strides([0.001, 0.005, 0.2, 30.0], 1.0)
    assert rounds == 250
    assert stride == [1, 4, 32, 32]
    assert all(len(range(0, rounds, step)) >= LEAST_ROUNDS for step in stride)
    assert strides([0.001, 30.0], 1.0, quick=True) == (1, [1, 1])


def test_the_order_is_rotated() -> None:
    calls: list[str] = []
    samples = interleave([lambda name=name: calls.append(name) for name in "abc"], [1.0] * 3, 0.0)  # type: ignore[misc]
    assert "".join(calls) == "abcbcacab" * 2 + "abc"
    assert [sorted(taken) for taken in samples] == [list(range(LEAST_ROUNDS))] * 3


@pytest.mark.parametrize(
    ("ratios", "claimed"),
    [([2.0] * LEAST_ROUNDS, True), ([0.9, 2.0] * LEAST_ROUNDS, False), ([2.0] * (LEAST_ROUNDS - 1), False)],
)
def test_a_ratio_is_claimed_only_where_its_band_excludes_1(ratios: list[float], claimed: bool) -> None:
    samples = {2 * number: 0.5 * ratio for number, ratio in enumerate(ratios)}
    # Rounds that only the other ran in do not count.
    ratio = Ratio.of(samples, {number: 0.5 for number in range(2 * len(ratios))})
    assert ratio.pairs == len(ratios) and ratio.claimed is claimed
    assert ratio.spread.median == pytest.approx(float(np.median(ratios)))


@pytest.mark.parametrize(
    ("seconds", "text"), [(2.5, "2.5 s"), (0.0123456, "12.3 ms"), (4.2e-5, "42 µs"), (3e-9, "3 ns")]
)
def test_durations_are_readable(seconds: float, text: str) -> None:
    assert duration(seconds) == text
