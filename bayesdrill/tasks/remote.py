"""Where long work is computed: processes of this machine or a Dask cluster; and many jobs there."""

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
from bayesdrill.basics.progress import Reporter
from bayesdrill.sampling.workers import ONE_THREAD, held_signals, shut_down, start_workers

ADDRESS = re.compile(r"((tcp|tls|ws|wss)://)?(\[[0-9a-fA-F:]+\]|[^/:\s\[\]]+):\d{1,5}")
PATIENCE = 5.0  # seconds for a scheduler to answer, a first worker, and what a worker is asked
WATCH = 2.0  # seconds between two looks at a cluster
SILENT_SECONDS = 20.0  # after which who says nothing is given up; heartbeats come twice a second


@contextmanager
def local_executor(processes: int) -> Iterator[RefitExecutor]:
    """`processes` workers; those still at a refit when the block is left by an error are ended."""
    pool = start_workers(processes, _nothing)
    try:
        yield RefitExecutor(pool)
    except BaseException:
        # A refit may take minutes, and is lost anyway.  Results are far shorter than what a pipe
        # takes in one piece, so that none is cut in the middle.
        shut_down(pool, 0.0)
        raise
    pool.shutdown()


def _nothing() -> None:
    """All that a worker has to prepare: each task brings what it needs."""


@contextmanager
def dask_executor(scheduler: str) -> Iterator[RefitExecutor]:
    """The workers of `scheduler`, such as tcp://host:8786; raises `InputError` without them."""
    try:
        from distributed import Client
    except ImportError:
        way_out = "install it with pip install 'bayesdrill[cluster]'"
        message = f"the package distributed is missing; {way_out}"
        raise InputError.at("--scheduler", message) from None
    if not ADDRESS.fullmatch(scheduler):
        message = f"'{scheduler}' is no address of a scheduler; write it like tcp://host:8786"
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
            with suppress(TimeoutError):  # of a scheduler that no longer answers
                client.close(timeout=PATIENCE)


def _check_answers(scheduler: str) -> None:
    """Raises `InputError`; `Client` itself waits without end for one that listens and says nothing."""
    from distributed import rpc
    from distributed.security import Security

    call: dict[str, Any] = Security().get_connection_args("client")  # type: ignore[no-untyped-call]
    if scheduler.startswith(("tls", "wss")) and call.get("ssl_context") is None:
        message = "no certificates are configured, without which tls:// and wss:// cannot be; "
        message += "name them in distributed.comm.tls of Dask's configuration, or take tcp://"
        raise InputError.at("--scheduler", message)

    async def identity() -> None:
        async with rpc(scheduler, connection_args=call) as remote:  # type: ignore[no-untyped-call]
            await asyncio.wait_for(remote.identity(), PATIENCE)

    try:
        asyncio.run(identity())
    except Exception as error:  # whatever else listens there may answer anything
        told = str(error).partition("\n")[0] if isinstance(error, OSError) else "what does is none"
        reason = told or f"nothing in {PATIENCE:g} s"
        message = f"no scheduler answers at {scheduler} ({reason}); start one with `dask scheduler`"
        raise InputError.at("--scheduler", message) from None


class RefitExecutor:
    """Processes of this machine; whoever waits for what they do calls `watch` now and then."""

    def __init__(self, pool: Executor) -> None:
        self.pool = pool

    def submit[**P, T](
        self, function: Callable[P, T], /, *arguments: P.args, **named: P.kwargs
    ) -> Future[T]:
        """Submit `function(...)` and return its future."""
        return self.pool.submit(function, *arguments, **named)

    def watch(self, say: Callable[[str], None]) -> str:
        """Why nothing will come any more; empty while something may."""
        return ""


class Cluster(RefitExecutor):
    """The workers of a scheduler."""

    def __init__(self, client: Any) -> None:
        super().__init__(client.get_executor(pure=False))
        self._client = client
        self._compared: set[str] = set()
        self._given_up: set[str] = set()
        # By address: the scheduler's time of a worker's last word, and when that was new to us.
        self._heard: dict[str, tuple[float, float]] = {}
        self._last = self._looked = time.monotonic()

    def compare(self, workers: Collection[str]) -> None:
        """Raises `InputError` where one has other software than this process.

        One that cannot load a task leaves it lie without a word; so this is asked before.
        """
        new = [worker for worker in workers if worker not in self._compared]
        installed, problems = software.installed_versions(), []
        for address, there in zip(new, self._client.sync(self._versions, new), strict=True):
            if there is None or isinstance(there, OSError):  # it cannot be asked now
                continue
            self._compared.add(address)
            wrong = [f"no bayesdrill that can be loaded ({there})"]
            if isinstance(there, dict):
                wrong = software.version_differences(there, installed)
            if wrong:
                message = f"it has {', '.join(wrong)}; install the same there"
                problems.append(Issue(f"worker {address}", message))
        if problems:
            raise InputError(problems)

    async def _versions(self, workers: Collection[str]) -> list[Any]:
        """Of each, or why not; None of one that does not answer."""

        async def asked(address: str) -> Any:
            run = self._client.run(
                software.installed_versions, workers=[address], on_error="return"
            )
            with suppress(TimeoutError):
                return (await asyncio.wait_for(run, PATIENCE)).get(address)

        return await asyncio.gather(*map(asked, workers))

    def watch(self, say: Callable[[str], None]) -> str:
        """What a worker had that is heard no more goes to the others. Raises as `compare` does."""
        now, client = time.monotonic(), self._client
        if now - self._looked < WATCH:
            return ""
        self._looked = now
        try:
            versions = client.sync(
                client.scheduler.identity, n_workers=-1, callback_timeout=SILENT_SECONDS
            )
            self.compare(workers := versions["workers"])
        except (OSError, AttributeError):  # AttributeError: the client has given it up
            return "the scheduler does not answer"
        for address in self._heard.keys() - workers.keys():
            del self._heard[address]
        for address, worker in workers.items():
            if self._heard.get(address, (None,))[0] != worker["last_seen"]:
                self._heard[address] = worker["last_seen"], now
        self._last = max([self._last, *(since for _, since in self._heard.values())])
        if now - self._last > SILENT_SECONDS:
            return f"no worker has been heard of for {SILENT_SECONDS:g} s"
        silent = {
            worker for worker, (_, since) in self._heard.items() if now - since > SILENT_SECONDS
        }
        for address in silent - self._given_up:
            self._given_up.add(address)
            say(f"worker {address} is silent; what it had is done by the others")
            leave = {"address": address, "stimulus_id": f"silent-{time.time()}"}
            # As it does itself when it leaves; else Dask's own patience ends.
            with suppress(OSError):
                client.sync(client.scheduler.unregister, **leave, callback_timeout=PATIENCE)
        return ""


def results[T](
    crew: RefitExecutor, futures: Collection[Future[T]], folder: Path, report: Reporter
) -> Iterator[tuple[Future[T], T]]:
    """Each future of `crew` with what it gave, as soon as it is done; `folder` keeps what is saved.

    Raises `InputError` where workers cannot do it, or none is left, and what a task raised.
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
            # Of distributed, which may be missing here: a task whose workers died again and again.
            if type(error).__name__ != "KilledWorker":
                raise
            raise _lost(folder, "workers were killed again and again (out of memory?)") from None


def _lost(folder: Path, reason: str) -> InputError:
    return InputError.at(str(folder), f"{reason}; continue with --resume")


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


def run_jobs[K, T](
    crew: RefitExecutor,
    function: Callable[..., T],
    jobs: Mapping[K, tuple[bytes, *tuple[Any, ...]]],
    finish: Callable[[K, T], str],
    folder: Path,
    report: Reporter,
) -> None:
    """Compute `function` of what each job has `packed` and of its further arguments, wherever that is.

    `finish`: keeps what one gave, as soon as it is done, and says how far all are; `folder` has what is
    kept.  A job that is computed twice, as a worker was lost, is finished once.  Raises as `results`.
    """
    versions = software.installed_versions()
    with held_signals():
        keys = {crew.submit(_work, function, versions, *job): key for key, job in jobs.items()}
    for count, (future, result) in enumerate(results(crew, keys, folder, report), 1):
        report.update(count / len(keys), finish(keys[future], result))
    report.update(1.0, "")


# A process computes one job at a time, whoever asks: limits on threads hold for all of it.
_ONE_AT_A_TIME = threading.Lock()


def packed(*arguments: Any) -> bytes:
    """Pickle `arguments` for other processes: compiled code is left out, and is made once by each."""
    return pickle.dumps(arguments)


_unpacked = functools.lru_cache(maxsize=1)(pickle.loads)


def _work[T](
    function: Callable[..., T], versions: Mapping[str, str], blob: bytes, *arguments: Any
) -> T:
    """Compute one job where the software is the same; raises `InputError` elsewhere."""
    if wrong := software.version_differences(software.installed_versions(), versions):
        raise InputError.at("a worker", f"it has {', '.join(wrong)}; install the same there")
    with _ONE_AT_A_TIME, ONE_THREAD:
        return function(*_unpacked(blob), *arguments)
