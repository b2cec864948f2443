"""Compute many jobs in processes of this machine or on a Dask cluster."""

from __future__ import annotations

import asyncio
import functools
import logging
import pickle
import re
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.processes import held_signals
from bayesdrill.basics.progress import Reporter
from bayesdrill.sampling.workers import ONE_THREAD, shut_down, start_workers

ADDRESS = re.compile(r"((tcp|tls|ws|wss)://)?(\[[0-9a-fA-F:]+\]|[^/:\s\[\]]+):\d{1,5}")
PATIENCE = 5.0  # seconds to wait for a scheduler, for a first worker and for an answer of a worker
WATCH = 2.0  # seconds between two checks of a cluster
SILENT_SECONDS = 20.0  # time without heartbeats (two per second) after which a worker is given up


@contextmanager
def local_executor(processes: int) -> Iterator[RefitExecutor]:
    """Yield an executor with `processes` workers, which are killed if the block raises."""
    pool = start_workers(processes, _nothing)
    try:
        yield RefitExecutor(pool)
    except BaseException:
        # A refit may take minutes, so workers are killed.  This truncates no result, since results
        # are short enough to pass a pipe in one piece.
        shut_down(pool, 0.0)
        raise
    pool.shutdown()


def _nothing() -> None:
    """Prepare nothing in a new worker, since each task contains all its data."""


@contextmanager
def dask_executor(scheduler: str) -> Iterator[RefitExecutor]:
    """Yield the workers of a `scheduler` (tcp://host:8786); raises `InputError` without workers."""
    try:
        from distributed import Client
    except ImportError:
        way_out = "install it with pip install 'bayesdrill[cluster]'"
        message = f"the package distributed is missing; {way_out}"
        raise InputError.at("--scheduler", message) from None
    if not ADDRESS.fullmatch(scheduler):
        message = f"'{scheduler}' is not an address of a scheduler; write it like tcp://host:8786"
        raise InputError.at("--scheduler", message)
    with _quiet():
        _check_answers(scheduler)
        client: Any = Client(scheduler, timeout=PATIENCE, set_as_default=False)  # type: ignore[no-untyped-call]
        cluster = Cluster(client)
        try:
            try:
                client.wait_for_workers(1, timeout=PATIENCE)
            except TimeoutError:
                start = f"dask worker {scheduler} --nthreads 1"
                message = f"{scheduler} has no workers; start some with `{start}`"
                raise InputError.at("--scheduler", message) from None
            cluster.compare(client.scheduler_info(n_workers=-1)["workers"])
            yield cluster
        finally:
            cluster.pool.shutdown(wait=False)
            with suppress(TimeoutError):  # the scheduler may have ended
                client.close(timeout=PATIENCE)


def _check_answers(scheduler: str) -> None:
    """Raise `InputError` if a scheduler does not answer; `Client` would wait for it for ever."""
    from distributed import rpc
    from distributed.security import Security

    call: dict[str, Any] = Security().get_connection_args("client")  # type: ignore[no-untyped-call]
    if scheduler.startswith(("tls", "wss")) and call.get("ssl_context") is None:
        message = "no certificates are configured, which tls:// and wss:// need; "
        message += "name them in distributed.comm.tls of Dask's configuration, or take tcp://"
        raise InputError.at("--scheduler", message)

    async def identity() -> None:
        async with rpc(scheduler, connection_args=call) as remote:  # type: ignore[no-untyped-call]
            await asyncio.wait_for(remote.identity(), PATIENCE)

    try:
        asyncio.run(identity())
    except Exception as error:  # another server at this address may answer anything
        text = str(error).partition("\n")[0] if isinstance(error, OSError) else "another program"
        reason = text or f"nothing in {PATIENCE:g} s"
        message = f"no scheduler answers at {scheduler} ({reason}); start one with `dask scheduler`"
        raise InputError.at("--scheduler", message) from None


class RefitExecutor:
    """An executor gives tasks to other processes; `watch` must be called every few seconds."""

    def __init__(self, pool: Executor) -> None:
        self.pool = pool

    def submit[**P, T](
        self, function: Callable[P, T], /, *arguments: P.args, **named: P.kwargs
    ) -> Future[T]:
        """Submit `function(...)` and return its future."""
        return self.pool.submit(function, *arguments, **named)

    def watch(self, say: Callable[[str], None]) -> str:
        """Return why no more results will come, or an empty text."""
        return ""


class Cluster(RefitExecutor):
    """A cluster executor gives tasks to the workers of a Dask scheduler."""

    def __init__(self, client: Any) -> None:
        super().__init__(client.get_executor(pure=False))
        self._client = client
        self._compared: set[str] = set()
        self._given_up: set[str] = set()
        # By address: a worker's last heartbeat in the scheduler's time, and when it was noticed here.
        self._heard: dict[str, tuple[float, float]] = {}
        self._last = self._looked = time.monotonic()

    def compare(self, workers: Collection[str]) -> None:
        """Raise `InputError` if the software of a worker differs from that of this process.

        This check comes before any task, as a worker silently ignores a task that it cannot load.
        """
        new = [worker for worker in workers if worker not in self._compared]
        installed, problems = software.installed_versions(), []
        for address, answer in zip(new, self._client.sync(self._versions, new), strict=True):
            if answer is None or isinstance(answer, OSError):  # the worker does not answer now
                continue
            self._compared.add(address)
            wrong = [f"no bayesdrill that can be loaded ({answer})"]
            if isinstance(answer, dict):
                wrong = software.version_differences(answer, installed)
            if wrong:
                message = f"it has {', '.join(wrong)}; install the same there"
                problems.append(Issue(f"worker {address}", message))
        if problems:
            raise InputError(problems)

    async def _versions(self, workers: Collection[str]) -> list[Any]:
        """Return the versions of each worker, or its error; None if it does not answer."""

        async def asked(address: str) -> Any:
            run = self._client.run(
                software.installed_versions, workers=[address], on_error="return"
            )
            with suppress(TimeoutError):
                return (await asyncio.wait_for(run, PATIENCE)).get(address)

        return await asyncio.gather(*map(asked, workers))

    def watch(self, say: Callable[[str], None]) -> str:
        """Give the tasks of silent workers to other workers; raises `InputError` like `compare`."""
        now, client = time.monotonic(), self._client
        if now - self._looked < WATCH:
            return ""
        self._looked = now
        try:
            versions = client.sync(
                client.scheduler.identity, n_workers=-1, callback_timeout=SILENT_SECONDS
            )
            self.compare(workers := versions["workers"])
        except (OSError, AttributeError):  # AttributeError: the client has given up
            return "the scheduler does not answer"
        for address in self._heard.keys() - workers.keys():
            del self._heard[address]
        for address, worker in workers.items():
            if self._heard.get(address, (None,))[0] != worker["last_seen"]:
                self._heard[address] = worker["last_seen"], now
        self._last = max([self._last, *(since for _, since in self._heard.values())])
        if now - self._last > SILENT_SECONDS:
            return f"no worker has answered for {SILENT_SECONDS:g} s"
        silent = {
            worker for worker, (_, since) in self._heard.items() if now - since > SILENT_SECONDS
        }
        for address in silent - self._given_up:
            self._given_up.add(address)
            say(f"worker {address} is silent; its work goes to the others")
            leave = {"address": address, "stimulus_id": f"silent-{time.time()}"}
            # Dask itself would wait longer for a silent worker.
            with suppress(OSError):
                client.sync(client.scheduler.unregister, **leave, callback_timeout=PATIENCE)
        return ""


def results[T](
    crew: RefitExecutor, futures: Collection[Future[T]], folder: Path, report: Reporter
) -> Iterator[tuple[Future[T], T]]:
    """Yield each future of `crew` with its result, as soon as the result is there.

    Raises `InputError`, at `folder`, if the workers are lost, and any error of a task.
    """
    done: SimpleQueue[Future[T]] = SimpleQueue()
    for future in futures:
        future.add_done_callback(done.put)
    for _ in futures:
        finished: Future[T] | None = None
        while finished is None:
            if reason := crew.watch(report.say):
                raise _lost(folder, reason)
            with suppress(Empty):
                finished = done.get(timeout=WATCH)
        try:
            yield finished, finished.result()
        except CancelledError:
            raise _lost(folder, "the scheduler is gone") from None
        except Exception as error:
            # `KilledWorker` of distributed (an optional package): workers died repeatedly.
            if type(error).__name__ != "KilledWorker":
                raise
            raise _lost(folder, "workers were killed again and again (out of memory?)") from None


def _lost(folder: Path, reason: str) -> InputError:
    return InputError.at(str(folder), f"{reason}; continue with --resume")


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the log of distributed, since a lost scheduler is reported in a sentence."""
    log = logging.getLogger("distributed.client")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


def run_jobs[K, T](
    crew: RefitExecutor,
    function: Callable[..., T],
    jobs: Mapping[K, tuple[bytes, *tuple[Any, ...]]],
    finish: Callable[[K, T], str],
    folder: Path,
    report: Reporter,
) -> None:
    """Compute `function` for each job, which has `packed` arguments and then further arguments.

    `finish` saves the result of a finished job in `folder`, and returns a text about the progress.
    A job that is computed twice, because a worker was lost, is saved once.  Raises like `results`.
    """
    versions = software.installed_versions()
    with held_signals():
        keys = {crew.submit(_work, function, versions, *job): key for key, job in jobs.items()}
    for count, (future, result) in enumerate(results(crew, keys, folder, report), 1):
        report.update(count / len(keys), finish(keys[future], result))
    report.update(1.0, "")


# A process computes one job at a time, as limits on threads hold for the whole process.
_ONE_AT_A_TIME = threading.Lock()


def packed(*arguments: Any) -> bytes:
    """Pickle `arguments` for other processes, which unpickle them and compile kernels only once."""
    return pickle.dumps(arguments)


_unpacked = functools.lru_cache(maxsize=1)(pickle.loads)


def _work[T](
    function: Callable[..., T], versions: Mapping[str, str], blob: bytes, *arguments: Any
) -> T:
    """Compute one job in a worker; raises `InputError` if its software has other versions."""
    if wrong := software.version_differences(software.installed_versions(), versions):
        raise InputError.at("a worker", f"it has {', '.join(wrong)}; install the same there")
    with _ONE_AT_A_TIME, ONE_THREAD:
        return function(*_unpacked(blob), *arguments)
