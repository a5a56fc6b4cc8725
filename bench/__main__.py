"""`python -m bench`: time this package against other libraries on the same sums, in one interleaved run."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from . import machine, table
from .cases import CASES
from .cases.bodies import KINDS
from .contest import Settings
from .run import WRONG, contest

DTYPES = ("float32", "float64")
QUICK_GRID, QUICK_ORDER = (16, 15, 12), (4, 3, 2)
SECONDS = 30.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the asked cases, print tables, write files; 0 unless the arguments make no sense."""
    options = _parser().parse_args(arguments)
    names = list(CASES) if not options.case or "all" in options.case else list(dict.fromkeys(options.case))
    report = run(names, _settings(options), options.dtype or ["float32"], options.seconds)
    table.show(report)
    if options.json:
        _write(options.json, _json(report))
    if options.out_dir:
        name = options.name or (names[0] if len(names) == 1 else "all")
        _write(options.out_dir / f"{name}.json", _json(report))
        _write(options.out_dir / f"{name}.md", table.markdown(report))
    return 0


def run(names: Sequence[str], settings: Settings, dtypes: Sequence[str], seconds: float) -> dict[str, Any]:
    """The report of some cases: {"machine", "settings", "ceilings", "records", "skipped"}."""
    report: dict[str, Any] = {
        "machine": machine.describe(machine.opencl_devices(settings.devices)),
        "settings": {**vars(settings), "dtype": list(dtypes), "seconds": seconds},
        "ceilings": {},
        "records": [],
        "skipped": [],
    }
    rates: dict[str, list[float]] = {}
    writes: dict[str, float] = {}
    for name in names:
        for dtype in dtypes:
            for case in CASES[name](replace(settings, dtype=dtype)):
                result = contest(case, seconds, settings.quick)
                writes[f"{name}, {dtype}" if len(dtypes) > 1 else name] = result["ceilings"].pop("stream_write_s")
                for ceiling, value in result["ceilings"].items():
                    rates.setdefault(ceiling, []).append(value)
                report["records"] += result["records"]
                # The same reason for three kinds of body is one reason.
                report["skipped"] += [skip for skip in result["skipped"] if skip not in report["skipped"]]
    report["ceilings"] = {ceiling: statistics.median(values) for ceiling, values in rates.items()}
    report["ceilings"]["stream_write_s"] = writes
    return report


def _settings(options: argparse.Namespace) -> Settings:
    default = Settings()
    return Settings(
        grid=options.grid or (QUICK_GRID if options.quick else default.grid),
        order=options.order or (QUICK_ORDER if options.quick else default.order),
        batch=options.batch,
        eps=options.eps,
        body=options.body,
        devices=tuple(options.device or ()),
        quick=options.quick,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    add = parser.add_argument
    add("--case", action="append", choices=[*CASES, "all"], help="may be repeated; all by default")
    add("--json", type=Path, metavar="FILE", help="write the report")
    add("--out-dir", type=Path, metavar="DIR", help="write the report as NAME.json and NAME.md")
    add("--name", help="NAME in --out-dir; the case's by default")
    add(
        "--seconds",
        type=_positive(float),
        default=SECONDS,
        help="to time each case, set-up apart (%(default)s)",
    )
    add("--batch", type=_positive(int), help="bodies, or queries, in one run")
    add("--grid", type=_three, metavar="N[,N,N]", help="cells (100)")
    add("--order", type=_three, metavar="N[,N,N]", help="order of the lattice (19)")
    add("--dtype", action="append", choices=DTYPES, help="may be repeated; float32 by default")
    add("--eps", type=_accuracy, help="accuracy asked of contenders that approximate (1e-6; 1e-12 in float64)")
    add(
        "--body",
        choices=KINDS,
        help="of the far fields: dense on the lattice, all three on scattered nodes",
    )
    add("--device", action="append", help="number or part of the label of an OpenCL device; may be repeated")
    add("--quick", action="store_true", help="tiny sizes, one round: checks that everything runs, times mean nothing")
    return parser


def _three(text: str) -> tuple[int, ...]:
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (1, 3) or min(numbers) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not one positive number or three, as in 120,60,180")
    return numbers * 3 if len(numbers) == 1 else numbers


def _accuracy(text: str) -> float:
    value: float = _positive(float)(text)
    # Whatever is further off than WRONG is not timed, and a contender may miss what was asked by some factor.
    if value > WRONG / 10:
        raise argparse.ArgumentTypeError(f"{text!r} exceeds {WRONG / 10}")
    return value


def _positive(kind: type[int] | type[float]) -> Any:
    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = kind(0)
        # A NaN is not greater than 0 either.
        if not 0 < value < float("inf"):
            raise argparse.ArgumentTypeError(f"{text!r} is not a positive {'integer' if kind is int else 'number'}")
        return value

    return parse


def _json(report: dict[str, Any]) -> str:
    return json.dumps(report, indent=1, allow_nan=False) + "\n"


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
