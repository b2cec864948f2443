"""A rig, a noise, a move, a format, a figure and an optimiser, each by one file and one line.

`tests/toys` is a package as others would install it: six files, and an entry point for each.
"""

from __future__ import annotations

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
from support.case_tables import run_cases

from bayesdrill.basics import registry
from bayesdrill.basics.entries import Strict, member_section
from bayesdrill.basics.errors import Stopped
from bayesdrill.basics.registry import Registry, lookup
from bayesdrill.guard import guarded
from bayesdrill.rig.models import MODELS
from bayesdrill.sampling.optimisers import OPTIMISERS

ROOT = Path(__file__).parents[2]
TOYS = ROOT / "tests" / "toys"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(TOYS), "MPLBACKEND": "agg"}

CONFIG = """\
name: toys
seed: 3
model: {name: toy_damped, i_m: 0.1}
record:
  file: FILE
  time: {column: t, unit: s}
  channels:
    w_1: {column: w_1, unit: rad/s, sigma: 0.2, noise: {name: toy_memory, correlation: 0.4}}
    w_2: {column: w_2, unit: rad/s, sigma: 0.1, noise: toy_memory}
inputs: {v: 8.0}
nominal: {table: tables_2_3, tau_s: 0.015}
parameters:
  j_m: nominal
  c_m: nominal
  k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  k_T: nominal
  r_m: nominal
  l_m: nominal
  k_s: nominal
  j_1: nominal
  t_f: nominal
  tau_s: {prior: log_uniform, low: 0.1, high: 10, relative: true}
map: {method: toy_compass, shortest: 1.0e-3}
sampler: {ensembles: 4, walkers: 32, ess: 400, moves: {toy_walk: 0.1, independence: 0.9}}
output: {figures: [toy_order], predictive_draws: 10}
simulation: {duration: 4.0, rate: 50}
"""
KINDS = ("noises", "rigs", "moves", "formats", "recipes", "optimisers")
LISTED = """
from bayesdrill.inference.noise import NOISES
from bayesdrill.record.formats import FORMATS
from bayesdrill.report.publish import FIGURES
from bayesdrill.rig.models import MODELS
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.samplers.ensemble import MOVES

print(*NOISES, *FORMATS, *FIGURES, *MODELS, *OPTIMISERS, *MOVES)
"""
CONTRACTS = [f"tests/contracts/test_{kind}.py" for kind in KINDS]


def bayesdrill(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bayesdrill", *map(str, arguments)]
    environment = {**ENVIRONMENT, "PYTHONPATH": f"{TOYS}{os.pathsep}{ROOT}"}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)


def test_each_toy_is_one_file_and_one_line() -> None:
    lines = (TOYS / "toys-1.0.dist-info" / "entry_points.txt").read_text().splitlines()
    brought = [line.split(" = ")[1].split(":")[0] for line in lines if " = " in line]
    assert sorted(f"{module}.py" for module in brought) == sorted(p.name for p in TOYS.glob("*.py"))


@pytest.mark.slow
def test_the_toys_pass_the_contracts() -> None:
    """Each of these tests runs over all members that there are."""

    def ran(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        done = subprocess.run(command, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    ran("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *CONTRACTS)
    assert set(re.findall(r"toy_[a-z]+", ran("-c", LISTED))) == {
        "toy_braked",
        "toy_damped",
        "toy_renamed",
        "toy_chain",
        "toy_memory",
        "toy_walk",
        "toy_json",
        "toy_order",
        "toy_compass",
    }


@pytest.mark.slow
def test_a_run_with_nothing_but_toys(tmp_path: Path) -> None:
    """From a simulated record to the report; and a mistake in what a toy brings is told as any other."""
    text = (tmp_path / "text.yaml", tmp_path / "json.yaml")
    text[0].write_text(CONFIG.replace("FILE", "record.csv"))
    done = bayesdrill("simulate", text[0], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "record.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {name: [float(row[name]) for row in rows] for name in rows[0]}
    (tmp_path / "record.toy").write_text(json.dumps({"run": columns}))
    text[1].write_text(CONFIG.replace("file: FILE", "file: record.toy\n  inside: run"))
    done = bayesdrill("posterior", text[1], "--output", "out", "--processes", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = list(csv.DictReader((tmp_path / "out" / "summary.csv").read_text().splitlines()))
    found = {row["name"]: row for row in rows}
    assert list(found) == ["k_e", "tau_s", "rho_w_2"]
    assert abs(float(found["tau_s"]["mean"]) - 0.015) < 5 * float(found["tau_s"]["sd"])
    assert abs(float(found["rho_w_2"]["mean"]) - 0.1) < 5 * float(found["rho_w_2"]["sd"])
    assert (tmp_path / "out" / "figures" / "toy_order.png").stat().st_size > 1000
    white = (
        text[1].read_text().replace("noise: {name: toy_memory, correlation: 0.4}", "noise: white")
    )
    text[1].write_text(white)
    done = bayesdrill("posterior", text[1], "--output", "out", "--resume", cwd=tmp_path)
    assert done.returncode == 2
    assert "cannot resume: the kind of noise" in done.stderr
    text[1].write_text(white.replace("noise: white", "noise: {name: toy_memory, correlation: 1.4}"))
    done = bayesdrill("check", text[1], cwd=tmp_path)
    assert done.returncode == 2
    assert "record.channels.w_1.noise.correlation: 1.4" in done.stderr
    assert "Traceback" not in done.stderr


def test_without_them_their_names_are_unknown(tmp_path: Path) -> None:
    assert "toy_damped" not in MODELS
    with pytest.raises(ValueError, match="'motor_shft' is not a model; did you mean motor_shaft"):
        lookup(MODELS, "motor_shft", "model")


BROKEN = """
import dataclasses, math
from typing import ClassVar
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig import Coulomb, Friction, Model
from bayesdrill.rig.models.motor_shaft import PARAMETERS, MotorShaft

class NoDataclass:
    name = "odd"

@dataclasses.dataclass(frozen=True)
class Base(Model):
    name: ClassVar[str] = "odd"
    declares: ClassVar[tuple] = ()
    parameters: ClassVar[tuple] = PARAMETERS
    states: ClassVar[tuple] = MotorShaft.states
    inputs: ClassVar[tuple] = MotorShaft.inputs
    def linear(self, p):
        return MotorShaft().linear(p)

@dataclasses.dataclass(frozen=True)
class Stranger:
    name = "stranger"

@dataclasses.dataclass(frozen=True)
class Nameless(Model):
    name = "nameless"

class OtherName(Base):
    name = "even"

class Right(Base):
    name = "right"

class Known(Base):
    name = "known"
    declares = (Symbol("c_s", "N*m*s/rad", "c_s", "N", "of the shaft, as the house has it"),)
    parameters = (*MotorShaft.parameters, "c_s")
    def linear(self, p):
        return MotorShaft(added=("c_s",)).linear(p)

class Brake(Base):
    name = "brake"
    frictions = (Friction(name="friction_1", against="w_1", law=Coulomb("t_f")),)
    def linear(self, p):
        found = MotorShaft().linear(p)
        column = {("w_1", "friction_1"): -1.0 / p["j_1"]}
        return dataclasses.replace(found, B={**found.B, **column})

class NoColumn(Brake):
    name = "no_column"
    def linear(self, p):
        return MotorShaft().linear(p)

class NoState(Brake):
    name = "no_state"
    frictions = (Friction(name="friction_1", against="w_3", law=Coulomb("t_x")),)

class TakenName(Brake):
    name = "taken_name"
    frictions = (Friction(name="t_1", against="w_1", law=Coulomb("t_f")),)

class Rough:
    parameters, seen, steady = ("t_f",), (), True
    def size(self, p, speed, seen):
        return math.tanh(speed) * p["t_f"]

class NoLaw(Brake):
    name = "no_law"
    frictions = (Friction(name="friction_1", against="w_1", law=Rough()),)

@dataclasses.dataclass(frozen=True)
class NoDefault(Base):
    i_m: float
    name = "no_default"

class NoSymbol(Base):
    name = "no_symbol"
    parameters = (*PARAMETERS, "c_x")

class OtherUnit(Base):
    name = "other_unit"
    declares = (Symbol("j_1", "m", "j_1", "m", "a length"),)

class Exponential(Base):
    name = "exponential"
    def linear(self, p):
        math.exp(p["j_1"])

class OtherState(Base):
    name = "other_state"
    def linear(self, p):
        found = MotorShaft().linear(p)
        return dataclasses.replace(found, A={**found.A, ("w_3", "w_1"): 1.0})
"""


RIGS = {
    "nowhere": ("nowhere.at_all:Rig", "ModuleNotFoundError: No module named 'nowhere'"),
    "no_dataclass": ("broken_rigs:NoDataclass", "a rig is a frozen dataclass"),
    "stranger": ("broken_rigs:Stranger", "it is no bayesdrill.rig.Model; derive it from that"),
    "nameless": ("broken_rigs:Nameless", "it has no parameters, states, inputs, declares, linear"),
    "other_name": (
        "broken_rigs:OtherName",
        "its name is 'even', and its entry point's 'other_name'",
    ),
    "no_symbol": ("broken_rigs:NoSymbol", "no symbol is declared of c_x"),
    "other_unit": ("broken_rigs:OtherUnit", "it declares j_1 in m; that is kg*m**2"),
    "exponential": ("broken_rigs:Exponential", "more than + - * / and whole powers"),
    "no_column": (
        "broken_rigs:NoColumn",
        "`linear` has no column of the friction friction_1 in `B`",
    ),
    "no_state": (
        "broken_rigs:NoState",
        "the friction friction_1 names w_3, t_x, which the rig has",
    ),
    "taken_name": ("broken_rigs:TakenName", "a friction is called t_1, which is something else"),
    "no_law": ("broken_rigs:NoLaw", "the friction friction_1: its law wants what it does not name"),
    "no_default": ("broken_rigs:NoDefault", "each field wants a default (TypeError"),
    "other_state": ("broken_rigs:OtherState", "`linear` names w_3, no state or input of it"),
}
OTHERS = ("noise", "format", "optimiser")
ASK = """
import json
from bayesdrill.basics.registry import lookup
from bayesdrill.rig.models import MODELS
from bayesdrill.config.schema.json_schema import json_schema

said = {}
for name in MODELS:
    try:
        lookup(MODELS, name, "model")
    except ValueError as error:
        said[name] = str(error)
json_schema()
print(json.dumps({"said": said, "usable": list(MODELS.usable())}))
"""


def test_what_is_none_is_named_and_takes_no_other_with_it(tmp_path: Path) -> None:
    """A package that is broken in all its parts, in the way of nobody who does not ask for one."""
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (tmp_path / "broken_rigs.py").write_text(BROKEN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, (value, _) in RIGS.items()]
    fine = [f"{name.lower()} = broken_rigs:{name}" for name in ("Right", "Known", "Brake")]
    lines = ["[bayesdrill.rig]", *fine, *lines]
    for what in OTHERS:
        lines += [f"[bayesdrill.{what}]", "odd = fractions:Fraction"]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-c", ASK]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert {"right", "known", "brake", "motor_shaft"} <= {*told["usable"]}
    assert {*told["said"]} == {*RIGS}
    assert not {*RIGS} & {*told["usable"]}
    for name, (value, says) in RIGS.items():
        start = f"{name} is brought by broken, and cannot be used from {value} ("
        assert told["said"][name].startswith(start)
        assert says in told["said"][name]


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
    """A package that does what none should, as if it were installed."""
    info = tmp_path / "hostile-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: hostile\nVersion: 1.0\n")
    lines = [f"{name} = hostile_{name}:member" for name in IMPORTS]
    lines += ["odd = hostile:Odd", "no_name = ::", "not_there = hostile:nothing"]
    (info / "entry_points.txt").write_text("\n".join(["[bayesdrill.optimiser]", *lines]))
    (tmp_path / "hostile.py").write_text(HOSTILE)
    for name, (text, _) in IMPORTS.items():
        (tmp_path / f"hostile_{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    registry._entry_points.cache_clear()
    yield tmp_path
    registry._entry_points.cache_clear()
    for name in [name for name in sys.modules if name.startswith("hostile")]:
        del sys.modules[name]


@pytest.mark.usefixtures("hostile")
def test_whatever_is_raised_as_a_package_is_loaded_names_it() -> None:
    found = Registry("optimiser", {}, judge=OPTIMISERS._judge)
    assert {*found} >= {*IMPORTS, "odd", "no_name", "not_there"}
    assert not {*found.usable()} & {*IMPORTS, "odd", "no_name", "not_there"}
    for name, (_, why) in IMPORTS.items():
        with pytest.raises(ValueError, match=f"^{name} is brought by hostile, .*{why}"):
            found[name]


@pytest.mark.usefixtures("hostile")
def test_a_signal_while_a_package_is_loaded_is_no_fault_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(EntryPoint, "load", lambda _: (_ for _ in ()).throw(Stopped()))
    with pytest.raises(Stopped):
        Registry("optimiser", {})["odd"]


@pytest.mark.usefixtures("hostile")
@run_cases("what, why", [("call", "TypeError: call"), ("exit", "SystemExit: 0")])
@run_cases("elsewhere", [False, True])
def test_whatever_is_raised_as_it_works_names_it(
    what: str, why: str, elsewhere: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """In this process, or in a worker, which hands on nothing but the text of a traceback."""
    import hostile

    def task() -> None:
        try:
            hostile.fails(what)
        except BaseException as error:
            if elsewhere:
                raise type(error)(*error.args) from RuntimeError(traceback.format_exc())
            raise

    with pytest.raises(typer.Exit) as ended, guarded():
        task()
    assert ended.value.exit_code == 2
    said = capsys.readouterr().err
    assert "is brought by hostile, and failed in" in said
    assert f"hostile.py:11 ({why}); mend or remove that package" in said


def test_a_mistake_of_the_house_is_blamed_on_nobody() -> None:
    with pytest.raises(ZeroDivisionError), guarded():
        raise ZeroDivisionError


def test_an_entry_that_has_its_meaning_keeps_it() -> None:
    """What another package calls as the house does an entry of its own."""

    class Base(Strict):
        kind: str = "a"
        file: str = "x"

    @dataclasses.dataclass(frozen=True)
    class Theirs:
        file: Annotated[int, Field(ge=3)] = 3
        more: Annotated[int, Field(ge=3)] = 3

    made = member_section("Made", Base, "kind", {"a": Theirs})
    assert made.model_validate({"file": "y", "more": 4}).model_dump()["file"] == "y"


def test_own_members_come_first() -> None:
    registry = Registry("nothing that anyone brings", {"one": 1, "two": 2})
    assert dict(registry) == registry.usable() == {"one": 1, "two": 2}
    assert len(registry) == 2
    with pytest.raises(KeyError):
        registry["three"]
