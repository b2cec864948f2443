"""Shells complete commands, options and files; asked of the shell, or as a shell asks."""

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


# What is typed before the tab key, and the line that bash makes of it.
TYPED = {
    "bayesdrill ver\t": "bayesdrill verify",
    "bayesdrill check conf\tmy\t": "bayesdrill check configs/my rig.yaml",
    "bayesdrill posterior x --res\t": "bayesdrill posterior x --resume",
}


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash here")
def test_bash_completes_what_is_typed(tmp_path: Path) -> None:
    """A terminal, the script that `--show-completion` prints, and the tab key."""
    script = tmp_path / "completion.sh"
    show = ["bash", "-c", f"{BAYESDRILL} --show-completion; exit"]
    script.write_text(subprocess.run(show, capture_output=True, text=True, check=True).stdout)
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "my rig.yaml").touch()
    # After the tab: to the front of the line (ctrl-a), and have it said instead of done.
    typed = "".join(f"{keys}\x01echo SAID \n" for keys in TYPED)
    shown = in_terminal(f"source {script}\n{typed}exit\n", tmp_path).splitlines()
    lines = [line.removeprefix("SAID ").strip() for line in shown if line.startswith("SAID ")]
    assert lines == [*TYPED.values()]


def in_terminal(typed: str, folder: Path) -> str:
    """Return what an interactive bash in `folder` shows."""
    terminal, other_end = pty.openpty()
    bash = subprocess.Popen(
        ["bash", "--norc", "--noprofile", "-i"],
        cwd=folder,
        env={"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "TERM": "dumb"},
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
