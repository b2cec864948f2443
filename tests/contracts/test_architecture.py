"""Who imports whom, where things may be done, how long files and functions are."""

import ast
import importlib
import re
import runpy
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from support.case_tables import run_cases
from support.syntax import nodes

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
    "design",
    "drafting",
    "results",
    "report",
    "selection",
    "tasks",
    "campaigns",
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
def imported_modules(path: Path) -> frozenset[str]:
    """Return those of the package that a file imports, `folder.module` where that is a module."""
    modules: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayesdrill."):
            of = (node.module or "").removeprefix("bayesdrill.")
            names = {f"{of}.{alias.name}" for alias in node.names}
            modules |= {name if name in MODULES else of for name in names}
        elif isinstance(node, ast.ImportFrom) and node.module == "bayesdrill":
            modules |= {alias.name for alias in node.names} - {"__version__"}
        elif isinstance(node, ast.Import):
            names = {a.name for a in node.names if a.name.startswith("bayesdrill.")}
            modules |= {name.removeprefix("bayesdrill.") for name in names}
    return frozenset(modules)


def name(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def without_type_checking(path: Path) -> str:
    """Return the text of a file without what only the type checker imports."""
    return re.sub(r"if TYPE_CHECKING:\n(    .*\n)+", "", path.read_text())


def folder_of(module: str) -> str:
    return module.split(".")[0]


def test_every_folder_has_a_floor_and_says_what_it_is_for() -> None:
    assert {folder_of(module) for module in MODULES} == set(FLOOR)
    inits = [path / "__init__.py" for path in sorted({path.parent for path in FILES} - {PACKAGE})]
    assert [name(p) for p in inits if not ast.get_docstring(nodes(p)[0])] == []


def test_a_folder_imports_only_folders_nearer_the_ground() -> None:
    assert [
        f"{name(path)} imports {module}"
        for path in FILES
        for module in sorted(imported_modules(path))
        if FLOOR[folder_of(module)] > FLOOR[folder_of(module_of(path))]
    ] == []


def test_the_command_line_is_a_user_of_the_api() -> None:
    """It parses, calls and prints: what it can do, Python can."""
    text = without_type_checking(PACKAGE / "cli.py")
    used = set(re.findall(r"^ *from bayesdrill\.(\w+)", text, re.M)) - {"cli"}
    assert "api" in used <= {"basics", "api", "guard"}


def test_studies_use_what_floors_hand_on_and_nothing_deeper() -> None:
    """`from bayesdrill.rig import Response`: so modules can be moved below it."""
    studies = (ROOT / "studies").rglob("*.py")
    paths = [p for p in studies if "tests" not in p.relative_to(ROOT).parts]
    imports = r"^ *(?:from (bayesdrill\.\w+\.\S+) import|import (bayesdrill)\b)"
    assert paths
    assert [str(p) for p in paths if re.search(imports, p.read_text(), re.M)] == []


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


def test_no_module_imports_itself_indirectly() -> None:
    graph = {module: imported_modules(path) & {*MODULES} for module, path in MODULES.items()}
    tuple(TopologicalSorter(graph).static_order())  # raises `CycleError` with the cycle


def test_the_picture_of_the_architecture_is_that_of_its_imports() -> None:
    draw = runpy.run_path(str(ROOT / "docs" / "architecture.py"))
    assert tuple(draw["order"]()) == FLOORS[:-1]
    assert draw["drawn"](draw["floors"](FLOORS[:-1])) == draw["PICTURE"].read_text()


def test_only_reports_know_how_to_plot() -> None:
    plotting = []
    for path in FILES:
        if folder_of(module_of(path)) != "report" and path.name != "latex.py":
            text = without_type_checking(path)
            imports = ("import matplotlib", "from matplotlib", "import corner")
            plotting += [f"{name(path)}: {each}" for each in imports if each in text]
    assert plotting == []


def test_yaml_is_validated_where_it_is_loaded_and_nowhere_again() -> None:
    calls = re.compile(r"model_validate|validate_python\(")
    validating = [name(path) for path in FILES if calls.search(path.read_text())]
    assert validating == ["config/schema/validation.py"]


def test_samplers_know_nothing_of_rigs() -> None:
    assert [
        f"{module} imports {other}"
        for module, path in MODULES.items()
        if module.startswith("sampling.samplers")
        for other in sorted(imported_modules(path))
        if not other.startswith(("sampling.samplers", "basics"))
    ] == []


def lines_of_code(function: ast.FunctionDef) -> int:
    """Return the lines of a function that are not its docstring."""
    first = function.body[0]
    text = first.end_lineno - first.lineno if ast.get_docstring(function) else 0
    return (function.end_lineno or 0) - function.lineno - text


def test_files_and_functions_stay_small() -> None:
    lengths = {name(path): len(path.read_text().splitlines()) for path in FILES}
    assert [f"{file}: {lines} lines" for file, lines in lengths.items() if lines > 600] == []
    assert [
        f"{name(path)}: {node.name} has more than 70 lines"
        for path in FILES
        for node in nodes(path)
        if isinstance(node, ast.FunctionDef) and lines_of_code(node) >= 70
    ] == []


def test_no_module_is_a_hub() -> None:
    """One that imports more than 25 others of the package does several things at once."""
    counts = {module: len(imported_modules(path)) for module, path in MODULES.items()}
    assert [f"{module} imports {n}" for module, n in counts.items() if n > 25] == []


def test_folders_have_two_levels_at_most() -> None:
    assert [module for module in MODULES if module.count(".") > 2] == []


def modules_loaded_by(code: str) -> list[set[str]]:
    """Run a process that prints `sys.modules` once or more, and return what each line says."""
    command = [sys.executable, "-c", f"import sys, bayesdrill as bd; {code}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    return [set(line.split()) for line in done.stdout.splitlines()]


def test_importing_the_command_line_loads_nothing_heavy() -> None:
    (loaded,) = modules_loaded_by("import bayesdrill.cli; print(*sys.modules)")
    assert not loaded & {"numpy", "scipy", "matplotlib", "emcee", "arviz_stats", "pydantic", "pint"}


def test_a_check_loads_nothing_that_draws_samples_or_stores() -> None:
    check, identify = modules_loaded_by(
        "case = bd.load('configs/nominal_step.yaml'); case.preview();"
        "print(*sys.modules); case.identify(); print(*sys.modules)"
    )
    heavy = {"matplotlib", "corner", "jinja2", "arviz_base", "arviz_stats", "xarray", "pandas"}
    heavy |= {"emcee", "h5py", "pint"}
    assert not identify & {*heavy, "scipy.stats"}
    assert not check & {*heavy, "scipy.special", "scipy.linalg", "scipy.optimize", "scipy.ndimage"}
