"""Work in processes: tasks `function(posterior, *arguments)` that need one posterior.

Every worker gets the posterior once, computes on one thread, and leaves Ctrl-C to the parent.
With one process the work is done in this one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Concatenate, Self

from threadpoolctl import threadpool_limits

from bayesdrill.posterior import Posterior

SPAWN = multiprocessing.get_context("spawn")


class Crew:
    """A context manager; `submit` returns a future."""

    def __init__(self, posterior: Posterior, processes: int) -> None:
        self._posterior = posterior
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
                return self._pool.submit(_work, function, arguments, named)
        future: Future[T] = Future()
        with threadpool_limits(1):
            future.set_result(function(self._posterior, *arguments, **named))
        return future

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
        # Workers finish the short task that they are at: one that is ended while it hands over a
        # result leaves half a message, for whose rest the pool would wait for ever.
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)


def workers(processes: int, prepare: Callable[..., None], *arguments: Any) -> ProcessPoolExecutor:
    """Fresh processes that compute on one thread, leave Ctrl-C to this one and die with it.

    Each calls `prepare(*arguments)` before its first task.
    """
    return ProcessPoolExecutor(
        max_workers=processes,
        mp_context=SPAWN,
        initializer=_enlist,
        initargs=(prepare, *arguments),
    )


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """Hold Ctrl-C back for a moment: a worker that starts meanwhile never hears of it at all."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
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
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_outlive_no_parent, daemon=True).start()
    threadpool_limits(1)
    prepare(*arguments)


def _take(posterior: Posterior) -> None:
    _POST["posterior"] = posterior


def _outlive_no_parent() -> None:
    """A parent that was killed cannot tell its workers to stop."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(function: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
    return function(_POST["posterior"], *arguments, **named)
