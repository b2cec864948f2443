"""Estimate the missing torque over time, and find what it follows: speed, angle, input, or time.

For each draw of the unknowns, a torque is drawn given the whole record.  It is first drawn from the
prior; then the smoother estimates a correction from the record minus the signals of this torque.  The
draws are thus from the joint posterior of unknowns and torque, and their band has both uncertainties.

The torque is then regressed on candidates by least squares, at the times at which the inertia turns.
Candidates are selected one by one, while the next explains enough of the remaining squares.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.likelihood import LatentTorqueObservation, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.models.latent_torque import TORQUE, LoadedModel, TorqueLocation
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import ROTARY, InertiaRoles
from bayesdrill.rig.simulators import simulator

STANDSTILL = 0.05  # speed divided by its root mean square, below which an inertia stands still
MIN_TURNING_SHARE = 0.05  # if the inertia turns at a smaller fraction of samples, all are used
TAILS = (0.5 - HDI_PROBABILITY / 2, 0.5 + HDI_PROBABILITY / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelMotion:
    """The missing torque explains a part of the motion of a channel, SI.

    `spread` is the sd of the channel.  At the mean of the draws, `without` is the rms of residuals
    without the torque, `left` that with the torque, and `moved` the rms of the torque's effect.
    `strayed` is the error of linearising the torque's effect, in sds of noise; NaN for a linear rig.
    """

    channel: str
    spread: float
    without: float
    left: float
    moved: float
    strayed: float

    @property
    def share(self) -> float:
        """Return the torque's effect divided by the spread of the channel."""
        return self.moved / self.spread if self.spread > 0 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueEstimate:
    """The missing torque of one experiment is estimated at its times `t (T,)`.

    `draws (N, T)` are torques [N m], and `expected (T,)` is the mean of the smoothed torques.  `states`
    maps names of the rig's states to their means `(T,)` over draws; `inputs` are measured.  Both are SI.
    """

    label: str
    location: TorqueLocation
    t: Array
    draws: Array
    expected: Array
    states: Mapping[str, Array]
    inputs: Mapping[str, Array]
    courses: tuple[ChannelMotion, ...]
    rig: Model

    @property
    def band(self) -> Array:
        """Return the central band `(2, T)` of the draws, with the same probability as an HDI."""
        return np.asarray(np.quantile(self.draws, TAILS, axis=0))

    @property
    def inertia(self) -> InertiaRoles:
        """Return the inertia on which the torque acts."""
        return self.rig.roles.inertia(self.location)

    @property
    def turning(self) -> Flags:
        """Return the samples `(T,)` at which the inertia turns, or all if it hardly ever does."""
        speed = self.speeds[0][1]
        fast = np.abs(speed) > STANDSTILL * np.sqrt(np.mean(speed**2))
        return fast if fast.mean() > MIN_TURNING_SHARE else np.ones(len(self.t), dtype=bool)

    @property
    def angle(self) -> Array:
        """Return the angle `(T,)` of the inertia on which the torque acts."""
        return self.states[self.inertia.angle] * (1.0 / self.inertia.reduction)

    @property
    def turned(self) -> list[InertiaRoles]:
        """Return one inertia for each known speed; the inertia with the torque comes first."""
        inertias: dict[str, InertiaRoles] = {}
        for inertia in (self.inertia, *self.rig.roles.inertias):
            if inertia.speed in self.states:
                inertias.setdefault(inertia.speed, inertia)
        return [*inertias.values()]

    @property
    def speeds(self) -> list[tuple[str, Array]]:
        """Return the speed state of each inertia in `turned`, and its values `(T,)`."""
        return [(i.speed, self.states[i.speed] * (1.0 / i.reduction)) for i in self.turned]


def torque_estimates(
    posterior: Posterior, draws: Array, rng: np.random.Generator
) -> tuple[TorqueEstimate, ...]:
    """Estimate the missing torque of each experiment that has one, by draws `(N, D)`."""
    full = posterior.space.full(draws)
    missing = [each for each in posterior.likelihood.observations if each.torque]
    return tuple(_estimate(observation, full, draws, rng) for observation in missing)


def is_approximate(posterior: Posterior) -> bool:
    """Return whether a torque is missing in a rig that is not linear."""
    observations = posterior.likelihood.observations
    return any(each.torque and not each.response.model.smooth for each in observations)


def _estimate(
    observation: Observation, full: Array, draws: Array, rng: np.random.Generator
) -> TorqueEstimate:
    torque = observation.torque
    assert torque is not None
    experiment = observation.experiment
    signals, motion = observation.signals(full), observation.states(full)  # without the torque
    residuals = experiment.y - signals
    smooth = torque.smooth(residuals, draws)
    drawn, _ = torque.sample_states(residuals, draws, rng)
    augmented = torque.kalman_filter.augmented
    sizes = torque.sizes(draws)[:, :1]
    index = augmented.states.index(TORQUE)
    by_torque = smooth @ torque.kalman_filter.output_matrix.T
    pushed, linear = sizes[0] * smooth[0, :, index], signals[0] + by_torque[0]
    strayed = _nonlinear_error(observation, pushed, linear, full[:1], draws[:1])
    return TorqueEstimate(
        label=observation.label,
        location=augmented.torque.at,
        t=np.asarray(experiment.t),
        draws=sizes * drawn[:, :, index],
        expected=(sizes * smooth[:, :, index]).mean(axis=0),
        states=_states(observation, torque, motion.mean(axis=0), smooth.mean(axis=0)),
        inputs={name: np.asarray(u) for name, u in experiment.series.items()},
        courses=_courses(observation, residuals.mean(axis=0), by_torque.mean(axis=0), strayed),
        rig=augmented.rig,
    )


def _states(
    observation: Observation, torque: LatentTorqueObservation, motion: Array, more: Array
) -> dict[str, Array]:
    """Return the states `(T,)` with the torque's effect; an unobservable angle is integrated."""
    augmented, t = torque.kalman_filter.augmented, np.asarray(observation.experiment.t)
    states = {name: motion[:, k] for k, name in enumerate(augmented.rig.states)}
    for name, moved in augmented.to_rig_states(more).items():
        states[name] = states[name] + moved
    if not augmented.observable:
        for name in augmented.rig.angles:
            speed = augmented.roles.speeds.get(name)
            if speed in augmented.states:
                change = more[:, augmented.states.index(speed)]
                turned = scipy.integrate.cumulative_trapezoid(change, t, initial=0.0)
                states[name] = states[name] + turned
    series, imposed = observation.experiment.series, {*augmented.roles.speeds.values()}
    return states | {name: np.asarray(u) for name, u in series.items() if name in imposed}


def _nonlinear_error(
    observation: Observation, torque: Array, linear: Array, full: Array, theta: Array
) -> Array:
    """Return the rms error `(K,)` of a `linear (T, K)` prediction, in sds of noise; NaN if exact.

    The prediction for `torque (T,)` assumes that friction keeps its sign, and pendulums are springs.
    """
    response, experiment = observation.response, observation.experiment
    assert observation.torque is not None  # the caller estimates it
    if response.model.smooth:
        return np.full(len(experiment.channels), np.nan)
    held = torque if experiment.first_order else 0.5 * (torque + np.append(torque[1:], torque[-1]))
    loaded = LoadedModel(response.model, observation.torque.kalman_filter.torque)
    record = dataclasses.replace(experiment, series={**experiment.series, TORQUE: held})
    pushed = simulator(loaded, record, response.sensing, *(response.stepping or ()))
    signals = pushed.signals(observation.simulator_parameters(full))[0]
    errors = (signals - linear) / observation.scales(theta)[0]
    return np.sqrt(np.nanmean(np.where(experiment.is_measured, errors, np.nan) ** 2, axis=0))


def _courses(
    observation: Observation, residuals: Array, moved: Array, strayed: Array
) -> tuple[ChannelMotion, ...]:
    return tuple(
        ChannelMotion(
            channel=observation.experiment.names[k],
            spread=float(observation.experiment.y[sampled, k].std()),
            without=_size(residuals[sampled, k]),
            left=_size(residuals[sampled, k] - moved[sampled, k]),
            moved=_size(moved[sampled, k]),
            strayed=float(strayed[k]),
        )
        for k, sampled in enumerate(observation.experiment.is_measured.T)
    )


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


MIN_SHARE_OF_REST = 0.3  # smallest fraction of remaining squares that a selected candidate explains
MIN_SHARE = 0.1  # smallest fraction of all squares that a selected candidate explains
CONSTANT_RATIO = 1e-9  # a candidate whose values stay below this limit counts as zero


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueRegression:
    """The torque is regressed on the function `kind` of the quantity `of`: a speed, an angle, an input.

    Alone, the function explains a `share` of the squares of the torque.  If it is `taken` into the
    joint regression, `size` is its coefficient [N m per SI unit], or the amplitude for an angle.  `sd`
    is the sd of `size` over the draws.
    """

    kind: str
    of: str
    share: float
    taken: bool = False
    size: float = 0.0
    sd: float = 0.0


def regress_torque(estimate: TorqueEstimate) -> tuple[TorqueRegression, ...]:
    """Regress the torque on candidates; return those selected, in their order, then the others."""
    turning = estimate.turning
    regressors = [
        (kind, name, rows[turning])
        for kind, name, rows in _candidates(estimate)
        if np.isfinite(rows[turning]).all() and np.abs(rows[turning]).max() > CONSTANT_RATIO
    ]
    torque = estimate.expected[turning]
    total = float(torque @ torque)
    if total == 0.0 or not regressors:
        return ()
    alone = [1.0 - _residual_squares(torque, rows) / total for _, _, rows in regressors]
    selected: list[int] = []
    remaining, rows = total, np.empty((len(torque), 0))
    while others := [k for k in range(len(regressors)) if k not in selected]:
        joint = [np.column_stack([rows, regressors[k][2]]) for k in others]
        squares = {k: _residual_squares(torque, x) for k, x in zip(others, joint, strict=True)}
        best = min(squares, key=lambda k: squares[k])
        if remaining - squares[best] < max(MIN_SHARE_OF_REST * remaining, MIN_SHARE * total):
            break
        selected.append(best)
        remaining, rows = squares[best], np.column_stack([rows, regressors[best][2]])
    regressions = [
        TorqueRegression(kind=kind, of=of, share=share)
        for (kind, of, _), share in zip(regressors, alone, strict=True)
    ]
    if selected:
        weights = np.linalg.lstsq(rows, estimate.draws[:, turning].T, rcond=None)[0]  # (rows, N)
        ends = np.cumsum([regressors[k][2].shape[1] for k in selected])[:-1]
        for k, sizes in zip(selected, np.split(weights, ends), strict=True):
            size = sizes[0] if len(sizes) == 1 else np.linalg.norm(sizes, axis=0)
            mean, sd = float(size.mean()), float(size.std())
            regressions[k] = dataclasses.replace(regressions[k], taken=True, size=mean, sd=sd)
    others = sorted({*range(len(alone))} - {*selected}, key=lambda k: -alone[k])
    return tuple(regressions[k] for k in (*selected, *others))


def _candidates(estimate: TorqueEstimate) -> Iterator[tuple[str, str, Array]]:
    for name, speed in estimate.speeds:
        yield "sign", name, np.sign(speed)[:, None]
        yield "speed", name, speed[:, None]
        yield "square", name, (speed * np.abs(speed))[:, None]
    if estimate.rig.roles.motion == ROTARY:
        turn = estimate.angle[:, None]
        yield "turn", estimate.inertia.angle, np.column_stack([np.cos(turn), np.sin(turn)])
    for name, values in estimate.inputs.items():
        if name not in estimate.states:
            yield "input", name, values[:, None]
    yield "constant", "", np.ones((len(estimate.t), 1))
    yield "drift", "", (estimate.t - estimate.t.mean())[:, None]


def _residual_squares(torque: Array, rows: Array) -> float:
    weights = np.linalg.lstsq(rows, torque, rcond=None)[0]
    residuals = torque - rows @ weights
    return float(residuals @ residuals)
