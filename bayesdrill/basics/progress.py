"""Report the progress of long work, as a bar on a terminal or as lines in a file."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol, TextIO, runtime_checkable

from bayesdrill.basics.errors import printable


@runtime_checkable
class Reporter(Protocol):
    """A reporter shows the progress of long work; threads may call it one at a time."""

    def say(self, text: str) -> None:
        """Print a line."""

    def update(self, fraction: float, text: str) -> None:
        """Show a text and the completed fraction of a stage: 0 at its start, 1 at its end."""


@dataclass(frozen=True, slots=True)
class Silent:
    """A silent reporter shows nothing."""

    def say(self, text: str) -> None:
        """Do nothing."""

    def update(self, fraction: float, text: str) -> None:
        """Do nothing."""


SILENT = Silent()


@dataclass(slots=True)
class Lines:
    """The reporter prints a line per stage and every `interval` seconds, for log files."""

    stream: TextIO
    interval: float = 10.0
    _start_time: float = field(default_factory=time.monotonic)
    _last_time: float = field(default_factory=time.monotonic)

    def say(self, text: str) -> None:
        """See `Reporter.say`."""
        try:
            print(printable(text), file=self.stream, flush=True)
        except OSError:  # a closed pipe or a full disk must not stop the work
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())

    def update(self, fraction: float, text: str) -> None:
        """See `Reporter.update`."""
        now = time.monotonic()
        if fraction <= 0:
            self._start_time = self._last_time = now
            self.say(f"  {text} ...")
        elif text and now - self._last_time >= self.interval:
            self._last_time = now
            remaining = _time_left(now - self._start_time, fraction)
            self.say(f"  {100 * fraction:3.0f} %  {text}{remaining}")


class Bar:
    """The reporter shows a progress bar (rich) and the estimated remaining time, for terminals."""

    def __init__(self, console: Any, progress: Any) -> None:
        self._console, self._progress = console, progress
        self._task: Any = None
        self._begun = time.monotonic()

    def say(self, text: str) -> None:
        """See `Reporter.say`."""
        self._console.print(printable(text), highlight=False, markup=False, soft_wrap=True)

    def update(self, fraction: float, text: str) -> None:
        """See `Reporter.update`."""
        if fraction <= 0:
            self._end()
        if self._task is None:
            self._begun = time.monotonic()
            self._task = self._progress.add_task("", total=1.0)
        remaining = _time_left(time.monotonic() - self._begun, fraction)
        self._progress.update(self._task, completed=fraction, description=f"{text}{remaining}")
        if fraction >= 1.0:
            self._end()

    def _end(self) -> None:
        if self._task is not None:
            self._progress.remove_task(self._task)
            self._task = None


def _time_left(elapsed: float, fraction: float) -> str:
    if fraction <= 0.02 or fraction >= 1:
        return ""
    seconds = elapsed * (1 - fraction) / fraction
    time_left = f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
    return f", about {time_left} left"


def rest(seconds: float) -> None:
    """Wait; empty texts on stderr keep `guard.never_silent` quiet meanwhile."""
    times = math.ceil(seconds)
    for _ in range(times):
        if sys.stderr is not None:
            sys.stderr.write("")
        time.sleep(seconds / times)


@contextmanager
def reporter() -> Iterator[Reporter]:
    """Yield a `Bar` if stderr is a terminal, otherwise `Lines`; `Silent` without stderr."""
    if sys.stderr is None:
        yield Silent()
        return
    if not sys.stderr.isatty():
        yield Lines(sys.stderr)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    text = TextColumn("{task.percentage:3.0f} % {task.description}", markup=False)
    columns = (BarColumn(bar_width=24), TimeElapsedColumn(), text)
    with Progress(*columns, console=console, transient=True) as progress:
        yield Bar(console, progress)
