"""Start worker processes, forked from a server with loaded libraries, or fresh ones.

A process that has threads, such as that of a notebook, cannot be forked safely.  On Linux workers
are therefore forked from a server (`multiprocessing.forkserver`), a fresh process with one thread.
The server loads the libraries once for all workers, while its parent reads config and record.  An
application that uses this package may have another server, with other libraries and limits.  If no
server can be started, and on systems whose libraries start threads, each worker is a fresh process.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import BaseContext

FORKED = sys.platform == "linux"
SPAWN = multiprocessing.get_context("spawn")
PRELOADED = "bayesdrill.sampling.preloaded"  # module that loads the workers' libraries
STOPPING = ("SIGINT", "SIGHUP", "SIGTERM")
# Only a server with one thread can be forked.  Its workers have one thread, too.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}
STARTING = threading.Lock()  # several threads may start workers


def available_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def held_signals() -> Iterator[None]:
    """Block signals that end a run, here and in processes that this context starts."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    held = {getattr(signal, name) for name in STOPPING}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, held)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Change variables of the environment in this context."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def start_server() -> BaseContext:
    """Start the server unless it runs, without waiting for it; return the context of workers.

    Workers of this context are forked from the server, or fresh if the server cannot start: its
    socket needs a temporary directory with a path of at most some 80 bytes.
    """
    with STARTING:
        # The resource tracker survives a killed run and removes its semaphores.  The tracker's
        # warning would appear on the terminal of the next run.
        with held_signals():
            sys.warnoptions.append("ignore:resource_tracker")
            try:
                resource_tracker.ensure_running()
            finally:
                sys.warnoptions.pop()
        if not FORKED:
            return SPAWN
        from bayesdrill.basics import forking

        # The server has the import path of this process, without the current directory, which may
        # contain a `corner.py` of the user.
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        own = {**ONE_THREAD, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
        try:  # the start of the tracker unblocked the signals
            forking.SERVER.set_forkserver_preload([PRELOADED])
            with held_signals(), environment(own):
                forking.SERVER.ensure_running()
        except OSError:
            return SPAWN
        return forking.CONTEXT
