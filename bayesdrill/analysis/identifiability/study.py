"""Study the identifiability of one config: structure, bounds, products, and remedies.

A remedy is a further channel, other inputs, or other knowledge, such as the weight of a part or an
equation of theory.  Remedies are tried at one point, with priors that are Gaussian in the logs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability.frictions import (
    NO_CONFOUNDING,
    FrictionConfounding,
    distinguish,
    drive_words,
    drives_of,
)
from bayesdrill.analysis.identifiability.information import (
    RANK_TOLERANCE,
    DesignVariant,
    Information,
    SensitivityStudy,
    from_sensitivities,
    project_out,
    root_of,
    simple_exponents,
)
from bayesdrill.analysis.identifiability.structure import (
    DependsOnFixed,
    Exponents,
    ScalingStructure,
    depends_on_fixed,
    structure_of,
)
from bayesdrill.analysis.identifiability.torque_confounding import (
    TorqueConfounding,
    find_confounded,
    scaled_with_torque,
)
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.config.schema.config import Identification, IdentifySpec
from bayesdrill.inference.compression import excerpt
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import prior_log_sd
from bayesdrill.inference.unknowns import labelled_name
from bayesdrill.record.experiment import typical_inputs

WEIGHED_TO = 0.01  # relative sd of a parameter that is weighed, or tied to another
LOAD_SHARE = 0.1  # largest effect of a known load on a channel, relative to the channel's range
ADDED_SHARE = 0.5  # known inertia added in a further record, relative to the unknown inertia
OTHER_DRIVE = 0.5  # drive in the second half, or in a further record, relative to the present drive


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """A remedy, `what` in words, would break symmetries and reduce standard deviations.

    `breaks` are indices of these symmetries, and `left` counts products that remain undetermined.
    `shrink` is the geometric mean of the factors by which sds of parameters of interest fall.
    """

    what: str
    breaks: tuple[int, ...]
    left: int
    shrink: float


def remedies(
    sensitivity: SensitivityStudy,
    theta: Array,
    symmetries: Sequence[Exponents],
    prior_sd: Array,
    of_interest: Sequence[str],
) -> tuple[Remedy, ...]:
    """Try each action alone, and return all, sorted from the most to the least helpful.

    `prior_sd (m,)` are sds of logs, and `of_interest` names the parameters whose sds count.
    """
    names = sensitivity.unknowns
    now = from_sensitivities(names, sensitivity.sensitivities(theta))
    rows = [names.index(name) for name in of_interest]
    before = now.with_priors(prior_sd).bounds()[rows]
    moves = [np.array(exponents, dtype=float) for exponents in symmetries]

    def tried(what: str, after: Information) -> Remedy:
        sd = after.with_priors(prior_sd).bounds()[rows]
        # An sd that underflows or overflows cannot be compared.
        finite = (before > 0) & (sd > 0) & (before < np.inf) & (sd < np.inf)
        ratio = np.divide(before, sd, out=np.ones_like(sd), where=finite)
        least = RANK_TOLERANCE * np.linalg.norm(after.root)
        breaks = (k for k, move in enumerate(moves) if np.linalg.norm(after.root @ move) > least)
        shrink = float(np.exp(np.mean(np.log(ratio))))
        return Remedy(what=what, breaks=tuple(breaks), left=after.n_blind, shrink=shrink)

    actions = itertools.starmap(tried, _actions(sensitivity, theta, now))
    return tuple(sorted(actions, key=lambda remedy: (remedy.left, -remedy.shrink)))


def _actions(
    sensitivity: SensitivityStudy, theta: Array, information: Information
) -> Iterator[tuple[str, Information]]:
    names = sensitivity.unknowns
    for name, unit in zip(names, np.eye(len(names)), strict=True):
        yield f"weigh or measure {name} to 1 %", information.with_knowledge(unit, WEIGHED_TO)
    # In an ideal motor, conservation of energy makes torque and back-EMF constants equal in SI.
    for motor in sensitivity.model.roles.motors:
        first, second = motor.torque_constant, motor.back_emf
        if first in names and second in names:
            equal = np.zeros(len(names))
            equal[names.index(first)], equal[names.index(second)] = 1.0, -1.0
            yield f"tie {first} = {second}", information.with_knowledge(equal, WEIGHED_TO)
    yield from _added_inertias(sensitivity, theta, information)
    others, channels = _other_drives(sensitivity), _more_channels(sensitivity, theta)
    for what, scene in (*others, *channels, *_other_inputs(sensitivity, theta)):
        yield what, from_sensitivities(names, sensitivity.sensitivities(theta, scene))


def _added_inertias(
    sensitivity: SensitivityStudy, theta: Array, information: Information
) -> Iterator[tuple[str, Information]]:
    """Yield, for each unknown inertia, the experiments repeated with a weighed inertia added to it."""
    names, space = sensitivity.unknowns, sensitivity.likelihood.space
    tied = {name for relation in space.relations.values() for name in relation.names}
    for inertia in sensitivity.model.roles.inertias:
        symbol = inertia.inertia
        if symbol not in names or symbol in tied:
            continue
        column, place = space.free.index(symbol), [names.index(symbol)]
        heavier = theta.copy()
        heavier[column] *= 1.0 + ADDED_SHARE
        rows = sensitivity.sensitivities(heavier)
        total = rows[:, place] / (1.0 + ADDED_SHARE)  # d log(j + J) / d log j = 1 / (1 + J / j)
        rows[:, place] = total
        weighed = np.append(np.zeros(len(names)), 1.0 / WEIGHED_TO)
        both = np.vstack([np.hstack([rows, ADDED_SHARE * total]), weighed])
        root = root_of(np.vstack([information.root, project_out(both, len(names))]))
        size = f"{ADDED_SHARE * theta[column]:.2g} {sensitivity.model.symbols[symbol].unit}"
        what = f"repeat it with an inertia of {size} (to 1 %) added to {symbol}"
        yield what, Information(names, root)


def _other_drives(sensitivity: SensitivityStudy) -> Iterator[tuple[str, DesignVariant]]:
    """Yield variants that repeat the experiments with a smaller drive."""
    experiments = [observation.experiment for observation in sensitivity.likelihood.observations]
    rig = sensitivity.model
    for name in drives_of(rig):
        if any(each.constant.get(name, 0.0) or name in each.series for each in experiments):
            typical = float(np.mean([typical_inputs(each)[name] for each in experiments]))
            size = f"{OTHER_DRIVE * typical:.3g} {rig.symbols[name].plain_unit}"
            other = DesignVariant(factors={name: OTHER_DRIVE}, keeps_original=True)
            yield f"another experiment at {size}", other


def _more_channels(
    sensitivity: SensitivityStudy, theta: Array
) -> Iterator[tuple[str, DesignVariant]]:
    """Yield variants that measure a further state, at the channels' median signal-to-noise ratio."""
    rig = sensitivity.model
    motions, observations = sensitivity.motions(theta), sensitivity.likelihood.observations
    weights = [each.experiment.weights(sensitivity.states) for each in observations]
    swings = [
        np.median((motion @ w.T).std(axis=0) / observation.scales(theta[None])[0])
        for observation, motion, w in zip(observations, motions, weights, strict=True)
    ]
    ratio = np.median(swings)
    spreads = np.median([motion.std(axis=0) for motion in motions], axis=0)
    for name, unit, spread in zip(sensitivity.states, np.eye(len(spreads)), spreads, strict=True):
        ranks = [np.linalg.matrix_rank(np.vstack([w, unit])) > len(w) for w in weights]
        new = name not in rig.inner and any(ranks)
        sigma = float(spread / ratio) if ratio > 0 else 0.0
        if new and sigma > 0:
            what = f"measure {name} (noise {sigma:.2g} {rig.symbols[name].unit})"
            yield what, DesignVariant(extra={name: sigma})


def _other_inputs(
    sensitivity: SensitivityStudy, theta: Array
) -> Iterator[tuple[str, DesignVariant]]:
    rig = sensitivity.model
    for name in drives_of(rig):
        mean = sensitivity.mean_input(name)
        if mean == 0.0:
            continue
        drive, free = drive_words(rig, name)
        size = f"{OTHER_DRIVE * mean:.3g} {rig.symbols[name].plain_unit}"
        change = DesignVariant(shifts={name: (OTHER_DRIVE - 1.0) * mean})
        yield f"change the {drive} to {size} half-way", change
        if free:
            coast = f"let the rig coast down half-way ({free})"
            yield coast, DesignVariant(shifts={name: -mean})
    loaded = [i for i in rig.roles.inertias if i.load in sensitivity.inputs]
    for inertia in loaded:
        where = f" {inertia.at}" if len(loaded) > 1 else ""
        yield from _load(sensitivity, theta, inertia.load, where)


def _load(
    sensitivity: SensitivityStudy, theta: Array, torque: str, location: str
) -> Iterator[tuple[str, DesignVariant]]:
    """Yield a variant with a known load in the second half, large enough to be seen in a channel."""
    motion, observations = sensitivity.model.roles.motion, sensitivity.likelihood.observations
    loaded = sensitivity.motions(theta, DesignVariant(shifts={torque: 1.0}))
    changes = []  # largest change of a channel by a unit load, relative to the channel's range
    for observation, *both in zip(observations, sensitivity.motions(theta), loaded, strict=True):
        free, pushed = (x @ observation.experiment.weights(sensitivity.states).T for x in both)
        with np.errstate(all="ignore"):  # the range of a channel may be zero
            changes.append(np.max(np.ptp(pushed - free, axis=0) / np.ptp(free, axis=0)))
    change = float(np.max(changes))
    if 0 < change < np.inf:
        load = LOAD_SHARE / change
        what = (
            f"apply a known load {motion.torque} of {load:.2g} {motion.newtons}{location} half-way"
        )
        yield what, DesignVariant(shifts={torque: load})


MIN_FALL = 2.0  # smallest factor by which the sd of an unknown falls if a similar nuisance is known


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownProduct:
    """The log of a product of powers has `sd` with record and priors, and `prior_sd` by priors alone.

    `bound` is the Cramer-Rao bound of the record alone, infinite if it does not determine the product.
    """

    exponents: Exponents
    sd: float
    prior_sd: float
    bound: float
    word: Identification

    @property
    def price(self) -> float:
        """Return sd / prior_sd times the sum of |exponents|; low prices are selected first."""
        return self.sd / self.prior_sd * sum(map(abs, self.exponents))


def products(
    information: Information, prior_sd: Array, candidates: Array, thresholds: IdentifySpec
) -> tuple[KnownProduct, ...]:
    """Return a maximal set of independent `candidates (n, m)`, in order of increasing price.

    The price increases with the number of factors; see `KnownProduct.price`.
    """
    spread = np.linalg.inv(information.with_priors(prior_sd).root)
    rank = np.linalg.matrix_rank(candidates) if len(candidates) else 0
    sd = np.linalg.norm(candidates @ spread, axis=1)
    before = np.linalg.norm(candidates * prior_sd, axis=1)
    price = sd / before * np.abs(candidates).sum(axis=1)
    selected: list[int] = []
    for index in np.argsort(price, kind="stable"):
        if len(selected) == rank:
            break
        if np.linalg.matrix_rank(candidates[[*selected, index]]) > len(selected):
            selected.append(int(index))
    chosen = candidates[selected]
    return _known_products(information, chosen, sd[selected], before[selected], thresholds)


def _known_products(
    information: Information,
    exponents: Array,
    sds: Array,
    prior_sds: Array,
    thresholds: IdentifySpec,
) -> tuple[KnownProduct, ...]:
    """Return the products with `exponents (n, m)`.

    Their logs have the sds `sds (n,)` with record and priors, and `prior_sds (n,)` by the priors alone.
    """
    return tuple(
        KnownProduct(
            exponents=tuple(map(int, powers)),
            sd=sd,
            prior_sd=prior_sd,
            bound=information.bound(powers),
            word=thresholds.classify(sd / prior_sd),
        )
        for powers, sd, prior_sd in zip(exponents, sds.tolist(), prior_sds.tolist(), strict=True)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisance:
    """A nuisance is an unknown of a sensor or a start, with its sd and its sd by the prior alone, SI.

    `like` has pairs: an unknown of the rig that can hardly be distinguished from the nuisance, and the
    factor by which the unknown's sd would fall if the nuisance were known.
    """

    name: str
    sd: float
    prior_sd: float
    word: Identification
    like: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifiabilityStudy:
    """A study describes the identifiability of the unknowns at a physical point, which `at` names.

    `information` is that of the record alone.  `stand_ins` are parameters that a missing torque can
    replace.  `scaled` are names that a symmetry scales together with the size of this torque.
    `resting` are scales that fixed numbers determine.
    """

    names: tuple[str, ...]
    at: str
    of_interest: tuple[str, ...]
    structure: ScalingStructure
    parameters: tuple[KnownProduct, ...]
    products: tuple[KnownProduct, ...]
    information: Information
    remedies: tuple[Remedy, ...]
    nuisances: tuple[Nuisance, ...] = ()
    frictions: FrictionConfounding = NO_CONFOUNDING
    stand_ins: tuple[TorqueConfounding, ...] = ()
    scaled: tuple[tuple[str, ...], ...] = ()
    resting: tuple[DependsOnFixed, ...] = ()


def study_of(
    sensitivity: SensitivityStudy,
    posterior: Posterior,
    theta: Array,
    settings: IdentifySpec,
    seed: int,
    at: str = "the start",
    *,
    seek_remedies: bool = False,
) -> IdentifiabilityStudy:
    """Study the identifiability at `theta (D,)`, which `at` names in sentences.

    Remedies are sought only on request, as they take as long as everything else.
    """
    rng = seeds.stream(seed, "identify")
    names = sensitivity.unknowns
    of_interest = tuple(settings.of_interest) or names
    posterior = excerpt(posterior) or posterior
    structure = structure_of(posterior, sensitivity, theta, rng)
    known = from_sensitivities(names, sensitivity.sensitivities(theta))
    prior_sd, tried = prior_spreads(posterior)[: len(names)], tuple[Remedy, ...]()
    sds = known.with_priors(prior_sd).bounds()
    if seek_remedies:
        tried = remedies(sensitivity, theta, structure.symmetries, prior_sd, of_interest)
    return IdentifiabilityStudy(
        names=names,
        at=at,
        of_interest=of_interest,
        structure=structure,
        parameters=_known_products(known, np.eye(len(names)), sds, prior_sd, settings),
        products=products(known, prior_sd, simple_exponents(len(names)), settings),
        information=known,
        remedies=tried,
        nuisances=_nuisances(sensitivity, posterior, theta, settings),
        frictions=distinguish(sensitivity, posterior, theta),
        stand_ins=find_confounded(posterior, theta, prior_spreads(posterior), rng),
        resting=depends_on_fixed(posterior, theta, known, prior_sd, rng),
        scaled=scaled_with_torque(posterior, structure.symmetries),
    )


START_DRAWS, TRIED = 128, 16  # number of prior draws, and of the most probable ones that are tried
STILL = 1e-3  # modelled / measured range of a channel, below which the model stands still
MIN_MOTION_OVER_NOISE = 3.0  # smallest sd / noise of a moving channel; differences give the noise


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyPoint:
    """A study is made at the point `theta (D,)`, which sentences name by `description`.

    Channels in `inert` rest in the model at the start; `description` is empty if no point moves them.
    """

    theta: Array
    description: str
    inert: tuple[str, ...] = ()


def study_point(sensitivity: SensitivityStudy, posterior: Posterior, seed: int) -> StudyPoint:
    """Return the start or, if the rig stands still there, a likely draw of the priors with motion.

    Signals of a rig at rest hardly depend on parameters, so that nothing would be determined.
    """
    space = posterior.space
    start = space.vector(space.start)
    if not (still := _still_channels(sensitivity, start)):
        return StudyPoint(theta=start, description="the start")
    drawn = space.draw(START_DRAWS, seeds.stream(seed, "identify", 2))
    likely = np.argsort(-(excerpt(posterior) or posterior).density(drawn), kind="stable")[:TRIED]
    moving = (theta for theta in drawn[likely] if not _still_channels(sensitivity, theta))
    if (theta := next(moving, None)) is None:
        return StudyPoint(theta=start, description="", inert=still)
    name = f"the most probable draw with motion, of {START_DRAWS} draws from the priors"
    return StudyPoint(theta=theta, description=name, inert=still)


def _still_channels(sensitivity: SensitivityStudy, theta: Array) -> tuple[str, ...]:
    full, still = sensitivity.likelihood.space.full(theta[None]), []
    for observation in sensitivity.likelihood.observations:
        experiment = observation.experiment
        with np.errstate(all="ignore"):
            predicted = observation.predict(full, theta[None])[0]
            for k, seen in enumerate(experiment.is_measured.T):
                y, noise = experiment.y[seen, k], np.diff(experiment.y[seen, k]).std() / 2.0**0.5
                moves = np.ptp(predicted[seen, k]) > STILL * np.ptp(y)
                if not moves and y.std() > MIN_MOTION_OVER_NOISE * noise:
                    still.append(labelled_name(experiment.names[k], observation.label))
    return tuple(still)


def _nuisances(
    sensitivity: SensitivityStudy, posterior: Posterior, theta: Array, thresholds: IdentifySpec
) -> tuple[Nuisance, ...]:
    rows = sensitivity.with_nuisances(theta)
    if not sensitivity.nuisances:
        return ()
    joint = from_sensitivities((*sensitivity.unknowns, *sensitivity.nuisances), rows)
    inverse = np.linalg.inv(joint.with_priors(sensitivity.prior_spreads).root)
    covariance = inverse @ inverse.T
    sds = np.sqrt(np.diag(covariance))
    correlations = covariance / np.outer(sds, sds)
    steps = posterior.coordinates.natural(theta[None])[0]

    nuisances = []
    for k, name in enumerate(sensitivity.nuisances, start=len(sensitivity.unknowns)):
        falls = 1.0 / np.sqrt(np.maximum(1.0 - correlations[k] ** 2, 1e-12))
        pairs = zip(sensitivity.unknowns, falls.tolist(), strict=False)
        before = sensitivity.prior_spreads[k]
        nuisance = Nuisance(
            name=name,
            sd=float(sds[k] * steps[k]),
            prior_sd=float(before * steps[k]),
            word=thresholds.classify(float(sds[k] / before)),
            like=tuple(x for x in sorted(pairs, key=lambda fall: -fall[1]) if x[1] > MIN_FALL),
        )
        nuisances.append(nuisance)
    return tuple(nuisances)


def prior_spreads(posterior: Posterior) -> Array:
    """Return the standard deviations `(D,)` of the logs under the priors."""
    return np.array([prior_log_sd(prior) for prior in posterior.space.priors.values()])
