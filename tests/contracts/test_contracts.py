"""Nobody asks a member of a registry which one it is: what is asked of it stands in its contract.

`isinstance` is recognised by the classes that it names, `getattr` and `hasattr` by the object that they
ask, or by an attribute that a contract has.
"""

import ast
import functools
import inspect
from pathlib import Path

from support.syntax import nodes

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
    *("torque", "scores"),
)
EXECUTORS = (RefitExecutor, Cluster)
PRIORS = tuple(prior for prior in priors.PRIORS.values() if inspect.isclass(prior))
# What variables are called that hold a member.
MEMBERS = {
    *("model", "rig", "noise", "prior", "response", "simulator", "observation", "observed"),
    *("optimiser", "move", "figure", "crew", "pool", "executor", "si"),
}
# By file and what is asked there.
ALLOWED = {
    ("inference/display_units.py", "getattr(si, key, None)"): "a row of a table, and no prior"
}


@functools.cache
def classes() -> set[str]:
    registries = (MODELS, NOISES, OPTIMISERS, MOVES, FORMATS, FIGURES)
    members = [registry[name] for registry in registries for name in registry]
    kinds = {member if inspect.isclass(member) else type(member) for member in members}
    kinds |= {*CONTRACTS, *SIMULATORS, *OBSERVATIONS, *EXECUTORS, *PRIORS, Mixed}
    return {kind.__name__ for kind in kinds if kind.__module__.startswith("bayesdrill.")}


@functools.cache
def attributes() -> set[str]:
    """Return the public names of contracts and members."""
    kinds = (*CONTRACTS, *SIMULATORS, *OBSERVATIONS, *EXECUTORS, *PRIORS, *NOISES.values())
    return {name for kind in kinds for name in dir(kind) if not name.startswith("_")}


def names_in(expression: ast.expr) -> set[str]:
    """Return names of classes, however they are written: `A | B`, `(A, B)`, `module.A`."""
    parts = [*ast.walk(expression)]
    attributes = {part.attr for part in parts if isinstance(part, ast.Attribute)}
    return attributes | {part.id for part in parts if isinstance(part, ast.Name)}


def offenders(path: Path) -> list[tuple[int, str]]:
    """Return lines and texts of the calls in a file that ask a member which one it is."""
    calls = []
    for node in nodes(path):
        match node:
            case ast.Call(func=ast.Name(id="isinstance"), args=[_, asked]):
                asks = bool(names_in(asked) & classes())
            case ast.Call(func=ast.Name(id="getattr" | "hasattr"), args=[of, asked, *_]):
                member = of.attr if isinstance(of, ast.Attribute) else getattr(of, "id", "")
                asks = member in MEMBERS or getattr(asked, "value", None) in attributes()
            case _:
                asks = False
        if asks:
            calls.append((node.lineno, ast.unparse(node)))
    return calls


def test_nobody_asks_a_member_which_one_it_is() -> None:
    asking = {
        (path.relative_to(PACKAGE).as_posix(), call): line
        for path in sorted(PACKAGE.rglob("*.py"))
        if not path.relative_to(PACKAGE).as_posix().startswith(REGISTRIES)
        for line, call in offenders(path)
    }
    new = {place: line for place, line in asking.items() if place not in ALLOWED}
    assert [f"{file}:{line}: {call}" for (file, call), line in new.items()] == []
    assert ALLOWED.keys() <= asking.keys()


def test_simulators_and_observations_keep_their_contracts() -> None:
    """They have all methods of their contract, which would otherwise be missed when they are called."""
    for contract, members in ((Simulator, SIMULATORS), (RefitExecutor, EXECUTORS)):
        wanted = {name for name in vars(contract) if not name.startswith("_")}
        for member in members:
            fields = getattr(member, "__annotations__", {})
            assert not wanted - {*dir(member), *fields, "model", "experiment"}, member
    assert {*DENSITY} <= {*vars(LatentTorqueObservation)}
