"""The evidence, beside integrals that are known, and odds beside the ratio of Savage and Dickey."""

from __future__ import annotations

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
        return self.target.inside(z)

    def integral(self, d: int) -> float:
        """The log of that of its density, which is not normalised."""
        one, scales = self.target, float(np.log(self.target.scales[:d]).sum())
        if isinstance(one, Skewed):
            return scales + d * math.lgamma(1.5)
        if isinstance(one, Boxed):
            return scales + d * math.log(math.expm1(one.rate) / one.rate)
        if isinstance(one, TwoModes):
            return scales + 0.5 * d * math.log(2 * math.pi)
        assert isinstance(one, Bent)
        n = count_loose(d)
        below, above = scipy.special.gammainc(one.shape, np.exp(np.clip(one.ends, -700, 700)))
        along = n * (math.lgamma(one.shape) + math.log(above - below))
        across = 0.5 * math.log(2 * math.pi) + scipy.stats.norm.logsf(one.least)
        return scales + along + (d - n) * float(across)


def found(target: Target, d: int, proposal: Proposal, seed: int = 1) -> Evidence:
    """From draws that no walker has made."""
    rng = np.random.default_rng(100 + seed)
    z = target.draw(2 * STEPS * WALKERS, d, rng).reshape(2, STEPS, WALKERS, d)
    log_p = target.log_density(z.reshape(-1, d)).reshape(z.shape[:-1])
    result = evidence(Known(target), proposal, z, log_p, seed)  # type: ignore[arg-type]
    assert result is not None
    return result


def test_walkers_that_do_not_pass_between_humps_are_in_the_error() -> None:
    """All of them on the heavier hump.  Mutant killed: an error of what walkers themselves have seen."""
    target = TARGETS["two_modes"]
    assert isinstance(target, TwoModes)
    z = target.draw(STEPS * WALKERS, 2, np.random.default_rng(5))
    for side in (z[:, 0] > z[:, 0].mean(), z[:, 0] <= z[:, 0].mean()):
        own = np.resize(z[side], (2, STEPS, WALKERS, 2))
        log_p = target.log_density(own.reshape(-1, 2)).reshape(own.shape[:-1])
        proposal = rough(target, 2, 2)
        result = evidence(Known(target), proposal, own, log_p, 1)  # type: ignore[arg-type]
        assert result is not None
        assert abs(result.log_z - Known(target).integral(2)) < 1.5 * result.error


@run_cases("d, name", [(d, name) for d in [2, 5, 9] for name in TARGETS])
def test_it_is_the_integral_of_the_density(d: int, name: str) -> None:
    """Over two bent ridges in units of their own, with priors that cut draws off, and humps.

    Mutants killed: the volume of a basis forgotten, the share of draws inside the prior for all of
    them, shares of the two kinds of draws that do not sum to one.
    """
    target = TARGETS[name]
    result = found(target, d, rough(target, d, 2))
    assert result.error < 0.1
    assert abs(result.log_z - Known(target).integral(d)) < SURE * result.error


def test_the_standard_error_is_that_of_repetitions() -> None:
    """Mutants killed: an error of one kind of draws alone; walkers' steps taken for independent."""
    target = TARGETS["mild"]
    exact, every = Known(target).integral(5), range(40)
    some = [found(target, 5, rough(target, 5), seed) for seed in every]
    off = np.array([(one.log_z - exact) / one.error for one in some])
    assert 0.75 < np.sqrt(np.mean(off**2)) < 1.3
    # Walkers that hardly move know less than as many that do.
    z = target.draw(WALKERS, 5, np.random.default_rng(3))
    still = np.repeat(z[None, None], 50, axis=1)
    log_p = target.log_density(z)[None, None].repeat(50, axis=1)
    proposal = rough(target, 5)
    told = evidence(Known(target), proposal, still, log_p, 1)  # type: ignore[arg-type]
    once = evidence(Known(target), proposal, still[:, :1], log_p[:, :1], 1)  # type: ignore[arg-type]
    assert told is not None
    assert once is not None
    assert told.error > 0.4 * once.error


def test_a_proposal_far_below_the_chain_has_a_large_error_and_ends_nothing() -> None:
    """Weights of 1e-200 and less, whose squares are no numbers: a record that no rig fits at all."""
    result = bridge(np.zeros((2, 5, 40)), np.full(100, -600.0), 120)
    assert result is not None
    assert result.error > 100.0


def test_nothing_in_common_is_no_evidence() -> None:
    target = TARGETS["boxed"]
    own = rough(target, 2)
    far = replace(own, mixture=replace(own.mixture, means=own.mixture.means + 1e3))
    z = target.draw(40, 2, np.random.default_rng(1)).reshape(2, 1, 20, 2)
    log_p = np.zeros((2, 1, 20))
    assert evidence(Known(target), far, z, log_p, 1) is None  # type: ignore[arg-type]


T = np.linspace(0.0, 4.0, 81)
SIGMA, OFFSET_SD = 0.05, 0.2
BOX = {"prior": "uniform", "low": 0.7, "high": 1.4, "relative": True}
OFFSET = {"prior": "normal", "mean": 0.0, "sd": OFFSET_SD}
RIG = bd.MotorShaft(i_m=0.125)


def signal(**changes: float) -> np.ndarray:
    return bd.respond(RIG, {**NOMINAL, **changes}, T, {"v": 8.0}, ["w_1"])["w_1"]


def measured() -> np.ndarray:
    return signal() + 0.02 + SIGMA * np.random.default_rng(4).standard_normal(len(T))


def case(parameters: dict[str, object], *, offset: bool, sigma: object = SIGMA) -> bd.Case:
    """A speed of the rig, whose sensor may be off."""
    own = {"offset": OFFSET} if offset else {}
    channel = bd.Channel(measured(), "rad/s", sigma, **own)  # type: ignore[arg-type]
    return bd.case(
        T,
        channels={"w_1": channel},
        inputs={"v": 8.0},
        parameters=dict.fromkeys(NOMINAL, "nominal") | parameters,
        rig=RIG,
        nominal="tables_2_3",
        seed=3,
        sampler={"walkers": 64, "ess": 2000},
    )


def test_an_offset_of_a_sensor_alone_is_a_normal_density_of_the_record() -> None:
    """All of a config's densities in one number: likelihood, priors and Jacobians, in SI."""
    run = case({}, offset=True).sample()
    assert run.evidence is not None
    covariance = SIGMA**2 * np.eye(len(T)) + OFFSET_SD**2
    exact = scipy.stats.multivariate_normal(signal(), covariance).logpdf(measured())
    assert abs(run.evidence.log_z - exact) < SURE * run.evidence.error < 0.05
