"""The whole study of one config: structure, bounds, simple products, and remedies tried by
computing.

An action that would help is another scene (a channel more, another course of the inputs), or knowledge
from elsewhere (weighing a part, a tie that theory gives).  Tried at the start values, with the priors
taken as Gaussian in the logs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability import information
from bayesdrill.analysis.identifiability.frictions import NOTHING, Told, told_apart
from bayesdrill.analysis.identifiability.information import (
    Direction,
    Information,
    Product,
    Scene,
    Scenery,
    directions,
    from_sensitivities,
    products,
    simple_exponents,
)
from bayesdrill.analysis.identifiability.structure import (
    Exponents,
    Resting,
    Structure,
    resting,
    structure_of,
)
from bayesdrill.analysis.identifiability.torque_confounding import StandIn, scaled, stand_ins
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import INPUTS
from bayesdrill.config.schema.config import Asked, Identification, Thresholds
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import prior_log_sd
from bayesdrill.record.experiment import usual_inputs
from bayesdrill.rig.models import INNER, STATES

WEIGHED_TO = 0.01  # what fixing or weighing a part is taken to give: one per cent
# Equal in SI by conservation of energy in an ideal motor.
TIES = (("motor.torque_constant", "motor.back_emf"),)
LOAD_SHARE = 0.1  # of a channel's range: what the known load that is tried changes at most
OTHER = 0.5  # times the usual drive, in the second half of the record or in another one
# What drives rigs: in words, and how one lets go of it.
DRIVES = {
    "v": ("voltage", "motor terminals shorted"),
    "w_2": ("imposed speed", ""),
    "t_m": ("torque of the motor", "no torque"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """`what` in words; `breaks`: symmetries (by index) that a signal or a scale would then show.

    `left`: independent products that stay without any trace in the record.  `shrink`: by what
    factor the sd of each parameter of interest would fall, on average (geometric mean).
    """

    what: str
    breaks: tuple[int, ...]
    left: int
    shrink: float


def remedies(
    scenery: Scenery,
    theta: Array,
    symmetries: Sequence[Exponents],
    prior_sd: Array,
    of_interest: Sequence[str],
) -> tuple[Remedy, ...]:
    """Every single action that can be tried, what helps most first."""
    names = scenery.unknowns
    now = information.from_sensitivities(names, scenery.sensitivities(theta))
    rows = [names.index(name) for name in of_interest]
    before = now.with_priors(prior_sd).bounds()[rows]
    moves = [np.array(exponents, dtype=float) for exponents in symmetries]
    found = []
    for what, after in _tried(scenery, theta, now):
        sd = after.with_priors(prior_sd).bounds()[rows]
        # What is known to all digits, by a record at the edge of numbers, gets no better.
        usual = (before > 0) & (sd > 0) & (before < np.inf)
        ratio = np.divide(before, sd, out=np.ones_like(sd), where=usual)
        seen = information.RANK_TOLERANCE * np.linalg.norm(after.root)
        breaks = [k for k, move in enumerate(moves) if np.linalg.norm(after.root @ move) > seen]
        shrink = float(np.exp(np.mean(np.log(ratio))))
        found.append(Remedy(what=what, breaks=tuple(breaks), left=after.n_blind, shrink=shrink))
    return tuple(sorted(found, key=lambda remedy: (remedy.left, -remedy.shrink)))


def _tried(scenery: Scenery, theta: Array, now: Information) -> Iterator[tuple[str, Information]]:
    names = scenery.unknowns
    for name, unit in zip(names, np.eye(len(names)), strict=True):
        yield f"weigh or measure {name} to 1 %", now.with_knowledge(unit, WEIGHED_TO)
    roles = scenery.likelihood.observations[0].response.model.roles
    for one, other in ((roles[one], roles[other]) for one, other in TIES):
        if one in names and other in names:
            equal = np.zeros(len(names))
            equal[names.index(one)], equal[names.index(other)] = 1.0, -1.0
            yield f"tie {one} = {other}", now.with_knowledge(equal, WEIGHED_TO)
    for what, scene in _other_drives(scenery):
        sensitivities = scenery.repeated(theta, scene)
        if np.isfinite(sensitivities).all():
            yield what, information.from_sensitivities(names, sensitivities)
    for what, scene in [*_more_channels(scenery, theta), *_other_inputs(scenery, theta)]:
        sensitivities = scenery.sensitivities(theta, scene)
        if np.isfinite(sensitivities).all():
            yield what, information.from_sensitivities(names, sensitivities)


def _other_drives(scenery: Scenery) -> Iterator[tuple[str, Scene]]:
    """The experiments there are, once more with less of what drives the rig."""
    every = [one.experiment for one in scenery.likelihood.observations]
    for name in (n for n in DRIVES if n in scenery.inputs):
        if any(one.constant.get(name, 0.0) or name in one.series for one in every):
            size = OTHER * float(np.mean([usual_inputs(one)[name] for one in every]))
            unit = INPUTS[name].plain_unit
            yield f"another experiment at {size:.3g} {unit}", Scene(times={name: OTHER})


def _more_channels(scenery: Scenery, theta: Array) -> Iterator[tuple[str, Scene]]:
    """Each state that is not measured yet, with the signal-to-noise ratio of the others."""
    motions, every = scenery.motions(theta), scenery.likelihood.observations
    seen = [one.experiment.weights(scenery.states) for one in every]
    swings = [
        np.median((motion @ weights.T).std(axis=0) / one.scales(theta[None])[0])
        for one, motion, weights in zip(every, motions, seen, strict=True)
    ]
    ratio = np.median(swings)
    spreads = np.median([motion.std(axis=0) for motion in motions], axis=0)
    for name, unit, spread in zip(scenery.states, np.eye(len(spreads)), spreads, strict=True):
        new = name not in INNER and any(
            np.linalg.matrix_rank(np.vstack([w, unit])) > len(w) for w in seen
        )
        sigma = float(spread / ratio) if ratio > 0 else 0.0
        if new and sigma > 0:
            yield (
                f"measure {name} (noise {sigma:.2g} {STATES[name].unit})",
                Scene(extra={name: sigma}),
            )


def _other_inputs(scenery: Scenery, theta: Array) -> Iterator[tuple[str, Scene]]:
    """A change of each input half-way through the record."""
    for name, (what, free) in DRIVES.items():
        usual = scenery.usual_input(name) if name in scenery.inputs else 0.0
        if usual == 0.0:
            continue
        said = f"change the {what} to {OTHER * usual:.3g} {INPUTS[name].plain_unit} half-way"
        yield said, Scene(late={name: (OTHER - 1.0) * usual})
        if free:
            coast = f"let the rig coast down half-way ({free})"
            yield coast, Scene(late={name: -usual})
    torque = scenery.likelihood.observations[0].response.model.roles.rotor.load
    if torque not in scenery.inputs:
        return
    found = []  # changes of channels, in shares of their ranges
    pairs = zip(
        scenery.motions(theta), scenery.motions(theta, Scene(late={torque: 1.0})), strict=True
    )
    for one, (before, after) in zip(scenery.likelihood.observations, pairs, strict=True):
        here, there = (x @ one.experiment.weights(scenery.states).T for x in (before, after))
        with np.errstate(all="ignore"):  # of a channel that stands still: no number, or infinite
            found.append(np.max(np.ptp(there - here, axis=0) / np.ptp(here, axis=0)))
    change = float(np.max(found))
    if 0 < change < np.inf:
        load = LOAD_SHARE / change
        loaded = f"apply a known load torque of {load:.2g} N m half-way"
        yield loaded, Scene(late={torque: load})


ALIKE = 2.0  # times: how much smaller an sd would be, for a nuisance that is named with it


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """A parameter or a simple product: sd of its log with record and prior, and before.

    `bound`: Cramer-Rao, from the record alone; inf if the record does not determine it.
    """

    exponents: Exponents
    sd: float
    prior_sd: float
    bound: float
    word: Identification


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisance:
    """A number of a sensor or a start, SI: sd with record and priors, and before.  `like`: unknowns of
    the rig that it can hardly be told from, each with the factor by which its sd would fall if this
    one were known.
    """

    name: str
    sd: float
    prior_sd: float
    word: Identification
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


def study_of(
    scenery: Scenery,
    posterior: Posterior,
    theta: Array,
    asked: Asked,
    at: str = "the start",
    *,
    seek_remedies: bool = False,
) -> Study:
    """At `theta (D,)`, as it is `asked` for.

    Remedies take as long as all else together, and are sought on request.
    """
    # Draws the points at which the structure is looked at.
    rng = seeds.stream(asked.seed, "identify")
    names, thresholds = scenery.unknowns, asked.thresholds
    of_interest = tuple(asked.of_interest) or names
    found = structure_of(posterior, scenery, theta, rng)
    known = from_sensitivities(names, scenery.sensitivities(theta))
    prior_sd = prior_spreads(posterior)[: len(names)]
    simple = products(known, prior_sd, simple_exponents(len(names)))
    return Study(
        names=names,
        at=at,
        of_interest=of_interest,
        structure=found,
        parameters=_parameters(known, prior_sd, thresholds),
        products=tuple(_known(p, thresholds) for p in simple),
        information=known,
        remedies=remedies(scenery, theta, found.symmetries, prior_sd, of_interest)
        if seek_remedies
        else (),
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
                word=thresholds.classify(float(sds[k] / before)),
                like=tuple((other, float(x)) for other, x in like if x > ALIKE),
            )
        )
    return tuple(found)


def prior_spreads(posterior: Posterior) -> Array:
    """Standard deviations of the logs under the priors `(D,)`."""
    return np.array([prior_log_sd(prior) for prior in posterior.space.priors.values()])


def _parameters(known: Information, prior_sd: Array, thresholds: Thresholds) -> tuple[Known, ...]:
    joint, alone = known.with_priors(prior_sd).bounds(), known.bounds()
    units = np.eye(len(prior_sd), dtype=int)
    return tuple(
        Known(
            exponents=tuple(int(x) for x in unit),
            sd=float(sd),
            prior_sd=float(before),
            bound=float(bound),
            word=thresholds.classify(sd / before),
        )
        for unit, sd, before, bound in zip(units, joint, prior_sd, alone, strict=True)
    )


def _known(product: Product, thresholds: Thresholds) -> Known:
    return Known(
        exponents=product.exponents,
        sd=product.sd,
        prior_sd=product.prior_sd,
        bound=product.bound,
        word=thresholds.classify(product.sd / product.prior_sd),
    )
