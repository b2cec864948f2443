"""Compute the motion at each friction of an experiment, and the friction law at these speeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.models.friction import DIRECTION, Friction
from bayesdrill.rig.simulators.contract import Simulator

CURVE_POINTS = 200  # number of speeds of each sign at which a law is drawn
# Smallest drawn speed divided by the largest; it is tiny as static friction falls steeply near zero.
SMALLEST_SPEED = 1e-4
SPEED_MARGIN = 1.05  # largest speed at which a law is drawn, divided by that of the record


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionMotion:
    """The motion at one friction is given at the samples `t (T,)`, at the MAP.

    At the friction, the speed is `gear` times the state's `speed (T,)`.  Its torque, force or voltage is
    `effort (T,)`, or `efforts (N, T)` at draws.  `sticks (T,)` flags sticking until the next sample.
    """

    friction: Friction
    label: str
    t: Array
    speed: Array
    effort: Array
    sticks: Flags
    efforts: Array
    gear: float

    @property
    def intervals(self) -> tuple[tuple[float, float], ...]:
        """Return the intervals in which the friction sticks, as pairs of times [s]."""
        edges = np.diff(np.concatenate([[0], self.sticks.astype(int), [0]]))
        first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        ends = np.minimum(last, len(self.t) - 1)
        return tuple((float(self.t[a]), float(self.t[b])) for a, b in zip(first, ends, strict=True))

    @property
    def stuck_later(self) -> float:
        """Return the time that the friction sticks after the first motion, divided by the duration."""
        steps = np.where(np.cumsum(~self.sticks[:-1]) > 0, np.diff(self.t), 0.0)
        return float(steps[self.sticks[:-1]].sum() / np.diff(self.t).sum())

    @property
    def reversals(self) -> int:
        """Return the number of reversals of the speed."""
        signs = np.sign(self.speed[self.speed != 0.0])
        return int(np.count_nonzero(np.diff(signs)))

    @property
    def slowest(self) -> float:
        """Return the smallest speed after the speed has first reached half of its maximum."""
        size = np.abs(self.speed * self.gear)
        first = int(np.argmax(size >= 0.5 * size.max()))
        return float(size[first:].min())

    @property
    def fastest(self) -> float:
        """Return the greatest speed."""
        return float(np.abs(self.speed * self.gear).max())


def friction_motions(
    posterior: Posterior, theta: Array, draws: Array
) -> tuple[tuple[FrictionMotion, ...], ...]:
    """Return the motion at each friction by experiment, at the MAP `theta (D,)` and draws `(N, D)`."""
    full = posterior.space.full(np.vstack([theta[None], draws]))
    return tuple(tuple(_friction_motions(each, full)) for each in posterior.likelihood.observations)


def _friction_motions(observation: Observation, full: Array) -> Iterator[FrictionMotion]:
    rig = observation.response
    if not rig.model.frictions:
        return
    motion = rig.motion(observation.simulator_parameters(full))
    for e, friction in enumerate(rig.model.frictions):
        speed = motion.states[0, :, rig.model.states.index(friction.against)]
        inertia = rig.model.roles.at_friction(friction.against, friction.where)
        still = speed == 0.0
        gear = 1.0 if inertia is None else 1.0 / inertia.reduction
        efforts = motion.efforts[:, :, e] * np.sign(gear)
        yield FrictionMotion(
            friction=friction,
            label=observation.label,
            t=np.asarray(rig.experiment.t),
            speed=speed,
            effort=efforts[0],
            sticks=np.append(still[:-1] & still[1:], False),
            efforts=efforts[1:],
            gear=gear,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionCurve:
    """A friction law has values `sizes (W, G)` at rising `speeds (G,)`, with the speeds' signs."""

    speeds: Array
    sizes: Array


def friction_curve(observation: Observation, rubbing: FrictionMotion, full: Array) -> FrictionCurve:
    """Compute a law at `full (W, P)` for a record's speeds; other inputs of the law have their rms."""
    rig, friction = observation.response, rubbing.friction
    largest = SPEED_MARGIN * float(np.abs(rubbing.speed).max()) or 1.0
    one_way = largest * np.geomspace(SMALLEST_SPEED, 1.0, CURVE_POINTS)
    speeds = np.concatenate([-one_way[::-1], [0.0], one_way])
    arguments = observation.simulator_parameters(full)
    p = {name: arguments[:, k, None] for k, name in enumerate(rig.model.parameters)}
    seen = {**_law_inputs(rig, friction, arguments[:1]), DIRECTION: np.sign(speeds)}
    sizes = friction.law.size(p, np.abs(speeds), seen)
    signed = np.broadcast_to(sizes, (len(arguments), len(speeds))) * np.sign(speeds * rubbing.gear)
    upwards = slice(None, None, 1 if rubbing.gear > 0 else -1)
    return FrictionCurve(speeds=(speeds * rubbing.gear)[upwards], sizes=signed[:, upwards])


def _law_inputs(rig: Simulator, friction: Friction, arguments: Array) -> dict[str, Array]:
    """Return the rms of each input of the law, and of its angle or of differences to the first one."""
    states = rig.model.states
    inputs = (name for name in friction.law.seen if name not in (*states, DIRECTION))
    values = {name: _rms(rig.sensors.acting_input(name, arguments)) for name in inputs}
    angles = [name for name in friction.law.seen if name in states]
    if angles:
        motion = rig.motion(arguments).states[0]
        turned = [motion[:, states.index(name)] for name in angles]
        first = turned[0] if len(angles) > 1 else 0.0
        values |= {name: _rms(x - first) for name, x in zip(angles, turned, strict=True)}
    return values


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2)))
