"""The evidence beside integrals that are known, and its standard error beside repetitions."""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
import scipy.stats
from support.case_tables import run_cases
from support.handmade_proposals import rough
from support.known_targets import TARGETS, Bent, Boxed, Skewed, Target, TwoModes, count_loose
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.sampling.evidence import Evidence, bridge, evidence
from bayesdrill.sampling.samplers.independence import Proposal

WALKERS, STEPS = 400, 10
SURE = 4.0  # standard errors


@dataclass(frozen=True)
class Known:
    """A target in the place of a posterior."""

    target: Target

    def __call__(self, z: np.ndarray) -> np.ndarray:
        return self.target.log_density(z)

    def supports(self, z: np.ndarray) -> np.ndarray:
        return self.target.in_support(z)


def log_integral(target: Target, d: int) -> float:
    """Of its density, which is not normalised."""
    scales = float(np.log(target.scales[:d]).sum())
    if isinstance(target, Skewed):
        return scales + d * math.lgamma(1.5)
    if isinstance(target, Boxed):
        return scales + d * math.log(math.expm1(target.rate) / target.rate)
    if isinstance(target, TwoModes):
        return scales + 0.5 * d * math.log(2 * math.pi)
    assert isinstance(target, Bent)
    n = count_loose(d)
    below, above = scipy.special.gammainc(target.shape, np.exp(np.clip(target.ends, -700, 700)))
    along = n * (math.lgamma(target.shape) + math.log(above - below))
    across = 0.5 * math.log(2 * math.pi) + scipy.stats.norm.logsf(target.least)
    return scales + along + (d - n) * float(across)


def estimate(target: Target, proposal: Proposal, z: np.ndarray, seed: int = 1) -> Evidence:
    """From draws `(E, S, W, D)` that no walker has made."""
    log_p = target.log_density(z.reshape(-1, z.shape[-1])).reshape(z.shape[:-1])
    return evidence(Known(target), proposal, z, log_p, seed)


def independent_draws(target: Target, d: int, seed: int = 1) -> np.ndarray:
    z = target.draw(2 * STEPS * WALKERS, d, np.random.default_rng(100 + seed))
    return z.reshape(2, STEPS, WALKERS, d)


def test_walkers_that_do_not_pass_between_humps_are_in_the_error() -> None:
    """All of them are on one hump."""
    target = TARGETS["two_modes"]
    z = target.draw(STEPS * WALKERS, 2, np.random.default_rng(5))
    for side in (z[:, 0] > z[:, 0].mean(), z[:, 0] <= z[:, 0].mean()):
        draws = np.resize(z[side], (2, STEPS, WALKERS, 2))
        result = estimate(target, rough(target, 2, 2), draws)
        assert abs(result.log_z - log_integral(target, 2)) < 1.5 * result.error


@run_cases("d", [2, 5, 9])
@run_cases("name", TARGETS)
def test_it_is_the_integral_of_the_density(d: int, name: str) -> None:
    """Over two bent ridges in units of their own, with priors that cut draws off, and humps."""
    target = TARGETS[name]
    result = estimate(target, rough(target, d, 2), independent_draws(target, d))
    assert result.error < 0.1
    assert abs(result.log_z - log_integral(target, d)) < SURE * result.error


def test_the_standard_error_is_that_of_repetitions() -> None:
    target = TARGETS["mild"]
    proposal = rough(target, 5)
    runs = [
        estimate(target, proposal, independent_draws(target, 5, seed), seed) for seed in range(40)
    ]
    off = np.array([(run.log_z - log_integral(target, 5)) / run.error for run in runs])
    assert 0.75 < np.sqrt(np.mean(off**2)) < 1.3


def test_walkers_that_hardly_move_know_no_more_than_their_first_draws() -> None:
    target = TARGETS["mild"]
    proposal = rough(target, 5)
    z = target.draw(WALKERS, 5, np.random.default_rng(3))[None, None]
    still = estimate(target, proposal, z.repeat(50, axis=1))
    assert still.error > 0.4 * estimate(target, proposal, z).error


def test_a_proposal_far_below_the_chain_has_a_large_error_and_ends_nothing() -> None:
    """Weights of 1e-200 and less, whose squares are no numbers: a record that no rig fits at all."""
    result = bridge(np.zeros((2, 5, 40)), np.full(100, -600.0), 120)
    assert result.error > 100.0


def test_walkers_at_far_apart_densities_have_a_finite_error() -> None:
    """The values of log p/q of walkers differ by thousands if a record contradicts its priors."""
    on_chain = np.linspace(-2000.0, 2000.0, 240).reshape(2, 20, 6)
    found = bridge(on_chain, np.linspace(-3000.0, -2000.0, 100), 100)
    assert math.isfinite(found.log_z)
    assert math.isfinite(found.error)


def test_a_proposal_without_overlap_gives_no_evidence() -> None:
    target = TARGETS["boxed"]
    near = rough(target, 2)
    far = replace(near, mixture=replace(near.mixture, means=near.mixture.means + 1e3))
    z = target.draw(40, 2, np.random.default_rng(1)).reshape(2, 1, 20, 2)
    log_p = np.zeros((2, 1, 20))
    assert evidence(Known(target), far, z, log_p, 1) is None


def test_the_evidence_of_an_offset_alone_is_a_normal_density_of_the_record() -> None:
    """All of a config's densities in one number: likelihood, priors and Jacobians, in SI."""
    t, sigma, offset_sd, rig = np.linspace(0.0, 4.0, 81), 0.05, 0.2, bd.MotorShaft(i_m=0.125)
    signal = bd.respond(rig, NOMINAL, t, {"v": 8.0}, ["w_1"])["w_1"]
    y = signal + 0.02 + sigma * np.random.default_rng(4).standard_normal(len(t))
    offset = {"prior": "normal", "mean": 0.0, "sd": offset_sd}
    run = bd.case(
        t,
        channels={"w_1": bd.Channel(y, "rad/s", sigma, offset=offset)},
        inputs={"v": 8.0},
        parameters=dict.fromkeys(NOMINAL, "nominal"),
        rig=rig,
        nominal="tables_2_3",
        seed=3,
        sampler={"walkers": 64, "ess": 2000},
    ).sample()
    covariance = sigma**2 * np.eye(len(t)) + offset_sd**2
    exact = scipy.stats.multivariate_normal(signal, covariance).logpdf(y)
    assert abs(run.evidence.log_z - exact) < SURE * run.evidence.error < 0.05
