"""The figures of merit of an experiment as tables and as what results.json holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .page import Table
from .trial import Outcome

MEASURES = ("IoU", "truncation alone", "far-field error", "Hausdorff [m]", "volume error")


def record(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """By setting."""
    return {outcome.setting.name: outcome.record for outcome in outcomes}


def table(outcomes: Sequence[Outcome], title: str = "Bodies that were in no training set") -> Table:
    """One row per query and setting: the figures of merit, and the IoU under noise."""
    family = outcomes[0].family
    deltas = [entry["delta"] for entry in outcomes[0].predictions[0].record["noise"]]
    rows = []
    for index, query in enumerate(family.queries):
        for outcome in outcomes:
            merits = outcome.predictions[index].record
            rows.append(
                [
                    family.describe(query) if outcome is outcomes[0] else "",
                    outcome.setting.name,
                    f"{merits['iou']:.4f}",
                    f"{merits['iou_truncation']:.4f}",
                    f"{merits['far_field_relative_error']:.1e}",
                    f"{merits['hausdorff_m']:.3f}",
                    f"{100 * merits['volume_relative_error']:.2f} %",
                    *(f"{entry['iou']:.4f}" for entry in merits["noise"]),
                ]
            )
    heads = ["body", "setting", *MEASURES, *(f"{100 * delta:g} %" for delta in deltas)]
    return Table(title, heads, rows, [("", 2 + len(MEASURES)), ("IoU under noise δ", len(deltas))])


def caption(merits: dict[str, Any]) -> list[str]:
    """Lines beside a picture."""
    return [
        f"IoU {merits['iou']:.3f}",
        f"truncation alone {merits['iou_truncation']:.3f}",
        f"far-field error {100 * merits['far_field_relative_error']:.1f} %",
        f"Hausdorff {1000 * merits['hausdorff_m']:.0f} mm",
        f"volume error {100 * merits['volume_relative_error']:.1f} %",
    ]


def settings(outcomes: Sequence[Outcome]) -> str:
    """A sentence on each setting."""
    return "Settings - " + "; ".join(describe(outcome) for outcome in outcomes) + "."


def describe(outcome: Outcome) -> str:
    """`paper: order 19, box 2.2 m, 59,319 nodes`."""
    setting = outcome.setting
    lattice = setting.lattice
    orders, sides = (sorted(set(values)) for values in (lattice.order, lattice.box.lengths))
    order = str(orders[0]) if len(orders) == 1 else str(lattice.order)
    side = f"{sides[0]:g}" if len(sides) == 1 else " × ".join(f"{length:g}" for length in lattice.box.lengths)
    cells = " × ".join(map(str, setting.grid.shape))
    return f"{setting.name}: N = {order}, V0 {side} m, {lattice.size:,} nodes, compared on {cells}"
