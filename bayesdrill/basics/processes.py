"""Start worker processes: forked from a server that has loaded what they need, or afresh.

A process that has threads, such as that of a notebook, cannot be forked safely.  On Linux workers are
therefore forked from a server (`multiprocessing.forkserver`), which is a fresh process with one
thread.  It loads the libraries once for all workers, while its parent reads config and record.  On
other systems, whose own libraries start threads, each worker is a fresh process.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, resource_tracker

FORKED = sys.platform == "linux"
CONTEXT: multiprocessing.context.BaseContext = multiprocessing.get_context(
    "forkserver" if FORKED else "spawn"
)
PRELOADED = "bayesdrill.sampling.preloaded"  # the module that loads what workers need
STOPPING = ("SIGINT", "SIGHUP", "SIGTERM")
# The server has one thread, so that its memory can be forked; so have its workers.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}


def available_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def held_signals() -> Iterator[None]:
    """Block signals that end a run in this context, and in processes that are started inside."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    held = {getattr(signal, name) for name in STOPPING}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, held)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_server() -> None:
    """Start the server if workers are forked and it does not run yet; return without waiting for it.

    Raises `OSError` if the system has no room for it.
    """
    # The resource tracker survives a run that is killed, and removes its semaphores.  Its warning
    # would appear on a terminal where the next run has begun.
    with held_signals():
        sys.warnoptions.append("ignore:resource_tracker")
        resource_tracker.ensure_running()
        sys.warnoptions.pop()
        if FORKED:
            before = {name: os.environ.get(name) for name in ONE_THREAD}
            os.environ.update(ONE_THREAD)
            forkserver.set_forkserver_preload([PRELOADED])
            forkserver.ensure_running()
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})
