"""Build changes of a config that may explain a bad fit: of columns, times, the rig, and the noise."""

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
from bayesdrill.config.building.experiments import EXPERIMENTS
from bayesdrill.config.job import Job
from bayesdrill.inference.likelihood import Observation
from bayesdrill.record.experiment import Experiment, typical_inputs
from bayesdrill.rig.models.linear import surplus_frictions
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
from bayesdrill.selection.scales import scale_entries

UNKNOWN, AR1 = NOISE
BOTH = "friction_both"
MISSING = "missing_torque"
# Names of changes of a whole rig or record; some of these changes need one of `Setting.numbers`.
START, MOMENT, GEAR, CLOCK, LATER = "free_start", "t_0", "gear", "clock", "later"
WIDENED = "prior_"  # prefix of the names of changes that widen the prior of an unknown
# Keys of a sensor in the entry of a column, and all keys that an exchange of columns swaps.
OF_SENSOR = ("gain", "offset", "lag")
OF_COLUMN = ("file", "time", "column", "variable", "unit", "mask", "wraps", "noise", *OF_SENSOR)

# A known sigma may be wrong by this factor, and the end of a log-uniform prior is moved by it.
WIDER = 10.0
MAX_LAG_SAMPLES = 20  # largest lag of a search, in samples
# With fast samples, the largest lag is the smaller of this time [s] and this fraction of the record.
MAX_LAG, LAG_SHARE = 0.1, 0.05
MAX_LAG_SHARE = 0.1  # upper limit of lags, as a fraction of the record; longer lags hide too much
GAIN_SD, SUPPLY_SD = 0.3, 0.3  # prior sds of a gain's log, and of an input's offset / typical value
QUARTER = 0.25  # prior scale of a missing torque, divided by the size of all other torques
SLOWEST = 1e-3  # smallest speed scale of static friction, divided by the largest speed
# Correlation time of a missing torque: at least 3 samples, at most the record's length / 3.
TIME_PARTS = 3.0
MIN_EFFICIENCY = 0.3  # smallest efficiency of a gear in a search
DRAG_MARGIN = 4.0  # largest drag, divided by the drag that acts as strongly as all other torques
# Largest dry friction, divided by the friction that acts as strongly as all other torques.  The root
# mean square of these torques is small in a record in which the rig mostly rests.
HOLDING = 4.0
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
# Kinds of physics, by the simulator that they need: linear, with Coulomb's law, or with another law.
# Candidates of one kind share kernels: each has all parameters of the kind, some at neutral values.
LINEAR, COULOMB, OTHER_LAW = 1, 2, 3
NOTHING: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Change:
    """A change of a model has `entries` that override those of the config; `description` describes it.

    `lacks` are the rig's parameters that the change introduces.  `requires` is a parameter that another
    change has to introduce, and `optional` an unknown that may be zero.  A change of physics has a
    `kind`, see `LINEAR`, and `neutral` values without effect.  Searches begin at `starts`.
    """

    name: str
    description: str
    entries: Entries
    lacks: tuple[str, ...] = ()
    requires: str = ""
    optional: str = ""
    kind: int = 0
    neutral: Mapping[str, float] = NOTHING
    starts: tuple[Mapping[str, float], ...] = ()

    @property
    def absorbs(self) -> bool:
        """Return whether the change absorbs any misfit without naming a cause."""
        return self.name in NOISE or self.name.startswith(TORQUE)

    @property
    def decides(self) -> frozenset[Place]:
        """Return the places in a config that the change sets; compatible changes share no place."""
        return frozenset(leaves(self.entries))


@dataclass(frozen=True)
class Setting:
    """A setting has the information from which changes of `job` are built.

    At a value in `sizes`, a parameter would act as strongly as all others.  `speeds` are the largest
    speeds of inertias, `values` the rig's parameters at the maximum.  `numbers` maps names of changes
    to the constants that they set.
    """

    job: Job
    sizes: Mapping[str, float] = NOTHING
    speeds: Mapping[str, float] = NOTHING
    values: Mapping[str, float] = NOTHING
    numbers: Mapping[str, float] = NOTHING

    @classmethod
    def from_job(cls, job: Job, values: Mapping[str, float]) -> Self:
        """Return the setting with sizes and speeds at the start or at `values`, whichever are larger."""
        space, observations = job.problem.posterior.space, job.problem.observations
        setting, inertias = cls(job), [i for i in job.problem.model.roles.inertias if i.static]
        for at in (space.start, {**space.start, **values}):
            full = space.full(space.vector(at)[None])
            sizes, speeds = edits.rig_candidates(observations, full), _speeds(observations, full)
            setting = setting.at_least(sizes, speeds)
            p = edits.rig_parameters(observations[0], full)
            shown = edits.rig_candidates(observations, full, measured=True)
            held = {i.static: HOLDING * shown[i.sliding] for i in inertias if i.sliding in shown}
            setting = setting.at_least(held, {})
        return replace(setting, values=p)

    def with_numbers(self, **numbers: float) -> Self:
        """Return the setting with further constants of changes, by name."""
        return replace(self, numbers={**self.numbers, **numbers})

    def at_least(self, sizes: Mapping[str, float], speeds: Mapping[str, float]) -> Self:
        """Return the setting with each size and speed raised to at least the given one."""
        return replace(
            self, sizes=_largest(self.sizes, sizes), speeds=_largest(self.speeds, speeds)
        )

    @cached_property
    def changes(self) -> dict[str, Change]:
        """Return all changes by name, in the order in which they are tried."""
        scales = (Change(*entries) for entries in scale_entries(self.job))
        measuring = (*scales, *self._widened(), *self._columns(), *self._times())
        changes = (*measuring, *self._physics(), *self._inertias(), *self._absorbing())
        return {change.name: change for change in changes if change.entries}

    # Properties of the job.

    @property
    def weights(self) -> dict[str, float]:
        """Return by name the value of each inertia that is a parameter of the rig."""
        inertias = self.job.problem.model.roles.inertias
        return {i.name: self.values[i.inertia] for i in inertias if i.inertia in self.values}

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
        """Return the unit of each channel."""
        return {c.name: c.unit for each in self._experiments for c in each.channels}

    @cached_property
    def _inputs(self) -> list[str]:
        names = dict.fromkeys(name for each in self._experiments for name in each.series)
        return sorted(names, key=lambda name: not self.job.problem.model.symbols[name].drives)

    @property
    def _span(self) -> tuple[float, float]:
        """Return the shortest step between samples, and the length of the longest record, in s."""
        lengths = [float(np.ptp(each.t)) for each in self._experiments]
        return min(each.dt for each in self._experiments), max(lengths)

    def _shared(self, *names: str) -> Entries:
        """Return the entry that makes `names` common to all experiments, if there are several."""
        return {SHARED: [*names]} if self._data.get(EXPERIMENTS) else {}

    # Priors whose range is too narrow.

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
        """Return the place and the entry of an unknown's prior; None if it is not found."""
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
            if name in self._units or len(self._units) > 1:  # inputs only with several channels
                yield Change(f"sign_{name}", f"the sign of {name} turned", self._turned(name))
        for name in units:
            gain = {"prior": "log_normal", "median": 1.0, "sd_log": GAIN_SD}
            yield self._sensor("gain", name, gain)
            size = rounded(self._offset_size(name))
            yield self._sensor("offset", name, {"prior": "normal", "mean": 0.0, "sd": size})

    def _exchanged(self, *names: str) -> Entries:
        """Return lines that exchange two columns; no lines if a column would have to lose a key."""
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
        lines = (nested(place, {"gain": -float(x.get("gain", 1.0))}) for place, x in entries)
        return merged({}, *lines)

    def _sensor(self, kind: str, name: str, prior: Entries) -> Change:
        entries = [*columns(self._data, name)]
        new = [place for place, x in entries if kind not in x and {"column", "variable"} & {*x}]
        lines = merged({}, *(nested((*place, kind), prior) for place in new))
        is_offset_of_channel = kind == "offset" and name in self._units
        if new and not is_offset_of_channel and not any(kind in entry for _, entry in entries):
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
                sd = SUPPLY_SD * typical_inputs(experiment)[name]
                sizes.append(sd / experiment.unit_of_input(name).factor)
        return max(sizes)

    # Times.

    @cached_property
    def _driven(self) -> bool:
        return any(np.ptp(u) > 0 for each in self._experiments for u in each.series.values())

    @cached_property
    def time_references(self) -> frozenset[str]:
        """Return names of changes that shift a channel, or all inputs, in time.

        No candidate has all of them: a channel, or inputs that change, must be the reference of time.
        """
        sensing = [observation.response.sensing for observation in self._observations]
        known = not any(each.states or each.steady for each in sensing)
        switched = known and any(x for each in self._experiments for x in each.constant.values())
        moments = {MOMENT} if self._driven or switched else set()
        return frozenset({*(f"lag_{name}" for name in self._units), *moments})

    @property
    def clocks(self) -> tuple[str, ...]:
        """Return the names of clock changes, for record and channels; none if all share one clock."""
        names = (*self._units, *self._inputs)
        timed = {n for n in names for _, entry in columns(self._data, n) if "time" in entry}
        return (CLOCK, *(f"{CLOCK}_{n}" for n in self._units if n in timed)) if timed else ()

    def _times(self) -> Iterator[Change]:
        sensing = [observation.response.sensing for observation in self._observations]
        shifted = {f"lag_{name}" for each in sensing for name in each.lags}
        shifted |= {MOMENT for each in sensing if each.delay}
        fixed = self.time_references - shifted
        pairs = [(each.dt, float(np.ptp(each.t))) for each in self._experiments]
        largest = max(max(MAX_LAG_SAMPLES * dt, min(MAX_LAG, LAG_SHARE * s)) for dt, s in pairs)
        largest = min(largest, *(MAX_LAG_SHARE * length for _, length in pairs))
        lag = uniform(largest, -largest)
        # `t_0` replaces a lag of the first input; the lag of a single channel replaces `t_0`.
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
        """Return lines that limit records to fractions of their time, and make their starts free."""
        several, lines = self._data.get(EXPERIMENTS), []
        for observation in self._observations:  # experiments that are held out do not change
            first, *_, last = observation.experiment.t.tolist()
            ends = [(1.0 - fraction) * first + fraction * last for fraction in (begin, end)]
            window = [rounded(ends[0] + later, 9), ends[1]]
            place = (EXPERIMENTS, observation.label) if several else ()
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
        lacks = [lack for lack in edits.lacks(roles) if lack.parameter in sizes]
        for lack in sorted(lacks, key=lambda lack: not lack.name.startswith("friction")):
            drags = lack.name.startswith("drag")
            kind = OTHER_LAW if drags else COULOMB if lack.dry else LINEAR
            size = sizes[lack.parameter] * (DRAG_MARGIN if drags else 1.0)
            fractions = np.geomspace(*SOUGHT_SIZES, DRIVEN_STARTS if self._driven else FREE_STARTS)
            starts = tuple({lack.parameter: size * fraction} for fraction in fractions.tolist())
            margin = HOLDING if kind == COULOMB else 1.0
            priors = {lack.parameter: uniform(size * margin)}
            yield replace(_physics(lack.name, lack.description, priors, kind), starts=starts)
        dry = [i for i in roles.inertias if f"friction_{i.name}" in {lack.name for lack in lacks}]
        if len(dry) == 2:
            words = f"dry friction {dry[0].at} and {dry[1].at}"
            yield self._dry(BOTH, words, {i.sliding: sizes[i.sliding] for i in dry})
        for i in roles.inertias:
            yield from self._at_rest(i)
            if self._offered(i.efficiency) and self._passes_on(i):
                words = f"friction of the gear {i.at}, which grows with the load"
                priors = {i.efficiency: uniform(1.0, MIN_EFFICIENCY)}
                part = _physics(f"load_friction_{i.name}", words, priors, OTHER_LAW)
                yield replace(part, neutral={i.efficiency: 1.0})
            yield from self._by_direction(i)
        for motor in roles.motors:
            if self._offered(motor.limit):
                words = f"a largest duty cycle of the servo of {motor.words}"
                part = _physics(f"saturation_{motor.inertia}", words, {motor.limit: uniform(1.0)})
                starts = tuple({motor.limit: duty} for duty in LIMIT_STARTS)
                yield replace(part, neutral=NOTHING, lacks=(), starts=starts)
            if self._offered(motor.goal_speed) and (fastest := self._fastest(motor.goal)):
                words = f"a largest speed of the goal of {motor.words}"
                priors = {motor.goal_speed: log_uniform(SLOWEST_GOAL * fastest, fastest)}
                part = _physics(f"goal_speed_{motor.inertia}", words, priors)
                starts = tuple({motor.goal_speed: fastest * x} for x in GOAL_STARTS)
                yield replace(part, neutral=NOTHING, lacks=(), starts=starts)

    def _dry(self, name: str, words: str, sizes: Mapping[str, float]) -> Change:
        """Return dry frictions with priors up to `HOLDING` times their `sizes`, and smaller starts."""
        priors = {friction: uniform(HOLDING * size) for friction, size in sizes.items()}
        values = ([(name, size * x) for x in SLIDING_SHARES] for name, size in sizes.items())
        starts = tuple(map(dict, itertools.product(*values)))
        return replace(_physics(name, words, priors), starts=starts)

    def _at_rest(self, i: InertiaRoles) -> Iterator[Change]:
        """Yield static friction for candidates with dry friction, then a change with both frictions."""
        sizes = self.sizes
        largest = self.speeds.get(i.name, 0.0)
        if i.static not in sizes or largest == 0:
            return
        fading = log_uniform(SLOWEST * largest, largest)
        held = uniform(sizes[i.static])
        priors = {i.static: held, i.fading: fading}
        part = _physics(f"static_{i.name}", f"friction at rest {i.at}", priors)
        yield replace(part, neutral=NOTHING, lacks=(), requires=i.sliding)
        words = f"dry friction {i.at} with friction at rest"
        part = _physics(f"sticking_{i.name}", words, {i.sliding: held, **priors})
        speed = {i.fading: FADING_SHARE * largest}
        starts = tuple(
            {i.sliding: sizes[i.static] * a, i.static: sizes[i.static] * b, **speed}
            for a, b in itertools.product(SLIDING_SHARES, STATIC_SHARES)
        )
        yield replace(part, neutral=NOTHING, lacks=(i.sliding,), starts=starts)

    def _fastest(self, goal: str) -> float:
        """Return the largest speed of a measured goal; a jump is a ramp between two samples."""
        records = [(each.t, each.series[goal]) for each in self._experiments if goal in each.series]
        return max((float(np.abs(np.diff(u) / np.diff(t)).max()) for t, u in records), default=0.0)

    def _by_direction(self, at: InertiaRoles) -> Iterator[Change]:
        """Yield frictions that may differ backwards; the prior is the same in both directions."""
        kinds = (
            ("direction", "dry friction", at.sliding, at.sliding_back),
            ("direction_rest", "friction at rest", at.static, at.static_back),
            ("direction_damping", "viscous damping", at.damping, at.damping_back),
        )
        model = self.job.problem.model
        for name, words, forward, backward in kinds:
            surplus = surplus_frictions(model, {*self.job.problem.names, forward, backward})
            if surplus or not self._offered(backward):
                continue
            part_name, words = f"{name}_{at.name}", f"{words} {at.at} that differs by direction"
            value, size = self.values.get(forward, 0.0), self.sizes.get(forward, 0.0)
            if forward == at.sliding and size:
                part = self._dry(part_name, words, dict.fromkeys((forward, backward), size))
            elif forward == at.damping and size:
                part = _physics(part_name, words, dict.fromkeys((forward, backward), uniform(size)))
            elif value > 0:
                given = (self._prior(forward) or ((), None))[1]
                prior = given or log_uniform(value / WIDER, value * WIDER)
                starts = tuple({backward: value * factor} for factor in BACKWARD_STARTS)
                part = replace(_physics(part_name, words, {backward: prior}), starts=starts)
            else:
                continue
            yield replace(part, neutral=NOTHING, lacks=())

    def _offered(self, *names: str) -> bool:
        model = self.job.problem.model
        return all(names) and {*names} <= {*model.offers} - {*model.parameters}

    def _passes_on(self, inertia: InertiaRoles) -> bool:
        """Return whether a gear joins the inertia to a load, and no joined inertia has friction."""
        model = self.job.problem.model
        roles, has = model.roles, {*model.parameters}
        joined = [i for i in roles.inertias if i.speed == inertia.speed and i is not inertia]
        ends = {end for shaft in roles.shafts for end in shaft.ends if shaft.stiffness in has}
        loaded = any(i.name in ends or i.weight in has for i in joined)
        return loaded and not any({i.sliding, i.efficiency} & has for i in joined)

    def _inertias(self) -> Iterator[Change]:
        """Yield changes that attach an inertia by a spring, if the rig offers it or is a train."""
        model = self.job.problem.model
        pairs = itertools.permutations(model.roles.inertias, 2)
        for shaft, (new, other) in itertools.product(model.roles.shafts, pairs):
            joined = {new.name, other.name} == {*shaft.ends}
            if joined and self._offered(shaft.stiffness, new.inertia):
                hosts = (i for i in model.roles.inertias if i.speed == other.speed)
                host = next((i for i in hosts if i.name in self.weights), None)
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
        """Return the change that attaches a further inertia by a damped spring.

        Its period on this spring is at least two samples and at most the length of the record.
        """
        weight, (step, longest) = self.weights[at.name] / at.reduction**2, self._span
        slow, fast = 2 * math.pi / longest, math.pi / step
        priors = (
            log_uniform(*(weight * fraction for fraction in INERTIA_RANGE)),
            log_uniform(weight * slow**2, weight * fast**2),
            uniform(2.0 * weight * math.sqrt(slow * fast)),
        )
        end_weight, remaining = SOUGHT_SHARE * weight, (1.0 - SOUGHT_SHARE) * self.weights[at.name]
        host = {at.inertia: remaining} if at.inertia in self.job.problem.names else {}
        starts = []
        for w in np.geomspace(2.0 * slow, 0.5 * fast, SOUGHT_SWINGS).tolist():
            values = (end_weight, end_weight * w**2, SOUGHT_DAMPING * end_weight * w)
            starts.append(host | dict(zip(names, values, strict=True)))
        words = f"one more inertia on a spring {at.at}"
        lines = merged(lines, {"parameters": dict(zip(names, priors, strict=True))})
        return Change(f"inertia_{at.name}", words, lines, optional=names[2], starts=tuple(starts))

    # Changes that absorb any misfit.

    def _absorbing(self) -> Iterator[Change]:
        yield Change(UNKNOWN, "noise of unknown size", self._noise(remembers=False))
        yield Change(AR1, "noise that remembers", self._noise(remembers=True))
        (step, longest), roles = self._span, self.job.problem.model.roles
        lacks = {lack.name for lack in edits.lacks(roles)}
        for i in roles.inertias if MISSING not in self._data else ():
            known = i.name in self.weights and i.sliding in self.sizes
            if known and f"friction_{i.name}" in lacks:
                size = {"prior": "half_normal", "scale": rounded(QUARTER * self.sizes[i.sliding])}
                shortest = TIME_PARTS * step
                time = log_uniform(shortest, max(longest / TIME_PARTS, 2 * shortest))
                torque = {"at": i.name, "smoothness": "1/2", "size": size, "time": time}
                lines = merged({MISSING: torque}, self._shared("s_d", "tau_d"))  # common to all
                yield Change(f"{TORQUE}{i.name}", f"a missing {roles.motion.torque} {i.at}", lines)

    def _noise(self, *, remembers: bool) -> Entries:
        """Return lines that make each known sigma an unknown, and the noise AR(1) if `remembers`.

        A sigma that is given once for all experiments becomes one unknown.
        """
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
                    if len(entries) == 1 and place[0] != EXPERIMENTS:
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
    for observation in observations:
        model = observation.response.model
        largest = np.abs(edits.state_motion(observation, full)).max(axis=0).tolist()
        known = dict(zip(model.states, largest, strict=True))
        turning = [i for i in model.roles.inertias if i.speed in known]
        speeds = _largest(speeds, {i.name: known[i.speed] / i.reduction for i in turning})
    return speeds
