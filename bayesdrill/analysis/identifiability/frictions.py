"""Find frictions, dampings and voltage drops that a record can hardly distinguish.

The information of record and priors shows which parameters these are, and the motion at the studied
point explains why.  Further experiments are judged by the information that they would add.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.analysis.friction_motion import friction_motions
from bayesdrill.analysis.identifiability.information import DesignVariant, SensitivityStudy
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import typical_inputs
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.friction import DIRECTION
from bayesdrill.rig.models.linear import Model, constant_forcing, dynamics
from bayesdrill.rig.models.roles import Roles

KNOWN_SD = 0.1  # a parameter with a smaller sd of its log counts as known, whatever it resembles
MIN_FALL = 2.0  # smallest factor by which known rivals reduce the sd of a confounded parameter
MIN_EXPLAINED_FALL = 0.8  # smallest fraction of that factor's log that reported rivals explain
MIN_HELPFUL_FALL = 1.5  # smallest factor by which a proposed experiment reduces an sd
MAX_PROPOSED = 2  # largest number of experiments that are proposed
STICTION_GONE_SPEEDS = 3.0  # speed divided by its scale `fading`, above which stiction is gone
LOST_SHARE = 0.9  # sd divided by the prior's sd, above which the record shows nothing
ONE_SPEED_SHARE = 0.25  # (fastest - slowest) / (fastest + slowest), below which there is one speed
BELOW_STALL = 0.8  # proposed voltage divided by the voltage below which the rig comes to rest


def rivals(roles: Roles) -> dict[str, tuple[str, ...]]:
    """Map the name of each friction, damping or voltage drop to the parameters that act alike."""
    inertias, motors = roles.inertias, roles.motors
    back_emfs = [motor.back_emf for motor in motors]
    similar: dict[str, tuple[str, ...]] = {}
    for here in inertias:
        others = [n for i in inertias if i is not here for n in (i.sliding, i.friction, i.damping)]
        own_motors = [m for m in motors if m.inertia == here.name]
        circuit = [name for m in own_motors for name in (m.drop, f"offset_{m.voltage}")]
        own = (here.friction, here.damping)
        similar[here.sliding] = (*own, *back_emfs, *others, here.efficiency, *circuit)
    for motor in motors:
        here = roles.inertia(motor.inertia)
        frictions = (here.sliding, here.friction, here.damping)
        circuit = [motor.resistance, f"offset_{motor.voltage}"]
        similar[motor.drop] = (motor.back_emf, *frictions, *circuit)
    for shaft in roles.shafts:
        similar[shaft.damping] = tuple(inertia.damping for inertia in inertias)
    for here in inertias:
        similar[here.efficiency] = (here.sliding, here.friction, here.damping)
        similar[here.sliding_back] = (here.friction, here.damping_back, here.sliding)
        similar[here.efficiency_back] = (here.sliding_back, here.sliding, here.friction)
    return {name: names for name, names in similar.items() if name}


@dataclass(frozen=True, slots=True, kw_only=True)
class Excitation:
    """The excitation describes the motion at a friction `where`, over all records.

    `against` names the state that the friction opposes: a speed, SI, or a current [A].  `reversals`
    counts the state's changes of sign, and `stuck` is the fraction of time at rest.  `slowest` and
    `fastest` are the smallest and largest magnitude of the state after the start.
    """

    where: str
    against: str
    reversals: int
    stuck: float
    slowest: float
    fastest: float

    @property
    def one_speed(self) -> bool:
        """Return whether the speed hardly changes."""
        return self.fastest - self.slowest < ONE_SPEED_SHARE * (self.fastest + self.slowest)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProposedExperiment:
    """A proposed experiment, at `volts` if given, would reduce an sd by the factor `shrink`."""

    what: str
    volts: float | None
    shrink: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Confounded:
    """A parameter resembles its `rivals`; if they were known, its sd would fall by the factor `fall`."""

    name: str
    rivals: tuple[str, ...]
    fall: float
    deeds: Excitation | None
    proposals: tuple[ProposedExperiment, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenStiction:
    """Static friction has parameters that no record shows, as all speeds are far above its `scale`."""

    names: tuple[str, ...]
    scale: float
    deeds: Excitation
    proposals: tuple[ProposedExperiment, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionConfounding:
    """A record can hardly distinguish the frictions `alike`, and does not show stictions `unseen`."""

    alike: tuple[Confounded, ...] = ()
    unseen: tuple[UnseenStiction, ...] = ()


NO_CONFOUNDING = FrictionConfounding()


def distinguish(
    sensitivity: SensitivityStudy, posterior: Posterior, theta: Array
) -> FrictionConfounding:
    """Find frictions that the record can hardly distinguish at `theta (D,)`."""
    roles = sensitivity.model.roles
    wanted = {*rivals(roles), *(name for i in roles.inertias for name in (i.static, i.fading))}
    if not wanted & {*sensitivity.unknowns, *sensitivity.nuisances}:
        return NO_CONFOUNDING
    scene = _FrictionStudy(sensitivity, posterior, theta)
    return FrictionConfounding(alike=tuple(scene.confounded()), unseen=tuple(scene.unseen()))


class _FrictionStudy:
    """The study of frictions uses the whitened sensitivities `rows (n, m + k)` of the records."""

    def __init__(self, sensitivity: SensitivityStudy, posterior: Posterior, theta: Array) -> None:
        self.sensitivity, self.theta, self.model = sensitivity, theta, sensitivity.model
        self.names = (*sensitivity.unknowns, *sensitivity.nuisances)
        self.rows = sensitivity.with_nuisances(theta)
        self.known = self._precision(self.rows)
        motions = friction_motions(posterior, theta, np.empty((0, len(theta))))
        self.frictions = [*itertools.chain.from_iterable(motions)]
        self.rig, self.drives = sensitivity.rig_at(theta), drives_of(self.model)

    def _precision(self, rows: Array) -> Array:
        return np.asarray(rows.T @ rows + np.diag(self.sensitivity.prior_spreads**-2.0))

    def _sd(self, name: str, precision: Array, known: Sequence[str] = ()) -> float:
        unknown = [k for k, other in enumerate(self.names) if other not in known]
        inside = precision[np.ix_(unknown, unknown)]
        scale = 1.0 / np.sqrt(np.diag(inside))
        spread = np.linalg.pinv(inside * scale[:, None] * scale, hermitian=True)
        k = [self.names[j] for j in unknown].index(name)
        return float(scale[k] * np.sqrt(spread[k, k]))

    def confounded(self) -> Iterator[Confounded]:
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
        self, name: str, rivals: Sequence[str], sd_alone: float, fall: float
    ) -> tuple[str, ...]:
        """Select, one after the other, the rivals that would reduce the sd most if they were known."""
        named: list[str] = []
        while len(named) < len(rivals):
            others = [rival for rival in rivals if rival not in named]
            sds = [self._sd(name, self.known, [*named, rival]) for rival in others]
            named.append(others[int(np.argmin(sds))])
            if np.log(sd_alone / min(sds)) >= MIN_EXPLAINED_FALL * np.log(fall):
                break
        return tuple(named)

    def unseen(self) -> Iterator[UnseenStiction]:
        for at in self.model.roles.inertias:
            scale = at.fading
            names = [parameter for parameter in (at.static, scale) if parameter in self.names]
            speed, deeds = float(self.rig.get(scale, np.nan)), self._excitation({*names})
            spreads = dict(zip(self.names, self.sensitivity.prior_spreads, strict=True))
            lost = tuple(n for n in names if self._sd(n, self.known) > LOST_SHARE * spreads[n])
            if not lost or deeds is None or deeds.stuck > 0:
                continue
            if not deeds.slowest < STICTION_GONE_SPEEDS * speed:
                proposed = self._proposals(lost[0])
                yield UnseenStiction(names=lost, scale=speed, deeds=deeds, proposals=proposed)

    def _excitation(self, parameters: set[str]) -> Excitation | None:
        """Return the excitation of the frictions with any of these parameters, or None."""
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
    def experiments(self) -> list[tuple[str, float | None, Array]]:
        """Return name, voltage and posterior precision of each possible experiment."""
        tried = []
        for what, volts, scene in self._scenes():
            rows = self.sensitivity.with_nuisances(self.theta, scene)
            both = np.vstack([self.rows, rows]) if scene.factors else rows  # a further record
            tried.append((what, volts, self._precision(both)))
        return tried

    def _proposals(self, name: str) -> tuple[ProposedExperiment, ...]:
        now = self._sd(name, self.known)
        proposals = [
            ProposedExperiment(what=what, volts=volts, shrink=now / self._sd(name, then))
            for what, volts, then in self.experiments
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
            yield "turned half-way", None, DesignVariant(shifts={supply: -2.0 * v})
            if 0 < stop < abs(v):
                low = float(np.sign(v)) * BELOW_STALL * stop
                yield "stops half-way", low, DesignVariant(shifts={supply: low - v})
        yield "half", 0.5 * size, self._at_other_voltage(0.5)

    def _at_other_voltage(self, times: float) -> DesignVariant:
        return DesignVariant(factors=dict.fromkeys(self.drives, times))


def drives_of(model: Model) -> list[str]:
    """Return the inputs that drive a rig."""
    return [name for name in model.inputs if model.symbols[name].drives]


def drive_words(model: Model, drive: str) -> tuple[str, str]:
    """Return a drive in words, and how to let the rig coast (empty if that is impossible)."""
    roles = model.roles
    moved, torque = roles.moved(drive), roles.motion.torque
    several = f" of {moved[0].words}" if moved and len(drives_of(model)) > 1 else ""
    match moved:
        case (_, "voltage"):
            return f"voltage{several}", "motor terminals shorted"
        case (_, "goal"):
            return f"goal{several}", ""
        case (_, "current"):
            return f"current{several}", "no current"
        case (inertia, "torque"):
            return f"{torque} of {inertia.words}", f"no {torque}"
    return f"imposed speed{several}", ""


def stall_voltage(model: Model, p: Mapping[str, float]) -> float:
    """Return the value of the first drive, such as a voltage [V], that just overcomes friction.

    At lower values the rig comes to rest, as friction at rest is no smaller than in motion.  The result
    is zero without friction, without a drive, and if the drive is a speed.
    """
    drive = next(iter(drives_of(model)), "")
    moved = model.roles.moved(drive)
    if moved is None or moved[0].speed not in model.states:
        return 0.0
    frictions = model.frictions
    others = {**dict.fromkeys((*model.states, *model.inputs), 0.0), DIRECTION: 1.0}
    # At this speed static friction has faded.
    sizes = {f.name: float(np.asarray(f.law.size(p, 1e6, others))) for f in frictions}
    linear = model.linear(p)
    matrix, angles = dynamics(linear, model.states, 1), steady_state.angle_indices(model)
    speed, turn = model.states.index(moved[0].speed), steady_state.free_turn(matrix, angles)

    def final_speed(volts: float) -> float:
        forcing = constant_forcing(linear, model.states, 1, {drive: volts, **sizes})
        return float(steady_state.states(matrix, forcing, angles, turn)[0, speed])

    offset, slope = final_speed(0.0), final_speed(1.0) - final_speed(0.0)
    return max(0.0, -offset / slope) if slope else 0.0
