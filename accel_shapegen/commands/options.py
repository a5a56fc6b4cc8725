"""Options that several verbs share, and how their texts become values."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import typer
from numpy.typing import NDArray

from .. import backends
from ..backends.base import Backend
from ..errors import ArgumentError, ShapegenError

Number = TypeVar("Number", int, float)


@dataclass
class Session:
    """What one run of the program must remember when a verb has failed."""

    debug: bool = False


def _remember_debug(context: typer.Context, wanted: bool) -> bool:
    session = context.find_object(Session)
    if session is not None:
        session.debug = session.debug or wanted
    return wanted


BackendName = Annotated[
    str | None, typer.Option("--backend", metavar="NAME", help="opencl, reference, … instead of the best there is.")
]
DeviceName = Annotated[
    str | None, typer.Option("--device", metavar="DEVICE", help="Its number, or a part of its name or version.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object for a program to read.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
# Eager, so that it is known before another option fails.
Debug = Annotated[
    bool, typer.Option("--debug", is_eager=True, callback=_remember_debug, help="Show the traceback of an error.")
]


def choose_backend(name: str | None, device: str | None) -> Backend | None:
    """The backend of `--backend` and `--device`; None where neither is given, so that each operation finds its own."""
    return None if name is None and device is None else backends.get(name, device=device)


def per_axis(option: str, text: str, kind: type[Number], what: str) -> list[Number]:
    """`19` or `21,11,30`: one number for all axes, or one per axis."""
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise ArgumentError(option, f"is {text!r}", f"give {what}, or one per axis as in 1,2,3") from None


def one_or_all(values: list[Number]) -> Number | list[Number]:
    """A single number stands for all axes."""
    return values[0] if len(values) == 1 else values


def assignments(option: str, text: str) -> dict[str, float]:
    """`height=1.62,rw=0.9` as numbers by name."""
    result: dict[str, float] = {}
    for part in text.split(","):
        name, equals, number = (piece.strip() for piece in part.partition("="))
        value = finite(number) if equals and name else None
        if value is None:
            raise ArgumentError(option, f"has {part.strip()!r}", "give NAME=NUMBER, as in height=1.62,rw=0.9")
        if name in result:
            raise ArgumentError(option, f"gives {name} twice", "give each name once")
        result[name] = value
    return result


def knots(option: str, text: str) -> tuple[str, NDArray[np.float64]]:
    """`height=1.5:1.9:5` (first, last, count) or `height=1.5,1.6,1.9` as a name and its values."""
    name, equals, values = (piece.strip() for piece in text.partition("="))
    example = f"give NAME=FIRST:LAST:COUNT or NAME=A,B,…, as in {name or 'height'}=1.5:1.9:5"
    if not equals or not name:
        raise ArgumentError(option, f"is {text!r}", example)
    if ":" not in values:
        numbers = [finite(part) for part in values.split(",")]
        if None in numbers:
            raise ArgumentError(option, f"has {values.split(',')[numbers.index(None)]!r} for {name}", example)
        return name, np.array(numbers, dtype=np.float64)
    parts = values.split(":")
    ends = [finite(part) for part in parts[:2]]
    if len(parts) != 3 or None in ends or not parts[2].strip().isdecimal() or int(parts[2]) < 2:
        raise ArgumentError(option, f"is {text!r}", example)
    return name, np.linspace(ends[0], ends[1], int(parts[2]))  # type: ignore[arg-type]


def finite(text: str) -> float | None:
    """A finite number, or None."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def require_new(paths: list[Path], overwrite: bool) -> None:
    """Refuse to replace files unless asked to."""
    there = [path for path in paths if path.exists()]
    if there and not overwrite:
        more = f", and {len(there) - 1} more" if len(there) > 1 else ""
        raise ArgumentError(str(there[0]), f"exists{more}", "give another place, or --overwrite")


@contextlib.contextmanager
def about(option: str) -> Iterator[None]:
    """What is wrong in the block is wrong with this option."""
    try:
        yield
    except ArgumentError as error:
        raise locate(error, option) from error


def locate(error: ShapegenError, where: str) -> ShapegenError:
    """The same error, said of a place in a file."""
    return type(error)(where, f"{error.subject} {error.problem}", error.remedy)
