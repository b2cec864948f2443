"""Define the likelihood of all records, and the log posterior over unknowns and coordinates.

A `Problem` is a posterior with names and nominal values.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.formulas import Expression
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import SECOND, Unit
from bayesdrill.inference.display_units import SI, DisplayUnits
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.unknowns import SIMULATOR_ROLES, Coordinates, ParameterSpace, Unknown
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import Simulator


@dataclass(frozen=True, slots=True)
class Likelihood:
    """The log likelihood of unknowns `theta (W, D)` is a sum over `observations`, which share them.

    Observations in `held_out` are only predicted, and do not enter the sum.
    """

    observations: tuple[Observation, ...]
    space: ParameterSpace
    held_out: tuple[Observation, ...] = ()

    @classmethod
    def joint(
        cls, space: ParameterSpace, parts: Sequence[Observation], held_out: Collection[str] = ()
    ) -> Likelihood:
        """Return the likelihood of `parts`; those with a label in `held_out` are only predicted."""
        bound = [observation.bind(space) for observation in parts]
        selected = tuple(each for each in bound if each.label not in held_out)
        return cls(selected, space, tuple(each for each in bound if each.label in held_out))

    def __call__(self, theta: Array) -> Array:
        """Return the log likelihood `(W,)` at `theta (W, D)`; NaN where a response overflows."""
        with np.errstate(all="ignore"):
            full = self.space.full(theta)
            parts = [each.by_channel(full, theta) for each in self.observations]
            together = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
            return together.sum(axis=-1)

    @property
    def n_measured(self) -> int:
        """Return the number of measured values in all observations."""
        return sum(observation.n_measured for observation in self.observations)

    def mean_square(self, theta: Array) -> Array:
        """Return mean squared residual / noise variance, `(W,)`, about 1 if only noise remains."""
        full = self.space.full(theta)
        squares = [each.weighted_squares(full, theta) for each in self.observations]
        return np.asarray(np.hstack(squares).sum(axis=-1) / self.n_measured)

    def all_signals(self, theta: Array) -> list[Array]:
        """Return the signals `(W, T, K)` of each observation."""
        full = self.space.full(theta)
        return [observation.signals(full) for observation in self.observations]

    def whitened_residuals(self, theta: Array) -> Array:
        """Return whitened residuals `(n,)` at `theta (D,)`, model minus measured; 0 if missing."""
        full, parts = self.space.full(theta[None]), []
        for observation in self.observations:
            errors = -observation.residuals(full).samples
            parts.append(observation.whitened_jacobian_at(errors, theta).ravel())
        return np.concatenate(parts)

    def rig_parameters(self, theta: Array) -> dict[str, Array]:
        """Return the rig's parameters in the first observation, each `(W,)`, by name."""
        return self.observations[0].rig_parameters(self.space.full(theta))

    @property
    def only_observation(self) -> Observation:
        """Return the only observation; raises `ValueError` if there are several."""
        (observation,) = self.observations
        return observation

    def signals(self, theta: Array) -> Array:
        """Return the noise-free channels `(W, T, K)` of the only observation."""
        return self.only_observation.signals(self.space.full(theta))


@dataclass(frozen=True, slots=True)
class Posterior:
    """The posterior is not normalised: it is a normalised prior times a normalised likelihood.

    `posterior(z)` maps coordinates `(W, D)` to their log density `(W,)`, Jacobian included.  It is
    finite or -inf, and never NaN.  `evaluate` also counts failed simulations.
    """

    space: ParameterSpace
    likelihood: Likelihood
    coordinates: Coordinates

    def edit(
        self,
        *,
        free: Sequence[Unknown] = (),
        records: Sequence[Array] = (),
        convert: Callable[[Observation], Observation] = lambda observation: observation,
    ) -> Posterior:
        """Return the posterior with some parts replaced.

        `free` lists parameters that become unknown.  They were fixed, or `convert` introduces them.
        New unknowns of the rig follow its old ones; other new unknowns precede those of the noise.
        `records` has a record `(T, K)` for each observation.  `convert` replaces each observation,
        also those that are held out; an example is `Observation.for_rig`.
        """
        space = self.space if not free else _with_unknowns(self.space, free)
        observations, held_out = (
            tuple(convert(observation).bind(space) for observation in group)
            for group in (self.likelihood.observations, self.likelihood.held_out)
        )
        if records:
            pairs = zip(observations, records, strict=True)
            observations = tuple(observation.with_record(y) for observation, y in pairs)
        coordinates = self.coordinates if space is self.space else space.coordinates
        return Posterior(space, Likelihood(observations, space, held_out), coordinates)

    def with_simulators(self, simulator_of: Callable[[Observation], Simulator]) -> Posterior:
        """Return the posterior with another simulator for each observation, held out or not."""
        return self.edit(convert=lambda old: dataclasses.replace(old, response=simulator_of(old)))

    def __call__(self, z: Array) -> Array:
        """Return the log density over `z`."""
        return self.evaluate(z)[0]

    def evaluate(self, z: Array) -> tuple[Array, int]:
        """Return log densities `(W,)`, and the number of points inside the prior that fail."""
        theta, log_jacobian = self.coordinates.with_jacobian(z)
        log_p, failures = self._density(theta)
        inside = log_p > -np.inf
        log_p[inside] += log_jacobian[inside]
        return log_p, failures

    def supports(self, z: Array) -> Flags:
        """Return whether the prior density at `z (W, D)` is not zero; nothing is simulated."""
        theta = self.coordinates.to_physical(z)
        return np.asarray(self.space.log_prior(theta) > -np.inf)

    def density(self, theta: Array) -> Array:
        """Return the log density `(W,)` of physical unknowns `(W, D)`, whose maximum is the MAP."""
        return self._density(theta)[0]

    def _density(self, theta: Array) -> tuple[Array, int]:
        log_p = self.space.log_prior(theta)
        log_p[np.isnan(log_p)] = -np.inf
        inside = np.flatnonzero(log_p > -np.inf)  # the model is evaluated inside the prior only
        if len(inside) == 0:
            return log_p, 0
        log_p[inside] += self.likelihood(theta[inside])
        failed = np.isnan(log_p)
        log_p[failed] = -np.inf
        return log_p, int(failed.sum())


def _with_unknowns(space: ParameterSpace, new: Sequence[Unknown]) -> ParameterSpace:
    """Return the space with `new` unknowns, which are no longer among the fixed values."""
    names, old = [unknown.name for unknown in new], space.unknowns
    rig, moving = len(space.columns("rig", "quantity")), len(space.columns(*SIMULATOR_ROLES))
    of_rig = [unknown for unknown in new if unknown.role == "rig"]
    others = [unknown for unknown in new if unknown.role != "rig"]
    return dataclasses.replace(
        space,
        model=(*space.model, *(name for name in names if name not in space.model)),
        unknowns=(*old[:rig], *of_rig, *old[rig:moving], *others, *old[moving:]),
        fixed={name: value for name, value in space.fixed.items() if name not in names},
    )


@dataclass(frozen=True, slots=True)
class Formula:
    """A formula defines a derived quantity of the config."""

    symbol: Symbol
    expression: Expression


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """A problem is a posterior with the symbols, nominal values and units of its unknowns.

    `nominal` maps names to nominal values, SI.  The values of names in `published` come from a
    table.  `tolerance` holds relative tolerances of nominal values, and `derived` the config's
    formulas.  Reports show unknowns and derived quantities in `units`, and times in the unit
    `clock`.  `compared_with` is a noun phrase for the nominal values in sentences.
    """

    posterior: Posterior
    symbols: tuple[Symbol, ...]
    nominal: Mapping[str, float]
    published: frozenset[str] = frozenset()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    derived: tuple[Formula, ...] = ()
    units: DisplayUnits = SI
    clock: Unit = SECOND
    compared_with: str = ""

    @property
    def observations(self) -> tuple[Observation, ...]:
        """Return the observations that enter the likelihood."""
        return self.posterior.likelihood.observations

    @property
    def all_observations(self) -> tuple[Observation, ...]:
        """Return all observations, including those that are held out."""
        return (*self.observations, *self.posterior.likelihood.held_out)

    @property
    def experiment(self) -> Experiment:
        """Return the only record; raises `ValueError` if there are several."""
        return self.posterior.likelihood.only_observation.experiment

    @property
    def model(self) -> Model:
        """Return the rig, which all observations share."""
        return self.observations[0].response.model

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the unknowns."""
        return self.posterior.space.free
