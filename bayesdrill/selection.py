"""Candidate models of a record: configs that differ from one in a thing each."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.analysis import edits
from bayesdrill.analysis.causes import NOISE, TORQUE
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import noise_name
from bayesdrill.config import loading
from bayesdrill.config.job import Job, assemble
from bayesdrill.config.records import sources
from bayesdrill.config.resolve import experiments
from bayesdrill.config.yaml_source import Source, as_yaml
from bayesdrill.inference.likelihood import Observation
from bayesdrill.record.experiment import Experiment, typical_inputs
from bayesdrill.record.formats.table import RecordTable
from bayesdrill.rig.models.roles import InertiaRoles, Roles

WIDER = 10.0  # either way, of the noise that was given


def change_noise(data: dict[str, Any], change: Callable[[dict[str, Any]], bool]) -> bool:
    """Change each noise, one number of all experiments to one unknown; whether any was changed."""
    changed = False
    top, *others = [s.get("record", {}).get("channels", {}) for s in rung_sections(data)]
    for channels in (top, *others):
        for name, channel in channels.items():
            sigma, known = noise_name(name), isinstance(channel.get("sigma"), int | float)
            if not change(channel):
                continue
            changed = True
            if known and channels is top and not any(name in other for other in others):
                share_entries(data, sigma)
            if channel.get("noise") == RED and sigma in data.get("shared", ()):
                share_entries(data, f"rho_{name}")
    return changed


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
    noise = channel.get("noise", "white")
    if (noise if isinstance(noise, str) else noise.get("name", "white")) != "white":
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
UNKNOWN, RED = NOISE
BOTH = "friction_both"
_ORDER = ("friction", "damping", "voltage")  # in which physics is tried, by the beginnings of names
MISSING = "missing_torque"
# Of a sensor: `gain_w_1` of a channel or an input; of the start; of the moment; of the gear.
SENSED = ("lag", "gain", "offset")
START, MOMENT, GEAR = "free_start", "t_0", "gear"
ABOUT: Mapping[str, str] = {
    GIVEN: "the config as it is",
    UNKNOWN: "noise of unknown size",
    RED: "noise that remembers",
    START: "another state at the start",
    MOMENT: "inputs that act later than recorded",
    GEAR: "another gear",
}

MOST_PHYSICS = 8  # unknowns
MOST_PARTS = 8
LONGEST_NAME = 100  # letters, of a config
LATEST = 20  # samples: how far a lag is sought
SLOW, SHARE = 0.1, 0.05  # s, of the record: how far it is sought where samples come faster
GAIN_SD, SUPPLY_SD = 0.3, 0.3  # of the log of a gain; of an input's offset, of its usual size
GEARS = (0.1, 0.2, 0.25, 1 / 3, 0.5, 2.0, 3.0, 4.0, 5.0, 10.0)  # times the gear that is given
QUARTER = 0.25  # of what else acts: the size of a missing torque
SLOWEST = 1e-3  # of the largest speed: that over which friction at rest is lost
LEAST, LONGEST = 3.0, 3.0  # samples, and of the record: the time of a missing torque


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """A candidate model, as the config that has it.

    `parts` that it has beside the config as given, and what each is in `words`; `lines` of a config
    that say so; `table`: a record that is in no file.
    """

    parts: tuple[str, ...]
    words: tuple[str, ...]
    source: Source
    lines: str = ""
    table: RecordTable | None = None

    @property
    def name(self) -> str:
        """Its name: parts with dashes between."""
        return "-".join(self.parts) or GIVEN

    @property
    def about(self) -> str:
        """What it has beside the config as given, in words."""
        return " and ".join(self.words) if self.parts else ABOUT[GIVEN]

    def job(self) -> Job:
        """Raises `InputError` where the config cannot have it."""
        return assemble(loading.validate(self.source), self.table)


@dataclass(frozen=True, slots=True)
class RigParts:
    """Parts that candidates of a rig with these `roles` may have, by name.

    `physics`: what the rig may be without, as the parameters that switch it on; `dry`: those of it
    that change their sign; `static`, `torques`: inertias with friction at rest, and on which a torque
    may be missing; `about`: what each is, in words.
    """

    physics: Mapping[str, tuple[str, ...]]
    dry: frozenset[str]
    static: Mapping[str, InertiaRoles]
    torques: Mapping[str, InertiaRoles]
    about: Mapping[str, str]

    @classmethod
    def from_roles(cls, roles: Roles) -> RigParts:
        """Return the parts; where friction acts at two places, `friction_both` is another."""
        each = {lack.name: lack for lack in edits.lacks(roles)}
        rubs = [i for i in roles.inertias if f"friction_{i.name}" in each]
        physics: dict[str, tuple[str, ...]] = {n: (x.parameter,) for n, x in each.items()}
        about = {**ABOUT, **{name: lack.words for name, lack in each.items()}}
        if len(rubs) == 2:
            physics |= {BOTH: (rubs[0].sliding, rubs[1].sliding)}
            about[BOTH] = f"dry friction {rubs[0].at} and {rubs[1].at}"
        static = {f"static_{i.name}": i for i in rubs if i.static}
        torques = {f"{TORQUE}{i.name}": i for i in rubs}
        about |= {name: f"friction at rest {i.at}" for name, i in static.items()}
        missing = f"a missing {roles.motion.torque}"
        about |= {name: f"{missing} {i.at}" for name, i in torques.items()}
        order = sorted(physics, key=lambda name: _ORDER.index(name.split("_", 1)[0]))
        dry = frozenset(name for name in physics if name == BOTH or each[name].dry)
        return cls({name: physics[name] for name in order}, dry, static, torques, about)

    @property
    def first(self) -> tuple[str, ...]:
        """What is tried by itself first, beside sensors and the start."""
        return (*NOISE, *self.physics, *self.torques)

    def static_beside(self, parts: Iterable[str]) -> list[str]:
        """Return friction at rest that may come beside these parts, as there it slides."""
        slides = {name for part in parts for name in self.physics.get(part, ())}
        return [name for name, i in self.static.items() if i.sliding in slides]

    def possible(self, parts: Sequence[str]) -> bool:
        """Tell whether they go together, and together mean something that one alone does not."""
        given = {*parts}
        rubs = {name for name in self.dry if name.startswith("friction_")}
        # Of each of these one is enough.
        groups = ({*self.torques}, {*NOISE}, rubs if BOTH in self.physics else set())
        # A missing torque wants white noise, and beside friction it is an approximation.
        apart = given & {*self.torques} and given & {*self.dry, *self.static, RED}
        rests = all(part in self.static_beside(parts) for part in parts if part in self.static)
        return rests and not apart and all(len(given & group) < 2 for group in groups)

    def words(self, part: str) -> str:
        """Say what a part is."""
        kind, _, name = part.partition("_")
        return self.about.get(part, f"{'an' if kind == 'offset' else 'a'} {kind} of {name}")


@dataclass(frozen=True, slots=True)
class CandidateModels:
    """Candidate models of `job`; `gear`: of those with another one, times that which is given.

    `sizes`: what parameters would be if they did as much as all else; `speeds`: the largest of inertias.
    """

    job: Job
    sizes: Mapping[str, float]
    speeds: Mapping[str, float]
    gear: float | None = None

    @classmethod
    def from_job(cls, job: Job, values: Mapping[str, float]) -> CandidateModels:
        """Return it with sizes and speeds at the start of the config or at `values`, the larger."""
        space, observations = job.problem.posterior.space, job.problem.observations
        ladder = cls(job, {}, {})
        for at in (space.start, {**space.start, **values}):
            full = space.full(space.vector(at)[None])
            sizes = edits.rig_candidates(observations, full)
            ladder = ladder.moving(sizes, _speeds(observations, full))
        return ladder

    def moving(self, sizes: Mapping[str, float], speeds: Mapping[str, float]) -> CandidateModels:
        """With sizes and speeds that are at least these."""
        sizes, speeds = _largest(self.sizes, sizes), _largest(self.speeds, speeds)
        return dataclasses.replace(self, sizes=sizes, speeds=speeds)

    @property
    def parts(self) -> RigParts:
        """The parts that candidates may have."""
        return RigParts.from_roles(self.job.problem.model.roles)

    def rungs(self, every: Iterable[tuple[str, ...]]) -> list[CandidateModel]:
        """Those with these parts, where there is such a thing to try."""
        return [rung for parts in every if (rung := self._rung(parts)) is not None]

    def singles(self) -> list[CandidateModel]:
        """Those with one thing each beside the config as given."""
        return self.rungs((name,) for name in (*self.parts.first, *self._sensors(), START))

    def beyond(self, parts: tuple[str, ...], more: Iterable[str]) -> list[CandidateModel]:
        """A rung with these parts and each of `more` that can go with them."""
        if len(parts) >= MOST_PARTS:
            return []
        wanted = dict.fromkeys((*more, *self.parts.static_beside(parts)))
        every = ((*parts, name) for name in wanted if name not in parts)
        return self.rungs(filter(self.parts.possible, every))

    def without_each(self, parts: tuple[str, ...]) -> list[CandidateModel]:
        """A rung without each of its parts, in turn."""
        every = (tuple(one for one in parts if one != part) for part in parts)
        return self.rungs(fewer for fewer in every if fewer and self.parts.possible(fewer))

    def with_gear(self, times: float) -> list[CandidateModel]:
        """With another ratio, `times` the one that is given; none where the rig has no gear."""
        return dataclasses.replace(self, gear=times).rungs([(GEAR,)])

    def windows(self, count: int) -> list[CandidateModel]:
        """The config as given, on each of `count` windows of the record, each from an unknown state."""
        given = self.job.source
        rungs = []
        for k in range(count):
            data = copy.deepcopy(given.data)
            several = data.get(experiments.EXPERIMENTS)
            for seen in self.job.problem.observations:  # what is held out stays as it is
                section, t = several[seen.label] if several else data, seen.experiment.t
                ends = t[0] + (t[-1] - t[0]) * np.array([k, k + 1]) / count
                section["record"] = {**section.get("record", {}), "window": ends.tolist()}
                section["initial"] = "free"
            source = Source(given.path, as_yaml(data), data, {}, ())
            rungs.append(CandidateModel((), (), source, table=self.job.table))
        return rungs

    def _sensors(self) -> Iterator[str]:
        """What channels and measured inputs may have, and all inputs together."""
        yield from (f"{kind}_{name}" for name in self._channels() for kind in SENSED)
        symbols = self.job.problem.model.symbols
        every = sorted(self._inputs(), key=lambda name: not symbols[name].drives)
        yield from (f"{kind}_{name}" for name in every for kind in SENSED[1:])
        yield from (f"{SENSED[0]}_{name}" for name in every[1:])  # the first: as all, by MOMENT
        if len(self._channels()) > 1:  # of one it is the lag of that
            yield MOMENT

    @property
    def _experiments(self) -> list[Experiment]:
        return [observation.experiment for observation in self.job.problem.observations]

    def _channels(self) -> list[str]:
        return list(dict.fromkeys(name for each in self._experiments for name in each.names))

    def _inputs(self) -> list[str]:
        return list(dict.fromkeys(name for each in self._experiments for name in each.series))

    def _rung(self, parts: tuple[str, ...]) -> CandidateModel | None:
        """None where there is no such thing to try."""
        given = self.job.source
        data = copy.deepcopy(given.data)
        for part in parts:
            if not self._changed(data, part):
                return None
        lines = as_yaml(changed_entries(given.data, data)).strip() if parts else ""
        lines = lines[1:-1] if lines.startswith("{") else lines
        if parts:
            data["output"] = {**data.get("output", {}), "figures": ["fit"]}
            data.pop("simulation", None)
            self._with_walkers(data)
        text, places = (as_yaml(data), {}) if parts else (given.text, given.lines)
        source = Source(given.path, text, data, places, ())
        words = tuple(map(self.parts.words, parts))
        return CandidateModel(parts, words, source, lines, self.job.table)

    def _changed(self, data: dict[str, Any], part: str) -> bool:
        if part in NOISE:
            return change_noise(data, freed if part == UNKNOWN else reddened)
        known = self.parts
        if part in known.physics:
            wanted = known.physics[part]
            if not all(name in self.sizes for name in wanted):
                return False
            data["parameters"] |= {name: uniform(self.sizes[name]) for name in wanted}
            return True
        if part in known.static:
            return self._rests(data["parameters"], known.static[part])
        if part == GEAR:
            return self._geared(data)
        if part == START:
            return _start_freed(data)
        if part not in known.torques:
            return self._sensed(data, *part.split("_", 1))
        at = known.torques[part]
        if MISSING in data or at.sliding not in self.sizes:
            return False
        size = {"prior": "half_normal", "scale": rounded(QUARTER * self.sizes[at.sliding])}
        data[MISSING] = {"at": at.name, "smoothness": "1/2", "size": size, "time": self._times()}
        share_entries(data, "s_d", "tau_d")  # one rig: the same lacks in each experiment
        return True

    def _geared(self, data: dict[str, Any]) -> bool:
        """With another number, where the gear is one."""
        model = self.job.problem.model
        if self.gear is None or not model.geared:
            return False
        given = data.get("model", {})
        given = {"name": given} if isinstance(given, str) else given
        data["model"] = {**given, model.roles.gear: rounded(self.gear * model.gear_ratio)}
        return True

    def _sensed(self, data: dict[str, Any], kind: str, name: str) -> bool:
        """With a prior of that kind in the entry of a channel or an input; `t_0` is `t` and `0`."""
        if f"{kind}_{name}" == MOMENT:
            inputs = data.setdefault("inputs", {})
            if any(MOMENT in section.get("inputs", {}) for section in rung_sections(data)):
                return False
            inputs[MOMENT] = self._lag()
            share_entries(data, MOMENT)
            return True
        channel, changed, differs = name in self._channels(), False, False
        for section in rung_sections(data):
            record = section.get("record", {})
            named = record.get("channels", {}) if channel else section.get("inputs", {})
            entry = named.get(name)
            if not isinstance(entry, dict):
                continue
            if kind in entry:
                differs = True  # an experiment says it otherwise
            elif {"column", "variable"} & {*entry}:
                entry[kind] = self._sensor_prior(kind, name, channel=channel)
                changed = True
        if changed and not differs and (kind != "offset" or not channel):
            share_entries(data, f"{kind}_{name}")
        return changed

    def _lag(self) -> dict[str, Any]:
        """Either way, so many samples [s]."""
        lengths = [(each.dt, float(each.t[-1] - each.t[0])) for each in self._experiments]
        late = rounded(max(max(LATEST * dt, min(SLOW, SHARE * length)) for dt, length in lengths))
        return {"prior": "uniform", "low": -late, "high": late}

    def _sensor_prior(self, kind: str, name: str, *, channel: bool) -> dict[str, Any]:
        if kind == "lag":
            return self._lag()
        if kind == "gain":
            return {"prior": "log_normal", "median": 1.0, "sd_log": GAIN_SD}
        size = 0.0
        for experiment in self._experiments:
            if channel and name in experiment.names:
                k = experiment.names.index(name)
                spread = float(np.nanstd(experiment.y[:, k]))
                size = max(size, spread / experiment.channels[k].shown.factor)
            elif not channel and name in experiment.series:
                usual = SUPPLY_SD * typical_inputs(experiment)[name]
                size = max(size, usual / experiment.unit_of_input(name).factor)
        return {"prior": "normal", "mean": 0.0, "sd": rounded(size)}

    def _rests(self, parameters: dict[str, Any], at: InertiaRoles) -> bool:
        """With friction that is larger at rest, where it slides by now."""
        largest, slides = self.speeds.get(at.name, 0.0), at.sliding
        if slides not in self.sizes or slides not in parameters or not largest > 0:
            return False
        parameters[at.static] = uniform(self.sizes[slides])
        parameters[at.fading] = log_uniform(SLOWEST * largest, largest)
        return True

    def _with_walkers(self, data: dict[str, Any]) -> None:
        """As many as further unknowns want, where the config says how many."""
        given = (data.get("sampler") or {}).get("walkers")
        channels = sum(len(each.channels) for each in self._experiments)
        least = 2 * (len(self.job.problem.names) + 2 * channels + MOST_PHYSICS)
        if isinstance(given, int) and given < least:
            data["sampler"] = {**data["sampler"], "walkers": least}

    def _times(self) -> dict[str, Any]:
        low = LEAST * min(each.dt for each in self._experiments)
        high = max(float(each.t[-1] - each.t[0]) for each in self._experiments) / LONGEST
        return log_uniform(low, max(high, 2 * low))


def _largest(first: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: max(first.get(name, 0.0), other.get(name, 0.0)) for name in {**first, **other}}


def _start_freed(data: dict[str, Any]) -> bool:
    """Whether any start was not free, and could be."""
    changed = False
    for section in rung_sections(data):
        initial = section.get("initial", "rest" if section is data else None)
        if initial is not None and initial != "free" and not isinstance(initial, dict):
            section["initial"] = "free"  # type: ignore[index]
            changed = True
    return changed


def changed_entries(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """What `after` has otherwise, mapping by mapping."""
    entries: dict[str, Any] = {}
    for key, value in after.items():
        if key not in before or value != before[key]:
            inside = isinstance(value, dict) and isinstance(before.get(key), dict)
            entries[key] = changed_entries(before[key], value) if inside else value
    return entries


def _speeds(observations: Sequence[Observation], full: Array) -> dict[str, float]:
    """The largest of each inertia, by its name."""
    speeds: dict[str, float] = {}
    for observation in observations:
        model, moved = observation.response.model, edits.state_motion(observation, full)
        for inertia in model.roles.inertias:
            if inertia.speed in model.states:
                of_state = np.abs(moved[:, model.states.index(inertia.speed)]).max()
                largest = {inertia.name: float(of_state) / inertia.reduction}
                speeds = _largest(speeds, largest)
    return speeds


def recommended(rung: CandidateModel, given: Source, name: str, folder: Path, about: str) -> str:
    """The config of a rung, as a file in `folder`, that draws what the one as `given` does.

    `name`: for its results; `about`: in comments that it begins with.
    """
    data = copy.deepcopy(rung.source.data)
    data["name"], data["output"] = name, given.data.get("output")
    if not data["output"]:
        data.pop("output", None)
    for section in rung_sections(data):
        sources.rebase(section, given.path.parent, folder)
    lines = "".join(f"# {line}\n" for line in about.splitlines())
    return f"{lines}{as_yaml(data)}"
