"""Define the contract of a rig, and models that wrap a rig to add physics.

A rig may offer optional physics, such as a damping, which is used only if a config names its
parameter. The class-level `offers` maps each optional parameter to the parameters that it requires.
The field `added` has the names that an instance uses; its `parameters`, `linear` and `frictions`
follow from them. `offers` and `added` are empty for rigs without options.
"""

from __future__ import annotations

import dataclasses
import itertools
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
    """Linear dynamics are the non-zero entries of `x' = A x + B u + c`.

    `A` maps (row state, column state), `B` (row state, input) and `c` (row state) to numbers,
    or to arrays of one common batch shape. The keys are the structure of the system: kernels skip
    all other entries.
    """

    A: Mapping[tuple[str, str], Array | float]
    B: Mapping[tuple[str, str], Array | float]
    c: Mapping[str, Array | float]


def dynamics(linear: Linear, states: tuple[str, ...], n: int) -> Array:
    """Return `A (n, X, X)` in the order of `states`, from `linear` at n parameter vectors."""
    index = {name: k for k, name in enumerate(states)}
    matrix = np.zeros((n, len(states), len(states)))
    for (row, column), value in linear.A.items():
        matrix[:, index[row], index[column]] = value
    return matrix


def constant_forcing(
    linear: Linear, states: tuple[str, ...], n: int, inputs: Mapping[str, Array | float]
) -> Array:
    """Return `B u + c`, `(n, X)`, for `inputs` that are numbers or `(n,)`; all other inputs are zero."""
    index = {name: k for k, name in enumerate(states)}
    out = np.zeros((n, len(states)))
    for row, value in linear.c.items():
        out[:, index[row]] += value
    for (row, name), value in linear.B.items():
        out[:, index[row]] += value * inputs.get(name, 0.0)
    return out


class Model(Protocol):
    """A rig is a frozen dataclass that derives from this contract.

    Its annotated fields are its constants, which a config gives under `model:`. The constructor checks
    them, and raises `InputError` if a constant is invalid. Names of parameters and states are those
    of `basics.symbols`, or those that the rig `declares` itself.
    """

    def __post_init__(self) -> None:
        set_constants(self)
        check_added(self)

    @property
    def declares(self) -> tuple[Symbol, ...]:
        """Return the symbols of parameters and states that only this rig has."""

    @property
    def name(self) -> str:
        """Return the name of the rig in the registry."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters, in the order of columns."""

    @property
    def states(self) -> tuple[str, ...]:
        """Return the names of the states x."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs u."""

    def linear(self, p: Named) -> Linear:
        """Return the linear dynamics at parameters `p`.

        The values of `p` are numbers, arrays of one batch shape, dual numbers, or registers of a
        kernel. So a model may only add, subtract, multiply and divide them, and raise them to
        whole powers.
        """

    # The following members are optional: a rig overrides them if their defaults do not apply.

    @property
    def roles(self) -> Roles:
        """Return the rig's inertias, shafts and motors; by default those of the paper's rig."""
        return usual_roles(float(getattr(self, "i_m", 1.0)))

    @property
    def symbols(self) -> Mapping[str, Symbol]:
        """Return the symbols of parameters, states, inputs and imposed angles, by name."""
        moving = {name: symbols.STATES[name] for name in self.states if name in symbols.STATES}
        declared = {symbol.name: symbol for symbol in self.declares}
        return {**declared, **HOUSE_SYMBOLS, **moving}

    @property
    def angles(self) -> tuple[str, ...]:
        """Return the names of states that are angles, or positions."""
        known = self.symbols
        return tuple(name for name in self.states if known[name].unit in SPEED_UNITS)

    @property
    def imposed(self) -> Mapping[str, str]:
        """Map each input that is a speed to the angle that may be imposed in its place."""
        speeds = {speed: angle for angle, speed in self.roles.speeds.items()}
        return {name: speeds[name] for name in self.inputs if name in speeds}

    @property
    def offers(self) -> Offers:
        """Return the optional parameters, each with the parameters that it requires."""
        return NO_OFFERS

    @property
    def added(self) -> tuple[str, ...]:
        """Return the optional parameters that this instance has; rigs with options make it a field."""
        return ()

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """Return the dry frictions, each of which is a column of `B`."""
        return ()

    @property
    def gravities(self) -> tuple[Gravity, ...]:
        """Return the pendulums, each of which is a column of `B`."""
        return ()

    @property
    def saturation(self) -> Saturation | None:
        """Return the servo that is nonlinear or has a measured supply, or None; see `Saturation`."""
        return None

    def acting(self, p: Named, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return `inputs` as they act on frictions and on a servo's supply, from recorded ones."""
        return inputs

    @property
    def smooth(self) -> bool:
        """Return whether the rig is linear: it has no dry friction, pendulum or nonlinear servo."""
        return not self.frictions and not self.gravities and self.saturation is None

    @property
    def combinations(self) -> Mapping[str, Mapping[str, float]]:
        """Return further signals that sensors may measure, each as weights of states."""
        return {}

    @property
    def has_private_names(self) -> bool:
        """Return whether names follow from the rig's constants, so that no other rig shares them."""
        return False

    @property
    def inner(self) -> tuple[str, ...]:
        """Return the states inside a part, such as a shaft with an inertia of its own.

        Sensors do not measure them, and configs give no start values: they are zero at the start.
        """
        return ()

    @property
    def outer(self) -> tuple[str, ...]:
        """Return all states that are not `inner`."""
        return tuple(name for name in self.states if name not in self.inner)

    @property
    def gear_ratio(self) -> float:
        """Return the turns of the shaft for one turn of the motor; 1 without a gear."""
        return float(getattr(self, self.roles.gear)) if self.geared else 1.0

    @property
    def geared(self) -> bool:
        """Return whether the gear ratio is one of the rig's constants."""
        return bool(self.roles.gear) and hasattr(self, self.roles.gear)


def check_added(rig: Model) -> None:
    """Raise `InputError` unless `added` is a tuple of names that the rig offers."""
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

    Raises `ValueError` if the symbol is on neither side of the gear of `rig`.
    """
    own_side, power = rig.roles.side(symbol.name), GEAR_POWERS.get(symbol.unit)
    if not own_side or power is None:
        raise ValueError(f"{symbol.name} is on no side of the gear; leave out `side:`")
    if side == own_side:
        return 1.0
    return float(rig.gear_ratio ** (power if own_side == "motor" else -power))


@dataclass(frozen=True, slots=True)
class WrappedModel(Model):
    """A wrapped model takes the members that it does not define from its `rig`; it has no options."""

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
    """The descriptor gives the parameters `fixed_names`, then those that are `added`.

    If it is read from the class, it gives only `fixed_names`.
    """

    fixed_names: tuple[str, ...]

    def __get__(self, rig: Any, kind: type | None = None) -> tuple[str, ...]:
        return self.fixed_names if rig is None else (*self.fixed_names, *rig.added)


@dataclass(frozen=True, slots=True)
class StateNames:
    """The descriptor gives the states `fixed_names`, then those of added parameters.

    `added_states` maps each group of parameters to the states that exist if the whole group is added.
    If the descriptor is read from the class, it gives only `fixed_names`.
    """

    fixed_names: tuple[str, ...]
    added_states: Mapping[tuple[str, ...], tuple[str, ...]]

    def __get__(self, rig: Any, kind: type | None = None) -> tuple[str, ...]:
        groups = self.added_states.items() if rig is not None else ()
        more = (names for needed, names in groups if {*needed} <= {*rig.added})
        return (*self.fixed_names, *(name for names in more for name in names))


def with_named(rig: Model, names: Collection[str]) -> Model:
    """Add all `names` that the rig offers, in the order of its offers, and return the new rig."""
    wanted = {*names, *rig.added}
    added = tuple(name for name in rig.offers if name in wanted)
    if not added:
        return rig
    composed: Model = dataclasses.replace(rig, added=added)  # type: ignore[type-var]
    return composed


def with_all(rig: Model) -> Model:
    """Return the rig with all its optional parameters."""
    return with_named(rig, rig.offers)


def missing_requirements(rig: Model) -> dict[str, tuple[str, ...]]:
    """Return for each added parameter the names that it requires but that are not added."""
    needs = {name: rig.offers.get(name, ()) for name in rig.added}
    missing = {name: tuple(n for n in names if n not in rig.added) for name, names in needs.items()}
    return {name: names for name, names in missing.items() if names}


def weak_statics(rig: Model, p: Mapping[str, Any]) -> dict[str, str]:
    """Return a message for each static friction that is below the sliding friction at all values `p`."""
    why = "is below {}; static friction is at least as large as sliding friction"
    inertias = rig.roles.inertias
    pairs = [(i.static, i.sliding) for i in inertias if {i.static, i.sliding} <= {*p}]
    for back, other in ((i.static_back, i.sliding_back) for i in inertias):
        pairs += [(back, other)] if {back, other} <= {*p} else []
    return {s: why.format(c) for s, c in pairs if np.all(np.asarray(p[s]) < p[c])}


def surplus_frictions(rig: Model, unknown: Collection[str]) -> dict[str, str]:
    """Return messages on each unknown `friction` that is redundant with `sliding` and `sliding_back`."""
    messages = {}
    for rubbing, joined in itertools.product(rig.roles.inertias, repeat=2):
        by_direction = {rubbing.sliding, rubbing.sliding_back}
        if rubbing.speed == joined.speed and {joined.friction, *by_direction} <= {*unknown}:
            messages[joined.friction] = (
                f"{rubbing.sliding} and {rubbing.sliding_back} differ by direction already; hold "
                f"{joined.friction} at 0 or remove it, or remove {rubbing.sliding_back}"
            )
    return messages


def requirement_text(name: str, missing: Collection[str]) -> str:
    """Return the message on an added parameter whose required parameters are `missing`."""
    others = " and ".join(missing)
    return f"{name} means nothing without {others}; name {others} too, or remove {name}"


def constants(rig: Any) -> dict[str, Any]:
    """Return the gear ratio and all fields that differ from their defaults, by name."""
    values = {
        entry.name: (getattr(rig, entry.name), entry.default) for entry in dataclasses.fields(rig)
    }
    gear = rig.roles.gear
    return {n: value for n, (value, default) in values.items() if n == gear or value != default}
