"""Work in processes: tasks `function(posterior, *arguments)` that need one posterior.

Every worker gets the posterior once, computes on one thread, and leaves Ctrl-C to the parent.
With one process the work is done in this one.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Concatenate, Self

from threadpoolctl import threadpool_limits

from bayesdrill.basics.errors import InputError
from bayesdrill.inference import step_error
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import StepSizes

SPAWN = multiprocessing.get_context("spawn")
PATIENCE = 10.0  # seconds that a worker has for its task, where the work is stopped
GRACE = 5.0  # seconds from SIGTERM to the end of a worker


class Crew:
    """A context manager; `submit` returns a future."""

    def __init__(self, posterior: Posterior, processes: int) -> None:
        self._posterior = posterior
        self._steps: dict[str, StepSizes] = {}
        self._pool: ProcessPoolExecutor | None = None
        if processes > 1:
            self._pool = workers(processes, _take, posterior)

    def submit[**P, T](
        self,
        function: Callable[Concatenate[Posterior, P], T],
        *arguments: P.args,
        **named: P.kwargs,
    ) -> Future[T]:
        if self._pool is not None:
            with ctrl_c_waits():
                return self._pool.submit(_work, self._steps, function, arguments, named)
        future: Future[T] = Future()
        with threadpool_limits(1):
            future.set_result(function(self._posterior, *arguments, **named))
        return future

    def run[**P, T](
        self, function: Callable[P, T], *arguments: P.args, **named: P.kwargs
    ) -> Future[T]:
        """As `submit`, of a function that needs another posterior than that of the crew."""
        return self.submit(_apart, function, arguments, named)

    def step(self, steps: Mapping[str, StepSizes]) -> None:
        """From now on the posterior is taken in these steps (`inference.step_error`)."""
        self._steps = dict(steps)
        self._posterior = step_error.with_steps(self._posterior, steps)

    @property
    def posterior(self) -> Posterior:
        """In the steps that it is taken in."""
        return self._posterior

    @property
    def alone(self) -> bool:
        """Whether the work is done in this process."""
        return self._pool is None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            closed(self._pool, PATIENCE)


def workers(processes: int, prepare: Callable[..., None], *arguments: Any) -> ProcessPoolExecutor:
    """Fresh processes that compute on one thread, leave Ctrl-C to this one and die with it.

    Each calls `prepare(*arguments)` before its first task.
    """
    try:
        with ctrl_c_waits():  # it starts a process that looks after its semaphores
            return ProcessPoolExecutor(
                max_workers=processes,
                mp_context=SPAWN,
                initializer=_enlist,
                initargs=(prepare, *arguments),
            )
    except OSError as error:  # its semaphores are files of /dev/shm, or the like
        reason = f"no worker processes can be started here ({error.strerror or error})"
        message = f"{reason}; see whether /dev/shm is full, or give --processes 1"
        raise InputError.one("", message) from None


def closed(pool: ProcessPoolExecutor, patience: float) -> None:
    """Ends a pool: its workers have `patience` seconds for the task that they are at.

    One that is ended while it hands over a long result leaves half a message, for whose rest the
    pool would wait; one that is stopped would never end by itself.
    """
    with ctrl_c_waits():
        pool.shutdown(wait=False, cancel_futures=True)
        end = time.monotonic() + patience
        for worker in multiprocessing.active_children():
            worker.join(max(0.0, end - time.monotonic()))
        for worker in multiprocessing.active_children():
            worker.kill()


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """Hold Ctrl-C and SIGHUP back for a moment: what starts meanwhile never hears of them at all."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def available() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# A worker process serves one posterior for all of its life; this is where it keeps it.
_POST: dict[str, Any] = {}


def _enlist(prepare: Callable[..., None], *arguments: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave_soon)
    threading.Thread(target=_outlive_no_parent, daemon=True).start()
    threadpool_limits(1)
    atexit.register(os._exit, 0)  # nothing is left to be saved: no need to take all apart
    prepare(*arguments)


def _take(posterior: Posterior) -> None:
    _POST["posterior"] = posterior


def _leave_soon(_number: int, _frame: object) -> None:
    """SIGTERM to all processes reaches this one too: the parent ends it, if it is given the time."""
    timer = threading.Timer(GRACE, os._exit, (1,))
    timer.daemon = True
    timer.start()


def _outlive_no_parent() -> None:
    """A parent that was killed cannot tell its workers to stop."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _apart(
    _: Posterior,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    named: dict[str, Any],
) -> Any:
    return function(*arguments, **named)


def _work(
    steps: dict[str, StepSizes],
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    named: dict[str, Any],
) -> Any:
    if steps:
        _take(step_error.with_steps(_POST["posterior"], steps))
    return function(_POST["posterior"], *arguments, **named)
