"""What verbs print: results on stdout, progress on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

WIDTH = 100


def console() -> Console:
    """On a terminal as wide as that is, at most 100 columns; 100 in a file or a pipe."""
    shown = Console(highlight=False)
    if not shown.is_terminal or shown.width > WIDTH:
        shown.width = WIDTH
    return shown


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: int = 0) -> Table:
    """A table whose last `numbers` columns are set to the right. Texts are shown as they are, brackets included."""
    from rich import box
    from rich.text import Text

    result = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        right = index >= len(columns) - numbers
        result.add_column(Text(column), justify="right" if right else "left", overflow="fold")
    for row in rows:
        result.add_row(*(Text(cell) for cell in row))
    return result


def print_json(value: Any) -> None:
    """One object, for a program to read; a NaN would not be JSON and is an error."""
    json.dump(value, sys.stdout, indent=2, allow_nan=False, ensure_ascii=False)
    sys.stdout.write("\n")
