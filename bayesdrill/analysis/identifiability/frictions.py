"""Which friction, damping and drop such records can hardly tell from what, by what they did not do.

Information as everywhere, with the priors; what the rig did at the same point says why; and each
experiment that could be made is tried by computing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.energy import Rubbing, rubbings
from bayesdrill.analysis.identifiability.information import Scene, Scenery
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import usual_inputs
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.linear import USUAL, Model, Roles, driven, dynamics

KNOWN = 0.1  # sd of the log: what is known as well is told apart, whatever it is like
ALIKE = 2.0  # times: how much smaller an sd would be, were the others known
MOST_OF_IT = 0.8  # of the log of that: enough of the others are named
HELPS = 1.5  # times: an experiment that is proposed
MOST_PROPOSED = 2
FAR = 3.0  # speed scales: static friction is gone
LOST = 0.9  # of a prior's spread: nothing is learnt
ONE = 0.25  # of the mean speed: a record goes at one
BELOW = 0.8  # of the voltage at which it stands still

SUPPLY = "motor.voltage"  # stands for its offset
# What each is like, if both are unknown; by roles.
RIVALS: Mapping[str, tuple[str, ...]] = {
    "motor.sliding": (
        *("motor.friction", "motor.damping", "motor.back_emf", "rotor.sliding", "rotor.damping"),
        *("motor.efficiency", "motor.drop", SUPPLY),
    ),
    "rotor.sliding": (
        *("motor.sliding", "motor.friction", "rotor.damping", "motor.damping", "motor.back_emf"),
    ),
    "motor.drop": (
        *("motor.back_emf", "motor.sliding", "motor.friction", "motor.damping"),
        *("motor.resistance", SUPPLY),
    ),
    "shaft.damping": ("rotor.damping", "motor.damping"),
    "motor.efficiency": ("motor.sliding", "motor.friction", "motor.damping"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Deeds:
    """Of what rubs at `where`, against a state, over all records: how often it turned round, the share
    of the time it stuck, and its speeds after the start, least and greatest, in its own unit (A of a
    current).
    """

    where: str
    against: str
    reversals: int
    stuck: float
    slowest: float
    fastest: float

    @property
    def one_way(self) -> bool:
        return self.reversals == 0

    @property
    def one_speed(self) -> bool:
        return self.fastest - self.slowest < ONE * (self.fastest + self.slowest)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """An experiment, and by what factor the sd in question would fall; `volts`: of it, if it has one."""

    what: str
    volts: float | None
    shrink: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Alike:
    """`name` can hardly be told from `rivals`: its sd would `fall` so many times, were these known."""

    name: str
    rivals: tuple[str, ...]
    fall: float
    deeds: Deeds | None
    proposals: tuple[Proposal, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Unseen:
    """Static friction that no record shows: `names` that it leaves to the prior; `scale`: the speed over
    which it is lost.
    """

    names: tuple[str, ...]
    scale: float
    deeds: Deeds
    proposals: tuple[Proposal, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    alike: tuple[Alike, ...] = ()
    unseen: tuple[Unseen, ...] = ()
    roles: Roles = USUAL


NOTHING = Told()


def told_apart(scenery: Scenery, posterior: Posterior, theta: Array) -> Told:
    """At `theta (D,)`; nothing of a rig that has none of it."""
    names = (*scenery.unknowns, *scenery.nuisances)
    roles = scenery.likelihood.observations[0].response.model.roles
    static = [name for at in (roles.motor, roles.rotor) for name in (at.static, at.fading)]
    wanted = {*(roles[role] for role in RIVALS), *static}
    if not wanted & {*names}:
        return NOTHING
    rows = scenery.every(theta)
    if not np.isfinite(rows).all():
        return NOTHING
    scene = _Scene(scenery, posterior, theta, names, rows)
    return Told(alike=tuple(scene.alike()), unseen=tuple(scene.unseen()), roles=roles)


class _Scene:
    """`rows (n, m + k)`: of these records over the noise."""

    def __init__(
        self,
        scenery: Scenery,
        posterior: Posterior,
        theta: Array,
        names: tuple[str, ...],
        rows: Array,
    ) -> None:
        self.scenery, self.theta, self.names, self.rows = scenery, theta, names, rows
        self.known = self._precision(rows)
        none = np.empty((0, len(theta)))
        self.frictions = [f for each in rubbings(posterior, theta, none) for f in each]
        self.model = scenery.likelihood.observations[0].response.model
        self.rig = dict(
            zip(
                self.model.parameters,
                scenery.likelihood.rig_parameters(theta[None])[0],
                strict=True,
            )
        )
        self.tried: list[tuple[str, float | None, Array]] | None = None

    def _precision(self, rows: Array) -> Array:
        """With the priors `(m + k, m + k)`."""
        return np.asarray(rows.T @ rows + np.diag(self.scenery.prior_spreads**-2.0))

    def _sd(self, name: str, precision: Array, known: Sequence[str] = ()) -> float:
        """Of the log, where others are `known`."""
        kept = [k for k, other in enumerate(self.names) if other not in known]
        inside = precision[np.ix_(kept, kept)]
        own = 1.0 / np.sqrt(np.diag(inside))
        spread = np.linalg.pinv(inside * own[:, None] * own, hermitian=True)
        k = [self.names[j] for j in kept].index(name)
        return float(own[k] * np.sqrt(spread[k, k]))

    def alike(self) -> Iterator[Alike]:
        said: set[frozenset[str]] = set()
        roles = self.model.roles
        for role, others in RIVALS.items():
            name, every = roles[role], [f"{'offset_' * (r == SUPPLY)}{roles[r]}" for r in others]
            rivals = [one for one in every if one in self.names]
            if name not in self.names or not rivals:
                continue
            alone = self._sd(name, self.known)
            fall = alone / self._sd(name, self.known, rivals)
            if alone < KNOWN or fall < ALIKE:
                continue
            named = self._enough(name, rivals, alone, fall)
            if all(frozenset((name, one)) in said for one in named):
                continue
            said |= {frozenset((name, one)) for one in named}
            yield Alike(
                name=name,
                rivals=named,
                fall=alone / self._sd(name, self.known, named),
                deeds=self._of([f for f in self.frictions if name in f.friction.law.parameters]),
                proposals=self._proposals(name),
            )

    def _enough(
        self, name: str, rivals: Sequence[str], alone: float, fall: float
    ) -> tuple[str, ...]:
        """One after the other, those whose knowledge would help most."""
        named: list[str] = []
        while len(named) < len(rivals):
            rest = [one for one in rivals if one not in named]
            sds = [self._sd(name, self.known, [*named, one]) for one in rest]
            named.append(rest[int(np.argmin(sds))])
            if np.log(alone / min(sds)) >= MOST_OF_IT * np.log(fall):
                break
        return tuple(named)

    def unseen(self) -> Iterator[Unseen]:
        for at in (self.model.roles.motor, self.model.roles.rotor):
            scale = at.fading
            names = tuple(one for one in (at.static, scale) if one in self.names)
            if not names:
                continue
            deeds = self._of([f for f in self.frictions if f.friction.against == at.speed])
            speed = float(self.rig.get(scale, np.nan))
            spreads = dict(zip(self.names, self.scenery.prior_spreads, strict=True))
            lost = [n for n in names if self._sd(n, self.known) > LOST * spreads[n]]
            if deeds is None or deeds.stuck > 0 or deeds.slowest < FAR * speed or not lost:
                continue
            yield Unseen(
                names=tuple(lost), scale=speed, deeds=deeds, proposals=self._proposals(lost[0])
            )

    def _of(self, every: Sequence[Rubbing]) -> Deeds | None:
        if not every:
            return None
        one_sign = len({np.sign(f.speed[f.speed != 0][-1]) for f in every if f.speed.any()}) == 1
        return Deeds(
            where=every[0].friction.where,
            against=every[0].friction.against,
            reversals=sum(f.reversals for f in every) + (not one_sign),
            stuck=float(np.mean([f.stuck_later for f in every])),
            slowest=min(f.slowest for f in every),
            fastest=max(f.fastest for f in every),
        )

    # Experiments that could be made.

    def _proposals(self, name: str) -> tuple[Proposal, ...]:
        now = self._sd(name, self.known)
        if self.tried is None:
            self.tried = [
                (what, volts, self._precision(rows))
                for what, volts, rows in self._scenes()
                if np.isfinite(rows).all()
            ]
        found = [
            Proposal(what=what, volts=volts, shrink=now / self._sd(name, then))
            for what, volts, then in self.tried
        ]
        helpful = [one for one in found if one.shrink > HELPS]
        return tuple(sorted(helpful, key=lambda one: -one.shrink)[:MOST_PROPOSED])

    def _scenes(self) -> Iterator[tuple[str, float | None, Array]]:
        """What it is, its voltage, and the rows of all that would then be known."""
        every = self.scenery.likelihood.observations
        supply = self.model.roles.motor.voltage
        if supply not in self.model.inputs:
            return
        size = float(np.mean([usual_inputs(one.experiment)[supply] for one in every]))
        stop = stops_below(self.model, self.rig)
        if any(supply in one.experiment.series for one in every):
            yield "turned", None, self._another(-1.0)
            if 0 < stop < size:
                yield "stops", BELOW * stop, self._another(BELOW * stop / size)
        elif v := self.scenery.usual_input(supply):
            yield "turned half-way", None, self._late(-2.0 * v)
            if 0 < stop < abs(v):
                low = float(np.sign(v)) * BELOW * stop
                yield "stops half-way", low, self._late(low - v)
        yield "half", 0.5 * size, self._another(0.5)

    def _another(self, times: float) -> Array:
        scene = Scene(times={self.model.roles.motor.voltage: times})
        return np.vstack([self.rows, self.scenery.every(self.theta, scene)])

    def _late(self, change: float) -> Array:
        return self.scenery.every(self.theta, Scene(late={self.model.roles.motor.voltage: change}))


def stops_below(model: Model, p: Mapping[str, float]) -> float:
    """The voltage that holds it at the very edge of turning, against all friction as it slips; V.

    Below it the rig comes to rest: friction at rest is no less.  Zero where none holds it, or nothing
    is driven by a voltage.
    """
    motor = model.roles.motor
    if motor.speed not in model.states or motor.voltage not in model.inputs:
        return 0.0
    frictions = model.frictions
    quick = dict.fromkeys((*model.states, *model.inputs), 0.0)
    sizes = {f.name: float(np.asarray(f.law.size(p, 1e6, quick))) for f in frictions}
    linear = model.linear(p)
    matrix, angles = dynamics(linear, model.states, 1), steady_state.angles_of(model)
    speed = model.states.index(motor.speed)

    def at(volts: float) -> float:
        forcing = driven(linear, model.states, 1, {motor.voltage: volts, **sizes})
        return float(steady_state.states(matrix, forcing, angles)[0, speed])

    still, slope = at(0.0), at(1.0) - at(0.0)
    return max(0.0, -still / slope) if slope else 0.0
