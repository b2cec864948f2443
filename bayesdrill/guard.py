"""Turn the errors of all commands into messages and exit statuses.

Exit status: 0 done (and converged); 2 wrong input, a full disk, too little memory, or a
missing output; 3 not converged, not to be believed or not calibrated; 130 interrupted.
"""

from __future__ import annotations

import mmap
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread, Timer
from typing import Any, TextIO, cast

import typer

from bayesdrill.basics import errors
from bayesdrill.basics.errors import InputError, Interrupted
from bayesdrill.basics.registry import blamed_package

INPUT_WRONG = 2
NOT_CONVERGED = 3
INTERRUPTED = 130
MOST_PROBLEMS = 15  # largest number of input errors that are listed
LONGEST_LINE = 400  # largest number of characters of a message
LEAST_MEMORY = 512 * 1024**2  # bytes; the libraries alone occupy this much
STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
KILLED = "a worker process was killed (out of memory?); fewer --processes need less"


@contextmanager
def guarded() -> Iterator[None]:
    """End a command with message and exit status after any expected error or Ctrl-C."""
    try:
        # Some libraries end the process without a message if they cannot be loaded.
        mmap.mmap(-1, LEAST_MEMORY).close()
        if sys.flags.optimize > 1:
            message = "python -OO removes docstrings that ArviZ needs; start Python without -OO"
            raise InputError.at("", message)
        with _interruptible(), never_silent():
            yield
    except InputError as error:
        for problem in error.problems[:MOST_PROBLEMS]:
            _tell(str(problem))
        if (more := len(error.problems) - MOST_PROBLEMS) > 0:
            _tell(f"... and {more} more")
        raise typer.Exit(INPUT_WRONG) from None
    except (Interrupted, KeyboardInterrupt) as stopped:
        _tell(str(stopped) if isinstance(stopped, Interrupted) else "stopped")
        raise typer.Exit(INTERRUPTED) from None
    except typer.Exit:
        raise
    except (Exception, SystemExit) as error:
        # The reader of stdout has closed it. Typer's help then raises `SystemExit`.
        if BrokenPipeError in (type(error), type(error.__context__)):
            _drop_unwritten()
            raise typer.Exit(0) from None
        if errors.was_stopped(error):
            _tell("stopped")
            raise typer.Exit(INTERRUPTED) from None
        if isinstance(error, BrokenExecutor):
            _tell(KILLED)
        elif errors.short_of_memory(error):
            _tell("out of memory; a shorter record, fewer walkers or fewer steps need less")
        elif isinstance(error, OSError):
            where = f"{error.filename}: " if error.filename else ""
            _tell(f"{where}{_reason(error)}")
            _drop_unwritten()
        elif text := blamed_package(error):
            _tell(text)
        else:
            raise
        raise typer.Exit(INPUT_WRONG) from None


def _drop_unwritten() -> None:
    """Redirect a closed stdout to null, since Python would fail when it flushes stdout at exit."""
    try:
        sys.stdout.flush()
    except (OSError, AttributeError):  # stdout is None if it was closed from the beginning
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def say(text: str, *, err: bool = False) -> None:
    """Print lines on stdout, or on stderr if `err`; unprintable characters are replaced."""
    typer.echo(errors.printable(text), err=err)


def finish(outcome: Any, *, verbose: bool = False) -> None:
    """Print an `outcome` of `tasks.pipeline` with its folder, and set the exit status."""
    say(outcome.details if verbose else outcome.summary)
    say(f"results: {outcome.folder}/ (report.html, summary.md, figures/, posterior.nc, chain.h5)")
    for file in outcome.missing:
        say(f"could not be made: {file}", err=True)
    if outcome.missing:
        command = f"`bayesdrill report {outcome.folder}`"
        say(f"everything else is written; correct this, then {command} makes the rest", err=True)
    if outcome.reasons:
        raise typer.Exit(NOT_CONVERGED)
    if outcome.missing:
        raise typer.Exit(INPUT_WRONG)


# Seconds without output after which a line is printed. The check is repeated every `SILENCE / 10`,
# so no command is silent for 10 s.
SILENCE = 8.0


class _Watched:
    """A watched stream stores the time of its last output."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self.written = stream, time.monotonic()

    def write(self, text: str) -> int:
        self.written = time.monotonic()
        return self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def never_silent(silence: float = SILENCE) -> Iterator[None]:
    """Print a line on stderr whenever nothing was written for `silence` seconds."""
    before = sys.stdout, sys.stderr
    if None in before:
        yield
        return
    out, err, done, begun = _Watched(sys.stdout), _Watched(sys.stderr), Event(), time.monotonic()
    sys.stdout, sys.stderr = cast(Any, out), cast(Any, err)

    def watch() -> None:
        while not done.wait(silence / 10):
            if time.monotonic() - max(out.written, err.written) >= silence:
                with suppress(OSError, ValueError):
                    err.write(f"  still working, for {time.monotonic() - begun:.0f} s by now\n")
                    err.flush()

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()
        sys.stdout, sys.stderr = before


@contextmanager
def _interruptible() -> Iterator[None]:
    """Raise `KeyboardInterrupt` at the first Ctrl-C, SIGTERM or SIGHUP; ignore further signals.

    A second signal would stop the clean-up. Signals that were ignored before (nohup) stay ignored.
    Python discards exceptions inside `__del__`; a signal lost there is sent again after 0.01 s.
    """
    numbers = [getattr(signal, name) for name in STOPPING if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    heard = [n for n, handler in before.items() if handler not in (None, signal.SIG_IGN)]

    def interrupt(_number: int, _frame: object) -> None:
        for number in heard:
            signal.signal(number, signal.SIG_IGN)
        raise errors.Stopped

    def hear() -> None:
        for number in heard:
            signal.signal(number, interrupt)

    def raise_again(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, errors.Stopped):
            hear()
            Timer(0.01, os.kill, [os.getpid(), heard[0]]).start()
        else:
            hook(lost)

    hook, sys.unraisablehook = sys.unraisablehook, raise_again
    hear()
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number in heard:
            if signal.getsignal(number) is interrupt:
                signal.signal(number, before[number])


@contextmanager
def saved_in(folder: Path, way_out: str = "go on with --resume") -> Iterator[None]:
    """Report the path at which a disk or a worker failed, and how to continue the run."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        if errors.short_of_memory(error):
            raise
        message = f"{_reason(error)}; correct this, then {way_out}"
        raise InputError.at(str(error.filename or folder), message) from None
    except BrokenExecutor:
        raise InputError.at(str(folder), f"{KILLED}; {way_out}") from None


def _reason(error: OSError) -> str:
    # For errors of HDF5, `error.strerror` is a long text.
    return f"cannot be written or read: {os.strerror(error.errno) if error.errno else error}"


def _tell(text: str) -> None:
    """Print one line on stderr; if stderr is full or closed, the exit status has to suffice."""
    with suppress(OSError):
        say(errors.shortened(text.replace("\n", " "), LONGEST_LINE), err=True)
