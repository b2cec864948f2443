"""The walls of the house: who imports whom, where names are printed, how long files are."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from support.case_tables import run_cases

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "bayesdrill"

# From the ground up: a folder imports only itself and folders that stand before it.
FLOORS = (
    "basics",
    "guard",
    "output_files",
    "record",
    "rig",
    "inference",
    "sampling",
    "config",
    "analysis",
    "drafting",
    "results",
    "selection",
    "report",
    "tasks",
    "api",
    "cli",
    "__main__",
)
FLOOR = {folder: height for height, folder in enumerate(FLOORS)}

FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def module_of(path: Path) -> str:
    """`sampling.gauss_newton`, below the package; a folder's own file is the folder."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in FILES}


@cache
def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def imported_modules(path: Path) -> frozenset[str]:
    """Of the package, each as far down as it is a module."""
    found: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayesdrill."):
            of = (node.module or "").removeprefix("bayesdrill.")
            inner = {f"{of}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else of for name in inner}
        elif isinstance(node, ast.ImportFrom) and node.module == "bayesdrill":
            found |= {alias.name for alias in node.names} - {"__version__"}
        elif isinstance(node, ast.Import):
            names = {a.name for a in node.names if a.name.startswith("bayesdrill.")}
            found |= {name.removeprefix("bayesdrill.") for name in names}
    return frozenset(found)


def name(path: Path) -> str:
    """Of a file, as those who mend it look for it."""
    return str(path.relative_to(PACKAGE))


def folder_of(module: str) -> str:
    return module.split(".")[0]


def test_every_folder_has_a_floor_and_says_what_it_is_for() -> None:
    assert {folder_of(module) for module in MODULES} == set(FLOOR)
    folders = sorted({path.parent for path in FILES} - {PACKAGE})
    texts = {one: ast.parse((one / "__init__.py").read_text()) for one in folders}
    assert [name(one) for one, text in texts.items() if not ast.get_docstring(text)] == []


def test_a_folder_imports_only_folders_nearer_the_ground() -> None:
    assert [
        f"{name(path)} imports {module}"
        for path in FILES
        for module in sorted(imported_modules(path))
        if FLOOR[folder_of(module)] > FLOOR[folder_of(module_of(path))]
    ] == []


def test_the_command_line_is_a_user_of_the_api() -> None:
    """It parses, calls and prints: what it can do, Python can."""
    allowed = {"basics", "api", "guard"}
    text = re.sub(r"if TYPE_CHECKING:\n(    .*\n)+", "", (PACKAGE / "cli.py").read_text())
    used = set(re.findall(r"^ *from bayesdrill\.(\w+)", text, re.M)) - {"cli"}
    assert "api" in used <= allowed


def test_studies_use_what_floors_hand_on_and_nothing_deeper() -> None:
    """`from bayesdrill.rig import Response`: so rooms can be moved below it, and below others."""
    paths = [p for p in (ROOT / "studies").rglob("*.py") if "tests" not in p.parts]
    assert paths
    modules = {
        (str(path.relative_to(ROOT)), node.module or "")
        for path in paths
        for node in nodes(path)
        if isinstance(node, ast.ImportFrom)
    }
    names = {
        a.name for path in paths for n in nodes(path) if isinstance(n, ast.Import) for a in n.names
    }
    assert [m for m in modules if re.match(r"bayesdrill\.\w+\.", m[1])] == []
    assert not any(name.startswith("bayesdrill") for name in names)


@run_cases("folder", [f for f in FLOORS if (PACKAGE / f).is_dir()])
def test_what_a_floor_hands_on_is_there(folder: str) -> None:
    text = (PACKAGE / folder / "__init__.py").read_text()
    names = re.findall(r"^    from (bayesdrill\.[\w.]+) import \(?\s*(\w+) as", text, re.M)
    floor = importlib.import_module(f"bayesdrill.{folder}")
    for module, name in names:
        assert getattr(floor, name) is getattr(importlib.import_module(module), name)
    assert len(names) == len(re.findall(r"^    from bayesdrill\.", text, re.M))
    if names:
        with pytest.raises(AttributeError, match="it has"):
            floor.nothing_of_this_name  # noqa: B018


def test_no_module_imports_itself_by_a_way_round() -> None:
    above = {module: imported_modules(path) for module, path in MODULES.items()}
    round_about = []
    for module in sorted(above):
        seen, now = set[str](), set(above[module])
        while now:
            seen |= now
            now = set().union(*(above.get(name, set()) for name in now)) - seen
        if module in seen:
            round_about.append(module)
    assert round_about == []


def test_the_picture_of_the_house_is_that_of_its_imports() -> None:
    draw = runpy.run_path(str(ROOT / "docs" / "architecture.py"))
    assert tuple(draw["order"]()) == FLOORS[:-1]
    assert draw["drawn"](draw["floors"](FLOORS[:-1])) == draw["PICTURE"].read_text()


def test_only_reports_know_how_to_plot() -> None:
    plotting = []
    for path in FILES:
        if folder_of(module_of(path)) != "report" and path.name != "latex.py":
            text = re.sub(r"if TYPE_CHECKING:\n(    .*\n)+", "", path.read_text())
            imports = ("import matplotlib", "from matplotlib", "import corner")
            plotting += [f"{name(path)}: {each}" for each in imports if each in text]
    assert plotting == []


def test_samplers_know_nothing_of_rigs() -> None:
    assert [
        f"{module} imports {other}"
        for module, path in MODULES.items()
        if module.startswith("sampling.samplers")
        for other in sorted(imported_modules(path))
        if not other.startswith(("sampling.samplers", "basics"))
    ] == []


def test_files_and_functions_stay_small() -> None:
    lengths = {name(path): len(path.read_text().splitlines()) for path in FILES}
    assert [f"{file}: {lines} lines" for file, lines in lengths.items() if lines > 600] == []
    functions = [
        (name(path), node)
        for path in FILES
        for node in nodes(path)
        if isinstance(node, ast.FunctionDef)
    ]
    assert [
        f"{file}: {node.name} has more than 70 lines"
        for file, node in functions
        if node.end_lineno - node.lineno >= 70
    ] == []


def test_no_module_is_a_hub() -> None:
    """One that imports more than 25 others of the package does several things at once."""
    counts = {module: len(imported_modules(path)) for module, path in MODULES.items()}
    assert [f"{module} imports {n}" for module, n in counts.items() if n > 25] == []


def test_folders_have_two_levels_at_most() -> None:
    assert [module for module in MODULES if module.count(".") > 2] == []


def test_importing_the_command_line_loads_nothing_heavy() -> None:
    code = "import sys, bayesdrill.cli; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "scipy", "matplotlib", "emcee", "arviz_stats", "pydantic", "pint"}


def test_a_check_loads_nothing_that_draws_samples_or_stores() -> None:
    """Mutants killed: what bars beside a table need stands with the panels of figures; degrees are
    looked up in pint.
    """
    code = (
        "import sys, bayesdrill as bd; case = bd.load('configs/nominal_step.yaml'); case.preview();"
        "print(*sys.modules); case.identify(); print(*sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=PACKAGE.parent
    )
    check, identify = (set(line.split()) for line in done.stdout.splitlines())
    drawing = {"matplotlib", "corner", "jinja2"}
    heavy = {*drawing, "arviz_base", "arviz_stats", "xarray", "pandas", "emcee", "h5py", "pint"}
    assert not identify & {*heavy, "scipy.stats"}
    assert not check & {*heavy, "scipy.special", "scipy.linalg", "scipy.optimize", "scipy.ndimage"}
