"""Warnings of nonsense, against numbers that can be worked out by hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import command_line, two_experiments
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, ORDER, by_expm, matrices
from support.small_problems import experiment, posterior

import bayesdrill as bd
from bayesdrill.analysis import plausibility
from bayesdrill.analysis.identifiability.information import Information, SensitivityStudy
from bayesdrill.basics import symbols
from bayesdrill.config.job import prepare
from bayesdrill.inference.posterior import Problem
from bayesdrill.rig.models.linear import Linear
from bayesdrill.rig.models.motor_shaft import MotorShaft

SMALL = command_line.ROOT.parent / "shared" / "cases" / "small"
BLIND = Information(ORDER, np.zeros((9, 9)))
SEEN = Information(ORDER, np.eye(9))


def problem(dt: float = 0.001, own: tuple[str, ...] = (), **changes: float) -> Problem:
    """`own`: nominal values that are not those of a table."""
    return Problem(
        posterior=posterior(experiment(11, dt), np.full(5, 0.1)),
        symbols=tuple(symbols.PARAMETERS[name] for name in ORDER),
        nominal={**NOMINAL, **changes},
        published=frozenset(NOMINAL) - {*own},
    )


def nominal(of: Problem) -> list[str]:
    return [finding.split(":")[0] for finding in plausibility.plausibility_of_nominal(of)]


def draws(n: int = 50, **changes: float) -> np.ndarray:
    return np.tile([{**NOMINAL, **changes}[name] for name in ORDER], (n, 1))


def test_poles_are_the_eigenvalues_of_the_rigs_matrix() -> None:
    found = plausibility.poles(MotorShaft(), {name: np.array([NOMINAL[name]]) for name in ORDER})[0]
    expected = np.linalg.eigvals(matrices(NOMINAL)[0])
    order = [np.lexsort((x.imag.round(6), x.real.round(6))) for x in (found, expected)]
    assert found[order[0]] == pytest.approx(expected[order[1]], abs=1e-6)


def test_a_motor_that_gives_more_than_it_takes_is_named() -> None:
    """Mutant killed: k_T below k_e is blamed instead."""
    found = problem()
    assert nominal(found) == ["energy"]
    assert nominal(problem(k_T=NOMINAL["k_e"])) == []
    assert nominal(problem(k_T=0.5 * NOMINAL["k_e"])) == []
    (told,) = plausibility.plausibility_of_draws(found, draws(), SEEN)
    assert "100 % of the draws (median ratio 1.99)" in told
    assert plausibility.plausibility_of_draws(found, draws(k_T=NOMINAL["k_e"]), SEEN) == ()


def test_a_ratio_that_the_record_cannot_show_is_not_blamed_on_the_rig() -> None:
    (told,) = plausibility.plausibility_of_draws(problem(), draws(), BLIND)
    assert "cannot show this ratio" in told


def test_geometry_is_that_of_the_paper_and_only_of_its_rig() -> None:
    """0.30 N m/rad of Table 1 is 14 % above what 2.4 m of 3 mm steel have."""
    assert nominal(problem(k_T=NOMINAL["k_e"], k_s=0.30)) == ["geometry"]
    assert nominal(problem(k_T=NOMINAL["k_e"], k_s=0.30, own=("k_s",))) == []
    stiffness, inertia = (plausibility.GEOMETRY[name][0] for name in ("shaft", "rotor_1"))
    assert stiffness == pytest.approx(0.263, abs=5e-4)
    assert inertia == pytest.approx(28.3e-3, abs=5e-5)


def test_a_pole_faster_than_the_samples_is_named() -> None:
    """Mutant killed: a step is compared with the time of the slowest motion."""
    ideal = NOMINAL["k_e"]
    values = {name: np.array([x]) for name, x in {**NOMINAL, "k_T": ideal}.items()}
    fastest = -plausibility.poles(MotorShaft(), values)[0].real.min()
    assert nominal(problem(0.9 / fastest, k_T=ideal)) == []
    step = 1.1 / fastest
    assert nominal(problem(step, k_T=ideal)) == ["sampling"]
    (told,) = plausibility.plausibility_of_draws(problem(step), draws(k_T=ideal), SEEN)
    assert "100 % of the draws" in told


def test_a_rig_that_runs_away_and_one_that_turns_too_fast_are_named() -> None:
    class Unstable(MotorShaft):
        def linear(self, p: Any) -> Linear:
            # An oscillation of 100 Hz that grows by 1 % a second.
            spin, n = 2 * np.pi * 100.0, np.ones_like(p["k_s"])
            two_experiments = {("theta_1", "w_1"): spin * n, ("w_1", "theta_1"): -spin * n}
            return Linear(
                A=two_experiments | {(x, x): 0.01 * n for x in ("theta_1", "w_1")}, B={}, c={}
            )

    found = plausibility.poles(Unstable(), {"k_s": np.ones(3)})
    every: Any = [SimpleNamespace(experiment=SimpleNamespace(dt=0.01))]
    problem: Any = SimpleNamespace(observations=every, model=Unstable())
    told = [*plausibility._poles(found, problem)]
    assert [finding.split(":")[0] for finding in told] == ["stability", "sampling"]
    assert "0.01 1/s" in told[0]
    assert "100 Hz" in told[1]


def of_course(v: np.ndarray, **changes: float) -> tuple[str, ...]:
    record = experiment(len(v), 0.01, constant={"t_1": 0.0}, series={"v": v})
    of = posterior(record, np.full(5, 0.1))
    told = plausibility.plausibility_of_course(
        SensitivityStudy(of.likelihood), draws(1, **changes)[0]
    )
    return tuple(told)


def test_friction_that_drives_is_named_with_its_share_of_the_record() -> None:
    """The share against SciPy's exponential.  Mutant killed: the sign of t_f is no matter."""
    ahead, reversed_ = np.full(800, 8.0), np.repeat([8.0, -8.0], 400)
    assert of_course(ahead) == ()
    assert of_course(reversed_, t_f=0.0) == ()
    x = by_expm(NOMINAL, 0.01 * np.arange(401), np.zeros(5), 8.0, 0.0)
    back = by_expm(NOMINAL, 0.01 * np.arange(401), x[-1], -8.0, 0.0)
    speed = np.concatenate([x[:400], back[:400]])[:, 3]
    share = 100 * np.mean(speed < -0.05 * np.abs(speed).max())
    assert 20 < share < 50
    (told,) = of_course(reversed_)
    assert told.startswith(
        f"friction: in {share:.3g} % of the record the motor turns the other way"
    )
    (always,) = of_course(-ahead)
    assert "turn the signs of v and of all channels" in always
    assert of_course(-ahead, t_f=-NOMINAL["t_f"]) == ()


def measured(measures: str, i_m: float = 0.125, **priors: object) -> Problem:
    """Of one channel, and of parameters that are held but for those with `priors`."""
    t, unit = np.linspace(0.0, 1.0, 21), "deg" if "theta" in measures else "rpm"
    case = bd.case(
        t,
        channels={"motor": bd.Channel(np.sin(t), unit, 1.0, measures=measures)},
        inputs={"v": 8.0},
        parameters={**dict.fromkeys(NOMINAL, "nominal"), "k_s": SPRING, **priors},
        rig=bd.MotorShaft(i_m=i_m),
        nominal="tables_2_3",
    )
    return case.job.problem


SPRING = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}


@run_cases(
    "measures, i_m, said",
    [
        ("8 * w_2", 0.125, False),
        ("-8 * w_2", 0.125, False),
        ("8.05 * theta_2", 0.125, False),
        ("w_2", 0.125, False),
        ("5 * w_1", 0.125, False),
        ("theta_1 - theta_2", 0.125, False),
        ("5 * w_2", 0.2, False),
        ("5 * w_2", 0.125, True),
        ("0.125 * theta_2", 0.125, True),
    ],
)
def test_a_channel_of_another_gear_than_the_model_is_named(
    measures: str, i_m: float, said: bool
) -> None:
    """Mutants killed: the factor taken for its inverse; a channel of rotor 1 blamed."""
    found = list(plausibility.plausibility_of_gear(measured(measures, i_m)))
    assert bool(found) is said
    if said:
        assert f"model.i_m: {i_m:g}" in found[0]
        assert found[0].startswith("motor measures ")


def test_a_nominal_value_that_a_prior_has_never_heard_of_is_named() -> None:
    far = {"prior": "normal", "mean": 10 * NOMINAL["j_1"], "sd": 0.2 * NOMINAL["j_1"]}
    near = {**far, "mean": 1.5 * NOMINAL["j_1"]}
    (told,) = plausibility.plausibility_of_priors(measured("w_2", j_1=far))
    assert told.startswith(
        "the nominal value 0.0283 of j_1 is far outside its prior, which goes from "
    )
    assert list(plausibility.plausibility_of_priors(measured("w_2", j_1=near))) == []


@run_cases("parameters, own", [("c_m: 0.1", "j_m"), ("c_m: PRIOR", "c_m")])
def test_a_parameter_that_is_another_one_in_each_experiment_needs_no_table(
    parameters: str, own: str, tmp_path: Path
) -> None:
    """Of a motor alone, of which no table knows.  Mutant killed: its plain name, which no number has."""
    prior = "{prior: log_uniform, low: 0.005, high: 0.3}"
    t = np.arange(60) * 0.02
    for label, size in (("a", 1.0), ("b", 2.0)):
        rows = np.stack([t, 0.01 * size * t, size * np.sin(t)], axis=-1)
        np.savetxt(tmp_path / f"{label}.csv", rows, delimiter=",", header="t,theta,u", comments="")
    (tmp_path / "own.yaml").write_text(
        "name: own\nseed: 1\nrecord: {time: {column: t, unit: s}, channels: "
        "{theta_2: {column: theta, unit: rad, sigma: 0.01}}}\n"
        "inputs: {t_m: {column: u, unit: N*m}}\n"
        "experiments: {a: {record: {file: a.csv}}, b: {record: {file: b.csv}}}\n"
        f"own: [{own}]\nmodel: {{name: motor}}\n"
        f"parameters: {{j_m: {prior}, {parameters.replace('PRIOR', prior)}}}\n"
    )
    ran = command_line.cli("check", tmp_path / "own.yaml")
    assert ran.status == 0, ran.text
    assert f"{own}_a" in ran.out
    assert f"{own}_b" in ran.out
    findings = plausibility.plausibility_of_nominal(prepare(tmp_path / "own.yaml").problem)
    assert len({*findings}) == len(findings)


def test_each_experiment_is_looked_at_with_its_own_numbers(tmp_path: Path) -> None:
    """A motor whose constants one experiment alone has the wrong way round."""
    entry = ("slow: {record", "slow: {parameters: {k_T: 2.0, k_e: 1.0}, record")
    held = ("k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}", "k_e: 3.0")
    found = plausibility.plausibility_of_nominal(
        prepare(two_experiments.write(tmp_path, entry, held)).problem
    )
    assert sum("2 times k_e" in finding for finding in found) == 1


@pytest.mark.skipif(not SMALL.is_dir(), reason="the records of others are not there")
@pytest.mark.parametrize("name", ["motor", "own", "own_free", "motor_nominal"])
def test_configs_of_others_with_parameters_of_each_experiment_are_checked(name: str) -> None:
    ran = command_line.cli("check", SMALL / "check_own_train" / f"{name}.yaml")
    assert ran.status == 0, ran.text
