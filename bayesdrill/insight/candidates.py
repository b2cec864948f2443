"""What could be behind a fit that leaves more than noise: each a number that is not unknown yet.

Gains, offsets and lags of channels, the offset of a measured voltage, the states at the start, and efforts
that the rig lacks (`rig.effects`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.priors import Prior, TruncatedNormal, Uniform
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.record.experiment import of_states, usual_inputs
from bayesdrill.rig.effects import EFFECTS, Effect, entries
from bayesdrill.rig.models.linear import Model

Array = NDArray[np.float64]

Kind = Literal["gain", "offset", "lag", "input offset", "start", "rig"]

LATEST = 20  # samples: how far a lag is sought


@dataclass(frozen=True, slots=True)
class Candidate:
    """`of`: a channel, an input, a state, or the parameter of an effect; `label`: of an experiment, empty
    for the rig, which all share; `step`: of a lag, from one sample to the next.
    """

    kind: Kind
    of: str
    label: str
    neutral: float
    prior: Prior
    step: float = 0.0
    effect: Effect | None = None

    @property
    def name(self) -> str:
        return of_label(f"tried {self.kind} {self.of}", self.label)

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


def of_sensors(one: Observation) -> Iterator[Candidate]:
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
    size = usual_inputs(experiment)["v"]
    if "v" in experiment.series and "v" not in sensing.input_offsets:
        prior = TruncatedNormal(0.0, 0.3 * size, -math.inf, math.inf)
        yield Candidate("input offset", "v", one.label, 0.0, prior)


def of_start(one: Observation, space: ParameterSpace, theta: Array) -> list[Candidate]:
    """Each state that is held at the start, within what it does later."""
    sensing = one.response.sensing
    if sensing.steady:
        return []
    model, experiment = one.response.model, one.experiment
    reach = 2.0 * np.abs(motion(one, space, theta)).max(axis=0)
    return [
        Candidate("start", name, one.label, held, TruncatedNormal(held, far, -math.inf, math.inf))
        for name, far in zip(model.states, reach, strict=True)
        if name not in sensing.states and far > 0
        for held in [float(experiment.start.get(name, 0.0))]
    ]


def of_rig(
    every: tuple[Observation, ...], space: ParameterSpace, theta: Array
) -> Iterator[Candidate]:
    """What the rig has not, as far as it can have it; `theta (D,)`: where it moves."""
    model = every[0].response.model
    motions = [motion(one, space, theta) for one in every]
    p = rig_at(every[0], space, theta)
    for effect in EFFECTS:
        if effect.parameter not in model.parameters and possible(model, effect, p):
            size = max(_size(model, effect, p, one) for one in motions)
            if size > 0:
                prior = TruncatedNormal(0.0, size, -math.inf, math.inf)
                yield Candidate("rig", effect.parameter, "", 0.0, prior, effect=effect)


def possible(model: Model, effect: Effect, p: Mapping[str, float]) -> bool:
    """Whether the rig has a place for it."""
    try:
        entries(model, effect.place, p)
    except KeyError:
        return False
    return all(name in model.states for name in effect.states)


def rig_at(one: Observation, space: ParameterSpace, theta: Array) -> dict[str, float]:
    """The rig's parameters at `theta (D,)`."""
    told = one.told(space.full(theta[None]))[0]
    names = one.response.model.parameters
    return dict(zip(names, map(float, told[: len(names)]), strict=True))


def motion(one: Observation, space: ParameterSpace, theta: Array) -> Array:
    """All states at the samples `(T, X)`, at `theta (D,)`."""
    states = one.response.model.states
    y = np.zeros((len(one.experiment.t), len(states)))
    shown = dataclasses.replace(one.experiment, channels=of_states(states), y=y)
    return np.asarray(one.response.of(shown).signals(one.told(space.full(theta[None])))[0])


def _size(model: Model, effect: Effect, p: Mapping[str, float], states: Array) -> float:
    """Of the effect's parameter: what would do as much as all that acts there, `states (T, X)`."""
    rates = model.linear(p).A
    named = dict(zip(model.states, states.T, strict=True))
    moved = float(np.sqrt(np.mean(effect.shape(named) ** 2)))
    found = [0.0]
    for row, entry in entries(model, effect.place, p).items():
        parts = [abs(value) * np.abs(named[at]) for (to, at), value in rates.items() if to == row]
        acting = float(np.sqrt(np.mean(sum(parts, np.zeros(len(states))) ** 2)))
        if entry and moved:
            found.append(acting / (abs(entry) * moved))
    return max(found)
