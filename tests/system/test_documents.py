"""Every command in the documents runs, and every config in them is one."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from bayesdrill.setup import loading

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project whose `.venv` is the environment of this test."""
    copy = tmp_path_factory.mktemp("clone") / "bayesdrill"
    ignore = shutil.ignore_patterns(
        ".venv", ".venv-*", ".git", "nominal_step", "__pycache__", ".*_cache"
    )
    shutil.copytree(ROOT, copy, ignore=ignore)
    (copy / ".venv").symlink_to(sys.prefix)
    for name, held in HELD.items():
        lighten(copy / "configs" / f"{name}.yaml", held)
    return copy


# What is held in the copy, so that few unknowns are left; the record of the second has another k_T.
HELD = {
    "nominal_step": dict.fromkeys(("j_m", "c_m", "k_T", "r_m", "l_m", "t_f"), "nominal"),
    "example_rig": dict.fromkeys(("j_m", "c_m", "l_m", "k_e", "t_f"), "nominal") | {"k_T": "0.1"},
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


def run(command: str, tree: Path) -> subprocess.CompletedProcess[str]:
    """As a newcomer types it, but `make` takes the environment as set up, and the tests that
    `make test` would run (these) are only collected, and not all of them."""
    command = re.sub(r"^make ", "make -o .venv/.ready ", command)
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTEST_ADDOPTS": "--collect-only -q tests/basics",
        "PYTHONPATH": str(tree),
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
    scripts = [block for path in DOCUMENTS for block in blocks(path, "python")]
    assert any("plot_corner" in script for script in scripts)
    for script in scripts:
        done = run(f"python - <<'END'\n{script}END", tree)
        assert done.returncode == 0, f"{script}\n{done.stdout}\n{done.stderr}"


def test_every_command_runs_in_order(tree: Path) -> None:
    """One after the other, as the README has them: later ones need what earlier ones left."""
    commands = [
        line for path in DOCUMENTS for block in blocks(path, "sh") for line in block.splitlines()
    ]
    assert "make posterior" in commands
    assert "make test" in commands
    for command in commands:
        done = run(command, tree)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
    assert (tree / "results" / "nominal_step" / "figures" / "corner.pdf").exists()
    assert (tree / "results" / "example_rig" / "summary.md").exists()


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
    config, _ = loading.load(path)
    assert config.parameters.j_1 == 0.0283


def test_documents_name_files_that_exist() -> None:
    for path in DOCUMENTS:
        for link in re.findall(r"\]\(([^)#:]+)\)", path.read_text()):
            assert (path.parent / link).exists(), f"{path.name}: {link}"


def test_no_machine_path_or_registry_host_is_committed() -> None:
    words = ["/" + "work/", "/" + "root/", "pypi" + ".org", "python" + "hosted"]
    for path in ROOT.rglob("*"):
        parts = path.relative_to(ROOT).parts
        others = (".venv", ".git", "__pycache__", ".hypothesis")
        if path.is_file() and parts[0] != "results":
            if any(part.startswith(others) or part.endswith("_cache") for part in parts):
                continue
            text = path.read_bytes().decode("utf-8", "ignore")
            assert not [word for word in words if word in text], path
