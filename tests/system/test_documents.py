"""Every command in the documents runs, and every config in them is one."""

from __future__ import annotations

import csv
import math
import os
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from support.case_tables import run_cases
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
from support.scipy_oracles import NOMINAL

from bayesdrill.config import loading

# Of all other pages: mostly the same commands for the same configs.
README = ROOT / "README.md"


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project whose `.venv` is the environment of this test."""
    copy = tmp_path_factory.mktemp("clone") / "bayesdrill"
    shutil.copytree(ROOT, copy, ignore=_of_this_place)
    (copy / ".venv").symlink_to(sys.prefix)
    for name, held in HELD.items():
        config = copy / "configs" / f"{name}.yaml"
        if config.exists():
            lighten(config, held)
    return copy


def _of_this_place(folder: str, names: list[str]) -> set[str]:
    """What a clone would not have: environments, caches, and runs."""
    others = shutil.ignore_patterns(".venv*", "build", ".git", "__pycache__", ".*_cache")
    runs = {*names} - {"README.md", "published"} if Path(folder) == ROOT / "results" else set()
    return {*others(folder, names), *runs}


# What is held in the copy, so that few unknowns are left; the record of the second has another k_T.
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
    """Targets that are soon met: what is tested are the commands; CI runs `make posterior` as it is."""
    text = re.sub(r"^sampler:.*\n(  .*\n)*", "", config.read_text(), flags=re.M)
    for name, value in held.items():
        text = re.sub(rf"^  {name}: {{.*$", f"  {name}: {value}", text, flags=re.M)
    drawn = "[corner]" if config.stem == "nominal_step" else "[]"
    config.write_text(text + LIGHT.replace("[]", drawn))


def lay_out(page: Path, tree: Path) -> None:
    """The files that a page shows, where its commands look for them."""
    for name, text in files(page).items():
        (tree / name).write_text(text)
        if (held := HELD.get(Path(name).stem)) is not None:
            lighten(tree / name, held)


def run(command: str, tree: Path) -> subprocess.CompletedProcess[str]:
    """As a newcomer types it, but `make` takes the environment as set up, and the tests that
    `make test` would run (these) are only collected, and not all of them."""
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


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_notebook_runs(path: Path) -> None:
    """As it is; `make docs` draws its pictures."""
    done = subprocess.run(
        [sys.executable, "-"],
        input=cells(path),
        cwd=path.parent,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


def test_every_script_and_notebook_is_python() -> None:
    for path in DOCUMENTS:
        compile(script(path), path.name, "exec")
    assert len(NOTEBOOKS) == 6
    for path in NOTEBOOKS:
        compile(cells(path), path.name, "exec")
        assert "assert run.converged" in cells(path), path.name


@pytest.fixture(scope="module")
def ran() -> set[str]:
    """The commands that ran in the tree: no run overwrites another."""
    return set()


@pytest.mark.slow
def test_every_command_runs_in_order(tree: Path, ran: set[str]) -> None:
    """One after the other, as the README has them: later ones need what earlier ones left."""
    follow(README, tree, ran)
    assert {"make posterior", "make test"} <= ran
    assert (tree / "results" / "nominal_step" / "figures" / "corner.pdf").exists()
    assert (tree / "results" / "example_rig" / "summary.md").exists()


@pytest.mark.slow
def test_the_numbers_of_one_motor_are_those_of_its_page(tree: Path, ran: set[str]) -> None:
    """At most eight commands lead to them, and their sds cover what windows of the record say."""
    page = DOCS / "one-motor.md"
    follow(page, tree, ran)
    assert len(commands(page)) <= 8
    units = {"K": 180 / math.pi, "T": 1e3, "t_0": 1e3}  # of the page, for one SI
    found = {}
    for name in ("one_motor", "one_motor_drift"):
        with (tree / "results" / name / "summary.csv").open() as file:
            rows = {row["name"]: row for row in csv.DictReader(file)}
        found[name] = {
            symbol: (unit * float(rows[symbol]["mean"]), unit * float(rows[symbol]["sd"]))
            for symbol, unit in units.items()
        }
    ranges = {"K": (158, 162), "T": (34, 40), "t_0": (17, 22)}
    windows = {"K": (160.2, 162.0), "T": (38.9, 39.4), "t_0": (16.89, 17.0)}
    for symbol, (low, high) in ranges.items():
        shown = re.findall(rf"^\| `{symbol}` .*?\| ([\d.]+) ", page.read_text(), re.M)
        for name, text in zip(found, shown, strict=True):
            mean, sd = found[name][symbol]
            assert low <= round(mean, 1) <= high
            assert float(text) == pytest.approx(mean, abs=sd)
        mean, sd = found["one_motor_drift"][symbol]
        assert all(abs(value - mean) < 2 * sd for value in windows[symbol])
    assert found["one_motor"]["K"][1] < 0.2 < found["one_motor_drift"]["K"][1] < 1.0


@pytest.mark.slow
def test_commands_of_all_other_pages_run(tree: Path, ran: set[str]) -> None:
    for path in DOCUMENTS:
        follow(path, tree, ran)
    assert len(ran) > 30


def follow(path: Path, tree: Path, ran: set[str]) -> None:
    """What a page says, in its order; what another page said before has been done."""
    lay_out(path, tree)
    for command in commands(path):
        if command in ran:
            continue
        ran.add(command)
        done = run(command, tree)
        status = 3 if "# ends with status 3" in command else 0
        assert done.returncode == status, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr


def test_commands_named_in_the_text_exist(tree: Path) -> None:
    """Inline `make x` and `bayesdrill x` too."""
    text = "\n".join(path.read_text() for path in DOCUMENTS)
    targets = set(re.findall(r"`make ([a-z-]+)", text))
    makefile = (ROOT / "Makefile").read_text()
    assert targets
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)
    for command in set(re.findall(r"`bayesdrill ([a-z]+)", text)):
        done = run(f"bayesdrill {command} --help", tree)
        assert done.returncode == 0, command
        assert "Example:" in done.stdout, command


def test_bare_make_prints_its_targets(tree: Path) -> None:
    done = run("make -s", tree)
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for target in phony.group(1).split():
        if target != "help":
            assert f"make {target}" in done.stdout


def test_the_readmes_own_config_is_valid(tree: Path) -> None:
    """Its block, completed with what it leaves out."""
    (block,) = blocks(ROOT / "README.md", "yaml")
    rest = "".join(f"  {name}: nominal\n" for name in ("j_m", "c_m", "k_T", "l_m", "t_f"))
    path = tree / "configs" / "readme.yaml"
    path.write_text(f"name: readme\nseed: 1\n{block}{rest}")
    config = loading.load(path).config
    assert config.parameters["j_1"] == 0.0283


REST: dict[str, Any] = {
    "name": "page",
    "seed": 1,
    "record": {"file": "r.csv", "time": {"column": "t", "unit": "s"}},
    "inputs": {"v": 8.0},
    "parameters": dict.fromkeys(NOMINAL, "nominal")
    | {"j_1": {"prior": "uniform", "low": 0.01, "high": 0.1}},
}
ANY_CHANNEL = {"theta_1": {"column": "a", "unit": "rad", "sigma": 0.1}}


COMPLETED = [block for page in ("record", "rigs") for block in blocks(DOCS / f"{page}.md", "yaml")]


@run_cases("block", COMPLETED)
def test_every_block_of_the_pages_on_records_and_rigs_is_valid(block: str, tmp_path: Path) -> None:
    """Completed with what it leaves out."""
    yaml = YAML(typ="safe")
    given = yaml.load(block)
    if "name" in given and "parameters" in given:
        whole = given
    elif (
        "model" in given and given["model"]["name"] != "motor_shaft"
    ):  # other inputs, other parameters
        whole = {**REST, **given, "record": {**REST["record"], "channels": ANY_CHANNEL}}
        whole["record"] |= given.get("record", {})
    else:
        whole = _of_the_papers_rig(given)
    with (tmp_path / "page.yaml").open("w") as file:
        yaml.dump(whole, file)
    config = loading.load(tmp_path / "page.yaml").config
    assert config.record.channels


def _of_the_papers_rig(given: dict[str, Any]) -> dict[str, Any]:
    both = {key: {**REST.get(key, {}), **value} for key, value in given.items()}
    both.get("record", {}).setdefault("channels", ANY_CHANNEL)
    return REST | {"record": REST["record"] | {"channels": ANY_CHANNEL}} | both


def test_documents_name_files_that_exist() -> None:
    for path in DOCUMENTS:
        for link, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]*))?\)", path.read_text()):
            target = path.parent / link if link else path
            assert target.exists(), f"{path.name}: {link}"
            if anchor:
                assert anchor in anchors(target), f"{path.name}: {link}#{anchor}"


def test_no_machine_path_or_registry_host_is_committed() -> None:
    words = ["/" + "work/", "/" + "root/", "pypi" + ".org", "python" + "hosted"]
    for path in ROOT.rglob("*"):
        parts = path.relative_to(ROOT).parts
        others = (".venv", ".git", "__pycache__", ".hypothesis")
        if path.is_file() and parts[0] not in ("results", "build"):
            if any(part.startswith(others) or part.endswith("_cache") for part in parts):
                continue
            text = path.read_bytes().decode("utf-8", "ignore")
            assert not [word for word in words if word in text], path


def test_no_place_is_left_to_be_worded() -> None:
    for path in DOCUMENTS:
        assert "@@" not in path.read_text(), path


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


def test_the_readme_is_short_and_the_glossary_in_order() -> None:
    assert len(README.read_text().splitlines()) <= 120
    terms = re.findall(r"^## (.*)$", (DOCS / "glossary.md").read_text(), re.MULTILINE)
    assert terms == sorted(terms, key=str.lower)
    assert len(terms) > 70
