"""Break the code in the ways that `tests/mutants.toml` names, and see the test fail that it names.

It works on copies of the tree, as many as `--processes` says.  A mutant that survives is an error, and
so is a killer that fails without one.  Words choose the mutants that have one of them in name, file or
killer.  `tests/contracts/test_mutants.py` sees that each mutant changes a line of the code.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import batched
from pathlib import Path
from queue import SimpleQueue

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


def run(tree: Path, *tests: str) -> subprocess.CompletedProcess[str]:
    """Run `tests` in `tree` until one fails: the return code is 0 where all pass, 1 where one fails."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(tests)} did not run:\n{done.stdout}{done.stderr}")
    return done


def chosen(words: list[str]) -> list[Mutant]:
    """Those of which the name, the file or the killer has one of `words`; all of them without any."""
    texts = [f"{mutant.name} {mutant.file} {mutant.killer}" for mutant in MUTANTS]
    return [
        mutant
        for mutant, text in zip(MUTANTS, texts, strict=True)
        if not words or any(word in text for word in words)
    ]


def copy_tree(folder: Path, name: str) -> Path:
    """Copy what tests need into `folder/name`; all copies share the kernels that they compile."""
    (folder / "cache").mkdir(exist_ok=True)
    tree = folder / name
    tree.mkdir()
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
        copy(ROOT / part, tree / part)
    (tree / ".pytest_cache").symlink_to(folder / "cache")
    return tree


def survives(tree: Path, mutant: Mutant) -> bool:
    """Return whether the killer passes in `tree` with the mutant, print it, and mend the tree."""
    begun = time.perf_counter()
    path = tree / mutant.path
    text = path.read_text()
    path.write_text(text.replace(mutant.old, mutant.new))
    survived = run(tree, mutant.killer).returncode == 0
    path.write_text(text)
    seconds = time.perf_counter() - begun
    word = "SURVIVED" if survived else "killed  "
    print(f"{word}  {mutant.name}  ({seconds:.1f} s)", flush=True)
    return survived


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="of name, file or killer; all mutants without any")
    parser.add_argument("--processes", type=int, default=1, help="copies of the tree, side by side")
    options = parser.parse_args()
    mutants, count = chosen(options.words), options.processes
    killers = sorted({mutant.killer for mutant in mutants})
    # Neighbours are tests of one file, which share what it prepares.
    groups = list(batched(killers, -(-len(killers) // count) or 1))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(count) as threads:
        trees = [copy_tree(Path(folder), f"tree{number}") for number in range(count)]
        for passed in threads.map(lambda tree, tests: run(tree, *tests), trees, groups):
            if passed.returncode:
                raise SystemExit(f"a killer fails without any mutant:\n{passed.stdout}")
        free = SimpleQueue[Path]()
        for tree in trees:
            free.put(tree)

        def in_a_free_tree(mutant: Mutant) -> bool:
            tree = free.get()
            try:
                return survives(tree, mutant)
            finally:
                free.put(tree)

        survivors = sum(threads.map(in_a_free_tree, mutants))
    print(f"{len(mutants) - survivors} of {len(mutants)} mutants killed")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
