"""Design an experiment for named targets, and compare it with the record and the usual waveforms."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array, StoredArray
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.design import search
from bayesdrill.design.knowledge import PresentKnowledge
from bayesdrill.design.limited_motion import LimitCheck, LimitPenalty
from bayesdrill.design.limits import RigLimit
from bayesdrill.design.promise import information, present_sds, promise
from bayesdrill.design.responses import (
    ComingExperiment,
    Evaluation,
    SimulatedSlopes,
    SuperposedPulses,
    TargetCovariance,
)
from bayesdrill.design.source import SourceLimits
from bayesdrill.design.variants import variant_sds
from bayesdrill.design.visibility import TargetVisibility, examine_targets
from bayesdrill.design.waveforms import FREE
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.record.experiment import Experiment

RECORDED, REPEATED, DESIGNED = "as recorded", "repeated", "designed"  # further waveforms
NOTHING: Mapping[str, float] = MappingProxyType({})
BAND = (0.01, 0.5, 0.99)  # quantiles of the expected response


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRequest:
    """A request names targets in `learn` (if empty, all products of parameters that can be learnt).

    `family` is one of `waveforms.FAMILIES`, or `FREE`.  `experiments` is the number of experiments.
    """

    source: SourceLimits
    limits: tuple[RigLimit, ...] = ()
    learn: tuple[str, ...] = ()
    family: str = FREE
    experiments: int = 1
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetOutlook:
    """An outlook has relative sds of a target: `now`, and `after` each waveform.

    `hidden_by` names unknowns that change no record if scaled with the target (an exact symmetry).
    `remedies` are actions that would break it, and factors by which the target's sd would fall.
    """

    name: str
    now: float
    after: Mapping[str, float]
    hidden_by: tuple[tuple[str, ...], ...] = ()
    remedies: tuple[tuple[str, float], ...] = ()

    @property
    def designed(self) -> float:
        """Return the sd after the designed experiment."""
        return self.after[DESIGNED]

    @property
    def usual_sds(self) -> dict[str, float]:
        """Return the sds after the usual waveforms."""
        special = (RECORDED, REPEATED, DESIGNED)
        return {name: sd for name, sd in self.after.items() if name not in special}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentDesign:
    """A design has `levels (E, S)` of E experiments, and the outlook for each target.

    `criteria` are mean log determinants of the targets' covariance, by waveform.  `bands (3, T, K)`
    are quantiles `BAND` of the channels in the first experiment, and `limited (3, t, L)` those of the
    limited quantities.  In each experiment, at least the fraction `kept` of draws keeps the limits.
    A design against a rival model has `log_odds` by waveform, and no targets.  `variants` has sds
    of the targets by the name of a changed experiment.
    """

    request: DesignRequest
    levels: StoredArray
    targets: tuple[TargetOutlook, ...]
    criteria: Mapping[str, float]
    log_odds: Mapping[str, float]
    experiment: Experiment
    bands: StoredArray
    limited: StoredArray
    kept: float
    known_from: str
    draws: int
    variants: Mapping[str, tuple[float, ...]] = MappingProxyType({})


def design_experiment(
    problem: Problem,
    request: DesignRequest,
    knowledge: PresentKnowledge,
    thresholds: IdentifySpec,
    report: Reporter,
) -> ExperimentDesign:
    """Design an experiment with the channels and noise of the first record of a problem.

    Raises `InputError` if limits contradict each other, or if no waveform helps.
    """
    request.source.check()
    report.update(0.0, "responses to pulses of the input")
    coming = ComingExperiment.from_observation(problem.observations[0], request.source)
    rng = seeds.stream(request.seed, "design", 1)
    visibility = examine_targets(problem, coming, request.learn, knowledge, rng)
    slopes, smooth = visibility.slopes[:, visibility.independent], problem.model.smooth
    check = LimitCheck.between_samples(coming, request.limits, knowledge.checked)
    batch = list[Array]()
    usual = dict[str, Array]()
    precision = np.tile(knowledge.precision, (len(knowledge.draws), 1, 1))
    chosen = TargetCovariance(slopes=slopes, precision=precision)
    for number in range(request.experiments):  # each search adds the information of earlier designs

        def progress(fraction: float, number: int = number) -> None:
            report.update(
                0.1 + 0.85 * (number + fraction) / request.experiments, "search of the levels"
            )

        known = information(coming.posterior(*batch), knowledge.draws) if batch else 0.0
        targets_after = TargetCovariance(slopes=slopes, precision=precision + known)
        waveforms, levels = search_levels(
            coming, knowledge, targets_after, check, request, rng, progress, batch, smooth=smooth
        )
        usual = usual or waveforms
        batch.append(levels)

    def repeated(levels: Array) -> Posterior:
        return coming.posterior(*[levels] * request.experiments)

    posteriors = {RECORDED: problem.posterior}
    posteriors |= {name: repeated(levels) for name, levels in usual.items()}
    if request.experiments > 1:
        posteriors[REPEATED] = repeated(batch[0])
    posteriors[DESIGNED] = coming.posterior(*batch)
    targets, informations = _outlooks(visibility, knowledge, posteriors, request.seed)
    _refuse_hopeless([targets[k] for k in visibility.visible], thresholds)
    report.update(1.0, "")
    criteria = {name: chosen.criterion(x)[0] for name, x in informations.items()}
    now, sds = np.array([(target.now, target.designed) for target in targets]).T
    variants = variant_sds(
        problem.observations[0], coming, batch, knowledge, visibility.slopes, sds, now
    )
    design = describe_expected(
        coming, request, np.array(batch), knowledge, check, targets, criteria
    )
    return dataclasses.replace(design, variants=variants)


def search_levels(
    coming: ComingExperiment,
    knowledge: PresentKnowledge,
    targets: TargetCovariance,
    check: LimitCheck,
    request: DesignRequest,
    rng: np.random.Generator,
    progress: Callable[[float], None],
    earlier: Sequence[Array] = (),
    *,
    smooth: bool,
    theta: Array | None = None,
) -> tuple[dict[str, Array], Array]:
    """Return the usual waveforms by name, and the levels of the requested family.

    The waveforms are the best for `targets` at `theta (W, D)`, by default at the draws in `knowledge`.
    The levels of `earlier` experiments are further starts.  A `smooth` rig is linear in its input.
    """
    theta = knowledge.draws if theta is None else theta
    evaluation: Evaluation
    if smooth:
        evaluation = pulses = SuperposedPulses(coming, theta, targets)
        penalty = LimitPenalty(check, knowledge.draws)
        repair: Callable[[Array], Array] = partial(search.least_excess, penalty)
        improve = partial(search.descend, pulses, penalty)
    else:
        evaluation = simulated = SimulatedSlopes(coming, theta, targets)
        repair, improve = np.copy, partial(search.exchange, simulated)
    safe = search.safe_waveform(check, repair)
    waveforms = search.usual_waveforms(evaluation, check, safe, rng)
    if request.family != FREE:
        return waveforms, waveforms[request.family]
    return waveforms, improve(check, safe, [*waveforms.values(), *earlier], rng, progress)


def describe_expected(
    coming: ComingExperiment,
    request: DesignRequest,
    levels: Array,
    knowledge: PresentKnowledge,
    check: LimitCheck,
    targets: tuple[TargetOutlook, ...] = (),
    criteria: Mapping[str, float] = NOTHING,
    odds: Mapping[str, float] = NOTHING,
) -> ExperimentDesign:
    """Return the design with `levels (E, S)` and the expected motion."""
    signals, _ = coming.motion(knowledge.checked, levels[0])
    limited = check.limited(knowledge.checked, levels[0])
    return ExperimentDesign(
        request=request,
        levels=levels,
        targets=targets,
        criteria=criteria,
        log_odds=odds,
        experiment=coming.observation.experiment,
        bands=np.quantile(signals, BAND, axis=0),
        limited=np.quantile(limited, BAND, axis=0),
        kept=min(map(check.kept_share, levels)),
        known_from=knowledge.source,
        draws=len(knowledge.draws),
    )


def _outlooks(
    visibility: TargetVisibility,
    knowledge: PresentKnowledge,
    posteriors: Mapping[str, Posterior],
    seed: int,
) -> tuple[tuple[TargetOutlook, ...], dict[str, Array]]:
    """Return outlooks of targets, and information matrices of records, by the name of a posterior."""
    slopes, after, informations = visibility.slopes, {}, {}
    space = posteriors[DESIGNED].space
    now = present_sds(space, knowledge, slopes, seeds.stream(seed, "design", 2))
    for name, posterior in posteriors.items():
        rng = seeds.stream(seed, "design", 2)  # the same random numbers for all waveforms
        sds, informations[name] = promise(posterior, knowledge, slopes, rng)
        # No record widens the knowledge on average, so larger sds are errors of the approximation.
        after[name] = np.minimum(sds, now)
    outlooks = tuple(
        TargetOutlook(
            name=target.name,
            now=float(now[k]),
            after={name: float(sds[k]) for name, sds in after.items()},
            hidden_by=visibility.hidden_by[k],
            remedies=visibility.remedies[k],
        )
        for k, target in enumerate(visibility.targets)
    )
    return outlooks, informations


def _refuse_hopeless(targets: Sequence[TargetOutlook], thresholds: IdentifySpec) -> None:
    """Raise `InputError` if the designed waveform hardly narrows any target."""
    ratios = [target.designed / target.now for target in targets]
    if all(thresholds.classify(ratio) == "left to the prior" for ratio in ratios):
        pairs = zip(targets, ratios, strict=True)
        falls = ", ".join(f"{x.name} to {100 * ratio:.3g} % of its sd" for x, ratio in pairs)
        message = f"the best waveform within these limits narrows nothing: {falls}"
        way_out = (
            "measure longer, with less noise, or with further channels (`bayesdrill identify`)"
        )
        raise InputError.at("--learn", f"{message}; {way_out}")
