"""Build any drive train from inertias (or masses), shafts, gears and drives that a config names.

    model:
      name: train
      inertias: [motor, arm, load]
      gears: {box: {between: [motor, arm], ratio: 0.07}}     # theta_arm = 0.07 theta_motor
      shafts: {coupling: [arm, load]}                        # `ground` may be an end
      drives: {motor: current}

Symbols contain the names of parts: `j_motor`, `k_coupling`, `theta_load`.  For a motion along a line
(`motion: linear`) they are `m_cart`, `x_cart`, `v_cart` and `f_cart`, in kg, m and N.  An optional
parameter, such as the damping `c_load` or the dry friction `t_c_load`, is used if the config names
it.  `equations` derives the equations.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal

from bayesdrill.basics.entries import set_constants
from bayesdrill.basics.errors import InputError, Issue, did_you_mean
from bayesdrill.basics.symbols import Symbol, own_symbol
from bayesdrill.rig.models.drive_parts import (
    DRIVES,
    Drives,
    Gear,
    Gears,
    Gravity,
    Inertias,
    Motion,
    Rock,
    Shaft,
    Shafts,
)
from bayesdrill.rig.models.equations import PartsModel
from bayesdrill.rig.models.linear import check_added
from bayesdrill.rig.models.motor_shaft import Power
from bayesdrill.rig.models.roles import GROUND, MOTIONS, InertiaRoles, MotorRoles, Roles, ShaftRoles


@dataclass(frozen=True, slots=True)
class Train(PartsModel):
    """A train is a rig that its parts describe; `stribeck` and `added` are as in a `MotorShaft`."""

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
    declares: ClassVar[Any] = property(lambda self: (*describe(self).symbols.values(),))
    symbols: ClassVar[Any] = property(lambda self: describe(self).symbols)
    parameters: ClassVar[Any] = property(lambda self: (*describe(self).parameters, *self.added))
    offers: ClassVar[Any] = property(lambda self: describe(self).offers)
    states: ClassVar[Any] = property(lambda self: describe(self).states)
    inputs: ClassVar[Any] = property(lambda self: describe(self).inputs)
    roles: ClassVar[Any] = property(lambda self: describe(self).roles)
    combinations: ClassVar[Any] = property(lambda self: describe(self).combinations)

    def __post_init__(self) -> None:
        set_constants(self)
        if issues := [Issue(*issue) for issue in _issues(self)]:
            raise InputError(issues)
        check_added(self)
        _check_frictions(self)
        _check_servos(self)


def _issues(train: Train) -> Iterator[tuple[str, str]]:
    """Yield each contradiction among the parts as (entry of the config, message)."""
    known = train.inertias
    kinds: tuple[tuple[str, Sequence[Shaft | Gear], tuple[str, ...]], ...] = (
        ("shafts", train.shafts, (*known, GROUND)),
        ("gears", train.gears, known),
    )
    for entry, parts, ends in kinds:
        for part in parts:
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
        yield (
            "gravity",
            "a mass that moves along a line is no pendulum; remove `gravity` or `motion: linear`",
        )
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
                f"gears join {' and '.join(sorted(both & imposed))}; impose only one of their speeds",
            )
        joined |= dict.fromkeys(both, both)


def _check_frictions(train: Train) -> None:
    """Raise `InputError` if two inertias that turn as one both have dry friction."""
    rubbing: dict[str, str] = {}
    for friction in train.frictions:
        place = friction.where.removeprefix("at ")
        if friction.against in rubbing:
            message = (
                f"{rubbing[friction.against]} and {place} turn as one, with one dry friction; "
                "name parameters of friction (or an efficiency) at one of them only"
            )
            raise InputError.at("gears", message)
        rubbing[friction.against] = place


def _check_servos(train: Train) -> None:
    """Raise `InputError` if several servos have a limit, a dead band or a measured supply."""
    limited = [motor.inertia for motor in train.roles.motors if motor.is_limited(train.added)]
    if len(limited) > 1:
        message = (
            f"{' and '.join(limited)} may saturate, or have a measured supply; only one servo of a "
            "train can"
        )
        raise InputError.at("drives", message)


@dataclass(frozen=True, slots=True)
class Row:
    """A row describes one parameter of a part: role, letter, unit and meaning for a rotary train.

    `required` names roles whose parameters must be used, too; None if the part always has this one.
    `suffix` ends the parameter's name, after the name of the part.
    """

    role: str
    letter: str
    unit: str
    meaning: str
    required: tuple[str, ...] | None = None
    held: Literal["positive", "not negative", "any"] = "positive"
    at_most: float = math.inf
    suffix: str = ""


BACKWARD = "_backward"
INERTIA = (
    Row("inertia", "j", "kg*m**2", "moment of inertia of"),
    Row("damping", "c", "N*m*s/rad", "viscous damping at", (), "not negative"),
    Row("friction", "t_f", "N*m", "friction that never changes its sign at", (), "any"),
)
RUBBING = (
    Row("sliding", "t_c", "N*m", "sliding friction at", (), "not negative"),
    Row("static", "t_s", "N*m", "static friction at", ("sliding", "fading"), "not negative"),
    Row("fading", "w_s", "rad/s", "speed scale of static friction's decay at", ("sliding", "static")),
    Row("drag", "d", "N*m*s**2/rad**2", "quadratic drag at", (), "not negative"),
    Row("sliding_back", "t_c", "N*m", "backward sliding friction at", ("sliding",), "not negative",
        suffix=BACKWARD),
    Row("static_back", "t_s", "N*m", "backward static friction at",
        ("sliding", "static", "fading"), "not negative", suffix=BACKWARD),
    Row("damping_back", "c", "N*m*s/rad", "backward viscous damping at", ("damping",),
        "not negative", suffix=BACKWARD),
)  # fmt: skip
GEAR = (
    Row("efficiency", "eta", "1", "efficiency of", (), at_most=1.0),
    Row("efficiency_back", "eta", "1", "efficiency, while the load drives, of", ("efficiency",),
        "not negative", at_most=1.0, suffix=BACKWARD),
)  # fmt: skip
PENDULUM = (
    Row("weight", "g", "N*m", "largest torque of gravity at"),
    Row("tilt", "a", "rad", "tilt of", (), "any"),
)
ROCK = tuple(
    Row(f"b_{k}", f"b_{k}", unit, "coefficient of rock at")
    for k, unit in enumerate(("m", "s/rad", "s/rad", "s**2/rad**2"))
)
SHAFT = (
    Row("stiffness", "k", "N*m/rad", "torsional stiffness of"),
    Row("damping", "c", "N*m*s/rad", "damping of", (), "not negative"),
)
SERVO = (
    Row("supply", "supply", "V", "supply of"),
    Row("duty", "duty", "1/rad", "duty cycle per unit of k_p * error of"),
    Row("proportional", "k_p", "1", "proportional gain of", ()),
    Row("derivative", "k_d", "s", "derivative gain of", (), "not negative"),
    Row("limit", "limit", "1", "largest duty cycle of", (), at_most=1.0),
    Row("band", "band", "rad", "dead band of", (), "not negative"),
    Row("goal_speed", "w_goal", "rad/s", "largest speed of the goal of", ()),
)
MOTOR = (Row("torque_constant", "k_T", "N*m/A", "torque constant of"),)
CIRCUIT = (
    Row("resistance", "r", "ohm", "resistance of"),
    Row("back_emf", "k_e", "V*s/rad", "voltage constant of", ()),
    Row("inductance", "l", "H", "inductance of", ()),
    Row("drop", "v_d", "V", "voltage drop at", ("inductance",), "not negative"),
)
# Letters, units and words of a linear train; the keys are those of a rotary train.
LINEAR: Mapping[str, str] = {
    "j": "m",
    "theta": "x",
    "w": "v",
    "w_s": "v_s",
    "w_goal": "v_goal",
    "k_T": "k_F",
    "t": "f",
    "T": "F",
    "t_f": "f_f",
    "t_c": "f_c",
    "t_s": "f_s",
    "kg*m**2": "kg",
    "rad": "m",
    "rad/s": "m/s",
    "N*m": "N",
    "N*m/rad": "N/m",
    "m": "1",
    "N*m*s/rad": "N*s/m",
    "N*m/A": "N/A",
    "V*s/rad": "V*s/m",
    "1/rad": "1/m",
    "s/rad": "s/m",
    "s**2/rad**2": "s**2/m**2",
    "N*m*s**2/rad**2": "N*s**2/m**2",
    "moment of inertia of": "mass of",
    "angle of": "position of",
    "torque on": "force on",
    "torsional stiffness of": "stiffness of",
    "torque constant of": "force constant of",
}


NO_NAMES: Mapping[str, str] = MappingProxyType({})


def words(name: str) -> str:
    """Return the name of a part in sentences, such as `the load` or `cart 1`."""
    text = name.replace("_", " ")
    return text if text[-1].isdigit() else f"the {text}"


class Description:
    """The description derives the names, symbols and roles of a train from its parts.

    Raises `InputError` if two names coincide.
    """

    def __init__(self, train: Train) -> None:
        self.train = train
        self.parameters: list[str] = []
        self.offers: dict[str, tuple[str, ...]] = {}
        self.symbols: dict[str, Symbol] = {}
        self.combinations: dict[str, dict[str, float]] = {}
        self._kinds = {drive.inertia: drive.kind for drive in train.drives}
        self._supplies = {drive.inertia: drive.supply for drive in train.drives}
        self._reductions = _reductions(train)
        inertias = tuple(map(self._inertia, train.inertias))
        shafts = tuple(map(self._shaft, train.shafts))
        wired = [n for n in train.inertias if self._kinds.get(n) in ("current", "voltage", "servo")]
        motors = tuple(map(self._motor, wired))
        self.roles: Roles = Roles(
            inertias=inertias, shafts=shafts, motors=motors, motion=MOTIONS[train.motion]
        )
        roots = [i for i in inertias if self._reductions[i.name][0] == i.name]
        imposed = [root.speed for root in roots if self._kinds.get(root.name) == "speed"]
        self.states: tuple[str, ...] = (
            *(root.angle for root in roots),
            *(root.speed for root in roots if root.speed not in imposed),
            *(motor.current for motor in motors if motor.inductance in train.added),
        )
        self.inputs: tuple[str, ...] = (
            *imposed,
            *(inertia.torque for inertia in inertias if inertia.torque),
            *(motor.goal or motor.voltage or motor.current for motor in motors),
            *(motor.supply for motor in motors if motor.usual_supply),
            *(inertia.bit_weight for inertia in inertias if inertia.bit_weight),
        )

    def _word(self, text: str) -> str:
        """Translate a letter, unit or word of a rotary train if this train moves along a line."""
        return LINEAR.get(text, text) if self.train.motion == "linear" else text

    def _symbol(
        self, letter: str, part: str, unit: str, meaning: str, after: str = "", **more: Any
    ) -> Symbol:
        """Return the symbol of a part, from `letter`, `unit` and `meaning` for a rotary train."""
        name = f"{self._word(letter)}_{part}{after}"
        text = f"{self._word(meaning)} {words(part)}"
        return dataclasses.replace(own_symbol(name, self._word(unit), None, text), **more)

    def _add(self, letter: str, part: str, unit: str, meaning: str, **more: Any) -> str:
        """Add the symbol of a part, and return its name."""
        symbol = self._symbol(letter, part, unit, meaning, **more)
        if symbol.name in self.symbols:
            message = f"two things would be called {symbol.name}; rename a part"
            raise InputError.at("inertias", message)
        self.symbols[symbol.name] = symbol
        return symbol.name

    def _add_rows(
        self, rows: Sequence[Row], part: str, known: Mapping[str, str] = NO_NAMES
    ) -> dict[str, str]:
        """Add the parameters of a part, and return their names by role; `known` has earlier names."""
        names = {row.role: f"{self._word(row.letter)}_{part}{row.suffix}" for row in rows}
        for row in rows:
            if row.required is None:
                self.parameters.append(names[row.role])
            else:
                needs = {**known, **names}
                self.offers[names[row.role]] = tuple(needs[role] for role in row.required)
            more: dict[str, Any] = {"held": row.held, "at_most": row.at_most}
            self._add(row.letter, part, row.unit, row.meaning, after=row.suffix, **more)
        return names

    def _inertia(self, name: str) -> InertiaRoles:
        train, (root, reduction) = self.train, self._reductions[name]
        kind = self._kinds.get(name, "")
        angle = self._add("theta", name, "rad", "angle of")
        latex = self.symbols[angle].latex
        dotted = {"latex": rf"\dot {latex}", "drives": kind == "speed"}
        speed = self._add("w", name, "rad/s", "speed of", **dotted)
        root_angle, root_speed = (f"{self._word(letter)}_{root}" for letter in ("theta", "w"))
        if root != name:
            self.combinations[angle] = {root_angle: 1.0 / reduction}
            self.combinations[speed] = {root_speed: 1.0 / reduction}
        names: dict[str, Any] = {"name": name, "words": words(name), "reduction": reduction}
        names |= {"angle": root_angle, "speed": root_speed, "latex": latex if root != name else ""}
        if self._kinds.get(root) == "speed":
            return InertiaRoles(**names)
        names |= self._add_rows(INERTIA, name)
        joined = [n for n in train.inertias if self._reductions[n][0] == root]
        if name == _rubbing(train, joined):
            names |= self._add_rows(RUBBING, name, names)
            loaded = {*train.gravity, *(end for shaft in train.shafts for end in shaft.ends)}
            behind = loaded & {*joined} - {name}  # a gear without load has no loss
            for gear in [gear.name for gear in train.gears if behind and gear.ends[0] == name][:1]:
                names |= self._add_rows(GEAR, gear)
        effort = f"friction_{name}"
        names["effort"] = self._symbol("T", name, "N*m", "friction at", name=effort)
        if kind == "torque":
            names["torque"] = self._add("t", name, "N*m", "torque on", drives=True)
        if name in train.gravity:
            names |= self._add_rows(PENDULUM, name)
        if name in train.rock:
            names["cutting"] = (*self._add_rows(ROCK, name).values(),)
            names["bit_weight"] = self._add("wob", name, "N", "weight on")
        return InertiaRoles(**names)

    def _shaft(self, shaft: Shaft) -> ShaftRoles:
        names = self._add_rows(SHAFT, shaft.name)
        return ShaftRoles(name=shaft.name, words=words(shaft.name), ends=shaft.ends, **names)

    def _motor(self, name: str) -> MotorRoles:
        kind, names = self._kinds[name], dict[str, Any](inertia=name, words=words(name))
        names["current"] = self._add("i", name, "A", "current of", drives=kind == "current")
        names |= self._add_rows(MOTOR, name)
        if kind == "servo":
            names["goal"] = self._add("goal", name, "rad", "goal of", drives=True)
            usual = names["usual_supply"] = self._supplies[name]
            if usual:
                names["supply"] = self._add("supply", name, "V", "supply of")
            names |= self._add_rows(SERVO[1:] if usual else SERVO, name)
        elif kind == "voltage":
            names["voltage"] = self._add("u", name, "V", "voltage of", drives=True)
        if kind in ("voltage", "servo"):
            names |= self._add_rows(CIRCUIT, name)
            drop = f"drop_{name}"
            names["effort"] = self._symbol("v_d", name, "V", "voltage drop at", name=drop)
        return MotorRoles(**names)


describe: Callable[[Train], Description] = functools.lru_cache(maxsize=256)(Description)


def _rubbing(train: Train, joined: Sequence[str]) -> str:
    """Return which of the `joined` inertias, which turn as one, has the dry friction.

    It is the first that drives a gear and is not driven by a gear, or else the first of all.
    """
    behind = {gear.ends[1] for gear in train.gears}
    first = {gear.ends[0] for gear in train.gears} - behind
    return next((name for name in joined if name in first), joined[0])


def _reductions(train: Train) -> dict[str, tuple[str, float]]:
    """Return (root, reduction) for each inertia: the root's angle is `reduction` times its own angle.

    Among inertias that gears join, the root is the one with an imposed speed, or else the first that
    drives no gear. Its angle is a state.
    """
    imposed = {drive.inertia for drive in train.drives if drive.kind == "speed"}
    inputs = {gear.ends[0] for gear in train.gears}
    known: dict[str, tuple[str, float]] = {}

    def follow_gears(name: str, root: str, reduction: float) -> None:
        known[name] = (root, reduction)
        for gear in train.gears:
            first, second = gear.ends
            ways = ((first, second, 1.0 / gear.ratio), (second, first, gear.ratio))
            for near, far, times in ways:
                if near == name and far not in known:
                    follow_gears(far, root, reduction * times)

    for root in sorted(train.inertias, key=lambda name: (name not in imposed, name in inputs)):
        if root not in known:
            follow_gears(root, root, 1.0)
    return known
