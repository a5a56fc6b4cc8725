"""Interleaved timing: contenders take turns, so that a busy minute of the machine hits them all.

The order is rotated each round: the threads of a BLAS or an OpenMP library spin for a while after a call and slow
whoever comes next, and a cache is warm with what the one before left there.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

# Below this many samples a band says nothing; above, more only cost time.
LEAST_ROUNDS, MOST_ROUNDS = 7, 400


@dataclass(frozen=True)
class Spread:
    """Median and 5th to 95th percentile."""

    median: float
    p5: float
    p95: float

    @classmethod
    def of(cls, samples: Sequence[float]) -> Spread:
        """Of at least one sample."""
        p5, median, p95 = np.percentile(samples, [5, 50, 95])
        return cls(float(median), float(p5), float(p95))


def strides(estimates: Sequence[float], seconds: float, quick: bool = False) -> tuple[int, list[int]]:
    """Number of rounds, and for each contender in which of them it runs: those divisible by its stride.

    Each contender may use an equal share of `seconds`, but runs at least `LEAST_ROUNDS` times. Strides are powers
    of two: where a slow contender runs, all faster ones do, so that any two meet in as many rounds as can be.
    """
    if quick:
        return 1, [1] * len(estimates)
    share = seconds / len(estimates)
    wanted = [min(max(int(share / estimate), LEAST_ROUNDS), MOST_ROUNDS) for estimate in estimates]
    rounds = max(wanted)
    return rounds, [2 ** math.floor(math.log2(rounds / count)) for count in wanted]


def interleave(
    runs: Sequence[Callable[[], object]], estimates: Sequence[float], seconds: float, quick: bool = False
) -> list[dict[int, float]]:
    """For each contender the seconds that its run took, by round."""
    rounds, stride = strides(estimates, seconds, quick)
    samples: list[dict[int, float]] = [{} for _ in runs]
    started = time.perf_counter()
    collecting = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        for number in range(rounds):
            for offset in range(len(runs)):
                turn = (number + offset) % len(runs)
                if number % stride[turn] == 0:
                    samples[turn][number] = clocked(runs[turn])
            # The estimates were made on a quiet moment; on a busy machine the rounds would take far longer.
            overrun = time.perf_counter() - started > 2 * seconds
            if overrun and all(len(taken) >= LEAST_ROUNDS for taken in samples):
                break
    finally:
        if collecting:
            gc.enable()
    return samples


def clocked(run: Callable[[], object]) -> float:
    """Seconds of one run."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


@dataclass(frozen=True)
class Ratio:
    """One contender's time over another's, from the rounds that both ran in.

    A ratio is claimed where its 5-95 % band excludes 1; with fewer than `LEAST_ROUNDS` pairs nothing is.
    """

    spread: Spread
    pairs: int

    @classmethod
    def of(cls, samples: dict[int, float], base: dict[int, float]) -> Ratio:
        """Of `samples` over `base`, seconds by round; every contender runs in round 0, so there is a pair."""
        pairs = [samples[number] / base[number] for number in samples.keys() & base.keys()]
        return cls(Spread.of(pairs), len(pairs))

    @property
    def claimed(self) -> bool:
        """Whether the ratio differs from 1 by more than chance would make it."""
        return self.pairs >= LEAST_ROUNDS and not self.spread.p5 <= 1 <= self.spread.p95
