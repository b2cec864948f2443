"""The documents: commands and scripts run, configs are valid, statements are true of the program."""

import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from support import command_line
from support.document_blocks import (
    DOCS,
    DOCUMENTS,
    NOTEBOOKS,
    ROOT,
    anchors,
    blocks,
    cells,
    commands,
    files,
    prose,
    script,
    sentences,
)

import bayesdrill as bd
from bayesdrill.cli import app
from bayesdrill.config import loading
from bayesdrill.config.schema.config import Config
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import dynamics
from docs import reference

README = ROOT / "README.md"


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project, whose `.venv` is the environment of this test."""
    copy = tmp_path_factory.mktemp("clone") / "bayesdrill"
    shutil.copytree(ROOT, copy, ignore=_not_in_a_clone)
    (copy / ".venv").symlink_to(sys.prefix)
    for name, held in HELD.items():
        config = copy / "configs" / f"{name}.yaml"
        if config.exists():
            lighten(config, held)
    return copy


def _not_in_a_clone(folder: str, names: list[str]) -> set[str]:
    """Names that a clone does not have: environments, caches, and runs."""
    others = shutil.ignore_patterns(".venv*", "build", ".git", "__pycache__", ".*_cache")
    runs = {*names} - {"README.md", "published"} if Path(folder) == ROOT / "results" else set()
    return {*others(folder, names), *runs}


# Parameters that are held in the copy, so that few unknowns remain; example_rig has another k_T.
HELD = {
    "nominal_step": dict.fromkeys(("j_m", "c_m", "k_T", "r_m", "l_m", "t_f"), "nominal"),
    "my_rig": dict.fromkeys(("j_m", "c_m", "k_T", "r_m", "t_f"), "nominal"),
    "example_rig": dict.fromkeys(("j_m", "c_m", "l_m", "k_e", "t_f"), "nominal") | {"k_T": "0.1"},
    "one_motor": {},
    "one_motor_drift": {},
}
LIGHT = """
output: {figures: [], predictive_draws: 10}
sampler: {ensembles: 4, walkers: 64, ess: 1000}
map: {starts: 2}
"""


def lighten(config: Path, held: dict[str, str]) -> None:
    """Set targets that are soon met: the commands are tested; CI runs `make posterior` as it is."""
    text = re.sub(r"^sampler:.*\n(  .*\n)*", "", config.read_text(), flags=re.M)
    for name, value in held.items():
        text = re.sub(rf"^  {name}: {{.*$", f"  {name}: {value}", text, flags=re.M)
    drawn = "[corner]" if config.stem == "nominal_step" else "[]"
    config.write_text(text + LIGHT.replace("[]", drawn))


def run(command: str, tree: Path) -> subprocess.CompletedProcess[str]:
    """Run as a newcomer types it; `make` takes the environment as set up and only collects tests."""
    command = re.sub(r"^make ", "make -o .venv/.ready ", command)
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTEST_ADDOPTS": "--collect-only -q tests/basics",
        "PYTHONPATH": f"{tree}{os.pathsep}{tree / 'tests' / 'toys'}",
    }
    one_core = partial(os.sched_setaffinity, 0, {min(os.sched_getaffinity(0))})
    return subprocess.run(
        command,
        shell=True,
        cwd=tree,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=one_core,  # another runs other tests
    )


@pytest.mark.slow
def test_every_script_runs(tree: Path) -> None:
    scripts = [text for path in DOCUMENTS if (text := script(path))]
    assert any("plot_corner" in text for text in scripts)
    for text in scripts:
        done = run(f"python - <<'END'\n{text}\nEND", tree)
        assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"


def test_every_script_and_notebook_is_python() -> None:
    for path in DOCUMENTS:
        compile(script(path), path.name, "exec")
    assert len(NOTEBOOKS) == 8
    for path in NOTEBOOKS:
        compile(cells(path), path.name, "exec")
        assert re.search(r"assert \w+(\.\w+)*\.converged\n", cells(path)), path.name


@pytest.fixture(scope="module")
def ran() -> set[str]:
    """Commands that ran in the tree: none runs twice."""
    return set()


@pytest.mark.slow
def test_commands_of_the_readme_run_in_order(tree: Path, ran: set[str]) -> None:
    """Commands of the README; later ones need the results of earlier ones."""
    follow(README, tree, ran)
    assert {"make posterior", "make test"} <= ran
    assert (tree / "results" / "nominal_step" / "figures" / "corner.pdf").exists()
    assert (tree / "results" / "example_rig" / "summary.md").exists()


@pytest.mark.slow
def test_the_numbers_of_one_motor_are_those_of_its_page(tree: Path, ran: set[str]) -> None:
    """Eight commands at most lead to them, and their sds cover the estimates of single windows."""
    page = DOCS / "one-motor.md"
    follow(page, tree, ran)
    assert len(commands(page)) <= 8
    units = {"K": 180 / math.pi, "T": 1e3, "t_0": 1e3}  # units of the page per SI unit
    results = {}
    for name in ("one_motor", "one_motor_drift"):
        rows = command_line.table(tree / "results" / name / "summary.csv")
        results[name] = {
            symbol: (unit * float(rows[symbol]["mean"]), unit * float(rows[symbol]["sd"]))
            for symbol, unit in units.items()
        }
    ranges = {"K": (158, 162), "T": (34, 40), "t_0": (17, 22)}
    windows = {"K": (160.2, 162.0), "T": (38.9, 39.4), "t_0": (16.89, 17.0)}
    for symbol, (low, high) in ranges.items():
        shown = re.findall(rf"^\| `{symbol}` .*?\| ([\d.]+) ", page.read_text(), re.M)
        for name, text in zip(results, shown, strict=True):
            mean, sd = results[name][symbol]
            assert low <= round(mean, 1) <= high
            assert float(text) == pytest.approx(mean, abs=sd)
        mean, sd = results["one_motor_drift"][symbol]
        assert all(abs(value - mean) < 2 * sd for value in windows[symbol])
    assert results["one_motor"]["K"][1] < 0.2 < results["one_motor_drift"]["K"][1] < 1.0


@pytest.mark.slow
def test_commands_of_all_other_pages_run(tree: Path, ran: set[str]) -> None:
    for path in DOCUMENTS:
        follow(path, tree, ran)
    assert len(ran) > 30


def follow(path: Path, tree: Path, ran: set[str]) -> None:
    """Write the files of a page and run its commands in order, except those that ran before."""
    for name, text in files(path).items():
        (tree / name).write_text(text)
        if (held := HELD.get(Path(name).stem)) is not None:
            lighten(tree / name, held)
    for command in commands(path):
        if command in ran:
            continue
        ran.add(command)
        done = run(command, tree)
        status = 3 if "# ends with status 3" in command else 0
        assert done.returncode == status, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr


def test_commands_named_in_the_text_exist() -> None:
    text = "\n".join(path.read_text() for path in DOCUMENTS)
    targets = set(re.findall(r"`make ([a-z-]+)", text))
    makefile = (ROOT / "Makefile").read_text()
    assert targets
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)
    for command in set(re.findall(r"`bayesdrill ([a-z]+)", text)):
        result = command_line.cli(command, "--help")
        assert result.status == 0, command
        assert "Example:" in result.out, command


YAML_SAFE = YAML(typ="safe", pure=True)


def completed(base: Mapping[str, Any], part: Mapping[str, Any]) -> dict[str, Any]:
    """Complete a part of a config by a whole one, section by section.

    A part with another rig has inputs and parameters of its own, and is given channels alone.
    """
    rig = part.get("model", {}).get("name", "motor_shaft")
    if rig != "motor_shaft" and "parameters" in part:
        channels = base["record"]["channels"]
        shown = {name: channels[name] for name in channels if name in MODELS[rig]().states}
        record = {**base["record"], "channels": shown}
        base = {"name": base["name"], "seed": base["seed"], "record": record}
    sections = {
        name: {**base[name], **own} if isinstance(base.get(name), Mapping) else own
        for name, own in part.items()
    }
    return {**base, **sections}


def test_every_part_of_a_config_is_valid(tmp_path: Path) -> None:
    """Completed by the bundled config, where a page shows a part."""
    base = YAML_SAFE.load((ROOT / "configs" / "nominal_step.yaml").read_text())
    count = 0
    for page in DOCUMENTS:
        for block in blocks(page, "yaml"):
            part = YAML_SAFE.load(block)
            if part is None or "toy_" in block:  # those are run with their package
                continue
            path = tmp_path / "part.yaml"
            with path.open("w") as file:
                YAML_SAFE.dump(completed(base, part), file)
            try:
                loading.load(path)
            except bd.InputError as error:
                pytest.fail(f"{page.name}\n{block}\n{error}")
            count += 1
    assert count > 10


def test_the_toys_are_the_package_that_is_shown() -> None:
    (shown,) = blocks(DOCS / "extending.md", "toml")
    listed = set(re.findall(r'^toy_\w+ = "[\w:]+"$', shown, re.MULTILINE))
    brought = (ROOT / "tests" / "toys" / "toys-1.0.dist-info" / "entry_points.txt").read_text()
    lines = [line.split(" = ") for line in brought.splitlines() if " = " in line]
    assert listed == {f'{name} = "{place}"' for name, place in lines}


def test_the_equations_for_matlab_are_those_of_the_model() -> None:
    """At values at which no other product is the same."""
    functions = [b for b in blocks(DOCS / "matlab.md", "matlab") if "function [" in b]
    linear_function, other = (next(b for b in functions if f" = {name}(" in b) for name in RIGS)
    values = {name: 1.1 + 0.3 * k for k, name in enumerate(bd.MotorShaft.parameters)}
    linear = bd.MotorShaft(i_m=1 / 8).linear(values)
    states = bd.MotorShaft.states
    a, constant = dynamics(linear, states, 1)[0], [linear.c.get(state, 0.0) for state in states]
    driven = np.array([linear.B.get((state, "v"), 0.0) for state in states])
    names = {**values, "i_m": 1 / 8}
    assert np.allclose(matrix(linear_function, "A", names), a)
    assert np.allclose(matrix(linear_function, "B", names), np.transpose([driven, constant]))
    x, v = np.arange(5.0) ** 2 + 0.7, 3.0
    names |= {"x": lambda k: x[k - 1], "u": lambda _: v, "twist": x[0] - x[1]}
    assert np.allclose(matrix(other, "dx", names)[:, 0], a @ x + driven * v + constant)


RIGS = ("rig", "rig_nl")


def matrix(function: str, name: str, values: Mapping[str, Any]) -> np.ndarray:
    """Evaluate a matrix of a MATLAB function."""
    text = re.search(rf"^{name} = \[(.*?)\];", function, re.MULTILINE | re.DOTALL)[1]
    rows = [row.replace("^", "**").split(",") for row in text.split(";")]
    return np.array([[eval(cell.strip(), {}, dict(values)) for cell in row] for row in rows])


def test_the_reference_has_every_command_entry_and_function() -> None:
    pages = {name: (DOCS / f"{name}.md").read_text() for name in ("commands", "entries", "api")}
    filled = {name: reference.fill(text) for name, text in pages.items()}
    commands = [command.name or command.callback.__name__ for command in app.registered_commands]
    assert {f"## {name}" for name in commands} <= {*filled["commands"].splitlines()}
    assert "`--profile`" in filled["commands"]
    assert all(f"`{name}`" in filled["entries"] for name in Config.model_fields)
    assert "| `walkers` | whole number" in filled["entries"]
    assert all(re.search(rf"\b(bayesdrill|bd)\.{name}\b", pages["api"]) for name in bd.__all__)


@pytest.mark.slow
def test_the_example_of_a_verdict_is_what_is_printed(tmp_path: Path) -> None:
    """Every line of the page, as the bundled run prints it."""
    page = DOCS / "verdict.md"
    command = ("posterior", ROOT / "configs" / "nominal_step.yaml", "--output", tmp_path / "out")
    brief = command_line.cli(*command)
    whole = command_line.cli(*command, "--force", "--verbose")
    printed = [line.rstrip() for line in (brief.text + whole.text).splitlines()]
    for block in blocks(page, "text"):
        for line in block.splitlines():
            assert line in printed, line
    summary = (tmp_path / "out" / "summary.md").read_text().splitlines()
    shown = re.findall(r"^\| (c_m|k_e|k_s) \| (.*) \|$", page.read_text(), re.MULTILINE)
    assert len(shown) == 3
    for name, row in shown:
        line = next(line for line in summary if line.startswith(f"| {name} "))  # of its parameters
        assert {*row.split(" | ")} <= {*line.strip("| ").split(" | ")}, name


def test_documents_name_files_that_exist() -> None:
    for path in DOCUMENTS:
        for link, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]*))?\)", path.read_text()):
            target = path.parent / link if link else path
            assert target.exists(), f"{path.name}: {link}"
            if anchor:
                assert anchor in anchors(target), f"{path.name}: {link}#{anchor}"


def test_no_machine_path_or_registry_host_is_committed() -> None:
    words = ["/" + "work/", "/" + "root/", "pypi" + ".org", "python" + "hosted"]
    ignored = (".venv", ".git", "__pycache__", ".hypothesis", "results", "build")
    folders = [path for path in ROOT.iterdir() if not path.name.startswith(ignored)]
    for path in (path for folder in folders for path in (folder, *folder.rglob("*"))):
        parts = path.relative_to(ROOT).parts
        if path.is_dir() or any(part == "__pycache__" or part.endswith("_cache") for part in parts):
            continue
        text = path.read_bytes().decode("utf-8", "ignore")
        assert not [word for word in words if word in text], path


LONGEST, WIDEST = 40, 100  # words of a sentence, columns of a line
WRITTEN = [path for path in DOCUMENTS if path.name != "paper.md"]  # that is made of its template


def test_no_sentence_of_the_documents_is_too_long() -> None:
    for path in WRITTEN:
        for number, sentence in sentences(path):
            words = len(re.findall(r"\S*\w\S*", sentence))
            assert words <= LONGEST, f"{path.name}:{number}: {words} words: {sentence}"


def test_lines_of_the_documents_are_not_too_wide() -> None:
    """A line may be longer where a link, a path or a formula cannot be broken."""
    for path in WRITTEN:
        for number, line in prose(path):
            broken = len(line) <= WIDEST or " " not in re.sub(
                r"`[^`]*`|\]\([^)]*\)", "", line.strip()
            )
            assert broken, f"{path.name}:{number}: {len(line)} columns"


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_notebook_runs(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", cells(path)],
        cwd=path.parent,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


def test_every_page_is_in_the_site() -> None:
    index = (DOCS / "index.md").read_text()
    pages = {path.relative_to(DOCS).with_suffix("") for path in DOCUMENTS[1:]}
    for page in pages - {Path("index"), Path("paper.template")}:
        assert re.search(rf"^{page}$", index, re.MULTILINE), page
