"""Each trouble is found, named with its place, and alone; sound chains are left in peace."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from support import known_chains
from support.case_tables import run_cases
from support.known_chains import Chains, sound

from bayesdrill.basics import seeds
from bayesdrill.sampling.convergence import Convergence, Targets, assess, find_two_groups
from bayesdrill.sampling.samplers.ensemble import State, advance

NAMES = ("k_T", "k_s", "r_m")
TARGETS = Targets(r_hat=1.05, n_tau=50, ess=1000)
KINDS = {
    "too short": "too short to judge its burn-in",
    "stuck": "stuck",
    "lost": "far from where the posterior is",
    "two places": "sit in two places",
    "tau grows": "still grows with the chain",
    "R-hat": "the ensembles disagree",
}


def judge(spoilt: Chains, targets: Targets = TARGETS) -> Convergence:
    return assess(spoilt.theta, NAMES, targets, log_p=spoilt.log_p)


def kinds(found: Convergence) -> set[str]:
    text = "\n".join(found.reasons)
    return {kind for kind, words in KINDS.items() if words in text}


def reason(found: Convergence, kind: str) -> str:
    (text,) = [r for r in found.reasons if KINDS[kind] in r]
    return text


@run_cases(
    "seed, shape", [(seed, shape) for seed in range(8) for shape in ["normal", "skewed", "flat"]]
)
def test_sound_chains_are_believed(seed: int, shape: str) -> None:
    fine = sound(seed)
    change = {"normal": lambda x: x, "skewed": np.exp, "flat": ndtr}[shape]
    fine.theta = change(fine.theta)
    assert judge(fine).reasons == ()


def test_sound_but_short_chains_are_called_short_and_nothing_else() -> None:
    found = judge(sound(1, steps=60))
    assert kinds(found) == {"too short"}
    assert found.burn_in == 30
    assert "half of the run is 30" in reason(found, "too short")
    assert "half of the run, too short" in found.burn_in_rule


def test_one_stuck_walker_in_the_middle_of_the_posterior_is_found() -> None:
    """Mutant killed: a walker may stand still for all of the chain."""
    spoilt = sound(2, walkers=64)
    spoilt.theta[2, 300, 17] = [0.1, 0.2, 1.5]
    spoilt.stuck(2, 17, since=300)
    found = judge(spoilt)
    assert kinds(found) == {"stuck"}
    assert "1 of 256 walkers (1 in ensemble 2) is stuck" in found.reasons[0]
    assert "did not move for 399 of " in found.reasons[0]
    assert "walker 17 of ensemble 2, at r_m" in found.reasons[0]


def test_one_stuck_walker_in_every_ensemble_is_found_where_r_hat_is_blind() -> None:
    spoilt = sound(3, walkers=64)
    for ensemble in range(4):
        spoilt.theta[ensemble, 0, 5] = [1.0, -0.5, 0.3]
        spoilt.stuck(ensemble, 5, since=0)
    found = judge(spoilt)
    assert kinds(found) == {"stuck"}
    assert "4 of 256 walkers (1 in ensemble 0, 1 in ensemble 1" in reason(found, "stuck")


def test_a_walker_that_rests_for_a_while_is_not_stuck() -> None:
    """An independence move may leave a walker in a tail for several tau."""
    fine = sound(4)
    fine.theta[1, 100:250, 3] = fine.theta[1, 100, 3]
    assert judge(fine).reasons == ()


def test_walkers_that_none_of_them_move_are_said_to_be_many() -> None:
    spoilt = sound(5)
    for ensemble in range(4):
        for walker in range(20):
            spoilt.stuck(ensemble, walker, since=0)
    found = judge(spoilt)
    assert any("80 of 128 walkers did not move" in text for text in found.reasons)


def test_a_walker_caught_in_a_lesser_maximum_is_found() -> None:
    """Mutant killed: walkers far below the rest pass."""
    spoilt = sound(6, walkers=64)
    for ensemble in range(4):
        spoilt.lost(ensemble, 9, far=0.8, below=40.0)
    found = judge(spoilt)
    assert kinds(found) == {"lost"}
    assert "4 of 256 walkers" in reason(found, "lost")


@run_cases("second", [slice(0, 12), slice(0, 1)], ["12 of 32", "1 of 32"])
def test_two_places_alike_in_all_ensembles_are_found_where_r_hat_is_blind(second: slice) -> None:
    """Mutant killed: walkers that never cross pass."""
    spoilt = sound(7)
    for ensemble in range(4):
        spoilt.parted(ensemble, second, 1, far=6.0)
    found = judge(spoilt)
    assert kinds(found) == {"two places"}
    text = reason(found, "two places")
    assert "k_s: " in text
    assert "k_T" not in text
    assert ", 0 crossings" in text


def test_two_places_between_which_walkers_cross_are_no_trouble() -> None:
    """Mutant killed: crossings are not counted."""
    fine = sound(8, steps=1500)
    flips = np.random.default_rng(8).random(fine.theta.shape[:3]) < 0.05
    fine.theta[..., 0] += 6.0 * (np.cumsum(flips, axis=1) % 2)
    assert judge(fine).reasons == ()
    seldom = np.cumsum(np.random.default_rng(9).random((1000, 100)) < 0.004, axis=0) % 2
    noise = np.random.default_rng(10).standard_normal((1000, 100))
    assert find_two_groups(6.0 * seldom + noise) is None
    never = find_two_groups(20.0 * (np.arange(100) % 4 == 0) + noise)
    assert never is not None
    assert never.crossings == 0
    assert never.share == pytest.approx(0.25, abs=0.01)
    assert (never.low, never.high) == pytest.approx((0.0, 20.0), abs=0.1)


def test_slow_motion_that_a_window_does_not_see_is_found() -> None:
    """Mutant killed: tau is never seen to grow."""
    spoilt = sound(9, steps=2000, rho=0.2)
    slow = known_chains.ar1((4, 2000, 32, 1), 0.9985, seed=10)
    spoilt.theta[..., :1] += 0.35 * slow
    found = judge(spoilt)
    assert found.n_tau > TARGETS.n_tau
    assert kinds(found) == {"tau grows"}
    assert "autocorrelation time of k_T still grows" in found.reasons[0]


def two_humps(z: np.ndarray) -> tuple[np.ndarray, int]:
    """Equal normal densities 2000 standard deviations apart, and a needle at (0, 9, 0)."""
    humps = np.logaddexp(
        -0.5 * (z**2).sum(axis=-1), -0.5 * ((z - [2000.0, 0.0, 0.0]) ** 2).sum(axis=-1)
    )
    needle = 60.0 - 0.5e12 * ((z - [0.0, 9.0, 0.0]) ** 2).sum(axis=-1)
    return np.logaddexp(humps, needle), 0


def sampled(start: np.ndarray, steps: int = 700) -> Chains:
    """Four real ensembles from the same start `(W, 3)`."""
    moves = {"differential_evolution": 0.7, "stretch": 0.3}
    found = []
    for ensemble in range(4):
        rng = np.random.default_rng(ensemble)
        z = start + np.where(start[:, 1:2] == 9.0, 1e-9, 0.5) * rng.standard_normal(start.shape)
        state = State(z, two_humps(z)[0], seeds.legacy_state(1, "walk", ensemble))
        found.append(advance(two_humps, state, steps, moves))
    return Chains(np.array([p.z for p in found]), np.array([p.log_p for p in found]))


@run_cases(
    "walkers, kind", [((0.0, 0.0), None), ((2000.0, 0.0), "two places"), ((0.0, 9.0), "stuck")]
)
def test_real_ensembles(walkers: tuple[float, float], kind: str | None) -> None:
    """All on one hump; two of sixteen on the other, one on the needle: alike in every ensemble."""
    start = np.zeros((16, 3))
    start[: 1 if kind == "stuck" else 2, :2] = walkers
    found = judge(sampled(start), Targets(r_hat=1.1, n_tau=10, ess=200))
    assert kinds(found) == ({kind} if kind else set())
