"""Rungs of a ladder: configs that differ from one in a thing each, from the simple to the rich."""

from __future__ import annotations

import copy
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.insight import candidates
from bayesdrill.setup import experiments, loading
from bayesdrill.setup.config import Config
from bayesdrill.setup.job import Job, assemble
from bayesdrill.setup.yaml_source import Source

GIVEN = "as_given"
UNKNOWN, RED = "unknown_noise", "ar1"
NOISE = (UNKNOWN, RED)
# What the rig may be without: the parameters that each rung switches on.
PHYSICS: Mapping[str, tuple[str, ...]] = {
    "friction_motor": ("t_cm",),
    "friction_rotor_1": ("t_c1",),
    "friction_both": ("t_cm", "t_c1"),
    "damping_rotor_1": ("c_1",),
    "damping_shaft": ("c_s",),
    "voltage_drop": ("v_d",),
}
TORQUES: Mapping[str, tuple[str, str]] = {  # where it acts, and the friction there
    "missing_torque_motor": ("motor", "t_cm"),
    "missing_torque_rotor_1": ("rotor_1", "t_c1"),
}
MISSING = "missing_torque"
FIRST = (GIVEN, *NOISE, *PHYSICS, *TORQUES)
ALIKE = ("friction_motor", "friction_rotor_1", "friction_both")  # one of them is enough

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
    "missing_torque_motor": "a missing torque at the motor",
    "missing_torque_rotor_1": "a missing torque at rotor 1",
}

MOST_PHYSICS = 4  # unknowns
LONGEST_NAME = 100  # letters, of a config
WIDER = 10.0  # either way, of the noise that was given
QUARTER = 0.25  # of what else acts: the size of a missing torque
LEAST, LONGEST = 3.0, 3.0  # samples, and of the record: the time of a missing torque


@dataclass(frozen=True, slots=True)
class Rung:
    """`parts`: names of what it has beside the config as given; `output`: what that wants drawn."""

    parts: tuple[str, ...]
    source: Source
    output: Mapping[str, Any]

    @property
    def name(self) -> str:
        return name_of(self.parts)

    @property
    def about(self) -> str:
        return " and ".join(ABOUT[part] for part in self.parts) if self.parts else ABOUT[GIVEN]

    def job(self) -> Job:
        """Raises `InputError` where the config cannot have it."""
        return assemble(loading.validated(self.source), self.source)


def name_of(parts: Sequence[str]) -> str:
    """Of a folder."""
    return "-".join(parts) or GIVEN


def names() -> tuple[str, ...]:
    """Of all folders that a ladder may have."""
    single = [(), *((name,) for name in FIRST[1:])]
    rich = [(one, *more) for one in (*PHYSICS, *TORQUES) for more in _more(one)]
    return tuple(name_of(parts) for parts in (*single, *rich))


def _more(one: str) -> Iterator[tuple[str, ...]]:
    """What may go with physics."""
    others = [
        (other,)
        for other in (*PHYSICS, *TORQUES)
        if other != one and not {one, other} <= {*ALIKE} and other not in TORQUES
    ]
    yield from others
    yield from ((name,) for name in NOISE)


@dataclass(frozen=True, slots=True)
class Ladder:
    """Rungs of the config of `job`; `sizes`: what a parameter would be if it did as much as all else."""

    job: Job
    sizes: Mapping[str, float]

    @classmethod
    def of(cls, job: Job) -> Ladder:
        posterior = job.problem.posterior
        space: ParameterSpace = posterior.space
        theta = space.vector(space.start)
        found = candidates.of_rig(posterior.likelihood.observations, space, theta)
        return cls(job, {one.of: float(one.prior.high) for one in found})

    def first(self) -> list[Rung]:
        """Those that need nothing of others, each with one thing; the config as given first."""
        found = [self._rung(()), *(self._rung((name,)) for name in FIRST[1:])]
        return [one for one in found if one is not None]

    def then(self, ranked: Sequence[str]) -> list[Rung]:
        """With the best physics another noise, and the second best; `ranked`: names of single rungs that
        are better than the config as given, the best first.
        """
        physics = [name for name in ranked if name in PHYSICS or name in TORQUES]
        if not physics:
            return []
        best = physics[0]
        possible = list(_more(best))
        second = next((name for name in physics[1:] if (name,) in possible), None)
        wanted = [(best, name) for name in (*NOISE, *((second,) if second else ()))]
        found = [self._rung(parts) for parts in wanted]
        return [one for one in found if one is not None]

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
            change = _freed if part == UNKNOWN else _reddened
            changed = [change(channel) for channel in _channels(data)]  # all of them
            return part in (UNKNOWN, *NOISES) and any(changed)
        if part in PHYSICS:
            wanted = PHYSICS[part]
            if not all(name in self.sizes for name in wanted):
                return False
            for name in wanted:
                high = _rounded(self.sizes[name])
                data["parameters"][name] = {"prior": "uniform", "low": 0.0, "high": high}
            return True
        at, friction = TORQUES[part]
        if MISSING not in Config.model_fields or MISSING in data or friction not in self.sizes:
            return False
        data[MISSING] = {
            "at": at,
            "smoothness": "1/2",
            "size": {"prior": "half_normal", "scale": _rounded(QUARTER * self.sizes[friction])},
            "time": self._times(),
        }
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
        return {"prior": "log_uniform", "low": _rounded(low), "high": _rounded(max(high, 2 * low))}


def _channels(data: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for section in _sections(data):
        yield from section.get("record", {}).get("channels", {}).values()


def _sections(data: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The top, and each experiment."""
    yield data
    yield from (data.get(experiments.EXPERIMENTS) or {}).values()


def _freed(channel: dict[str, Any]) -> bool:
    """Of a size that is known; whether it was."""
    sigma = channel.get("sigma")
    if isinstance(sigma, int | float):
        low, high = _rounded(sigma / WIDER), _rounded(sigma * WIDER)
        prior = {"prior": "log_uniform", "low": low, "high": high, "start": float(sigma)}
        channel["sigma"] = prior
        return True
    return False


def _reddened(channel: dict[str, Any]) -> bool:
    """That remembers, where it was white; whether it was."""
    own = channel.get("noise", "white")
    if (own if isinstance(own, str) else own.get("name", "white")) != "white":
        return False
    _freed(channel)
    channel["noise"] = RED
    return True


def _rounded(value: float) -> float:
    """To three digits: a config is read."""
    return float(f"{value:.3g}")


def recommended(rung: Rung, name: str, folder: Path, opening: str) -> str:
    """The config of a rung, as a file in `folder`: `opening` in comments, and `name` for its results."""
    given = rung.source
    data = copy.deepcopy(given.data)
    data["name"] = name
    if rung.parts:
        data["output"] = dict(rung.output)
    if not data.get("output"):
        data.pop("output", None)
    for entry, key in _files(data):
        record = (given.path.parent / entry[key]).resolve()
        entry[key] = Path(os.path.relpath(record, folder.resolve())).as_posix()
    lines = "".join(f"# {line}\n" for line in opening.splitlines())
    return f"{lines}{as_yaml(data)}"


def _files(data: Mapping[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """Each mapping that names a file, and the key that does."""
    for section in _sections(data):
        record, inputs = section.get("record", {}), section.get("inputs", {})
        every = [record, *record.get("channels", {}).values(), *inputs.values()]
        for one in every:
            if isinstance(one, dict) and "file" in one:
                file = one["file"]
                yield (file, "path") if isinstance(file, dict) else (one, "file")


def as_yaml(data: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    yaml, out = YAML(), io.StringIO()
    yaml.width = 120
    yaml.default_flow_style = None
    yaml.dump(dict(data), out)
    return out.getvalue()
