"""Edits of the entries of a config, each of which makes another model of the same record.

They change `data`, the entries as they are read from YAML, and return whether there was something to
change.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from bayesdrill.basics.symbols import noise_name
from bayesdrill.config.records import sources
from bayesdrill.config.resolve import experiments
from bayesdrill.config.yaml_source import Source, as_yaml

Entries = dict[str, Any]
WIDER = 10.0  # either way, of the noise that was given
AR1 = "ar1"
# What of the entry of a column says where its numbers stand and what they are.
SOURCE = ("file", "time", "column", "variable", "unit", "mask", "wraps")
OF_SENSOR = ("gain", "offset", "lag")


def sections(data: Mapping[str, Any]) -> Iterator[Entries]:
    """Yield the top of a config, and each experiment."""
    yield data  # type: ignore[misc]
    yield from (data.get(experiments.EXPERIMENTS) or {}).values()


def share(data: Entries, *names: str) -> None:
    """Make these one unknown in all experiments, where there are several."""
    if data.get(experiments.EXPERIMENTS):
        data["shared"] = [*dict.fromkeys((*data.get("shared", ()), *names))]


def rounded(value: float, digits: int = 3) -> float:
    """Round to a few digits: a config is read by people."""
    return float(f"{value:.{digits}g}")


def log_uniform(low: float, high: float) -> Entries:
    """Return a prior, as an entry of a config."""
    return {"prior": "log_uniform", "low": rounded(low), "high": rounded(high)}


def uniform(high: float, low: float = 0.0) -> Entries:
    """Return a prior between two ends, as an entry of a config."""
    return {"prior": "uniform", "low": rounded(low), "high": rounded(high)}


# Noise.


def change_noise(data: Entries, change: Callable[[Entries], bool]) -> bool:
    """Change the noise of each channel, one number of all experiments to one unknown."""
    changed = False
    top, *others = [section.get("record", {}).get("channels", {}) for section in sections(data)]
    for channels in (top, *others):
        for name, channel in channels.items():
            sigma, known = noise_name(name), isinstance(channel.get("sigma"), int | float)
            if not change(channel):
                continue
            changed = True
            if known and channels is top and not any(name in other for other in others):
                share(data, sigma)
            if channel.get("noise") == AR1 and sigma in data.get("shared", ()):
                share(data, f"rho_{name}")
    return changed


def free_noise(channel: Entries) -> bool:
    """Make the size of a channel's noise unknown, where it is known."""
    sigma = channel.get("sigma")
    if isinstance(sigma, int | float):
        channel["sigma"] = log_uniform(sigma / WIDER, sigma * WIDER) | {"start": float(sigma)}
        return True
    return False


def redden_noise(channel: Entries) -> bool:
    """Let a channel's noise remember, where it is white."""
    noise = channel.get("noise", "white")
    if (noise if isinstance(noise, str) else noise.get("name", "white")) != "white":
        return False
    free_noise(channel)
    channel["noise"] = AR1
    return True


# Columns: sensors, clocks, windows.


def columns(data: Entries, name: str) -> Iterator[Entries]:
    """Yield the entries of a channel or an input, at the top and in experiments."""
    for section in sections(data):
        every = {**(section.get("inputs") or {}), **section.get("record", {}).get("channels", {})}
        if isinstance(entry := every.get(name), dict):
            yield entry


def free_sensor(data: Entries, kind: str, name: str, prior: Entries, *, shared: bool) -> bool:
    """Give the sensor of a channel or an input an unknown `gain`, `offset` or `lag`."""
    changed, differs = False, False
    for entry in columns(data, name):
        if kind in entry:
            differs = True  # an experiment says it otherwise
        elif {"column", "variable"} & {*entry} and "derived_from" not in entry:
            entry[kind] = prior
            changed = True
    if changed and not differs and shared:
        share(data, f"{kind}_{name}")
    return changed


def turn_sign(data: Entries, name: str) -> bool:
    """Turn the sign of a column."""
    entries = [entry for entry in columns(data, name) if "derived_from" not in entry]
    if not entries or any(isinstance(entry.get("gain", 1.0), dict) for entry in entries):
        return False
    for entry in entries:
        entry["gain"] = -float(entry.get("gain", 1.0))
    return True


def exchange(data: Entries, first: str, second: str) -> bool:
    """Exchange two columns; what only one of them says cannot be exchanged by lines of a config."""
    changed = False
    for a, b in zip(columns(data, first), columns(data, second), strict=False):
        said = [key for key in (*SOURCE, "noise", *OF_SENSOR) if key in a or key in b]
        if a.get("unit") != b.get("unit"):
            said.append("sigma")
        if not {*said} <= {*a} & {*b}:
            return False
        for key in said:
            a[key], b[key] = b[key], a[key]
        changed = True
    return changed


def scale_clock(data: Entries, factor: float, name: str = "") -> bool:
    """Multiply the times of the record, or of the column `name`, by a factor."""
    owners = columns(data, name) if name else (s.get("record", {}) for s in sections(data))
    times = [owner["time"] for owner in owners if isinstance(owner.get("time"), dict)]
    for time in times:
        if "rate" in time:
            time["rate"] = rounded(time["rate"] / factor, 6)
        else:
            time["scale"] = rounded(time.get("scale", 1.0) * factor, 6)
    return bool(times)


def set_window(data: Entries, label: str, begin: float, end: float) -> None:
    """Use a stretch of an experiment alone, from an unknown state."""
    several = data.get(experiments.EXPERIMENTS)
    section = several[label] if several else data
    section["record"] = {**section.get("record", {}), "window": [begin, end]}
    section["initial"] = "free"


def free_start(data: Entries) -> bool:
    """Free the start, where it is not said state by state."""
    changed = False
    for section in sections(data):
        initial = section.get("initial", "rest" if section is data else None)
        if initial is not None and initial != "free" and not isinstance(initial, dict):
            section["initial"] = "free"
            changed = True
    return changed


# The rig.


def set_parameters(data: Entries, entries: Mapping[str, Any]) -> bool:
    """Name parameters of the rig."""
    data["parameters"] |= copy.deepcopy(dict(entries))
    return True


def set_model(data: Entries, **entries: Any) -> bool:
    """Change entries of `model:`."""
    given = data.get("model", {})
    data["model"] = {**({"name": given} if isinstance(given, str) else given), **entries}
    return True


def add_inertia(
    data: Entries, at: str, new: str, states: Mapping[str, str], entries: Mapping[str, Any]
) -> bool:
    """Add an inertia `new` to a described train, on a spring at another; it begins as that does.

    `states`: of the new inertia, each with that of the other.
    """
    model = data["model"]
    shafts = {**model.get("shafts", {}), f"{new}_spring": [at, new]}
    set_model(data, inertias=[*model["inertias"], new], shafts=shafts)
    for section in sections(data):
        initial = section.get("initial")
        if isinstance(initial, dict):
            begun = {own: initial[other] for own, other in states.items() if other in initial}
            begun = {own: "free" if "prior" in str(x) else x for own, x in begun.items()}
            section["initial"] = {**initial, **begun}
    return set_parameters(data, entries)


# Priors.


def prior_of(data: Entries, name: str) -> Entries | None:
    """Return the entry with the prior of an unknown; None where it cannot be told."""
    labels = [f"_{label}" for label in data.get(experiments.EXPERIMENTS) or {}]
    bare = next((name.removesuffix(label) for label in labels if name.endswith(label)), name)
    for known in (name, bare):
        kind, _, owner = known.partition("_")
        torque = data.get("missing_torque") or {}
        places = [
            data.get("parameters", {}).get(known),
            (data.get("quantities") or {}).get(known),
            {"s_d": torque.get("size"), "tau_d": torque.get("time")}.get(known),
            *((section.get("inputs") or {}).get(known) for section in sections(data)),
            *(entry.get(kind) for entry in columns(data, owner) if kind in OF_SENSOR),
        ]
        starts = (section.get("initial") for section in sections(data))
        given = [start for start in starts if isinstance(start, dict)]
        places += [start.get(known.removesuffix("_0")) for start in given]
        found = [entry for entry in places if isinstance(entry, dict) and "prior" in entry]
        if found:
            return found[-1]
    return None


def widen_prior(data: Entries, name: str, *, upwards: bool, positive: bool, most: float) -> bool:
    """Move one end of a prior out by its own range, of a log-uniform one by a factor of ten.

    `positive`: zero is an end for good; `most`: what it cannot exceed, as the config has it.
    """
    entry = prior_of(data, name)
    if entry is None or not {"low", "high"} <= {*entry}:
        return False
    low, high = float(entry["low"]), float(entry["high"])
    if entry["prior"] == "log_uniform":
        wider = high * WIDER if upwards else low / WIDER
    else:
        wider = high + (high - low) if upwards else low - (high - low)
        wider = max(wider, 0.0) if positive else wider
    wider = min(wider, most)
    key, before = ("high", high) if upwards else ("low", low)
    entry[key] = rounded(wider, 4)
    return not math.isclose(entry[key], before)


# What is sampled, and read.


def raise_walkers(data: Entries, unknowns: int) -> None:
    """Give as many walkers as so many unknowns want, where the config says how many there are."""
    given = (data.get("sampler") or {}).get("walkers")
    if isinstance(given, int) and given < 2 * unknowns:
        data["sampler"] = {**data["sampler"], "walkers": 2 * unknowns}


def changed_entries(before: Mapping[str, Any], after: Mapping[str, Any]) -> Entries:
    """Return what `after` has otherwise, mapping by mapping."""
    entries: Entries = {}
    for key, value in after.items():
        if key not in before or value != before[key]:
            inside = isinstance(value, dict) and isinstance(before.get(key), dict)
            entries[key] = changed_entries(before[key], value) if inside else value
    return entries


def merged(before: Mapping[str, Any], more: Mapping[str, Any]) -> Entries:
    """Return entries with `more`, which go over what stands there, mapping by mapping."""
    entries = copy.deepcopy(dict(before))
    for key, value in more.items():
        inside = isinstance(value, dict) and isinstance(entries.get(key), dict)
        entries[key] = merged(entries[key], value) if inside else value
    return entries


def as_file(
    data: Mapping[str, Any], given: Source, folder: Path, about: Sequence[str], name: str = ""
) -> str:
    """Return a config as the text of a file in `folder`, whose first lines are comments.

    It names the records of the one that was `given`, and draws what that does; `name`: of its results.
    """
    written = copy.deepcopy(dict(data))
    written.pop("output", None)
    if drawn := given.data.get("output"):
        written["output"] = drawn
    if name:
        written["name"] = name
    for section in sections(written):
        sources.rebase(section, given.path.parent, folder)
    lines = "".join(f"# {line}\n" for line in about)
    return f"{lines}{as_yaml(written)}"
