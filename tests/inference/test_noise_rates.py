"""Records whose noise remembers, fitted as if it did not, and as it is: how often the truth is held.

Mutants killed: a likelihood that takes neighbours for independent, information without what they share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import experiment, likelihood_of, unknown
from scipy.stats import binom, multivariate_t

from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import LogUniform, Uniform
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.rig.models.motor_shaft import PARAMETERS, MotorShaft
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.sampling.gauss_newton import gauss_newton

FREE = ("k_e", "k_s", "j_1")
SIGMA = (0.1, 0.1)
RHO, RECORDS, INSIDE = 0.95, 200, 0.94
DRAWS, TAILS = 4000, 5  # of a proposal with heavier tails than the posterior
BY_CHANCE = 1e-3  # that right intervals would leave the band, all unknowns together


@dataclass(frozen=True)
class Bench:
    """Twenty seconds of two speeds at 100 Hz, under 8 V either way."""

    rig: Response
    clean: np.ndarray

    @classmethod
    def made(cls) -> Bench:
        speeds = {name: {name: 1.0} for name in ("w_1", "w_2")}
        v = 8.0 * np.sign(np.sin(0.7 * np.arange(2001) * 0.01 + 0.1))
        one = experiment(2001, measures=speeds, constant={"t_1": 0.0}, series={"v": v})
        rig = Response(MotorShaft(), one)
        return cls(rig, rig.signals(np.array([[NOMINAL[p] for p in PARAMETERS]]))[0])

    def posterior(self, kind: str, y: np.ndarray) -> Posterior:
        channels = [
            NoisyChannel(channel=channel, sigma=LogUniform(0.01, 10.0), start=sigma)
            for channel, sigma in zip(self.rig.experiment.channels, SIGMA, strict=True)
        ]
        noise = NOISES[kind].from_channels(channels, len(y))
        own = [unknown(p, Uniform(0.2 * NOMINAL[p], 3.0 * NOMINAL[p])) for p in FREE]
        space = ParameterSpace(
            model=PARAMETERS,
            unknowns=(*own, *noise.unknowns),
            fixed={p: NOMINAL[p] for p in PARAMETERS if p not in FREE},
        )
        likelihood = likelihood_of(space, (self.rig.with_record(y), noise))
        return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)

    def record(self, seed: int) -> np.ndarray:
        """By its own recurrence, no noise of the house."""
        fresh = np.random.default_rng(seed).standard_normal(self.clean.shape)
        noise = fresh[0]
        out = [self.clean[0] + SIGMA * noise]
        for row, clean in zip(fresh[1:], self.clean[1:], strict=True):
            noise = RHO * noise + np.sqrt(1.0 - RHO**2) * row
            out.append(clean + SIGMA * noise)
        return np.array(out)

    def below(self, kind: str, seed: int) -> dict[str, float]:
        """How much of the posterior lies below the truth, by weighed draws about its maximum."""
        target = self.posterior(kind, self.record(seed))
        truth = {**NOMINAL, "rho_w_1": RHO, "rho_w_2": RHO}
        truth |= dict(zip(("sigma_w_1", "sigma_w_2"), SIGMA, strict=True))
        true = target.coordinates.from_physical(target.space.vector(truth)[None])
        surface = LogDensity(target)
        found = gauss_newton(surface, true, 60)
        best = target.coordinates.to_physical(found.u)[0]
        covariance = laplace.covariance(target, best)
        proposal = multivariate_t(found.u[0], 1.3 * covariance, df=TAILS, seed=seed)
        draws = proposal.rvs(DRAWS)
        logs = target(draws) - proposal.logpdf(draws)
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        assert 1.0 / (weights @ weights) > 0.05 * DRAWS
        return dict(zip(target.space.free, weights @ (draws < true), strict=True))


def held(kind: str, records: int) -> dict[str, int]:
    """In how many records each interval holds the truth."""
    bench, counts = Bench.made(), dict[str, int]()
    for seed in range(records):
        for name, below in bench.below(kind, seed).items():
            counts[name] = counts.get(name, 0) + int(abs(below - 0.5) < 0.5 * INSIDE)
    return counts


@pytest.mark.slow
def test_noise_that_remembers_is_to_be_told_of() -> None:
    white, told = held("white", RECORDS), held("ar1", RECORDS)
    assert all(white[name] < 0.55 * RECORDS for name in FREE)
    tail = BY_CHANCE / len(told) / 2
    low, high = binom.ppf([tail, 1 - tail], RECORDS, INSIDE)
    assert {name: n for name, n in told.items() if not low <= n <= high} == {}


def test_a_few_records_tell_it_already() -> None:
    white, told = held("white", 12), held("ar1", 12)
    assert sum(white[name] for name in FREE) < 0.6 * 12 * len(FREE)
    assert sum(told[name] for name in FREE) > 0.8 * 12 * len(FREE)
