"""Start worker processes, which are forked from a server with loaded libraries, or spawned.

A process with several threads, such as that of a notebook, cannot be forked safely.  On Linux,
workers are therefore forked from a server (`multiprocessing.forkserver`), which has one thread.  It
loads the libraries once for all workers, while the parent process reads the config and the record.
The application that uses this package may have another fork server, with other libraries.  On other
systems, or if the server cannot start, each worker is a new process ("spawn").
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
PRELOADED = "bayesdrill.sampling.preloaded"  # module whose import loads the libraries
STOPPING = ("SIGINT", "SIGHUP", "SIGTERM")
# Keep libraries single-threaded in the server, so that it can be forked, and in its workers.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}
STARTING = threading.Lock()  # several threads may start workers at the same time


def available_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def held_signals() -> Iterator[None]:
    """Block the signals `STOPPING` in this thread, and in processes started in the block."""
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
    """Change environment variables within the block."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def start_server() -> BaseContext:
    """Start the server if it does not run, and return a context that starts workers.

    The function does not wait for the server.  Workers are spawned if the server cannot start.  The
    path of the temporary directory, which has the server's socket, may have about 80 bytes at most.
    """
    with STARTING:
        # If a run is killed, the resource tracker removes its semaphores and warns about them.  The
        # warning is switched off, since it would appear in the output of the next run.
        with held_signals():
            sys.warnoptions.append("ignore:resource_tracker")
            try:
                resource_tracker.ensure_running()
            finally:
                sys.warnoptions.pop()
        if not FORKED:
            return SPAWN
        from bayesdrill.basics import forking

        # The server gets the import path of this process, but not the current directory: a user's
        # `corner.py` there would replace the library.
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        own = {**ONE_THREAD, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
        try:  # signals are blocked again, as the tracker's start unblocked them
            forking.SERVER.set_forkserver_preload([PRELOADED])
            with held_signals(), environment(own):
                forking.SERVER.ensure_running()
        except OSError:
            return SPAWN
        return forking.CONTEXT
