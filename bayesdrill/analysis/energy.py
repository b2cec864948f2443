"""Where the energy goes in each experiment, and what frictions do in it: how fast, how large,
where they stick.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.energy import Energies, can_tell, energies
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.simulators.contract import Simulator

STORED, CONVERTED, AT_START = "stored", "conversion", "start"
NOTHING = 1e-9  # of the largest flow


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """`name`: of an input, a parameter, a friction, or `conversion`, `start` and `stored`; `joules`
    until the end; `share` of all that came in, and its `sd` over draws, None without any.
    """

    name: str
    joules: float
    share: float
    sd: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """Of one experiment: `came` in and `went` at each of the times `t (N,)`, J, by name; what is stored
    at the start has come in.  `left`: the share that is in neither, of the order of the steps.
    """

    label: str
    t: Array
    came: dict[str, Array]
    went: dict[str, Array]
    parts: tuple[Part, ...]
    left: float

    @property
    def total(self) -> Array:
        """All that came in so far `(N,)`."""
        return np.asarray(sum(self.came.values(), np.zeros(len(self.t))))


def accounts(posterior: Posterior, theta: Array, draws: Array) -> tuple[Account, ...]:
    """Of experiments whose rig rubs, at the MAP `theta (D,)` and draws `(N, D)`."""
    full = posterior.space.full(np.vstack([theta[None], draws]))
    return tuple(
        _account(one, one.simulator_parameters(full))
        for one in posterior.likelihood.observations
        if one.response.model.frictions and can_tell(one.response.model)
    )


def _account(one: Observation, told: Array) -> Account:
    """At parameters `told (1 + N, P)` of its simulator: of the MAP, and of draws."""
    rig = one.response
    best = energies(rig, told[0])
    flows = _flows(best)
    names = _sides(flows)
    came = {name: flows[name] for name in names[0]}
    went = {name: -flows[name] for name in names[1]}
    shares = [_shares(_flows(energies(rig, each)), names) for each in told[1:]]
    parts = [
        Part(
            name=name,
            joules=float((came | went)[name][-1]),
            share=share,
            sd=None if len(shares) < 2 else float(np.std([o[name] for o in shares], ddof=1)),
        )
        for name, share in _shares(flows, names).items()
    ]
    total = sum(part[-1] for part in came.values())
    left = float(np.abs(best.open[-1]) / total) if total else 0.0
    return Account(label=one.label, t=best.t, came=came, went=went, parts=tuple(parts), left=left)


def _flows(found: Energies) -> dict[str, Array]:
    """By name, what comes in is positive."""
    flows = {**found.given, CONVERTED: found.converted}
    flows |= {name: -part for name, part in found.lost.items()}
    start = np.full(len(found.t), found.stored[0])
    return {**flows, AT_START: start, STORED: -found.stored}


def _sides(flows: dict[str, Array]) -> tuple[list[str], list[str]]:
    """Names of what came in and of what went, in the end; what is next to nothing has none."""
    scale = max(float(np.abs(part).max()) for part in flows.values())
    kept = [n for n, part in flows.items() if n == STORED or np.abs(part).max() > NOTHING * scale]
    came = [name for name in kept if name != STORED and flows[name][-1] >= 0]
    return came, [name for name in kept if name not in came]


def _shares(flows: dict[str, Array], names: tuple[list[str], list[str]]) -> dict[str, float]:
    """Of all that came in."""
    ends = {name: float(flows[name][-1]) for name in (*names[0], *names[1])}
    total = sum(ends[name] for name in names[0])
    signs = dict.fromkeys(names[0], 1.0) | dict.fromkeys(names[1], -1.0)
    return {name: signs[name] * end / total if total else 0.0 for name, end in ends.items()}


SPEEDS = 200  # of each sign, at which a law is drawn: ...
NEAREST = 1e-4  # ... from this share of the largest one on, as static friction falls near zero
BEYOND = 1.05  # of the largest speed of the record


@dataclass(frozen=True, slots=True, kw_only=True)
class Rubbing:
    """One friction in one experiment, at samples `t (T,)`: of the MAP its `speed`, `effort` and where it
    `sticks` until the next sample, `(T,)`; `efforts (N, T)` of draws.  `gear`: its own speed is so many
    times that of the state.
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
        """The share of the time."""
        steps = np.diff(self.t)
        return float(steps[self.sticks[:-1]].sum() / steps.sum())

    @property
    def intervals(self) -> tuple[tuple[float, float], ...]:
        """When it sticks."""
        edges = np.diff(np.concatenate([[0], self.sticks.astype(int), [0]]))
        first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        ends = np.minimum(last, len(self.t) - 1)
        return tuple((float(self.t[a]), float(self.t[b])) for a, b in zip(first, ends, strict=True))

    @property
    def stuck_later(self) -> float:
        """The same, of what comes after its start from rest."""
        steps = np.where(np.cumsum(~self.sticks[:-1]) > 0, np.diff(self.t), 0.0)
        return float(steps[self.sticks[:-1]].sum() / np.diff(self.t).sum())

    @property
    def reversals(self) -> int:
        """How often it goes on the other way."""
        signs = np.sign(self.speed[self.speed != 0.0])
        return int(np.count_nonzero(np.diff(signs)))

    @property
    def slowest(self) -> float:
        """The least speed of its own once it has gone at half of its greatest; what comes before is a
        start from rest.
        """
        size = np.abs(self.speed) * self.gear
        first = int(np.argmax(size >= 0.5 * size.max()))
        return float(size[first:].min())

    @property
    def fastest(self) -> float:
        return float(np.abs(self.speed).max() * self.gear)


def rubbings(posterior: Posterior, theta: Array, draws: Array) -> tuple[tuple[Rubbing, ...], ...]:
    """Of each experiment, at the MAP `theta (D,)` and draws `(N, D)`; empty where nothing rubs."""
    full = posterior.space.full(np.vstack([theta[None], draws]))
    return tuple(tuple(_of(one, full)) for one in posterior.likelihood.observations)


def _of(one: Observation, full: Array) -> Iterator[Rubbing]:
    rig = one.response
    if not rig.model.frictions:
        return
    motion = rig.motion(one.simulator_parameters(full))
    for e, friction in enumerate(rig.model.frictions):
        speed = motion.states[0, :, rig.model.states.index(friction.against)]
        still = speed == 0.0
        yield Rubbing(
            friction=friction,
            label=one.label,
            t=np.asarray(rig.experiment.t),
            speed=speed,
            effort=motion.efforts[0, :, e],
            sticks=np.append(still[:-1] & still[1:], False),
            efforts=motion.efforts[1:, :, e],
            gear=geared(rig, friction),
        )


def geared(rig: Simulator, friction: Friction) -> float:
    """How many times as fast the motor turns as what its friction is said to be against."""
    model = rig.model
    return 1.0 / model.gear_ratio if friction.against == model.roles.motor.speed else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A law at its own `speeds (G,)`: `sizes (W, G)` of so many walkers, signed as the speeds."""

    speeds: Array
    sizes: Array


def curve(one: Observation, rubbing: Rubbing, full: Array) -> Curve:
    """Of parameters `full (W, P)`, over the speeds that the record saw; where a law sees more than the
    speed, at the root mean square of that.
    """
    rig, friction = one.response, rubbing.friction
    far = BEYOND * float(np.abs(rubbing.speed).max()) or 1.0
    one_way = far * np.geomspace(NEAREST, 1.0, SPEEDS)
    speeds = np.concatenate([-one_way[::-1], [0.0], one_way])
    told = one.simulator_parameters(full)
    names = rig.model.parameters
    p = {name: told[:, k, None] for k, name in enumerate(names)}
    seen = {name: np.asarray(x) for name, x in _seen(rig, friction, told[:1]).items()}
    sizes = friction.law.size(p, np.abs(speeds), seen)
    signed = np.broadcast_to(sizes, (len(told), len(speeds))) * np.sign(speeds)
    return Curve(speeds=speeds * rubbing.gear, sizes=np.asarray(signed))


def _seen(rig: Simulator, friction: Friction, told: Array) -> dict[str, float]:
    """States, and inputs, that the law looks at; of two angles only their difference counts."""
    steps = rig.steps(told)
    angles = [name for name in friction.law.seen if name in rig.model.states]
    others = [name for name in friction.law.seen if name not in rig.model.states]
    found = {name: float(np.sqrt(np.mean(steps.felt[name] ** 2))) for name in others}
    if len(angles) == 2:
        first, second = (steps.motion.states[0, :, rig.model.states.index(n)] for n in angles)
        found[angles[0]] = 0.0
        found[angles[1]] = float(np.sqrt(np.mean((second - first) ** 2)))
    return found
