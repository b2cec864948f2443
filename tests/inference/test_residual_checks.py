"""What a fit leaves: as much as noise, more, less, or correlated with itself and with inputs."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.case_tables import run_cases, slow_except
from support.missing_physics import ar1
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, noisy_step, posterior, replace_only

from bayesdrill.basics.units import SECOND
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.posterior import Likelihood
from bayesdrill.inference.residual_checks import (
    FALSE_ALARM,
    ResidualCorrelation,
    ResidualSummary,
    correlations,
    followed_inputs,
    residual_summaries,
)
from bayesdrill.report.doubts import residual_reasons, residual_sentences
from bayesdrill.report.findings import finding_sentences

Array = NDArray[np.float64]

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])  # unequal
FREE = ("k_s", "j_m")
AT = np.array([NOMINAL[name] for name in FREE])
N = 60


@cache
def likelihood(*, known: bool = True, n: int = N) -> Likelihood:
    """Return that of four channels, whose noise levels are known or not."""
    return posterior(noisy_step(SIGMA, n=n), SIGMA if known else None, free=FREE).likelihood


def summaries(
    residuals: Array, theta: Array = AT, of: Likelihood | None = None
) -> tuple[ResidualSummary, ...]:
    """Return what is said of a record that differs from the signals by `residuals (N, 4)`."""
    of = of or likelihood()
    y = of.signals(theta[None])[0] + residuals
    response = of.only_observation.response.with_record(y)
    return residual_summaries(replace_only(of, response=response), theta)


def white(seed: int) -> Array:
    return SIGMA * np.random.default_rng(seed).standard_normal((N, 4))


@pytest.mark.parametrize("records", slow_except((1000,), (1000, 2000)))
def test_records_of_the_model_give_a_finding_as_seldom_as_stated(records: int) -> None:
    """A record gives a finding in any channel with a probability of 1 % (0.7 % after a fit)."""
    every = [summaries(white(seed)) for seed in range(records)]
    wrong = [any(x.large or x.small or x.correlated or x.far for x in of) for of in every]
    assert 0.3 * FALSE_ALARM < np.mean(wrong) < 1.6 * FALSE_ALARM
    for kind in ("large", "correlated", "far"):
        assert any(getattr(channel, kind) for of in every for channel in of)


def test_sizes_and_correlations_are_those_of_the_channel() -> None:
    residuals, record = white(3), likelihood().only_observation.experiment
    result = summaries(residuals)
    signals = likelihood().signals(AT[None])[0]
    for k, channel in enumerate(result):
        own = residuals[:, k]
        assert channel.channel == record.names[k]
        assert channel.rms * SIGMA[k] == pytest.approx(np.sqrt(np.mean(own**2)))
        assert channel.farthest == pytest.approx(np.abs(own / SIGMA[k]).max())
        assert channel.time == record.t[np.abs(own).argmax()]
        assert channel.correlation == pytest.approx(own[1:] @ own[:-1] / (own @ own), abs=1e-9)
        share = np.sqrt(np.mean(own**2)) / (signals[:, k] + own).std()
        assert channel.share == pytest.approx(share, rel=1e-6)
    first, second = residual_sentences(result, SECOND).splitlines()
    assert first.startswith("fit: the MAP leaves unexplained ")
    assert f"{100 * result[1].share:.2g} % of {result[1].channel}" in first
    assert second.startswith("fit: the residuals look like the noise (rms ")


def test_a_channel_that_does_not_move_has_no_share() -> None:
    y = likelihood().only_observation.experiment.y.copy()
    y[:, 0] = 3.0
    result = summaries(y - likelihood().signals(AT[None])[0])
    assert np.isnan(result[0].share)
    assert "theta_1" not in residual_sentences(result, SECOND).splitlines()[0]


def test_a_differenced_column_and_one_bad_sample_are_noticed() -> None:
    residuals = white(7)
    steps = np.random.default_rng(1).standard_normal(N + 2)
    residuals[:, 1] = SIGMA[1] * np.diff(steps, 2) / np.sqrt(6)
    residuals[20, 0] = -5.5 * SIGMA[0]
    result = summaries(residuals)
    assert [channel.correlated for channel in result] == [False, True, False, False]
    assert result[1].correlation == pytest.approx(-2 / 3, abs=0.15)
    assert [channel.far for channel in result] == [True, False, False, False]
    time = likelihood().only_observation.experiment.t[20]
    assert f"theta_1 5.5 at {time:.4g} s" in residual_sentences(result, SECOND)


@run_cases(
    "rms, kind, believed", [(0.3, "smaller", True), (1.4, "larger", True), (1.6, "larger", False)]
)
def test_residuals_of_a_wrong_sigma_are_named_and_far_too_large_ones_not_believed(
    rms: float, kind: str, believed: bool
) -> None:
    """A fit that leaves less is believed: its standard deviations are too large."""
    residuals = white(5)
    residuals[:, 2] *= rms * SIGMA[2] / np.sqrt(np.mean(residuals[:, 2] ** 2))
    result = summaries(residuals)
    assert [channel.large for channel in result] == [False, False, rms > 1, False]
    assert [channel.small for channel in result] == [False, False, rms < 1, False]
    assert [channel.unbelievable for channel in result] == [False, False, not believed, False]
    assert f"are {kind} than the noise" in residual_sentences(result, SECOND)
    reason = "the residuals are larger than the noise: w_1 1.6 times sigma"
    assert residual_reasons(result) == (() if believed else (reason,))


@run_cases("weights, believed", [((1.0, 1.0), True), ((1.0,) * 5, False), ((1.0, -2.0, 1.0), True)])
def test_a_fit_that_leaves_strongly_correlated_residuals_is_not_believed(
    weights: tuple[float, ...], believed: bool
) -> None:
    """Averages of two and of five samples: correlations of 1/2 and of 4/5; a differenced column."""
    rng, residuals = np.random.default_rng(6), white(5)
    steps = np.convolve(rng.standard_normal(N + len(weights) - 1), weights, mode="valid")
    residuals[:, 1] = SIGMA[1] * steps / steps.std()
    result = summaries(residuals)
    assert result[1].correlated
    assert not any(channel.large for channel in result)
    reasons = residual_reasons(result)
    assert bool(reasons) != believed
    if not believed:
        assert "are correlated" in reasons[0]
        assert f"to the next: theta_2 {result[1].correlation:.3g}" in reasons[0]


def test_predictions_one_step_ahead_stand_beside_the_simulation() -> None:
    """AR(1) noise with rho 0.8 leaves 0.6 of itself one step ahead; of white noise nothing is said."""
    plain = likelihood(n=400)
    record = plain.only_observation.experiment
    assert "one step ahead" not in residual_sentences(residual_summaries(plain, AT), SECOND)
    channels = [
        NoisyChannel(channel=c, sigma=float(s), start=1.0, entries={"rho": 0.8})
        for c, s in zip(record.channels, SIGMA, strict=True)
    ]
    noise = NOISES["ar1"].from_channels(channels, 400)
    rng = np.random.default_rng(2)
    residuals = noise.draw(np.zeros((1, 400, 4)), np.empty((1, 0)), rng)[0]
    result = summaries(residuals, AT, replace_only(plain, noise=noise))
    spread = plain.signals(AT[None])[0].std(axis=0)
    for k, channel in enumerate(result):
        assert channel.simulated == channel.share
        innovations = residuals[1:, k] - 0.8 * residuals[:-1, k]
        assert channel.ahead == pytest.approx(innovations.std() / spread[k], rel=0.05)
        assert channel.ahead == pytest.approx(0.6 * channel.simulated, rel=0.2)
    text = residual_sentences(result, SECOND).splitlines()[1]
    assert text.startswith("fit: explained by the simulation alone, and by predictions one step")
    simulated, ahead = (100 * (1 - x) for x in (result[-1].simulated, result[-1].ahead))
    assert text.endswith(f"w_2 {simulated:.4g} % and {ahead:.4g} %.")


# --- correlations at several lags, with residuals and with an input -----------------------------------

LONG, DT = 600, 0.01
TWO_SIGMAS = np.array([0.02, 0.1])


VOLTAGE = 6.0 + 2.0 * ar1(0.9, (LONG,), 99)


@cache
def driven() -> Likelihood:
    measures = {"theta_1": {"theta_1": 1.0}, "w_2": {"w_2": 1.0}}
    record = experiment(LONG, DT, series={"v": VOLTAGE}, constant={"t_1": 0.0}, measures=measures)
    return posterior(record, TWO_SIGMAS, free=FREE).likelihood


def correlations_of(residuals: Array) -> dict[tuple[str, str], ResidualCorrelation]:
    """Return those of residuals `(600, 2)`, NaN where nothing was measured, by channel and input."""
    observation = driven().only_observation
    y = driven().signals(AT[None])[0] + residuals
    record = dataclasses.replace(observation.experiment, y=y)
    changed = replace_only(
        driven(),
        response=observation.response.of(record),
        noise=observation.noise.with_counts(record.counts),
    )
    return {(one.channel.name, one.input): one for one in correlations(changed, AT)}


def test_correlations_are_those_of_pairs_of_samples_that_are_there() -> None:
    """Those with an input are of what one sample does not say of the next."""
    residuals = TWO_SIGMAS * ar1(0.7, (LONG, 2), 1)
    residuals[100:160, 0] = residuals[300, 1] = np.nan
    result = correlations_of(residuals)
    e, own = residuals[:, 0] / TWO_SIGMAS[0], result["theta_1", ""]

    def mean(a: Array, b: Array) -> float:
        return float(np.nanmean(a * b))

    for lag in (1, 2, 7, 25):
        assert own.lags[lag - 1] == lag
        expected = mean(e[lag:], e[:-lag]) / mean(e, e)
        assert own.values[lag - 1] == pytest.approx(expected, rel=1e-9)
    with_v, rho = result["theta_1", "v"], own.values[0]
    u = np.where(np.isnan(e), np.nan, VOLTAGE - VOLTAGE[~np.isnan(e)].mean())
    e, u = e[1:] - rho * e[:-1], u[1:] - rho * u[:-1]
    size = np.sqrt(mean(e, e) * mean(u, u))
    for lag in (0, 1, 5, 25):
        late, early = mean(e[lag:], u[: len(u) - lag]), mean(e[: len(e) - lag], u[lag:])
        assert with_v.values[with_v.lags == lag] == pytest.approx(late / size, rel=1e-9)
        assert with_v.values[with_v.lags == -lag] == pytest.approx(early / size, rel=1e-9)
    assert with_v.step == pytest.approx(DT)


@run_cases("rho", [0.0, 0.8])
def test_bands_hold_residuals_that_know_nothing_of_the_input(rho: float) -> None:
    """Over 100 records one value in a hundred is outside, and hardly a record follows the input."""
    outside, white_outside, followed = [], [], 0
    for seed in range(100):
        result = correlations_of(TWO_SIGMAS * ar1(rho, (LONG, 2), seed))
        with_input = [one for (_, name), one in result.items() if name]
        outside += [np.abs(one.values) > one.band for one in with_input]
        white_outside.append(np.abs(result["w_2", ""].values) > result["w_2", ""].band)
        followed += bool(followed_inputs(with_input))
    assert 0.003 < np.mean(outside) < 0.02
    assert followed <= 5  # 1 on average
    assert rho > 0 or 0.005 < np.mean(white_outside) < 0.02


@run_cases("lag, channel, size", [(4, 1, 0.04), (-3, 0, 0.008)])
def test_residuals_that_follow_an_input_are_named_with_the_lag(
    lag: int, channel: int, size: float
) -> None:
    """Also deep in correlated residuals, and where the input comes after them."""
    residuals = TWO_SIGMAS * ar1(0.9, (LONG, 2), 3)
    residuals[:, channel] += size * np.roll(VOLTAGE - 6.0, lag)
    (text,) = finding_sentences(followed_inputs(list(correlations_of(residuals).values())))
    name = ("theta_1", "w_2")[channel]
    assert text.startswith(f"the residuals of {name} follow the input v, {lag:+} samples (")
    assert text.endswith(": the input reacts to the rig, or times are off") == (lag < 0)
