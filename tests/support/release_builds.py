"""What a release is made of, built from a copy of the checkout, and environments to try it in."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.command_line import ROOT

MADE = (
    ".venv",
    ".venv-bench",
    ".git",
    "results",
    "dist",
    ".hypothesis",
)  # in a checkout, by work in it
PINNED = ROOT / "requirements.lock"


@dataclass(frozen=True)
class Dist:
    """`tree`: the copy that the two files are made of."""

    tree: Path
    wheel: Path
    sdist: Path


def build(folder: Path) -> Dist:
    """As `make dist` does, of a checkout in which work was done."""
    tree = folder / "bayesdrill"
    shutil.copytree(ROOT, tree, ignore=_made)
    for name in (
        "results/mine/chain.h5",
        "results/published/run/report.html",
        ".venv/pyvenv.cfg",
        "bayesdrill/__pycache__/cli.pyc",
    ):
        (tree / name).parent.mkdir(parents=True)
        (tree / name).write_text("not to be released")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", "dist"]
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,), (sdist,) = (tree / "dist").glob("*.whl"), (tree / "dist").glob("*.tar.gz")
    return Dist(tree, wheel, sdist)


def _made(folder: str, names: list[str]) -> set[str]:
    top = MADE if Path(folder) == ROOT else ()
    return {name for name in names if name in (*top, "__pycache__") or name.endswith("_cache")}


def interpreter(version: str) -> str | None:
    """One of this version that runs: on PATH, or of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = [
        shutil.which(f"python{version}"),
        *sorted(map(str, pyenv.glob(f"{version}.*/bin/python"))),
    ]
    for place in places:
        if place is not None:
            ask = [place, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
            told = subprocess.run(ask, capture_output=True, text=True, check=False)
            if told.stdout.strip() == version:
                return place
    return None


@dataclass(frozen=True)
class Installed:
    """An environment with bayesdrill and what it needs, and a folder that is no checkout."""

    bin: Path
    folder: Path

    def run(self, *command: str | Path, status: int = 0) -> str:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
        done = subprocess.run(
            [self.bin / command[0], *command[1:]],
            cwd=self.folder,
            env={**clean, "PATH": f"{self.bin}{os.pathsep}{os.defpath}", "MPLBACKEND": "agg"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == status, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
        return done.stdout


def empty(version: str, folder: Path) -> Installed:
    """An environment of nothing but pip."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} here")
    (folder / "work").mkdir(parents=True)
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True, capture_output=True)
    return Installed(folder / "venv" / "bin", folder / "work")


def reach_packages(at: Installed) -> None:
    """Skips where pip finds no packages at all; what is wrong after that is wrong with ours."""
    pin = PINNED.read_text().splitlines()[0]
    probe = [at.bin / "pip", "download", "-q", "--no-deps", "-d", at.folder.parent / "probe", pin]
    done = subprocess.run(probe, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"pip finds no packages here: {done.stderr.strip().splitlines()[-1]}")
