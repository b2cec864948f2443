"""The contract of a model, and models that follow from another: with added physics.

Added physics is what a rig takes when its parameter is named, and is without when it is not.  A rig
that is composed has a class-level `offers`: parameters, each with the names that it means nothing
without; and a field `added`, the names that this one has.  `parameters`, `linear` and `frictions`
of an instance follow from `added`.  Of other rigs both are empty.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np

from bayesdrill.basics import symbols
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import set_constants
from bayesdrill.basics.errors import InputError, did_you_mean, short_repr
from bayesdrill.basics.symbols import SPEED_UNITS, Symbol
from bayesdrill.rig.models.friction import Friction, Gravity, Named
from bayesdrill.rig.models.roles import GEAR_POWERS, Roles, usual_roles
from bayesdrill.rig.models.servo import Saturation

HOUSE_SYMBOLS: Mapping[str, Symbol] = MappingProxyType(
    {**symbols.PARAMETERS, **symbols.STATES, **symbols.INPUTS}
)
Offers = Mapping[str, tuple[str, ...]]
NO_OFFERS: Offers = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Linear:
    """`x' = A x + B u + c`, as the entries that are not zero.

    `A` maps (row state, column state), `B` (row state, input) and `c` (row state) to values of
    any one batch shape, or to plain numbers.  The keys are the structure: kernels skip the rest.
    """

    A: Mapping[tuple[str, str], Array | float]
    B: Mapping[tuple[str, str], Array | float]
    c: Mapping[str, Array | float]


def dynamics(linear: Linear, states: tuple[str, ...], n: int) -> Array:
    """Return `A (n, X, X)` in the order of `states`, for `linear` of n parameter vectors."""
    index = {name: k for k, name in enumerate(states)}
    matrix = np.zeros((n, len(states), len(states)))
    for (row, column), value in linear.A.items():
        matrix[:, index[row], index[column]] = value
    return matrix


def constant_forcing(
    linear: Linear, states: tuple[str, ...], n: int, inputs: Mapping[str, Array | float]
) -> Array:
    """Return `B u + c`, `(n, X)`, with inputs that are numbers or `(n,)`; those not named are zero."""
    index = {name: k for k, name in enumerate(states)}
    out = np.zeros((n, len(states)))
    for row, value in linear.c.items():
        out[:, index[row]] += value
    for (row, name), value in linear.B.items():
        out[:, index[row]] += value * inputs.get(name, 0.0)
    return out


class Model(Protocol):
    """A rig: a frozen dataclass that derives from this.

    Its annotated fields are its constants, entries of `model:`, which are checked as one is made:
    `InputError`.  Names are those of `basics.symbols`, or of `declares`: symbols of parameters and
    states of its own.
    """

    def __post_init__(self) -> None:
        set_constants(self)
        check_added(self)

    @property
    def declares(self) -> tuple[Symbol, ...]:
        """Symbols of parameters and states that only this rig has."""

    @property
    def name(self) -> str:
        """The name in the registry."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of columns."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states x."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs u."""

    def linear(self, p: Named) -> Linear:
        """Return the dynamics at parameters `p`.

        These are numbers, arrays of one batch shape, numbers with slopes, or registers of a kernel:
        so they can be added, multiplied, divided and raised to whole powers, and nothing else.
        """

    # What a rig may have beside that.

    @property
    def roles(self) -> Roles:
        """What it consists of; the paper's rig with the usual names, where it does not say."""
        return usual_roles(float(getattr(self, "i_m", 1.0)))

    @property
    def symbols(self) -> Mapping[str, Symbol]:
        """The symbols of its parameters, states and inputs, and of imposed angles, by name."""
        moving = {name: symbols.STATES[name] for name in self.states if name in symbols.STATES}
        declared = {symbol.name: symbol for symbol in self.declares}
        return {**declared, **HOUSE_SYMBOLS, **moving}

    @property
    def angles(self) -> tuple[str, ...]:
        """Names of states that are angles, or positions."""
        known = self.symbols
        return tuple(name for name in self.states if known[name].unit in SPEED_UNITS)

    @property
    def imposed(self) -> Mapping[str, str]:
        """The angle that can be given in the place of each input that is a speed."""
        speeds = {speed: angle for angle, speed in self.roles.speeds.items()}
        return {name: speeds[name] for name in self.inputs if name in speeds}

    @property
    def offers(self) -> Offers:
        """Physics that it takes where it is named, each parameter with those it needs."""
        return NO_OFFERS

    @property
    def added(self) -> tuple[str, ...]:
        """The names that it has of what it offers: a field."""
        return ()

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """Dry frictions, each a column of `B`."""
        return ()

    @property
    def gravities(self) -> tuple[Gravity, ...]:
        """Pendulums, each a column of `B`."""
        return ()

    @property
    def saturation(self) -> Saturation | None:
        """The servo that saturates or has a dead band, with a column of `B`; None without any."""
        return None

    @property
    def smooth(self) -> bool:
        """Whether it is linear: nothing in it rubs, no pendulum swings, and no servo saturates."""
        return not self.frictions and not self.gravities and self.saturation is None

    @property
    def combinations(self) -> Mapping[str, Mapping[str, float]]:
        """Names beside the states that sensors may use, each with its weights of states."""
        return {}

    @property
    def has_private_names(self) -> bool:
        """Whether its names follow from its constants, so that they mean nothing to other rigs."""
        return False

    @property
    def inner(self) -> tuple[str, ...]:
        """States within a part, that no start names and no sensor sees.

        They are zero where nothing moves the part.
        """
        return ()

    @property
    def outer(self) -> tuple[str, ...]:
        """All other states."""
        return tuple(name for name in self.states if name not in self.inner)

    @property
    def gear_ratio(self) -> float:
        """Turns of the shaft for one of the motor: 1 without a gear."""
        return float(getattr(self, self.roles.gear)) if self.geared else 1.0

    @property
    def geared(self) -> bool:
        """Whether one of its constants is that ratio."""
        return bool(self.roles.gear) and hasattr(self, self.roles.gear)


def check_added(rig: Model) -> None:
    """Raise `InputError` where `added` is no tuple of names that the rig offers."""
    added: object = rig.added
    if not (isinstance(added, tuple) and all(isinstance(name, str) for name in added)):
        raise InputError.at("added", f"give a tuple of names, not {short_repr(added)}")
    offers = tuple(rig.offers)
    for name in added:
        if name not in offers:
            hint = did_you_mean(name, offers)
            raise InputError.at("added", f"{rig.name} has no {name!r} to add{hint}")


def gear_factor(rig: Model, symbol: Symbol, side: str) -> float:
    """Return the factor that refers a value at `side` (`motor` or `load`) to the symbol's own side.

    Raises `ValueError` where the symbol is on no side of the gear of `rig`.
    """
    own_side, power = rig.roles.side(symbol.name), GEAR_POWERS.get(symbol.unit)
    if not own_side or power is None:
        raise ValueError(f"{symbol.name} is on no side of the gear; leave out `side:`")
    if side == own_side:
        return 1.0
    return float(rig.gear_ratio ** (power if own_side == "motor" else -power))


@dataclass(frozen=True, slots=True)
class WrappedModel(Model):
    """A model around a `rig`: all that it does not define is the rig's; it offers nothing."""

    rig: Model

    declares: ClassVar[Any] = property(lambda self: self.rig.declares)
    symbols: ClassVar[Any] = property(lambda self: self.rig.symbols)
    combinations: ClassVar[Any] = property(lambda self: self.rig.combinations)
    name: ClassVar[Any] = property(lambda self: self.rig.name)
    parameters: ClassVar[Any] = property(lambda self: self.rig.parameters)
    states: ClassVar[Any] = property(lambda self: self.rig.states)
    inputs: ClassVar[Any] = property(lambda self: self.rig.inputs)
    frictions: ClassVar[Any] = property(lambda self: self.rig.frictions)
    gravities: ClassVar[Any] = property(lambda self: self.rig.gravities)
    saturation: ClassVar[Any] = property(lambda self: self.rig.saturation)
    inner: ClassVar[Any] = property(lambda self: self.rig.inner)
    roles: ClassVar[Any] = property(lambda self: self.rig.roles)
    gear_ratio: ClassVar[Any] = property(lambda self: self.rig.gear_ratio)
    geared: ClassVar[Any] = property(lambda self: self.rig.geared)


@dataclass(frozen=True, slots=True)
class ParameterNames:
    """A descriptor of parameters: `always`, of the class too, and behind them what is `added`."""

    always: tuple[str, ...]

    def __get__(self, rig: Any, kind: type | None = None) -> tuple[str, ...]:
        return self.always if rig is None else (*self.always, *rig.added)


@dataclass(frozen=True, slots=True)
class StateNames:
    """A descriptor of states: `always`, of the class too, and those that groups of `added` bring."""

    always: tuple[str, ...]
    brought: Mapping[tuple[str, ...], tuple[str, ...]]

    def __get__(self, rig: Any, kind: type | None = None) -> tuple[str, ...]:
        groups = self.brought.items() if rig is not None else ()
        more = (names for needed, names in groups if {*needed} <= {*rig.added})
        return (*self.always, *(name for names in more for name in names))


def with_named(rig: Model, names: Collection[str]) -> Model:
    """Return the rig with what it has, and what it offers of these names, in its own order."""
    wanted = {*names, *rig.added}
    added = tuple(name for name in rig.offers if name in wanted)
    if not added:
        return rig
    composed: Model = dataclasses.replace(rig, added=added)  # type: ignore[type-var]
    return composed


def with_all(rig: Model) -> Model:
    """Return the rig with all that it offers."""
    return with_named(rig, rig.offers)


def missing_requirements(rig: Model) -> dict[str, tuple[str, ...]]:
    """Return what is added in vain, each with what it means nothing without."""
    needs = {name: rig.offers.get(name, ()) for name in rig.added}
    missing = {name: tuple(n for n in names if n not in rig.added) for name, names in needs.items()}
    return {name: names for name, names in missing.items() if names}


def weak_statics(rig: Model, p: Mapping[str, Any]) -> dict[str, str]:
    """Return a message on each static friction below the sliding one at all of `p`, by its name."""
    why = "is below {}; static friction is at least as large as sliding friction"
    inertias = rig.roles.inertias
    pairs = [(i.static, i.sliding) for i in inertias if {i.static, i.sliding} <= {*p}]
    for back, other in ((i.static_back, i.sliding_back) for i in inertias):
        pairs += [(back, other)] if {back, other} <= {*p} else []
    return {s: why.format(c) for s, c in pairs if np.all(np.asarray(p[s]) < p[c])}


def requirement_text(name: str, missing: Collection[str]) -> str:
    """Return the message on a name that is added in vain."""
    others = " and ".join(missing)
    return f"{name} means nothing without {others}; name {others} too, or remove {name}"


def constants(rig: Any) -> dict[str, Any]:
    """Return the gear, and other fields that differ from their defaults, by name."""
    values = {
        entry.name: (getattr(rig, entry.name), entry.default) for entry in dataclasses.fields(rig)
    }
    gear = rig.roles.gear
    return {n: value for n, (value, default) in values.items() if n == gear or value != default}
