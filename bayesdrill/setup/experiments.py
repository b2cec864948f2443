"""Several experiments in one config: each as a config of its own, with what they have in common."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayesdrill.inference.unknowns import of_label
from bayesdrill.setup.config import Config
from bayesdrill.setup.yaml_source import Place, Source

SECTIONS = ("record", "inputs", "initial")  # which an experiment may have of its own
EXPERIMENTS = "experiments"
WHOSE = ("shared", "own")  # of what the experiments have in common, or each for itself


@dataclass(frozen=True, slots=True)
class View:
    """One experiment: `label` is its name, empty where there is only one."""

    label: str
    config: Config
    source: Source


def views(config: Config, source: Source) -> tuple[View, ...]:
    """Of a config that is valid."""
    if not config.experiments:
        return (View("", config, source),)
    return tuple(
        View(label, Config.model_validate(own.data), own) for label, own in split(source).items()
    )


def split(source: Source) -> dict[str, Source]:
    """Of a config with experiments, what each reads as if it were alone; by name."""
    named = source.data.get(EXPERIMENTS)
    if not isinstance(named, Mapping):
        return {}
    return {
        label: _alone(source, label, own)
        for label, own in named.items()
        if isinstance(own, Mapping)  # what is none is told of by its own entry
    }


def bare(source: Source) -> Source:
    """Of a config whose experiments are none: what else it says."""
    return _alone(source, "", {})


def together(source: Source, alone: Mapping[str, Source]) -> dict[str, Any]:
    """The config of all: at its top the first experiment, and under each name all that is its own."""
    named = source.data[EXPERIMENTS]
    named = dict(named) if isinstance(named, Mapping) else named
    first = next(iter(alone.values()), source)
    for label, own in alone.items():
        named[label] = {**named[label], **{k: own.data[k] for k in SECTIONS if k in own.data}}
    kept = {key: source.data[key] for key in WHOSE if key in source.data}
    return {**first.data, EXPERIMENTS: named, **kept}


def of(config: Config, label: str) -> Config:
    """The config of one experiment, of one that is `together`."""
    if not label:
        return config
    data = config.model_dump(exclude_unset=True, exclude={EXPERIMENTS, *WHOSE, *SECTIONS})
    own = config.experiments[label].model_dump(exclude_unset=True, include=set(SECTIONS))
    return Config.model_validate(data | own)


def held_out(config: Config) -> list[str]:
    """Names of experiments that are no evidence."""
    return [label for label, one in config.experiments.items() if one.held_out]


def common_or_own(config: Config, name: str, label: str) -> str:
    """What an unknown of one experiment is called among those of all."""
    return name if name in config.shared else of_label(name, label)


def _alone(source: Source, label: str, own: Mapping[str, Any]) -> Source:
    data = {k: v for k, v in source.data.items() if k not in (EXPERIMENTS, *WHOSE)}
    data = copy.deepcopy(data)
    for section in [name for name in SECTIONS if name in own]:
        data[section] = _over(data.get(section), own[section])
    lines, moved = dict(source.lines), dict[Place, Place]()
    prefix: Place = (EXPERIMENTS, label)
    for place, line in source.lines.items():
        if place[:2] == prefix and len(place) > 2:
            lines[place[2:]], moved[place[2:]] = line, place
    return dataclasses.replace(source, data=data, lines=lines, repeated=(), moved=moved)


def _over(common: Any, own: Any) -> Any:
    """`own` entries in the place of common ones, mapping by mapping."""
    if not (isinstance(common, Mapping) and isinstance(own, Mapping)):
        return copy.deepcopy(own)
    if _chosen(own) and _chosen(common) != _chosen(own):
        return copy.deepcopy(own)  # another kind of entry: nothing of the common one fits
    merged = {key: value for key, value in common.items() if key not in own}
    return {**merged, **{key: _over(common.get(key), value) for key, value in own.items()}}


def _chosen(entry: Mapping[str, Any]) -> str:
    """Which kind a number or column is, where it says so."""
    return next((key for key in ("prior", "value", "rate") if key in entry), "")
