"""The command line: parse, call, print; nothing else.

`guard` says what the exit status means.
"""

from __future__ import annotations

import io
import sys

import typer

from bayesdrill.cli import before, runs, sundry  # noqa: F401  each brings its commands
from bayesdrill.cli.app import app


def main() -> None:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files need not be text
            stream.reconfigure(errors="backslashreplace")
    command = typer.main.get_command(app)
    for option in command.params:
        if option.name == "show_completion":
            option.hidden = True  # type: ignore[attr-defined]
    command()
