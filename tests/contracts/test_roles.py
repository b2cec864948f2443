"""A rig in words of its own has every analysis that the house's has, to the number and to the word.

Mutants killed: a symbol that is known by its spelling; an analysis that a rig of a package goes without.
"""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.analysis import edits, plausibility
from bayesdrill.analysis.causes import Causes, EquivalentExplanation
from bayesdrill.analysis.friction_motion import friction_curve, friction_motions
from bayesdrill.analysis.identifiability.frictions import rivals, stall_voltage
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.latent_torque import regress_torque, torque_estimates
from bayesdrill.analysis.refits import refit_candidate
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.basics import symbols
from bayesdrill.basics.progress import SILENT
from bayesdrill.inference import derived
from bayesdrill.report import words
from bayesdrill.report.sections import causes_words, torque_words
from bayesdrill.report.sections.physics_words import effort_symbol, speed_symbol
from bayesdrill.report.sections.torque_words import regressors
from bayesdrill.rig import MotorShaft
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import Roles, usual_roles
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.selection.candidates import CandidateModels
from bayesdrill.tasks import ranking

ROOT = Path(__file__).parents[2]
TOYS = ROOT / "tests" / "toys"

T = 0.05 * np.arange(60)
V = np.where((T // 0.8) % 2 == 0, 8.0, -5.0)
TRUTH = {"t_cm": 0.03, "t_sm": 0.06, "w_sm": 3.0, "t_c1": 0.1, "v_d": 0.4, "c_s": 4e-3, "c_1": 0.01}
HALF = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
TORQUE = {
    "at": "motor",
    "smoothness": "1/2",
    "size": {"prior": "half_normal", "scale": 0.1},
    "time": {"prior": "log_uniform", "low": 0.1, "high": 1.0},
}


def case(
    rig: Model,
    own: dict[str, str],
    free: dict[str, float],
    turns: float = 1.0,
    seen: tuple[np.ndarray, ...] = (np.cumsum(V) * 0.05 * 1.1, 1.1 * V, 6.6 * V),
    **entries: Any,
) -> bd.Case:
    """`own`: its names of the usual ones; `free`: what is unknown, and where the search begins; `turns`:
    what is wrong with the unit of an angle; `seen`: angle and speeds.
    """
    rng = np.random.default_rng(5)
    angle, speed, geared = seen
    columns = {
        "alpha": (own["theta_1"], turns * angle, "rad", 0.05),
        "omega": (own["w_1"], speed, "rad/s", 0.1),
        "geared": (f"6 * {own['w_2']}", geared, "rad/s", 0.5),
    }
    table = {own[name]: x for name, x in {**NOMINAL, "k_T": 0.1, **free}.items()}
    return bd.case(
        T,
        channels={
            name: bd.Channel(x + sigma * rng.standard_normal(len(T)), unit, sigma, measures=what)
            for name, (what, x, unit, sigma) in columns.items()
        },
        inputs={"v": bd.Input(V, "V")},
        nominal=table,
        parameters={**dict.fromkeys(table, "nominal"), **{own[name]: HALF for name in free}},
        rig=rig,
        **entries,
    )


def of_record(of: bd.Case) -> Iterator[Any]:
    """Suspicions, plausibility, and what may be tried where the fit is bad; the ladder."""
    problem, posterior = of.job.problem, of.job.problem.posterior
    theta = posterior.space.vector(posterior.space.start)
    yield words.model(problem)
    yield words.record_suspicions(problem)
    yield [
        *plausibility.plausibility_of_nominal(problem),
        *plausibility.plausibility_of_gear(problem),
    ]
    yield derived.values_at(problem, theta[None])
    tried = edits.rig_candidates(
        posterior.likelihood.observations, posterior.space.full(theta[None])
    )
    yield tried
    every = [
        EquivalentExplanation(parameter=lack.parameter, value=0.1, lost=1.0)
        for lack in edits.lacks(problem.model.roles)
    ]
    yield [[*causes_words.instead(one, problem.model)] for one in every]
    models = CandidateModels.from_job(of.job, {})
    rungs = [*models.singles(), *models.singles(absorbing=True)]
    rungs += models.beyond(("friction_both",), ())
    yield [(one.name, one.about, one.source.data) for one in rungs]


def of_friction(of: bd.Case) -> Iterator[Any]:
    """What frictions did, what can be told of them, remedies, and how all of it is shown."""
    problem, posterior = of.job.problem, of.job.problem.posterior
    theta, none = posterior.space.vector(posterior.space.start), np.empty((0, len(problem.names)))
    model, full = problem.model, posterior.space.full(theta[None])
    scenery = SensitivityStudy(posterior.likelihood)
    yield tuple(plausibility.plausibility_of_course(scenery, theta))
    found = of.identify()
    yield [str(found), repr(found.study.remedies)]
    (one,), (rubs,) = posterior.likelihood.observations, friction_motions(posterior, theta, none)
    for each in rubs:
        law = each.friction
        inertia = model.roles.at_friction(law.against, law.where)
        speed = speed_symbol(law.against, inertia, model)
        yield [law.where, effort_symbol(law).latex, speed.latex]
        yield [
            each.gear,
            each.stuck,
            each.slowest,
            each.effort,
            friction_curve(one, each, full).sizes,
        ]
    yield stall_voltage(model, dict(zip(model.parameters, full[0], strict=False)))


def of_cause(rig: Model, own: dict[str, str]) -> Iterator[Any]:
    """What would explain the fit of a rig that rubs and is said not to."""
    moved = bd.respond(
        "motor_shaft",
        {**NOMINAL, "k_T": 0.1, "t_f": 0.0, "t_c1": 0.2},
        T,
        {"v": V},
        ["theta_1", "w_1", "w_2"],
    )
    seen = moved["theta_1"], moved["w_1"], 6.0 * moved["w_2"]
    of = case(rig, own, {name: NOMINAL[name] for name in ("k_e", "j_1")}, seen=seen)
    posterior = of.job.problem.posterior
    start = posterior.space.start
    few = {"friction_rotor_1", "voltage_drop", "damping_shaft", "offset_v"}  # all take a minute
    rungs = [one for one in CandidateModels.from_job(of.job, {}).singles() if one.name in few]
    given = refit_candidate(posterior, start, -math.inf)
    assert given is not None
    with WorkerPool(posterior, 1) as pool:
        work = ranking.Ranking(of.job, start, given, pool.submit_function, SILENT)
        work.refit_all(rungs, start)
    causes = Causes(given=given.fit, ranked=work._ranked())
    yield repr(causes)
    yield causes_words.explained(causes)
    yield causes_words.lacking(causes, of.job.problem.model.roles)


def of_torque(of: bd.Case) -> Iterator[Any]:
    """What a missing torque was, what it follows, and what it can stand in for."""
    posterior = of.job.problem.posterior
    theta = posterior.space.vector(posterior.space.start)
    (found,) = torque_estimates(posterior, theta[None], np.random.default_rng(1))
    yield [found.expected, found.angle, found.inertia.reduction, repr(regress_torque(found))]
    yield torque_words.law_sentences(torque_summary(found), found.rig)
    yield [(each.label.latex, each.means) for each in regressors(found)]


def analyses(rig: Model, own: dict[str, str]) -> dict[str, Any]:
    wild = {name: NOMINAL[name] for name in ("k_e", "k_T", "j_1", "k_s")}
    return {
        "record": [*of_record(case(rig, own, wild, 180 / np.pi))],
        "friction": [
            *of_friction(case(rig, own, {**TRUTH, "k_e": 0.06, "k_T": 0.06, "t_f": 0.02}))
        ],
        "cause": [*of_cause(rig, own)],
        "torque": [*of_torque(case(rig, own, wild, missing_torque=TORQUE))],
    }


def printed() -> None:
    """In a process in which the toys are installed."""
    from toy_renamed import OWN

    usual = analyses(MODELS["motor_shaft"](), {name: name for name in OWN})
    own = analyses(MODELS["toy_renamed"](), OWN)
    names = {**OWN, "motor_shaft": "toy_renamed", "i_m": "gear_down"}
    print(json.dumps([names, usual, own], default=lambda one: np.asarray(one).tolist()))


def chained() -> None:
    """In the same: a chain of three discs, and a torque at the middle one that it is without."""
    from toy_chain import Chain

    drive, dry = 0.6 * np.sign(np.sin(1.1 * T)) + 0.2, 0.15
    truth = {"mass_top": 0.02, "mass_middle": 0.03, "mass_bit": 0.01, "stiffness_pipe": 2.0}
    truth |= {"stiffness_collar": 1.5, "oil_top": 0.05}
    speeds = [f"speed_{disc}" for disc in ("top", "middle", "bit")]
    rubs = Chain(added=("oil_top", "dry_middle"))
    moved = bd.respond(rubs, {**truth, "dry_middle": dry}, T, {"t_m": drive}, speeds)
    rng = np.random.default_rng(2)
    channels = {
        name: bd.Channel(x + 0.01 * rng.standard_normal(len(T)), "rad/s", 0.01, measures=name)
        for name, x in moved.items()
    }

    def made(**entries: Any) -> bd.Case:
        return bd.case(
            T,
            channels=channels,
            inputs={"t_m": bd.Input(drive, "N*m")},
            nominal=truth,
            parameters={**dict.fromkeys(truth, "nominal"), "stiffness_pipe": HALF},
            rig=Chain(),
            **entries,
        )

    plain, lacks = made(), made(missing_torque={**TORQUE, "at": "middle"})
    models = CandidateModels.from_job(plain.job, {})
    singles = [*models.singles(), *models.singles(absorbing=True)]
    parts = {one.name: one.job().problem.names for one in singles}
    posterior = lacks.job.problem.posterior
    theta = posterior.space.vector({**posterior.space.start, "s_d": dry, "tau_d": 1.0})
    (found,) = torque_estimates(posterior, theta[None], rng)
    true, turns = -dry * np.sign(moved["speed_middle"]), np.abs(moved["speed_middle"]) > 0.3
    torque = float(np.sqrt(np.mean((found.expected - true)[turns] ** 2))) / dry
    said = torque_words.law_sentences(torque_summary(found), found.rig)
    print(json.dumps([parts, torque, said]))


def printed_by(function: str) -> Any:
    path = os.pathsep.join(map(str, (ROOT, TOYS, TOYS.parent, TOYS.parent / "contracts")))
    command = [sys.executable, "-c", f"import test_roles; test_roles.{function}()"]
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_each_part_of_a_chain_has_every_analysis() -> None:
    """Mutants killed: parts of the paper's rig alone; a torque that is divided by another inertia."""
    parts, torque, said = printed_by("chained")
    for disc in ("top", "middle", "bit"):
        assert f"dry_{disc}" in parts[f"friction_{disc}"]
        assert {f"missing_torque_{disc}"} <= {*parts}
    assert "oil_bit" in parts["damping_bit"]
    assert "loss_collar" in parts["damping_collar"]
    assert "friction_both" not in parts
    assert torque < 0.2
    assert "it follows the sign of the speed of the middle" in said
    assert "dry friction at the middle of 0.1" in said


def test_a_rig_in_other_words_has_every_analysis() -> None:
    names, usual, own = printed_by("printed")
    back = {word: name for name, word in names.items()}
    longest = sorted(back, key=len, reverse=True)
    begins = r"(?:(?<=\\n)|(?<![A-Za-z0-9]))"  # a line, as JSON has it, or a word
    words_of = re.compile(rf"{begins}({'|'.join(longest)})(?![A-Za-z0-9])")
    own = json.loads(words_of.sub(lambda found: back[found[1]], json.dumps(own)))
    for what, every in usual.items():
        assert all(every), what
        for one, other in zip(every, own[what], strict=True):
            assert unpadded(one) == unpadded(other)
    said = json.dumps(usual)
    for text in (
        "energy: k_T = ",
        "the motor turns 8 times",
        "Causes(given=",
        "dry friction at rotor 1 (t_c1)",
        "geared measures 6 * w_2",
        "t_f, which keeps",
    ):
        assert text in said
    for text in (
        "friction: ",
        "tie k_T = k_e",
        "unit: ",
        "missing torque: it follows",
    ):
        assert text in said
    assert {"friction_both", "missing_torque_motor"} <= {one[0] for one in usual["record"][-1]}


def unpadded(value: Any) -> Any:
    """Columns are as wide as names."""
    return json.loads(re.sub(r"(?:(?<= ) +)", "", json.dumps(value)))


# Where names are those of inputs, or stand in for what a config lacks.
ELSEWHERE = {"record/experiment.py", "config/resolve/quantities.py", "config/schema/records.py"} | {
    "analysis/identifiability/study.py",
    "config/loading.py",
}
ROOMS = ("rig/models/", "basics/symbols.py", "drafting/")


def test_no_module_outside_rigs_knows_a_symbol_by_its_spelling() -> None:
    known = {*symbols.PARAMETERS, *symbols.STATES, "i_m", "friction_m", "friction_1"}
    found = []
    for path in sorted((ROOT / "bayesdrill").rglob("*.py")):
        name = path.relative_to(ROOT / "bayesdrill").as_posix()
        if not name.startswith(ROOMS) and name not in ELSEWHERE:
            each = [
                n.value
                for n in ast.walk(ast.parse(path.read_text()))
                if isinstance(n, ast.Constant)
            ]
            found += [(name, one) for one in each if isinstance(one, str) and one in known]
    assert found == []


def test_roles_have_names_and_no_rig_is_asked_whether_it_has_a_member() -> None:
    usual = usual_roles()
    named = {lack.parameter for lack in edits.lacks(usual)} | {*rivals(usual)} | usual.states
    assert named <= {*symbols.PARAMETERS, *symbols.STATES}
    asked = re.compile(r"(?:get|has)attr\((?:model|rig|[a-z_.]+\.model|[a-z_.]+\.rig), [\"'](\w+)")
    for path in (ROOT / "bayesdrill").rglob("*.py"):
        assert not asked.findall(path.read_text()), path


def test_states_of_no_role_are_named() -> None:
    class Dumb(MotorShaft):
        @property
        def roles(self) -> Roles:
            motor, gearbox, rotor, _ = usual_roles().inertias
            bit = dataclasses.replace(rotor, speed="of_the_bit")
            return dataclasses.replace(usual_roles(), inertias=(motor, gearbox, bit))

    (said,) = plausibility.of_roles(SimpleNamespace(model=Dumb()))  # type: ignore[arg-type]
    assert "motor_shaft does not say what w_1 is" in said
    for rig in MODELS.usable().values():
        assert [*plausibility.of_roles(SimpleNamespace(model=rig()))] == []  # type: ignore[arg-type]
