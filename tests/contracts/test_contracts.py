"""Nobody asks a member of a registry which one it is: what is asked of it stands in its contract.

All offenders come together, each with file and line.  `isinstance` is told by the classes that it
names; `getattr` and `hasattr` by what they are asked of, or by the attribute, where a contract has it.
"""

from __future__ import annotations

import ast
import functools
import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest

import bayesdrill
from bayesdrill.inference import priors
from bayesdrill.inference.likelihood import LatentTorqueObservation, Observation
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise
from bayesdrill.inference.noise.mixed import Mixed
from bayesdrill.record.formats import FORMATS
from bayesdrill.report.publish import FIGURES
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.stepped import Stepped
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Optimiser
from bayesdrill.sampling.samplers.ensemble import MOVES, Move
from bayesdrill.tasks.remote import Cluster, RefitExecutor

PACKAGE = Path(bayesdrill.__file__).parent

# Where members stand, and are told apart by what makes them.
REGISTRIES = (
    "rig/models/",
    "rig/simulators/__init__.py",
    "rig/simulators/linear.py",
    "rig/simulators/stepped.py",
    "inference/noise/",
    "inference/priors.py",
    "inference/likelihood.py",
    "sampling/optimisers/",
    "sampling/samplers/",
    "record/formats/",
    "report/publish.py",
    "tasks/remote.py",
)
CONTRACTS = (Model, Simulator, Noise, priors.Prior, Observation, Optimiser, Move, RefitExecutor)
SIMULATORS = (Response, Stepped)
OBSERVATIONS = (Observation, LatentTorqueObservation)
# Of an observation whose density is not that of independent residuals all this is its own.
DENSITY = (
    *("by_channel", "pointwise", "whiten", "whitened_jacobian", "quadratic_terms", "expected"),
    *("fitted", "predict", "draw", "replicate", "with_fixed_covariance", "unknowns", "white"),
    *("kind", "torque"),
)
EXECUTORS = (RefitExecutor, Cluster)
PRIORS = tuple(one for one in priors.PRIORS.values() if inspect.isclass(one))
# What variables are called that hold a member.
MEMBERS = {
    *("model", "rig", "noise", "prior", "response", "simulator", "observation", "observed"),
    *("optimiser", "move", "figure", "crew", "pool", "executor", "si"),
}
# By file and what is asked there.
ALLOWED = {
    ("inference/display_units.py", "getattr(si, key, None)"): "a row of a table, and no prior",
}


@functools.cache
def classes() -> set[str]:
    registries = (MODELS, NOISES, OPTIMISERS, MOVES, FORMATS, FIGURES)
    members = [registry[name] for registry in registries for name in registry]
    own = {one if inspect.isclass(one) else type(one) for one in members}
    every = (*own, *CONTRACTS, *SIMULATORS, *OBSERVATIONS, *EXECUTORS, *PRIORS, Mixed)
    return {one.__name__ for one in every if one.__module__.startswith("bayesdrill.")}


@functools.cache
def attributes() -> set[str]:
    """Of contracts and members, those that everything has left out."""
    of = (*CONTRACTS, *SIMULATORS, *OBSERVATIONS, *EXECUTORS, *PRIORS, *NOISES.values())
    return {name for one in of for name in dir(one) if not name.startswith("_")}


def calls(text: str) -> Iterator[tuple[ast.Call, str, ast.expr, ast.expr]]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) > 1:
            yield node, node.func.id, node.args[0], node.args[1]


def names_in(expression: ast.expr) -> set[str]:
    """Of classes, however they are written: `A | B`, `(A, B)`, `module.A`."""
    found = {node.id for node in ast.walk(expression) if isinstance(node, ast.Name)}
    return found | {node.attr for node in ast.walk(expression) if isinstance(node, ast.Attribute)}


def offenders(text: str) -> list[tuple[int, str]]:
    kinds, known, found = classes(), attributes(), []
    for node, function, of, what in calls(text):
        last = of.attr if isinstance(of, ast.Attribute) else getattr(of, "id", "")
        asked = what.value if isinstance(what, ast.Constant) else None
        kind = function == "isinstance" and bool(names_in(what) & kinds)
        attribute = function in ("getattr", "hasattr") and (last in MEMBERS or asked in known)
        if kind or attribute:
            found.append((node.lineno, ast.unparse(node)))
    return found


def test_nobody_asks_a_member_which_one_it_is() -> None:
    found, used = [], set()
    for path in sorted(PACKAGE.rglob("*.py")):
        file = str(path.relative_to(PACKAGE))
        if not file.startswith(REGISTRIES):
            for line, call in offenders(path.read_text()):
                used.add((file, call))
                if (file, call) not in ALLOWED:
                    found.append(f"{file}:{line}: {call}")
    assert not found, "\n" + "\n".join(found)
    assert ALLOWED.keys() <= used


@pytest.mark.parametrize(
    "code",
    [
        "isinstance(one.response, Stepped)",
        "isinstance(one, White | AR1)",
        "isinstance(one, (likelihood.LatentTorqueObservation, int))",
        "isinstance(rig, MotorShaft)",
        "getattr(one.noise, name)",
        "getattr(anything, 'with_counts', None)",
        "hasattr(one, 'gear_ratio')",
        "getattr(prior, name)",
    ],
)
def test_it_would_be_seen(code: str) -> None:
    assert offenders(f"def f():\n    return {code}") == [(2, code)]


def test_what_is_no_member_may_be_asked() -> None:
    assert not offenders("isinstance(value, float | int)\ngetattr(error, 'errno', None)")


def test_simulators_and_observations_keep_their_contracts() -> None:
    """Whole, and by the same names: what is only found when it is called is found here."""
    for contract, members in ((Simulator, SIMULATORS), (RefitExecutor, EXECUTORS)):
        wanted = {name for name in vars(contract) if not name.startswith("_")}
        for one in members:
            fields = getattr(one, "__annotations__", {})
            own = {*dir(one), *fields, "model", "experiment"}
            assert not wanted - own, one
    assert {*DENSITY} <= {*vars(LatentTorqueObservation)}
