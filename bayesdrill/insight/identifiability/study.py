"""The whole study of one config: structure, bounds, simple products, remedies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import seeds
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import spread_of_log
from bayesdrill.insight.identifiability.frictions import NOTHING, Told, told_apart
from bayesdrill.insight.identifiability.information import (
    Direction,
    Information,
    Product,
    directions,
    from_sensitivities,
    products,
    simple_exponents,
)
from bayesdrill.insight.identifiability.proving import structure_of
from bayesdrill.insight.identifiability.remedies import Remedy, remedies
from bayesdrill.insight.identifiability.resting import Resting, resting
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.identifiability.standing_in import StandIn, scaled, stand_ins
from bayesdrill.insight.identifiability.structure import Exponents, Structure

Array = NDArray[np.float64]
Class = Literal["determined", "weak", "left to the prior"]

ALIKE = 2.0  # times: how much smaller an sd would be, for a nuisance that is named with it


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """Of the ratio of an sd with the record to the prior's, both of logs."""

    determined: float = 0.5
    left_to_prior: float = 0.9

    def judge(self, ratio: float) -> Class:
        if ratio < self.determined:
            return "determined"
        return "weak" if ratio < self.left_to_prior else "left to the prior"


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What is asked of a study: `of_interest` of all unknowns, its words, and its random points."""

    of_interest: tuple[str, ...] = ()
    thresholds: Thresholds = Thresholds()
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """A parameter or a simple product: sd of its log with record and prior, and before.

    `bound`: Cramer-Rao, from the record alone; inf if the record does not determine it.
    """

    exponents: Exponents
    sd: float
    prior_sd: float
    bound: float
    word: Class


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisance:
    """A number of a sensor or a start, SI: sd with record and priors, and before.  `like`: unknowns of
    the rig that it can hardly be told from, each with the factor by which its sd would fall if this
    one were known.
    """

    name: str
    sd: float
    prior_sd: float
    word: Class
    like: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """At a physical point, which `at` names.

    `information` is that of the record alone, `directions` its sloppy spectrum.  `stand_ins`:
    parameters that a missing torque can stand in for; `scaled`: names that can be multiplied
    together, its size among them.  `resting`: scales that numbers which are held settle.
    """

    names: tuple[str, ...]
    at: str
    of_interest: tuple[str, ...]
    structure: Structure
    parameters: tuple[Known, ...]
    products: tuple[Known, ...]
    information: Information
    remedies: tuple[Remedy, ...]
    nuisances: tuple[Nuisance, ...] = ()
    frictions: Told = NOTHING
    stand_ins: tuple[StandIn, ...] = ()
    scaled: tuple[tuple[str, ...], ...] = ()
    resting: tuple[Resting, ...] = ()

    @property
    def directions(self) -> tuple[Direction, ...]:
        return directions(self.information)


def study(
    scenery: Scenery,
    posterior: Posterior,
    theta: Array,
    of_interest: Sequence[str],
    thresholds: Thresholds,
    rng: np.random.Generator,
    at: str = "the start",
) -> Study:
    """At `theta (D,)`; `rng` draws the points at which the structure is looked at."""
    names = scenery.unknowns
    found = structure_of(posterior, scenery, theta, rng)
    known = from_sensitivities(names, scenery.sensitivities(theta))
    prior_sd = prior_spreads(posterior)[: len(names)]
    simple = products(known, prior_sd, simple_exponents(len(names)))
    return Study(
        names=names,
        at=at,
        of_interest=tuple(of_interest) or names,
        structure=found,
        parameters=_parameters(known, prior_sd, thresholds),
        products=tuple(_known(p, thresholds) for p in simple),
        information=known,
        remedies=remedies(scenery, theta, found.symmetries, prior_sd, of_interest or names),
        nuisances=_nuisances(scenery, posterior, theta, thresholds),
        frictions=told_apart(scenery, posterior, theta),
        stand_ins=stand_ins(posterior, theta, prior_spreads(posterior), rng),
        resting=resting(posterior, theta, known, prior_sd, rng),
        scaled=scaled(posterior, found.symmetries),
    )


def _nuisances(
    scenery: Scenery, posterior: Posterior, theta: Array, thresholds: Thresholds
) -> tuple[Nuisance, ...]:
    rows = scenery.every(theta)
    if not scenery.nuisances or not np.isfinite(rows).all():
        return ()
    joint = from_sensitivities((*scenery.unknowns, *scenery.nuisances), rows)
    inverse = np.linalg.inv(joint.with_priors(scenery.prior_spreads).root)
    covariance = inverse @ inverse.T
    sds = np.sqrt(np.diag(covariance))
    alike = covariance / np.outer(sds, sds)
    steps = posterior.coordinates.natural(theta[None])[0]
    found = []
    for k, name in enumerate(scenery.nuisances, start=len(scenery.unknowns)):
        falls = {
            other: 1.0 / np.sqrt(max(1.0 - alike[k, j] ** 2, 1e-12))
            for j, other in enumerate(scenery.unknowns)
        }
        like = sorted(falls.items(), key=lambda one: -one[1])
        before = scenery.prior_spreads[k]
        found.append(
            Nuisance(
                name=name,
                sd=float(sds[k] * steps[k]),
                prior_sd=float(before * steps[k]),
                word=thresholds.judge(float(sds[k] / before)),
                like=tuple((other, float(x)) for other, x in like if x > ALIKE),
            )
        )
    return tuple(found)


def study_of(
    scenery: Scenery,
    posterior: Posterior,
    theta: Array,
    asked: Asked,
    at: str = "the start",
) -> Study:
    """As it is asked for."""
    rng = seeds.stream(asked.seed, "identify")
    return study(scenery, posterior, theta, asked.of_interest, asked.thresholds, rng, at)


def prior_spreads(posterior: Posterior) -> Array:
    """Standard deviations of the logs under the priors `(D,)`."""
    return np.array([spread_of_log(prior) for prior in posterior.space.priors.values()])


def _parameters(known: Information, prior_sd: Array, thresholds: Thresholds) -> tuple[Known, ...]:
    joint, alone = known.with_priors(prior_sd).bounds(), known.bounds()
    units = np.eye(len(prior_sd), dtype=int)
    return tuple(
        Known(
            exponents=tuple(int(x) for x in unit),
            sd=float(sd),
            prior_sd=float(before),
            bound=float(bound),
            word=thresholds.judge(sd / before),
        )
        for unit, sd, before, bound in zip(units, joint, prior_sd, alone, strict=True)
    )


def _known(product: Product, thresholds: Thresholds) -> Known:
    return Known(
        exponents=product.exponents,
        sd=product.sd,
        prior_sd=product.prior_sd,
        bound=product.bound,
        word=thresholds.judge(product.sd / product.prior_sd),
    )
