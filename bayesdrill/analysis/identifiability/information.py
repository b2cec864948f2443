"""Compute exact sensitivities of measured signals, and how well they determine unknowns.

A scene is the experiments as they are, or with further channels, or with inputs changed half-way.
What is unknown of sensors and starts is taken out of the sensitivities: what is left of them is
what the record says of the rig, whatever these are, as Fisher information and Cramer-Rao bounds.

All is in the logs of the unknowns, so that a standard deviation of 0.01 is one per cent.  The
information is kept as its square root R (information = R' R): squaring would lose the digits that
tell a badly determined direction from one that is not determined at all.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesdrill.basics.arrays import Array, StoredArray
from bayesdrill.inference.compression import first_samples
from bayesdrill.inference.laplace import natural_sd
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood
from bayesdrill.inference.unknowns import SIMULATOR_ROLES
from bayesdrill.record.experiment import with_states


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignVariant:
    """A change of the experiment that is tried by computing; `beside`: in further ones.

    `extra`: states that are measured too, each with its sigma; `late`: what is added to inputs in
    the second half of each record; `times`: what inputs are multiplied with throughout.
    """

    extra: Mapping[str, float] = field(default_factory=dict)
    late: Mapping[str, float] = field(default_factory=dict)
    times: Mapping[str, float] = field(default_factory=dict)
    beside: bool = False


AS_RECORDED = DesignVariant()
STUDIED_SAMPLES = 16384  # of a long record
LARGEST_SLOPE = 1e100  # over the noise: sums of squares of such numbers are numbers still


class SensitivityStudy:
    """Sensitivities at physical points `theta`; of long records the first samples stand for all."""

    def __init__(self, likelihood: Likelihood) -> None:
        short = [first_samples(o, STUDIED_SAMPLES) for o in likelihood.observations]
        self.likelihood = dataclasses.replace(likelihood, observations=tuple(short))
        self._stages = tuple(
            _ExtendedExperiment(new, len(old.experiment.t) / len(new.experiment.t))
            for old, new in zip(likelihood.observations, short, strict=True)
        )
        self.model = likelihood.observations[0].response.model
        self.states, self.inputs = self.model.states, self.model.inputs
        space = likelihood.space
        moving = [space.unknowns[k] for k in space.columns(*SIMULATOR_ROLES)]
        self.unknowns = tuple(u.name for u in moving if u.role in ("rig", "quantity"))
        self.nuisances = tuple(u.name for u in moving if u.role not in ("rig", "quantity"))
        self.prior_spreads = np.array([natural_sd(u) for u in moving])
        self.known = 1.0 / self.prior_spreads[len(self.unknowns) :]

    def mean_input(self, name: str) -> float:
        """Return the mean of an input over the records."""
        means = [each.constant.get(name, 0.0) + each.base[name].mean() for each in self._stages]
        return float(np.mean(means))

    def rig_at(self, theta: Array) -> dict[str, float]:
        """Return the rig's parameters at `theta (D,)`, by name."""
        return {name: x[0] for name, x in self.likelihood.rig_parameters(theta[None]).items()}

    def sensitivities(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> Array:
        """Return d channel / d log unknown over sigma at `theta (D,)`: `(n, m)`.

        What nuisances explain of them, as freely as their priors allow, is taken away.
        """
        rows, m = self.with_nuisances(theta, scene), len(self.unknowns)
        if not self.nuisances:
            return rows
        return project_out(self._with_priors(rows, m), m)

    def local_estimate(self, rows: Array, residuals: Array) -> tuple[Array, Array]:
        """Return the information of rows `(n, m + k)`, and where their `residuals (n,)` lead.

        `R (m, m)` and `b (m,)`: these rows alone know the rig's unknowns as `R' R`, and would move
        them by `R^-1 b`, whatever the nuisances are.
        """
        m = len(self.unknowns)
        matrix = self._with_priors(np.insert(rows, m, residuals, axis=1), m + 1)
        reduced = project_out(matrix, m + 1)
        return reduced[:m, :m], reduced[:m, m]

    def _with_priors(self, rows: Array, before: int) -> Array:
        priors = np.hstack([np.zeros((len(self.known), before)), np.diag(self.known)])
        return np.vstack([rows, priors])

    def with_nuisances(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> Array:
        """Return sensitivities `(n, m + k)` to nuisances as well, on their natural scale.

        A number whose slopes overflow tells nothing: its row is zero.
        """
        parts = self.by_experiment(theta, scene)
        if scene.beside:
            parts = [*self.by_experiment(theta), *parts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def by_experiment(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> list[Array]:
        """Return `with_nuisances` of each experiment by itself."""
        both = self._full_and_slopes(theta)
        return [stage.whitened(*both, theta, scene) for stage in self._stages]

    def motions(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> list[Array]:
        """Return the states of each experiment, `(T, X)`."""
        both = self._full_and_slopes(theta)
        return [stage.course(*both, scene)[0][:, stage.k :] for stage in self._stages]

    def _full_and_slopes(self, theta: Array) -> tuple[Array, Array]:
        space = self.likelihood.space
        return space.full(theta[None]), space.slopes(theta[None])


def project_out(rows: Array, m: int) -> Array:
    """Project the last k columns of `rows (n, m + k)` out of the first m: `(m, m)`."""
    k = rows.shape[1] - m
    remaining = np.linalg.qr(np.hstack([rows[:, m:], rows[:, :m]]), mode="r")[k:, k:]
    return np.asarray(np.vstack([remaining, np.zeros((m - len(remaining), m))]))


class _ExtendedExperiment:
    """One experiment with its states for further channels, whose inputs can all be changed."""

    def __init__(self, observation: Observation, repeats: float) -> None:
        self._repeats = repeats  # of the record, as far as what is known goes
        model, experiment = observation.response.model, observation.experiment
        self._one, self._states, self.k = observation, model.states, len(experiment.channels)
        n, self.constant = len(experiment.t), experiment.constant
        self.base = {name: experiment.series.get(name, np.zeros(n)) for name in model.inputs}
        self._late = (np.arange(n) >= n // 2).astype(float)
        shown = with_states(experiment, model.states)
        self._response = observation.response.of(dataclasses.replace(shown, series=self.base))
        # Of the inputs of the record: the last point, and its course.
        self._recorded: tuple[bytes, tuple[Array, Array]] | None = None

    def whitened(self, full: Array, along: Array, theta: Array, scene: DesignVariant) -> Array:
        """Rows over the noise, zero where nothing was measured: `(n, m + k)`."""
        slopes = self.course(full, along, scene)[1]
        rows = self._one.whitened_jacobian_at(slopes[:, :, : self.k], theta)
        if scene.extra:
            more = slopes[:, :, [self.k + self._states.index(name) for name in scene.extra]]
            rows = np.concatenate([rows, more / np.array([*scene.extra.values()])], axis=2)
        rows = rows.reshape(len(rows), -1).T * math.sqrt(self._repeats)
        readable = (np.abs(rows) < LARGEST_SLOPE).all(axis=1)
        return np.where(readable[:, None], rows, 0.0)

    def course(self, full: Array, along: Array, scene: DesignVariant) -> tuple[Array, Array]:
        """Signals `(T, K + X)` and slopes `(q, T, K + X)`, not to be written to.

        Many look at one point with the inputs of the record: that course is kept until the next.
        """
        arguments = self._one.simulator_parameters
        at = (arguments(full), arguments(along))
        if scene.late or scene.times:
            pushed = {}
            for name, u in self.base.items():
                more = (scene.times.get(name, 1.0) - 1.0) * (u + self.constant.get(name, 0.0))
                pushed[name] = np.asarray(u + more + scene.late.get(name, 0.0) * self._late)
            scene_record = dataclasses.replace(self._response.experiment, series=pushed)
            signals, slopes = self._response.of(scene_record).course(*at)
            return signals[0], slopes[0]
        point = b"".join(each.tobytes() for each in at)
        if self._recorded is None or self._recorded[0] != point:
            course = tuple(each[0] for each in self._response.course(*at))
            for each in course:
                each.flags.writeable = False
            self._recorded = point, (course[0], course[1])
        return self._recorded[1]


RANK_TOLERANCE = 1e-11  # of the largest singular value; exact nulls come out at 1e-16
# share of a direction that may lie in the blind ones before its bound is infinite
BLIND_SHARE = 1e-6
MAX_FACTORS = 3  # in a simple product


@dataclass(frozen=True, slots=True)
class Information:
    """The information of a record about the logs of `names`, as its root `(m, m)`."""

    names: tuple[str, ...]
    root: StoredArray

    def bound(self, exponents: Array) -> float:
        """Return the Cramer-Rao bound of the log of a product of powers; inf if not determined."""
        return float(self.bounds_of(exponents[None])[0])

    def bounds(self) -> Array:
        """Return the bound of each unknown, `(m,)`."""
        return self.bounds_of(np.eye(len(self.names)))

    def bounds_of(self, exponents: Array) -> Array:
        """Return the bounds of many products, `(n, m) -> (n,)`."""
        _, values, rows = np.linalg.svd(self.root)
        determined = values > RANK_TOLERANCE * values[0]
        along = exponents @ rows.T
        hidden = np.linalg.norm(along[:, ~determined], axis=1)
        known = np.linalg.norm(along[:, determined] / values[determined], axis=1)
        return np.where(hidden > BLIND_SHARE * np.linalg.norm(exponents, axis=1), np.inf, known)

    def with_knowledge(self, exponents: Array, sd: float) -> Information:
        """Add that the log of a product of powers is known to `sd` from elsewhere."""
        return Information(self.names, root_of(np.vstack([self.root, exponents / sd])))

    def with_priors(self, sd: Array) -> Information:
        """Add priors, taken as Gaussian in the logs, with these standard deviations `(m,)`."""
        return Information(self.names, root_of(np.vstack([self.root, np.diag(1.0 / sd)])))

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The sloppy spectrum: independent products, from the best determined to the worst."""
        _, values, rows = np.linalg.svd(self.root)
        spectrum = []
        for value, row in zip(values, rows, strict=True):
            largest = row[np.argmax(np.abs(row))]
            blind = value <= RANK_TOLERANCE * values[0]
            sd = float("inf") if blind else float(1.0 / (value * np.abs(largest)))
            spectrum.append(Direction(exponents=tuple(map(float, row / largest)), sd=sd))
        return tuple(spectrum)

    @property
    def n_blind(self) -> int:
        """The number of independent products of which the record says nothing."""
        values = np.linalg.svd(self.root, compute_uv=False)
        return int(np.sum(values <= RANK_TOLERANCE * values[0]))


def from_sensitivities(names: tuple[str, ...], sensitivities: Array) -> Information:
    """Build the information of d signal / d log unknown over sigma, `(n, m)`."""
    return Information(names, root_of(sensitivities))


def root_of(rows: Array) -> Array:
    """Reduce rows `(n, m)` to `(m, m)` with the same `rows' rows`."""
    m = rows.shape[1]
    reduced = np.linalg.qr(rows, mode="r")
    return np.asarray(np.vstack([reduced, np.zeros((m - len(reduced), m))]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """A principal direction, its largest exponent 1; `sd`: bound of the log, inf where it is blind."""

    exponents: tuple[float, ...]
    sd: float


def simple_exponents(m: int) -> Array:
    """Return all products of up to three unknowns with exponents up to 2, the first positive."""
    rows = []
    for size in range(1, min(MAX_FACTORS, m) + 1):
        for places in itertools.combinations(range(m), size):
            for powers in itertools.product((1, -1, 2, -2), repeat=size):
                if powers[0] > 0 and math.gcd(*powers) == 1:
                    row = np.zeros(m)
                    row[list(places)] = powers
                    rows.append(row)
    return np.array(rows)
