"""Shells complete commands, options and files; asked of the shell, or as a shell asks."""

import subprocess
import sys
from pathlib import Path

from support.case_tables import run_cases
from typer.testing import CliRunner

from bayesdrill.cli import app

BIN = Path(sys.executable).parent
BAYESDRILL = str(BIN / "bayesdrill")


def answer(shell: str, line: str) -> str:
    """Return what bayesdrill answers to a shell that wants `line` completed."""
    words = line.split(" ")
    variables = {
        "bash": {"COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)},
        "zsh": {"_TYPER_COMPLETE_ARGS": line},
        "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
        "powershell": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_WORD_TO_COMPLETE": words[-1]},
    }[shell]
    environment = {**variables, "_BAYESDRILL_COMPLETE": f"complete_{shell}"}
    result = CliRunner().invoke(app, env=environment, prog_name="bayesdrill")
    assert (result.exit_code, result.stderr) == (0, "")
    return result.stdout


@run_cases("shell", ["zsh", "fish", "powershell"])
def test_shells_that_show_helps_are_answered_with_them(shell: str) -> None:
    text = answer(shell, "bayesdrill po")
    assert "posterior" in text
    assert "verify" not in text
    assert "Search the MAP, sample the posterior" in text


def test_options_and_their_words_are_completed() -> None:
    assert answer("bash", "bayesdrill posterior a.yaml --f").split() == ["--force"]
    assert answer("bash", "bayesdrill export --to m").split() == ["mjcf"]
    assert not answer("bash", "bayesdrill check co").split()  # files are the shell's
    ended = subprocess.run([BAYESDRILL, "--help"], capture_output=True, text=True, check=True)
    assert "--install-completion" in ended.stdout
    assert "--show-completion" not in ended.stdout
