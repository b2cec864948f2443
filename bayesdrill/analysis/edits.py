"""A posterior in which more is unknown: what could be behind a fit that leaves more than noise.

Gains, offsets and lags of channels, the offset of a measured voltage, lags of single inputs, the states
at the start, and physics that the rig offers and has not been given.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Prior, TruncatedNormal, Uniform
from bayesdrill.inference.unknowns import MOVES, ParameterSpace, Unknown, of_label
from bayesdrill.record.experiment import DRIVES, of_states, usual_inputs
from bayesdrill.rig.models.linear import Linear, Model, with_named
from bayesdrill.rig.simulators.sensors import Sensing

Kind = Literal["gain", "offset", "lag", "input offset", "input lag", "start", "rig"]

LATEST = 20  # samples: how far a lag is sought
SLOW, SHARE = 0.1, 0.05  # s, of the record: how far that of an input is, where samples come faster
APART = 6  # steps from none to the largest lag of an input
ZERO = np.zeros(1)

# What a rig may be without, each by the role of the parameter that switches it on.
LACKS = ("motor.sliding", "rotor.sliding", "motor.drop", "rotor.damping", "shaft.damping")


@dataclass(frozen=True, slots=True)
class Candidate:
    """`of`: a channel, an input, a state, or a parameter that the rig lacks; `label`: of an experiment,
    empty for the rig, which all share; `step`: of a lag, from one sample to the next.
    """

    kind: Kind
    of: str
    label: str
    neutral: float
    prior: Prior
    step: float = 0.0

    @property
    def name(self) -> str:
        return (
            self.of if self.kind == "rig" else of_label(f"tried {self.kind} {self.of}", self.label)
        )

    def at(self, lag: float) -> float:
        """Where a search begins; `lag` in samples."""
        return self.neutral + lag * self.step

    @property
    def group(self) -> tuple[str, str]:
        """The same thing in all experiments; a start is one thing with all its states."""
        return (self.kind, "" if self.kind == "start" else self.of)

    @property
    def unknown(self) -> Unknown:
        symbol = Symbol(self.name, "", "", "", "")
        return Unknown(symbol=symbol, role="sensor", prior=self.prior, start=self.neutral)


def sensor_candidates(one: Observation) -> Iterator[Candidate]:
    """What is not told of its sensors yet."""
    sensing = one.response.sensing
    experiment, latest = one.experiment, LATEST * one.experiment.dt
    for k, channel in enumerate(experiment.channels):
        y = experiment.y[experiment.seen[:, k], k]
        spread = float(y.std())
        if not spread > 0:
            continue
        if channel.name not in sensing.gains:
            prior = TruncatedNormal(1.0, 0.5, 0.05, math.inf)
            yield Candidate("gain", channel.name, one.label, 1.0, prior)
        if channel.name not in sensing.offsets:
            prior = TruncatedNormal(0.0, spread, -math.inf, math.inf)
            yield Candidate("offset", channel.name, one.label, 0.0, prior)
        if channel.name not in sensing.lags and sensing.delay is None:
            late = Uniform(-latest, latest)
            yield Candidate("lag", channel.name, one.label, 0.0, late, experiment.dt)
    supply = one.response.model.roles.motor.voltage
    if supply in experiment.series and supply not in sensing.input_offsets:
        size = usual_inputs(experiment)[supply]
        prior = TruncatedNormal(0.0, 0.3 * size, -math.inf, math.inf)
        yield Candidate("input offset", supply, one.label, 0.0, prior)
    yield from _of_late_inputs(one)


def _of_late_inputs(one: Observation) -> Iterator[Candidate]:
    """All but the first, as lags of channels stand for that of all."""
    experiment, sensing = one.experiment, one.response.sensing
    every = sorted(experiment.series, key=lambda name: name not in DRIVES)
    if sensing.delay is not None or set(sensing.input_lags) & set(every[:1]):
        return
    duration = float(experiment.t[-1] - experiment.t[0])
    latest = max(LATEST * experiment.dt, min(SLOW, SHARE * duration))
    for name in every[1:]:
        if name not in sensing.input_lags:
            late = Uniform(-latest, latest)
            yield Candidate("input lag", name, one.label, 0.0, late, latest / APART)


def start_candidates(one: Observation, space: ParameterSpace, theta: Array) -> list[Candidate]:
    """Each state that is held at the start, within what it does later."""
    sensing = one.response.sensing
    if sensing.steady:
        return []
    model, experiment = one.response.model, one.experiment
    reach = 2.0 * np.abs(motion(one, space, theta)).max(axis=0)
    return [
        Candidate("start", name, one.label, held, TruncatedNormal(held, far, -math.inf, math.inf))
        for name, far in zip(model.states, reach, strict=True)
        if name not in (*sensing.states, *model.inner) and far > 0
        for held in [float(experiment.start.get(name, 0.0))]
    ]


def rig_candidates(
    every: tuple[Observation, ...], space: ParameterSpace, theta: Array
) -> Iterator[Candidate]:
    """What the rig offers and has not, as far as it can have it; `theta (D,)`: where it moves."""
    model = every[0].response.model
    lacks = [model.roles[role] for role in LACKS]
    names = [name for name in lacks if name in model.offers and name not in model.parameters]
    moved = (
        [(rig_at(one, space, theta), motion(one, space, theta)) for one in every] if names else []
    )
    for name in names:
        size = max(_size(with_named(model, (name,)), name, p, states) for p, states in moved)
        if size > 0:
            yield Candidate("rig", name, "", 0.0, Uniform(0.0, size))


def rig_at(one: Observation, space: ParameterSpace, theta: Array) -> dict[str, float]:
    """The rig's parameters at `theta (D,)`."""
    told = one.told(space.full(theta[None]))[0]
    names = one.response.model.parameters
    return dict(zip(names, map(float, told[: len(names)]), strict=False))


def motion(one: Observation, space: ParameterSpace, theta: Array) -> Array:
    """All states at the samples `(T, X)`, at `theta (D,)`."""
    states = one.response.model.states
    y = np.zeros((len(one.experiment.t), len(states)))
    shown = dataclasses.replace(one.experiment, channels=of_states(states), y=y)
    return np.asarray(one.response.of(shown).signals(one.told(space.full(theta[None])))[0])


def _size(model: Model, name: str, p: Mapping[str, float], states: Array) -> float:
    """What the parameter would be if it did as much as all else that acts where it does.

    `states (T, X)`: of the motion without it.
    """
    without, alone = (model.linear({**p, name: value}) for value in (0.0, 1.0))
    named = dict(zip(model.states, states.T, strict=True))
    found = [0.0]
    for row in model.states:
        acting = _rates(without, row, named)
        changed = [(k, x) for k, x in alone.A.items() if k[0] == row and x != without.A.get(k, 0.0)]
        own = sum((np.asarray(x - without.A.get(k, 0.0)) * named[k[1]] for k, x in changed), ZERO)
        for one in model.frictions:
            if name in one.law.parameters and (row, one.name) in alone.B:
                own = own + np.asarray(alone.B[row, one.name]) * np.sign(named[one.against])
        if (size := float(np.sqrt(np.mean(own**2)))) > 0:
            found.append(acting / size)
    return max(found)


def _rates(linear: Linear, row: str, named: Mapping[str, Array]) -> float:
    """The root mean square of all that acts there, taken as if it acted one way.

    Angles act by their differences alone, in springs: together, as a rig may have turned anywhere.
    """
    every = [(k[1], x * named[k[1]]) for k, x in linear.A.items() if k[0] == row]
    rates: dict[str, list[float]] = {}
    for (of, by), x in linear.A.items():
        rates.setdefault(of, []).append(float(x) if of != by else math.nan)
    turned = {of for of, each in rates.items() if each == [1.0]}  # whose rate is another state
    springs = [part for of, part in every if of in turned]
    parts = [sum(springs, ZERO), *(part for of, part in every if of not in turned)]
    return float(np.sqrt(np.mean(sum(map(np.abs, parts), ZERO) ** 2)))


@dataclass(frozen=True, slots=True)
class Widened:
    """`every`: what is tried, in the order in which it stands in `posterior`, before the noise."""

    posterior: Posterior
    every: tuple[Candidate, ...]

    @property
    def tried(self) -> slice:
        """Places of what is tried among the unknowns."""
        last = len(self.posterior.space.columns(*MOVES))
        return slice(last - len(self.every), last)

    def at(self, theta: Array, lag: float = 0.0) -> Array:
        """The unknowns `theta (D,)`, and what is tried where its search begins, `(E,)`."""
        where = self.tried.start
        return np.insert(theta, where, [one.at(lag) for one in self.every])


def widened(posterior: Posterior, theta: Array, kinds: frozenset[Kind]) -> Widened:
    """With all unknown that is of these kinds, at `theta (D,)` and neutral so far."""
    space, every = posterior.space, posterior.likelihood.observations
    rig = tuple(rig_candidates(every, space, theta)) if "rig" in kinds else ()
    tried = [*rig]
    for one in every:
        tried += [c for c in sensor_candidates(one) if c.kind in kinds]
        tried += start_candidates(one, space, theta) if "start" in kinds else []

    def with_tried(one: Observation) -> Observation:
        seen = _without_first(one) if "start" in kinds else one  # it may move before its start
        model = with_named(one.response.model, [c.of for c in rig])
        own = [c for c in tried[len(rig) :] if c.label == one.label]
        return seen.of_rig(model, _sensing(one.response.sensing, own))

    free = [c.unknown for c in tried]
    return Widened(posterior.edit(free=free, each=with_tried), tuple(tried))


def _sensing(old: Sensing, tried: Sequence[Candidate]) -> Sensing:
    """With what is `tried` of the sensors and the start of one experiment."""
    fields: dict[str, Kind] = {
        "gains": "gain",
        "offsets": "offset",
        "lags": "lag",
        "input_offsets": "input offset",
        "input_lags": "input lag",
        "states": "start",
    }
    more = {n: {c.of: c.name for c in tried if c.kind == kind} for n, kind in fields.items()}
    return dataclasses.replace(old, **{n: getattr(old, n) | new for n, new in more.items()})


def _without_first(one: Observation) -> Observation:
    """Before a lag is over, a rig in motion shows what was before its start.  Too short a record, and
    one whose noise needs every sample, stay whole.
    """
    experiment, y = one.experiment, np.array(one.experiment.y)
    y[experiment.t < experiment.t_start + LATEST * experiment.dt] = np.nan
    if np.isnan(y).mean() >= 0.5:
        return one
    try:
        return one.on(y)
    except ValueError:
        return one
