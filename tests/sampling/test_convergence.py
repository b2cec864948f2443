"""Convergence of processes whose autocorrelation is known, and of chains with one fault each."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.stats
from scipy.special import ndtr
from support.case_tables import run_cases

from bayesdrill.inference.derived import HDI_PROBABILITY, hdi
from bayesdrill.report.findings import finding_sentence, finding_sentences
from bayesdrill.sampling.convergence import (
    BURN_IN_TAUS,
    Convergence,
    Targets,
    assess,
    autocorrelation_time,
    chain_length,
    find_two_groups,
    futility,
    thinned,
)

TARGETS = Targets(r_hat=1.01, n_tau=50, ess=1000)


def ar1(shape: tuple[int, int, int, int], rho: float, seed: int = 6) -> np.ndarray:
    """`(E, S, W, D)` with autocorrelation rho^k: integrated time (1 + rho)/(1 - rho)."""
    rng = np.random.default_rng(seed)
    x = np.empty(shape)
    x[:, 0] = rng.standard_normal(shape[:1] + shape[2:])
    for s in range(1, shape[1]):
        fresh = rng.standard_normal(shape[:1] + shape[2:])
        x[:, s] = rho * x[:, s - 1] + np.sqrt(1 - rho**2) * fresh
    return x


def sentences(result: Convergence) -> tuple[str, ...]:
    return finding_sentences(result.reasons)


@run_cases("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_a_known_process(rho: float) -> None:
    tau = autocorrelation_time(ar1((4, 2000, 16, 2), rho))
    assert tau == pytest.approx((1 + rho) / (1 - rho), rel=0.05)


def test_converged_chains_are_believed() -> None:
    result = assess(ar1((4, 1200, 16, 2), 0.8), ("a", "b"), TARGETS)
    assert result.converged
    assert result.tau == pytest.approx([9, 9], rel=0.1)
    assert result.burn_in == pytest.approx(45, abs=6)
    assert result.thin in (9, 10)


def test_ensembles_that_disagree_are_not_believed() -> None:
    chains = ar1((4, 1200, 16, 2), 0.8)
    chains[2, :, :, 1] += 0.8
    result = assess(chains, ("a", "b"), TARGETS)
    assert not result.converged
    assert "the ensembles disagree on b" in sentences(result)[0]


def test_walkers_that_disagree_alike_in_all_ensembles_are_not_independent_chains() -> None:
    """Stuck walkers: every ensemble has the same mixture, so only tau can tell."""
    chains = ar1((4, 1200, 16, 1), 0.2) + 5.0 * np.arange(16)[:, None]
    result = assess(chains, ("a",), TARGETS)
    assert not result.converged
    assert "autocorrelation times long (tau" in " ".join(sentences(result))


def test_short_chains_say_what_is_missing() -> None:
    short = assess(ar1((4, 150, 16, 1), 0.9), ("a",), TARGETS)
    assert any("wanted at least 50" in reason for reason in sentences(short))
    few = assess(ar1((4, 600, 4, 1), 0.5), ("a",), Targets(r_hat=1.5, n_tau=10, ess=1e6))
    assert any("effective draws of a, wanted at least 1e+06" in reason for reason in sentences(few))


def test_a_chain_that_is_only_too_short_says_how_many_steps_are_enough() -> None:
    """A chain whose ensembles disagree is promised nothing."""
    chains = ar1((4, 4000, 16, 2), 0.9)
    short = assess(chains[:, :600], ("a", "b"), TARGETS)
    assert not short.converged
    assert short.slowest in ("a", "b")
    assert 600 < short.enough < 4000
    assert assess(chains[:, : short.enough], ("a", "b"), TARGETS).converged
    chains[2, :, :, 1] += 3.0
    assert assess(chains[:, :600], ("a", "b"), TARGETS).enough is None


def test_walkers_that_remember_their_last_draw_have_no_more_effective_draws() -> None:
    """Draws are thinned by tau or by a quarter of the steps, whatever is less: here by far less.

    ArviZ takes the walkers of an ensemble for a series, in which neighbours are independent.
    """
    rho, walkers, steps = 0.98, 64, 300
    result = assess(ar1((4, steps, walkers, 1), rho), ("a",), TARGETS)
    assert result.thin < result.tau[0]
    kept = 4 * walkers * (steps - result.burn_in)
    assert result.ess_bulk[0] < 2 * kept * (1 - rho) / (1 + rho)
    assert result.ess_tail[0] <= kept / result.thin


TOO_LONG = "about 25000 steps, more than sampler.max_steps (20000). Raise"


@run_cases(
    "trail, words",
    [
        ([(200, 8), (400, 16), (1000, 41)], None),  # on its way: tau is constant
        ([(200, 8), (400, 8.5), (800, 9)], None),  # too early to say
        ([(500, 9), (1000, 10)], "the chain. It was 56 at step 500 and is 100 at step 1000"),
        ([(500, 50), (1000, 51)], None),  # nothing is missing
        ([(500, 1.0), (1000, 2.0)], TOO_LONG),
        ([(500, 1.3), (1000, 2.6)], None),  # 19231 steps would do
        ([(600, 9), (1000, 10)], None),  # no check at half of the steps or less to compare with
    ],
)
def test_runs_that_more_steps_would_not_help_are_given_up(
    trail: list[tuple[int, float]], words: str | None
) -> None:
    reason = futility(trail, target=50, allowed=20_000, step_limit=20_000)
    if words is None:
        assert reason is None
    else:
        message = finding_sentence(reason)
        assert message.startswith("stopped early: ")
        assert words in message


@run_cases("rho", [0.0, 0.5, 0.9])
def test_the_next_check_is_when_the_chain_is_long_enough(rho: float) -> None:
    tau = (1.0 + rho) / (1.0 - rho)
    steps = math.ceil(BURN_IN_TAUS * tau + 40 * tau)  # not quite the 50 that are wanted
    length = chain_length(ar1((4, steps, 64, 1), rho))
    assert length.n_tau < 50
    ahead = length.next_check(steps, 50)
    assert 1.05 * 55 * tau < ahead < 1.4 * 55 * tau
    assert chain_length(ar1((4, ahead, 64, 1), rho)).n_tau > 50


def test_checks_are_neither_rare_nor_many() -> None:
    """However far there is to go, and also where the length is not what is missing."""
    length = chain_length(ar1((4, 200, 16, 1), 0.5))
    assert length.next_check(200, 1e6) == 300
    assert length.next_check(200, 1.0) == 250


def test_thinning_keeps_time_and_ensembles_apart() -> None:
    chains = np.arange(2 * 10 * 3 * 1, dtype=float).reshape(2, 10, 3, 1)
    draws = thinned(chains, burn_in=4, thin=3)
    assert draws.shape == (2, 6, 1)
    assert list(draws[0, :, 0]) == [12, 13, 14, 21, 22, 23]
    assert list(draws[1, :3, 0]) == [42, 43, 44]


def test_hdi_is_the_narrowest_interval_not_the_one_with_equal_tails() -> None:
    """Of an exponential it begins at zero; arviz-stats before 1.2.1 returned an ETI."""
    assert HDI_PROBABILITY == 0.94
    u = (np.arange(200_000) + 0.5) / 200_000
    low, high = hdi(scipy.stats.expon.ppf(u))
    assert low == pytest.approx(0.0, abs=1e-3)
    assert high == pytest.approx(-np.log(0.06), abs=1e-3)
    gamma = scipy.stats.gamma(3.0)
    low, high = hdi(gamma.ppf(u))
    assert gamma.pdf(low) == pytest.approx(gamma.pdf(high), rel=0.01)
    assert gamma.cdf(high) - gamma.cdf(low) == pytest.approx(0.94, abs=1e-3)


# --- each fault is named with its place, and no other ----------------------------------------------

NAMES = ("k_T", "k_s", "r_m")
LOOSE = Targets(r_hat=1.05, n_tau=50, ess=1000)
FAULTS = {
    "too short": "too short to judge its burn-in",
    "stuck": "stuck",
    "lost": "far from where the posterior is",
    "two places": "sit in two places",
    "tau grows": "still grows with the chain",
    "R-hat": "the ensembles disagree",
}


@dataclass
class Chains:
    """`theta (E, S, W, D)`, `log_p (E, S, W)`: sound until a method spoils them."""

    theta: np.ndarray
    log_p: np.ndarray

    def stuck(self, ensemble: int, walker: int, since: int) -> None:
        """This walker stays where it is at the step `since`."""
        self.theta[ensemble, since:, walker] = self.theta[ensemble, since, walker]
        self.log_p[ensemble, since:, walker] = self.log_p[ensemble, since, walker]


def sound(seed: int, walkers: int = 32, steps: int = 700, rho: float = 0.8) -> Chains:
    """Four ensembles of three unknowns: tau 9 at rho 0.8."""
    theta = ar1((4, steps, walkers, 3), rho, seed)
    return Chains(theta, -0.5 * (theta**2).sum(axis=-1))


def judge(chains: Chains, targets: Targets = LOOSE) -> Convergence:
    return assess(chains.theta, NAMES, targets, log_p=chains.log_p)


def faults(result: Convergence) -> set[str]:
    text = "\n".join(sentences(result))
    return {fault for fault, words in FAULTS.items() if words in text}


def reason(result: Convergence, fault: str) -> str:
    """The only reason, which is this one."""
    assert faults(result) == {fault}
    (text,) = [text for text in sentences(result) if FAULTS[fault] in text]
    return text


@run_cases("seed", range(8))
@run_cases("shape", [np.asarray, np.exp, ndtr], ["normal", "skewed", "flat"])
def test_sound_chains_are_believed(seed: int, shape: np.ufunc) -> None:
    chains = sound(seed)
    chains.theta = shape(chains.theta)
    assert judge(chains).reasons == ()


def test_sound_but_short_chains_are_called_short_and_nothing_else() -> None:
    result = judge(sound(1, steps=60))
    assert "half of the run is 30" in reason(result, "too short")
    assert result.burn_in == 30
    assert result.too_short_for_burn_in


def test_a_stuck_walker_in_the_middle_of_the_posterior_is_named() -> None:
    chains = sound(2, walkers=64)
    chains.theta[2, 300, 17] = [0.1, 0.2, 1.5]
    chains.stuck(2, 17, since=300)
    words = reason(judge(chains), "stuck")
    assert "1 of 256 walkers (1 in ensemble 2) is stuck" in words
    assert "did not move for 399 of " in words
    assert "walker 17 of ensemble 2, at r_m" in words


def test_a_walker_that_rests_for_a_while_is_not_stuck() -> None:
    """An independence move may leave a walker in a tail for several tau."""
    chains = sound(4)
    chains.theta[1, 100:250, 3] = chains.theta[1, 100, 3]
    assert judge(chains).reasons == ()


def test_many_walkers_that_do_not_move_are_counted() -> None:
    chains = sound(5)
    for ensemble in range(4):
        for walker in range(20):
            chains.stuck(ensemble, walker, since=0)
    assert any("80 of 128 walkers did not move" in text for text in sentences(judge(chains)))


def test_a_walker_caught_in_a_lesser_maximum_is_named() -> None:
    chains = sound(6, walkers=64)
    chains.theta[:, :, 9] += 0.8
    chains.log_p[:, :, 9] -= 40.0
    assert "4 of 256 walkers" in reason(judge(chains), "lost")


@run_cases("second", [slice(0, 12), slice(0, 1)], ["12 of 32", "1 of 32"])
def test_two_places_alike_in_all_ensembles_are_named_where_r_hat_is_blind(second: slice) -> None:
    chains = sound(7)
    chains.theta[:, :, second, 1] += 6.0  # as high as the first place
    words = reason(judge(chains), "two places")
    assert "k_s: " in words
    assert "k_T" not in words
    assert ", 0 crossings" in words


def test_two_places_between_which_walkers_cross_are_no_fault() -> None:
    chains = sound(8, steps=1500)
    flips = np.random.default_rng(8).random(chains.theta.shape[:3]) < 0.05
    chains.theta[..., 0] += 6.0 * (np.cumsum(flips, axis=1) % 2)
    assert judge(chains).reasons == ()
    seldom = np.cumsum(np.random.default_rng(9).random((1000, 100)) < 0.004, axis=0) % 2
    noise = np.random.default_rng(10).standard_normal((1000, 100))
    assert find_two_groups(6.0 * seldom + noise) is None
    groups = find_two_groups(20.0 * (np.arange(100) % 4 == 0) + noise)
    low, high, upper_share, crossings = groups
    assert crossings == 0
    assert upper_share == pytest.approx(0.25, abs=0.01)
    assert (low, high) == pytest.approx((0.0, 20.0), abs=0.1)


def test_slow_motion_that_a_window_does_not_see_is_named() -> None:
    chains = sound(9, steps=2000, rho=0.2)
    chains.theta[..., :1] += 0.35 * ar1((4, 2000, 32, 1), 0.9985, seed=10)
    result = judge(chains)
    assert result.n_tau > LOOSE.n_tau
    assert "autocorrelation time of k_T still grows" in reason(result, "tau grows")
