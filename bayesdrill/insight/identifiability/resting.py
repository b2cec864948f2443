"""Unknowns that a record knows only as far as numbers that the config holds are right.

A number that is held settles a scale that no signal shows: were it another, so would be all that is
told through it, and the record would look the same.  Unless the record hardly shows that number: then
priors settle the scale, held or not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Likelihood
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.insight.identifiability.information import Information
from bayesdrill.insight.identifiability.proving import structure_of
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.identifiability.structure import Exponents
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.vocabulary import PARAMETERS

Array = NDArray[np.float64]

NEAR = 0.5, 1.5  # times what is held: where the structure is looked at
MOSTLY = 0.5  # of a scale, what priors settle; of the largest part, what is named as well


@dataclass(frozen=True, slots=True, kw_only=True)
class Resting:
    """With `exponents` of `names`, of which the last are `held`, no measured signal changes.

    `following (m, m)`: of unknowns, by how much the mean of each log follows the middle of each prior.
    """

    names: tuple[str, ...]
    exponents: Exponents
    held: tuple[str, ...]
    following: Array

    @property
    def unknown(self) -> tuple[str, ...]:
        """Those that are known through what is held."""
        named = zip(self.names, self.exponents, strict=True)
        return tuple(name for name, e in named if e and name not in self.held)

    @property
    def through(self) -> tuple[str, ...]:
        named = zip(self.names, self.exponents, strict=True)
        return tuple(name for name, e in named if e and name in self.held)

    @property
    def narrowest(self) -> str:
        """The unknown that the record narrows most."""
        left = dict(zip(self.names, np.diag(self.following), strict=False))
        return min(self.unknown, key=left.__getitem__)

    def scales(self, names: Sequence[str], exponents: Sequence[float]) -> bool:
        """Whether a product of powers is another where what is held is."""
        own = dict(zip(self.names, self.exponents, strict=True))
        return sum(own[name] * e for name, e in zip(names, exponents, strict=True)) != 0

    def priors(self, names: Sequence[str], exponents: Sequence[float]) -> tuple[str, ...]:
        """Whose priors settle a product of powers that this scales; none where what is held does.

        What priors do together follows them all, and what is held the rest of the way.
        """
        m = len(self.following)
        given = dict(zip(names, exponents, strict=True))
        powers = np.array([given.get(name, 0.0) for name in self.names[:m]])
        scale, follows = np.array(self.exponents[:m]), powers @ self.following
        if follows @ scale / (powers @ scale) < MOSTLY:
            return ()
        large = np.abs(follows) >= MOSTLY * np.abs(follows).max()
        return tuple(name for name, one in zip(self.names, large, strict=False) if one)


def resting(
    posterior: Posterior,
    theta: Array,
    known: Information,
    prior_sd: Array,
    rng: np.random.Generator,
) -> tuple[Resting, ...]:
    """At `theta (D,)`; `rng` draws the points at which the structure is looked at.

    `known` of the record there, `prior_sd (m,)` of the logs.

    Where few are held and many rest on them: who holds most of a rig knows that the rest is told
    through it.
    """
    space, model = posterior.space, posterior.likelihood.observations[0].response.model
    held = tuple(name for name in model.parameters if space.fixed.get(name, 0.0) > 0.0)
    if not held:
        return ()
    first = len(space.columns("rig", "quantity"))
    wider = _freed(posterior, model, held, first)
    at = np.insert(theta, first, [space.fixed[name] for name in held])
    found = structure_of(wider, Scenery(wider.likelihood), at, rng)
    follows = following(known, prior_sd)
    every = (
        Resting(names=found.names, exponents=e, held=held, following=follows)
        for e in found.symmetries
    )
    return tuple(one for one in every if 0 < len(one.through) <= len(one.unknown))


def following(known: Information, prior_sd: Array) -> Array:
    """`(m, m)`: by how much the mean of each log follows the middle of each prior."""
    spread = np.linalg.inv(known.with_priors(prior_sd).root)
    return np.asarray(spread @ spread.T / prior_sd**2)


def _freed(posterior: Posterior, model: Model, held: tuple[str, ...], first: int) -> Posterior:
    """With what is held unknown, behind the rig's other unknowns, of which `first` is the number."""
    space, (low, high) = posterior.space, NEAR
    known = {one.name: one for one in (*PARAMETERS.values(), *model.declares)}
    new = tuple(
        Unknown(
            symbol=known[name],
            role="rig",
            prior=Uniform(low=low * space.fixed[name], high=high * space.fixed[name]),
            start=space.fixed[name],
        )
        for name in held
    )
    wider = dataclasses.replace(
        space,
        unknowns=(*space.unknowns[:first], *new, *space.unknowns[first:]),
        fixed={name: value for name, value in space.fixed.items() if name not in held},
    )
    likelihood = Likelihood.joint(wider, posterior.likelihood.observations)
    return Posterior(space=wider, likelihood=likelihood, coordinates=wider.coordinates())
