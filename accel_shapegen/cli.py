"""The command line: `accel-shapegen devices | demo | train | generate | reproduce`.

What a person or program did wrong is one line on stderr and exit status 2; `--debug` shows where it was noticed.
"""

from __future__ import annotations

import io
import sys
import traceback
from collections.abc import Sequence
from typing import Any

from .errors import ShapegenError

FAILED, INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the program's name; those it was started with by default.

    Returns
    -------
    int
        Exit status: 0, 2 after an error, 130 when interrupted.
    """
    # Typer and rich load here, so that importing the package stays light.
    import typer

    from .commands import Session, command

    # The base of every error in the arguments themselves; typer exports none of its names but this one's child's.
    usage_error: Any = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")
    for stream in (sys.stdout, sys.stderr):
        # A console that is not UTF-8 gets a question mark for a frame or a ×, not a traceback after the work is done.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    session = Session()
    try:
        status = command().main(
            args=list(sys.argv[1:] if arguments is None else arguments),
            prog_name="accel-shapegen",
            standalone_mode=False,
            obj=session,
        )
        return int(status or 0)
    except usage_error as error:
        return _fail(session, error, error.format_message().replace("\n", " "))
    except (ShapegenError, OSError) as error:
        return _fail(session, error, str(error))
    except MemoryError as error:
        return _fail(session, error, f"out of memory ({error}): give smaller sizes")
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


def _fail(session: object, error: BaseException, line: str) -> int:
    if getattr(session, "debug", False):
        traceback.print_exception(error)
    print(f"error: {line}", file=sys.stderr)
    return FAILED
