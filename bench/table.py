"""The report as a table: rich on a terminal, Markdown in a file."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from .timing import LEAST_ROUNDS

COLUMNS = ("contender", "batch", "time", "5-95 %", "to best OpenCL", "error", "write", "copy", "GEMM")

FILE_WIDTH = 180  # of a table that goes to a file or a pipe, where nothing limits it

Report = dict[str, Any]
Record = dict[str, Any]

LEGEND = (
    "Times are medians and 5-95 % of the rounds. The ratio is time over the best OpenCL contender's, from the "
    "rounds that both ran in, claimed only where its 5-95 % band excludes 1. The error is relative L2 against float64. "
    "write, copy, GEMM: the fraction of this machine's ceiling that was reached - streaming out one output, moving "
    "input and output once at copy bandwidth, and the sum as plain matrix products at the BLAS's rate (a way that "
    "needs less arithmetic than those can exceed 100 %)."
)


def show(report: Report) -> None:
    """Print all tables, ceilings and skipped contenders."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if not console.is_terminal:
        console.width = FILE_WIDTH
    for title, records in _groups(report):
        table = Table(*COLUMNS, title=title, title_justify="left")
        for column in table.columns[1:]:
            column.justify = "right"
        for record in records:
            table.add_row(*_row(record), style="bold" if record["best_opencl"] else None)
        console.print(table)
    for line in [*_ceilings(report), *_skipped(report)]:
        console.print(line, highlight=False, markup=False)


def markdown(report: Report) -> str:
    """The same as Markdown, with the machine it was measured on."""
    lines = ["# Benchmarks", "", *(f"- {line}" for line in _machine(report["machine"])), "", LEGEND]
    for title, records in _groups(report):
        lines += ["", f"## {title}", "", f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
        lines += [f"| {' | '.join(_row(record))} |" for record in records]
    lines += ["", "## Ceilings", "", *(f"- {line}" for line in _ceilings(report))]
    if report["skipped"]:
        lines += ["", "## Left out", "", *(f"- {line}" for line in _skipped(report))]
    return "\n".join(lines) + "\n"


def _groups(report: Report) -> Iterator[tuple[str, list[Record]]]:
    for (case, detail, dtype, per), group in groupby(
        report["records"], key=lambda r: (r["case"], r["detail"], r["dtype"], r["per"])
    ):
        yield f"{case}: {detail}, {dtype}, per {per}", sorted(group, key=lambda record: record["median_s"])


def _row(record: Record) -> tuple[str, ...]:
    fractions = record["fraction_of_ceilings"]
    eps = "" if record["eps"] is None else f" (asked {record['eps']:.0e})"
    return (
        record["contender"],
        str(record["batch"]),
        duration(record["median_s"]),
        f"{duration(record['p5_s'])} .. {duration(record['p95_s'])}",
        _ratio(record),
        f"{record['error']:.1e}{eps}",
        *("" if fractions[name] is None else f"{100 * fractions[name]:.0f} %" for name in ("write", "copy", "gemm")),
    )


def _ratio(record: Record) -> str:
    ratio = record["ratio_to_best_opencl"]
    if ratio is None:
        return "no OpenCL"
    if record["best_opencl"]:
        return "best"
    if not ratio["pairs"] >= LEAST_ROUNDS:
        return "too few rounds"
    band = f"{ratio['p5']:.2f} .. {ratio['p95']:.2f}"
    return f"{ratio['median']:.2f} ({band})" if ratio["claimed"] else f"none claimed ({band})"


def duration(seconds: float) -> str:
    """Three figures in a unit that suits."""
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * factor >= 1:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _ceilings(report: Report) -> list[str]:
    limits = report["ceilings"]
    lines = [
        f"GEMM of NumPy's BLAS, {d}: {limits[f'gemm_{d}_flop_per_s'] / 1e9:.1f} GFLOP/s" for d in ("float32", "float64")
    ]
    lines.append(f"copy: {limits['copy_bytes_per_s'] / 1e9:.1f} GB/s each way")
    lines += [f"streaming write of one output, {name}: {duration(t)}" for name, t in limits["stream_write_s"].items()]
    return lines


def _skipped(report: Report) -> list[str]:
    return [f"left out: {skip['contender']} of {skip['case']}: {skip['reason']}" for skip in report["skipped"]]


def _machine(machine: dict[str, Any]) -> list[str]:
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items() if version)
    return [
        f"CPU: {machine['cpu']}, {machine['threads']} threads, load {machine['load_average']} at the start",
        f"Python {machine['python']}, {versions}",
        f"BLAS: {'; '.join(machine['blas'] or ['unknown (threadpoolctl is not installed)'])}",
        *(f"Device: {d['label']}, {d['platform']}, {d['units']} compute units" for d in machine["devices"]),
    ]
