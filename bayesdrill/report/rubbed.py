"""What figures show of frictions: efforts over time, laws over speed, in the units of the user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol, own_symbol
from bayesdrill.basics.units import Unit
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.problem import Problem
from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.insight.rubbing import Rubbing, curve
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.models.roles import Roles

Array = NDArray[np.float64]

TAILS = (0.5 - HDI_PROBABILITY / 2, 0.5 + HDI_PROBABILITY / 2)
MOTOR = Symbol("w_3", "rad/s", r"\dot\theta_3", "rad/s", "speed of the motor")


def effort_symbol(friction: Friction) -> Symbol:
    """Its own, or one that is made of its name."""
    return friction.symbol or own_symbol(
        friction.name, "N*m", None, friction.where or friction.name
    )


def speed_symbol(state: str, roles: Roles) -> Symbol:
    """Of the motor before the gear."""
    return MOTOR if state == roles.motor.speed else vocabulary.STATES[state]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rub:
    """A friction over time: at the MAP `effort (T,)`, its `band (2, T)` where there are draws, and the
    times between which it `sticks`.
    """

    label: Symbol
    effort: Array
    band: Array | None
    sticks: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Law:
    """A friction over its speeds `(G,)`: at the MAP, with its band over draws `(2, G)`, and by nominal
    values, where all of it has one; `seen (T,)`: the speeds of the record.
    """

    speed: Symbol
    effort: Symbol
    where: str
    speeds: Array
    best: Array
    band: Array | None
    nominal: Array | None
    seen: Array


def rubs(found: Sequence[Rubbing], clock: Unit) -> tuple[Rub, ...]:
    """Of one experiment."""
    return tuple(
        Rub(
            label=effort_symbol(one.friction),
            effort=one.effort,
            band=None if len(one.efforts) < 2 else np.quantile(one.efforts, TAILS, axis=0),
            sticks=tuple((a / clock.factor, b / clock.factor) for a, b in one.intervals),
        )
        for one in found
    )


def laws(
    one: Observation, found: Sequence[Rubbing], problem: Problem, best: Array, draws: Array
) -> tuple[Law, ...]:
    """Of one experiment, at the MAP `best (D,)` and draws `(N, D)`."""
    space, every = problem.posterior.space, []
    for rubbing in found:
        points = np.vstack([best[None], draws])
        shown = curve(one, rubbing, space.full(points))
        every.append(
            Law(
                speed=speed_symbol(rubbing.friction.against, one.response.model.roles),
                effort=effort_symbol(rubbing.friction),
                where=rubbing.friction.where,
                speeds=shown.speeds,
                best=shown.sizes[0],
                band=np.quantile(shown.sizes[1:], TAILS, axis=0) if len(draws) > 1 else None,
                nominal=_nominal(one, rubbing, problem, best),
                seen=rubbing.speed * rubbing.gear,
            )
        )
    return tuple(every)


def _nominal(one: Observation, rubbing: Rubbing, problem: Problem, best: Array) -> Array | None:
    """By the nominal values of what the law names; None where one of them is unknown and has none."""
    space = problem.posterior.space
    named = one.named(one.response.parameters)
    own = {named.get(name, name) for name in rubbing.friction.law.parameters}
    if not own & {*space.free} or not own & {*space.free} <= {*problem.nominal}:
        return None
    values = {name: problem.nominal.get(name, x) for name, x in zip(space.free, best, strict=True)}
    return np.asarray(curve(one, rubbing, space.full(space.vector(values)[None])).sizes[0])
