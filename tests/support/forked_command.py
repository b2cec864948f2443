"""The command line in a child forked from this process, with bounds on its time and memory."""

import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

SECONDS = 20.0
MEMORY = 2 * 1024**3  # beyond what the parent has


@dataclass(frozen=True)
class Ended:
    """`status`: of the exit, or minus the number of the signal that ended it.

    `silence`: the longest time in which nothing was printed, in seconds.
    """

    status: int
    text: str
    hung: bool
    silence: float = 0.0

    @property
    def traceback(self) -> bool:
        return "Traceback (most recent call last)" in self.text


def ran(arguments: Sequence[str | Path], cwd: Path, seconds: float = SECONDS) -> Ended:
    """Killed, with all that it started, where it takes longer than `seconds`."""

    def command() -> None:
        from bayesdrill.cli import main

        sys.argv = ["bayesdrill", *map(str, arguments)]
        main()

    return called(command, cwd, seconds)


def called(what: Callable[[], object], cwd: Path, seconds: float = SECONDS) -> Ended:
    """As `ran`, of a call; an `InputError` has the status that it has on the command line."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        _inside(what, cwd, into)
    os.close(into)
    return _watched(child, out, time.monotonic() + seconds)


def _inside(what: Callable[[], object], cwd: Path, into: int) -> None:
    """Never returns."""
    from bayesdrill.basics.errors import InputError

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
        what()
        status = 0
    except InputError as error:
        print(repr(str(error)))
        status = 2
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
    said, hung, silence, last = [], False, 0.0, time.monotonic()
    with os.fdopen(out, "rb") as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                hung = True
                break
            block = os.read(pipe.fileno(), 65536)
            silence, last = max(silence, time.monotonic() - last), time.monotonic()
            if not block:
                break
            said.append(block)
    if hung:
        os.killpg(child, signal.SIGKILL)
    _, code = os.waitpid(child, 0)
    text = b"".join(said).decode("utf-8", "replace")
    return Ended(os.waitstatus_to_exitcode(code), text, hung, silence)
