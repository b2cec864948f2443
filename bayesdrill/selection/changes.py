"""Changes of a config that may explain a bad fit: of columns, times, the rig, and the noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from bayesdrill.analysis import edits
from bayesdrill.analysis.causes import NOISE, TORQUE
from bayesdrill.basics.symbols import noise_name
from bayesdrill.config.job import Job
from bayesdrill.config.resolve import experiments
from bayesdrill.inference.likelihood import Observation
from bayesdrill.record.experiment import Experiment, typical_inputs
from bayesdrill.rig.models.roles import InertiaRoles
from bayesdrill.selection.config_edits import (
    SHARED,
    Entries,
    Place,
    columns,
    leaves,
    log_uniform,
    merged,
    nested,
    rounded,
    sections,
    uniform,
)

UNKNOWN, AR1 = NOISE
BOTH = "friction_both"
MISSING = "missing_torque"
# Changes whose constant is sought, or that stand for all of a rig or a record.
START, MOMENT, GEAR, CLOCK, LATER = "free_start", "t_0", "gear", "clock", "later"
WIDENED = "prior_"  # begins the names of changes that widen the prior of an unknown
# What of the entry of a column says where its numbers stand, what they are, and how it is measured.
OF_SENSOR = ("gain", "offset", "lag")
OF_COLUMN = ("file", "time", "column", "variable", "unit", "mask", "wraps", "noise", *OF_SENSOR)

WIDER = 10.0  # either way, of the noise that was given; of the end of a prior in logs
MAX_LAG_SAMPLES = 20  # samples: how far a lag is sought
MAX_LAG, LAG_SHARE = 0.1, 0.05  # s, of the record: how far it is sought where samples come faster
MAX_LAG_SHARE = 0.1  # of the record: no lag is sought beyond, as it would hide what it shifts
GAIN_SD, SUPPLY_SD = 0.3, 0.3  # of the log of a gain; of an input's offset, of its usual size
QUARTER = 0.25  # of what else acts: the size of a missing torque
SLOWEST = 1e-3  # of the largest speed: that over which friction at rest is lost
# Samples at least, and at most the record over it: the time of a missing torque.
TIME_PARTS = 3.0
MIN_EFFICIENCY = 0.3
DRAG_MARGIN = 4.0  # times the size by which a drag would do as much as all else: speeds fall by it
# Of its size, from where to where physics is sought, and from how many starts: a rig that nothing drives
# comes to rest by friction after so many swings, and each number of them is a maximum of its own.
SOUGHT_SIZES, DRIVEN_STARTS, FREE_STARTS = (0.003, 0.8), 14, 30
INERTIA_RANGE = (0.01, 10.0)  # times the inertia that a further one is on a spring at
# Where that is sought: of the inertia, from so many springs, of the damping.
SOUGHT_SHARE, SOUGHT_SWINGS, SOUGHT_DAMPING = 0.3, 6, 0.05
# Of physics, by what it asks of a simulator: nothing that is linear, Coulomb's law, or another law.
# Candidates of one kind have all of it, the others at numbers that do nothing: they share kernels.
LINEAR, COULOMB, OTHER_LAW = 1, 2, 3
NOTHING: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Change:
    """A change of a model, in `words`: `entries` go over those of its config.

    `lacks`: parameters of the rig that it switches on; `needs`: a parameter that another change has to
    have freed; `optional`: an unknown that may be zero.  `kind`, `neutral`: of physics, see `LINEAR`,
    with the numbers at which it does nothing.  `starts`: values from which it is sought.
    """

    name: str
    words: str
    entries: Entries
    lacks: tuple[str, ...] = ()
    needs: str = ""
    optional: str = ""
    kind: int = 0
    neutral: Mapping[str, float] = NOTHING
    starts: tuple[Mapping[str, float], ...] = ()

    @property
    def absorbs(self) -> bool:
        """Whether it absorbs any misfit and names no cause."""
        return self.name in NOISE or self.name.startswith(TORQUE)

    @property
    def decides(self) -> frozenset[Place]:
        """What of a config it decides: changes that decide the same do not go together."""
        return frozenset(leaves(self.entries))


@dataclass(frozen=True)
class Setting:
    """What is known where changes of `job` are chosen.

    `sizes`: what parameters would be if they did as much as all else; `speeds`: the largest of inertias;
    `weights`: what these are at the maximum; `numbers`: constants that changes have, by their names.
    """

    job: Job
    sizes: Mapping[str, float] = NOTHING
    speeds: Mapping[str, float] = NOTHING
    weights: Mapping[str, float] = NOTHING
    numbers: Mapping[str, float] = NOTHING

    @classmethod
    def from_job(cls, job: Job, values: Mapping[str, float]) -> Self:
        """Return it with sizes and speeds at the start of the config or at `values`, the larger."""
        space, observations = job.problem.posterior.space, job.problem.observations
        setting = cls(job)
        for at in (space.start, {**space.start, **values}):
            full = space.full(space.vector(at)[None])
            sizes, speeds = edits.rig_candidates(observations, full), _speeds(observations, full)
            setting = setting.at_least(sizes, speeds)
            p = edits.rig_parameters(observations[0], full)
        inertias = job.problem.model.roles.inertias
        return replace(setting, weights={i.name: p[i.inertia] for i in inertias if i.inertia in p})

    def with_numbers(self, **numbers: float) -> Self:
        """Return it with these constants of changes."""
        return replace(self, numbers={**self.numbers, **numbers})

    def at_least(self, sizes: Mapping[str, float], speeds: Mapping[str, float]) -> Self:
        """Return it with sizes and speeds that are at least these."""
        return replace(
            self, sizes=_largest(self.sizes, sizes), speeds=_largest(self.speeds, speeds)
        )

    @cached_property
    def changes(self) -> dict[str, Change]:
        """All changes by name, in the order in which they are tried."""
        of_columns = (*self._widened(), *self._columns(), *self._times())
        every = (*of_columns, *self._physics(), *self._inertias(), *self._absorbing())
        return {change.name: change for change in every if change.entries}

    # What the job has.

    @property
    def _data(self) -> Entries:
        return dict(self.job.source.data)

    @property
    def _observations(self) -> tuple[Observation, ...]:
        return self.job.problem.observations

    @cached_property
    def _experiments(self) -> list[Experiment]:
        return [observation.experiment for observation in self._observations]

    @cached_property
    def _units(self) -> dict[str, str]:
        """The unit of each channel."""
        return {c.name: c.unit for each in self._experiments for c in each.channels}

    @cached_property
    def _inputs(self) -> list[str]:
        names = dict.fromkeys(name for each in self._experiments for name in each.series)
        return sorted(names, key=lambda name: not self.job.problem.model.symbols[name].drives)

    @property
    def _span(self) -> tuple[float, float]:
        """The shortest step between samples, and the longest record [s]."""
        lengths = [float(np.ptp(each.t)) for each in self._experiments]
        return min(each.dt for each in self._experiments), max(lengths)

    def _shared(self, *names: str) -> Entries:
        """Return the entry by which these are one unknown in all experiments, if there are several."""
        return {SHARED: [*names]} if self._data.get(experiments.EXPERIMENTS) else {}

    # Priors that end too early.

    def _widened(self) -> Iterator[Change]:
        parameters, symbols = self.job.problem.model.parameters, self.job.problem.model.symbols
        for part in [name for name in self.numbers if name.startswith(WIDENED)]:
            name, way = part.removeprefix(WIDENED), int(self.numbers[part])
            place, prior = self._prior(name) or ((), {})
            if not {"low", "high"} <= {*prior}:
                continue
            key, ends = "high" if way > 0 else "low", (float(prior["low"]), float(prior["high"]))
            logs = prior["prior"] == "log_uniform"
            end = float(prior[key]) * WIDER**way if logs else float(prior[key]) + way * np.ptp(ends)
            if name in parameters:
                end = min(max(end, 0.0), symbols[name].at_most)
            if end != float(prior[key]):
                lines = nested((*place, key), rounded(end, 4))
                yield Change(part, f"a wider prior of {name}", lines)

    def _prior(self, name: str) -> tuple[Place, Entries] | None:
        """Return the entry with the prior of an unknown, and its place; None where it is not found."""
        ending = next((f"_{e.label}" for e in self._observations if name.endswith(e.label)), "")
        kind, _, owner = name.removesuffix(ending).partition("_")
        tops = ("parameters", "quantities", "inputs")
        numbers: dict[Place, Any] = {(n, name): (self._data.get(n) or {}).get(name) for n in tops}
        if kind in OF_SENSOR:
            numbers |= {(*p, kind): x.get(kind) for p, x in columns(self._data, owner)}
        priors = (
            pair for pair in numbers.items() if isinstance(pair[1], dict) and "prior" in pair[1]
        )
        return next(priors, None)

    # Columns.

    def _columns(self) -> Iterator[Change]:
        units = self._units | {n: self.job.problem.model.symbols[n].unit for n in self._inputs}
        for pair in itertools.combinations(units, 2):
            if units[pair[0]] == units[pair[1]] and {*pair} & {*self._units}:
                words = f"the columns of {pair[0]} and {pair[1]} exchanged"
                yield Change(f"exchange_{'_'.join(pair)}", words, self._exchanged(*pair))
        for name in units:
            if name in self._units or len(self._units) > 1:  # of one channel it is that of this
                yield Change(f"sign_{name}", f"the sign of {name} turned", self._turned(name))
        for name in units:
            gain = {"prior": "log_normal", "median": 1.0, "sd_log": GAIN_SD}
            yield self._sensor("gain", name, gain)
            size = rounded(self._offset_size(name))
            yield self._sensor("offset", name, {"prior": "normal", "mean": 0.0, "sd": size})

    def _exchanged(self, *names: str) -> Entries:
        """Nothing, where only one of two columns says something: no line takes that away."""
        lines: Entries = {}
        for (first, a), (second, b) in zip(*(columns(self._data, n) for n in names), strict=False):
            keys = [key for key in OF_COLUMN if key in a or key in b]
            keys += ["sigma"] if a.get("unit") != b.get("unit") else []
            if not {*keys} <= {*a} & {*b}:
                return {}
            for place, mine, other in ((first, a, b), (second, b, a)):
                new = {key: other[key] for key in keys if other[key] != mine[key]}
                lines = merged(lines, nested(place, new))
        return lines

    def _turned(self, name: str) -> Entries:
        entries = [*columns(self._data, name)]
        if any(isinstance(entry.get("gain", 1.0), dict) for _, entry in entries):
            return {}
        each = (nested(place, {"gain": -float(x.get("gain", 1.0))}) for place, x in entries)
        return merged({}, *each)

    def _sensor(self, kind: str, name: str, prior: Entries) -> Change:
        entries = [*columns(self._data, name)]
        new = [place for place, x in entries if kind not in x and {"column", "variable"} & {*x}]
        lines = merged({}, *(nested((*place, kind), prior) for place in new))
        scales_channel = kind == "offset" and name in self._units
        if new and not scales_channel and not any(kind in entry for _, entry in entries):
            lines = merged(lines, self._shared(f"{kind}_{name}"))
        article = "an" if kind == "offset" else "a"
        return Change(f"{kind}_{name}", f"{article} {kind} of {name}", lines)

    def _offset_size(self, name: str) -> float:
        sizes = [0.0]
        for experiment in self._experiments:
            for channel, y in zip(experiment.channels, experiment.y.T, strict=True):
                if channel.name == name:
                    sizes.append(float(np.nanstd(y)) / channel.display_unit.factor)
            if name in experiment.series:
                usual = SUPPLY_SD * typical_inputs(experiment)[name]
                sizes.append(usual / experiment.unit_of_input(name).factor)
        return max(sizes)

    # Times.

    @cached_property
    def _driven(self) -> bool:
        return any(np.ptp(u) > 0 for each in self._experiments for u in each.series.values())

    @cached_property
    def time_references(self) -> frozenset[str]:
        """Changes that shift a channel, or all inputs, in time: one of what they shift has to stay.

        Inputs tell the time where they change, or are switched on where the start is known.
        """
        sensing = [observation.response.sensing for observation in self._observations]
        known = not any(each.states or each.steady for each in sensing)
        pushed = known and any(x for each in self._experiments for x in each.constant.values())
        moments = {MOMENT} if self._driven or pushed else set()
        return frozenset({*(f"lag_{name}" for name in self._units), *moments})

    @property
    def clocks(self) -> tuple[str, ...]:
        """Changes of a clock, that of the record or of a channel, if there are several."""
        names = (*self._units, *self._inputs)
        timed = {n for n in names for _, entry in columns(self._data, n) if "time" in entry}
        return (CLOCK, *(f"{CLOCK}_{n}" for n in self._units if n in timed)) if timed else ()

    def _times(self) -> Iterator[Change]:
        sensing = [observation.response.sensing for observation in self._observations]
        shifted = {f"lag_{name}" for each in sensing for name in each.lags}
        shifted |= {MOMENT for each in sensing if each.delay}
        fixed = self.time_references - shifted
        pairs = [(each.dt, float(np.ptp(each.t))) for each in self._experiments]
        late = max(max(MAX_LAG_SAMPLES * dt, min(MAX_LAG, LAG_SHARE * s)) for dt, s in pairs)
        late = min(late, *(MAX_LAG_SHARE * length for _, length in pairs))
        lag = uniform(late, -late)
        # Of inputs the first is as all, by `t_0`; of one channel that is its lag.
        for name in (*(self._units if len(fixed) > 1 else ()), *self._inputs[1:]):
            yield self._sensor("lag", name, lag)
        if len(fixed) > 1 and MOMENT in fixed and len(self._units) > 1:
            lines = merged(nested(("inputs", MOMENT), lag), self._shared(MOMENT))
            yield Change(MOMENT, "inputs that act later than recorded", lines)
        for part in self.clocks:
            if (factor := self.numbers.get(part)) is not None:
                yield self._clock(part, part.removeprefix(CLOCK).removeprefix("_"), factor)
        starts = [(p, x.get("initial", None if p else "rest")) for p, x in sections(self._data)]
        held = [place for place, x in starts if isinstance(x, str) and x != "free"]
        free = merged({}, *(nested((*place, "initial"), "free") for place in held))
        yield Change(START, "another state at the start", free)
        if (later := self.numbers.get(LATER)) is not None:
            words = f"a record that begins {later:.3g} s later, from an unknown state"
            yield Change(LATER, words, self.window(0.0, 1.0, later))
        if GEAR in self.numbers:
            model = self.job.problem.model
            ratio = rounded(self.numbers[GEAR] * model.gear_ratio)
            yield Change(GEAR, "another gear", self._model({model.roles.gear: ratio}))

    def window(self, begin: float, end: float, later: float = 0.0) -> Entries:
        """Return lines by which all experiments have these shares of their times, from a free start."""
        several, lines = self._data.get(experiments.EXPERIMENTS), []
        for observation in self._observations:  # what is held out stays as it is
            first, *_, last = observation.experiment.t.tolist()
            ends = [(1.0 - share) * first + share * last for share in (begin, end)]
            window = [rounded(ends[0] + later, 9), ends[1]]
            place = (experiments.EXPERIMENTS, observation.label) if several else ()
            lines.append(nested(place, {"record": {"window": window}, "initial": "free"}))
        return merged({}, *lines)

    def _clock(self, part: str, name: str, factor: float) -> Change:
        records = (((*p, "record"), x.get("record") or {}) for p, x in sections(self._data))
        lines: Entries = {}
        for place, owner in columns(self._data, name) if name else records:
            if isinstance(time := owner.get("time"), dict):
                key, times = ("rate", 1.0 / factor) if "rate" in time else ("scale", factor)
                new = nested((*place, "time", key), rounded(time.get(key, 1.0) * times, 6))
                lines = merged(lines, new)
        whose = f"of {name}" if name else "of the record"
        words = f"a clock {whose} whose times are {factor:.6g} times what it shows"
        return Change(part, words, lines)

    def _model(self, entries: Entries) -> Entries:
        given = self._data.get("model", {})
        return {"model": {**({"name": given} if isinstance(given, str) else {}), **entries}}

    # The rig.

    def _physics(self) -> Iterator[Change]:
        sizes, roles = self.sizes, self.job.problem.model.roles
        each = [lack for lack in edits.lacks(roles) if lack.parameter in sizes]
        for lack in sorted(each, key=lambda lack: not lack.name.startswith("friction")):
            drags = lack.name.startswith("drag")
            kind = OTHER_LAW if drags else COULOMB if lack.dry else LINEAR
            size = sizes[lack.parameter] * (DRAG_MARGIN if drags else 1.0)
            shares = np.geomspace(*SOUGHT_SIZES, DRIVEN_STARTS if self._driven else FREE_STARTS)
            starts = tuple({lack.parameter: size * share} for share in shares.tolist())
            priors = {lack.parameter: uniform(size)}
            yield replace(_physics(lack.name, lack.words, priors, kind), starts=starts)
        dry = [i for i in roles.inertias if f"friction_{i.name}" in {lack.name for lack in each}]
        if len(dry) == 2:
            priors = {i.sliding: uniform(sizes[i.sliding]) for i in dry}
            yield _physics(BOTH, f"dry friction {dry[0].at} and {dry[1].at}", priors)
        for i in roles.inertias:
            largest = self.speeds.get(i.name, 0.0)
            if i.static and i.sliding in sizes and largest > 0:
                fading = log_uniform(SLOWEST * largest, largest)
                priors = {i.static: uniform(sizes[i.sliding]), i.fading: fading}
                part = _physics(f"static_{i.name}", f"friction at rest {i.at}", priors)
                yield replace(part, neutral=NOTHING, lacks=(), needs=i.sliding)
            if self._offered(i.efficiency) and self._passes_on(i):
                words = f"friction of the gear {i.at}, which grows with the load"
                priors = {i.efficiency: uniform(1.0, MIN_EFFICIENCY)}
                part = _physics(f"load_friction_{i.name}", words, priors, OTHER_LAW)
                yield replace(part, neutral={i.efficiency: 1.0})

    def _offered(self, *names: str) -> bool:
        model = self.job.problem.model
        return all(names) and {*names} <= {*model.offers} - {*model.parameters}

    def _passes_on(self, inertia: InertiaRoles) -> bool:
        """Tell whether a load is behind its gear, and nothing that turns with it rubs elsewhere."""
        model = self.job.problem.model
        roles, has = model.roles, {*model.parameters}
        alike = [i for i in roles.inertias if i.speed == inertia.speed and i is not inertia]
        ends = {end for shaft in roles.shafts for end in shaft.ends if shaft.stiffness in has}
        behind = any(i.name in ends or i.weight in has for i in alike)
        return behind and not any({i.sliding, i.efficiency} & has for i in alike)

    def _inertias(self) -> Iterator[Change]:
        """Yield one more inertia on a spring at each: one that the rig offers, or that a train takes."""
        model = self.job.problem.model
        pairs = itertools.permutations(model.roles.inertias, 2)
        for shaft, (new, other) in itertools.product(model.roles.shafts, pairs):
            joined = {new.name, other.name} == {*shaft.ends}
            if joined and self._offered(shaft.stiffness, new.inertia):
                alike = (i for i in model.roles.inertias if i.speed == other.speed)
                host = next((i for i in alike if i.name in self.weights), None)
                if host is not None:
                    yield self._inertia(host, (new.inertia, shaft.stiffness, shaft.damping), {})
        given = self._data.get("model", {})
        if "inertias" not in given:
            return
        for at in model.roles.inertias:
            if at.name in self.weights and at.reduction == 1.0:
                new_name, spring = f"{at.name}_end", f"{at.name}_end_spring"
                names = (f"{at.inertia.split('_')[0]}_{new_name}", f"k_{spring}", f"c_{spring}")
                lines = self._model({"inertias": [*given["inertias"], new_name]})
                lines = merged(lines, nested(("model", "shafts", spring), [at.name, new_name]))
                starts = ((p, x.get("initial")) for p, x in sections(self._data))
                for place, start in ((p, x) for p, x in starts if isinstance(x, dict)):
                    for state in (x for x in (at.angle, at.speed) if x in start):
                        entry = (*place, "initial", f"{state.split('_')[0]}_{new_name}")
                        value = "free" if "prior" in str(start[state]) else start[state]
                        lines = merged(lines, nested(entry, value))
                yield self._inertia(at, names, lines)

    def _inertia(self, at: InertiaRoles, names: tuple[str, str, str], lines: Entries) -> Change:
        """Return an inertia on a damped spring, sought where both are the one that was found.

        It swings by itself at least once, and at most as fast as samples show.
        """
        weight, (step, longest) = self.weights[at.name] / at.reduction**2, self._span
        slow, fast = 2 * math.pi / longest, math.pi / step
        priors = (
            log_uniform(*(weight * share for share in INERTIA_RANGE)),
            log_uniform(weight * slow**2, weight * fast**2),
            uniform(2.0 * weight * math.sqrt(slow * fast)),
        )
        end_weight, rest = SOUGHT_SHARE * weight, (1.0 - SOUGHT_SHARE) * self.weights[at.name]
        host = {at.inertia: rest} if at.inertia in self.job.problem.names else {}
        starts = tuple(
            host
            | dict(
                zip(
                    names,
                    (end_weight, end_weight * w**2, SOUGHT_DAMPING * end_weight * w),
                    strict=True,
                )
            )
            for w in np.geomspace(2.0 * slow, 0.5 * fast, SOUGHT_SWINGS).tolist()
        )
        words = f"one more inertia on a spring {at.at}"
        lines = merged(lines, {"parameters": dict(zip(names, priors, strict=True))})
        return Change(f"inertia_{at.name}", words, lines, optional=names[2], starts=starts)

    # What absorbs anything.

    def _absorbing(self) -> Iterator[Change]:
        yield Change(UNKNOWN, "noise of unknown size", self._noise(remembers=False))
        yield Change(AR1, "noise that remembers", self._noise(remembers=True))
        (step, longest), roles = self._span, self.job.problem.model.roles
        rubs = {lack.name for lack in edits.lacks(roles)}
        for i in roles.inertias if MISSING not in self._data else ():
            known = i.name in self.weights and i.sliding in self.sizes
            if known and f"friction_{i.name}" in rubs:
                size = {"prior": "half_normal", "scale": rounded(QUARTER * self.sizes[i.sliding])}
                shortest = TIME_PARTS * step
                time = log_uniform(shortest, max(longest / TIME_PARTS, 2 * shortest))
                torque = {"at": i.name, "smoothness": "1/2", "size": size, "time": time}
                lines = merged({MISSING: torque}, self._shared("s_d", "tau_d"))  # one rig
                yield Change(f"{TORQUE}{i.name}", f"a missing {roles.motion.torque} {i.at}", lines)

    def _noise(self, *, remembers: bool) -> Entries:
        """Free the noise of each channel; one number of all experiments becomes one unknown."""
        lines: Entries = {}
        shared = {*self._data.get(SHARED, ())}
        for name in self._units:
            entries = [*columns(self._data, name)]
            for place, entry in entries:
                noise, sigma = entry.get("noise", "white"), entry.get("sigma")
                known = sigma if isinstance(sigma, int | float) else None
                white = (noise if isinstance(noise, str) else noise.get("name", "white")) == "white"
                if "sigma" not in entry or not (white if remembers else known):
                    continue
                if known:
                    prior = log_uniform(known / WIDER, known * WIDER) | {"start": float(known)}
                    lines = merged(lines, nested((*place, "sigma"), prior))
                    if len(entries) == 1 and place[0] != experiments.EXPERIMENTS:
                        shared.add(noise_name(name))
                        lines = merged(lines, self._shared(noise_name(name)))
                if remembers:
                    lines = merged(lines, nested((*place, "noise"), AR1))
                    if noise_name(name) in shared:
                        lines = merged(lines, self._shared(f"rho_{name}"))
        return lines


def _physics(name: str, words: str, priors: Entries, kind: int = COULOMB) -> Change:
    names = (*priors,)
    neutral = dict.fromkeys(names, 0.0)
    return Change(name, words, {"parameters": priors}, names, kind=kind, neutral=neutral)


def _largest(first: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: max(first.get(name, 0.0), other.get(name, 0.0)) for name in {**first, **other}}


def _speeds(observations: tuple[Observation, ...], full: Any) -> dict[str, float]:
    """Return the largest speed of each inertia, by its name."""
    speeds: dict[str, float] = {}
    for model, each in ((each.response.model, each) for each in observations):
        largest = np.abs(edits.state_motion(each, full)).max(axis=0).tolist()
        known = dict(zip(model.states, largest, strict=True))
        turning = [i for i in model.roles.inertias if i.speed in known]
        speeds = _largest(speeds, {i.name: known[i.speed] / i.reduction for i in turning})
    return speeds
