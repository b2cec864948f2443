"""Clusters that fail: each ends in a sentence within half a minute, or the work goes on."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest

from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Silent
from bayesdrill.tasks import remote
from bayesdrill.tasks.remote import Cluster

Answer = Callable[[socket.socket], object]
FOLDER = Path("out")


def silence(_: socket.socket) -> None:
    pass


def nonsense(call: socket.socket) -> None:
    call.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 20)


def zeros(call: socket.socket) -> None:
    call.sendall(bytes(4096))


def hangs_up(call: socket.socket) -> None:
    call.close()


@pytest.fixture
def listening() -> Iterator[Callable[[Answer], str]]:
    """`host:port` where something listens that is no scheduler, and answers as it is told."""
    server, calls = socket.create_server(("127.0.0.1", 0)), []

    def listen(answer: Answer) -> None:
        while True:
            try:
                call, _ = server.accept()
                calls.append(call)
                answer(call)
            except OSError:
                return

    def start(answer: Answer) -> str:
        threading.Thread(target=listen, args=(answer,), daemon=True).start()
        return f"127.0.0.1:{server.getsockname()[1]}"

    yield start
    server.shutdown(socket.SHUT_RDWR)
    server.close()
    for call in calls:
        call.close()


def refused(address: str) -> str:
    with pytest.raises(InputError) as wrong, remote.dask_executor(address):
        pass
    (problem,) = wrong.value.problems
    assert problem.place == "--scheduler"
    return problem.message


@pytest.mark.parametrize("answer", [silence, nonsense, zeros, hangs_up])
def test_what_listens_and_is_no_scheduler_is_named(
    answer: Answer, listening: Callable[[Answer], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mutant killed: `Client` is left to find out; it waits for ever, or leaves a traceback."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(remote, "PATIENCE", 0.3)
    address = listening(answer)
    begun = time.monotonic()
    assert f"no scheduler answers at tcp://{address}" in refused(f"tcp://{address}")
    assert time.monotonic() - begun < 30


@pytest.mark.parametrize("kind", ["tls", "wss"])
def test_certificates_that_are_missing_are_asked_for(kind: str) -> None:
    pytest.importorskip("distributed")
    assert "no certificates" in refused(f"{kind}://127.0.0.1:8786")


class Client:
    """As `distributed.Client`: `seen` is when each worker said its last word, `there` what it has."""

    def __init__(self, **workers: object) -> None:
        self.seen = dict.fromkeys(workers, 0)
        self.there = workers
        self.scheduler = self
        self.hangs = False

    def get_executor(self, **_: object) -> None:
        return None

    def sync(self, function: Callable[..., object], *arguments: object, **named: object) -> object:
        named.pop("callback_timeout", None)
        if self.hangs:
            raise TimeoutError
        return asyncio.run(function(*arguments, **named))  # type: ignore[arg-type]

    async def identity(self, n_workers: int) -> dict[str, object]:
        assert n_workers == -1  # of all
        return {"workers": {name: {"last_seen": when} for name, when in self.seen.items()}}

    async def run(self, asked: object, workers: list[str], on_error: str) -> dict[str, object]:
        assert (asked, on_error) == (software.installed_versions, "return")
        return {name: self.there[name] for name in workers if name in self.there}

    async def unregister(self, address: str, stimulus_id: str) -> None:
        del self.seen[address]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "WATCH", 0.01)
    monkeypatch.setattr(remote, "SILENT_SECONDS", 0.2)


def never() -> Future[int]:
    return Future()


def ends(client: Client, *futures: Future[int]) -> str:
    """What is said of work that can come to no end."""
    with pytest.raises(InputError) as wrong:
        list(remote.results(Cluster(client), futures, FOLDER, Silent()))
    return str(wrong.value)


OTHER = {**software.installed_versions(), "bayesdrill": "0.0.9"}


@pytest.mark.parametrize(
    ("there", "told"),
    [
        (OTHER, "bayesdrill 0.0.9 instead of"),
        (ModuleNotFoundError("No module named 'bayesdrill'"), "No module named 'bayesdrill'"),
        (AttributeError("no versions"), "no versions"),
    ],
)
def test_a_worker_with_other_software_is_named_before_it_has_work(
    there: object, told: str, quick: None
) -> None:
    """Also one that comes later; kills comparing within the task, which may never be loaded."""
    own = software.installed_versions()
    with pytest.raises(InputError, match="worker b: ") as wrong:
        Cluster(Client(a=own, b=there)).compare(["a", "b"])
    assert told in str(wrong.value)
    assert "install the same there" in str(wrong.value)
    assert told in ends(Client(a=own, b=there), never())


def test_a_worker_that_cannot_be_asked_now_is_not_judged() -> None:
    own = software.installed_versions()
    Cluster(Client(a=own, b=TimeoutError(), c=OSError("gone"))).compare(["a", "b", "c", "d"])


def test_without_workers_the_work_ends(quick: None) -> None:
    """They were killed, and none came back."""
    assert "no worker has been heard of for" in ends(Client(), never())
    assert "continue with --resume" in ends(Client(), never())


def test_workers_that_fall_silent_are_as_good_as_dead(quick: None) -> None:
    """As a stopped one, whose socket stays open; kills counting the workers that are known."""
    own = software.installed_versions()
    client = Client(a=own, b=own)
    assert "no worker has been heard of for" in ends(client, never())
    assert client.seen.keys() == {"a", "b"}  # there are no others to do what they had


def test_what_a_silent_worker_had_goes_to_the_others(quick: None) -> None:
    client, future, said = (
        Client(a=software.installed_versions(), b=software.installed_versions()),
        never(),
        [],
    )

    class Telling(Silent):
        def say(self, text: str) -> None:
            said.append(text)

    async def leave(**worker: str) -> None:
        await Client.unregister(client, **worker)
        future.set_result(7)

    async def identity(n_workers: int) -> dict[str, object]:
        client.seen["a"] += 1
        return await Client.identity(client, n_workers)

    client.unregister, client.identity = leave, identity  # type: ignore[method-assign]
    found = list(remote.results(Cluster(client), [future], FOLDER, Telling()))
    assert found == [(future, 7)]
    assert client.seen.keys() == {"a"}
    assert said == ["worker b is silent; what it had is done by the others"]


def test_a_scheduler_that_falls_silent_ends_the_work(quick: None) -> None:
    client = Client(a=software.installed_versions())
    client.hangs = True
    assert ends(client, never()) == "out: the scheduler does not answer; continue with --resume"


def test_a_scheduler_that_is_gone_ends_the_work() -> None:
    """Dask gives its futures up."""
    future = never()
    future.cancel()
    assert "the scheduler is gone; continue with --resume" in ends(Client(), future)


def slow(index: int) -> int:
    time.sleep(0.5)
    return index


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda one: one.name)
def test_a_real_worker_that_dies_or_stops_costs_nothing(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(remote, "SILENT_SECONDS", 5.0)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        pid = cluster.workers[1].pid
        with remote.dask_executor(cluster.scheduler_address) as crew:
            futures = [crew.submit(slow, k) for k in range(12)]
            found = []
            for _, of in remote.results(crew, futures, FOLDER, Silent()):
                found.append(of)
                if len(found) == 5:  # what it has done and said stays in its memory
                    os.kill(pid, number)
        assert sorted(found) == list(range(12))
        if number == signal.SIGSTOP:
            os.kill(pid, signal.SIGKILL)
