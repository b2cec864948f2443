"""Rigs that rub, fitted as rigs that do not and lack a torque: how often the truth is held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from bayesdrill.analysis.latent_torque import regress_torque, torque_estimates
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.simulators.stepped import Stepped
from benchmarks.rates.records import FREE, FRICTION, PIECES, TORQUE, observed, of, weighed

Array = NDArray[np.float64]

RECORDS, INSIDE = 100, 0.9
BY_CHANCE = 1e-3  # that right intervals would hold fewer, all parameters together
SHOWN, MOVING = 200, 1.0  # draws of the torque; rad/s


@cache
def both() -> tuple[Posterior, Posterior]:
    """Of the rig that rubs, in fine steps, and of one that lacks a torque."""
    rubs = observed(rubs={"t_c1": FRICTION})
    one = rubs.likelihood.observations[0]
    assert isinstance(one.response, Stepped)
    return of(rubs, replace(one, response=one.response.with_substeps(PIECES))), observed(
        missing_torque=TORQUE
    )


@dataclass(frozen=True)
class Told:
    """Of one record: how much of each parameter's posterior lies below its truth; the law that is named;
    its size, and that of the torque where the rotor turns, over the friction; how much of the law is
    within the band there.
    """

    below: dict[str, float]
    law: tuple[str, str]
    size: float
    turning: float
    within: float


@cache
def told(seed: int) -> Told:
    rubs, lacks = both()
    rng = np.random.default_rng([23, seed])
    one = rubs.likelihood.observations[0]
    theta = rubs.space.draw(1, rng)
    y = one.draw(one.signals(rubs.space.full(theta)), theta, rng)[0]
    target = of(lacks, lacks.likelihood.observations[0].with_record(y))
    truth = dict(zip(rubs.space.free, theta[0], strict=True))
    friction = float(truth.pop("t_c1"))
    start = target.space.vector({**truth, "s_d": friction, "tau_d": 0.3})
    true = target.coordinates.from_physical(start[None])
    u, weights = weighed(target, true, seed)
    below = dict(zip(target.space.free, weights @ (u < true), strict=True))
    ratio = [target.space.free.index(name) for name in ("k_s", "j_1")]
    both_logs = u[:, ratio] @ [1, -1] < true[:, ratio] @ [1, -1]
    below["k_s/j_1"] = float(weights @ both_logs)
    physical = target.coordinates.to_physical(u[rng.choice(len(u), SHOWN, p=weights)])
    (found,) = torque_estimates(target, physical, rng)
    _, speed = found.speeds[0]
    turns, law = np.abs(speed) > MOVING, -friction * np.sign(speed)
    low, high = found.band
    first = regress_torque(found)[0]
    return Told(
        below={name: float(below[name]) for name in (*FREE, "k_s/j_1")},
        law=(first.kind, first.of),
        size=-first.size / friction,
        turning=float((found.expected[turns] / law[turns]).mean()),
        within=float(((low < law) & (law < high))[turns].mean()),
    )


def held(every: Sequence[Told]) -> dict[str, int]:
    """In how many records each interval holds the truth."""
    names = every[0].below
    return {n: sum(abs(one.below[n] - 0.5) < 0.5 * INSIDE for one in every) for n in names}


def named(every: Sequence[Told]) -> int:
    """In how many records dry friction at rotor 1 is, to 15 % of its size."""
    return sum(one.law == ("sign", "w_1") and abs(one.size - 1.0) < 0.15 for one in every)


def check() -> None:
    """Intervals may hold more: a Gaussian process allows for far more than friction."""
    every = [told(seed) for seed in range(RECORDS)]
    found = held(every)
    sizes, turning, within = (
        np.quantile([getattr(one, what) for one in every], [0.0, 0.5, 1.0]).round(3)
        for what in ("size", "turning", "within")
    )
    print(f"held by {INSIDE:.0%} of {RECORDS}: {found}; named {named(every)}")
    print(f"size over friction {sizes}, where it turns {turning}; law within the band {within}")
    low = binom.ppf(BY_CHANCE / len(found), RECORDS, INSIDE)
    assert {name: n for name, n in found.items() if n < low} == {}
    assert named(every) >= 0.95 * RECORDS
    assert within[0] > 0.85
