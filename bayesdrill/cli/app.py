"""The program itself, and what its commands have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayesdrill import __version__

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="What a record says about the nine parameters of a torsional drilling rig.",
)


def output_option(what: str) -> Any:
    return typer.Option("--output", "-o", help=what)


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Experiment config (YAML).")]
Force = Annotated[bool, typer.Option("--force", help="Discard what is there and start over.")]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Of a Dask cluster, such as tcp://host:8786."),
]
Processes = Annotated[
    int | None, typer.Option(min=1, max=256, help="Processes; the result does not depend on it.")
]


def _tell_version(wanted: bool) -> None:
    """Eager, so that `--version` needs no command."""
    if wanted:
        typer.echo(f"bayesdrill {__version__}")
        raise typer.Exit


@app.callback()
def top(
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_tell_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    pass
