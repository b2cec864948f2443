"""Warnings of implausible values and priors, against numbers that can be worked out by hand."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, ORDER, by_expm
from support.small_problems import experiment, posterior, starts_believed

import bayesdrill as bd
from bayesdrill.analysis import plausibility
from bayesdrill.analysis.identifiability.information import Information, SensitivityStudy
from bayesdrill.analysis.plausibility import DiffusePrior, diffuse_priors
from bayesdrill.basics import symbols
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import (
    HalfNormal,
    LogNormal,
    LogUniform,
    Prior,
    TruncatedNormal,
    Uniform,
)
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.sections.comparison import evidence_sentences
from bayesdrill.rig.models.linear import Linear
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.sampling.evidence import Evidence

BLIND, SEEN = Information(ORDER, np.zeros((9, 9))), Information(ORDER, np.eye(9))
IDEAL = NOMINAL["k_e"]  # of k_T


def problem(dt: float = 0.001, own: tuple[str, ...] = (), **changes: float) -> Problem:
    """Return one with other nominal values; those of `own` are from no table."""
    return Problem(
        posterior=posterior(experiment(11, dt), np.full(5, 0.1)),
        symbols=tuple(symbols.PARAMETERS[name] for name in ORDER),
        nominal={**NOMINAL, **changes},
        published=frozenset(NOMINAL) - {*own},
    )


def kinds(of: Problem) -> list[str]:
    found = finding_sentences(plausibility.plausibility_of_nominal(of))
    return [text.split(":")[0] for text in found]


def draws(n: int = 50, **changes: float) -> np.ndarray:
    return np.tile([{**NOMINAL, **changes}[name] for name in ORDER], (n, 1))


def test_a_motor_that_gives_more_than_it_takes_is_named() -> None:
    """But not blamed where the record cannot show the ratio of its constants, nor for mere starts."""
    assert kinds(problem()) == ["energy"]
    known = {name: value for name, value in NOMINAL.items() if name not in ("k_T", "k_e")}
    assert kinds(dataclasses.replace(problem(), nominal=known, published=frozenset())) == []
    assert kinds(problem(k_T=IDEAL)) == kinds(problem(k_T=0.5 * IDEAL)) == []
    (text,) = finding_sentences(plausibility.plausibility_of_draws(problem(), draws(), SEEN))
    assert "100 % of the draws (median ratio 1.99)" in text
    assert plausibility.plausibility_of_draws(problem(), draws(k_T=IDEAL), SEEN) == ()
    (text,) = finding_sentences(plausibility.plausibility_of_draws(problem(), draws(), BLIND))
    assert "cannot show this ratio" in text


def test_the_geometry_of_the_paper_is_held_against_values_of_its_table_alone() -> None:
    """0.30 N m/rad of Table 1 is 14 % above what 2.4 m of 3 mm steel have."""
    assert kinds(problem(k_T=IDEAL, k_s=0.30)) == ["geometry"]
    assert kinds(problem(k_T=IDEAL, k_s=0.30, own=("k_s",))) == []
    stiffness, inertia = (plausibility.GEOMETRY[name][0] for name in ("shaft", "rotor_1"))
    assert stiffness == pytest.approx(0.263, abs=5e-4)
    assert inertia == pytest.approx(28.3e-3, abs=5e-5)


def test_a_pole_that_is_faster_than_the_samples_is_named() -> None:
    values = {name: np.array([x]) for name, x in {**NOMINAL, "k_T": IDEAL}.items()}
    fastest = -plausibility.poles(MotorShaft(), values)[0].real.min()
    assert kinds(problem(0.9 / fastest, k_T=IDEAL)) == []
    assert kinds(problem(1.1 / fastest, k_T=IDEAL)) == ["sampling"]
    slow = problem(1.1 / fastest)
    (text,) = finding_sentences(plausibility.plausibility_of_draws(slow, draws(k_T=IDEAL), SEEN))
    assert "100 % of the draws" in text


def test_an_oscillation_that_grows_and_is_faster_than_the_samples_is_named() -> None:
    class Unstable(MotorShaft):
        def linear(self, p: Any) -> Linear:
            spin, n = 2 * np.pi * 100.0, np.ones_like(p["k_s"])
            swing = {("theta_1", "w_1"): spin * n, ("w_1", "theta_1"): -spin * n}
            growth = {(state, state): 0.01 * n for state in ("theta_1", "w_1")}
            return Linear(A=swing | growth, B={}, c={})

    poles = plausibility.poles(Unstable(), {"k_s": np.ones(3)})
    observations: Any = [SimpleNamespace(experiment=SimpleNamespace(dt=0.01))]
    unstable: Any = SimpleNamespace(observations=observations, model=Unstable())
    stability, sampling = finding_sentences(plausibility._poles(poles, unstable))
    assert stability.startswith("stability: ")
    assert "0.01 1/s" in stability
    assert sampling.startswith("sampling: ")
    assert "100 Hz" in sampling


def of_course(v: np.ndarray, **changes: float) -> tuple[str, ...]:
    record = experiment(len(v), 0.01, constant={"t_1": 0.0}, series={"v": v})
    sensitivity = SensitivityStudy(posterior(record, np.full(5, 0.1)).likelihood)
    found = plausibility.plausibility_of_course(sensitivity, draws(1, **changes)[0])
    return finding_sentences(found)


def test_friction_that_drives_the_motor_is_named_with_its_share_of_the_record() -> None:
    """The share is that of SciPy's exponential."""
    ahead, reverses = np.full(800, 8.0), np.repeat([8.0, -8.0], 400)
    assert of_course(ahead) == of_course(reverses, t_f=0.0) == ()
    x = by_expm(NOMINAL, 0.01 * np.arange(401), np.zeros(5), 8.0, 0.0)
    back = by_expm(NOMINAL, 0.01 * np.arange(401), x[-1], -8.0, 0.0)
    speed = np.concatenate([x[:400], back[:400]])[:, 3]
    share = 100 * np.mean(speed < -0.05 * np.abs(speed).max())
    assert 20 < share < 50
    (text,) = of_course(reverses)
    expected = f"friction: in {share:.3g} % of the record the motor turns the other way"
    assert text.startswith(expected)
    (text,) = of_course(-ahead)
    assert "turn the signs of v and of all channels" in text
    assert of_course(-ahead, t_f=-NOMINAL["t_f"]) == ()


@starts_believed()
def problem_measuring(measures: str, i_m: float = 0.125, **priors: object) -> Problem:
    """Return one of one channel, of a rig whose parameters are held but for those with `priors`."""
    t, unit = np.linspace(0.0, 1.0, 21), "deg" if "theta" in measures else "rpm"
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    case = bd.case(
        t,
        channels={"motor": bd.Channel(np.sin(t), unit, 1.0, measures=measures)},
        inputs={"v": 8.0},
        parameters={**dict.fromkeys(NOMINAL, "nominal"), "k_s": box, **priors},
        rig=bd.MotorShaft(i_m=i_m),
        nominal="tables_2_3",
    )
    return case.job.problem


@run_cases(
    "measures, i_m, named",
    [
        *((x, 0.125, False) for x in ("8 * w_2", "-8 * w_2", "8.05 * theta_2", "w_2", "5 * w_1")),
        ("theta_1 - theta_2", 0.125, False),
        ("5 * w_2", 0.2, False),
        ("5 * w_2", 0.125, True),
        ("0.125 * theta_2", 0.125, True),
    ],
)
def test_a_channel_with_another_gear_than_the_model_is_named(
    measures: str, i_m: float, named: bool
) -> None:
    found = plausibility.plausibility_of_gear(problem_measuring(measures, i_m))
    texts = finding_sentences(found)
    assert len(texts) == named
    for text in texts:
        assert text.startswith("motor measures ")
        assert f"model.i_m: {i_m:g}" in text


def test_a_nominal_value_far_outside_its_prior_is_named() -> None:
    prior = {"prior": "normal", "mean": 10 * NOMINAL["j_1"], "sd": 0.2 * NOMINAL["j_1"]}
    found = plausibility.plausibility_of_priors(problem_measuring("w_2", j_1=prior))
    (text,) = finding_sentences(found)
    assert text.startswith("the nominal value 0.0283 of j_1 is far outside its prior, of which")
    near = problem_measuring("w_2", j_1={**prior, "mean": 1.5 * NOMINAL["j_1"]})
    assert list(plausibility.plausibility_of_priors(near)) == []


SHARP = 0.05 * (1.0 + 0.01 * np.random.default_rng(6).standard_normal(4000))
UNMOVED = LogUniform(1e-3, 1e1).quantile(np.random.default_rng(7).random(4000))


@run_cases(
    "prior, x, wide",
    [
        (LogUniform(0.01, 1.0), SHARP, False),
        (LogUniform(1e-3, 1e1), SHARP, True),
        (LogUniform(1e-3, 1e1), UNMOVED, False),  # the record leaves it alone
        (LogNormal(0.05, 3.0), SHARP, True),
        (Uniform(0.02, 0.1), SHARP, False),
        (Uniform(0.0, 1.0), SHARP, False),
        (Uniform(0.0, 100.0), SHARP, True),
        (HalfNormal(0.1), SHARP, False),
        (HalfNormal(30.0), SHARP, True),
        (TruncatedNormal(0.0, 1.0, low=-np.inf), SHARP, False),
        (TruncatedNormal(0.0, 30.0, low=-np.inf), SHARP, True),
    ],
)
def test_a_prior_far_wider_than_the_posterior_is_diffuse(
    prior: Prior, x: np.ndarray, wide: bool
) -> None:
    names = [one.name for one in diffuse_priors(x[:, None], {"x": prior})]
    assert names == ["x"] * wide


GOOD = Evidence(log_z=3535.61044, error=0.0046, overlap=0.6)
ROUGH = Evidence(log_z=3535.61044, error=0.3, overlap=0.01)


def test_an_evidence_has_the_digits_that_are_known_and_what_makes_it_doubtful() -> None:
    assert evidence_sentences(GOOD, (), converged=True) == "log evidence: 3535.610 +- 0.005"
    wide = (DiffusePrior(name="c_s", decades=4.0),)
    text = evidence_sentences(ROUGH, wide, converged=True)
    assert "3535.6 +- 0.3" in text
    assert "ROUGH" in text
    assert "the prior of c_s is 4.0 decades wide" in text
    assert "ROUGH" in evidence_sentences(GOOD, (), converged=False)
    stepped = dataclasses.replace(ROUGH, steps=-0.41, steps_error=0.29)
    text = evidence_sentences(stepped, (), converged=True)
    assert "of which -0.41 +- 0.3 for the error of its steps" in text
    assert "ROUGH: the time steps of the rig are too long" in text
