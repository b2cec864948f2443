"""Run tasks `function(posterior, *arguments)` in worker processes that share one posterior.

Every worker gets the posterior once, computes on one thread, and leaves Ctrl-C to the parent. With
one process, this process does the work, also on one thread.  Sums by several threads depend on the
number of threads, so chains would depend on the machine.
"""

from __future__ import annotations

import atexit
import importlib
import mmap
import multiprocessing
import os
import pickle
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Concatenate, Self, cast

from threadpoolctl import threadpool_limits

from bayesdrill.basics.errors import InputError
from bayesdrill.basics.processes import PRELOADED, held_signals, start_server
from bayesdrill.inference import step_error
from bayesdrill.inference.compression import Compressions, compressed
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import StepSizes

TASK_SECONDS = 10.0  # seconds for a worker to finish its task when the work is stopped
PIPE = 1 << 15  # number of bytes that a pipe takes at once; larger arrays go into a file
ALIGNED = 64  # alignment of arrays in that file, in bytes
SIGTERM_SECONDS = 5.0  # seconds from SIGTERM to the end of a worker


class _OneThread:
    """Limit linear algebra to one thread in this context.

    The limit holds for the process: the first context sets it, and the last one removes it.
    """

    def __init__(self) -> None:
        self._lock, self._inside = threading.Lock(), 0

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                importlib.import_module("scipy.linalg")  # so that its threads are limited, too
                self._limits = threadpool_limits(1)
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._limits.restore_original_limits()


ONE_THREAD = _OneThread()


@dataclass(frozen=True, slots=True)
class _Form:
    """A form has the step sizes and compressed records that workers apply to their posterior."""

    step_sizes: Mapping[str, StepSizes] = field(default_factory=dict)
    compressions: Compressions = field(default_factory=dict)
    version: int = 0

    def of_posterior(self, posterior: Posterior) -> Posterior:
        return compressed(step_error.with_steps(posterior, self.step_sizes), self.compressions)


@dataclass(frozen=True, slots=True)
class _Copy:
    """A copy is a posterior pickled as `data`; its arrays may be in bytes `spans` of a file."""

    data: bytes
    spans: tuple[tuple[int, int], ...] = ()
    path: str = ""

    def posterior(self) -> Posterior:
        if not self.path:
            return cast(Posterior, pickle.loads(self.data))
        with open(self.path, "rb") as file:
            block = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        arrays = [block[first:last] for first, last in self.spans]
        return cast(Posterior, pickle.loads(self.data, buffers=arrays))


def _copy_posterior(posterior: Posterior) -> tuple[_Copy, IO[bytes] | None]:
    """Return a copy for workers and, if its arrays are large, the open file that contains them.

    All workers map this file, since a pipe with large arrays would block until a worker has
    started.  The file has no name, so it never remains on the disk.  If workers cannot open such a
    file, each worker gets its own copy of the arrays.
    """
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(posterior, protocol=5, buffer_callback=buffers.append)
    views = [buffer.raw() for buffer in buffers]
    if sum(view.nbytes for view in views) > PIPE and Path("/proc/self/fd").is_dir():
        with suppress(OSError):
            file, spans = tempfile.TemporaryFile(), list[tuple[int, int]]()  # noqa: SIM115
            for view in views:
                first = -(-file.tell() // ALIGNED) * ALIGNED
                file.seek(first)
                file.write(view)
                spans.append((first, first + view.nbytes))
            file.flush()
            return _Copy(data, tuple(spans), f"/proc/{os.getpid()}/fd/{file.fileno()}"), file
    return _Copy(pickle.dumps(posterior)), None


class WorkerPool:
    """A pool, which is a context manager, has workers that share one `posterior`."""

    def __init__(self, posterior: Posterior, processes: int) -> None:
        self.posterior, self.processes = posterior, processes
        self._form = _Form()
        self._pool: ProcessPoolExecutor | None = None
        self._arrays: IO[bytes] | None = None
        if processes > 1:
            copied, self._arrays = _copy_posterior(posterior)
            self._pool = start_workers(processes, _set_copied, copied)

    def submit[**P, T](
        self,
        function: Callable[Concatenate[Posterior, P], T],
        *arguments: P.args,
        **named: P.kwargs,
    ) -> Future[T]:
        """Submit `function(posterior, ...)` and return its future."""
        if self._pool is not None:
            with held_signals():
                return self._pool.submit(
                    _call_with_posterior, self._form, function, *arguments, **named
                )
        future: Future[T] = Future()
        future.set_result(function(self.posterior, *arguments, **named))
        return future

    def submit_function[**P, T](
        self, function: Callable[P, T], *arguments: P.args, **named: P.kwargs
    ) -> Future[T]:
        """Submit a function that does not need the posterior of the pool."""
        return self.submit(_call, function, *arguments, **named)

    def map_each[A, T](self, function: Callable[[A], T], items: Iterable[A]) -> list[T]:
        """Return `function(item)` for each item; the function gets no posterior."""
        tasks = [self.submit_function(function, item) for item in items]
        return [task.result() for task in tasks]

    def set_steps(self, steps: Mapping[str, StepSizes]) -> None:
        """Use the posterior with these step sizes from now on (`inference.step_error`)."""
        self._change(_Form(dict(steps), self._form.compressions, self._form.version + 1))

    def compress(self, compressions: Compressions) -> None:
        """Use the posterior with these compressed records from now on (`inference.compression`)."""
        if compressions:
            self._change(_Form(self._form.step_sizes, compressions, self._form.version + 1))

    def _change(self, form: _Form) -> None:
        self._form, self.posterior = form, form.of_posterior(self.posterior)

    @property
    def in_process(self) -> bool:
        """Return whether the work is done in this process."""
        return self._pool is None

    def __enter__(self) -> Self:
        ONE_THREAD.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        ONE_THREAD.__exit__()
        if self._pool is not None:
            shut_down(self._pool, TASK_SECONDS)
        if self._arrays is not None:
            self._arrays.close()


def start_workers(
    processes: int, prepare: Callable[..., None], *arguments: Any
) -> ProcessPoolExecutor:
    """Start processes that compute on one thread, ignore Ctrl-C, and end with this process.

    Each process first calls `prepare(*arguments)`.  Raises `InputError` if no process can start.
    """
    try:
        context = start_server()
        with held_signals():
            return ProcessPoolExecutor(
                max_workers=processes,
                mp_context=context,
                initializer=_start_worker,
                initargs=({**os.environ}, prepare, *arguments),
            )
    except OSError as error:  # semaphores are files in /dev/shm or a similar folder
        reason = f"no worker processes can be started here ({error.strerror or error})"
        message = f"{reason}; see whether /dev/shm is full, or give --processes 1"
        raise InputError.at("", message) from None


def shut_down(pool: ProcessPoolExecutor, patience: float) -> None:
    """Shut down a pool, whose workers have `patience` seconds to finish their tasks.

    `pool.shutdown` alone would wait for ever for a suspended worker, or for the rest of a killed
    worker's result.  The pool's thread holds a lock while it removes semaphores.  A process that
    is forked at this time would inherit the lock, so this function waits for the thread.
    """
    workers = list((pool._processes or {}).values())  # no other child processes
    thread: Any = pool._executor_manager_thread
    with held_signals():
        pool.shutdown(wait=False, cancel_futures=True)
        end = time.monotonic() + patience
        for worker in workers:
            worker.join(max(0.0, end - time.monotonic()))
        for worker in workers:
            worker.kill()
        if thread is not None:
            thread.join(1.0)


# In a worker process, this contains its posterior and the version of its form.
_WORKER: dict[str, Any] = {}


def _start_worker(
    environment: Mapping[str, str], prepare: Callable[..., None], *arguments: Any
) -> None:
    os.environ.clear()  # the server's environment may be older
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _exit_soon)
    if hasattr(signal, "pthread_sigmask"):  # the server started with blocked signals
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    ONE_THREAD.__enter__()
    importlib.import_module(PRELOADED)  # no-op if forked from the server
    atexit.register(os._exit, 0)  # nothing has to be saved or cleaned up
    prepare(*arguments)


def _set_copied(copied: _Copy) -> None:
    _WORKER.update(posterior=copied.posterior(), version=0)


def _exit_soon(_number: int, _frame: object) -> None:
    """Exit `SIGTERM_SECONDS` after SIGTERM, unless the parent stops this process earlier."""
    timer = threading.Timer(SIGTERM_SECONDS, os._exit, (1,))
    timer.daemon = True
    timer.start()


def _exit_with_parent() -> None:
    """Exit when the parent has ended, since a killed parent cannot stop its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _call(_: Posterior, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    return function(*arguments, **named)


def _call_with_posterior(
    form: _Form, function: Callable[..., Any], *arguments: Any, **named: Any
) -> Any:
    if form.version > _WORKER["version"]:
        _WORKER.update(posterior=form.of_posterior(_WORKER["posterior"]), version=form.version)
    return function(_WORKER["posterior"], *arguments, **named)
