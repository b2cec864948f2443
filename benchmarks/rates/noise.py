"""Records whose noise remembers, fitted as if it did not, and as it is: how often the truth is held."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, multivariate_t

import bayesdrill as bd
from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.gauss_newton import gauss_newton

Array = NDArray[np.float64]

FREE = ("k_e", "k_s", "j_1")
SPEEDS = ("w_1", "w_2")
SIGMA = np.array([0.1, 0.1])
RHO, RECORDS, INSIDE = 0.95, 200, 0.94
DRAWS, TAILS = 4000, 5  # of a proposal with heavier tails than the posterior
BY_CHANCE = 1e-3  # that right intervals would leave the band, all unknowns together
T = 0.01 * np.arange(2001)
VOLTAGE = 8.0 * np.sign(np.sin(0.7 * T + 0.1))


@cache
def clean() -> Array:
    """Twenty seconds of two speeds at 100 Hz, under 8 V either way."""
    shown = bd.respond("motor_shaft", bd.nominal(), T, {"v": VOLTAGE}, [*SPEEDS])
    return np.stack([shown[name] for name in SPEEDS], axis=-1)


@cache
def posterior(kind: str) -> Posterior:
    """Of the record without noise."""
    sigma = {"prior": "log_uniform", "low": 0.01, "high": 10.0}
    box = {"prior": "uniform", "low": 0.2, "high": 3.0, "relative": True}
    columns = dict(zip(SPEEDS, clean().T, strict=True))
    case = bd.case(
        T,
        {name: bd.Channel(y, "rad/s", sigma, noise=kind) for name, y in columns.items()},
        {"v": bd.Input(VOLTAGE, "V")},
        dict.fromkeys(bd.nominal(), "nominal") | dict.fromkeys(FREE, box),
        nominal="tables_2_3",
    )
    return case.job.problem.posterior


def record(seed: int) -> Array:
    """By its own recurrence, no noise of the house."""
    fresh = np.random.default_rng(seed).standard_normal(clean().shape)
    noise = fresh[0]
    out = [clean()[0] + SIGMA * noise]
    for row, signal in zip(fresh[1:], clean()[1:], strict=True):
        noise = RHO * noise + np.sqrt(1.0 - RHO**2) * row
        out.append(signal + SIGMA * noise)
    return np.array(out)


def below(kind: str, seed: int) -> dict[str, float]:
    """How much of the posterior lies below the truth, by weighed draws about its maximum."""
    target = posterior(kind).edit(records=[record(seed)])
    truth = {**bd.nominal(), "rho_w_1": RHO, "rho_w_2": RHO}
    truth |= dict(zip(("sigma_w_1", "sigma_w_2"), SIGMA.tolist(), strict=True))
    true = target.coordinates.from_physical(target.space.vector(truth)[None])
    found = gauss_newton(LogDensity(target), true, 60)
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
    counts = dict[str, int]()
    for seed in range(records):
        for name, share in below(kind, seed).items():
            counts[name] = counts.get(name, 0) + int(abs(share - 0.5) < 0.5 * INSIDE)
    return counts


def check() -> None:
    """Noise that remembers is to be told of."""
    white, told = held("white", RECORDS), held("ar1", RECORDS)
    print(f"held by {INSIDE:.0%} of {RECORDS}: as white {white}; as it is {told}")
    assert all(white[name] < 0.55 * RECORDS for name in FREE)
    tail = BY_CHANCE / len(told) / 2
    low, high = binom.ppf([tail, 1 - tail], RECORDS, INSIDE)
    assert {name: n for name, n in told.items() if not low <= n <= high} == {}
