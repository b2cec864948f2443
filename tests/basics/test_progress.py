"""Reports of progress: a line for each stage and now and then, or a bar with the time left."""

import io

import pytest
from rich.console import Console

from bayesdrill.basics import progress
from bayesdrill.basics.progress import Lines


def test_each_stage_has_a_line_and_more_come_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    now, stream = [100.0], io.StringIO()
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    lines = Lines(stream)
    for after, fraction, text in (
        *((0.0, 0.0, "searching"), (9.0, 0.3, "searching, 3 of 10"), (2.0, 0.5, "5 of 10")),
        *((1.0, 0.6, "6 of 10"), (20.0, 1.0, ""), (0.0, 0.0, "learning"), (11.0, 0.1, "round 1")),
    ):
        now[0] += after
        lines.update(fraction, text)
    assert stream.getvalue().splitlines() == [
        "  searching ...",
        "   50 %  5 of 10, about 11 s left",
        "  learning ...",
        "   10 %  round 1, about 2 min left",
    ]


def test_a_bar_begins_anew_with_each_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    terminal = type("Terminal", (io.StringIO,), {"isatty": lambda _: True})()
    monkeypatch.setattr(progress.sys, "stderr", terminal)
    monkeypatch.setattr("rich.console.Console", lambda **_: console)
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.reporter() as bar:
        bar.update(0.0, "searching")
        now[0] += 1000.0
        bar.update(0.0, "learning")
        now[0] += 10.0
        bar.update(0.5, "round 1")
        (task,) = bar._progress.tasks
        assert task.description == "round 1, about 10 s left"
        bar.update(1.0, "")
        assert not bar._progress.tasks
