"""Compute exact sensitivities of measured signals, and how well they determine unknowns.

A `DesignVariant` describes the experiments with further channels, or with other inputs.  Unknowns of
sensors and starts are nuisances, which are projected out of the sensitivities.  The remainder gives
Fisher information on the rig and Cramer-Rao bounds.

Everything is in the logs of the unknowns, so a standard deviation of 0.01 is one per cent.  The
information is kept as its square root R, with information R' R.  Squaring would lose the digits that
distinguish a badly determined direction from an undetermined one.
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
from bayesdrill.record.experiment import channels_first, with_states


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignVariant:
    """A design variant changes the experiments, or adds changed copies if `keeps_original` is true.

    `extra` maps further measured states to their sigma, SI.  `shifts` are added to inputs in the second
    half of each record, and `factors` multiply them throughout.
    """

    extra: Mapping[str, float] = field(default_factory=dict)
    shifts: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    keeps_original: bool = False


AS_RECORDED = DesignVariant()
STUDIED_SAMPLES = 16384  # largest number of samples of a record that are studied
LARGEST_SLOPE = 1e100  # limit of whitened derivatives, so that sums of squares do not overflow


class SensitivityStudy:
    """A study computes sensitivities to m unknowns and k nuisances.

    Only the first `samples` of each record are studied; their information is scaled to the whole record.
    """

    def __init__(self, likelihood: Likelihood, samples: int = STUDIED_SAMPLES) -> None:
        short = [first_samples(o, samples) for o in likelihood.observations]
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
        means = [stage.constant.get(name, 0.0) + stage.base[name].mean() for stage in self._stages]
        return float(np.mean(means))

    def rig_at(self, theta: Array) -> dict[str, float]:
        """Return the rig's parameters at `theta (D,)`, by name."""
        return {name: x[0] for name, x in self.likelihood.rig_parameters(theta[None]).items()}

    def sensitivities(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> Array:
        """Return (d channel / d log unknown) / sigma at `theta (D,)`, `(n, m)`.

        Nuisances are projected out, with their priors as additional information.
        """
        rows, m = self.with_nuisances(theta, scene), len(self.unknowns)
        if not self.nuisances:
            return rows
        return project_out(self._with_priors(rows, m), m)

    def local_estimate(self, rows: Array, residuals: Array) -> tuple[Array, Array]:
        """Return `R (m, m)` and `b (m,)` of `rows (n, m + k)` with `residuals (n,)`.

        These rows have the information `R' R` on the rig's unknowns, and their Gauss-Newton step is
        `R^-1 b`.  Nuisances are projected out.
        """
        m = len(self.unknowns)
        matrix = self._with_priors(np.insert(rows, m, residuals, axis=1), m + 1)
        reduced = project_out(matrix, m + 1)
        return reduced[:m, :m], reduced[:m, m]

    def _with_priors(self, rows: Array, before: int) -> Array:
        priors = np.hstack([np.zeros((len(self.known), before)), np.diag(self.known)])
        return np.vstack([rows, priors])

    def with_nuisances(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> Array:
        """Return sensitivities `(n, m + k)` to unknowns and nuisances, on their natural scales.

        The row of a sample is zero if its derivatives exceed `LARGEST_SLOPE`.
        """
        parts = self.by_experiment(theta, scene)
        if scene.keeps_original:
            parts = [*self.by_experiment(theta), *parts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def changes(self, theta: Array, points: Array) -> Array:
        """Return whitened changes `(N, n)` of all signals from `theta (D,)` to `points (N, D)`.

        `with_nuisances` returns the derivatives of these changes at `theta`.
        """
        observations, parts = self.likelihood.observations, []
        moved = self.likelihood.all_signals(np.vstack([theta, points]))
        for stage, observation, signals in zip(self._stages, observations, moved, strict=True):
            rows = observation.whitened_jacobian_at(signals[1:] - signals[0], theta)
            parts.append(rows.reshape(len(points), -1) * math.sqrt(stage.repeats))
        return np.concatenate(parts, axis=1)

    def by_experiment(self, theta: Array, scene: DesignVariant = AS_RECORDED) -> list[Array]:
        """Return the rows of `with_nuisances` for each experiment."""
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
    """Project the last k columns of `rows (n, m + k)` out of the first m; return the root `(m, m)`."""
    k = rows.shape[1] - m
    remaining = np.linalg.qr(np.hstack([rows[:, m:], rows[:, :m]]), mode="r")[k:, k:]
    return np.asarray(np.vstack([remaining, np.zeros((m - len(remaining), m))]))


class _ExtendedExperiment:
    """An experiment is extended by all states as channels, and all inputs as series."""

    def __init__(self, observation: Observation, repeats: float) -> None:
        self.repeats = repeats  # the length of the record divided by that of its excerpt
        model, experiment = observation.response.model, observation.experiment
        self._one, self._states, self.k = observation, model.states, len(experiment.channels)
        n, self.constant = len(experiment.t), experiment.constant
        self.base = {name: experiment.series.get(name, np.zeros(n)) for name in model.inputs}
        self._late = (np.arange(n) >= n // 2).astype(float)
        self._states_alone = observation.response.sensing.empty
        shown = with_states(experiment, model.states, alone=self._states_alone)
        self._response = observation.response.of(dataclasses.replace(shown, series=self.base))
        # Cache: the last point with the inputs of the record, and its signals and their derivatives.
        self._recorded: tuple[bytes, tuple[Array, Array]] | None = None

    def whitened(self, full: Array, directions: Array, theta: Array, scene: DesignVariant) -> Array:
        """Return whitened rows `(n, m + k)`, which are zero where nothing was measured."""
        slopes = self.course(full, directions, scene)[1]
        rows = self._one.whitened_jacobian_at(slopes[:, :, : self.k], theta)
        if scene.extra:
            more = slopes[:, :, [self.k + self._states.index(name) for name in scene.extra]]
            rows = np.concatenate([rows, more / np.array([*scene.extra.values()])], axis=2)
        rows = rows.reshape(len(rows), -1).T * math.sqrt(self.repeats)
        readable = (np.abs(rows) < LARGEST_SLOPE).all(axis=1)
        return np.where(readable[:, None], rows, 0.0)

    def course(self, full: Array, directions: Array, scene: DesignVariant) -> tuple[Array, Array]:
        """Return signals `(T, K + X)` and their derivatives `(q, T, K + X)`.

        With the inputs of the record, the arrays are read-only and cached for the last point.
        """
        at = [self._one.simulator_parameters(parameters) for parameters in (full, directions)]
        point, response = b"".join(map(bytes, at)), self._response
        changed = bool(scene.shifts or scene.factors)
        if changed:
            pushed = {}
            for name, u in self.base.items():
                more = (scene.factors.get(name, 1.0) - 1.0) * (u + self.constant.get(name, 0.0))
                pushed[name] = np.asarray(u + more + scene.shifts.get(name, 0.0) * self._late)
            response = response.of(dataclasses.replace(response.experiment, series=pushed))
        elif self._recorded is not None and self._recorded[0] == point:
            return self._recorded[1]
        both = (array[0] for array in response.course(*at))
        if self._states_alone:
            both = (channels_first(self._one.experiment, self._states, each) for each in both)
        signals, slopes = both
        if not changed:
            signals.flags.writeable = slopes.flags.writeable = False
            self._recorded = point, (signals, slopes)
        return signals, slopes


RANK_TOLERANCE = 1e-11  # singular value divided by the largest, below which it counts as zero
# Relative norm of exponents in undetermined directions, above which the bound of a product is infinite.
BLIND_SHARE = 1e-6
MAX_FACTORS = 3  # largest number of factors of a simple product


@dataclass(frozen=True, slots=True)
class Information:
    """The information of a record on the logs of unknowns `names` is R' R, where R is `root (m, m)`."""

    names: tuple[str, ...]
    root: StoredArray

    def bound(self, exponents: Array) -> float:
        """Return the Cramer-Rao bound of the log of a product of powers; inf if not determined."""
        return float(self.bounds_of(exponents[None])[0])

    def bounds(self) -> Array:
        """Return the bound of each unknown, `(m,)`."""
        return self.bounds_of(np.eye(len(self.names)))

    def bounds_of(self, exponents: Array) -> Array:
        """Return the bounds `(n,)` of products with `exponents (n, m)`."""
        _, values, rows = np.linalg.svd(self.root)
        determined = values > RANK_TOLERANCE * values[0]
        along = exponents @ rows.T
        hidden = np.linalg.norm(along[:, ~determined], axis=1)
        known = np.linalg.norm(along[:, determined] / values[determined], axis=1)
        return np.where(hidden > BLIND_SHARE * np.linalg.norm(exponents, axis=1), np.inf, known)

    def with_knowledge(self, exponents: Array, sd: float) -> Information:
        """Return the information if the log of a product of powers is also known to `sd`."""
        return Information(self.names, root_of(np.vstack([self.root, exponents / sd])))

    def with_priors(self, sd: Array) -> Information:
        """Return the information with Gaussian priors of the logs that have the sds `sd (m,)`."""
        return Information(self.names, root_of(np.vstack([self.root, np.diag(1.0 / sd)])))

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Return the principal directions, from the best determined to the worst."""
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
        """Return the number of independent products that the record does not determine."""
        values = np.linalg.svd(self.root, compute_uv=False)
        return int(np.sum(values <= RANK_TOLERANCE * values[0]))


def from_sensitivities(names: tuple[str, ...], sensitivities: Array) -> Information:
    """Return the information of sensitivities (d signal / d log unknown) / sigma, `(n, m)`."""
    return Information(names, root_of(sensitivities))


def root_of(rows: Array) -> Array:
    """Reduce rows `(n, m)` to `(m, m)` with the same `rows' rows`."""
    m = rows.shape[1]
    reduced = np.linalg.qr(rows, mode="r")
    return np.asarray(np.vstack([reduced, np.zeros((m - len(reduced), m))]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """A principal direction is scaled to a largest exponent of 1; its bound `sd` may be infinite."""

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
