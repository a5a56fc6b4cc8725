"""Run experiments by name and write what they found: results.json, pictures, and one page with everything on it."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import arguments
from ..backends.base import Backend
from ..progress import Progress
from ..report import require_matplotlib
from . import cuboid, forward, human, kite, kite_fem, multi_domain, stability
from .fem import require_ngsolve
from .page import Section, write_page

EXPERIMENTS: dict[str, Callable[..., Section]] = {
    "kite": kite.run,
    "multi-domain": multi_domain.run,
    "cuboid": cuboid.run,
    "human": human.run,
    "stability": stability.run,
    "forward": forward.run,
    "kite-fem": kite_fem.run,
}
# Minutes of finite elements, for one comparison: only when asked for by name.
ONLY_BY_NAME = ("kite-fem",)
NEED_NGSOLVE = ("forward", "kite-fem")

TITLE = "Geometric body generation from far fields: the experiments"
OPENING = (
    "The experiments of J. Li, H. Liu, W.-Y. Tsui, X. Wang, “An inverse scattering approach for geometric body "
    "generation: a machine learning perspective” (2020), with its parameters. A model learns the far-field patterns "
    "(shape generators) of bodies on a grid of characteristic values, predicts those of other bodies by a tensor "
    "product cubic spline, and turns them back into bodies by a truncated Fourier series f_N.",
    "A predicted body is {f_N > 1/2}. IoU is taken at cell centres against the exact body; “truncation alone” is the "
    "IoU that the exact generator would give, so that what is missing from it is learning error. Far-field errors are "
    "relative L2 over the nodes without the zero node.",
)


def run(
    name: str,
    out: str | os.PathLike[str],
    *,
    sizes: dict[str, dict[str, Any]] | None = None,
    backend: str | Backend | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run one experiment, or all that need no name of their own.

    Parameters
    ----------
    name : str
        One of `EXPERIMENTS`, or "all".
    out : path
        Folder for results.json, index.html and the pictures; it is made, and files of an earlier run are replaced.
    sizes : dict, optional
        By experiment, keywords of its `run` in place of the paper's numbers.
    backend : str, optional
        See `accel_shapegen.backends.get`.
    progress : Progress, optional
        Where stages are shown.

    Returns
    -------
    dict
        What results.json holds: `experiments` by name, `seconds` by stage and in all.

    Raises
    ------
    ArgumentError, MissingDependencyError
        An unknown name; matplotlib or ngsolve missing where it is needed, before any work is done.
    """
    arguments.choice("experiment", name, (*EXPERIMENTS, "all"))
    names = [key for key in EXPERIMENTS if key not in ONLY_BY_NAME] if name == "all" else [name]
    require_matplotlib()
    if any(key in NEED_NGSOLVE for key in names):
        require_ngsolve()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    shown = progress if progress is not None else Progress()
    started, seconds, sections = time.perf_counter(), {}, {}
    for key in names:
        before = time.perf_counter()
        sections[key] = EXPERIMENTS[key](folder, **(sizes or {}).get(key, {}), backend=backend, progress=shown)
        seconds[key] = round(time.perf_counter() - before, 3)
    total = round(time.perf_counter() - started, 3)
    results = {
        "experiments": {key: section.record for key, section in sections.items()},
        "seconds": total,
        "seconds_by_experiment": seconds,
        "stages": {what: round(taken, 3) for what, taken in shown.seconds.items()},
        "files": ["index.html", *(figure.name for section in sections.values() for figure in section.figures)],
    }
    text = json.dumps(results, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "results.json").write_text(text + "\n", encoding="utf-8")
    closing = f"Made by accel-shapegen reproduce {name} in {total:.0f} s."
    write_page(folder / "index.html", TITLE, OPENING, list(sections.values()), closing)
    return results
