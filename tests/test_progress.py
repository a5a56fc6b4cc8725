"""Progress: lines without a terminal, a bar on one."""

from __future__ import annotations

import io
import re
import threading
import time

import pytest

from accel_shapegen.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def wait_for(stream: io.StringIO, pattern: str) -> None:
    """Until a pattern has been written, at most 10 s."""
    end = time.monotonic() + 10
    while not re.search(pattern, stream.getvalue(), flags=re.MULTILINE):
        assert time.monotonic() < end, stream.getvalue()
        time.sleep(0.005)


def test_a_line_says_the_stage_and_how_far_it_is() -> None:
    stream = io.StringIO()
    with Progress(stream, every=0.01) as progress, progress.stage("training bodies") as report:
        report(3, 25)
        wait_for(stream, r"^training bodies: 3 of 25, \d+ s$")
        report(4, 25)
        wait_for(stream, r"^training bodies: 4 of 25, \d+ s$")


def test_lines_come_within_a_single_long_step() -> None:
    stream = io.StringIO()
    with Progress(stream, every=0.01) as progress, progress.stage("fit"):
        wait_for(stream, r"(^fit: \d+ s\n){3}")


def test_no_line_before_its_time_and_none_after_the_end() -> None:
    stream = io.StringIO()
    with Progress(stream) as progress, progress.stage("fit") as report:
        report(1, 1)
    assert stream.getvalue() == ""
    assert "progress" not in [thread.name for thread in threading.enumerate()]


def test_a_terminal_gets_a_bar_per_stage() -> None:
    stream = Terminal()
    with Progress(stream) as progress:
        with progress.stage("training bodies") as report:
            report(4, 25)
            report(25, 25)
        with progress.stage("fit"):
            pass
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue())
    assert re.search(r"training bodies\s+\S+\s+25/25", text)
    assert re.search(r"fit\s+\S+\s+1/1", text)


@pytest.mark.parametrize("stream", [None, io.StringIO(), Terminal()])
def test_stages_are_timed_and_errors_pass(stream: io.StringIO | None) -> None:
    with Progress(stream) as progress:
        for what in ("one", "two", "one"):
            with progress.stage(what):
                time.sleep(0.02)
        with pytest.raises(KeyError), progress.stage("three"):
            raise KeyError
    assert list(progress.seconds) == ["one", "two", "three"]
    # The clock of sleep and that of the stages differ by less than the resolution of either, 1 ms here.
    assert progress.seconds["one"] >= 0.039
    assert progress.seconds["two"] >= 0.019
