"""Any drive train: inertias (or masses) with shafts, gears and drives, as a config describes them.

    model:
      name: train
      inertias: [motor, arm, load]
      gears: {box: {between: [motor, arm], ratio: 0.07}}     # theta_arm = 0.07 theta_motor
      shafts: {coupling: [arm, load]}                        # `ground` may be an end
      drives: {motor: current}

Symbols are made of names: `j_motor`, `k_coupling`, `theta_load`.  Of what moves along a line
(`motion: linear`) they are `m_cart`, `x_cart`, `v_cart` and `f_cart`, in kg, m and N.  A parameter
that is only offered, as the damping `c_load` or the dry friction `t_c_load`, is there where it is
named.  The equations are those of `equations`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pydantic import TypeAdapter, ValidationError

from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.symbols import Symbol, own_symbol
from bayesdrill.rig.models.drive_parts import (
    DRIVES,
    Drives,
    Gear,
    Gears,
    Gravity,
    Inertias,
    Motion,
    PartsError,
    Rock,
    Shaft,
    Shafts,
)
from bayesdrill.rig.models.equations import PartsModel
from bayesdrill.rig.models.linear import Offers
from bayesdrill.rig.models.motor_shaft import Power
from bayesdrill.rig.models.roles import (
    GROUND,
    MOTIONS,
    InertiaRoles,
    MotorRoles,
    Roles,
    ShaftRoles,
)


@dataclass(frozen=True, slots=True)
class Train(PartsModel):
    """A rig that is described by its parts; `stribeck`, `added`: as of a `MotorShaft`."""

    inertias: Inertias = ("rotor",)
    shafts: Shafts = ()
    gears: Gears = ()
    drives: Drives = ()
    motion: Motion = "rotary"
    gravity: Gravity = ()
    rock: Rock = ()
    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "train"
    has_private_names: ClassVar[bool] = True

    def __post_init__(self) -> None:
        wrong: list[tuple[str, str]] = []
        for entry, adapter in _adapters().items():
            try:
                value = adapter.validate_python(getattr(self, entry), strict=True)
            except ValidationError as error:
                message = error.errors()[0]["msg"].removeprefix("Value error, ")
                wrong.append((entry, f"{getattr(self, entry)!r:.60} cannot be this: {message}"))
            else:
                object.__setattr__(self, entry, value)
        if issues := tuple(wrong or _issues(self)):
            raise PartsError(issues)
        _check_frictions(self)

    @property
    def declares(self) -> tuple[Symbol, ...]:
        """All of its symbols."""
        return (*self.symbols.values(),)

    @property
    def symbols(self) -> Mapping[str, Symbol]:
        """See `Model.symbols`; of what it offers too."""
        return describe(self).symbols

    @property
    def parameters(self) -> tuple[str, ...]:
        """Inertias, shafts and drives, then what is added."""
        return (*describe(self).parameters, *self.added)

    @property
    def offers(self) -> Offers:
        """Damping, friction, and what else its parts may have."""
        return describe(self).offers

    @property
    def states(self) -> tuple[str, ...]:
        """Angles, speeds, currents."""
        return describe(self).states

    @property
    def inputs(self) -> tuple[str, ...]:
        """What its drives bring, and the weight on bits."""
        return describe(self).inputs

    @property
    def roles(self) -> Roles:
        """Its parts."""
        return describe(self).roles

    @property
    def combinations(self) -> Mapping[str, Mapping[str, float]]:
        """Angles and speeds before gears, as states behind them."""
        return describe(self).combinations


@functools.cache
def _adapters() -> dict[str, TypeAdapter[Any]]:
    """What reads each entry."""
    return {entry: TypeAdapter(kind) for entry, kind in entries_of(Train).items()}


def _issues(train: Train) -> Iterator[tuple[str, str]]:
    """Yield what does not go together, each with its entry."""
    known = train.inertias
    for entry in ("shafts", "gears"):
        parts: tuple[Shaft | Gear, ...] = getattr(train, entry)
        for part in parts:
            ends = [*known, GROUND] if entry == "shafts" else known
            for end in part.ends:
                if end not in ends:
                    hint = did_you_mean(end, ends)
                    yield entry, f"{part.name} joins '{end}', which is no inertia{hint}"
            if part.ends[0] == part.ends[1]:
                yield entry, f"{part.name} joins {part.ends[0]} to itself"
    for drive in train.drives:
        if drive.inertia not in known:
            hint = did_you_mean(drive.inertia, known)
            yield "drives", f"'{drive.inertia}' is no inertia{hint}"
        if drive.kind not in DRIVES:
            hint = did_you_mean(drive.kind, DRIVES)
            yield "drives", f"{drive.inertia} cannot be moved by '{drive.kind}'{hint}"
    for entry in ("gravity", "rock"):
        for name in getattr(train, entry):
            if name not in known:
                yield entry, f"'{name}' is no inertia{did_you_mean(name, known)}"
    if train.gravity and train.motion == "linear":
        yield "gravity", "what moves along a line is no pendulum; remove it, or `motion: linear`"
    called = [*known, *(s.name for s in train.shafts), *(gear.name for gear in train.gears)]
    for name in dict.fromkeys(name for name in called if called.count(name) > 1 or name == GROUND):
        yield "inertias", f"two parts are called {name}; give each a name of its own"
    yield from _gear_issues(train)


def _gear_issues(train: Train) -> Iterator[tuple[str, str]]:
    joined = {name: {name} for name in train.inertias}
    imposed = {drive.inertia for drive in train.drives if drive.kind == "speed"}
    for gear in train.gears:
        first, second = (joined.get(end, {end}) for end in gear.ends)
        if second is first:
            yield "gears", f"{gear.name} joins inertias that other gears join already"
        both = first | second
        if len(both & imposed) > 1:
            yield (
                "drives",
                f"the speeds of {' and '.join(sorted(both & imposed))} follow from each other",
            )
        joined |= dict.fromkeys(both, both)


def _check_frictions(train: Train) -> None:
    """Raise `PartsError` where two of what turns as one have dry friction: it is one friction."""
    rubbing: dict[str, str] = {}
    for friction in train.frictions:
        place = friction.where.removeprefix("at ")
        if friction.against in rubbing:
            message = (
                f"{rubbing[friction.against]} and {place} turn as one, so that their dry frictions "
                "are one: name parameters of friction (or an efficiency) at one of them alone"
            )
            raise PartsError((("gears", message),))
        rubbing[friction.against] = place


@dataclass(frozen=True, slots=True)
class _Units:
    """Letters and units of a kind of motion."""

    inertia: tuple[str, str]
    angle: tuple[str, str]
    speed: tuple[str, str]
    torque: tuple[str, str]
    constant: tuple[str, str]
    damping: str
    stiffness: str
    back_emf: str
    words: tuple[str, str, str, str]  # inertia, angle, torque, shaft


_UNITS: Mapping[str, _Units] = {
    "rotary": _Units(
        inertia=("j", "kg*m**2"),
        angle=("theta", "rad"),
        speed=("w", "rad/s"),
        torque=("t", "N*m"),
        constant=("k_T", "N*m/A"),
        damping="N*m*s/rad",
        stiffness="N*m/rad",
        back_emf="V*s/rad",
        words=("moment of inertia", "angle", "torque", "torsional stiffness"),
    ),
    "linear": _Units(
        inertia=("m", "kg"),
        angle=("x", "m"),
        speed=("v", "m/s"),
        torque=("f", "N"),
        constant=("k_F", "N/A"),
        damping="N*s/m",
        stiffness="N/m",
        back_emf="V*s/m",
        words=("mass", "position", "force", "stiffness"),
    ),
}


@dataclass(slots=True)
class Description:
    """What a train has, by its parts: names, symbols and roles."""

    parameters: list[str] = field(default_factory=list)
    offers: dict[str, tuple[str, ...]] = field(default_factory=dict)
    symbols: dict[str, Symbol] = field(default_factory=dict)
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    roles: Roles = field(default_factory=Roles)
    combinations: dict[str, dict[str, float]] = field(default_factory=dict)

    def symbol(self, name: str, unit: str, meaning: str, **more: Any) -> str:
        """Add a symbol, and return its name."""
        if name in self.symbols:
            raise PartsError((("inertias", f"two things would be called {name}; rename a part"),))
        made = own_symbol(name, unit, more.pop("latex", None), meaning)
        self.symbols[name] = dataclasses.replace(made, **more)
        return name

    def parameter(
        self, name: str, unit: str, meaning: str, needs: tuple[str, ...] | None = None, **more: Any
    ) -> str:
        """Add a parameter; it is only offered where it says what it `needs`."""
        if needs is None:
            self.parameters.append(name)
        else:
            self.offers[name] = needs
        return self.symbol(name, unit, meaning, **more)


def words(name: str) -> str:
    """Return what sentences call a part: `the load`, `cart 1`."""
    text = name.replace("_", " ")
    return text if text[-1].isdigit() else f"the {text}"


@functools.lru_cache(maxsize=256)
def describe(train: Train) -> Description:
    """Return names, symbols and roles of a train; raises `PartsError` where two names are one."""
    return _Describer(train).describe()


class _Describer:
    """Makes the description of a train."""

    def __init__(self, train: Train) -> None:
        self.train, self.units, self.made = train, _UNITS[train.motion], Description()
        self.kinds = {drive.inertia: drive.kind for drive in train.drives}
        self.reductions = dict(_reductions(train))

    def describe(self) -> Description:
        """Return it."""
        train, made = self.train, self.made
        inertias = [self._inertia(name) for name in train.inertias]
        shafts = [self._shaft(shaft) for shaft in train.shafts]
        motors = [
            self._motor(i) for i in inertias if self.kinds.get(i.name) in ("current", "voltage")
        ]
        made.roles = Roles(
            inertias=(*inertias,),
            shafts=(*shafts,),
            motors=(*motors,),
            motion=MOTIONS[train.motion],
        )
        roots = [i for i in inertias if self._root(i.name) == i.name]
        imposed = [i.speed for i in roots if self.kinds.get(i.name) == "speed"]
        currents = [m.current for m in motors if m.inductance in train.added]
        made.states = (
            *(i.angle for i in roots),
            *(i.speed for i in roots if i.speed not in imposed),
            *currents,
        )
        made.inputs = (
            *imposed,
            *(i.torque for i in inertias if i.torque),
            *(m.voltage or m.current for m in motors),
            *(i.bit_weight for i in inertias if i.bit_weight),
        )
        return made

    def _root(self, name: str) -> str:
        return self.reductions[name][0]

    def _inertia(self, name: str) -> InertiaRoles:
        made, units, kind = self.made, self.units, self.kinds.get(name, "")
        root, reduction = self.reductions[name]
        moved = self.kinds.get(root) == "speed"
        called, (inertia, angle, torque, _) = words(name), units.words
        angle_name, speed_name = f"{units.angle[0]}_{name}", f"{units.speed[0]}_{name}"
        latex = own_symbol(angle_name, "1", None, "").latex
        made.symbol(angle_name, units.angle[1], f"{angle} of {called}")
        made.symbol(
            speed_name,
            units.speed[1],
            f"speed of {called}",
            latex=rf"\dot {latex}",
            drives=kind == "speed",
        )
        if root != name:
            made.combinations |= {
                f"{letter}_{name}": {f"{letter}_{root}": 1.0 / reduction}
                for letter in (units.angle[0], units.speed[0])
            }
        roles = InertiaRoles(
            name=name,
            words=called,
            angle=f"{units.angle[0]}_{root}",
            speed=f"{units.speed[0]}_{root}",
            reduction=reduction,
            latex=latex if root != name else "",
        )
        if moved:
            return roles
        letter, unit = units.torque

        def offer(name: str, unit: str, meaning: str, needs: tuple[str, ...] = ()) -> str:
            return made.parameter(name, unit, meaning, needs, held="not negative")

        sliding, static, fading = (
            f"{letter}_c_{name}",
            f"{letter}_s_{name}",
            f"{units.speed[0]}_s_{name}",
        )
        effort = own_symbol(f"{letter.upper()}_{name}", unit, None, f"friction at {called}")
        return dataclasses.replace(
            roles,
            inertia=made.parameter(
                f"{units.inertia[0]}_{name}", units.inertia[1], f"{inertia} of {called}"
            ),
            damping=offer(f"c_{name}", units.damping, f"viscous damping at {called}"),
            friction=offer(f"{letter}_f_{name}", unit, f"friction of constant sign at {called}"),
            sliding=offer(sliding, unit, f"sliding friction at {called}"),
            static=offer(static, unit, f"static friction at {called}", (sliding, fading)),
            fading=made.parameter(
                fading, units.speed[1], "speed over which that friction is lost", (sliding, static)
            ),
            torque=made.symbol(f"{letter}_{name}", unit, f"{torque} on {called}", drives=True)
            if kind == "torque"
            else "",
            efficiency=self._efficiency(name),
            effort=dataclasses.replace(effort, name=f"friction_{name}"),
            **self._pendulum(name),
            **self._bit(name),
        )

    def _efficiency(self, name: str) -> str:
        gears = [gear for gear in self.train.gears if gear.ends[0] == name]
        if not gears:
            return ""
        gear = gears[0].name
        return self.made.parameter(
            f"eta_{gear}", "1", f"efficiency of {words(gear)}", (), at_most=1.0
        )

    def _pendulum(self, name: str) -> dict[str, Any]:
        if name not in self.train.gravity:
            return {}
        called = words(name)
        return {
            "weight": self.made.parameter(
                f"g_{name}", "N*m", f"largest torque of gravity at {called}"
            ),
            "tilt": self.made.parameter(f"a_{name}", "rad", f"tilt of {called}", (), held="any"),
        }

    def _bit(self, name: str) -> dict[str, Any]:
        if name not in self.train.rock:
            return {}
        speed = "s/rad" if self.train.motion == "rotary" else "s/m"
        units = (
            "m" if speed == "s/rad" else "1",
            speed,
            speed,
            f"{speed.replace('s/', 's**2/')}**2",
        )
        meaning = f"coefficient of rock at {words(name)}"
        return {
            "cutting": tuple(
                self.made.parameter(f"b_{k}_{name}", unit, meaning) for k, unit in enumerate(units)
            ),
            "bit_weight": self.made.symbol(f"wob_{name}", "N", f"weight on {words(name)}"),
        }

    def _shaft(self, shaft: Shaft) -> ShaftRoles:
        made, units, called = self.made, self.units, words(shaft.name)
        return ShaftRoles(
            name=shaft.name,
            words=called,
            ends=shaft.ends,
            stiffness=made.parameter(
                f"k_{shaft.name}", units.stiffness, f"{units.words[3]} of {called}"
            ),
            damping=made.parameter(
                f"c_{shaft.name}", units.damping, f"damping of {called}", (), held="not negative"
            ),
        )

    def _motor(self, inertia: InertiaRoles) -> MotorRoles:
        made, units, name, called = self.made, self.units, inertia.name, inertia.words
        wired = self.kinds[name] == "voltage"
        roles = MotorRoles(
            inertia=name,
            words=called,
            current=made.symbol(f"i_{name}", "A", f"current of {called}", drives=not wired),
            torque_constant=made.parameter(
                f"{units.constant[0]}_{name}",
                units.constant[1],
                f"{units.words[2]} constant of {called}",
            ),
        )
        if not wired:
            return roles
        inductance = f"l_{name}"
        drop = own_symbol(f"v_d_{name}", "V", None, f"voltage drop at {called}")
        return dataclasses.replace(
            roles,
            voltage=made.symbol(f"u_{name}", "V", f"voltage of {called}", drives=True),
            resistance=made.parameter(f"r_{name}", "ohm", f"resistance of {called}"),
            back_emf=made.parameter(
                f"k_e_{name}", units.back_emf, f"voltage constant of {called}", ()
            ),
            inductance=made.parameter(inductance, "H", f"inductance of {called}", ()),
            drop=made.parameter(
                f"v_d_{name}", "V", f"voltage drop at {called}", (inductance,), held="not negative"
            ),
            effort=dataclasses.replace(drop, name=f"drop_{name}"),
        )


def _reductions(train: Train) -> Iterator[tuple[str, tuple[str, float]]]:
    """Yield by inertia whose angle is the state, and how many times its own that is.

    Of those that gears join it is what is imposed, or else the first that drives no gear.
    """
    imposed = {drive.inertia for drive in train.drives if drive.kind == "speed"}
    inputs = {gear.ends[0] for gear in train.gears}
    order = sorted(train.inertias, key=lambda name: (name not in imposed, name in inputs))
    known: dict[str, tuple[str, float]] = {}
    for root in order:
        pending = [(root, 1.0)] if root not in known else []
        while pending:
            name, reduction = pending.pop()
            known[name] = (root, reduction)
            for gear in train.gears:
                first, second = gear.ends
                for near, far, times in (
                    (first, second, 1.0 / gear.ratio),
                    (second, first, gear.ratio),
                ):
                    if near == name and far not in known:
                        pending.append((far, reduction * times))
    yield from known.items()
