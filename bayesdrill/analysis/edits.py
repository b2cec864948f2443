"""What a rig offers and has not been given: how large it may be, and a posterior in which it is free."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import SIMULATOR_ROLES, ParameterSpace, Unknown
from bayesdrill.record.experiment import of_states
from bayesdrill.rig.models.linear import Linear, Model, with_named

ZERO = np.zeros(1)

# What a rig may be without, each by the role of the parameter that switches it on.
LACKS = ("motor.sliding", "rotor.sliding", "motor.drop", "rotor.damping", "shaft.damping")


def rig_candidates(
    every: tuple[Observation, ...], space: ParameterSpace, theta: Array
) -> dict[str, float]:
    """What the rig offers and has not, with the most that it can be; `theta (D,)`: where it moves."""
    model = every[0].response.model
    lacks = [model.roles[role] for role in LACKS]
    names = [name for name in lacks if name in model.offers and name not in model.parameters]
    moved = (
        [(rig_at(one, space, theta), motion(one, space, theta)) for one in every] if names else []
    )
    sizes = {
        name: max(_size(with_named(model, (name,)), name, p, states) for p, states in moved)
        for name in names
    }
    return {name: size for name, size in sizes.items() if size > 0}


def rig_at(one: Observation, space: ParameterSpace, theta: Array) -> dict[str, float]:
    """The rig's parameters at `theta (D,)`."""
    told = one.simulator_parameters(space.full(theta[None]))[0]
    names = one.response.model.parameters
    return dict(zip(names, map(float, told[: len(names)]), strict=False))


def motion(one: Observation, space: ParameterSpace, theta: Array) -> Array:
    """All states at the samples `(T, X)`, at `theta (D,)`."""
    states = one.response.model.states
    y = np.zeros((len(one.experiment.t), len(states)))
    shown = dataclasses.replace(one.experiment, channels=of_states(states), y=y)
    return np.asarray(
        one.response.of(shown).signals(one.simulator_parameters(space.full(theta[None])))[0]
    )


def _size(model: Model, name: str, p: Mapping[str, float], states: Array) -> float:
    """What the parameter would be if it did as much as all else that acts where it does.

    `states (T, X)`: of the motion without it.
    """
    without, alone = (model.linear({**p, name: value}) for value in (0.0, 1.0))
    named = dict(zip(model.states, states.T, strict=True))
    found = [0.0]
    for row in model.states:
        acting = _rates(without, row, named)
        changed = [(k, x) for k, x in alone.A.items() if k[0] == row and x != without.A.get(k, 0.0)]
        own = sum((np.asarray(x - without.A.get(k, 0.0)) * named[k[1]] for k, x in changed), ZERO)
        for one in model.frictions:
            if name in one.law.parameters and (row, one.name) in alone.B:
                own = own + np.asarray(alone.B[row, one.name]) * np.sign(named[one.against])
        if (size := float(np.sqrt(np.mean(own**2)))) > 0:
            found.append(acting / size)
    return max(found)


def _rates(linear: Linear, row: str, named: Mapping[str, Array]) -> float:
    """The root mean square of all that acts there, taken as if it acted one way.

    Angles act by their differences alone, in springs: together, as a rig may have turned anywhere.
    """
    every = [(k[1], x * named[k[1]]) for k, x in linear.A.items() if k[0] == row]
    rates: dict[str, list[float]] = {}
    for (of, by), x in linear.A.items():
        rates.setdefault(of, []).append(float(x) if of != by else math.nan)
    turned = {of for of, each in rates.items() if each == [1.0]}  # whose rate is another state
    springs = [part for of, part in every if of in turned]
    parts = [sum(springs, ZERO), *(part for of, part in every if of not in turned)]
    return float(np.sqrt(np.mean(sum(map(np.abs, parts), ZERO) ** 2)))


@dataclass(frozen=True, slots=True)
class Widened:
    """`sizes`: of what is tried, in the order in which it stands in `posterior`, before the noise."""

    posterior: Posterior
    sizes: Mapping[str, float]

    @property
    def tried(self) -> range:
        """Places of what is tried among the unknowns."""
        last = len(self.posterior.space.columns(*SIMULATOR_ROLES))
        return range(last - len(self.sizes), last)

    def at(self, theta: Array) -> Array:
        """The unknowns `theta (D,)`, with nothing of what is tried, `(E,)`."""
        return np.insert(theta, self.tried.start, np.zeros(len(self.sizes)))


def widened(posterior: Posterior, theta: Array) -> Widened:
    """With all unknown that the rig lacks, at `theta (D,)`."""
    sizes = rig_candidates(posterior.likelihood.observations, posterior.space, theta)
    free = [
        Unknown(
            symbol=Symbol(name, "", "", "", ""), role="sensor", prior=Uniform(0.0, size), start=0.0
        )
        for name, size in sizes.items()
    ]

    def with_tried(one: Observation) -> Observation:
        return one.for_rig(with_named(one.response.model, [*sizes]), one.response.sensing)

    return Widened(posterior.edit(free=free, each=with_tried), sizes)
