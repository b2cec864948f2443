"""Find frictions, dampings and drops that a record can hardly distinguish.

Information as everywhere, with the priors; what the rig did at the same point says why; and each
experiment that could be made is tried by computing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.analysis.friction_motion import FrictionMotion, friction_motions
from bayesdrill.analysis.identifiability.information import DesignVariant, SensitivityStudy
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import typical_inputs
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.linear import Model, constant_forcing, dynamics
from bayesdrill.rig.models.roles import Roles

KNOWN_SD = 0.1  # sd of the log: what is known as well is told apart, whatever it is like
MIN_FALL = 2.0  # times: how much smaller an sd would be, were the others known
MIN_EXPLAINED_FALL = 0.8  # of the log of that: enough of the others are named
MIN_HELPFUL_FALL = 1.5  # times: an experiment that is proposed
MAX_PROPOSED = 2
STICTION_GONE_SPEEDS = 3.0  # speed scales: static friction is gone
LOST_SHARE = 0.9  # of a prior's spread: nothing is learnt
ONE_SPEED_SHARE = 0.25  # of the mean speed: a record goes at one
BELOW_STALL = 0.8  # of the voltage at which it stands still


def rivals(roles: Roles) -> dict[str, tuple[str, ...]]:
    """Return what each friction, damping or drop of a rig is like, if both are unknown, by name."""
    inertias, motors = roles.inertias, roles.motors
    back_emfs = [motor.back_emf for motor in motors]
    each: dict[str, tuple[str, ...]] = {}
    for here in inertias:
        others = [n for i in inertias if i is not here for n in (i.sliding, i.friction, i.damping)]
        there = [m for m in motors if m.inertia == here.name]
        circuit = [name for m in there for name in (m.drop, f"offset_{m.voltage}")]
        behind = [here.efficiency, *circuit]
        each[here.sliding] = (here.friction, here.damping, *back_emfs, *others, *behind)
    for motor in motors:
        here = roles.inertia(motor.inertia)
        rubs = (here.sliding, here.friction, here.damping)
        each[motor.drop] = (motor.back_emf, *rubs, motor.resistance, f"offset_{motor.voltage}")
    for shaft in roles.shafts:
        each[shaft.damping] = tuple(inertia.damping for inertia in inertias)
    for here in inertias:
        each[here.efficiency] = (here.sliding, here.friction, here.damping)
    return {name: names for name, names in each.items() if name}


@dataclass(frozen=True, slots=True, kw_only=True)
class Excitation:
    """How a record excites a friction at `where`, against a state, over all records.

    How often it turned round, the share of the time it stuck, and its speeds after the start, least
    and greatest, in its own unit (A of a current).
    """

    where: str
    against: str
    reversals: int
    stuck: float
    slowest: float
    fastest: float

    @property
    def one_speed(self) -> bool:
        """Whether its speed hardly changes."""
        return self.fastest - self.slowest < ONE_SPEED_SHARE * (self.fastest + self.slowest)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProposedExperiment:
    """An experiment, and by what factor the sd in question would fall; `volts`: its drive, if any."""

    what: str
    volts: float | None
    shrink: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Confounded:
    """`name` can hardly be told from `rivals`: its sd would `fall` so many times, were these known."""

    name: str
    rivals: tuple[str, ...]
    fall: float
    deeds: Excitation | None
    proposals: tuple[ProposedExperiment, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenStiction:
    """Static friction that no record shows: `names` left to the prior, lost over the speed `scale`."""

    names: tuple[str, ...]
    scale: float
    deeds: Excitation
    proposals: tuple[ProposedExperiment, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionConfounding:
    """Frictions that a record can hardly distinguish, and stiction that it does not show."""

    alike: tuple[Confounded, ...] = ()
    unseen: tuple[UnseenStiction, ...] = ()


NO_CONFOUNDING = FrictionConfounding()


def distinguish(
    sensitivity: SensitivityStudy, posterior: Posterior, theta: Array
) -> FrictionConfounding:
    """Find what the record can hardly distinguish at `theta (D,)`; nothing of a rig without it."""
    names = (*sensitivity.unknowns, *sensitivity.nuisances)
    roles = sensitivity.model.roles
    wanted = {*rivals(roles), *(name for i in roles.inertias for name in (i.static, i.fading))}
    if not wanted & {*names}:
        return NO_CONFOUNDING
    rows = sensitivity.with_nuisances(theta)
    none = np.empty((0, len(theta)))
    frictions = [f for each in friction_motions(posterior, theta, none) for f in each]
    scene = _FrictionStudy(sensitivity, theta, names, rows, frictions)
    return FrictionConfounding(alike=tuple(scene.alike()), unseen=tuple(scene.unseen()))


@dataclass
class _FrictionStudy:
    """`rows (n, m + k)`: of these records over the noise."""

    sensitivity: SensitivityStudy
    theta: Array
    names: tuple[str, ...]
    rows: Array
    frictions: Sequence[FrictionMotion]

    def __post_init__(self) -> None:
        self.known = self._precision(self.rows)
        self.model = self.sensitivity.model
        self.rig = self.sensitivity.rig_at(self.theta)
        self.drives = drives_of(self.model)

    def _precision(self, rows: Array) -> Array:
        return np.asarray(rows.T @ rows + np.diag(self.sensitivity.prior_spreads**-2.0))

    def _sd(self, name: str, precision: Array, known: Sequence[str] = ()) -> float:
        unknown = [k for k, other in enumerate(self.names) if other not in known]
        inside = precision[np.ix_(unknown, unknown)]
        scale = 1.0 / np.sqrt(np.diag(inside))
        spread = np.linalg.pinv(inside * scale[:, None] * scale, hermitian=True)
        k = [self.names[j] for j in unknown].index(name)
        return float(scale[k] * np.sqrt(spread[k, k]))

    def alike(self) -> Iterator[Confounded]:
        reported: set[frozenset[str]] = set()
        for name, others in rivals(self.model.roles).items():
            known = [other for other in others if other in self.names]
            if name not in self.names or not known:
                continue
            alone = self._sd(name, self.known)
            fall = alone / self._sd(name, self.known, known)
            if alone < KNOWN_SD or fall < MIN_FALL:
                continue
            named = self._named_rivals(name, known, alone, fall)
            pairs = {frozenset((name, rival)) for rival in named}
            if pairs <= reported:
                continue
            reported |= pairs
            yield Confounded(
                name=name,
                rivals=named,
                fall=alone / self._sd(name, self.known, named),
                deeds=self._excitation({name}),
                proposals=self._proposals(name),
            )

    def _named_rivals(
        self, name: str, rivals: Sequence[str], alone: float, fall: float
    ) -> tuple[str, ...]:
        """One after the other, those whose knowledge would help most."""
        named: list[str] = []
        while len(named) < len(rivals):
            others = [rival for rival in rivals if rival not in named]
            sds = [self._sd(name, self.known, [*named, rival]) for rival in others]
            named.append(others[int(np.argmin(sds))])
            if np.log(alone / min(sds)) >= MIN_EXPLAINED_FALL * np.log(fall):
                break
        return tuple(named)

    def unseen(self) -> Iterator[UnseenStiction]:
        for at in self.model.roles.inertias:
            scale = at.fading
            names = [parameter for parameter in (at.static, scale) if parameter in self.names]
            speed, deeds = float(self.rig.get(scale, np.nan)), self._excitation({*names})
            spreads = dict(zip(self.names, self.sensitivity.prior_spreads, strict=True))
            lost = [n for n in names if self._sd(n, self.known) > LOST_SHARE * spreads[n]]
            if not lost or deeds is None or deeds.stuck > 0:
                continue
            if not deeds.slowest < STICTION_GONE_SPEEDS * speed:
                yield UnseenStiction(
                    names=tuple(lost), scale=speed, deeds=deeds, proposals=self._proposals(lost[0])
                )

    def _excitation(self, parameters: set[str]) -> Excitation | None:
        """Of the frictions that have any of these parameters; None where there are none."""
        motions = [f for f in self.frictions if parameters & {*f.friction.law.parameters}]
        if not motions:
            return None
        one_sign = len({np.sign(f.speed[f.speed != 0][-1]) for f in motions if f.speed.any()}) == 1
        return Excitation(
            where=motions[0].friction.where,
            against=motions[0].friction.against,
            reversals=sum(f.reversals for f in motions) + (not one_sign),
            stuck=float(np.mean([f.stuck_later for f in motions])),
            slowest=min(f.slowest for f in motions),
            fastest=max(f.fastest for f in motions),
        )

    @cached_property
    def tried(self) -> list[tuple[str, float | None, Array]]:
        """Experiments that could be made: what each is, its voltage, and what would then be known."""
        tried = []
        for what, volts, scene in self._scenes():
            rows = self.sensitivity.with_nuisances(self.theta, scene)
            both = np.vstack([self.rows, rows]) if scene.times else rows  # other experiments
            tried.append((what, volts, self._precision(both)))
        return tried

    def _proposals(self, name: str) -> tuple[ProposedExperiment, ...]:
        now = self._sd(name, self.known)
        proposals = [
            ProposedExperiment(what=what, volts=volts, shrink=now / self._sd(name, then))
            for what, volts, then in self.tried
        ]
        helpful = [proposal for proposal in proposals if proposal.shrink > MIN_HELPFUL_FALL]
        return tuple(sorted(helpful, key=lambda proposal: -proposal.shrink)[:MAX_PROPOSED])

    def _scenes(self) -> Iterator[tuple[str, float | None, DesignVariant]]:
        if not self.drives:
            return
        experiments = [each.experiment for each in self.sensitivity.likelihood.observations]
        supply = self.drives[0]
        size = float(np.mean([typical_inputs(experiment)[supply] for experiment in experiments]))
        stop = stall_voltage(self.model, self.rig)
        if any(supply in experiment.series for experiment in experiments):
            yield "turned", None, self._at_other_voltage(-1.0)
            if 0 < stop < size:
                yield "stops", BELOW_STALL * stop, self._at_other_voltage(BELOW_STALL * stop / size)
        elif v := self.sensitivity.mean_input(supply):
            yield "turned half-way", None, DesignVariant(late={supply: -2.0 * v})
            if 0 < stop < abs(v):
                low = float(np.sign(v)) * BELOW_STALL * stop
                yield "stops half-way", low, DesignVariant(late={supply: low - v})
        yield "half", 0.5 * size, self._at_other_voltage(0.5)

    def _at_other_voltage(self, times: float) -> DesignVariant:
        return DesignVariant(times=dict.fromkeys(self.drives, times))


def drives_of(model: Model) -> list[str]:
    """Return the inputs that drive a rig."""
    return [name for name in model.inputs if model.symbols[name].drives]


def drive_words(model: Model, drive: str) -> tuple[str, str]:
    """Return what drives a rig, in words, and how one lets go of it (empty: one cannot)."""
    roles = model.roles
    moved, torque = roles.moved(drive), roles.motion.torque
    several = f" of {moved[0].words}" if moved and len(drives_of(model)) > 1 else ""
    match moved:
        case (_, "voltage"):
            return f"voltage{several}", "motor terminals shorted"
        case (_, "current"):
            return f"current{several}", "no current"
        case (inertia, "torque"):
            return f"{torque} of {inertia.words}", f"no {torque}"
    return f"imposed speed{several}", ""


def stall_voltage(model: Model, p: Mapping[str, float]) -> float:
    """Return the voltage [V] that holds the rig at the edge of turning, against all friction.

    Or what else drives it first.  Below it the rig comes to rest: friction at rest is no less.  Zero
    where none holds it, or nothing is driven, or all by a speed.
    """
    drive = next(iter(drives_of(model)), "")
    moved = model.roles.moved(drive)
    if moved is None or moved[0].speed not in model.states:
        return 0.0
    frictions = model.frictions
    quick = dict.fromkeys((*model.states, *model.inputs), 0.0)
    sizes = {f.name: float(np.asarray(f.law.size(p, 1e6, quick))) for f in frictions}
    linear = model.linear(p)
    matrix, angles = dynamics(linear, model.states, 1), steady_state.angle_indices(model)
    speed, turn = model.states.index(moved[0].speed), steady_state.free_turn(matrix, angles)

    def at(volts: float) -> float:
        forcing = constant_forcing(linear, model.states, 1, {drive: volts, **sizes})
        return float(steady_state.states(matrix, forcing, angles, turn)[0, speed])

    still, slope = at(0.0), at(1.0) - at(0.0)
    return max(0.0, -still / slope) if slope else 0.0
