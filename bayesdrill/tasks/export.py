"""Export the rig of a run to simulators, as MJCF (MuJoCo) or JSON.

A joint is a coordinate of the rig, with all inertias that move together.  Armature, damping and dry
friction of these inertias are reflected through the gears to the joint, in SI.  In MJCF, springs
between joints are fixed tendons, and motors are actuators.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np

from bayesdrill import __version__
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import InertiaRoles
from bayesdrill.tasks.conclusions import SampledRun


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedNumber:
    """An exported quantity of a part has `draws (N,)` and a value at the MAP, in SI."""

    part: str
    name: str
    unit: str
    draws: Array
    map: float

    @property
    def key(self) -> str:
        """Return the full name, such as `load.armature`."""
        return f"{self.part}.{self.name}"

    @property
    def mean(self) -> float:
        """Return the posterior mean."""
        return float(self.draws[0] + (self.draws - self.draws[0]).mean())

    @property
    def sd(self) -> float:
        """Return the posterior standard deviation."""
        return float((self.draws - self.draws[0]).std())  # exactly zero if all draws are equal


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatorModel:
    """A simulator model describes a rig by joints, springs and drives.

    `joints` maps a speed (a state) to its joint's name.  `springs` maps a spring to its ends:
    the joint, and the turns of this end per turn of the joint.  `drives` maps a drive to its joint,
    and the drive's turns per turn of the joint.
    """

    title: str
    linear: bool
    joints: Mapping[str, str]
    springs: Mapping[str, tuple[tuple[str, float], ...]]
    drives: Mapping[str, tuple[str, float]]
    quantities: tuple[ExportedNumber, ...]

    def means(self, part: str) -> dict[str, float]:
        """Return the posterior means of a part's quantities, by their names."""
        return {q.name: q.mean for q in self.quantities if q.part == part}


def simulator_model(run: SampledRun, draws: int, rng: np.random.Generator) -> SimulatorModel:
    """Return a run's rig with at most `draws` draws; raises `InputError` without `roles`."""
    problem = run.job.problem
    model, posterior = problem.model, problem.posterior
    chain = run.sampled.draws.reshape(-1, len(problem.names))
    rows = rng.choice(len(chain), min(draws, len(chain)), replace=False)
    theta = np.vstack([posterior.space.vector(run.mode.values), chain[np.sort(rows)]])
    p = posterior.likelihood.rig_parameters(theta)
    moving = model.roles.moving(model.states, model.parameters)
    if not moving:
        message = f"the rig {model.name} does not describe its inertias (`roles`)"
        raise InputError.at(str(run.job.config.name), f"{message}; nothing can be exported")
    joints = {speed: inertias[-1].name for speed, inertias in moving.items()}
    turns = {
        inertia.name: (joints[inertia.speed], 1.0 / inertia.reduction)
        for inertia in model.roles.inertias
        if inertia.speed in joints
    }
    springs = {
        shaft.name: tuple(turns[end] for end in shaft.ends if end in turns)
        for shaft in model.roles.shafts
        if shaft.stiffness in p
    }
    drives = {
        inertia.torque: turns[inertia.name]
        for inertia in model.roles.inertias
        if inertia.torque in model.inputs and inertia.name in turns
    }
    for motor in model.roles.motors:
        if motor.torque_constant in p and motor.inertia in turns:
            drives[f"motor_{motor.inertia}"] = turns[motor.inertia]
    return SimulatorModel(
        title=run.job.config.name,
        linear=model.symbols[next(iter(joints))].unit == "m/s",
        joints=joints,
        springs=springs,
        drives=drives,
        quantities=tuple(_quantities(model, p, moving.values())),
    )


def _quantities(
    model: Model, p: Mapping[str, Array], joints: Iterable[list[InertiaRoles]]
) -> Iterator[ExportedNumber]:
    """Yield the quantities of joints (sums over the inertias of a joint), shafts and motors."""
    terms = [term for inertias in joints for term in _joint_terms(inertias, p)]
    for shaft in model.roles.shafts:
        springs = {"stiffness": shaft.stiffness, "damping": shaft.damping}
        terms += [(shaft.name, name, symbol, 1.0) for name, symbol in springs.items()]
    for motor in model.roles.motors:
        circuit = {
            "torque_constant": motor.torque_constant,
            "back_emf": motor.back_emf,
            "resistance": motor.resistance,
            "series_resistance": motor.series,
            "inductance": motor.inductance,
            "voltage_drop": motor.drop,
            "supply": motor.supply,
            "duty": motor.duty,
            "proportional_gain": motor.proportional,
            "derivative_gain": motor.derivative,
            "largest_duty": motor.limit,
            "dead_band": motor.band,
            "goal_speed": motor.goal_speed,
        }
        terms += [(f"motor_{motor.inertia}", name, symbol, 1.0) for name, symbol in circuit.items()]
    fixed = {motor.supply: motor.usual_supply for motor in model.roles.motors if motor.usual_supply}
    known = {**p, **{name: np.full_like(next(iter(p.values())), x) for name, x in fixed.items()}}
    sums: dict[tuple[str, str, str], Array] = {}
    for part, name, symbol, factor in terms:
        if symbol in known:
            key = part, name, model.symbols[symbol].unit
            sums[key] = sums.get(key, np.zeros(1)) + known[symbol] / factor
    for (part, name, unit), values in sums.items():
        yield ExportedNumber(
            part=part, name=name, unit=unit, draws=values[1:], map=float(values[0])
        )


def _joint_terms(
    inertias: Sequence[InertiaRoles], p: Mapping[str, Array]
) -> Iterator[tuple[str, str, str, float]]:
    """Yield (joint, quantity, parameter, divisor) for the inertias of a joint.

    Directions are those of the joint, and each friction without a direction acts in both.
    """
    for inertia in inertias:
        joint, turns = inertias[-1].name, inertia.reduction
        yield joint, "armature", inertia.inertia, turns**2
        for quantity, role, power in (("damping", "damping", 2), ("frictionloss", "sliding", 1)):
            forward, back = getattr(inertia, role), getattr(inertia, f"{role}_back")
            ways = (forward, back if back in p else forward)[:: 1 if turns > 0 else -1]
            yield joint, quantity, ways[0], abs(turns) ** power
            if any(getattr(other, f"{role}_back") in p for other in inertias):
                yield joint, f"{quantity}_backward", ways[1], abs(turns) ** power
        yield joint, "constant_friction", inertia.friction, turns
        yield joint, "gravity", inertia.weight, abs(turns)


def as_json(model: SimulatorModel) -> str:
    """Return JSON text with means, sds, correlations and draws of all quantities."""
    draws = np.array([quantity.draws for quantity in model.quantities])
    with np.errstate(invalid="ignore"):  # a fixed quantity has no correlation
        correlations = np.nan_to_num(np.atleast_2d(np.corrcoef(draws)))
    np.fill_diagonal(correlations, 1.0)
    data = {
        "name": model.title,
        "by": f"bayesdrill {__version__}",
        "motion": "linear" if model.linear else "rotary",
        "joints": [*model.joints.values()],
        "springs": {name: dict(ends) for name, ends in model.springs.items()},
        "drives": {name: dict([drive]) for name, drive in model.drives.items()},
        "quantities": {
            q.key: {
                "unit": q.unit,
                "mean": q.mean,
                "sd": q.sd,
                "map": q.map,
            }
            for q in model.quantities
        },
        "correlations": correlations.round(6).tolist(),
        "draws": draws.T.tolist(),
    }
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _body(joint: str, model: SimulatorModel) -> str:
    """Return the name of a joint's body; simulators reserve the names `world` and `base`."""
    taken, name = {"world", "base", *model.joints.values()}, f"{joint}_body"
    while name in taken:
        name += "_body"
    return name if joint in ("world", "base") else joint


def as_mjcf(model: SimulatorModel, *, dcmotor: bool = False) -> str:
    """Return a MuJoCo model at the posterior means, with a joint for each coordinate.

    With `dcmotor`, motors with a circuit are `dcmotor` actuators (MuJoCo 3.5 or later).
    """
    root = Element("mujoco", model=model.title)
    root.append(Comment(_spread(model)))
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    SubElement(root, "option", gravity="0 0 0")
    world = SubElement(root, "worldbody")
    for joint in model.joints.values():
        means = model.means(joint)
        for name in ("damping", "frictionloss"):  # MuJoCo has a single number for both directions
            if name in means:
                means[name] = (means[name] + means.get(f"{name}_backward", means[name])) / 2.0
        body = SubElement(world, "body", name=_body(joint, model))
        # Every body must have a mass; this one is negligible.
        SubElement(body, "inertial", pos="0 0 0", mass="1e-9", diaginertia="1e-12 1e-12 1e-12")
        entries = {"name": joint, "type": "slide" if model.linear else "hinge", "axis": "0 0 1"}
        entries |= {
            n: f"{means[n]:.9g}" for n in ("armature", "damping", "frictionloss") if n in means
        }
        SubElement(body, "joint", entries)
    tendons = SubElement(root, "tendon")
    for name, ends in model.springs.items():
        means = model.means(name)
        entries = {"name": name, "springlength": "0"}
        entries |= {n: f"{means[n]:.9g}" for n in ("stiffness", "damping") if n in means}
        fixed = SubElement(tendons, "fixed", entries)
        for (joint, turns), sign in zip(ends, (1.0, -1.0), strict=False):
            SubElement(fixed, "joint", joint=joint, coef=f"{sign * turns:.9g}")
    actuators = SubElement(root, "actuator")
    for name, (joint, turns) in model.drives.items():
        entries = {"name": name, "joint": joint, "gear": f"{turns:.9g}"}
        circuit = _circuit(model.means(name)) if dcmotor else {}
        if circuit:
            SubElement(actuators, "dcmotor", entries | circuit)
        else:
            SubElement(actuators, "general", entries | _gains(model.means(name)))
    return _written(root)


def _gains(means: Mapping[str, float]) -> dict[str, str]:
    """Return the entries of a general actuator: the gains of its input, of angle and of speed.

    The input is a torque, current or voltage, or the goal of a servo, whose gains then hold for its
    usual supply voltage.  Limits of duty are ignored.
    """
    resistance = means.get("resistance", 1.0) + means.get("series_resistance", 0.0)
    gain = means.get("torque_constant", 1.0) / resistance
    stiffness, brake = 0.0, gain * means.get("back_emf", 0.0)
    if _is_servo(means):
        gain *= means["supply"] * means["duty"]
        brake += gain * means.get("derivative_gain", 0.0)
        gain = stiffness = gain * means.get("proportional_gain", 1.0)
    entries = {"gainprm": f"{gain:.9g}"}
    if stiffness or "back_emf" in means:
        entries |= {"biastype": "affine", "biasprm": f"0 {-stiffness or 0:.9g} {-brake:.9g}"}
    return entries


def _is_servo(means: Mapping[str, float]) -> bool:
    return "duty" in means


def _circuit(means: Mapping[str, float]) -> dict[str, str]:
    """Return the entries of MuJoCo's `dcmotor`; empty for a servo or an incomplete circuit."""
    if _is_servo(means) or not {"resistance", "torque_constant", "back_emf"} <= means.keys():
        return {}
    resistance = means["resistance"] + means.get("series_resistance", 0.0)
    entries = {
        "resistance": f"{resistance:.9g}",
        "motorconst": f"{means['torque_constant']:.9g} {means['back_emf']:.9g}",
    }
    if "inductance" in means:
        entries["inductance"] = f"{means['inductance']:.9g} 0"
    return entries


FORMS: Mapping[str, Callable[[SimulatorModel], str]] = {
    "json": as_json,
    "mjcf": as_mjcf,
    "dcmotor": functools.partial(as_mjcf, dcmotor=True),
}


def _spread(model: SimulatorModel) -> str:
    lines = [f"{q.key} {q.mean:.6g} +- {q.sd:.2g} {q.unit}" for q in model.quantities]
    head = f"by bayesdrill {__version__}: posterior means and standard deviations, SI"
    return "\n".join([head, *lines, ""]).replace("--", "- -")


def _written(root: Element) -> str:
    indent(root)
    return tostring(root, encoding="unicode") + "\n"
