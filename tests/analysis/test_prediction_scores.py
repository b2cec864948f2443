"""Predictive scores beside those of normal densities, and refusals where they would tell nothing."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.analysis.prediction import LooScore, has_memory, held_out, leave_one_out
from bayesdrill.inference import residual_checks

T = np.linspace(0.0, 4.0, 81)
SIGMA, OFFSET_SD = 0.05, 0.2
RIG = bd.MotorShaft(i_m=0.125)
AWAY = (T >= 2.0) & (T <= 2.5)


def signal() -> np.ndarray:
    return bd.respond(RIG, NOMINAL, T, {"v": 8.0}, ["w_1"])["w_1"]


def measured() -> np.ndarray:
    return signal() + 0.02 + SIGMA * np.random.default_rng(4).standard_normal(len(T))


def case(*, noise: object = None, away: bool = False, **entries: object) -> bd.Case:
    """An offset of a sensor is all that is unknown: posterior and predictions are normal."""
    offset = {"prior": "normal", "mean": 0.0, "sd": OFFSET_SD}
    channel = bd.Channel(measured(), "rad/s", SIGMA, noise=noise, offset=offset)  # type: ignore[arg-type]
    return bd.case(
        T,
        channels={"w_1": channel},
        inputs={"v": 8.0},
        parameters=dict.fromkeys(NOMINAL, "nominal"),
        rig=RIG,
        **({"record": {"held_out": [2.0, 2.5]}} if away else {}),  # type: ignore[arg-type]
        **entries,  # type: ignore[arg-type]
    )


def draws(seen: np.ndarray, n: int = 4000) -> np.ndarray:
    """Of the exact posterior `(n, 1)` by some samples."""
    sd = (seen.sum() / SIGMA**2 + 1 / OFFSET_SD**2) ** -0.5
    mean = sd**2 * (measured() - signal())[seen].sum() / SIGMA**2
    return mean + sd * np.random.default_rng(3).standard_normal((n, 1))


def test_each_sample_without_itself() -> None:
    """Mutant killed: samples that help to predict themselves."""
    posterior = case().job.problem.posterior
    theta = draws(np.ones(len(T), dtype=bool))
    left = residual_checks.residual_summaries(posterior.likelihood, theta.mean(axis=0))
    found = leave_one_out(posterior, theta, left)
    assert isinstance(found, LooScore)
    each = []
    for k in range(len(T)):
        seen = np.arange(len(T)) != k
        sd = (seen.sum() / SIGMA**2 + 1 / OFFSET_SD**2) ** -0.5
        mean = sd**2 * (measured() - signal())[seen].sum() / SIGMA**2
        spread = np.hypot(sd, SIGMA)
        each.append(scipy.stats.norm.logpdf((measured() - signal())[k], mean, spread))
    assert np.abs(found.each - each).max() < 0.03
    assert found.elpd == pytest.approx(sum(each), abs=0.1)
    assert found.doubtful == 0.0
    # of which what samples say of themselves is more than ten times as much
    own = scipy.stats.norm.logpdf(measured() - signal(), theta.mean(), SIGMA).sum()
    assert own - found.elpd > 0.5


def test_where_samples_tell_of_each_other_it_is_refused() -> None:
    """Mutants killed: the noise looked at alone, or what is left alone."""
    posterior = case().job.problem.posterior
    theta = draws(np.ones(len(T), dtype=bool)) + 0.5
    left = residual_checks.residual_summaries(posterior.likelihood, theta.mean(axis=0))
    said = leave_one_out(posterior, theta, left)
    assert isinstance(said, str)
    assert "not white (correlation of neighbours" in said


def test_what_is_held_out_is_predicted_by_the_rest() -> None:
    """Mutant killed: samples that are held out and fitted all the same."""
    made = case(away=True)
    posterior = made.job.problem.posterior
    assert posterior.likelihood.n_measured == (~AWAY).sum()
    assert held_out(case().job.problem.posterior, draws(~AWAY)) is None
    found = held_out(posterior, draws(~AWAY))
    assert found is not None
    assert found.samples == AWAY.sum()
    sd = ((~AWAY).sum() / SIGMA**2 + 1 / OFFSET_SD**2) ** -0.5
    mean = sd**2 * (measured() - signal())[~AWAY].sum() / SIGMA**2
    rest = (measured() - signal())[AWAY]
    exact = scipy.stats.norm.logpdf(rest, mean, np.hypot(sd, SIGMA)).sum()
    assert found.score == pytest.approx(exact, abs=0.02)
    red = held_out(
        case(away=True, noise={"name": "ar1", "rho": 0.6}).job.problem.posterior, draws(~AWAY)
    )
    assert red is not None
    assert red.score < found.score
    run = made.sample(seed=2)  # and the chain is that of the rest, too
    assert run.draws[made.unknowns[0]].mean() == pytest.approx(mean, abs=0.2 * sd)


@run_cases("rho", [0.0, 0.6, None])
def test_a_noise_that_remembers_is_found_out(rho: float | None) -> None:
    """Mutant killed: what is no white noise by its kind."""
    white = case().job.problem.posterior
    assert not has_memory(white.likelihood.observations[0], np.zeros((1, 1)))
    own = {"name": "ar1"} if rho is None else {"name": "ar1", "rho": rho}
    red = case(noise=own).job.problem.posterior
    theta = red.space.draw(2, np.random.default_rng(1))
    assert has_memory(red.likelihood.observations[0], theta) == (rho != 0.0)


def test_a_missing_torque_predicts_what_is_held_out_and_remembers() -> None:
    """All but nothing of it is white noise; more of it allows for more."""
    scores = []
    for size in (1e-9, 0.05):
        torque = {"at": "motor", "size": size, "time": 0.5}
        posterior = case(away=True, missing_torque=torque).job.problem.posterior
        found = held_out(posterior, draws(~AWAY))
        assert found is not None
        scores.append(found.score)
        (one,) = posterior.likelihood.observations
        assert has_memory(one, draws(~AWAY)) == (size > 1e-3)
    white = held_out(case(away=True).job.problem.posterior, draws(~AWAY))
    assert white is not None
    assert scores[0] == pytest.approx(white.score, abs=1e-3)
    assert scores[1] < white.score - 1.0
