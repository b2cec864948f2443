"""What half a sample of the moment would move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, posterior_of, replace_only, vector

import bayesdrill as bd
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.suspicions import half_sample_shift
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.sampling.gauss_newton import gauss_newton
from bayesdrill.tasks.conclusions import SampledRun, concluded

FREE = ("j_m", "k_e", "k_s", "j_1")
TRUTH = vector(NOMINAL) * np.where(np.arange(9) == 8, 0.01, 1.0)
MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 1.0}}
SIGMA = np.array([0.02, 0.1])
DT, N = 0.01, 300


def voltage(n: int = N) -> np.ndarray:
    t = DT * np.arange(n)
    return 5.0 * np.sign(np.sin(5.0 * t + 0.4)) + 0.7


def seen() -> Experiment:
    """With noise."""
    clean = experiment(N, DT, series={"v": voltage()}, constant={"t_1": 0.0}, measures=MEASURES)
    y = Response(MotorShaft(), clean, ObservationModel()).signals(TRUTH[None])[0]
    return replace(clean, y=y + SIGMA * np.random.default_rng(8).standard_normal(y.shape))


def believed(record: Experiment) -> Posterior:
    """As if the inputs were in time."""
    priors = {name: Uniform(0.3 * NOMINAL[name], 3 * NOMINAL[name]) for name in FREE}
    values = dict(zip(MotorShaft.parameters, TRUTH.tolist(), strict=True))
    rig = simulator(MotorShaft(), record, ObservationModel())
    return posterior_of(rig, SIGMA, priors, values)


def best(posterior: Posterior) -> np.ndarray:
    surface = LogDensity(posterior, physical=True)
    start = posterior.space.vector(posterior.space.start)
    top = gauss_newton(surface, posterior.coordinates.from_physical(start[None]), 60)
    return posterior.coordinates.to_physical(top.u)[0]


@pytest.mark.slow
def test_half_a_sample_moves_what_a_late_step_moves() -> None:
    """Oracle: the fit of a record whose step was given half a sample late; mutant: the other way."""
    clean = experiment(N, DT, measures=MEASURES, constant={"v": 8.0, "t_1": 0.0})
    late = Response(MotorShaft(), clean, ObservationModel(delay="t_0"))
    on_time, half = (late.signals(np.append(TRUTH, shift)[None])[0] for shift in (0.0, 0.5 * DT))
    posterior = believed(replace(clean, y=on_time))
    theta = best(posterior)
    scenery = SensitivityStudy(posterior.likelihood)
    found = half_sample_shift(scenery, theta)
    assert found is not None
    assert found.matters
    moved = best(believed(replace(clean, y=half)))
    rows = scenery.with_nuisances(theta)
    sds = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    # To first order, in logs: half a sample is much of what such a step can be late by.
    actual = np.log(moved / theta) / sds
    for (name, shift), true in zip(found.shifts, actual, strict=True):
        assert shift == pytest.approx(true, rel=0.5, abs=0.3), name


@run_cases("own, seconds", [({}, 0.5 * DT), ({"v": 7 * DT}, 3.5 * DT)], ["of the record", "slower"])
def test_half_a_sample_is_one_of_the_input(own: dict[str, float], seconds: float) -> None:
    """Of channels one sample of four is left; mutant killed: half of one of theirs."""
    record = seen()
    fewer = np.where(np.arange(N)[:, None] % 4 == 0, record.y, np.nan)
    posterior = believed(replace(record, y=fewer, input_steps=own))
    found = half_sample_shift(SensitivityStudy(posterior.likelihood), best(posterior))
    assert found is not None
    assert found.seconds == pytest.approx(seconds)


def test_a_moment_that_is_unknown_is_no_matter_of_doubt() -> None:
    record = seen()
    posterior = believed(record)
    assert half_sample_shift(SensitivityStudy(posterior.likelihood), best(posterior)) is not None
    every = ObservationModel(lags={"alpha": "a", "w_2": "b"})
    rig = Response(MotorShaft(), record, every)
    one = replace(posterior.likelihood.only_observation, response=rig)
    space = replace(
        posterior.space,
        model=(*posterior.space.model, "a", "b"),
        fixed={**posterior.space.fixed, "a": 0.0, "b": 0.0},
    )
    likelihood = Likelihood((one,), space)
    assert half_sample_shift(SensitivityStudy(likelihood), best(posterior)) is None


def test_half_a_sample_is_told_only_where_the_fit_is_noise() -> None:
    """Mutant killed: that it would leave what looks like noise, said of a fit that is far from it."""
    t = np.linspace(0.0, 2.0, 81)
    exact = bd.respond("motor_shaft", NOMINAL, t, {"v": 8.0}, "w_1")["w_1"]
    noise = 0.05 * np.random.default_rng(6).standard_normal(len(t))
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    case = bd.case(
        t,
        channels={"w_1": bd.Channel(exact + noise, "rad/s", 0.05)},
        inputs={"v": 8.0},
        parameters=dict.fromkeys(NOMINAL, "nominal") | {"l_m": box},
        sampler={"ensembles": 4, "walkers": 16, "r_hat": 1.1, "n_tau": 5, "ess": 100},
    )
    run = case.sample(seed=3)
    assert [note for note in run._view.notes if "timing: if the inputs act half a sample" in note]
    posterior = run.job.problem.posterior
    response = posterior.likelihood.only_observation.response.with_record(
        (exact + 9.0 * noise)[:, None]
    )
    off = replace(posterior, likelihood=replace_only(posterior.likelihood, response=response))
    job = replace(run.job, problem=replace(run.job.problem, posterior=off))
    view = concluded(
        SampledRun(job, run.mode, run.sampled), alone=False
    )  # no causes are looked for
    assert not like_noise(view.analysis.fit)
    assert not [note for note in view.notes if "moment" in note]
