"""The walls of the house: who imports whom, where names are printed, how long files are."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "bayesdrill"

# From the ground up: a room imports only rooms of lines above its own.
FLOORS = [
    {"bayesdrill", "errors", "symbols"},
    {"units", "sizes", "typesetting", "expressions", "formulas", "seeds", "progress"}
    | {"ours", "sealed", "software", "duals"},
    {"models", "priors", "experiment", "yaml_source", "kernels"},
    {"formats", "parameters", "coordinates", "noise", "response", "beliefs"},
    {"likelihood", "config"},
    {"posterior"},
    {"problem"},
    {"laplace", "samplers", "crew", "surface"},
    {"optimisers", "schema", "shelf", "suspicions", "climb", "directions", "aliases"},
    {"ridges"},
    {"settled"},
    {"left_out"},
    {"identifiability", "convergence", "givens", "maxima", "learning", "residuals"},
    {"build", "pieces", "mode", "preparation"},
    {"consistency", "recording", "store"},
    {"loading", "sampling", "diagnostics", "physics", "tension"},
    {"derived"},
    {"job", "opening"},
    {"writing"},
    {"simulation", "tree", "provenance", "verdict"},
    {"calibration", "reproduction", "wording"},
    {"conclusions"},
    {"report"},
    {"identify"},
    {"pipeline"},
    {"calibrate", "paper", "guard"},
    {"cli"},
    {"__main__"},
]
FLOOR = {room: height for height, rooms in enumerate(FLOORS) for room in rooms}

FILES = sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return "bayesdrill" if parts == ("__init__",) else parts[0]


def imported_rooms(path: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayesdrill"):
            parts = (node.module or "").split(".")
            rooms |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            rooms |= {a.name.split(".")[1] for a in node.names if a.name.startswith("bayesdrill.")}
    return {room if room in FLOOR else "bayesdrill" for room in rooms}


def test_every_room_has_a_floor() -> None:
    assert {room_of(path) for path in FILES} == set(FLOOR)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_rooms_import_only_rooms_nearer_the_ground(path: Path) -> None:
    room = room_of(path)
    above = {r for r in imported_rooms(path) if r != room and FLOOR[r] >= FLOOR[room]}
    assert not above


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_reports_know_how_to_plot(path: Path) -> None:
    if room_of(path) not in ("report", "typesetting"):
        text = path.read_text()
        assert "import matplotlib" not in text
        assert "from matplotlib" not in text
        assert "import corner" not in text


def test_samplers_know_nothing_of_rigs() -> None:
    for path in (PACKAGE / "samplers").rglob("*.py"):
        assert imported_rooms(path) <= {"samplers"}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_files_and_functions_stay_small(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 350
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno - node.lineno < 70, node.name


def test_importing_the_command_line_loads_nothing_heavy() -> None:
    code = "import sys, bayesdrill.cli; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "scipy", "matplotlib", "emcee", "arviz_stats", "pydantic", "pint"}
