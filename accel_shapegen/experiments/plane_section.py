"""What the two experiments in the plane have in common: their tables and figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from . import figures, summary
from .page import Figure, Section
from .trial import Outcome


def assemble(title: str, text: str, name: str, outcomes: Sequence[Outcome], folder: Path) -> Section:
    """The section of an experiment in the plane; draws `name`.png and `name`_noise.png into `folder`."""
    figures.draw_plane(folder / f"{name}.png", outcomes)
    figures.draw_noise(folder / f"{name}_noise.png", outcomes)
    family = outcomes[0].family
    grid = " × ".join(str(len(axis)) for axis in family.knots)
    ranges = ", ".join(
        f"{label} in [{axis[0]:g}, {axis[-1]:g}]" for label, axis in zip(family.names, family.knots, strict=True)
    )
    shown = [
        Figure(f"{name}.png", figures.PLANE_CAPTION),
        Figure(f"{name}_noise.png", figures.NOISE_CAPTION),
    ]
    return Section(
        title,
        [text, f"Training grid: {grid} bodies, {ranges}.", summary.settings(outcomes)],
        [summary.table(outcomes)],
        shown,
        summary.record(outcomes),
    )
