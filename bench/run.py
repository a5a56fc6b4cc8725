"""One case from set-up to records: check every contender, choose its best variant, time all of them together."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import ceilings
from .contest import Case, Contender, Run, Skipped
from .timing import Ratio, Spread, clocked, interleave

# Above this a contender computes something else, and its time means nothing.
WRONG = 1e-2
# A variant whose error exceeds the asked accuracy by more than this is not what was asked for. Generous to libraries
# whose fast setting misses it a little: errors stand beside the times.
ACCURACY_SLACK = 30


@dataclass(frozen=True)
class Entry:
    """A contender ready to be timed, in the variant that was kept."""

    contender: Contender
    variant: str
    run: Run
    error: float
    estimate: float
    tried: dict[str, dict[str, Any]]


def contest(case: Case, seconds: float, quick: bool = False) -> dict[str, Any]:
    """Ceilings, records and skipped contenders of one case, ready for JSON."""
    entries, skipped = [], list(case.skipped)
    for contender in case.contenders:
        print(f"bench: {case.name} ({case.detail}): {contender.name}", file=sys.stderr, flush=True)
        chosen = enter(case, contender)
        if isinstance(chosen, Entry):
            entries.append(chosen)
        else:
            skipped.append(chosen)
    probes = ceilings.probes(case, quick)
    estimates = [entry.estimate for entry in entries] + [_estimate(probe.run) for probe in probes]
    samples = interleave([*(e.run for e in entries), *(p.run for p in probes)], estimates, seconds, quick)
    limits = {
        probe.name: probe.value(Spread.of([*taken.values()]).median)
        for probe, taken in zip(probes, samples[len(entries) :], strict=True)
    }
    records = _records(case, entries, samples[: len(entries)], limits)
    return {"ceilings": limits, "records": records, "skipped": [vars(skip) for skip in skipped]}


def enter(case: Case, contender: Contender) -> Entry | Skipped:
    """The contender in its fastest variant that is accurate enough, or why there is none."""
    ready: dict[str, tuple[Run, float, float]] = {}
    tried: dict[str, dict[str, Any]] = {}
    for variant, prepare in contender.variants.items():
        # Whatever a foreign library raises ends up in the report: a contender that cannot run is news, not a crash.
        try:
            run, error, estimate = _try(case, prepare())
        except Exception as problem:
            tried[variant] = {"problem": f"{type(problem).__name__}: {problem}"}
            continue
        if not error <= WRONG:
            tried[variant] = {"problem": f"its error {error:.2g} exceeds {WRONG}: it computes something else"}
            continue
        ready[variant] = run, error, estimate
        tried[variant] = {"s": estimate / contender.items, "error": error}
    if not ready:
        reasons = {attempt["problem"] for attempt in tried.values()}
        return Skipped(case.name, contender.name, "; ".join(sorted(reasons)))
    asked = math.inf if contender.eps is None else ACCURACY_SLACK * contender.eps
    accurate = [variant for variant in ready if ready[variant][1] <= asked]
    fastest = min(accurate, key=lambda variant: ready[variant][2]) if accurate else ""
    kept = fastest or min(ready, key=lambda variant: ready[variant][1])
    run, error, estimate = ready[kept]
    return Entry(contender, kept, run, error, estimate, tried)


def _try(case: Case, run: Run) -> tuple[Run, float, float]:
    """A first run on poisoned output, which is checked, and an estimate of the time of later ones."""
    case.out.fill(np.nan)
    return run, case.error(run()), _estimate(run)


def _estimate(run: Any) -> float:
    # The first run after the set-up still pays for pages and thread pools.
    clocked(run)
    return max(min(clocked(run) for _ in range(3)), 1e-9)


def _records(
    case: Case, entries: Sequence[Entry], samples: Sequence[dict[int, float]], limits: dict[str, float]
) -> list[dict[str, Any]]:
    per_item = [
        {number: t / entry.contender.items for number, t in taken.items()}
        for entry, taken in zip(entries, samples, strict=True)
    ]
    spreads = [Spread.of([*taken.values()]) for taken in per_item]
    ours = [i for i, entry in enumerate(entries) if entry.contender.name.startswith("opencl")]
    best = min(ours, key=lambda i: spreads[i].median, default=None)
    records = []
    for i, (entry, taken, spread) in enumerate(zip(entries, per_item, spreads, strict=True)):
        record = {
            "case": case.name,
            "contender": entry.contender.name,
            "shape": case.shape,
            "batch": entry.contender.items,
            "dtype": case.dtype,
            "eps": entry.contender.eps,
            "median_s": spread.median,
            "p5_s": spread.p5,
            "p95_s": spread.p95,
            "error": entry.error,
            "detail": case.detail,
            "per": case.per,
            "repetitions": len(taken),
            "variant": entry.variant,
            "variants": entry.tried,
            "fraction_of_ceilings": ceilings.fractions(case, limits, spread.median),
            "ratio_to_best_opencl": None,
            "best_opencl": i == best,
        }
        if best is not None:
            ratio = Ratio.of(taken, per_item[best])
            record["ratio_to_best_opencl"] = {**vars(ratio.spread), "pairs": ratio.pairs, "claimed": ratio.claimed}
        records.append(record)
    return records
