"""What is not of the rig itself in an experiment: gains, offsets and delays of sensors, and the start.

y_k(t) = gain_k c_k . x(t - lag_k - delay) + offset_k        x' = A x + B (gain_u u + offset_u) + c

A delay is one of all that drives the rig, offsets of inputs among it: until then it is at its start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from bayesdrill.rig import vocabulary
from bayesdrill.rig.models.linear import Around, Linear, Model, Named


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """Names of parameters by what they belong to: channels, inputs, states.

    `input_lags`: by how much later than its record the rig feels an input, each by itself.
    `delay`: of all inputs, or of the moment at which constant ones are switched on.  `states`: of the
    start; `steady`: the rest of it is the steady state under the first inputs.
    """

    gains: Mapping[str, str] = field(default_factory=dict)
    offsets: Mapping[str, str] = field(default_factory=dict)
    lags: Mapping[str, str] = field(default_factory=dict)
    input_gains: Mapping[str, str] = field(default_factory=dict)
    input_offsets: Mapping[str, str] = field(default_factory=dict)
    input_lags: Mapping[str, str] = field(default_factory=dict)
    delay: str | None = None
    states: Mapping[str, str] = field(default_factory=dict)
    steady: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Each once."""
        return tuple(dict.fromkeys(self._every()))

    def _every(self) -> Iterator[str]:
        inputs = (self.input_gains, self.input_offsets, self.input_lags)
        for of in (self.gains, self.offsets, self.lags, *inputs):
            yield from of.values()
        if self.delay is not None:
            yield self.delay
        yield from self.states.values()

    @property
    def shifts(self) -> bool:
        """Whether any channel is seen at other times than those of the inputs."""
        return bool(self.lags) or self.delay is not None

    def moves(self, start: Mapping[str, float]) -> bool:
        """Whether a rig with this `start` may turn, or carry a current, before the first sample."""
        held = [x for name, x in start.items() if vocabulary.STATES[name].unit != "rad"]
        return self.steady or bool(self.states) or any(held)

    @property
    def in_words(self) -> str:
        """What each of them has: `twist: gain, lag; v: offset; inputs: delay`."""
        found: dict[str, list[str]] = {}
        kinds = (("gain", self.gains), ("offset", self.offsets), ("lag", self.lags))
        inputs = (
            ("gain", self.input_gains), ("offset", self.input_offsets), ("lag", self.input_lags)
        )  # fmt: skip
        for kind, named in (*kinds, *inputs):
            for of in named:
                found.setdefault(of, []).append(kind)
        if self.delay is not None:
            found["inputs"] = ["delay"]
        return "; ".join(f"{of}: {', '.join(has)}" for of, has in found.items())

    @property
    def start_in_words(self) -> str:
        """Whether it is steady, and which states of it are unknown."""
        unknown = f"{', '.join(self.states)} unknown" if self.states else ""
        return ", ".join(filter(None, ["steady" if self.steady else "", unknown]))

    @property
    def nothing(self) -> bool:
        return not self.names and not self.steady


@dataclass(frozen=True, slots=True)
class Wired(Around):
    """`rig` behind the sensors of its inputs: their gains and offsets are parameters of it."""

    input_gains: tuple[tuple[str, str], ...]
    input_offsets: tuple[tuple[str, str], ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        own = [name for _, name in (*self.input_gains, *self.input_offsets)]
        return (*self.rig.parameters, *dict.fromkeys(own))

    def linear(self, p: Named) -> Linear:
        found, gains, offsets = self.rig.linear(p), dict(self.input_gains), dict(self.input_offsets)
        b, c = dict(found.B), dict(found.c)
        for (row, name), value in found.B.items():
            if name in gains:
                b[row, name] = value * p[gains[name]]
            if name in offsets:
                c[row] = c.get(row, 0.0) + value * p[offsets[name]]
        return Linear(A=found.A, B=b, c=c)


def wired(rig: Model, sensing: Sensing) -> Model:
    """The rig itself where nothing of its inputs is to be told."""
    if not sensing.input_gains and not sensing.input_offsets:
        return rig
    gains, offsets = sensing.input_gains.items(), sensing.input_offsets.items()
    return Wired(rig, tuple(gains), tuple(offsets))
