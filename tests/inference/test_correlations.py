"""Correlations of residuals with themselves and with inputs, and sds that count on them."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from support.missing_physics import best
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, posterior, replace_only

from bayesdrill.analysis.diagnostics import sandwich_sds
from bayesdrill.inference.laplace import information_root, long_run_variance
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import ResidualCorrelation, correlations, input_sentences

Array = NDArray[np.float64]

N, DT = 600, 0.01
SIGMA = np.array([0.02, 0.1])
FREE = ("k_s", "j_1", "k_e")
AT = np.array([NOMINAL[name] for name in FREE])
MEASURES = {"theta_1": {"theta_1": 1.0}, "w_2": {"w_2": 1.0}}


def remembering(rho: float, shape: tuple[int, ...], seed: int) -> Array:
    """First-order autoregressive, of sd 1."""
    fresh = np.random.default_rng(seed).standard_normal((shape[0] + 300, *shape[1:]))
    return np.asarray(lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], fresh, axis=0)[300:])


def voltage() -> Array:
    return 6.0 + 2.0 * remembering(0.9, (N,), 99)


@cache
def rig() -> Posterior:
    record = experiment(N, DT, series={"v": voltage()}, constant={"t_1": 0.0}, measures=MEASURES)
    return posterior(record, SIGMA, free=FREE)


def with_residuals(residuals: Array) -> Posterior:
    """Samples are missing where `residuals (N, 2)` are NaN."""
    likelihood = rig().likelihood
    y = likelihood.signals(AT[None])[0] + residuals
    one = likelihood.only_observation
    shown = dataclasses.replace(one.experiment, y=y)
    counts = tuple(int(n) for n in (~np.isnan(y)).sum(axis=0))
    changed = replace_only(
        likelihood, response=one.response.of(shown), noise=one.noise.with_counts(counts)
    )
    return dataclasses.replace(rig(), likelihood=changed)


def found(residuals: Array) -> dict[tuple[str, str], ResidualCorrelation]:
    every = correlations(with_residuals(residuals).likelihood, AT)
    return {(one.channel.name, one.input): one for one in every}


def test_they_are_those_of_pairs_of_samples_that_are_there() -> None:
    """By a plain loop over pairs.  Mutants killed: samples beside a gap taken for neighbours; a lag
    the wrong way round.
    """
    residuals = SIGMA * remembering(0.7, (N, 2), 1)
    residuals[100:160, 0] = residuals[300, 1] = np.nan
    every = found(residuals)
    e, v = residuals[:, 0] / SIGMA[0], voltage()
    own = every["theta_1", ""]
    size = np.nanmean(e**2)

    def mean(a: Array, b: Array) -> float:
        pairs = [x * y for x, y in zip(a, b, strict=True) if np.isfinite(x * y)]
        return float(np.mean(pairs))

    for lag in (1, 2, 7, 25):
        assert own.lags[lag - 1] == lag
        assert own.values[lag - 1] == pytest.approx(mean(e[lag:], e[:-lag]) / size, rel=1e-9)
    with_v = every["theta_1", "v"]
    rho = own.values[0]
    u = np.where(np.isnan(e), np.nan, v - v[~np.isnan(e)].mean())
    fresh, driven = e[1:] - rho * e[:-1], u[1:] - rho * u[:-1]
    size = np.sqrt(np.nanmean(fresh**2) * np.nanmean(driven**2))
    for lag in (0, 1, 5, 25):
        late = mean(fresh[lag:], driven[: len(driven) - lag]) / size
        assert with_v.values[with_v.lags == lag] == pytest.approx(late, rel=1e-9)
        early = mean(fresh[: len(fresh) - lag], driven[lag:]) / size
        assert with_v.values[with_v.lags == -lag] == pytest.approx(early, rel=1e-9)
    assert with_v.step == pytest.approx(DT)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_bands_of_inputs_hold_what_chance_gives(rho: float) -> None:
    """200 records of residuals that know nothing of the input, which itself remembers: one value in a
    hundred is outside, and hardly a record is said to follow it.

    Mutants killed: inputs and residuals that are not filtered; limits of one look for all.
    """
    outside, said = [], 0
    for seed in range(200):
        every = found(SIGMA * remembering(rho, (N, 2), seed))
        chosen = [one for (_, given), one in every.items() if given]
        outside += [np.abs(one.values) > one.band for one in chosen]
        said += bool(input_sentences(chosen))
    assert 0.003 < np.mean(outside) < 0.02
    assert said <= 7  # 2 on the mean, by chance
    white = [found(SIGMA * remembering(0.0, (N, 2), seed))["w_2", ""] for seed in range(100)]
    assert 0.005 < np.mean([np.abs(one.values) > one.band for one in white]) < 0.02


def test_what_an_input_does_late_is_named_with_its_lag() -> None:
    """Also where it stands deep in residuals that remember, and where the input comes after."""
    noise, v = SIGMA * remembering(0.9, (N, 2), 3), voltage() - 6.0
    late = noise.copy()
    late[4:, 1] += 0.04 * v[:-4]
    (text,) = input_sentences(list(found(late).values()))
    assert text.startswith("the residuals of w_2 follow the input v, +4 samples (0.04 s) after")
    early = noise.copy()
    early[:-3, 0] += 0.008 * v[3:]
    (text,) = input_sentences(list(found(early).values()))
    assert "theta_1 follow the input v, -3 samples" in text
    assert text.endswith(": the input answers to the rig, or times are off")


def test_a_sandwich_is_what_refits_scatter_by() -> None:
    """40 records whose noise remembers, fitted as if it were white: the posterior's sds are too small
    by what slopes and memory make of it, in closed form.

    Mutants killed: the covariance of the posterior itself; lags that count only near 0; the prior's
    part counted twice.
    """
    rho, step = 0.8, 1e-5
    up, down = (np.repeat(AT[None], 3, axis=0) * np.exp(s * step * np.eye(3)) for s in (1, -1))
    signals = rig().likelihood.signals
    slopes = ((signals(up) - signals(down)) / (2 * step) / SIGMA).transpose(1, 2, 0)  # (N, 2, D)
    memory = rho ** np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    inverse = np.linalg.inv(np.einsum("tkd,tke->de", slopes, slopes))
    middle = np.einsum("tkd,ts,ske->de", slopes, memory, slopes)
    white = AT * np.sqrt(np.diag(inverse))
    true = AT * np.sqrt(np.diag(inverse @ middle @ inverse))
    assert (true > 1.8 * white).all()
    refits, sds = [], []
    for seed in range(40):
        target = with_residuals(SIGMA * remembering(rho, (N, 2), seed))
        refits.append(best(target))
        sds.append([*sandwich_sds(target, refits[-1]).values()])
    spread = np.std(refits, axis=0, ddof=1)
    assert spread == pytest.approx(true, rel=0.25)  # of 40, known to 11 %
    assert np.mean(sds, axis=0) == pytest.approx(spread, rel=0.2)
    assert np.mean(sds, axis=0) == pytest.approx(true, rel=0.1)


def test_a_sandwich_of_white_residuals_is_the_posterior_s_and_leaves_priors_alone() -> None:
    """k_s that two samples say nothing of keeps the sd of its prior."""
    target = with_residuals(SIGMA * remembering(0.0, (N, 2), 5))
    inverse = np.linalg.inv(information(target))
    sds = np.array([*sandwich_sds(target, AT).values()])
    assert sds == pytest.approx(AT * np.sqrt(np.diag(inverse)), rel=0.15)
    hidden = np.full((N, 2), np.nan)
    hidden[:2] = 0.0
    blind = with_residuals(hidden)
    prior = np.log(np.random.default_rng(1).uniform(0.5, 1.5, 400_000)).std()
    assert sandwich_sds(blind, AT)["k_s"] == pytest.approx(AT[0] * prior, rel=0.01)


def information(target: Posterior) -> Array:
    root = information_root(target, AT)
    return np.asarray(root.T @ root)


def test_the_variance_of_a_sum_counts_all_lags() -> None:
    """Of an AR(1) it is (1 + rho) / (1 - rho) times that of as many independent numbers."""
    for rho, within in ((0.0, 0.05), (0.5, 0.1), (0.9, 0.2), (-0.5, 0.1)):
        x = remembering(rho, (20_000, 2), 7)
        expected = 20_000 * (1 + rho) / (1 - rho)
        assert np.diag(long_run_variance(x)) / expected == pytest.approx([1.0, 1.0], abs=within)
