"""Break the code in the ways that `mutants.toml` names, and see the test fail that it names.

`make mutants` works on a copy of the tree; a mutant that survives is an error.  Words after
`python tests/mutants.py` choose those that have one of them in name, file or killer.  A mutant whose
line is no longer in the code is an error too, so that this list cannot rot.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PARTS = (
    *("bayesdrill", "benchmarks", "configs", "docs", "studies", "tests"),
    *("conftest.py", "pyproject.toml", "README.md"),
)


@dataclass(frozen=True)
class Mutant:
    name: str
    file: str  # below the package, or from the root where it is of the studies
    old: str
    new: str
    killer: str  # the test that must fail

    @property
    def path(self) -> str:
        """From the root of the tree."""
        return self.file if self.file.startswith("studies/") else f"bayesdrill/{self.file}"


LISTED = tomllib.loads((ROOT / "tests/mutants.toml").read_text(encoding="utf-8"))
MUTANTS = [Mutant(**each) for each in LISTED["mutant"]]


def run(tree: Path, killer: str) -> bool:
    """Whether the test passes in `tree`."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", killer],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{killer} did not run:\n{done.stdout}{done.stderr}")
    return done.returncode == 0


def chosen(words: list[str]) -> list[Mutant]:
    """Those of which the name, the file or the killer has one of `words`; all of them without any."""
    texts = [f"{mutant.name} {mutant.file} {mutant.killer}" for mutant in MUTANTS]
    return [
        mutant
        for mutant, text in zip(MUTANTS, texts, strict=True)
        if not words or any(word in text for word in words)
    ]


def main() -> None:
    survivors = []
    mutants = chosen(sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        tree.mkdir()
        for part in PARTS:
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
            copy(ROOT / part, tree / part)
        for killer in sorted({mutant.killer for mutant in mutants}):
            if not run(tree, killer):
                raise SystemExit(f"{killer} fails without any mutant")
        for mutant in mutants:
            begun = time.perf_counter()
            path = tree / mutant.path
            text = path.read_text()
            path.write_text(text.replace(mutant.old, mutant.new))
            survived = run(tree, mutant.killer)
            path.write_text(text)
            seconds = time.perf_counter() - begun
            print(f"{'SURVIVED' if survived else 'killed  '}  {mutant.name}  ({seconds:.1f} s)")
            if survived:
                survivors.append(mutant.name)
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} mutants killed")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
