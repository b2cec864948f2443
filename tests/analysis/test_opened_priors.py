"""Nominal values at ends of priors: tensions against the likelihood on a grid, which knows no end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import measured, posterior
from scipy.stats import norm
from together import for_each
from verdicts import LINEAR, NAMES, PRIOR, TABLE, gaussian

from bayesdrill.analysis.verdict import judge, tension
from bayesdrill.basics.progress import Silent
from bayesdrill.config.schema.config import Thresholds
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import LogNormal, LogUniform, Prior, TruncatedNormal, Uniform
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import ExtendedPriors, Plan, SamplingResult
from bayesdrill.sampling.extended_priors import with_extended_priors

SIGMA = np.full(4, 0.1)
PLAN = Plan(
    ensembles=4,
    walkers=64,
    moves={"independence": 1.0},
    targets=Targets(r_hat=1.01, n_tau=50, ess=1000),
    max_steps=2000,
    seed=3,
)
K_S = NOMINAL["k_s"]
NAMED = {"k_s": K_S}


def opened(target: Posterior, draws: np.ndarray, maxima: np.ndarray) -> ExtendedPriors | None:
    """What is seen beyond ends, of a chain of these draws `(N, D)` that has converged."""
    convergence: Any = SimpleNamespace(converged=True, burn_in=0, thin=1)
    sampled = SamplingResult(segments=[], theta=draws[None, :, None], convergence=convergence)
    return with_extended_priors(sampled, target, NAMED, maxima, PLAN, Silent()).extended


def test_an_end_at_the_nominal_value_does_not_count() -> None:
    """Mutants killed: the end is not moved; it is moved to the other side; only one end is looked at."""
    cases = {
        "begins at nominal": (Uniform(K_S, 1.5 * K_S),),
        "ends there": (LogUniform(0.5 * K_S, K_S),),
        "begins beyond it": (TruncatedNormal(K_S, K_S, low=1.001 * K_S),),
    }

    def check(prior: Prior) -> None:
        target = posterior(measured(SIGMA, 101, 0.03), SIGMA, free=("k_s",), priors={"k_s": prior})
        top = np.array([[min(max(1.0005 * K_S, prior.low), prior.high)]])
        draws = np.linspace(0.99, 1.01, 4001)[:, None] * K_S
        draws = draws[(draws[:, 0] >= prior.low) & (draws[:, 0] <= prior.high)]
        found = opened(target, draws, top)
        assert found is not None
        assert found.draws is not None
        assert found.names == ("k_s",)
        grid = np.linspace(0.95, 1.05, 2001)[:, None] * K_S
        log_p = target.likelihood(grid)
        mass = np.exp(log_p - log_p.max())
        below = mass[grid[:, 0] <= K_S].sum() / mass.sum()
        exact = norm.isf(min(below, 1.0 - below))
        assert tension(np.log(found.draws[:, 0] / K_S), 0.0, 0.0) == pytest.approx(exact, abs=0.1)

    for_each(cases, check)


def test_priors_that_are_in_nobodys_way_stay() -> None:
    """Mutants killed: ends are opened wherever draws, or the nominal value, are near."""
    cases = {
        "nominal in the middle": (Uniform(0.5 * K_S, 1.5 * K_S), 0.5, 1.5),
        "an end that no draw comes near": (Uniform(0.99 * K_S, 1.5 * K_S), 1.2, 1.21),
        "no end at all": (LogNormal(K_S, 0.5), 0.9, 1.1),
    }

    def check(prior: Prior, low: float, high: float) -> None:
        target = posterior(measured(SIGMA, 101, 0.03), SIGMA, free=("k_s",), priors={"k_s": prior})
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        share = (np.arange(2000) + 0.5) / 2000
        draws = (middle + half * np.clip(norm.ppf(share) / 4, -1, 1))[:, None] * K_S
        assert opened(target, draws, draws[:1]) is None

    for_each(cases, check)


def cut(truth: dict[str, float], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact draws, and those of them that a box that begins at the nominal `r_m` leaves."""
    draws = gaussian(truth, np.random.default_rng(seed), 20_000)
    return draws, draws[draws[:, 2] > TABLE["r_m"]]


def test_tensions_are_counted_where_the_ends_are_open() -> None:
    """Mutants killed: the cut draws are counted, alone or together; the mean is the open one."""
    free, inside = cut(TABLE, 4)
    blind = judge(LINEAR, inside, PRIOR, TABLE, {}, ["r_m"], Thresholds())
    whole = judge(LINEAR, free, PRIOR, TABLE, {}, (), Thresholds())
    beyond = ExtendedPriors(names=("r_m",), draws=free, pressed=())
    found = judge(LINEAR, inside, PRIOR, TABLE, {}, ["r_m"], Thresholds(), beyond)
    assert found.joint == whole.joint
    assert found.opened == ("r_m",)
    for got, cut_off, exact in zip(
        found.parameters, blind.parameters, whole.parameters, strict=True
    ):
        assert got.tension == exact.tension
        assert got.mean == cut_off.mean
        assert got.says == exact.says != "pressed against the prior"


def test_what_could_not_be_opened_is_pressed() -> None:
    """Mutant killed: a posterior that did not converge is counted all the same."""
    _, inside = cut(TABLE, 5)
    found = judge(
        LINEAR, inside, PRIOR, TABLE, {}, (), Thresholds(),
        ExtendedPriors(names=("r_m",), draws=None, pressed=("r_m",)),
    )  # fmt: skip
    (pressed,) = found.saying("pressed against the prior")
    assert pressed.exponents == tuple(int(name == "r_m") for name in NAMES)
    assert found.joint is None
    assert found.agrees
