"""What pages of the documentation and docstrings of modules point to is there.

A name in backticks is a pointer where it ends with `.py`, where it is a path below the package, and
where its parts are joined by dots and begin with a folder or a module of the package.
"""

import ast
import re
from pathlib import Path

from support.case_tables import run_cases
from support.syntax import nodes

import bayesdrill as bd

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "bayesdrill"
ARCHITECTURE = ROOT / "docs" / "architecture.md"
PAGES = [ROOT / "README.md", *ROOT.glob("docs/**/*.md")]
# The docstring of the package itself is for users: its names are those of a notebook.
MODULES = [*(p for p in PACKAGE.rglob("*.py") if p.parent != PACKAGE or p.name != "__init__.py")]
MODULES += (ROOT / "studies").rglob("*.py")
DOTTED = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
}
FIRST = {part for module in DOTTED for part in module.split(".")}
ENDINGS = (".yaml", ".json", ".py", ".csv", ".md", ".toml")
# What a run writes for its user stands in a folder `results`, and files of theirs in `config`.
USERS = ("results/", "config.yaml", "config.resolved.yaml")


def quoted(text: str) -> list[str]:
    return sorted(set(re.findall(r"`([\w./]+)`", text)))


FOLDERS = ("bayesdrill", "benchmarks", "docs", "studies", "tests")
FILE_NAMES = {path.name for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
PATHS = [PACKAGE, *PACKAGE.rglob("*")]


def is_lost_path(name: str) -> bool:
    """Return whether this is a path that does not exist; below the package it may be short."""
    if name.endswith(".py"):
        if "/" not in name:
            return name not in FILE_NAMES
    elif "/" not in name or name.startswith(USERS) or name.split("/")[0] not in FIRST:
        return False
    below = any(path.match(f"**/{name.rstrip('/')}") for path in PATHS)
    return not below and not (ROOT / name).exists()


def is_lost_name(name: str) -> bool:
    """Return whether this is a dotted name of a module, or in one, that does not exist."""
    if re.match(r"bd\.\w", name):
        return name.split(".")[1] not in dir(bd)
    if not re.fullmatch(r"\w+(\.\w+)+", name) or name.split(".")[0] not in FIRST:
        return False
    within, _, last = name.rpartition(".")
    defined = re.compile(rf"^(?:def|class|type) {last}\b|^{last}\b[^\n]*=| as {last}$", re.M)
    return not any(
        f".{module}".endswith(f".{name}")
        or (f".{module}".endswith(f".{within}") and defined.search(path.read_text()))
        for module, path in DOTTED.items()
    )


@run_cases("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_page_points_to_exists(page: Path) -> None:
    """In all pages but that of the architecture dotted names are entries of configs."""
    names = quoted(page.read_text())
    assert [name for name in names if is_lost_path(name)] == []
    python = [n for n in names if n.startswith("bd.") or page == ARCHITECTURE]
    assert [n for n in python if not n.endswith(ENDINGS) and is_lost_name(n)] == []


@run_cases("module", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_the_docstring_of_a_module_points_to_exists(module: Path) -> None:
    names = quoted(ast.get_docstring(nodes(module)[0]) or "")
    assert [name for name in names if is_lost_path(name)] == []
    assert [name for name in names if not name.endswith(ENDINGS) and is_lost_name(name)] == []


def test_registries_are_in_the_files_that_the_page_says() -> None:
    places = re.findall(r"`([A-Z]+)`(?: and `[A-Z]+`)? in `([\w/.]+)`", ARCHITECTURE.read_text())
    assert places
    for registry, file in places:
        assert f"\n{registry}" in (PACKAGE / file).read_text(), registry
