"""Tables of characteristic values: CSV files with a header, whose faults are named by row and column."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingFileError, TableError
from .options import finite


@dataclass(frozen=True)
class Table:
    """The texts of a CSV file: a header, and rows with the line of the file where each ends."""

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]

    def place(self, row: int, column: str | None = None) -> str:
        """How messages call a row, from 1, or a cell."""
        where = f"{self.path}, row {row + 1} (line {self.lines[row]})"
        return where if column is None else f"{where}, column {column!r}"

    def texts(self, column: str) -> list[str]:
        """A column that must be there and filled."""
        self.require((column,))
        index = self.header.index(column)
        for row, cells in enumerate(self.rows):
            if not cells[index]:
                raise TableError(self.place(row, column), "is empty", "fill it")
        return [cells[index] for cells in self.rows]

    def numbers(self, columns: Sequence[str]) -> NDArray[np.float64]:
        """Columns of finite numbers, in the order asked for, shape (rows, columns)."""
        self.require(columns)
        result = np.empty((len(self.rows), len(columns)))
        for j, column in enumerate(columns):
            for row, text in enumerate(self.texts(column)):
                value = finite(text)
                if value is None:
                    raise TableError(self.place(row, column), f"is {text!r}", "give a finite number")
                result[row, j] = value
        return result

    def require(self, columns: Sequence[str]) -> None:
        """Refuse a header that lacks a column."""
        missing = [column for column in columns if column not in self.header]
        if missing:
            raise TableError(
                str(self.path), f"has no column {missing[0]!r}, only {', '.join(self.header)}", "add it to the header"
            )


def read_table(path: Path) -> Table:
    """A CSV file in UTF-8, separated by commas; empty lines are passed over.

    Raises
    ------
    MissingFileError, TableError
        No such file; no header or no rows; an empty or repeated column name; a row of another length than the header.
    """
    if not path.is_file():
        raise MissingFileError(str(path), "is not a file", "give a CSV file with a header")
    rows, lines = [], []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            for cells in reader:
                if any(cell.strip() for cell in cells):
                    rows.append([cell.strip() for cell in cells])
                    lines.append(reader.line_num)
    except (UnicodeDecodeError, csv.Error) as error:
        raise TableError(str(path), f"is no CSV file in UTF-8 ({error})", "save it as one") from error
    if len(rows) < 2:
        raise TableError(str(path), "has no rows" if rows else "is empty", "give a header and at least one row")
    header, *rest = rows
    for index, name in enumerate(header):
        if not name or name in header[:index]:
            problem = f"has the column {name!r} twice" if name else f"has no name for column {index + 1}"
            raise TableError(str(path), problem, "give each column a name of its own")
    table = Table(path, tuple(header), rest, lines[1:])
    for row, cells in enumerate(rest):
        if len(cells) != len(header):
            problem = f"has {len(cells)} cells for {len(header)} columns"
            raise TableError(table.place(row), problem, "separate them by commas, numbers with a point")
    return table
