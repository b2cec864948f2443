"""Candidate models of a record: configs that differ from one in a thing each, from the simple to
the rich.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.analysis import edits
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import noise_name
from bayesdrill.config import loading
from bayesdrill.config.job import Job, assemble
from bayesdrill.config.records import sources
from bayesdrill.config.resolve import experiments
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source, as_yaml
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.rig.models.linear import MotorRoles, Roles, RotorRoles

RED = "ar1"
WIDER = 10.0  # either way, of the noise that was given


def change_channels(data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any], bool]]:
    """Each with its name, and whether all experiments have it so."""
    top, *own = [section.get("record", {}).get("channels", {}) for section in rung_sections(data)]
    for name, channel in top.items():
        yield name, channel, not any(name in one for one in own)
    for one in own:
        for name, channel in one.items():
            yield name, channel, False


def change_sections(
    data: dict[str, Any],
    change: Callable[[dict[str, Any]], bool],
    name: str,
    channel: dict[str, Any],
    common: bool,
) -> bool:
    """What was one number for all experiments becomes one unknown; a memory goes with its size."""
    known = isinstance(channel.get("sigma"), int | float)
    if not change(channel):
        return False
    sigma = noise_name(name)
    if common and known:
        share_entries(data, sigma)
    if channel.get("noise") == RED and sigma in data.get("shared", ()):
        share_entries(data, f"rho_{name}")
    return True


def share_entries(data: dict[str, Any], *names: str) -> None:
    """One unknown in all experiments, where there are several."""
    if data.get(experiments.EXPERIMENTS):
        data["shared"] = [*dict.fromkeys((*data.get("shared", ()), *names))]


def rung_sections(data: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The top, and each experiment."""
    yield data
    yield from (data.get(experiments.EXPERIMENTS) or {}).values()


def freed(channel: dict[str, Any]) -> bool:
    """Of a size that is known; whether it was."""
    sigma = channel.get("sigma")
    if isinstance(sigma, int | float):
        channel["sigma"] = log_uniform(sigma / WIDER, sigma * WIDER) | {"start": float(sigma)}
        return True
    return False


def reddened(channel: dict[str, Any]) -> bool:
    """That remembers, where it was white; whether it was."""
    own = channel.get("noise", "white")
    if (own if isinstance(own, str) else own.get("name", "white")) != "white":
        return False
    freed(channel)
    channel["noise"] = RED
    return True


def rounded(value: float) -> float:
    """To three digits: a config is read."""
    return float(f"{value:.3g}")


def log_uniform(low: float, high: float) -> dict[str, Any]:
    """A prior, as an entry of a config."""
    return {"prior": "log_uniform", "low": rounded(low), "high": rounded(high)}


def uniform(high: float) -> dict[str, Any]:
    """A prior from zero, as an entry of a config."""
    return {"prior": "uniform", "low": 0.0, "high": rounded(high)}


GIVEN = "as_given"
UNKNOWN = "unknown_noise"
NOISE = (UNKNOWN, RED)
# What the rig may be without: the roles of the parameters that each rung switches on.
PHYSICS: Mapping[str, tuple[str, ...]] = {
    "friction_motor": ("motor.sliding",),
    "friction_rotor_1": ("rotor.sliding",),
    "friction_both": ("motor.sliding", "rotor.sliding"),
    "damping_rotor_1": ("rotor.damping",),
    "damping_shaft": ("shaft.damping",),
    "voltage_drop": ("motor.drop",),
}
# Friction at rest, where there is friction: what it slides with, and where.
STATIC: Mapping[str, tuple[str, str]] = {
    "static_motor": ("motor.sliding", "motor"),
    "static_rotor_1": ("rotor.sliding", "rotor_1"),
}
TORQUES: Mapping[str, str] = {  # where it acts
    "missing_torque_motor": "motor",
    "missing_torque_rotor_1": "rotor_1",
}
MISSING = "missing_torque"
FIRST = (GIVEN, *NOISE, *PHYSICS, *TORQUES)
ORDER = (*PHYSICS, *STATIC, *TORQUES, *NOISE)  # of parts in a name
# Of each of these one is enough.
ALIKE = ({"friction_motor", "friction_rotor_1", "friction_both"}, {*TORQUES}, {*NOISE})
# A missing torque wants white noise, and beside friction it is an approximation.
APART = {*TORQUES}, {*PHYSICS, *STATIC, RED} - {"damping_rotor_1", "damping_shaft"}

ABOUT: Mapping[str, str] = {
    GIVEN: "the config as it is",
    UNKNOWN: "noise of unknown size",
    RED: "noise that remembers, of unknown size",
    "friction_motor": "dry friction at the motor",
    "friction_rotor_1": "dry friction at rotor 1",
    "friction_both": "dry friction at the motor and at rotor 1",
    "damping_rotor_1": "viscous damping at rotor 1",
    "damping_shaft": "damping of the shaft",
    "voltage_drop": "a voltage drop of driver and brushes",
    "static_motor": "friction at rest at the motor",
    "static_rotor_1": "friction at rest at rotor 1",
    "missing_torque_motor": "a missing torque at the motor",
    "missing_torque_rotor_1": "a missing torque at rotor 1",
}

MOST_PHYSICS = 8  # unknowns
MOST_PARTS = 5
LONGEST_NAME = 100  # letters, of a config
QUARTER = 0.25  # of what else acts: the size of a missing torque
SLOWEST = 1e-3  # of the largest speed: that over which friction at rest is lost
LEAST, LONGEST = 3.0, 3.0  # samples, and of the record: the time of a missing torque


@dataclass(frozen=True, slots=True)
class Rung:
    """`parts`: names of what it has beside the config as given; `output`: what that wants drawn."""

    parts: tuple[str, ...]
    source: Source
    output: Mapping[str, Any]

    @property
    def name(self) -> str:
        return rung_name(self.parts)

    @property
    def about(self) -> str:
        return " and ".join(ABOUT[part] for part in self.parts) if self.parts else ABOUT[GIVEN]

    def job(self) -> Job:
        """Raises `InputError` where the config cannot have it."""
        return assemble(loading.validated(self.source))


def rung_name(parts: Sequence[str]) -> str:
    """Of a folder."""
    return "-".join(parts) or GIVEN


def rung_names() -> tuple[str, ...]:
    """Of all folders that a ladder may have, those with fewer parts first."""
    every = [(), *((name,) for name in FIRST[1:])]
    for count in range(2, MOST_PARTS + 1):
        every += [parts for parts in combinations(ORDER, count) if _possible(parts)]
    return tuple(rung_name(parts) for parts in every)


def _possible(parts: Sequence[str]) -> bool:
    """Whether they can go together, and together mean something that one alone does not."""
    given = {*parts}
    either, other = APART
    sliding = {name for one in parts for name in PHYSICS.get(one, ())}
    rests = all(STATIC[one][0] in sliding for one in parts if one in STATIC)
    alike = any(len(given & one) > 1 for one in ALIKE)
    return rests and not alike and not (given & either and given & other)


@dataclass(frozen=True, slots=True)
class Ladder:
    """Rungs of the config of `job`; `sizes`: what a parameter would be if it did as much as all else;
    `speeds`: the largest speeds of rotor 1 and of the motor, where friction may act.
    """

    job: Job
    sizes: Mapping[str, float]
    speeds: Mapping[str, float]

    @classmethod
    def of(cls, job: Job) -> Ladder:
        posterior = job.problem.posterior
        space: ParameterSpace = posterior.space
        theta = space.vector(space.start)
        every = posterior.likelihood.observations
        found = edits.rig_candidates(every, space, theta)
        sizes = {one.of: float(one.prior.high) for one in found}
        return cls(job, sizes, _speeds(every, space, theta))

    @property
    def roles(self) -> Roles:
        return self.job.problem.model.roles

    def first(self) -> list[Rung]:
        """Those that need nothing of others, each with one thing; the config as given first."""
        return self._rungs([(), *((name,) for name in FIRST[1:])])

    def then(self, ranked: Sequence[str]) -> list[Rung]:
        """With the best physics another noise, and the second best; `ranked`: names of single rungs that
        are better than the config as given, the best first.
        """
        physics = [name for name in ranked if name in PHYSICS or name in TORQUES]
        if not physics:
            return []
        best = physics[0]
        second = next((name for name in physics[1:] if _possible((best, name))), None)
        return self._with((best,), (*NOISE, *((second,) if second else ())))

    def beyond(self, parts: tuple[str, ...]) -> list[Rung]:
        """Of a rung with physics that leaves more than noise: with each thing more that it has not."""
        if len(parts) >= MOST_PARTS or not {*parts} & {*PHYSICS, *TORQUES}:
            return []
        return self._with(parts, tuple(name for name in ORDER if name not in parts))

    def _with(self, parts: tuple[str, ...], more: Sequence[str]) -> list[Rung]:
        every = [tuple(sorted((*parts, name), key=ORDER.index)) for name in more]
        return self._rungs(filter(_possible, every))

    def _rungs(self, every: Iterable[tuple[str, ...]]) -> list[Rung]:
        return [rung for parts in every if (rung := self._rung(parts)) is not None]

    def _rung(self, parts: tuple[str, ...]) -> Rung | None:
        """None where there is no such thing to try."""
        given = self.job.source
        data = copy.deepcopy(given.data)
        for part in parts:
            if not self._changed(data, part):
                return None
        output = dict(data.get("output", {}))
        if parts:
            data["output"] = {**output, "figures": ["fit"]}
            data.pop("simulation", None)
            self._with_walkers(data)
        text = given.text if not parts else as_yaml(data)
        source = Source(given.path, text, data, given.lines if not parts else {}, ())
        return Rung(parts, source, output)

    def _changed(self, data: dict[str, Any], part: str) -> bool:
        if part in NOISE:
            change = freed if part == UNKNOWN else reddened
            changed = [change_sections(data, change, *one) for one in list(change_channels(data))]
            return part in (UNKNOWN, *NOISES) and any(changed)
        if part in PHYSICS:
            wanted = [self.roles[role] for role in PHYSICS[part]]
            if not all(name in self.sizes for name in wanted):
                return False
            data["parameters"] |= {name: uniform(self.sizes[name]) for name in wanted}
            return True
        if part in STATIC:
            return self._rests(data["parameters"], self.roles.at(STATIC[part][1]))
        at = TORQUES[part]
        friction = self.roles.at(at).sliding
        if MISSING not in Config.model_fields or MISSING in data or friction not in self.sizes:
            return False
        size = {"prior": "half_normal", "scale": rounded(QUARTER * self.sizes[friction])}
        data[MISSING] = {"at": at, "smoothness": "1/2", "size": size, "time": self._times()}
        share_entries(data, "s_d", "tau_d")  # one rig: the same lacks in each experiment
        return True

    def _rests(self, parameters: dict[str, Any], at: MotorRoles | RotorRoles) -> bool:
        """With friction that is larger at rest, where it slides by now."""
        largest, slides = self.speeds.get(at.speed, 0.0), at.sliding
        if slides not in self.sizes or slides not in parameters or not largest > 0:
            return False
        parameters[at.static] = uniform(self.sizes[slides])
        parameters[at.fading] = log_uniform(SLOWEST * largest, largest)
        return True

    def _with_walkers(self, data: dict[str, Any]) -> None:
        """As many as further unknowns want, where the config says how many."""
        given = (data.get("sampler") or {}).get("walkers")
        problem = self.job.problem
        channels = sum(len(one.experiment.channels) for one in problem.observations)
        least = 2 * (len(problem.names) + 2 * channels + MOST_PHYSICS)
        if isinstance(given, int) and given < least:
            data["sampler"] = {**data["sampler"], "walkers": least}

    def _times(self) -> dict[str, Any]:
        every = [one.experiment for one in self.job.problem.observations]
        low = LEAST * min(one.dt for one in every)
        high = max(float(one.t[-1] - one.t[0]) for one in every) / LONGEST
        return log_uniform(low, max(high, 2 * low))


def _speeds(every: Sequence[Observation], space: ParameterSpace, theta: Array) -> dict[str, float]:
    """Of rotor 1, and of the motor on its own side of the gear [rad/s]."""
    found: dict[str, float] = {}
    for one in every:
        model, moved = one.response.model, edits.motion(one, space, theta)
        roles = model.roles
        for name, gear in ((roles.rotor.speed, 1.0), (roles.motor.speed, model.gear_ratio)):
            if name in model.states:
                largest = float(np.abs(moved[:, model.states.index(name)]).max()) / gear
                found[name] = max(found.get(name, 0.0), largest)
    return found


def recommended(rung: Rung, name: str, folder: Path, opening: str) -> str:
    """The config of a rung, as a file in `folder`: `opening` in comments, and `name` for its results."""
    given = rung.source
    data = copy.deepcopy(given.data)
    data["name"] = name
    if rung.parts:
        data["output"] = dict(rung.output)
    if not data.get("output"):
        data.pop("output", None)
    for section in rung_sections(data):
        sources.rebase(section, given.path.parent, folder)
    lines = "".join(f"# {line}\n" for line in opening.splitlines())
    return f"{lines}{as_yaml(data)}"
