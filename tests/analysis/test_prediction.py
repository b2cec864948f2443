"""Predictions of samples without themselves, of samples held out, and of channels by frequency."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import norm
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, matrices
from support.small_problems import experiment, posterior, posterior_of, starts_believed

import bayesdrill as bd
from bayesdrill.analysis.prediction import (
    MAX_RELATIVE_SD,
    FrequencyResponse,
    frequency_responses,
    has_memory,
    held_out,
    leave_one_out,
    leave_one_out_check,
    prediction_checks,
)
from bayesdrill.inference import residual_checks
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.report.findings import finding_sentence
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

Array = NDArray[np.float64]

# An offset of the sensor is all that is unknown: posterior and predictions are normal.
N, SIGMA, OFFSET_SD = 81, 0.05, 0.2
ALL, AWAY = np.ones(N, dtype=bool), np.isin(np.arange(N), np.arange(40, 51))


def times(n: int) -> Array:
    return 0.05 * np.arange(n)


@cache
def signal(n: int = N) -> Array:
    return bd.respond(bd.MotorShaft(i_m=0.125), NOMINAL, times(n), {"v": 8.0}, ["w_1"])["w_1"]


def residuals(n: int = N) -> Array:
    """Return those of the signal without offset; the true one is 0.02."""
    return 0.02 + SIGMA * np.random.default_rng(4).standard_normal(n)


def case(
    *, n: int = N, sigma: float = SIGMA, noise: object = None, away: bool = False, **entries: object
) -> Posterior:
    """Return the posterior of `n` samples; with `away` some are held out."""
    offset = {"prior": "normal", "mean": 0.0, "sd": OFFSET_SD}
    y = signal(n) + residuals(n)
    channel = bd.Channel(y, "rad/s", sigma, noise=noise, offset=offset)
    window = {"record": {"held_out": [2.0, 2.5]}} if away else {}
    made = bd.case(
        times(n),
        channels={"w_1": channel},
        inputs={"v": 8.0},
        parameters=dict.fromkeys(NOMINAL, "nominal"),
        rig=bd.MotorShaft(i_m=0.125),
        **window,
        **entries,
    )
    return made.job.problem.posterior


def offset_given(seen: NDArray[np.bool_], sigma: float = SIGMA) -> tuple[float, float]:
    """Return mean and sd of the offset given some samples."""
    sd = (seen.sum() / sigma**2 + 1 / OFFSET_SD**2) ** -0.5
    return sd**2 * residuals(len(seen))[seen].sum() / sigma**2, sd


def draws(seen: NDArray[np.bool_], n: int = 4000, sigma: float = SIGMA) -> Array:
    """Return exact draws of the offset `(n, 1)` given some samples."""
    mean, sd = offset_given(seen, sigma)
    return mean + sd * np.random.default_rng(3).standard_normal((n, 1))


def predictions_without_itself(n: int) -> tuple[Array, Array]:
    """Return the mean and the sd of the residual of each sample, given all others."""
    others = [offset_given(np.arange(n) != k) for k in range(n)]
    mean, sd = np.array(others).T
    return mean, np.hypot(sd, SIGMA)


def test_the_score_of_a_sample_is_its_density_given_all_others() -> None:
    target, theta = case(), draws(ALL)
    left = residual_checks.residual_summaries(target.likelihood, theta.mean(axis=0))
    score = leave_one_out(target, theta, left)
    exact = norm.logpdf(residuals(), *predictions_without_itself(N))
    assert np.abs(score.terms - exact).max() < 0.03
    assert score.elpd == pytest.approx(exact.sum(), abs=0.1)
    assert score.unreliable == 0.0
    assert norm.logpdf(residuals(), theta.mean(), SIGMA).sum() - score.elpd > 0.5


def test_samples_are_not_left_out_one_by_one_where_residuals_are_correlated() -> None:
    target, theta = case(), draws(ALL) + 0.5
    left = residual_checks.residual_summaries(target.likelihood, theta.mean(axis=0))
    refusal = leave_one_out(target, theta, left)
    assert "not white (correlation of neighbours" in finding_sentence(refusal)


def test_held_out_samples_are_predicted_by_the_rest() -> None:
    target, theta = case(away=True), draws(~AWAY)
    assert target.likelihood.n_measured == (~AWAY).sum()
    assert held_out(case(), theta) is None
    score = held_out(target, theta)
    assert score.samples == AWAY.sum()
    mean, sd = offset_given(~AWAY)
    density = target.density(np.array([[mean], [mean + sd]]))
    assert density[0] - density[1] == pytest.approx(0.5)
    exact = norm.logpdf(residuals()[AWAY], mean, np.hypot(sd, SIGMA)).sum()
    assert score.score == pytest.approx(exact, abs=0.02)
    red = held_out(case(away=True, noise={"name": "ar1", "rho": 0.6}), theta)
    assert red.score < score.score


@starts_believed()
@run_cases("noise, memory", [(None, False), (0.0, False), (0.6, True), ("unknown", True)])
def test_a_noise_has_memory_if_its_samples_are_correlated(noise: object, memory: bool) -> None:
    rho = {"rho": noise} if isinstance(noise, float) else {}
    target = case(noise=None if noise is None else {"name": "ar1", **rho})
    theta = target.space.draw(2, np.random.default_rng(1))
    assert has_memory(target.likelihood.only_observation, theta) == memory


def test_each_sample_is_predicted_without_itself() -> None:
    target, y = case(n=8), residuals(8)
    theta = draws(ALL[:8], 40_000)
    mean, sd = predictions_without_itself(8)
    exact = ndtr((y - mean) / sd)
    result = leave_one_out_check(target.likelihood, target.likelihood.only_observation, theta)
    assert result[:, 0] == pytest.approx(exact, abs=0.01)
    assert np.abs(ndtr((y - theta) / SIGMA).mean(axis=0) - exact).max() > 0.025
    alike = leave_one_out_check(
        target.likelihood, target.likelihood.only_observation, np.full((30, 1), 0.02)
    )
    assert alike[:, 0] == pytest.approx(ndtr((y - 0.02) / SIGMA))


@run_cases(
    "factor, moved, words",
    [
        (1.0, 0.0, ""),
        (0.7, 0.0, "prediction too narrow"),
        (1.4, 0.0, "prediction too wide"),
        (1.0, 0.02, "measured lies above"),
        (1.0, -0.02, "measured lies below"),
    ],
)
def test_a_wrong_prediction_leaves_the_band_and_is_named(
    factor: float, moved: float, words: str
) -> None:
    """The noise is believed to be `factor` times what it is."""
    sigma, seen = factor * SIGMA, np.ones(1000, dtype=bool)
    target = case(n=1000, sigma=sigma).likelihood
    (result,) = prediction_checks(target, draws(seen, 400, sigma) - moved)
    assert result.is_consistent is (words == "")
    assert result.says == words


def test_a_long_record_is_thinned_from_end_to_end() -> None:
    (result,) = prediction_checks(case(n=5000).likelihood, draws(np.ones(5000, dtype=bool), 50))
    assert len(result.pit) == 2000
    assert result.is_consistent
    assert result.band.count_below(result.ranks)[-1] <= 2000


M, DT = 3600, 0.01  # in segments of 800: frequencies are multiples of 1/8 Hz
MEASURES = {"theta_1": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 1.0}}
SENSORS = {"gain": 1.3, "lag": 0.017, "supply": 0.8}
K_S = np.array([NOMINAL["k_s"]])


def with_sensors(
    series: dict[str, Array], sigma: Sequence[float] = (0.1, 0.1), **entries: Any
) -> Posterior:
    """Return one of an unknown k_s, with a gain, a lag and the gain of an input that are known."""
    sensing = ObservationModel(
        gains={"w_2": "gain"}, lags={"theta_1": "lag"}, input_gains={"v": "supply"}
    )
    n = len(series["v"])
    record = experiment(n, DT, series=series, constant={}, measures=MEASURES, **entries)
    rig = simulator(MotorShaft(), record, sensing)
    return posterior_of(rig, sigma, {"k_s": Uniform(0.1, 1.0)}, NOMINAL | SENSORS)


@run_cases("first_order", [False, True])
def test_the_response_of_the_model_is_that_of_simulated_sines(first_order: bool) -> None:
    """Of the second half of a record, without the motion of the shaft, which hardly dies away."""
    rng = np.random.default_rng(1)
    series = {"v": rng.standard_normal(M), "t_1": 0.1 * rng.standard_normal(M)}
    every = frequency_responses(with_sensors(series, first_order=first_order), K_S)
    responses = {(one.channel.name, one.input.name): one for one in every}
    assert [*responses] == [(channel, name) for channel in MEASURES for name in series]
    t = DT * np.arange(M)
    roots = np.linalg.eigvals(matrices(NOMINAL)[0])
    slow = roots[np.abs(roots.real) < 1]
    own = [part(np.exp(root * t)) for root in slow for part in (np.real, np.imag)]
    for name in series:
        for rate in (0.25, 2.0, 6.0):
            phase = 2 * np.pi * rate * t
            sines = {other: np.sin(phase) * (other == name) for other in series}
            target = with_sensors(sines, first_order=first_order)
            parts = np.stack([np.sin(phase), np.cos(phase), *own], axis=-1)
            signals = target.likelihood.signals(K_S[None])[0]
            sine, cosine = np.linalg.lstsq(parts[M // 2 :], signals[M // 2 :], rcond=None)[0][:2]
            for k, channel in enumerate(MEASURES):
                response = responses[channel, name]
                at = np.abs(response.frequencies - rate).argmin()
                assert response.frequencies[at] == pytest.approx(rate)
                expected = sine[k] + 1j * cosine[k]
                assert response.modelled[at] == pytest.approx(expected, rel=0.01)


def responses_of_record(k_s: float, seed: int) -> tuple[FrequencyResponse, ...]:
    """Return those of a model with `k_s`, of a nominal record under two correlated inputs."""
    rng, n, sigma = np.random.default_rng(seed), 6000, np.array([0.005, 0.5])
    v = 5.0 * rng.standard_normal(n)
    series = {"v": v, "t_1": 0.5 * rng.standard_normal(n) + 0.04 * v}
    y = with_sensors(series).likelihood.signals(K_S[None])[0]
    y = y + sigma * rng.standard_normal(y.shape)
    return frequency_responses(with_sensors(series, sigma, y=y), np.array([k_s]))


def deviation(response: FrequencyResponse, truth: FrequencyResponse) -> Array:
    """Return how far the measured response is from the true one, in its sds, where it is known."""
    seen = np.isfinite(response.measured)
    assert (response.error[seen] <= MAX_RELATIVE_SD).all()
    sd = response.error * np.abs(response.measured)
    return np.asarray(np.abs(response.measured - truth.modelled)[seen] / sd[seen])


def test_the_measured_response_is_that_of_the_rig_whatever_the_model_is() -> None:
    """Here of a shaft that is a tenth too stiff, under two inputs that are correlated."""
    truths = [responses_of_record(NOMINAL["k_s"], seed) for seed in range(6)]
    wrongs = [responses_of_record(1.1 * NOMINAL["k_s"], seed) for seed in range(6)]
    for k, name in enumerate([("theta_1", "v"), ("theta_1", "t_1"), ("w_2", "v")]):
        for models in (truths, wrongs):
            pairs = [(model[k], truth[k]) for model, truth in zip(models, truths, strict=True)]
            assert {(one.channel.name, one.input.name) for one, _ in pairs} == {name}
            away = np.concatenate([deviation(*pair) for pair in pairs])
            assert len(away) > 100
            assert 0.9 < np.sqrt(np.mean(away**2) / 2) < 1.3  # magnitude and phase
    assert deviation(wrongs[-1][0], wrongs[-1][0]).max() > 8


def test_without_an_input_that_varies_there_is_no_response() -> None:
    still = posterior(experiment(200, DT, measures=MEASURES), np.array([0.1, 0.1]), free=("k_s",))
    assert frequency_responses(still, K_S) == ()
