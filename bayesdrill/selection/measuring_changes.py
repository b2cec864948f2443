"""Build changes of how the rig is measured: priors, columns, sensors, times, and the gear."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from bayesdrill.record.experiment import typical_inputs
from bayesdrill.selection.change import CLOCK, GEAR, LATER, MOMENT, START, WIDENED, WIDER, Change
from bayesdrill.selection.config_edits import (
    Entries,
    columns,
    merged,
    nested,
    rounded,
    sections,
    uniform,
)
from bayesdrill.selection.setting import OF_SENSOR, Setting

# Keys of the entry of a column that an exchange of columns swaps.
OF_COLUMN = ("file", "time", "column", "variable", "unit", "mask", "wraps", "noise", *OF_SENSOR)
MAX_LAG_SAMPLES = 20  # largest lag of a search, in samples
# With fast samples, the largest lag is the smaller of this time [s] and this fraction of the record.
MAX_LAG, LAG_SHARE = 0.1, 0.05
MAX_LAG_SHARE = 0.1  # upper limit of lags, as a fraction of the record; longer lags hide too much
GAIN_SD, SUPPLY_SD = 0.3, 0.3  # prior sds of a gain's log, and of an input's offset / typical value


def widened_priors(setting: Setting) -> Iterator[Change]:
    """Yield wider priors of those unknowns whose prior ends where the record pulls."""
    parameters, symbols = setting.rig.parameters, setting.rig.symbols
    for part in [name for name in setting.numbers if name.startswith(WIDENED)]:
        name, way = part.removeprefix(WIDENED), int(setting.numbers[part])
        place, prior = setting.prior(name) or ((), {})
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


def changed_columns(setting: Setting) -> Iterator[Change]:
    """Yield exchanges, signs, gains and offsets of columns."""
    units = setting.units | {n: setting.rig.symbols[n].unit for n in setting.inputs}
    for pair in itertools.combinations(units, 2):
        if units[pair[0]] == units[pair[1]] and {*pair} & {*setting.units}:
            words = f"the columns of {pair[0]} and {pair[1]} exchanged"
            yield Change(f"exchange_{'_'.join(pair)}", words, _exchanged(setting, *pair))
    for name in units:
        if name in setting.units or len(setting.units) > 1:  # inputs only with several channels
            yield Change(f"sign_{name}", f"the sign of {name} turned", _turned(setting, name))
    for name in units:
        gain = {"prior": "log_normal", "median": 1.0, "sd_log": GAIN_SD}
        yield _sensor(setting, "gain", name, gain)
        size = rounded(_offset_size(setting, name))
        yield _sensor(setting, "offset", name, {"prior": "normal", "mean": 0.0, "sd": size})


def _exchanged(setting: Setting, *names: str) -> Entries:
    """Return lines that exchange two columns; no lines if a column would have to lose a key."""
    lines: Entries = {}
    for (first, a), (second, b) in zip(*(columns(setting.data, n) for n in names), strict=False):
        keys = [key for key in OF_COLUMN if key in a or key in b]
        keys += ["sigma"] if a.get("unit") != b.get("unit") else []
        if not {*keys} <= {*a} & {*b}:
            return {}
        for place, mine, other in ((first, a, b), (second, b, a)):
            new = {key: other[key] for key in keys if other[key] != mine[key]}
            lines = merged(lines, nested(place, new))
    return lines


def _turned(setting: Setting, name: str) -> Entries:
    entries = [*columns(setting.data, name)]
    if any(isinstance(entry.get("gain", 1.0), dict) for _, entry in entries):
        return {}
    lines = (nested(place, {"gain": -float(x.get("gain", 1.0))}) for place, x in entries)
    return merged({}, *lines)


def _sensor(setting: Setting, kind: str, name: str, prior: Entries) -> Change:
    entries = [*columns(setting.data, name)]
    new = [place for place, x in entries if kind not in x and {"column", "variable"} & {*x}]
    lines = merged({}, *(nested((*place, kind), prior) for place in new))
    is_offset_of_channel = kind == "offset" and name in setting.units
    if new and not is_offset_of_channel and not any(kind in entry for _, entry in entries):
        lines = merged(lines, setting.shared(f"{kind}_{name}"))
    article = "an" if kind == "offset" else "a"
    return Change(f"{kind}_{name}", f"{article} {kind} of {name}", lines)


def _offset_size(setting: Setting, name: str) -> float:
    sizes = [0.0]
    for experiment in setting.experiments:
        for channel, y in zip(experiment.channels, experiment.y.T, strict=True):
            if channel.name == name:
                sizes.append(float(np.nanstd(y)) / channel.display_unit.factor)
        if name in experiment.series:
            sd = SUPPLY_SD * typical_inputs(experiment)[name]
            sizes.append(sd / experiment.unit_of_input(name).factor)
    return max(sizes)


def changed_times(setting: Setting) -> Iterator[Change]:
    """Yield lags, delays of the inputs, clocks, and other starts; also another gear."""
    sensing = [observation.response.sensing for observation in setting.observations]
    shifted = {f"lag_{name}" for each in sensing for name in each.lags}
    shifted |= {MOMENT for each in sensing if each.delay}
    fixed = setting.time_references - shifted
    pairs = [(each.dt, float(np.ptp(each.t))) for each in setting.experiments]
    largest = max(max(MAX_LAG_SAMPLES * dt, min(MAX_LAG, LAG_SHARE * s)) for dt, s in pairs)
    largest = min(largest, *(MAX_LAG_SHARE * length for _, length in pairs))
    lag = uniform(largest, -largest)
    # `t_0` replaces a lag of the first input; the lag of a single channel replaces `t_0`.
    for name in (*(setting.units if len(fixed) > 1 else ()), *setting.inputs[1:]):
        yield _sensor(setting, "lag", name, lag)
    if len(fixed) > 1 and MOMENT in fixed and len(setting.units) > 1:
        lines = merged(nested(("inputs", MOMENT), lag), setting.shared(MOMENT))
        yield Change(MOMENT, "inputs that act later than recorded", lines)
    for part in setting.clocks:
        if (factor := setting.numbers.get(part)) is not None:
            yield _clock(setting, part, part.removeprefix(CLOCK).removeprefix("_"), factor)
    starts = [(p, x.get("initial", None if p else "rest")) for p, x in sections(setting.data)]
    held = [place for place, x in starts if isinstance(x, str) and x != "free"]
    free = merged({}, *(nested((*place, "initial"), "free") for place in held))
    yield Change(START, "another state at the start", free)
    if (later := setting.numbers.get(LATER)) is not None:
        words = f"a record that begins {later:.3g} s later, from an unknown state"
        yield Change(LATER, words, setting.window(0.0, 1.0, later))
    if GEAR in setting.numbers:
        model = setting.rig
        ratio = rounded(setting.numbers[GEAR] * model.gear_ratio)
        yield Change(GEAR, "another gear", setting.model_entries({model.roles.gear: ratio}))


def _clock(setting: Setting, part: str, name: str, factor: float) -> Change:
    records = (((*p, "record"), x.get("record") or {}) for p, x in sections(setting.data))
    lines: Entries = {}
    for place, owner in columns(setting.data, name) if name else records:
        if isinstance(time := owner.get("time"), dict):
            key, times = ("rate", 1.0 / factor) if "rate" in time else ("scale", factor)
            new = nested((*place, "time", key), rounded(time.get(key, 1.0) * times, 6))
            lines = merged(lines, new)
    whose = f"of {name}" if name else "of the record"
    words = f"a clock {whose} whose times are {factor:.6g} times what it shows"
    return Change(part, words, lines)
