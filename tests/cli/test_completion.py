"""Shells complete commands, options and files; asked of the shell, or as a shell asks."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.case_tables import run_cases
from typer.testing import CliRunner

from bayesdrill.cli import app

BIN = Path(sys.executable).parent
BAYESDRILL = str(BIN / "bayesdrill")


def asked(shell: str, line: str) -> str:
    """What bayesdrill answers to a shell that wants `line` completed."""
    words = line.split(" ")
    asking = {
        "bash": {"COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)},
        "zsh": {"_TYPER_COMPLETE_ARGS": line},
        "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
        "powershell": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_WORD_TO_COMPLETE": words[-1]},
    }[shell]
    environment = {**asking, "_BAYESDRILL_COMPLETE": f"complete_{shell}"}
    said = CliRunner().invoke(app, env=environment, prog_name="bayesdrill")
    assert (said.exit_code, said.stderr) == (0, "")
    return said.stdout


@run_cases("shell", ["zsh", "fish", "powershell"])
def test_other_shells_are_answered(shell: str) -> None:
    said = asked(shell, "bayesdrill po")
    assert "posterior" in said
    assert "verify" not in said
    assert "MAP, sampling, diagnostics" in said  # these show what a command does


def test_options_and_their_words_are_completed() -> None:
    assert asked("bash", "bayesdrill posterior a.yaml --f").split() == ["--force"]
    assert asked("bash", "bayesdrill export --to m").split() == ["mjcf"]
    assert not asked("bash", "bayesdrill check co").split()  # files are the shell's


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash here")
def test_bash_completes_what_is_typed(tmp_path: Path) -> None:
    """A terminal, the script that `--show-completion` prints, and the tab key."""
    script = tmp_path / "completion.sh"
    shown = subprocess.run(
        ["bash", "-c", f"{BAYESDRILL} --show-completion; exit"],
        capture_output=True,
        text=True,
        check=True,
    )
    script.write_text(shown.stdout)
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "my rig.yaml").touch()
    # After the tab: to the front of the line (ctrl-a), and have it said instead of done.
    lines = [
        ("bayesdrill ver\t", "bayesdrill verify"),
        ("bayesdrill check conf\tmy\t", "bayesdrill check configs/my rig.yaml"),
        ("bayesdrill posterior x --res\t", "bayesdrill posterior x --resume"),
    ]
    typed = "".join(f"{line}\x01echo SAID \n" for line, _ in lines)
    said = [
        line.removeprefix("SAID ").strip()
        for line in in_terminal(f"source {script}\n{typed}exit\n", tmp_path).splitlines()
        if line.startswith("SAID ")
    ]
    assert said == [expected for _, expected in lines]


def in_terminal(typed: str, folder: Path) -> str:
    """What an interactive bash in `folder` shows."""
    terminal, other_end = pty.openpty()
    search = f"{BIN}{os.pathsep}{os.environ['PATH']}"
    bash = subprocess.Popen(
        ["bash", "--norc", "--noprofile", "-i"],
        cwd=folder,
        env={"PATH": search, "TERM": "dumb"},
        stdin=other_end,
        stdout=other_end,
        stderr=other_end,
        start_new_session=True,
    )
    os.close(other_end)
    shown = b""
    try:
        for line in typed.splitlines(keepends=True):
            os.write(terminal, line.encode())
        while piece := os.read(terminal, 4096):
            shown += piece
    except OSError:  # the end of a terminal
        pass
    finally:
        bash.wait(timeout=20)
        os.close(terminal)
    return shown.decode().replace("\r", "")


def test_help_names_one_option_for_it() -> None:
    done = subprocess.run([BAYESDRILL, "--help"], capture_output=True, text=True, check=True)
    assert "--install-completion" in done.stdout
    assert "--show-completion" not in done.stdout
