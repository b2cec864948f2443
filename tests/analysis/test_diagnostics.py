"""Rows of unknowns: ends of priors, ranks of ensembles, dependence on priors, and sandwich sds."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import rankdata
from support.case_tables import run_cases
from support.missing_physics import MEASURES, ar1, best
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, posterior

from bayesdrill.analysis import diagnostics
from bayesdrill.analysis.diagnostics import (
    RANK_BINS,
    ParameterRow,
    Word,
    end_at_nominal,
    pressed_against,
    prior_dependence,
    rank_histograms,
    sandwich_sds,
)
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import (
    HalfNormal,
    LogNormal,
    LogUniform,
    Prior,
    TruncatedNormal,
    Uniform,
)

Array = NDArray[np.float64]

U = (np.arange(4000) + 0.5) / 4000
EXPONENTIAL = -np.log(U)
BOX = Uniform(0.5, 1.5)
CUT = TruncatedNormal(1.0, 0.3, 0.2, 1.05)


def bell(middle: float, sd: float, low: float = -np.inf, high: float = np.inf) -> Array:
    """Return draws of a normal that is cut at its ends."""
    return TruncatedNormal(middle, sd, low, high).quantile(U)


PRESSED: dict[str, tuple[Prior, Array, float | None]] = {
    "above": (BOX, 1.5 - 0.02 * EXPONENTIAL, 1.5),
    "below, closely": (BOX, 0.5 + 1e-8 * EXPONENTIAL, 0.5),
    "log-uniform": (LogUniform(1e-3, 1.0), 1e-3 * (1.0 + 0.05 * EXPONENTIAL), 1e-3),
    "truncated": (TruncatedNormal(1.0, 0.3, 0.2, 2.0), 0.2 + 1e-3 * EXPONENTIAL, 0.2),
    "zero": (HalfNormal(1.0), 1e-3 * EXPONENTIAL, 0.0),
    "nine unknowns that share one scale": (Uniform(0.0, 1.0), U ** (1.0 / 9.0), None),
    **{
        f"a peak of the width {sd} near an end": (
            BOX,
            1.5 - 3 * sd + sd * np.sqrt(2.0) * np.cos(np.pi * U),
            None,
        )
        for sd in (1e-4, 5e-3)
    },
    **{
        f"draws of the prior itself, {prior}": (prior, prior.quantile(U), None)
        for prior in (BOX, LogUniform(1e-3, 1.0), CUT, HalfNormal(1.0), LogNormal(1.0, 2.0))
    },
}


@run_cases("prior, draws, end", PRESSED.values(), PRESSED)
def test_draws_that_crowd_at_an_end_of_their_prior_are_pressed_against_it(
    prior: Prior, draws: Array, end: float | None
) -> None:
    assert pressed_against(draws, prior) == end


AT_NOMINAL: dict[str, tuple[Prior, Array, float | None]] = {
    "begins at nominal": (Uniform(1.0, 1.5), bell(1.0, 0.01, 1.0, 1.5), 1.0),
    "ends at nominal": (LogUniform(0.5, 1.0), bell(1.0, 0.01, 0.5, 1.0), 1.0),
    "begins beyond it": (TruncatedNormal(1.0, 0.3, 1.1, 3.0), bell(1.4, 0.01), 1.1),
    "ends beyond it, far from the draws": (Uniform(0.2, 0.9), bell(0.5, 0.01), 0.9),
    "begins a little before it": (Uniform(0.99, 1.5), bell(1.0, 0.01, 0.99), 0.99),
    "begins before it, far from the draws": (Uniform(0.99, 1.5), bell(1.2, 0.01), None),
    "nominal in the middle": (BOX, bell(1.0, 0.3, 0.5, 1.5), None),
    "an end at zero": (Uniform(0.0, 40.0), bell(0.0, 1.0, 1e-9), None),
    "no end at all": (LogNormal(1.0, 0.5), bell(1.0, 0.01), None),
}


@run_cases("prior, draws, end", AT_NOMINAL.values(), AT_NOMINAL)
def test_an_end_that_cuts_draws_off_at_the_nominal_value_is_found(
    prior: Prior, draws: Array, end: float | None
) -> None:
    """The nominal value is 1."""
    assert end_at_nominal(draws, prior, 1.0) == end


def ensembles(seed: int, n: int = 600, unknowns: int = 2) -> Array:
    return np.random.default_rng(seed).standard_normal((4, n, unknowns))


def test_counts_are_those_of_the_ranks() -> None:
    x = ensembles(1)
    for d, histogram in enumerate(rank_histograms(x, np.random.default_rng(0))):
        assert histogram.draws == 600
        assert (histogram.counts.sum(axis=1) == 600).all()
        assert (histogram.counts.sum(axis=0) == 2400 / RANK_BINS).all()
        first = (rankdata(x[..., d]).reshape(4, 600) <= 2400 / RANK_BINS).sum(axis=1)
        assert (histogram.counts[:, 0] == first).all()


def test_an_ensemble_that_is_elsewhere_leaves_the_band() -> None:
    x = ensembles(2)
    x[2, :, 0] += 0.25
    x[1, :, 1] *= 1.3
    shifted, wider = rank_histograms(x, np.random.default_rng(0))
    assert list(np.flatnonzero(~shifted.is_consistent)) == [2]
    assert list(np.flatnonzero(~wider.is_consistent)) == [1]
    assert (shifted.deviation[2] < 0).mean() > 0.9  # draws too high: too few below any share


def test_equal_ensembles_leave_the_band_as_often_as_is_said() -> None:
    """1 % of 400; twelve or more would come once in a thousand times."""
    alarms = 0
    widths = diagnostics._chance_widths(4, 300, 0.01, np.random.default_rng(3))
    for seed in range(400):
        ranks = rankdata(ensembles(1000 + seed, 300, 1)).reshape(4, 300) / 1200
        below = np.stack([(ranks <= share).sum(axis=1) for share in diagnostics.SHARES], axis=1)
        alarms += bool((np.abs(below - 300 * diagnostics.SHARES) > widths).any())
    assert 0 < alarms < 12


def row(name: str, word: Word) -> ParameterRow:
    fields = {field.name: 1.0 for field in dataclasses.fields(ParameterRow)}
    return ParameterRow(**fields | {"name": name, "unit": "1", "word": word})


A, B, C = np.random.default_rng(4).uniform(1.0, 3.0, (3, 6000))  # left to their priors
NOISE = np.random.default_rng(5).standard_normal(6000)
DEPENDENT: dict[str, tuple[Array, tuple[str, ...]]] = {
    "a line": (2.0 - 0.3 * A + 0.01 * NOISE, ("a",)),
    "a bent ridge": (np.exp(-4 * A) * (1 + 0.01 * NOISE), ("a",)),
    "a product": (A * B, ("a", "b")),
    "hardly": (A + 2.0 * NOISE, ()),
    "not at all": (NOISE, ()),
}


@run_cases("draws, partners", DEPENDENT.values(), DEPENDENT)
def test_an_unknown_explained_by_unconstrained_partners_depends_on_their_priors(
    draws: Array, partners: tuple[str, ...]
) -> None:
    kinds: tuple[Word, ...] = ("prior only", "determined", "prior only", "prior only")
    rows = [row(name, word) for name, word in zip("axbc", kinds, strict=True)]
    result = prior_dependence(rows, np.stack([A, draws, B, C], axis=1))
    assert result == ({"x": partners} if partners else {})


@run_cases("partner, word", [("weak", "determined"), ("prior only", "through others")])
def test_only_what_is_called_determined_depends_on_a_prior(partner: Word, word: Word) -> None:
    """And only on what the record leaves to its prior."""
    draws = np.stack([A, A + 0.01 * NOISE], axis=1)
    assert prior_dependence([row("a", partner), row("x", word)], draws) == {}


N, SIGMA, FREE = 600, np.array([0.02, 0.1]), ("k_s", "j_1", "k_e")
AT = np.array([NOMINAL[name] for name in FREE])


@cache
def rig() -> Posterior:
    series = {"v": 6.0 + 2.0 * ar1(0.9, (N,), 99)}
    record = experiment(N, 0.01, series=series, constant={"t_1": 0.0}, measures=MEASURES)
    return posterior(record, SIGMA, free=FREE)


def test_sandwich_sds_are_those_by_which_refits_scatter() -> None:
    """Over 40 records whose noise is correlated, fitted as if it were white: the posterior's sds are
    too small, and the right ones have a closed form."""
    rho, step = 0.8, 1e-5
    signals = rig().likelihood.signals
    up, down = (np.repeat(AT[None], 3, axis=0) * np.exp(s * step * np.eye(3)) for s in (1, -1))
    slopes = ((signals(up) - signals(down)) / (2 * step) / SIGMA).transpose(1, 2, 0)  # (N, 2, D)
    correlation = rho ** np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    inverse = np.linalg.inv(np.einsum("tkd,tke->de", slopes, slopes))
    middle = np.einsum("tkd,ts,ske->de", slopes, correlation, slopes, optimize=True)
    true = AT * np.sqrt(np.diag(inverse @ middle @ inverse))
    assert (true > 1.8 * AT * np.sqrt(np.diag(inverse))).all()
    refits, sds = [], []
    for seed in range(40):
        target = rig().edit(records=[signals(AT[None])[0] + SIGMA * ar1(rho, (N, 2), seed)])
        refits.append(best(target))
        sds.append([*sandwich_sds(target, refits[-1]).values()])
    spread = np.std(refits, axis=0, ddof=1)
    assert spread == pytest.approx(true, rel=0.25)  # 40 refits know it to 11 %
    assert np.mean(sds, axis=0) == pytest.approx(spread, rel=0.2)
    assert np.mean(sds, axis=0) == pytest.approx(true, rel=0.1)
