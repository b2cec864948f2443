"""Where mistakes end: in a message and a status, whatever command they happen in.

Exit status: 0 done (and converged), 2 the input is wrong, disk or memory ran out or a table or figure
could not be made, 3 finished but not converged or not calibrated, 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

INPUT_WRONG = 2
NOT_CONVERGED = 3
INTERRUPTED = 130
LONGEST_LINE = 400
KILLED = "a worker process was killed (out of memory?); fewer --processes need less"


@contextmanager
def guarded() -> Iterator[None]:
    """Mistakes, a full disk, a killed worker and Ctrl-C end in a message and a status."""
    from bayesdrill.errors import InputError, Interrupted

    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    except InputError as error:
        _fail(error.problems)
    except Interrupted as stopped:
        typer.echo(str(stopped), err=True)
        raise typer.Exit(INTERRUPTED) from None
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # Nobody reads on.  Python would try once more at the end, and fail, so give it a place.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        typer.echo(_line(f"{place}{_reason(error)}"), err=True)
        raise typer.Exit(INPUT_WRONG) from None
    except BrokenExecutor:
        typer.echo(KILLED, err=True)
        raise typer.Exit(INPUT_WRONG) from None
    except MemoryError:
        message = "out of memory; a shorter record, fewer walkers or fewer steps need less"
        typer.echo(message, err=True)
        raise typer.Exit(INPUT_WRONG) from None
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def saved_in(folder: Path, way_out: str = "go on with --resume") -> Iterator[None]:
    """A disk or a worker that fails during a run: where, and how the run goes on from there."""
    from bayesdrill.errors import InputError

    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        message = f"{_reason(error)}; mend this, then {way_out}"
        raise InputError.one(str(error.filename or folder), message) from None
    except BrokenExecutor:
        raise InputError.one(str(folder), f"{KILLED}; {way_out}") from None


def _reason(error: OSError) -> str:
    # HDF5 puts a page of its own into `strerror`.
    return f"cannot be written or read: {os.strerror(error.errno) if error.errno else error}"


def _fail(problems: tuple[Any, ...]) -> None:
    most = 15
    for problem in problems[:most]:
        typer.echo(_line(str(problem)), err=True)
    if len(problems) > most:
        typer.echo(f"... and {len(problems) - most} more", err=True)
    raise typer.Exit(INPUT_WRONG)


def _line(text: str) -> str:
    """One line that a terminal can show, however long the names in a file are."""
    text = "".join(letter if letter.isprintable() else " " for letter in text)
    return text if len(text) <= LONGEST_LINE else f"{text[: LONGEST_LINE - 3]}..."


def _interrupt(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt
