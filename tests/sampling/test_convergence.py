"""Convergence against processes whose autocorrelation is known."""

from __future__ import annotations

import math

import emcee
import numpy as np
import pytest
import scipy.stats
from support.case_tables import run_cases
from support.known_chains import ar1

from bayesdrill.inference.derived import HDI_PROBABILITY, hdi
from bayesdrill.sampling.convergence import (
    BURN_IN_TAUS,
    Targets,
    assess,
    autocorrelation_time,
    chain_length,
    futility,
    thinned,
)

TARGETS = Targets(r_hat=1.01, n_tau=50, ess=1000)


@run_cases("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_a_known_process(rho: float) -> None:
    tau = autocorrelation_time(ar1((4, 2000, 16, 2), rho))
    assert tau == pytest.approx((1 + rho) / (1 - rho), rel=0.05)


def test_autocorrelation_time_is_emcees() -> None:
    chain = ar1((1, 4000, 12, 3), 0.8) * [1.0, 1e-4, 50.0] + [0.0, 3.0, -7.0]
    true = emcee.autocorr.integrated_time(chain[0], tol=0, quiet=True)
    assert autocorrelation_time(chain) == pytest.approx(true, rel=0.05)


def test_converged_chains_are_believed() -> None:
    found = assess(ar1((4, 1200, 16, 2), 0.8), ("a", "b"), TARGETS)
    assert found.converged
    assert found.tau == pytest.approx([9, 9], rel=0.1)
    assert found.burn_in == pytest.approx(45, abs=6)
    assert found.thin in (9, 10)


def test_ensembles_that_disagree_are_not() -> None:
    """Mutant killed: R-hat over walkers instead of ensembles."""
    chains = ar1((4, 1200, 16, 2), 0.8)
    chains[2, :, :, 1] += 0.8
    found = assess(chains, ("a", "b"), TARGETS)
    assert not found.converged
    assert "the ensembles disagree on b" in found.reasons[0]


def test_walkers_that_disagree_alike_in_all_ensembles_are_not_independent_chains() -> None:
    """Stuck walkers: every ensemble has the same mixture, so only tau can tell."""
    chains = ar1((4, 1200, 16, 1), 0.2)
    chains += 5.0 * np.arange(16)[:, None]
    found = assess(chains, ("a",), TARGETS)
    assert not found.converged
    assert "autocorrelation times long" in " ".join(found.reasons)


def test_short_chains_say_what_is_missing() -> None:
    found = assess(ar1((4, 150, 16, 1), 0.9), ("a",), TARGETS)
    assert any("wanted at least 50" in reason for reason in found.reasons)
    few = assess(ar1((4, 600, 4, 1), 0.5), ("a",), Targets(r_hat=1.5, n_tau=10, ess=1e6))
    assert any("effective draws of a, wanted at least 1e+06" in reason for reason in few.reasons)


def test_where_only_length_is_missing_it_says_how_many_steps_would_do() -> None:
    """So many do, and a chain whose ensembles disagree is promised nothing."""
    chains = ar1((4, 4000, 16, 2), 0.9)
    short = assess(chains[:, :600], ("a", "b"), TARGETS)
    assert not short.converged
    assert short.enough is not None
    assert short.slowest in ("a", "b")
    assert 600 < short.enough < 4000
    assert assess(chains[:, : short.enough], ("a", "b"), TARGETS).converged
    chains[2, :, :, 1] += 3.0
    assert assess(chains[:, :600], ("a", "b"), TARGETS).enough is None


def test_effective_draws_of_independent_ones_are_their_number() -> None:
    found = assess(ar1((4, 700, 10, 1), 0.0), ("a",), TARGETS)
    kept = 4 * 10 * (found.steps - found.burn_in) / found.thin
    assert found.ess_bulk[0] == pytest.approx(kept, rel=0.1)


def test_walkers_that_remember_their_last_draw_have_no_more_effective_ones() -> None:
    """Draws are thinned by tau or by a quarter of the steps, whatever is less: here by far less.

    ArviZ takes the walkers of an ensemble for a series, in which neighbours are independent.
    Mutant killed: its number taken for all walkers, thousands of draws of which hundreds count.
    """
    rho, walkers, steps = 0.98, 64, 300
    found = assess(ar1((4, steps, walkers, 1), rho), ("a",), TARGETS)
    assert found.thin < found.tau[0]
    kept = steps - found.burn_in
    true = 4 * walkers * kept * (1 - rho) / (1 + rho)
    assert found.ess_bulk[0] < 2 * true
    assert found.ess_tail[0] <= 4 * walkers * kept / found.thin


@run_cases(
    "trail, says",
    [
        ([(200, 8), (400, 16), (1000, 41)], None),  # on its way: tau is constant
        ([(200, 8), (400, 8.5), (800, 9)], None),  # too early to say
        ([(500, 9), (1000, 10)], "tau grows with the chain, 56 steps after 500 and 100 after 1000"),
        ([(500, 50), (1000, 51)], None),  # nothing is missing
        (
            [(500, 1.0), (1000, 2.0)],
            "about 25000 steps, more than sampler.max_steps (20000); raise",
        ),
        ([(500, 1.3), (1000, 2.6)], None),  # 19231 steps would do
        ([(600, 9), (1000, 10)], None),  # no check at half of the steps or less to compare with
    ],
)
def test_runs_that_more_steps_would_not_help_are_given_up(
    trail: list[tuple[int, float]], says: str | None
) -> None:
    """Mutants killed: given up before it can be told; never; what is enough given up."""
    found = futility(trail, wanted=50, allowed=20_000, most=20_000)
    assert (says in found) if says else found == ""
    assert not found or found.startswith("stopped early: ")


def test_a_chain_that_would_be_too_large_is_not_for_max_steps_to_mend() -> None:
    """Mutant killed: advice that changes nothing."""
    found = futility([(500, 3.0), (1000, 6.0)], wanted=50, allowed=20_000, most=8_000)
    assert "about 8333 steps, more than the 8000 that a chain of so many walkers" in found
    assert "sampler.walkers a smaller number" in found
    assert "max_steps" not in found


@run_cases("rho", [0.0, 0.5, 0.9])
def test_the_next_check_is_when_the_chain_is_long_enough(rho: float) -> None:
    """Of an AR(1) chain tau is known.  Mutant killed: a growth that does not ask for tau."""
    tau = (1.0 + rho) / (1.0 - rho)
    steps = math.ceil(BURN_IN_TAUS * tau + 40 * tau)  # not quite the 50 that are wanted
    found = chain_length(ar1((4, steps, 64, 1), rho))
    assert found.n_tau < 50
    ahead = found.next_check(steps, 50)
    assert 1.05 * 55 * tau < ahead < 1.4 * 55 * tau
    assert chain_length(ar1((4, ahead, 64, 1), rho)).n_tau > 50


def test_checks_are_neither_rare_nor_many() -> None:
    """However far there is to go, and also where the length is not what is missing."""
    found = chain_length(ar1((4, 200, 16, 1), 0.5))
    assert found.next_check(200, 1e6) == 300
    assert found.next_check(200, 1.0) == 250


def test_thinning_keeps_time_and_ensembles_apart() -> None:
    """Mutant killed: chain transposed."""
    chains = np.arange(2 * 10 * 3 * 1, dtype=float).reshape(2, 10, 3, 1)
    draws = thinned(chains, burn_in=4, thin=3)
    assert draws.shape == (2, 6, 1)
    assert list(draws[0, :, 0]) == [12, 13, 14, 21, 22, 23]
    assert list(draws[1, :3, 0]) == [42, 43, 44]


def test_hdi_is_the_narrowest_interval_not_the_one_with_equal_tails() -> None:
    """Of an exponential it begins at zero; arviz-stats versions before 1.2.1 returned an ETI."""
    assert HDI_PROBABILITY == 0.94
    u = (np.arange(200_000) + 0.5) / 200_000
    low, high = hdi(scipy.stats.expon.ppf(u))
    assert low == pytest.approx(0.0, abs=1e-3)
    assert high == pytest.approx(-np.log(0.06), abs=1e-3)
    low, high = hdi(scipy.stats.gamma(3.0).ppf(u))
    density = scipy.stats.gamma(3.0).pdf
    assert density(low) == pytest.approx(density(high), rel=0.01)
    cdf = scipy.stats.gamma(3.0).cdf
    assert cdf(high) - cdf(low) == pytest.approx(0.94, abs=1e-3)
