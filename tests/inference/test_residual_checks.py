"""What a fit leaves: as much as noise, more, less, or with a memory."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import noisy_step, posterior, replace_only

from bayesdrill.basics.units import SECOND
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.posterior import Likelihood
from bayesdrill.inference.residual_checks import FALSE_ALARM, ResidualSummary, residual_summaries
from bayesdrill.report.sections import fit_words as words

Array = NDArray[np.float64]

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])  # unequal
FREE = ("k_s", "j_m")
AT = np.array([NOMINAL[name] for name in FREE])
N = 60


@pytest.fixture(scope="module")
def rig() -> Likelihood:
    return posterior(noisy_step(SIGMA, n=N), SIGMA, free=FREE).likelihood


def with_residuals(rig: Likelihood, residuals: Array) -> Likelihood:
    y = rig.signals(AT[None])[0] + residuals
    return replace_only(rig, response=rig.only_observation.response.with_record(y))


def white(seed: int) -> Array:
    return SIGMA * np.random.default_rng(seed).standard_normal((N, 4))


def wrong(found: ResidualSummary) -> bool:
    return found.large or found.small or found.correlated or found.far


def test_records_of_the_model_give_a_finding_as_seldom_as_stated(rig: Likelihood) -> None:
    """2000 records, of which 20 or fewer; the limit below counts on a fit, so rather 15.

    Mutants killed: the limits of one look for all twenty.
    """
    found = [residual_summaries(with_residuals(rig, white(seed)), AT) for seed in range(2000)]
    rate = np.mean([any(map(wrong, one)) for one in found])
    assert 0.3 * FALSE_ALARM < rate < 1.6 * FALSE_ALARM
    for what in ("large", "correlated", "far"):
        assert any(getattr(channel, what) for one in found for channel in one)


def test_sizes_and_correlations_are_those_of_the_channel(rig: Likelihood) -> None:
    residuals = white(3)
    found = residual_summaries(with_residuals(rig, residuals), AT)
    for k, one in enumerate(found):
        own = residuals[:, k]
        assert one.channel == rig.only_observation.response.experiment.names[k]
        assert one.rms * SIGMA[k] == pytest.approx(np.sqrt(np.mean(own**2)))
        assert one.farthest == pytest.approx(np.abs(own / SIGMA[k]).max())
        assert (
            own[np.argmin(np.abs(rig.only_observation.response.experiment.t - one.time))] ** 2
            == (own**2).max()
        )
        assert one.correlation == pytest.approx(own[1:] @ own[:-1] / (own @ own), abs=1e-9)
        spread = rig.only_observation.response.experiment.y[:, k].std()
        assert one.share == pytest.approx(np.sqrt(np.mean(own**2)) / spread, rel=0.02)
    first, second = words.residual_sentences(found, SECOND).splitlines()
    assert first.startswith("fit: the MAP leaves unexplained ")
    assert f"{100 * found[1].share:.2g} % of {found[1].channel}" in first
    assert second.startswith("fit: the residuals look like the noise (rms ")


def test_a_channel_that_does_nothing_has_no_share(rig: Likelihood) -> None:
    flat = rig.only_observation.response.experiment.y.copy()
    flat[:, 0] = 3.0
    found = residual_summaries(
        replace_only(rig, response=rig.only_observation.response.with_record(flat)), AT
    )
    assert np.isnan(found[0].share)
    assert "theta_1" not in words.residual_sentences(found, SECOND).splitlines()[0]


@run_cases(
    "factor, which, says",
    [
        (2.0, "large", "are larger than the noise"),
        (0.4, "small", "are smaller than the noise"),
    ],
)
def test_a_wrong_sigma_is_told_in_its_channel(
    factor: float, which: str, says: str, rig: Likelihood
) -> None:
    residuals = white(5)
    residuals[:, 2] *= factor
    found = residual_summaries(with_residuals(rig, residuals), AT)
    assert [getattr(one, which) for one in found] == [False, False, True, False]
    assert not any(one.correlated or one.far for one in found)
    text = words.residual_sentences(found, SECOND).split("\n", 1)[1]
    assert says in text
    assert f"w_1 {found[2].rms:.3g}" in text
    assert "theta" not in text


def test_what_the_model_misses_is_told_with_unknown_noise_too() -> None:
    """A slow wave in one channel, whose sigma fits its size."""
    record = noisy_step(SIGMA, n=N)
    rig = posterior(record, None, free=FREE).likelihood
    residuals = white(5)
    residuals[:, 3] += 0.05 * np.sin(np.linspace(0, 9, N))
    size = np.sqrt(np.mean(residuals**2, axis=0))
    theta = np.array([*AT, *size])
    y = rig.signals(theta[None])[0] + residuals
    found = residual_summaries(
        replace_only(rig, response=rig.only_observation.response.with_record(y)), theta
    )
    assert [one.correlated for one in found] == [False, False, False, True]
    assert not any(one.large or one.small or one.far for one in found)
    text = words.residual_sentences(found, SECOND)
    assert f"to the next: w_2 {found[3].correlation:.3g}" in text
    assert "looks like" not in text


def test_an_unknown_sigma_that_its_prior_keeps_off_is_told() -> None:
    rig = posterior(noisy_step(SIGMA, n=N), None, free=FREE).likelihood
    y = rig.signals(np.array([*AT, *SIGMA])[None])[0] + white(4)
    own = replace_only(rig, response=rig.only_observation.response.with_record(y))
    found = residual_summaries(own, np.array([*AT, SIGMA[0] / 3, *SIGMA[1:]]))
    assert [one.large for one in found] == [True, False, False, False]


def test_a_differenced_column_and_one_bad_sample_are_told(rig: Likelihood) -> None:
    """Mutants killed: correlations above zero alone; sizes of the channel alone."""
    residuals = white(7)
    steps = np.random.default_rng(1).standard_normal(N + 2)
    residuals[:, 1] = SIGMA[1] * np.diff(steps, 2) / np.sqrt(6)
    residuals[20, 0] = -5.5 * SIGMA[0]
    found = residual_summaries(with_residuals(rig, residuals), AT)
    assert [one.correlated for one in found] == [False, True, False, False]
    assert found[1].correlation == pytest.approx(-2 / 3, abs=0.15)
    assert [one.far for one in found] == [True, False, False, False]
    assert (
        f"theta_1 5.5 at {rig.only_observation.response.experiment.t[20]:.4g} s"
        in words.residual_sentences(found, SECOND)
    )


def test_the_worst_channel_comes_first(rig: Likelihood) -> None:
    found = residual_summaries(with_residuals(rig, white(5) * [2.0, 1.0, 9.0, 4.0]), AT)
    assert re.search(
        r"noise: w_1 \S+, w_2 \S+, theta_1 \S+ times sigma \(",
        words.residual_sentences(found, SECOND),
    )


def test_an_exact_fit_leaves_less_than_noise(rig: Likelihood) -> None:
    found = residual_summaries(with_residuals(rig, np.zeros((N, 4))), AT)
    assert all(one.small and not one.large for one in found)
    assert not any(one.correlated and one.rms > 1e-9 for one in found)


@run_cases("rms, believed", [(1.4, True), (1.6, False)])
def test_a_fit_that_leaves_far_more_than_the_noise_is_not_believed(
    rms: float, believed: bool, rig: Likelihood
) -> None:
    """Mutants killed: every finding a reason; never one."""
    residuals = white(5)
    residuals[:, 2] *= rms * SIGMA[2] / np.sqrt(np.mean(residuals[:, 2] ** 2))
    found = residual_summaries(with_residuals(rig, residuals), AT)
    assert [one.large for one in found] == [False, False, True, False]
    assert [one.unbelievable for one in found] == [False, False, not believed, False]
    more = "the residuals are larger than the noise: w_1 1.6 times sigma"
    assert words.residual_reasons(found) == (() if believed else (more,))


@run_cases("weights, believed", [((1.0, 1.0), True), ((1.0,) * 5, False), ((1.0, -2.0, 1.0), True)])
def test_what_is_not_white_by_far_is_not_believed(
    weights: tuple[float, ...], believed: bool, rig: Likelihood
) -> None:
    """Averages of two and of five samples: correlations of 1/2 and of 4/5; a differenced column.

    Mutants killed: what is but told taken for a reason; a correlation below zero for one.
    """
    rng, residuals = np.random.default_rng(6), white(5)
    steps = np.convolve(rng.standard_normal(N + len(weights) - 1), weights, mode="valid")
    residuals[:, 1] = SIGMA[1] * steps / steps.std()
    found = residual_summaries(with_residuals(rig, residuals), AT)
    assert found[1].correlated
    assert not any(one.large for one in found)
    reasons = words.residual_reasons(found)
    assert reasons == () if believed else "are correlated" in reasons[0]
    if not believed:
        assert f"to the next: theta_2 {found[1].correlation:.3g}" in reasons[0]


def test_a_fit_that_leaves_too_little_is_believed(rig: Likelihood) -> None:
    """A sigma that is too large makes sds too large."""
    assert words.residual_reasons(residual_summaries(with_residuals(rig, 0.3 * white(5)), AT)) == ()


def test_the_simulation_and_predictions_one_step_ahead_stand_side_by_side() -> None:
    """Noise that remembers by 0.8 leaves 0.6 of itself one step ahead; white noise all, and nothing is
    said.  Mutants killed: shares of the whitened residuals, or of one channel for the other's.
    """
    record = noisy_step(SIGMA, n=400)
    rig = posterior(record, SIGMA, free=FREE).likelihood
    assert "one step ahead" not in words.residual_sentences(residual_summaries(rig, AT), SECOND)
    channels = [
        NoisyChannel(channel=c, sigma=float(s), start=1.0, entries={"rho": 0.8})
        for c, s in zip(record.channels, SIGMA, strict=True)
    ]
    noise = NOISES["ar1"].from_channels(channels, 400)
    blank = np.zeros((1, 400, 4))
    residuals = noise.draw(blank, np.empty((1, 0)), np.random.default_rng(2))[0]
    found = residual_summaries(with_residuals(replace_only(rig, noise=noise), residuals), AT)
    spread = rig.signals(AT[None])[0].std(axis=0)
    for k, one in enumerate(found):
        assert one.simulated == one.share
        fresh = residuals[1:, k] - 0.8 * residuals[:-1, k]
        assert one.ahead == pytest.approx(fresh.std() / spread[k], rel=0.05)
        assert one.ahead == pytest.approx(0.6 * one.simulated, rel=0.2)
    text = words.residual_sentences(found, SECOND).splitlines()[1]
    last = found[-1]
    assert text.startswith(
        "fit: explained by the simulation alone, and by predictions one step ahead"
    )
    assert text.endswith(
        f"w_2 {100 * (1 - last.simulated):.4g} % and {100 * (1 - last.ahead):.4g} %."
    )
