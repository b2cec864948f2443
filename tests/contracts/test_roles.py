"""A rig of a package, in names of its own, has every analysis of `motor_shaft`, to the word."""

import ast
import dataclasses
import json
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
from support.syntax import nodes

import bayesdrill as bd
from bayesdrill.analysis import edits, plausibility
from bayesdrill.analysis.causes import Causes, EquivalentExplanation
from bayesdrill.analysis.friction_motion import friction_curve, friction_motions
from bayesdrill.analysis.identifiability.frictions import rivals, stall_voltage
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.latent_torque import regress_torque, torque_estimates
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.analysis.suspicions import suspicions_of_problem
from bayesdrill.basics import symbols
from bayesdrill.basics.progress import SILENT
from bayesdrill.inference import derived
from bayesdrill.report import words
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.sections.causes import describe_causes, instead, lacking
from bayesdrill.report.sections.friction import effort_symbol, speed_symbol
from bayesdrill.report.sections.torque import law_sentences, regressors
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
ANGLE = np.cumsum(V) * 0.05 * 1.1
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
    names: dict[str, str],
    free: dict[str, float],
    seen: tuple[np.ndarray, ...] = (ANGLE, ANGLE, 1.1 * V, 6.6 * V),
    **entries: Any,
) -> bd.Case:
    """Return a case of a rig that calls the usual symbols by other `names`.

    `free` has the starts of the unknowns, and `seen` two angles, a speed and that of the motor.
    """
    rng = np.random.default_rng(5)
    channels = {
        "alpha": (names["theta_1"], seen[0], "rad", 0.05),
        "beta": (names["theta_2"], seen[1], "rad", 0.05),
        "omega": (names["w_1"], seen[2], "rad/s", 0.1),
        "geared": (f"6 * {names['w_2']}", seen[3], "rad/s", 0.5),
    }
    table = {names[name]: x for name, x in {**NOMINAL, "k_T": 0.1, **free}.items()}
    return bd.case(
        T,
        channels={
            name: bd.Channel(x + sigma * rng.standard_normal(len(T)), unit, sigma, measures=what)
            for name, (what, x, unit, sigma) in channels.items()
        },
        inputs={"v": bd.Input(V, "V")},
        nominal=table,
        parameters={**dict.fromkeys(table, "nominal"), **{names[name]: HALF for name in free}},
        rig=rig,
        **entries,
    )


def analyses_of_record(of: bd.Case) -> Iterator[Any]:
    """Suspicions, plausibility, what may be tried where the fit is bad, and the rungs of the ladder."""
    problem, posterior = of.job.problem, of.job.problem.posterior
    theta = posterior.space.vector(posterior.space.start)
    yield words.model(problem)
    yield finding_sentences(suspicions_of_problem(problem))
    yield finding_sentences(plausibility.plausibility_of_nominal(problem))
    yield finding_sentences(plausibility.plausibility_of_gear(problem))
    yield derived.values_at(problem, theta[None])
    full = posterior.space.full(theta[None])
    yield edits.rig_candidates(posterior.likelihood.observations, full)
    lacks = edits.lacks(problem.model.roles)
    explanations = [
        EquivalentExplanation(parameter=lack.parameter, value=0.1, lost=1.0) for lack in lacks
    ]
    yield [[*instead(each, problem.model)] for each in explanations]
    models = CandidateModels.from_job(of.job, {})
    rungs = [*models.singles(), *models.singles(absorbing=True)]
    rungs += models.extensions(("friction_both",), models.changes)
    yield [(rung.names, [each.description for each in rung.changes], rung.data) for rung in rungs]


def analyses_of_friction(of: bd.Case) -> Iterator[Any]:
    """What frictions did, what can be inferred of them, remedies, and how all of it is shown."""
    problem, posterior = of.job.problem, of.job.problem.posterior
    theta, none = posterior.space.vector(posterior.space.start), np.empty((0, len(problem.names)))
    model, full = problem.model, posterior.space.full(theta[None])
    found = plausibility.plausibility_of_course(SensitivityStudy(posterior.likelihood), theta)
    yield finding_sentences(found)
    identified = of.identify()
    yield [str(identified), repr(identified.study.remedies)]
    (observation,) = posterior.likelihood.observations
    (motions,) = friction_motions(posterior, theta, none)
    for motion in motions:
        law = motion.friction
        inertia = model.roles.at_friction(law.against, law.where)
        speed = speed_symbol(law.against, inertia, model)
        yield [law.where, effort_symbol(law).latex, speed.latex]
        curve = friction_curve(observation, motion, full).sizes
        yield [motion.gear, motion.stuck_later, motion.slowest, motion.effort, curve]
    yield stall_voltage(model, dict(zip(model.parameters, full[0], strict=False)))


def analyses_of_causes(rig: Model, names: dict[str, str]) -> Iterator[Any]:
    """What would explain the fit of a rig without friction to the record of one that has it."""
    truth = {**NOMINAL, "k_T": 0.1, "t_f": 0.0, "t_c1": 0.2}
    motion = bd.respond("motor_shaft", truth, T, {"v": V}, ["theta_1", "theta_2", "w_1", "w_2"])
    seen = (*(motion[name] for name in ("theta_1", "theta_2", "w_1")), 6.0 * motion["w_2"])
    of = case(rig, names, {name: NOMINAL[name] for name in ("k_e", "j_1")}, seen)
    posterior = of.job.problem.posterior
    start = posterior.space.start
    few = {"friction_rotor_1", "voltage_drop"}  # all take a minute
    rungs = [r for r in CandidateModels.from_job(of.job, {}).singles() if r.names[0] in few]
    with WorkerPool(posterior, 1) as pool:
        ranking_ = ranking.Ranking(of.job, start, pool.submit_function, SILENT)
        ranking_.refit_all(rungs, start)
    causes = Causes(given=ranking_.base.residuals, ranked=ranking_.ranked())
    yield repr(causes)
    yield describe_causes(causes)
    yield lacking(causes, of.job.problem.model.roles)


def analyses_of_torque(of: bd.Case) -> Iterator[Any]:
    """What a missing torque was, what it follows, and what it can stand in for."""
    posterior = of.job.problem.posterior
    theta = posterior.space.vector(posterior.space.start)
    (torque,) = torque_estimates(posterior, theta[None], np.random.default_rng(1))
    yield [torque.expected, torque.angle, torque.inertia.reduction, repr(regress_torque(torque))]
    yield law_sentences(torque_summary(torque), torque.rig)
    yield [(each.label.latex, each.means) for each in regressors(torque)]


def analyses(rig: Model, names: dict[str, str]) -> dict[str, list[Any]]:
    wild = {name: NOMINAL[name] for name in ("k_e", "k_T", "j_1", "k_s")}
    rubbing = {**TRUTH, "k_e": 0.06, "k_T": 0.06, "t_f": 0.02}
    degrees = np.rad2deg(ANGLE), np.rad2deg(ANGLE), 1.1 * V, 6.6 * V  # said to be radians
    return {
        "record": [*analyses_of_record(case(rig, names, wild, degrees))],
        "friction": [*analyses_of_friction(case(rig, names, rubbing))],
        "causes": [*analyses_of_causes(rig, names)],
        "torque": [*analyses_of_torque(case(rig, names, wild, missing_torque=TORQUE))],
    }


def print_both_vocabularies() -> None:
    """In a process in which the toys are installed."""
    from toy_renamed import OWN

    usual = analyses(MODELS["motor_shaft"](), {name: name for name in OWN})
    renamed = analyses(MODELS["toy_renamed"](), OWN)
    names = {**OWN, "motor_shaft": "toy_renamed", "i_m": "gear_down"}
    print(json.dumps([names, usual, renamed], default=lambda array: np.asarray(array).tolist()))


def printed() -> Any:
    """Return what that function prints."""
    path = os.pathsep.join(map(str, (ROOT, TOYS, TOYS.parent, TOYS.parent / "contracts")))
    command = [sys.executable, "-c", "from test_roles import *; print_both_vocabularies()"]
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_rig_in_other_words_has_every_analysis() -> None:
    names, usual, renamed = printed()
    back = {word: name for name, word in names.items()}
    longest = sorted(back, key=len, reverse=True)
    begins = r"(?:(?<=\\n)|(?<![A-Za-z0-9]))"  # a line, as JSON has it, or a word
    words_of = re.compile(rf"{begins}({'|'.join(longest)})(?![A-Za-z0-9])")
    renamed = json.loads(words_of.sub(lambda match: back[match[1]], json.dumps(renamed)))
    for kind, results in usual.items():
        assert all(results), kind
        for expected, result in zip(results, renamed[kind], strict=True):
            assert unpadded(expected) == unpadded(result)
    text = json.dumps(usual)
    for part in (
        *("energy: k_T = ", "the motor turns 8 times", "Causes(given=", "friction: ", "unit: "),
        *("dry friction at rotor 1 (t_c1)", "geared measures 6 * w_2", "t_f, which keeps"),
        *("tie k_T = k_e", "missing torque: it follows"),
    ):
        assert part in text
    rungs = {name for rung in usual["record"][-1] for name in rung[0]}
    assert {"friction_both", "missing_torque_motor"} <= rungs


def unpadded(value: Any) -> Any:
    """Columns are as wide as names."""
    return json.loads(re.sub(r"(?:(?<= ) +)", "", json.dumps(value)))


# Modules in which a name is one of an input, or stands in for what a config lacks.
EXCEPTIONS = ("record/experiment.py", "config/building/inputs.py", "config/schema/records.py")
EXCEPTIONS += ("analysis/identifiability/study.py", "config/loading.py")
EXCEPTIONS += ("rig/models/", "basics/symbols.py", "drafting/")


def test_no_module_outside_rigs_knows_a_symbol_by_its_spelling() -> None:
    known = {*symbols.PARAMETERS, *symbols.STATES, "i_m", "friction_m", "friction_1"}
    asked = re.compile(r"(?:get|has)attr\((?:model|rig|[a-z_.]+\.model|[a-z_.]+\.rig), [\"'](\w+)")
    for path in sorted((ROOT / "bayesdrill").rglob("*.py")):
        text = path.read_text()
        assert not asked.findall(text), path
        if not path.relative_to(ROOT / "bayesdrill").as_posix().startswith(EXCEPTIONS):
            constants = {n.value for n in nodes(path) if isinstance(n, ast.Constant)}
            assert constants & known == set(), path


def test_what_rigs_may_lack_has_symbols() -> None:
    usual = usual_roles()
    names = {lack.parameter for lack in edits.lacks(usual)} | {*rivals(usual)} | usual.states
    assert names <= {*symbols.PARAMETERS, *symbols.STATES}


def test_a_state_of_no_role_is_named() -> None:
    class WithoutRole(MotorShaft):
        @property
        def roles(self) -> Roles:
            motor, gearbox, rotor, _ = usual_roles().inertias
            bit = dataclasses.replace(rotor, speed="of_the_bit")
            return dataclasses.replace(usual_roles(), inertias=(motor, gearbox, bit))

    problem: Any = SimpleNamespace(model=WithoutRole())
    (message,) = finding_sentences(plausibility.of_roles(problem))
    assert "motor_shaft gives no role to w_1" in message
    for rig in MODELS.usable().values():
        assert [*plausibility.of_roles(SimpleNamespace(model=rig()))] == []  # type: ignore[arg-type]
