"""A posterior in which more is unknown: of sensors, of starts, and what its rig lacks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.insight import candidates
from bayesdrill.insight.candidates import LATEST, Candidate, Kind
from bayesdrill.rig.choosing import simulator
from bayesdrill.rig.models.composed import with_named

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Widened:
    """`every`: what is tried, in the order in which it stands in `posterior`, before the noise."""

    posterior: Posterior
    every: tuple[Candidate, ...]


def widened(posterior: Posterior, theta: Array, kinds: frozenset[Kind]) -> Widened:
    """With all unknown that is of these kinds, at `theta (D,)` and neutral so far."""
    space, every = posterior.space, posterior.likelihood.observations
    rig = tuple(candidates.of_rig(every, space, theta)) if "rig" in kinds else ()
    tried, parts = [*rig], []
    for one in every:
        own = [c for c in candidates.of_sensors(one) if c.kind in kinds]
        if "start" in kinds:
            own += candidates.of_start(one, space, theta)
        tried += own
        parts.append(_part(one, own, rig, late="start" in kinds))
    noise = len(space.unknowns) - len(space.columns("noise"))
    new = tuple(c.unknown for c in tried)
    wider = dataclasses.replace(
        space,
        model=(*space.model, *(c.name for c in tried)),
        unknowns=(*space.unknowns[:noise], *new, *space.unknowns[noise:]),
    )
    made = Posterior(
        space=wider, likelihood=Likelihood.joint(wider, parts), coordinates=wider.coordinates()
    )
    return Widened(made, tuple(tried))


def _part(
    one: Observation,
    own: Sequence[Candidate],
    rig: Sequence[Candidate],
    *,
    late: bool,
) -> Observation:
    """`own`: of this experiment; `rig`: of all; `late`: a rig that may move before its start."""
    old = one.response.sensing
    names = {(c.kind, c.of): c.name for c in own}

    def with_new(kind: Kind, known: Mapping[str, str]) -> dict[str, str]:
        return {**known, **{of: name for (k, of), name in names.items() if k == kind}}

    sensing = dataclasses.replace(
        old,
        gains=with_new("gain", old.gains),
        offsets=with_new("offset", old.offsets),
        lags=with_new("lag", old.lags),
        input_offsets=with_new("input offset", old.input_offsets),
        input_lags=with_new("input lag", old.input_lags),
        states=with_new("start", old.states),
    )
    seen = _without_first(one) if late else one
    model = with_named(one.response.model, [c.of for c in rig])
    steps = one.response.stepping or ()  # others would explain what these do
    response = simulator(model, seen.experiment, sensing, *steps)
    told = one.named(one.response.parameters) | {c.of: c.name for c in rig}
    return seen.simulated(response, [told.get(name, name) for name in response.parameters])


def _without_first(one: Observation) -> Observation:
    """Before a lag is over, a rig in motion shows what was before its start.  Too short a record, and
    one whose noise needs every sample, stay whole.
    """
    experiment, y = one.experiment, np.array(one.experiment.y)
    y[experiment.t < experiment.t_start + LATEST * experiment.dt] = np.nan
    if np.isnan(y).mean() >= 0.5:
        return one
    try:
        return one.on(y)
    except ValueError:
        return one
