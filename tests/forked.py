"""The command line in a child forked from this process, with bounds on its time and memory."""

from __future__ import annotations

import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

SECONDS = 20.0
MEMORY = 2 * 1024**3  # beyond what the parent has


@dataclass(frozen=True)
class Ended:
    """`status`: of the exit, or minus the number of the signal that ended it."""

    status: int
    text: str
    hung: bool

    @property
    def traceback(self) -> bool:
        return "Traceback (most recent call last)" in self.text


def ran(arguments: Sequence[str | Path], cwd: Path, seconds: float = SECONDS) -> Ended:
    """Killed, with all that it started, where it takes longer than `seconds`."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        _inside([str(argument) for argument in arguments], cwd, into)
    os.close(into)
    return _watched(child, out, time.monotonic() + seconds)


def _inside(arguments: list[str], cwd: Path, into: int) -> None:
    """Never returns."""
    status = 1
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.chdir(cwd)
        os.dup2(into, 1)
        os.dup2(into, 2)
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        own = _virtual()
        resource.setrlimit(resource.RLIMIT_AS, (own + MEMORY, own + MEMORY))
        from bayesdrill.cli import main

        sys.argv = ["bayesdrill", *arguments]
        main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(bool(end.code))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _virtual() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()


def _watched(child: int, out: int, end: float) -> Ended:
    said, hung = [], False
    with os.fdopen(out, "rb") as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                hung = True
                break
            block = os.read(pipe.fileno(), 65536)
            if not block:
                break
            said.append(block)
    if hung:
        os.killpg(child, signal.SIGKILL)
    _, code = os.waitpid(child, 0)
    text = b"".join(said).decode("utf-8", "replace")
    return Ended(os.waitstatus_to_exitcode(code), text, hung)
