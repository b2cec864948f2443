"""Find the targets that a suitable waveform can determine, and remedies for the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability.information import SensitivityStudy, from_sensitivities
from bayesdrill.analysis.identifiability.structure import (
    Exponents,
    ScalingStructure,
    structure_of,
)
from bayesdrill.analysis.identifiability.study import remedies
from bayesdrill.basics.arrays import StoredArray
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.design.knowledge import PresentKnowledge
from bayesdrill.design.responses import ComingExperiment
from bayesdrill.design.targets import (
    DesignTarget,
    gradients,
    hidden_by,
    independent,
    invariant_products,
    parse_targets,
    product_target,
)
from bayesdrill.inference.posterior import Problem

MOST_REMEDIES = 4  # largest number of remedies that are named for a target
LEAST_FALL = 1.05  # least factor by which a named remedy divides the sd of the target


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetVisibility:
    """The k targets have relative derivatives `slopes (W, k, m)`; those at `visible` can be learnt.

    For each target, `hidden_by` names the unknowns that each exact symmetry changes together with
    the target.  `remedies` are actions that would break such a symmetry, and the factors by which
    the sd of the target would fall.
    """

    targets: tuple[DesignTarget, ...]
    slopes: StoredArray
    visible: tuple[int, ...]
    hidden_by: tuple[tuple[tuple[str, ...], ...], ...]
    remedies: tuple[tuple[tuple[str, float], ...], ...]

    @property
    def independent(self) -> list[int]:
        """Return the indices of visible targets that do not follow from earlier visible targets."""
        return [self.visible[k] for k in independent(self.slopes[:, list(self.visible)])]


def examine_targets(
    problem: Problem,
    coming: ComingExperiment,
    learn: Sequence[str],
    knowledge: PresentKnowledge,
    rng: np.random.Generator,
) -> TargetVisibility:
    """Examine the targets named in `learn`; without names, all products that can be determined.

    Raises `InputError` if no waveform can determine any of the targets.
    """
    source = coming.source
    # A symmetry under random levels holds for every waveform.
    levels = source.low + (source.high - source.low) * rng.random(source.count)
    posterior = coming.posterior(source.nearest_levels(levels))
    sensitivity = SensitivityStudy(posterior.likelihood)
    structure = structure_of(posterior, sensitivity, knowledge.draws[0], rng)
    names = sensitivity.unknowns
    shown = from_sensitivities(names, sensitivity.sensitivities(knowledge.draws[0]))
    known_best = invariant_products(structure, shown, sensitivity.prior_spreads[: len(names)])
    invariants = tuple(product_target(names, product.exponents) for product in known_best)
    targets = parse_targets(problem, learn, knowledge.draws) if learn else invariants
    if not targets:
        raise InputError.at("--learn", "no product of the unknowns changes any channel")
    slopes = gradients(targets, posterior.space, knowledge.draws)
    hidden = [hidden_by(slopes[:, k], structure) for k in range(len(targets))]
    visibility = TargetVisibility(
        targets=targets,
        slopes=slopes,
        visible=tuple(k for k, symmetries in enumerate(hidden) if not symmetries),
        hidden_by=tuple(tuple(_moved(structure, e) for e in each) for each in hidden),
        remedies=tuple(
            _remedies(target, symmetries, sensitivity, structure, knowledge)
            for target, symmetries in zip(targets, hidden, strict=True)
        ),
    )
    if not visibility.visible:
        sentences = _nothing_to_learn(visibility, invariants)
        raise InputError([Issue("--learn", sentence) for sentence in sentences])
    return visibility


def _remedies(
    target: DesignTarget,
    symmetries: Sequence[Exponents],
    sensitivity: SensitivityStudy,
    structure: ScalingStructure,
    knowledge: PresentKnowledge,
) -> tuple[tuple[str, float], ...]:
    """Return actions that break a symmetry, and the factors by which the sd of the target falls.

    Only the best action of each kind is returned.  Kinds are, for example, `weigh` and `add`.
    """
    names = [name for name in target.formula.names if name in structure.names]
    if not symmetries or not names:
        return ()
    prior_sd = sensitivity.prior_spreads[: len(structure.names)]
    tried = remedies(sensitivity, knowledge.draws[0], symmetries, prior_sd, names)
    useful = [x for x in tried if x.breaks and x.shrink > LEAST_FALL]
    others = [x for x in useful if x.what.split(" to ")[0] != f"weigh or measure {target.name}"]
    ranked = sorted(others, key=lambda remedy: -remedy.shrink)
    # The first word of an action is its kind, and the best of each kind is kept.
    best = {remedy.what.split()[0]: remedy for remedy in reversed(ranked)}.values()
    return tuple((each.what, each.shrink) for each in ranked if each in best)[:MOST_REMEDIES]


def _moved(structure: ScalingStructure, exponents: Exponents) -> tuple[str, ...]:
    return tuple(name for name, e in zip(structure.names, exponents, strict=True) if e)


def _nothing_to_learn(
    visibility: TargetVisibility, invariants: Sequence[DesignTarget]
) -> list[str]:
    sentences = []
    for k, target in enumerate(visibility.targets):
        moved = "; ".join(map(", ".join, visibility.hidden_by[k]))
        scaled = f"no channel changes if these are scaled together: {moved}"
        sentences.append(f"no waveform shows {target.name}: {scaled}")
        sentences += [
            f"to learn {target.name}, {action}: this divides its sd by {shrink:.3g}"
            for action, shrink in visibility.remedies[k]
        ]
    others = ", ".join(target.name for target in invariants)
    return [*sentences, f"a waveform can determine: {others}"]
