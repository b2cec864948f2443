"""Members of registries that packages bring: good ones work, bad ones are named and harm no other.

`tests/toys` is a package as others would install it: a file and an entry point for each member.
"""

import csv
import dataclasses
import json
import os
import re
import subprocess
import sys
import traceback
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Annotated

import pytest
import typer
from pydantic import Field
from support import document_blocks
from support.case_tables import read_table, run_cases

from bayesdrill.basics import registry
from bayesdrill.basics.entries import Strict, with_member_entries
from bayesdrill.basics.errors import Stopped
from bayesdrill.basics.registry import Registry, lookup
from bayesdrill.guard import guarded
from bayesdrill.rig.models import MODELS
from bayesdrill.sampling.optimisers import OPTIMISERS

ROOT = Path(__file__).parents[2]
TOYS = ROOT / "tests" / "toys"
LISTED = """
from bayesdrill.inference.noise import NOISES
from bayesdrill.record.formats import FORMATS
from bayesdrill.report.publish import FIGURES
from bayesdrill.rig.models import MODELS
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.samplers.ensemble import MOVES

print(*NOISES, *FORMATS, *FIGURES, *MODELS, *OPTIMISERS, *MOVES)
"""
KINDS = ("noises", "rigs", "moves", "formats", "figures", "optimisers")
CONTRACTS = [f"tests/contracts/test_{kind}.py" for kind in KINDS]


def run_python(
    *arguments: str | Path, cwd: Path = ROOT, installed: Path = TOYS
) -> subprocess.CompletedProcess[str]:
    """Run a process in which the package in `installed` is."""
    path = f"{installed}{os.pathsep}{ROOT}"
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
    )


def entry_points() -> list[tuple[str, str]]:
    """Return names and modules of the toys."""
    text = (TOYS / "toys-1.0.dist-info" / "entry_points.txt").read_text()
    return re.findall(r"^(\w+) = (\w+):", text, re.M)


@pytest.mark.slow
def test_the_toys_pass_the_contracts() -> None:
    """Each of these tests runs over all members that there are."""
    done = run_python("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *CONTRACTS)
    assert done.returncode == 0, done.stdout + done.stderr
    listed = run_python("-c", LISTED).stdout.split()
    assert {name for name in listed if name.startswith("toy_")} == {n for n, _ in entry_points()}


@pytest.mark.slow
def test_a_run_with_nothing_but_toys(tmp_path: Path) -> None:
    """The config of `docs/extending.md`, its record as JSON, and mistakes in what a toy brings."""
    text = document_blocks.files(document_blocks.DOCS / "extending.md")["toys.yaml"]
    config = tmp_path / "toys.yaml"

    def run(command: str, *options: str, status: int = 0) -> str:
        done = run_python("-m", "bayesdrill", command, config, *options, cwd=tmp_path)
        assert done.returncode == status, done.stdout + done.stderr
        return done.stderr

    config.write_text(text)
    run("simulate")
    with (tmp_path / "toys.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {name: [float(row[name]) for row in rows] for name in rows[0]}
    (tmp_path / "record.toy").write_text(json.dumps({"run": columns}))
    text = text.replace("file: toys.csv", "file: record.toy\n  inside: run")
    config.write_text(text)
    run("posterior", "--output", "out", "--processes", "1")
    rows = list(csv.DictReader((tmp_path / "out" / "summary.csv").read_text().splitlines()))
    estimates = {row["name"]: (float(row["mean"]), float(row["sd"])) for row in rows}
    assert list(estimates) == ["k_e", "tau_s", "rho_w_2"]
    for name, truth in (("tau_s", 0.015), ("rho_w_2", 0.1)):
        mean, sd = estimates[name]
        assert abs(mean - truth) < 5 * sd
    assert (tmp_path / "out" / "figures" / "toy_order.png").stat().st_size > 1000
    noise = "noise: {name: toy_memory, correlation: 0.4}"
    config.write_text(text.replace(noise, "noise: white"))
    message = run("posterior", "--output", "out", "--resume", status=2)
    assert "cannot resume: the kind of noise" in message
    config.write_text(text.replace(noise, noise.replace("0.4", "1.4")))
    message = run("check", status=2)
    assert "record.channels.w_1.noise.correlation: 1.4" in message
    assert "Traceback" not in message


def test_names_of_packages_that_are_not_installed_are_unknown() -> None:
    assert "toy_damped" not in MODELS
    with pytest.raises(ValueError, match="'motor_shft' is not a model; did you mean motor_shaft"):
        lookup(MODELS, "motor_shft", "model")


BROKEN = read_table("contracts/broken_rigs.yaml")
SOUND, MESSAGES = BROKEN["sound"], BROKEN["messages"]
ASK = """
import json
from bayesdrill.basics.registry import lookup
from bayesdrill.rig.models import MODELS
from bayesdrill.config.schema.json_schema import json_schema

errors = {}
for name in MODELS:
    try:
        lookup(MODELS, name, "model")
    except ValueError as error:
        errors[name] = str(error)
json_schema()
print(json.dumps([errors, list(MODELS.usable())]))
"""


def install(folder: Path, name: str, modules: dict[str, str], entries: list[str]) -> None:
    """Write a package as if it were installed in `folder`."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join(entries) + "\n")
    for module, text in modules.items():
        (folder / f"{module}.py").write_text(text)


def test_a_bad_rig_is_named_with_its_package_and_takes_no_other_with_it(tmp_path: Path) -> None:
    places = {name: f"broken_rigs:{name}" for name in (*SOUND, *MESSAGES)}
    places["nowhere"] = "nowhere.at_all:Rig"
    entries = ["[bayesdrill.rig]", *(f"{name} = {place}" for name, place in places.items())]
    for kind in ("noise", "format", "optimiser"):
        entries += [f"[bayesdrill.{kind}]", "odd = fractions:Fraction"]
    install(tmp_path, "broken", {"broken_rigs": BROKEN["module"]}, entries)
    done = run_python("-c", ASK, installed=tmp_path)
    assert done.returncode == 0, done.stderr
    errors, usable = json.loads(done.stdout)
    assert {*SOUND, "motor_shaft"} <= {*usable}
    assert {*errors} == {*MESSAGES}
    assert not {*MESSAGES} & {*usable}
    for name, message in MESSAGES.items():
        start = f"{name} comes from broken, and cannot be used from {places[name]} ("
        assert errors[name].startswith(start)
        assert message in errors[name]


HOSTILE = """
import dataclasses, sys
from typing import Annotated
from pydantic import Field

class Rude(BaseException):
    def __str__(self):
        raise RuntimeError("no word of why")

def fails(what):
    raise {"exit": SystemExit(0), "stop": KeyboardInterrupt(), "rude": Rude()}.get(what, TypeError(what))

@dataclasses.dataclass(frozen=True)
class Odd:
    def check(self, unknown): fails("check")
    def __call__(self, task, start, evaluations): fails("call")
    model_config: Annotated[float, Field(ge=0)] = 1.0
"""
IMPORTS = {
    "leaves": ("import sys; sys.exit(0)", "SystemExit: 0"),
    "stops": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "rude": ("import hostile; hostile.fails('rude')", "Rude"),
    "deep": ("def f(): f()\nf()", "RecursionError"),
    "syntax": ("def", "SyntaxError"),
    "nul": ("\0", "SyntaxError"),
}


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install a package whose modules fail as they are imported, or as they work."""
    modules = {f"hostile_{name}": text for name, (text, _) in IMPORTS.items()}
    entries = [f"{name} = hostile_{name}:member" for name in IMPORTS]
    entries += ["odd = hostile:Odd", "no_name = ::", "not_there = hostile:nothing"]
    modules["hostile"] = HOSTILE
    install(tmp_path, "hostile", modules, ["[bayesdrill.optimiser]", *entries])
    monkeypatch.syspath_prepend(tmp_path)
    registry._entry_points.cache_clear()
    yield tmp_path
    registry._entry_points.cache_clear()
    for name in [name for name in sys.modules if name.startswith("hostile")]:
        del sys.modules[name]


@pytest.mark.usefixtures("hostile")
def test_whatever_a_package_raises_as_it_is_loaded_names_it() -> None:
    optimisers = Registry("optimiser", {}, judge=OPTIMISERS._judge)
    bad = {*IMPORTS, "odd", "no_name", "not_there"}
    assert {*optimisers} >= bad
    assert not {*optimisers.usable()} & bad
    for name, (_, error) in IMPORTS.items():
        with pytest.raises(ValueError, match=f"^{name} comes from hostile, .*{error}"):
            optimisers[name]


@pytest.mark.usefixtures("hostile")
def test_a_signal_while_a_package_is_loaded_is_no_fault_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(EntryPoint, "load", lambda _: (_ for _ in ()).throw(Stopped()))
    with pytest.raises(Stopped):
        Registry("optimiser", {})["odd"]


@pytest.mark.usefixtures("hostile")
@run_cases("what, error", [("call", "TypeError: call"), ("exit", "SystemExit: 0")])
@run_cases("in_a_worker", [False, True])
def test_whatever_a_package_raises_as_it_works_names_it(
    what: str, error: str, in_a_worker: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A worker hands on nothing but the text of a traceback."""
    import hostile

    def task() -> None:
        try:
            hostile.fails(what)
        except BaseException as raised:
            if in_a_worker:
                raise type(raised)(*raised.args) from RuntimeError(traceback.format_exc())
            raise

    with pytest.raises(typer.Exit) as ended, guarded():
        task()
    assert ended.value.exit_code == 2
    message = capsys.readouterr().err
    assert "comes from hostile, and failed in" in message
    assert f"hostile.py:11 ({error}); repair or remove that package" in message


def test_an_entry_of_a_package_does_not_change_one_of_the_same_name() -> None:
    @dataclasses.dataclass(frozen=True)
    class Member:
        file: Annotated[int, Field(ge=3)] = 3
        more: Annotated[int, Field(ge=3)] = 3

    @with_member_entries("kind", {"a": Member})
    class Section(Strict):
        kind: str = "a"
        file: str = "x"

    assert Section.model_validate({"file": "y", "more": 4}).model_dump()["file"] == "y"
