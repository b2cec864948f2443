"""The missing torque as the posterior has it over time, and what it follows: a speed, an angle, an
input, the time.

Each draw of the unknowns has a torque of its own, drawn with all samples known (by simulation: a
torque drawn from its prior, and what all samples say of the difference), so that the draws are
those of unknowns and torque together, and a band of them holds what is uncertain of both.

Each is held against the torque by itself, by least squares, where its inertia turns.  The one that
explains most is taken first, then what takes most of what is left, as long as that is a good part of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.likelihood import LatentTorque, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import of_states
from bayesdrill.rig.models.latent_torque import TORQUE, At, Loaded, angles
from bayesdrill.rig.models.linear import USUAL, Roles
from bayesdrill.rig.simulators import simulator

STILL = 0.05  # of the root mean square of a speed: slower is standing still
HARDLY = 0.05  # of all samples
TAILS = (0.5 - HDI_PROBABILITY / 2, 0.5 + HDI_PROBABILITY / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """What a channel did: its spread, and root mean squares of what is left without the torque and
    with it, at the mean of the draws, SI; `moved`: what the torque moves; `strayed`: of a rig that rubs,
    how far from all that it would be with this torque as an input, in sd of the noise (NaN elsewhere).
    """

    channel: str
    spread: float
    without: float
    left: float
    moved: float
    strayed: float

    @property
    def share(self) -> float:
        """Of the motion: what the torque moves, over the spread of the channel."""
        return self.moved / self.spread if self.spread > 0 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaking:
    """Of one experiment, at its times `t (T,)`: `draws (N, T)` of the torque [N m], `expected
    (T,)` their mean without the chance of drawing.

    `states`: of the rig, angles [rad] and speeds [rad/s] among them, `(T,)` by name, means of the draws;
    `inputs`: those that were measured; `gear`: the motor turns so many times as fast as its side
    of the shaft.
    """

    label: str
    at: At
    t: Array
    draws: Array
    expected: Array
    states: Mapping[str, Array]
    inputs: Mapping[str, Array]
    courses: tuple[Course, ...]
    gear: float
    roles: Roles = USUAL

    @property
    def band(self) -> Array:
        """`(2, T)`."""
        return np.asarray(np.quantile(self.draws, TAILS, axis=0))

    @property
    def speed(self) -> Array:
        """Of the inertia on which it acts, of the motor by itself."""
        return self.speeds[0][1]

    @property
    def turning(self) -> Flags:
        """`(T,)`: where that is no standstill, at which dry friction may be anything; all of a record
        that hardly has another.
        """
        fast = np.abs(self.speed) > STILL * np.sqrt(np.mean(self.speed**2))
        return fast if fast.mean() > HARDLY else np.ones(len(self.t), dtype=bool)

    @property
    def angle(self) -> Array:
        """Of the same."""
        own = self.states[self.roles.at(self.at).angle]
        return own * self.gear if self.at == "motor" else own

    @property
    def speeds(self) -> list[tuple[str, Array]]:
        """By name, its own first; of the motor by itself."""
        motor, rotor = self.roles.motor.speed, self.roles.rotor.speed
        names = (motor, rotor) if self.at == "motor" else (rotor, motor)
        gears = {motor: self.gear}
        return [(n, self.states[n] * gears.get(n, 1.0)) for n in names if n in self.states]


def shakings(posterior: Posterior, draws: Array, rng: np.random.Generator) -> tuple[Shaking, ...]:
    """Of each experiment, by draws `(N, D)`; empty where no torque is missing."""
    every = posterior.likelihood.observations
    return tuple(_of(one, torque, posterior, draws, rng) for one in every if (torque := one.torque))


def rubs_besides(posterior: Posterior) -> bool:
    """Whether a torque is missing of a rig that rubs, which is an approximation."""
    every = posterior.likelihood.observations
    return any(one.torque and _rubs(one) for one in every)


def _rubs(one: Observation) -> bool:
    return bool(one.response.model.frictions)


def _of(
    one: Observation,
    found: LatentTorque,
    posterior: Posterior,
    draws: Array,
    rng: np.random.Generator,
) -> Shaking:
    full = posterior.space.full(draws)
    experiment = one.experiment
    signals, motion = _moved(one, full)
    left = experiment.y - signals
    smooth = found.smooth(left, draws)
    drawn, _ = found.sample_states(left, draws, rng)
    made = found.kalman_filter.pushed
    sizes = found.sizes(draws)[:, :1]
    place = made.states.index(TORQUE)
    by_torque = smooth @ found.kalman_filter.weights.T
    first = full[:1], draws[:1]
    pushed = sizes[0] * smooth[0, :, place]
    strayed = _strayed(one, found, first, signals[0] + by_torque[0], pushed)
    return Shaking(
        label=one.label,
        at=made.torque.at,
        t=np.asarray(experiment.t),
        draws=sizes * drawn[:, :, place],
        expected=(sizes * smooth[:, :, place]).mean(axis=0),
        states=_states(one, found, motion.mean(axis=0), smooth.mean(axis=0)),
        inputs={name: np.asarray(u) for name, u in experiment.series.items()},
        courses=_courses(one, left.mean(axis=0), by_torque.mean(axis=0), strayed),
        gear=1.0 / made.gear_ratio,
        roles=made.roles,
    )


def _moved(one: Observation, full: Array) -> tuple[Array, Array]:
    """Channels `(N, T, K)` and states `(N, T, X)` without the torque."""
    experiment, k = one.experiment, len(one.experiment.channels)
    every = of_states(one.response.model.states)
    shown = dataclasses.replace(
        experiment,
        y=np.zeros((len(experiment.t), k + len(every))),
        channels=(*experiment.channels, *every),
    )
    signals = one.response.of(shown).signals(one.simulator_parameters(full))
    return signals[..., :k], signals[..., k:]


def _states(one: Observation, torque: LatentTorque, motion: Array, more: Array) -> dict[str, Array]:
    """With what the torque moves; an angle of which nothing tells follows from its speed."""
    made, t = torque.kalman_filter.pushed, np.asarray(one.experiment.t)
    found = {name: motion[:, k] for k, name in enumerate(made.rig.states)}
    for name, moved in made.of_states(more).items():
        found[name] = found[name] + moved
    if not made.tells:
        for name in angles(made.rig):
            speed = made.roles.speeds.get(name)
            if speed in made.states:
                change = more[:, made.states.index(speed)]
                steps = 0.5 * (change[1:] + change[:-1]) * np.diff(t)
                found[name] = found[name] + np.concatenate([[0.0], np.cumsum(steps)])
    series, driven = one.experiment.series, made.roles.motor.speed
    return found | {name: np.asarray(u) for name, u in series.items() if name == driven}


def _strayed(
    one: Observation, of: LatentTorque, draw: tuple[Array, Array], shown: Array, torque: Array
) -> Array:
    """`(K,)`: the rig that rubs, driven by `torque (T,)` at one `draw` (all parameters, all unknowns),
    from what is `shown (T, K)`: there the torque moves it as if no friction changed its sign.
    """
    response, experiment = one.response, one.experiment
    if not _rubs(one):
        return np.full(len(experiment.channels), np.nan)
    held = torque if experiment.first_order else 0.5 * (torque + np.append(torque[1:], torque[-1]))
    loaded = simulator(
        Loaded(response.model, of.kalman_filter.torque),
        dataclasses.replace(experiment, series={**experiment.series, TORQUE: held}),
        response.sensing,
        *(response.stepping or ()),
    )
    full, theta = draw
    off = (loaded.signals(one.simulator_parameters(full))[0] - shown) / one.scales(theta)[0]
    return np.sqrt(np.nanmean(np.where(experiment.seen, off, np.nan) ** 2, axis=0))


def _courses(one: Observation, left: Array, moved: Array, strayed: Array) -> tuple[Course, ...]:
    """Means over the draws `(T, K)`."""
    return tuple(
        Course(
            channel=one.experiment.names[k],
            spread=float(one.experiment.y[seen, k].std()),
            without=_size(left[seen, k]),
            left=_size(left[seen, k] - moved[seen, k]),
            moved=_size(moved[seen, k]),
            strayed=float(strayed[k]),
        )
        for k, seen in enumerate(one.experiment.seen.T)
    )


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


WORTH = 0.3  # of what is left of the squares: less is not worth a second word
LEAST = 0.1  # of all
FLAT = 1e-9  # of its size: what varies less is constant


@dataclass(frozen=True, slots=True, kw_only=True)
class Follows:
    """`kind` of `of` (a speed, an angle, an input): `share` of the squares of the torque that it
    explains by itself; `taken`: whether it is among those that explain it together, and then
    `size` with its `sd` over the draws, N m per unit of it, of an angle its amplitude.
    """

    kind: str
    of: str
    share: float
    taken: bool = False
    size: float = 0.0
    sd: float = 0.0


def follows(found: Shaking) -> tuple[Follows, ...]:
    """Those taken first, in their order; then all others by their shares."""
    turning = found.turning
    candidates = ((kind, of, rows[turning]) for kind, of, rows in _candidates(found))
    every = [one for one in candidates if np.isfinite(one[2]).all() and np.abs(one[2]).max() > FLAT]
    torque = found.expected[turning]
    total = float(torque @ torque)
    if total == 0.0 or not every:
        return ()
    alone = {k: 1.0 - _left(torque, rows) / total for k, (_, _, rows) in enumerate(every)}
    taken: list[int] = []
    rest, rows = total, np.empty((len(torque), 0))
    while len(taken) < len(every):
        lefts = {
            k: _left(torque, np.column_stack([rows, own]))
            for k, (_, _, own) in enumerate(every)
            if k not in taken
        }
        best = min(lefts, key=lambda k: lefts[k])
        if rest - lefts[best] < WORTH * rest or rest - lefts[best] < LEAST * total:
            break
        taken.append(best)
        rest, rows = lefts[best], np.column_stack([rows, every[best][2]])
    told = {k: Follows(kind=every[k][0], of=every[k][1], share=alone[k]) for k in alone}
    if taken:
        weights = np.linalg.lstsq(rows, found.draws[:, turning].T, rcond=None)[0]  # (rows, N)
        each = np.split(weights, np.cumsum([every[k][2].shape[1] for k in taken])[:-1])
        for k, sizes in zip(taken, each, strict=True):
            size = sizes[0] if len(sizes) == 1 else np.linalg.norm(sizes, axis=0)
            told[k] = dataclasses.replace(
                told[k], taken=True, size=float(size.mean()), sd=float(size.std())
            )
    others = sorted(set(alone) - {*taken}, key=lambda k: -alone[k])
    return tuple(told[k] for k in (*taken, *others))


def _candidates(found: Shaking) -> Iterator[tuple[str, str, Array]]:
    for name, speed in found.speeds:
        yield "sign", name, np.sign(speed)[:, None]
        yield "speed", name, speed[:, None]
        yield "square", name, (speed * np.abs(speed))[:, None]
    turn = found.angle[:, None]
    yield "turn", found.roles.at(found.at).angle, np.column_stack([np.cos(turn), np.sin(turn)])
    for name, values in found.inputs.items():
        if name not in found.states:
            yield "input", name, values[:, None]
    yield "constant", "", np.ones((len(found.t), 1))
    yield "drift", "", (found.t - found.t.mean())[:, None]


def _left(torque: Array, rows: Array) -> float:
    weights = np.linalg.lstsq(rows, torque, rcond=None)[0]
    rest = torque - rows @ weights
    return float(rest @ rest)
