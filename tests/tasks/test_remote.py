"""Clusters that fail: each ends in a sentence within half a minute, or the work goes on."""

import asyncio
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest
from support.case_tables import run_cases

from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Silent
from bayesdrill.tasks import remote
from bayesdrill.tasks.remote import Cluster

OUT = Path("out")
OWN = software.installed_versions()
ANSWERS: dict[str, Callable[[socket.socket], object]] = {
    "silence": lambda call: None,
    "nonsense": lambda call: call.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 20),
    "zeros": lambda call: call.sendall(bytes(4096)),
    "hangs up": lambda call: call.close(),
}


@pytest.fixture(params=ANSWERS)
def stranger(request: pytest.FixtureRequest) -> Iterator[str]:
    """Yield `host:port` where something listens that is no scheduler."""
    server, calls = socket.create_server(("127.0.0.1", 0)), []

    def listen() -> None:
        while True:
            try:
                calls.append(server.accept()[0])
                ANSWERS[request.param](calls[-1])
            except OSError:
                return

    threading.Thread(target=listen, daemon=True).start()
    yield f"127.0.0.1:{server.getsockname()[1]}"
    server.shutdown(socket.SHUT_RDWR)
    for one in (server, *calls):
        one.close()


def refusal(address: str) -> str:
    pytest.importorskip("distributed")
    with pytest.raises(InputError) as error, remote.dask_executor(address):
        pass
    (problem,) = error.value.problems
    assert problem.place == "--scheduler"
    return problem.message


def test_an_address_without_a_scheduler_is_refused(stranger: str) -> None:
    """The client of Dask would wait for ever, or leave a traceback."""
    begun = time.monotonic()
    assert f"no scheduler answers at tcp://{stranger}" in refusal(f"tcp://{stranger}")
    assert time.monotonic() - begun < 30


@run_cases(
    "address, message",
    [
        ("tls://127.0.0.1:8786", "no certificates"),
        ("wss://127.0.0.1:8786", "no certificates"),
        ("nonsense://x:y", "'nonsense://x:y' is not an address of a scheduler"),
        ("tcp://127.0.0.1:1", "no scheduler answers at tcp://127.0.0.1:1"),
        ("tcp://no.such.host:8786", "no scheduler answers at tcp://no.such.host:8786"),
    ],
)
def test_an_address_that_cannot_be_used_is_refused_in_one_line(address: str, message: str) -> None:
    text = refusal(address)
    assert message in text
    assert "\n" not in text


def test_without_distributed_a_scheduler_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match=r"bayesdrill\[cluster\]"),
        remote.dask_executor("tcp://127.0.0.1:1"),
    ):
        pass


class Client:
    """Answers as `distributed.Client` does.

    `seen` is when each worker was heard of last, and `versions` what each of them has installed.
    """

    def __init__(self, **versions: object) -> None:
        self.seen = dict.fromkeys(versions, 0)
        self.versions = versions
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

    async def run(self, function: object, workers: list[str], on_error: str) -> dict[str, object]:
        assert (function, on_error) == (software.installed_versions, "return")
        return {name: self.versions[name] for name in workers if name in self.versions}

    async def unregister(self, address: str, stimulus_id: str) -> None:
        del self.seen[address]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "PATIENCE", 0.3)
    monkeypatch.setattr(remote, "WATCH", 0.01)
    monkeypatch.setattr(remote, "SILENT_SECONDS", 0.2)


def end(client: Client, future: Future[int] | None = None) -> str:
    """Return what is said of work that can come to no end."""
    with pytest.raises(InputError) as error:
        list(remote.results(Cluster(client), [future or Future()], OUT, Silent()))
    return str(error.value)


@pytest.mark.parametrize(
    ("versions", "reason"),
    [
        ({**OWN, "bayesdrill": "0.0.9"}, "bayesdrill 0.0.9 instead of"),
        (ModuleNotFoundError("No module named 'bayesdrill'"), "No module named 'bayesdrill'"),
        (AttributeError("no versions"), "no versions"),
    ],
)
def test_a_worker_with_other_software_is_named_before_it_has_work(
    versions: object, reason: str
) -> None:
    """Also one that comes later."""
    with pytest.raises(InputError, match="worker b: ") as error:
        Cluster(Client(a=OWN, b=versions)).compare(["a", "b"])
    assert reason in str(error.value)
    assert "install the same there" in str(error.value)
    assert reason in end(Client(a=OWN, b=versions))


def test_a_worker_that_cannot_be_asked_now_is_not_judged() -> None:
    client = Client(a=OWN, b=TimeoutError(), c=OSError("gone"))
    Cluster(client).compare(["a", "b", "c", "d"])


@pytest.mark.parametrize("workers", [{}, {"a": OWN, "b": OWN}], ids=["none left", "all silent"])
def test_work_ends_where_no_worker_is_heard_of(workers: dict[str, object]) -> None:
    """A stopped worker is as good as dead, though its socket stays open."""
    client = Client(**workers)
    text = end(client)
    assert "no worker has answered for" in text
    assert "continue with --resume" in text
    assert client.seen.keys() == workers.keys()  # there are no others to take their work


def test_the_work_of_a_silent_worker_goes_to_the_others() -> None:
    client, future, messages = Client(a=OWN, b=OWN), Future[int](), []

    class Recording(Silent):
        def say(self, text: str) -> None:
            messages.append(text)

    async def unregister(**worker: str) -> None:
        await Client.unregister(client, **worker)
        future.set_result(7)

    async def identity(n_workers: int) -> dict[str, object]:
        client.seen["a"] += 1
        return await Client.identity(client, n_workers)

    client.unregister, client.identity = unregister, identity  # type: ignore[method-assign]
    assert list(remote.results(Cluster(client), [future], OUT, Recording())) == [(future, 7)]
    assert client.seen.keys() == {"a"}
    assert messages == ["worker b is silent; its work goes to the others"]


def test_work_ends_where_the_scheduler_is_silent_or_gone() -> None:
    client, cancelled = Client(a=OWN), Future[int]()
    client.hangs = True
    assert end(client) == "out: the scheduler does not answer; continue with --resume"
    cancelled.cancel()  # Dask gives its futures up
    assert "the scheduler is gone; continue with --resume" in end(Client(), cancelled)
