"""Define which names a config may use: symbols of its rig's parameters, states and inputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bayesdrill.basics import symbols
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig import models
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model, with_all, with_named


@dataclass(frozen=True, kw_only=True)
class Vocabulary:
    """A vocabulary has the symbols of a rig with all optional physics, in the rig's order."""

    parameters: Mapping[str, Symbol]
    states: Mapping[str, Symbol]
    inputs: Mapping[str, Symbol]
    combined: Mapping[str, Symbol]  # linear combinations of states that have a name for channels
    inner: frozenset[str]  # states without an initial value in the config
    angles: Mapping[str, Symbol]  # angles that may replace an input speed, by the speed's name
    optional_inputs: frozenset[str]  # inputs that are zero unless the config gives them
    inertias: tuple[str, ...]

    def __hash__(self) -> int:
        return hash((*self.parameters, *self.states, *self.inputs))

    @cached_property
    def starts(self) -> Mapping[str, Symbol]:
        """Return the symbols of states that `initial:` may name."""
        return {name: symbol for name, symbol in self.states.items() if name not in self.inner}

    @cached_property
    def signals(self) -> Mapping[str, Symbol]:
        """Return the symbols whose names a channel without `measures:` may have."""
        return {**self.states, **self.combined}

    @cached_property
    def imposed(self) -> Mapping[str, str]:
        """Return the name of the angle that may replace an input, by the input's name."""
        return {speed: angle.name for speed, angle in self.angles.items()}

    @cached_property
    def entries(self) -> Mapping[str, Symbol]:
        """Return the symbols of inputs by name; an angle follows the input that it may replace."""
        pairs = ((symbol, self.angles.get(name)) for name, symbol in self.inputs.items())
        return {symbol.name: symbol for pair in pairs for symbol in pair if symbol is not None}


def idle_inputs(rig: Model) -> set[str]:
    """Return the load inputs of a rig, which are zero by default."""
    pushes = {name for inertia in rig.roles.inertias for name in (inertia.load, inertia.torque)}
    return {name for name in pushes & {*rig.inputs} if not rig.symbols[name].drives}


def described_rigs() -> list[str]:
    """Return the names of the models, such as `train`, whose parts a config lists itself."""
    return [name for name, kind in MODELS.usable().items() if kind().has_private_names]


def _house() -> Vocabulary:
    """Return the common vocabulary of all rigs whose symbols do not depend on the config."""
    rigs = [with_all(kind()) for kind in MODELS.usable().values()]
    rigs = [rig for rig in rigs if not rig.has_private_names]
    imposed = {speed: angle for rig in rigs for speed, angle in rig.imposed.items()}
    return Vocabulary(
        parameters=dict(models.PARAMETERS),
        states=dict(models.STATES),
        inputs=dict(symbols.INPUTS),
        combined={},
        inner=models.INNER,
        angles={n: models.STATES[imposed[n]] for n in symbols.INPUTS if n in imposed},
        optional_inputs=frozenset(name for rig in rigs for name in idle_inputs(rig)),
        inertias=("motor", "rotor_1"),
    )


HOUSE = _house()


def vocabulary_of(rig: Model) -> Vocabulary:
    """Return the vocabulary of a rig, `HOUSE` if its symbols do not depend on the config."""
    if not rig.has_private_names:
        return HOUSE
    plain: Any = rig
    bare: Model = dataclasses.replace(plain, added=())
    offered = [with_named(bare, (name, *needs)) for name, needs in bare.offers.items()]
    variants, known = [bare, *offered], rig.symbols  # some optional parts exclude others

    def symbols_of(names: str) -> dict[str, Symbol]:
        return {name: known[name] for variant in variants for name in getattr(variant, names)}

    return Vocabulary(
        parameters=symbols_of("parameters"),
        states=symbols_of("states"),
        inputs=symbols_of("inputs"),
        combined=symbols_of("combinations"),
        inner=frozenset(name for variant in variants for name in variant.inner),
        angles={speed: known[angle] for speed, angle in rig.imposed.items()},
        optional_inputs=frozenset(name for variant in variants for name in idle_inputs(variant)),
        inertias=tuple(inertia.name for inertia in rig.roles.inertias),
    )
