"""Account for the energy of each experiment, and describe what frictions do in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.energy import Energies, can_balance, energies
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.simulators.contract import Simulator

STORED, CONVERTED, AT_START = "stored", "conversion", "start"
NEGLIGIBLE_SHARE = 1e-9  # of the largest flow


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyPart:
    """A part of the energy of one experiment.

    `name`: of an input, a parameter, a friction, or `conversion`, `start` and `stored`; `joules`
    until the end; `share` of all that came in, and its `sd` over draws, None without any.
    """

    name: str
    joules: float
    share: float
    sd: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergySummary:
    """The energy of one experiment: the `parts` that `came` in and `went`, until the end.

    What is stored at the start came in; `left`: the share in neither, of the order of the steps.
    """

    label: str
    parts: tuple[EnergyPart, ...]
    came: tuple[str, ...]
    went: tuple[str, ...]
    left: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyAccount:
    """The energy of one experiment that `came` in and `went` by the times `t (N,)`, J, by name."""

    summary: EnergySummary
    t: Array
    came: dict[str, Array]
    went: dict[str, Array]

    @property
    def total(self) -> Array:
        """All that came in so far, `(N,)`."""
        return np.asarray(sum(self.came.values(), np.zeros(len(self.t))))


def energy_accounts(posterior: Posterior, theta: Array, draws: Array) -> tuple[EnergyAccount, ...]:
    """Account for experiments with friction, at the MAP `theta (D,)` and draws `(N, D)`."""
    full = posterior.space.full(np.vstack([theta[None], draws]))
    return tuple(
        _account(observation, observation.simulator_parameters(full))
        for observation in posterior.likelihood.observations
        if observation.response.model.frictions and can_balance(observation.response.model)
    )


def _account(observation: Observation, arguments: Array) -> EnergyAccount:
    """At parameters `(1 + N, P)` of its simulator: of the MAP, and of draws."""
    rig = observation.response
    best = energies(rig, arguments[0])
    flows = _flows(best)
    # What is next to nothing has no side, unless it is what is stored.
    least = NEGLIGIBLE_SHARE * max(float(np.abs(part).max()) for part in flows.values())
    sizable = {n: part for n, part in flows.items() if n == STORED or np.abs(part).max() > least}
    came = {n: part for n, part in sizable.items() if n != STORED and part[-1] >= 0}
    went = {n: -part for n, part in sizable.items() if n not in came}

    def shares(flows: dict[str, Array]) -> dict[str, float]:
        """Of all that came in."""
        ends = {name: float(flows[name][-1]) for name in (*came, *went)}
        total = sum(ends[name] for name in came)
        ends |= {name: -ends[name] for name in went}
        return {name: end / total if total else 0.0 for name, end in ends.items()}

    of_draws = [shares(_flows(energies(rig, each))) for each in arguments[1:]]
    total, several = sum(part[-1] for part in came.values()), len(of_draws) > 1
    parts = tuple(
        EnergyPart(
            name=name,
            joules=float((came | went)[name][-1]),
            share=share,
            sd=float(np.std([o[name] for o in of_draws], ddof=1)) if several else None,
        )
        for name, share in shares(flows).items()
    )
    left = float(np.abs(best.open[-1]) / total) if total else 0.0
    summary = EnergySummary(
        label=observation.label, parts=parts, came=tuple(came), went=tuple(went), left=left
    )
    return EnergyAccount(summary=summary, t=best.t, came=came, went=went)


def _flows(energies: Energies) -> dict[str, Array]:
    """By name, what comes in is positive."""
    flows = {**energies.given, CONVERTED: energies.converted}
    flows |= {name: -part for name, part in energies.lost.items()}
    start = np.full(len(energies.t), energies.stored[0])
    return {**flows, AT_START: start, STORED: -energies.stored}


CURVE_POINTS = 200  # of each sign, at which a law is drawn: ...
# ... from this share of the largest one on, as static friction falls near zero
SMALLEST_SPEED = 1e-4
SPEED_MARGIN = 1.05  # of the largest speed of the record


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionMotion:
    """The motion of one friction at samples `t (T,)`; `gear`: its own speed over that of the state.

    Of the MAP `speed`, `effort` and where it `sticks` until the next sample; of draws `efforts (N, T)`.
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
    def stuck(self) -> float:
        """The share of the time that it sticks."""
        steps = np.diff(self.t)
        return float(steps[self.sticks[:-1]].sum() / steps.sum())

    @property
    def intervals(self) -> tuple[tuple[float, float], ...]:
        """The intervals in which it sticks."""
        edges = np.diff(np.concatenate([[0], self.sticks.astype(int), [0]]))
        first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        ends = np.minimum(last, len(self.t) - 1)
        return tuple((float(self.t[a]), float(self.t[b])) for a, b in zip(first, ends, strict=True))

    @property
    def stuck_later(self) -> float:
        """The share of the time that it sticks after its start from rest."""
        steps = np.where(np.cumsum(~self.sticks[:-1]) > 0, np.diff(self.t), 0.0)
        return float(steps[self.sticks[:-1]].sum() / np.diff(self.t).sum())

    @property
    def reversals(self) -> int:
        """The number of reversals."""
        signs = np.sign(self.speed[self.speed != 0.0])
        return int(np.count_nonzero(np.diff(signs)))

    @property
    def slowest(self) -> float:
        """The least speed once it has gone at half of its greatest: before, it starts from rest."""
        size = np.abs(self.speed) * self.gear
        first = int(np.argmax(size >= 0.5 * size.max()))
        return float(size[first:].min())

    @property
    def fastest(self) -> float:
        """The greatest speed."""
        return float(np.abs(self.speed).max() * self.gear)


def friction_motions(
    posterior: Posterior, theta: Array, draws: Array
) -> tuple[tuple[FrictionMotion, ...], ...]:
    """Return the frictions of each experiment, at the MAP `theta (D,)` and draws `(N, D)`."""
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
        yield FrictionMotion(
            friction=friction,
            label=observation.label,
            t=np.asarray(rig.experiment.t),
            speed=speed,
            effort=motion.efforts[0, :, e],
            sticks=np.append(still[:-1] & still[1:], False),
            efforts=motion.efforts[1:, :, e],
            gear=1.0 if inertia is None else 1.0 / inertia.reduction,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionCurve:
    """A friction law at its own `speeds (G,)`: `sizes (W, G)` of so many walkers, signed as these."""

    speeds: Array
    sizes: Array


def friction_curve(observation: Observation, rubbing: FrictionMotion, full: Array) -> FrictionCurve:
    """Compute a law at `full (W, P)` over the record's speeds; all else is at its root mean square."""
    rig, friction = observation.response, rubbing.friction
    far = SPEED_MARGIN * float(np.abs(rubbing.speed).max()) or 1.0
    one_way = far * np.geomspace(SMALLEST_SPEED, 1.0, CURVE_POINTS)
    speeds = np.concatenate([-one_way[::-1], [0.0], one_way])
    arguments = observation.simulator_parameters(full)
    p = {name: arguments[:, k, None] for k, name in enumerate(rig.model.parameters)}
    sizes = friction.law.size(p, np.abs(speeds), _law_inputs(rig, friction, arguments[:1]))
    signed = np.broadcast_to(sizes, (len(arguments), len(speeds))) * np.sign(speeds)
    return FrictionCurve(speeds=speeds * rubbing.gear, sizes=np.asarray(signed))


def _law_inputs(rig: Simulator, friction: Friction, arguments: Array) -> dict[str, Array]:
    """States, and inputs, that the law looks at; of two angles only their difference counts."""
    steps = rig.steps(arguments)
    states = rig.model.states
    angles = [name for name in friction.law.seen if name in states]
    others = [name for name in friction.law.seen if name not in states]
    values = {name: np.asarray(np.sqrt(np.mean(steps.felt[name] ** 2))) for name in others}
    if len(angles) == 2:
        first, second = (steps.motion.states[0, :, states.index(name)] for name in angles)
        values[angles[0]] = np.asarray(0.0)
        values[angles[1]] = np.asarray(np.sqrt(np.mean((second - first) ** 2)))
    return values
