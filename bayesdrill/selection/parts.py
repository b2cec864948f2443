"""Parts that a candidate model may have beside the config as given, each a cause of a bad fit."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from bayesdrill.analysis import edits
from bayesdrill.analysis.causes import NOISE, TORQUE
from bayesdrill.config.job import Job
from bayesdrill.inference.likelihood import Observation
from bayesdrill.record.experiment import Experiment, typical_inputs
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import InertiaRoles, ShaftRoles
from bayesdrill.selection import config_edits
from bayesdrill.selection.config_edits import Entries, log_uniform, rounded, uniform

UNKNOWN, AR1 = NOISE
BOTH = "friction_both"
MISSING = "missing_torque"
# Parts whose constant is sought, or that stand for all of a rig or a record.
START, MOMENT, GEAR, CLOCK, LATER = "free_start", "t_0", "gear", "clock", "later"
WIDENED = "prior_"  # begins the names of parts that widen the prior of an unknown

MAX_LAG_SAMPLES = 20  # samples: how far a lag is sought
MAX_LAG, LAG_SHARE = 0.1, 0.05  # s, of the record: how far it is sought where samples come faster
MAX_LAG_SHARE = 0.1  # of the record: no lag is sought beyond, as it would hide what it shifts
GAIN_SD, SUPPLY_SD = 0.3, 0.3  # of the log of a gain; of an input's offset, of its usual size
QUARTER = 0.25  # of what else acts: the size of a missing torque
SLOWEST = 1e-3  # of the largest speed: that over which friction at rest is lost
MIN_TIME_STEPS, TIME_PARTS = (
    3.0,
    3.0,
)  # samples, and parts of the record: the time of a missing torque
MIN_EFFICIENCY = 0.3
DRAG_MARGIN = 4.0  # times the size by which a drag would do as much as all else: speeds fall by it
# Of its size, from where to where physics is sought, and from how many starts: a rig that nothing drives
# comes to rest by friction after so many swings, and each number of them is a maximum of its own.
SOUGHT_SIZES, DRIVEN_STARTS, FREE_STARTS = (0.003, 0.8), 14, 30
INERTIA_RANGE = (0.01, 10.0)  # times the inertia that a further one is on a spring at
SOUGHT_SHARE, SOUGHT_SWINGS, SOUGHT_DAMPING = (
    0.3,
    6,
    0.05,
)  # where that is sought: of it, of its spring
MAX_DAMPING_RATIO = 1.0  # of that spring
MAX_NEW_INERTIAS = 4  # of a train: places where one more is tried
# Of physics, by what it asks of a simulator: nothing that is linear, Coulomb's law, or another law.
# Candidates of one kind have all of it, the others at numbers that do nothing: they share kernels.
LINEAR, COULOMB, OTHER_LAW = 1, 2, 3
NOTHING: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Part:
    """A thing that a candidate has: `edit` gives it to the entries of a config.

    `decides`: what of a config it decides; parts that decide the same do not go together.  `lacks`:
    parameters of the rig that it switches on; `rubs`: they change their sign with the speed; `needs`:
    parameters that another part has to have freed; `optional`: those that may be zero.  `kind`,
    `neutral`: of physics, see `LINEAR`, with the numbers at which it does nothing.  `starts`: values
    from which it is sought.
    """

    name: str
    words: str
    edit: Callable[[Entries], bool]
    decides: frozenset[str]
    lacks: tuple[str, ...] = ()
    rubs: bool = False
    needs: str = ""
    kind: int = 0
    optional: frozenset[str] = frozenset()
    neutral: Mapping[str, float] = field(default_factory=dict)
    starts: tuple[Mapping[str, float], ...] = ()

    @property
    def absorbs(self) -> bool:
        """Whether it absorbs any misfit and names no cause."""
        return self.name in NOISE or self.name.startswith(TORQUE)


@dataclass(frozen=True, slots=True)
class Setting:
    """What is known where parts of candidates of `job` are chosen.

    `sizes`: what parameters would be if they did as much as all else; `speeds`: the largest of inertias;
    `inertias`: what they are at the maximum; `numbers`: constants that some parts have, by their names.
    """

    job: Job
    sizes: Mapping[str, float] = NOTHING
    speeds: Mapping[str, float] = NOTHING
    inertias: Mapping[str, float] = NOTHING
    numbers: Mapping[str, float] = NOTHING

    @classmethod
    def from_job(cls, job: Job, values: Mapping[str, float]) -> Setting:
        """Return it with sizes and speeds at the start of the config or at `values`, the larger."""
        space, observations = job.problem.posterior.space, job.problem.observations
        setting = cls(job)
        for at in (space.start, {**space.start, **values}):
            full = space.full(space.vector(at)[None])
            sizes, speeds = edits.rig_candidates(observations, full), _speeds(observations, full)
            setting = setting.at_least(sizes, speeds)
            p = edits.rig_parameters(observations[0], full)
        weights = {i.name: p[i.inertia] for i in job.problem.model.roles.inertias if i.inertia in p}
        return dataclasses.replace(setting, inertias=weights)

    def at_least(self, sizes: Mapping[str, float], speeds: Mapping[str, float]) -> Setting:
        """Return it with sizes and speeds that are at least these."""
        sizes, speeds = _largest(self.sizes, sizes), _largest(self.speeds, speeds)
        return dataclasses.replace(self, sizes=sizes, speeds=speeds)

    def time_references(self) -> frozenset[str]:
        """Return parts that shift channels or inputs in time, of all of which one has to stay."""
        return _Parts(self).time_references

    def clocks(self) -> tuple[str, ...]:
        """Return parts that change a clock, where the record has several."""
        return _Parts(self).clocks

    def parts(self) -> dict[str, Part]:
        """Return all parts by name, in the order in which they are tried."""
        chosen = _Parts(self)
        every = (
            *chosen.widened(),
            *chosen.columns(),
            *chosen.timing(),
            *chosen.physics(),
            *chosen.inertias(),
            *chosen.absorbing(),
        )
        return {part.name: part for part in every}


class _Parts:
    """Makes the parts of a `Setting`."""

    def __init__(self, setting: Setting) -> None:
        self.setting, self.numbers, problem = setting, setting.numbers, setting.job.problem
        self.data: Entries = setting.job.source.data
        self.model, self.roles = problem.model, problem.model.roles
        self.observations, self.unknowns = problem.observations, {*problem.names}
        self.experiments: list[Experiment] = [each.experiment for each in self.observations]
        self.channels = {c.name: c for each in self.experiments for c in each.channels}
        inputs = dict.fromkeys(name for each in self.experiments for name in each.series)
        self.inputs = sorted(inputs, key=lambda name: not self.model.symbols[name].drives)

    def widened(self) -> Iterator[Part]:
        """Yield wider priors of unknowns that want to be beyond an end."""
        known = self.model.symbols
        for name, way in self.numbers.items():
            if name.startswith(WIDENED):
                unknown = name.removeprefix(WIDENED)
                symbol, signed = known.get(unknown), unknown not in self.model.parameters
                edit = partial(
                    config_edits.widen_prior,
                    name=unknown,
                    upwards=way > 0,
                    positive=not signed,
                    most=symbol.at_most if symbol else np.inf,
                )
                yield Part(name, f"a wider prior of {unknown}", edit, frozenset({name}))

    # Columns.

    def columns(self) -> Iterator[Part]:
        """Yield signs, gains and offsets of channels and inputs, and columns that are exchanged."""
        units = {name: channel.unit for name, channel in self.channels.items()}
        units |= {name: self.model.symbols[name].unit for name in self.inputs}
        for first, second in itertools.combinations(units, 2):
            if units[first] == units[second] and {first, second} & {*self.channels}:
                yield Part(
                    f"exchange_{first}_{second}",
                    f"the columns of {first} and {second} exchanged",
                    partial(config_edits.exchange, first=first, second=second),
                    frozenset({f"column_{first}", f"column_{second}"}),
                )
        for name in units:
            if name in self.channels or len(self.channels) > 1:  # of one channel it is that of this
                edit = partial(config_edits.turn_sign, name=name)
                sign = f"the sign of {name} turned"
                yield Part(f"sign_{name}", sign, edit, frozenset({f"gain_{name}"}))
        for name in units:
            gain = {"prior": "log_normal", "median": 1.0, "sd_log": GAIN_SD}
            yield self._sensor("gain", name, gain)
            offset = {"prior": "normal", "mean": 0.0, "sd": rounded(self._offset_size(name))}
            yield self._sensor("offset", name, offset)

    def _sensor(self, kind: str, name: str, prior: Entries) -> Part:
        article = "an" if kind == "offset" else "a"
        edit = partial(
            config_edits.free_sensor,
            kind=kind,
            name=name,
            prior=prior,
            shared=kind != "offset" or name not in self.channels,
        )
        part = f"{kind}_{name}"
        return Part(part, f"{article} {kind} of {name}", edit, frozenset({part}))

    def _offset_size(self, name: str) -> float:
        size = 0.0
        for experiment in self.experiments:
            if name in experiment.names:
                k = experiment.names.index(name)
                spread = float(np.nanstd(experiment.y[:, k]))
                size = max(size, spread / experiment.channels[k].shown.factor)
            elif name in experiment.series:
                usual = SUPPLY_SD * typical_inputs(experiment)[name]
                size = max(size, usual / experiment.unit_of_input(name).factor)
        return size

    # Times.

    @cached_property
    def driven(self) -> bool:
        """Whether any input changes."""
        return any(np.ptp(u) > 0 for each in self.experiments for u in each.series.values())

    @cached_property
    def _inputs_tell_time(self) -> bool:
        """Whether an input changes, or is switched on where the start is known."""
        pushed = any(x for each in self.experiments for x in each.constant.values())
        sensing = [observation.response.sensing for observation in self.observations]
        known = not any(each.states or each.steady for each in sensing)
        return self.driven or (pushed and known)

    @property
    def time_references(self) -> frozenset[str]:
        """Return parts that shift a channel, or all inputs: of all of them one has to stay."""
        moments = {MOMENT} if self._inputs_tell_time else set()
        return frozenset({*(f"lag_{name}" for name in self.channels), *moments})

    def timing(self) -> Iterator[Part]:
        """Yield lags, clocks, the gear, and what is wrong with the start."""
        shifted = {f"lag_{n}" for each in self.observations for n in each.response.sensing.lags}
        delayed = any(each.response.sensing.delay for each in self.observations)
        fixed = self.time_references - shifted - ({MOMENT} if delayed else set())
        for name in self.channels if len(fixed) > 1 else ():
            yield self._sensor("lag", name, self._lag())
        for name in self.inputs[1:]:  # the first: as all, by `t_0`
            yield self._sensor("lag", name, self._lag())
        if len(fixed) > 1 and MOMENT in fixed and len(self.channels) > 1:  # of one it is its lag
            later = "inputs that act later than recorded"
            yield Part(MOMENT, later, self._delay, frozenset({MOMENT}))
        for name, factor in self.numbers.items():
            if name.startswith(CLOCK):
                yield self._clock(name.removeprefix(CLOCK).removeprefix("_"), factor)
        start = frozenset({"initial"})
        yield Part(START, "another state at the start", config_edits.free_start, start)
        if LATER in self.numbers:
            words = f"a record that begins {self.numbers[LATER]:.3g} s later, from an unknown state"
            yield Part(LATER, words, self._begin_later, start | {"window"})
        if GEAR in self.numbers:
            ratio: Entries = {self.roles.gear: rounded(self.numbers[GEAR] * self.model.gear_ratio)}
            edit = partial(config_edits.set_model, **ratio)
            yield Part(GEAR, "another gear", edit, frozenset({GEAR}))

    @property
    def clocks(self) -> tuple[str, ...]:
        """Return parts that change a clock, that of the record or of a channel, if there are several."""
        own = {n for n in (*self.channels, *self.inputs) for c in self._columns(n) if "time" in c}
        if not own:
            return ()
        return (CLOCK, *(f"{CLOCK}_{name}" for name in self.channels if name in own))

    def _columns(self, name: str) -> list[Entries]:
        return [*config_edits.columns(self.data, name)]

    def _lag(self) -> Entries:
        """Return a prior either way [s]."""
        lengths = [(each.dt, float(each.t[-1] - each.t[0])) for each in self.experiments]
        late = max(max(MAX_LAG_SAMPLES * dt, min(MAX_LAG, LAG_SHARE * s)) for dt, s in lengths)
        late = rounded(min(late, MAX_LAG_SHARE * min(s for _, s in lengths)))
        return uniform(late, -late)

    def _delay(self, data: Entries) -> bool:
        inputs = data.setdefault("inputs", {})
        if any(MOMENT in (each.get("inputs") or {}) for each in config_edits.sections(data)):
            return False
        inputs[MOMENT] = self._lag()
        config_edits.share(data, MOMENT)
        return True

    def _clock(self, name: str, factor: float) -> Part:
        whose = f"of {name}" if name else "of the record"
        words = f"a clock {whose} whose times are {factor:.6g} times what it shows"
        edit = partial(config_edits.scale_clock, factor=factor, name=name)
        part = f"{CLOCK}_{name}" if name else CLOCK
        return Part(part, words, edit, frozenset({part}))

    def _begin_later(self, data: Entries) -> bool:
        for observation in self.observations:
            t = observation.experiment.t
            begin = float(t[0]) + self.numbers[LATER]
            config_edits.set_window(data, observation.label, rounded(begin, 9), float(t[-1]))
        return True

    # The rig.

    def physics(self) -> Iterator[Part]:
        """Yield physics that the rig offers and has not."""
        sizes = self.setting.sizes
        each = {lack.name: lack for lack in edits.lacks(self.roles) if lack.parameter in sizes}
        for lack in sorted(each.values(), key=lambda lack: not lack.name.startswith("friction")):
            kind = LINEAR if not lack.dry else COULOMB
            kind = OTHER_LAW if lack.name.startswith("drag") else kind
            size = sizes[lack.parameter] * (DRAG_MARGIN if kind == OTHER_LAW else 1.0)
            part = self._physics(lack.name, lack.words, {lack.parameter: uniform(size)}, kind=kind)
            shares = np.geomspace(*SOUGHT_SIZES, DRIVEN_STARTS if self.driven else FREE_STARTS)
            starts = tuple({lack.parameter: size * share} for share in shares.tolist())
            yield dataclasses.replace(part, starts=starts)
        dry = [i for i in self.roles.inertias if f"friction_{i.name}" in each]
        if len(dry) == 2:
            priors = {i.sliding: uniform(sizes[i.sliding]) for i in dry}
            yield self._physics(BOTH, f"dry friction {dry[0].at} and {dry[1].at}", priors)
        for i in (i for i in self.roles.inertias if i.static and i.sliding in sizes):
            if (largest := self.setting.speeds.get(i.name, 0.0)) > 0:
                static = uniform(sizes[i.sliding])
                priors = {i.static: static, i.fading: log_uniform(SLOWEST * largest, largest)}
                words = f"friction at rest {i.at}"
                part = self._physics(f"static_{i.name}", words, priors)
                yield dataclasses.replace(part, neutral={}, lacks=(), needs=i.sliding)
        for i in self.roles.inertias:
            if self._offered(i.efficiency) and self._passes_on(i):
                words = f"friction of the gear {i.at}, which grows with the load"
                prior = {i.efficiency: uniform(1.0, MIN_EFFICIENCY)}
                part = self._physics(f"load_friction_{i.name}", words, prior, kind=OTHER_LAW)
                yield dataclasses.replace(part, neutral={i.efficiency: 1.0})

    def _physics(
        self, name: str, words: str, priors: Mapping[str, Entries], *, kind: int = COULOMB
    ) -> Part:
        edit, names = partial(config_edits.set_parameters, entries=priors), (*priors,)
        neutral = dict.fromkeys(names, 0.0)
        rubs = kind != LINEAR
        return Part(
            name, words, edit, frozenset(names), names, rubs=rubs, kind=kind, neutral=neutral
        )

    def _offered(self, *names: str) -> bool:
        offered = {*self.model.offers} - {*self.model.parameters}
        return all(names) and {*names} <= offered

    def _passes_on(self, inertia: InertiaRoles) -> bool:
        """Tell whether nothing that turns with it rubs at another place, and a spring is behind it."""
        has = {*self.model.parameters}
        alike = [i for i in self.roles.inertias if i.speed == inertia.speed and i is not inertia]
        ends = {end for shaft in self.roles.shafts for end in shaft.ends if shaft.stiffness in has}
        behind = any(i.name in ends or i.weight in has for i in alike)
        return behind and not any({i.sliding, i.efficiency} & has for i in alike)

    def inertias(self) -> Iterator[Part]:
        """Yield one more inertia on a spring at each: one that the rig offers, or that a train takes."""
        weights = self.setting.inertias
        for shaft in self.roles.shafts:
            ends = [self.roles.inertia(name) for name in shaft.ends if name != "ground"]
            new = [end for end in ends if self._offered(shaft.stiffness, end.inertia)]
            if len(new) == 1 and (host := self._host(shaft, new[0])) is not None:
                names = (new[0].inertia, shaft.stiffness, shaft.damping)
                entries = self._on_spring(weights[host.name] / host.reduction**2, names)
                edit = partial(config_edits.set_parameters, entries=entries)
                yield self._inertia(host, edit, names)
        if not (self.model.has_private_names and isinstance(self.data.get("model"), dict)):
            return
        free = [i for i in self.roles.inertias if i.name in weights and i.reduction == 1.0]
        for at in free[:MAX_NEW_INERTIAS]:
            new_name = f"{at.name}_end"
            letters = [name.removesuffix(at.name) for name in (at.inertia, f"k_{at.name}")]
            names = (f"{letters[0]}{new_name}", f"k_{new_name}_spring", f"c_{new_name}_spring")
            begun = {
                f"{state.split('_', 1)[0]}_{new_name}": state for state in (at.angle, at.speed)
            }
            entries = self._on_spring(weights[at.name], names)
            edit = partial(
                config_edits.add_inertia, at=at.name, new=new_name, states=begun, entries=entries
            )
            yield self._inertia(at, edit, names)

    def _host(self, shaft: ShaftRoles, new: InertiaRoles) -> InertiaRoles | None:
        """Return the inertia of this rig at the other end of a shaft."""
        other = next(name for name in shaft.ends if name != new.name)
        speed = self.roles.inertia(other).speed
        alike = (
            i for i in self.roles.inertias if i.speed == speed and i.name in self.setting.inertias
        )
        return next(alike, None)

    @cached_property
    def _swings(self) -> tuple[float, float]:
        """The slowest and the fastest angular frequency that the record shows."""
        longest = max(float(each.t[-1] - each.t[0]) for each in self.experiments)
        return 2 * math.pi / longest, math.pi / min(each.dt for each in self.experiments)

    def _on_spring(self, weight: float, names: tuple[str, str, str]) -> Entries:
        """Return priors of an inertia, of its spring, and of the damping there."""
        (slow, fast), (low, high) = self._swings, (weight * share for share in INERTIA_RANGE)
        damping = 2.0 * MAX_DAMPING_RATIO * weight * math.sqrt(slow * fast)
        priors = (log_uniform(low, high), log_uniform(weight * slow**2, weight * fast**2))
        return dict(zip(names, (*priors, uniform(damping)), strict=True))

    def _inertia(
        self, at: InertiaRoles, edit: Callable[[Entries], bool], names: tuple[str, str, str]
    ) -> Part:
        """Return the part; it is sought where both inertias together are the one that was found."""
        total = self.setting.inertias[at.name]
        own, rest = total * SOUGHT_SHARE / at.reduction**2, total * (1.0 - SOUGHT_SHARE)
        slow, fast = self._swings
        starts = tuple(
            dict(zip(names, (own, own * w**2, SOUGHT_DAMPING * own * w), strict=True))
            | ({at.inertia: rest} if at.inertia in self.unknowns else {})
            for w in np.geomspace(2.0 * slow, 0.5 * fast, SOUGHT_SWINGS).tolist()
        )
        words, what = f"one more inertia on a spring {at.at}", frozenset({"inertia"})
        damping = frozenset({names[2]})
        name = f"inertia_{at.name}"
        return Part(name, words, edit, what, optional=damping, starts=starts)

    # What absorbs anything.

    def absorbing(self) -> Iterator[Part]:
        """Yield noises, and missing torques."""
        change, noise = config_edits.change_noise, frozenset({"noise"})
        unknown = partial(change, change=config_edits.free_noise)
        memory = partial(change, change=config_edits.redden_noise)
        yield Part(UNKNOWN, "noise of unknown size", unknown, noise)
        yield Part(AR1, "noise that remembers", memory, noise)
        rubs = {lack.name for lack in edits.lacks(self.roles)}
        for i in (i for i in self.roles.inertias if f"friction_{i.name}" in rubs):
            words, edit = (
                f"a missing {self.roles.motion.torque} {i.at}",
                partial(self._torque, at=i),
            )
            yield Part(f"{TORQUE}{i.name}", words, edit, frozenset({MISSING}))

    def _torque(self, data: Entries, at: InertiaRoles) -> bool:
        if MISSING in data or at.sliding not in self.setting.sizes:
            return False
        scale = rounded(QUARTER * self.setting.sizes[at.sliding])
        size = {"prior": "half_normal", "scale": scale}
        shortest = MIN_TIME_STEPS * min(each.dt for each in self.experiments)
        longest = max(float(each.t[-1] - each.t[0]) for each in self.experiments) / TIME_PARTS
        time = log_uniform(shortest, max(longest, 2 * shortest))
        data[MISSING] = {"at": at.name, "smoothness": "1/2", "size": size, "time": time}
        config_edits.share(data, "s_d", "tau_d")  # one rig: the same lacks in each experiment
        return True


def _largest(first: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: max(first.get(name, 0.0), other.get(name, 0.0)) for name in {**first, **other}}


def _speeds(observations: tuple[Observation, ...], full: Any) -> dict[str, float]:
    """Return the largest speed of each inertia, by its name."""
    speeds: dict[str, float] = {}
    for observation in observations:
        model: Model = observation.response.model
        moved = edits.state_motion(observation, full)
        for inertia in model.roles.inertias:
            if inertia.speed in model.states:
                of_state = np.abs(moved[:, model.states.index(inertia.speed)]).max()
                largest = {inertia.name: float(of_state) / inertia.reduction}
                speeds = _largest(speeds, largest)
    return speeds
