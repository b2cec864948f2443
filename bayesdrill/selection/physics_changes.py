"""Build changes that add physics to the rig: frictions, limits of servos, inertias and gravity."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from bayesdrill.analysis import edits
from bayesdrill.rig.models.linear import surplus_frictions
from bayesdrill.rig.models.roles import InertiaRoles
from bayesdrill.selection.change import BOTH, COULOMB, LINEAR, NOTHING, OTHER_LAW, WIDER, Change
from bayesdrill.selection.config_edits import (
    Entries,
    log_uniform,
    merged,
    nested,
    sections,
    uniform,
)
from bayesdrill.selection.setting import HOLDING, Setting

SLOWEST = 1e-3  # smallest speed scale of static friction, divided by the largest speed
MIN_EFFICIENCY = 0.3  # smallest efficiency of a gear in a search
DRAG_MARGIN = 4.0  # largest drag, divided by the drag that acts as strongly as all other torques
# Starts of searches for dry friction: sliding and static friction as fractions of a size, and the
# speed scale of static friction as a fraction of the largest speed; see `Setting` for both.
SLIDING_SHARES, STATIC_SHARES, FADING_SHARE = (0.05, 0.5), (0.1, 0.8), 0.03
# Starts of searches for other physics, between these fractions of its largest size.  A rig without a
# drive needs more starts: the likelihood has a maximum for each number of oscillations until rest.
SOUGHT_SIZES, DRIVEN_STARTS, FREE_STARTS = (0.003, 0.8), 14, 30
LIMIT_STARTS = (0.2, 0.4, 0.7, 0.95)  # starts for the largest duty cycle of a servo
# Limits of a goal's speed, divided by its largest speed in the record: the smallest, and starts.
SLOWEST_GOAL, GOAL_STARTS = 0.01, (0.03, 0.1, 0.3, 0.5, 0.8)
BACKWARD_STARTS = (0.5, 0.9, 1.1, 2.0)  # starts of backward friction, divided by forward friction
INERTIA_RANGE = (0.01, 10.0)  # a further inertia, divided by the inertia to which it is attached
# Starts of searches for a further inertia: its fraction of the original inertia, the number of
# stiffnesses, and damping / (inertia * frequency).
SOUGHT_SHARE, SOUGHT_SWINGS, SOUGHT_DAMPING = 0.3, 6, 0.05
# Longest period of a small swing under gravity that is sought, divided by the length of the record.
LONGEST_SWING = 3.0


def added_physics(setting: Setting) -> Iterator[Change]:
    """Yield what the rig lacks: frictions, drags, losses of gears, and limits of servos."""
    sizes, roles = setting.sizes, setting.rig.roles
    lacks = [lack for lack in edits.lacks(roles) if lack.parameter in sizes]
    for lack in sorted(lacks, key=lambda lack: not lack.name.startswith("friction")):
        drags = lack.name.startswith("drag")
        kind = OTHER_LAW if drags else COULOMB if lack.dry else LINEAR
        size = sizes[lack.parameter] * (DRAG_MARGIN if drags else 1.0)
        fractions = np.geomspace(*SOUGHT_SIZES, DRIVEN_STARTS if setting.is_driven else FREE_STARTS)
        starts = tuple({lack.parameter: size * fraction} for fraction in fractions.tolist())
        margin = HOLDING if kind == COULOMB else 1.0
        priors = {lack.parameter: uniform(size * margin)}
        yield replace(_of_physics(lack.name, lack.description, priors, kind), starts=starts)
    dry = [i for i in roles.inertias if f"friction_{i.name}" in {lack.name for lack in lacks}]
    if len(dry) == 2:
        words = f"dry friction {dry[0].at} and {dry[1].at}"
        yield _dry(setting, BOTH, words, {i.sliding: sizes[i.sliding] for i in dry})
    for i in roles.inertias:
        yield from _at_rest(setting, i)
        if setting.offered(i.efficiency) and _passes_on(setting, i):
            words = f"friction of the gear {i.at}, which grows with the load"
            priors = {i.efficiency: uniform(1.0, MIN_EFFICIENCY)}
            part = _of_physics(f"load_friction_{i.name}", words, priors, OTHER_LAW)
            yield replace(part, neutral={i.efficiency: 1.0})
        yield from _by_direction(setting, i)
    for motor in roles.motors:
        if setting.offered(motor.limit):
            words = f"a largest duty cycle of the servo of {motor.words}"
            part = _of_physics(f"saturation_{motor.inertia}", words, {motor.limit: uniform(1.0)})
            starts = tuple({motor.limit: duty} for duty in LIMIT_STARTS)
            yield replace(part, neutral=NOTHING, lacks=(), starts=starts)
        if setting.offered(motor.goal_speed) and (fastest := _fastest(setting, motor.goal)):
            words = f"a largest speed of the goal of {motor.words}"
            priors = {motor.goal_speed: log_uniform(SLOWEST_GOAL * fastest, fastest)}
            part = _of_physics(f"goal_speed_{motor.inertia}", words, priors)
            starts = tuple({motor.goal_speed: fastest * x} for x in GOAL_STARTS)
            yield replace(part, neutral=NOTHING, lacks=(), starts=starts)


def _dry(setting: Setting, name: str, words: str, sizes: Mapping[str, float]) -> Change:
    """Return dry frictions with priors up to `HOLDING` times their `sizes`, and smaller starts."""
    priors = {friction: uniform(HOLDING * size) for friction, size in sizes.items()}
    values = ([(name, size * x) for x in SLIDING_SHARES] for name, size in sizes.items())
    starts = tuple(map(dict, itertools.product(*values)))
    return replace(_of_physics(name, words, priors), starts=starts)


def _at_rest(setting: Setting, i: InertiaRoles) -> Iterator[Change]:
    """Yield static friction for candidates with dry friction, then a change with both frictions."""
    sizes = setting.sizes
    largest = setting.speeds.get(i.name, 0.0)
    if i.static not in sizes or largest == 0:
        return
    fading = log_uniform(SLOWEST * largest, largest)
    held = uniform(sizes[i.static])
    priors = {i.static: held, i.fading: fading}
    part = _of_physics(f"static_{i.name}", f"friction at rest {i.at}", priors)
    yield replace(part, neutral=NOTHING, lacks=(), requires=i.sliding)
    words = f"dry friction {i.at} with friction at rest"
    part = _of_physics(f"sticking_{i.name}", words, {i.sliding: held, **priors})
    speed = {i.fading: FADING_SHARE * largest}
    starts = tuple(
        {i.sliding: sizes[i.static] * a, i.static: sizes[i.static] * b, **speed}
        for a, b in itertools.product(SLIDING_SHARES, STATIC_SHARES)
    )
    yield replace(part, neutral=NOTHING, lacks=(i.sliding,), starts=starts)


def _fastest(setting: Setting, goal: str) -> float:
    """Return the largest speed of a measured goal; a jump is a ramp between two samples."""
    records = [(each.t, each.series[goal]) for each in setting.experiments if goal in each.series]
    return max((float(np.abs(np.diff(u) / np.diff(t)).max()) for t, u in records), default=0.0)


def _by_direction(setting: Setting, at: InertiaRoles) -> Iterator[Change]:
    """Yield frictions that may differ backwards; the prior is the same in both directions."""
    kinds = (
        ("direction", "dry friction", at.sliding, at.sliding_back),
        ("direction_rest", "friction at rest", at.static, at.static_back),
        ("direction_damping", "viscous damping", at.damping, at.damping_back),
    )
    for name, words, forward, backward in kinds:
        surplus = surplus_frictions(setting.rig, {*setting.job.problem.names, forward, backward})
        if surplus or not setting.offered(backward):
            continue
        part_name, words = f"{name}_{at.name}", f"{words} {at.at} that differs by direction"
        value, size = setting.values.get(forward, 0.0), setting.sizes.get(forward, 0.0)
        if forward == at.sliding and size:
            part = _dry(setting, part_name, words, dict.fromkeys((forward, backward), size))
        elif forward == at.damping and size:
            part = _of_physics(part_name, words, dict.fromkeys((forward, backward), uniform(size)))
        elif value > 0:
            given = (setting.prior(forward) or ((), None))[1]
            prior = given or log_uniform(value / WIDER, value * WIDER)
            starts = tuple({backward: value * factor} for factor in BACKWARD_STARTS)
            part = replace(_of_physics(part_name, words, {backward: prior}), starts=starts)
        else:
            continue
        yield replace(part, neutral=NOTHING, lacks=())


def _passes_on(setting: Setting, inertia: InertiaRoles) -> bool:
    """Return whether a gear joins the inertia to a load, and no joined inertia has friction."""
    model = setting.rig
    roles, has = model.roles, {*model.parameters}
    joined = [i for i in roles.inertias if i.speed == inertia.speed and i is not inertia]
    ends = {end for shaft in roles.shafts for end in shaft.ends if shaft.stiffness in has}
    loaded = any(i.name in ends or i.weight in has for i in joined)
    return loaded and not any({i.sliding, i.efficiency} & has for i in joined)


def added_inertias(setting: Setting) -> Iterator[Change]:
    """Yield changes that attach an inertia by a spring, if the rig offers it or is a train."""
    model = setting.rig
    pairs = itertools.permutations(model.roles.inertias, 2)
    for shaft, (new, other) in itertools.product(model.roles.shafts, pairs):
        joined = {new.name, other.name} == {*shaft.ends}
        if joined and setting.offered(shaft.stiffness, new.inertia):
            hosts = (i for i in model.roles.inertias if i.speed == other.speed)
            host = next((i for i in hosts if i.name in setting.weights), None)
            if host is not None:
                yield _inertia(setting, host, (new.inertia, shaft.stiffness, shaft.damping), {})
    given = setting.data.get("model", {})
    if "inertias" not in given:
        return
    for at in model.roles.inertias:
        if at.name in setting.weights and at.reduction == 1.0:
            new_name, spring = f"{at.name}_end", f"{at.name}_end_spring"
            names = (f"{at.inertia.split('_')[0]}_{new_name}", f"k_{spring}", f"c_{spring}")
            lines = setting.model_entries({"inertias": [*given["inertias"], new_name]})
            lines = merged(lines, nested(("model", "shafts", spring), [at.name, new_name]))
            starts = ((p, x.get("initial")) for p, x in sections(setting.data))
            for place, start in ((p, x) for p, x in starts if isinstance(x, dict)):
                for state in (x for x in (at.angle, at.speed) if x in start):
                    entry = (*place, "initial", f"{state.split('_')[0]}_{new_name}")
                    value = "free" if "prior" in str(start[state]) else start[state]
                    lines = merged(lines, nested(entry, value))
            yield _inertia(setting, at, names, lines)


def _inertia(
    setting: Setting, at: InertiaRoles, names: tuple[str, str, str], lines: Entries
) -> Change:
    """Return the change that attaches a further inertia by a damped spring.

    Its period on this spring is at least two samples and at most the length of the record.
    """
    weight, (slow, fast) = setting.weights[at.name] / at.reduction**2, _frequencies(setting)
    priors = (
        log_uniform(*(weight * fraction for fraction in INERTIA_RANGE)),
        log_uniform(weight * slow**2, weight * fast**2),
        uniform(2.0 * weight * math.sqrt(slow * fast)),
    )
    end_weight, remaining = SOUGHT_SHARE * weight, (1.0 - SOUGHT_SHARE) * setting.weights[at.name]
    host = {at.inertia: remaining} if at.inertia in setting.job.problem.names else {}
    starts = []
    for w in np.geomspace(2.0 * slow, 0.5 * fast, SOUGHT_SWINGS).tolist():
        values = (end_weight, end_weight * w**2, SOUGHT_DAMPING * end_weight * w)
        starts.append(host | dict(zip(names, values, strict=True)))
    words = f"one more inertia on a spring {at.at}"
    lines = merged(lines, {"parameters": dict(zip(names, priors, strict=True))})
    return Change(f"inertia_{at.name}", words, lines, optional=names[2], starts=tuple(starts))


def added_gravity(setting: Setting) -> Iterator[Change]:
    """Yield changes that make an inertia of a train a pendulum, which hangs down at the angle zero.

    The frequency of its small swings is at most half the rate of sampling.
    """
    given, (slow, fast) = setting.data.get("model", {}), _frequencies(setting)
    if "inertias" not in given or given.get("motion") == "linear":
        return
    for at in setting.rig.roles.inertias:
        if at.weight or at.name not in setting.weights or at.speed not in setting.rig.states:
            continue
        name, inertia = f"g_{at.name}", setting.weights[at.name]
        prior = log_uniform(inertia * (slow / LONGEST_SWING) ** 2, inertia * fast**2)
        lines = setting.model_entries({"gravity": [*given.get("gravity", ()), at.name]})
        sought = np.geomspace(2.0 * slow, 0.5 * fast, SOUGHT_SWINGS).tolist()
        starts = tuple({name: inertia * w**2} for w in sought)
        lines = merged(lines, {"parameters": {name: prior}})
        yield Change(f"gravity_{at.name}", f"gravity {at.at}", lines, starts=starts)


def _frequencies(setting: Setting) -> tuple[float, float]:
    """Return the lowest and the highest angular frequency that a record shows, in rad/s."""
    step, longest = setting.span
    return 2 * math.pi / longest, math.pi / step


def _of_physics(name: str, words: str, priors: Entries, kind: int = COULOMB) -> Change:
    """Return a change that adds parameters with `priors`; each has no effect at zero."""
    names = (*priors,)
    neutral = dict.fromkeys(names, 0.0)
    return Change(name, words, {"parameters": priors}, names, kind=kind, neutral=neutral)
