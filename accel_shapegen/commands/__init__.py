"""The verbs of the command line, one a file. Only `accel_shapegen.cli` imports this: it loads typer."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from .demo import demo
from .devices import devices
from .generate import generate
from .options import Session
from .reproduce import reproduce
from .train import train

__all__ = ["Session", "command"]

VERBS = (devices, demo, train, generate, reproduce)


def command() -> Any:
    """The whole command line, ready to run."""
    program = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")
    program.callback(invoke_without_command=True)(top)
    for verb in VERBS:
        program.command()(verb)
    return typer.main.get_command(program)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"accel-shapegen {version('accel-shapegen')}")
        raise typer.Exit


def top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    """Geometric bodies from far-field shape generators, on OpenCL devices.

    Start with [bold]accel-shapegen demo[/bold]; [bold]accel-shapegen devices[/bold] says what it runs on.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
