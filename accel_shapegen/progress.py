"""Progress of long work: a bar on a terminal, a line every 30 s otherwise.

    with Progress(sys.stderr) as progress:
        with progress.stage("training bodies") as report:
            report(done, total)

A `report` is what the functions of this package take as `progress`.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, TextIO

Report = Callable[[int, int], object]

# Seconds between lines where there is no terminal.
EVERY = 30.0


class Progress:
    """Stages of a long run, one after the other.

    Parameters
    ----------
    stream : text stream, optional
        Where to show them; nowhere if None. A bar is drawn where it is a terminal.
    every : float
        Seconds between lines where it is not.

    Attributes
    ----------
    seconds : dict of str to float
        How long each finished stage took, in order; stages of one name add up.
    """

    def __init__(self, stream: TextIO | None = None, *, every: float = EVERY) -> None:
        self.seconds: dict[str, float] = {}
        self._stream = stream
        self._bars = stream is not None and stream.isatty()
        self._every = every
        self._now: tuple[str, float] | None = None
        self._count: tuple[int, int] | None = None
        self._ended = threading.Event()
        self._clock: threading.Thread | None = None

    def __enter__(self) -> Progress:
        if self._stream is not None and not self._bars:
            # A thread, because a single step may take longer than the time between two lines.
            self._clock = threading.Thread(target=self._tick, name="progress", daemon=True)
            self._clock.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._clock is not None:
            self._clock.join()

    @contextlib.contextmanager
    def stage(self, what: str) -> Iterator[Report]:
        """Show `what` while the block runs; it yields the report to call as report(done, total)."""
        started = time.perf_counter()
        self._count, self._now = None, (what, started)
        try:
            if self._bars:
                with self._bar(what) as report:
                    yield report
            else:
                yield self._remember
        finally:
            self._now = None
            self.seconds[what] = self.seconds.get(what, 0.0) + time.perf_counter() - started

    def _remember(self, done: int, total: int) -> None:
        self._count = (done, total)

    def _tick(self) -> None:
        while not self._ended.wait(self._every):
            now, count = self._now, self._count
            if now is not None and self._stream is not None:
                what, started = now
                counted = f" {count[0]} of {count[1]}," if count else ""
                print(f"{what}:{counted} {time.perf_counter() - started:.0f} s", file=self._stream, flush=True)

    @contextlib.contextmanager
    def _bar(self, what: str) -> Iterator[Report]:
        from rich import progress as bars
        from rich.console import Console

        columns: list[Any] = [
            bars.TextColumn("{task.description:<24}"),
            bars.BarColumn(bar_width=40),
            bars.MofNCompleteColumn(),
            bars.TimeElapsedColumn(),
        ]
        with bars.Progress(*columns, console=Console(file=self._stream)) as shown:
            task = shown.add_task(what, total=None)
            yield lambda done, total: shown.update(task, completed=done, total=total)
            # A stage that never counted would go on pulsing.
            if shown.tasks[0].total is None:
                shown.update(task, completed=1, total=1)
