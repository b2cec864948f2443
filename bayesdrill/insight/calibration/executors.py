"""Where refits are computed: processes of this machine, or a Dask cluster. Both are `Executor`s."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any

from bayesdrill.basics.errors import InputError
from bayesdrill.engines.workers import closed, workers

ADDRESS = re.compile(r"((tcp|tls|ws|wss)://)?(\[[0-9a-fA-F:]+\]|[^/:\s\[\]]+):\d{1,5}")
PATIENCE = 5.0  # seconds for a scheduler to answer, and then for a first worker


@contextmanager
def local(processes: int) -> Iterator[Executor]:
    """`processes` workers; those still at a refit when the block is left by an error are ended."""
    pool = workers(processes, _nothing)
    try:
        yield pool
    except BaseException:
        # A refit may take minutes, and is lost anyway.  Results are far shorter than what a pipe
        # takes in one piece, so that none is cut in the middle.
        closed(pool, 0.0)
        raise
    pool.shutdown()


def _nothing() -> None:
    """All that a worker has to prepare: each task brings what it needs."""


@contextmanager
def dask(scheduler: str) -> Iterator[Executor]:
    """The workers of `scheduler`, such as tcp://host:8786; raises `InputError` without them."""
    try:
        from distributed import Client
    except ImportError:
        message = (
            "the package distributed is missing; install it with pip install 'bayesdrill[cluster]'"
        )
        raise InputError.one("--scheduler", message) from None
    if not ADDRESS.fullmatch(scheduler):
        message = f"'{scheduler}' is no address of a scheduler; write it like tcp://host:8786"
        raise InputError.one("--scheduler", message)
    try:
        client: Any = Client(scheduler, timeout=PATIENCE, set_as_default=False)  # type: ignore[no-untyped-call]
    except OSError as error:
        reason = str(error).partition("\n")[0]
        message = f"no scheduler answers at {scheduler} ({reason}); start one with `dask scheduler`"
        raise InputError.one("--scheduler", message) from None
    with client, _quiet():
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            start = f"dask worker {scheduler} --nthreads 1"
            message = f"{scheduler} has no workers; start some with `{start}`"
            raise InputError.one("--scheduler", message) from None
        executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


@contextmanager
def _quiet() -> Iterator[None]:
    """A scheduler that goes away is told in a sentence, not in the tracebacks of distributed's log."""
    log = logging.getLogger("distributed.client")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)
