"""Where mistakes end: in a message and a status."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
import typer

from bayesdrill.crew import Crew
from bayesdrill.errors import InputError
from bayesdrill.guard import INPUT_WRONG, INTERRUPTED, guarded, saved_in


def test_a_worker_that_is_killed_ends_in_a_message(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever the command. The task ends its process at once, as the kernel does when memory is out."""
    with pytest.raises(typer.Exit) as ended, guarded(), Crew(9, 2) as crew:  # type: ignore[arg-type]
        crew.submit(os._exit).result()
    assert ended.value.exit_code == INPUT_WRONG
    said = capsys.readouterr().err
    assert "a worker process was killed" in said
    assert "--processes" in said


def test_a_run_that_loses_a_worker_says_how_to_go_on(tmp_path: Path) -> None:
    with pytest.raises(InputError) as ended, saved_in(tmp_path), Crew(9, 2) as crew:  # type: ignore[arg-type]
        crew.submit(os._exit).result()
    (problem,) = ended.value.problems
    assert problem.place == str(tmp_path)
    assert "--processes" in problem.message
    assert "--resume" in problem.message


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_command_that_is_stopped_claims_nothing_of_files(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    """`report` and `identify -o` may have written some by then."""
    with pytest.raises(typer.Exit) as ended, guarded():
        signal.raise_signal(number)
    assert ended.value.exit_code == INTERRUPTED
    assert capsys.readouterr().err == "stopped\n"
