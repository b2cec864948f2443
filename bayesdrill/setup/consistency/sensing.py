"""What is said of sensors and of the start, entry by entry."""

from __future__ import annotations

from bayesdrill.basics import units
from bayesdrill.basics.symbols import INPUTS
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import sensors
from bayesdrill.setup.config import Config
from bayesdrill.setup.consistency.collector import Collector
from bayesdrill.setup.experiment_entries import InputQuantity
from bayesdrill.setup.sensor_entries import Sensed


def check_sensors(found: Collector, config: Config, model: Model) -> None:
    for entry in sensors.entries(config, model):
        if entry.kind != "offset" or getattr(entry.spec, "unit", None) or _fits(entry):
            found.run(entry.place, sensors.declared, entry)
    found.run(("inputs",), sensors.sensing, config, model)
    names = [entry.name for entry in sensors.entries(config, model)]
    names += [sensors.state_name(name) for name in sensors.free_states(config, model)]
    for name in config.quantities:
        if name in names:
            found.add(("quantities", name), "a sensor's number has this name; choose another one")
    _check_derived(found, config)
    _check_constant(found, config)
    if config.initial.state == "steady":
        _check_steady(found, config, model)


def _fits(entry: sensors.Entry) -> bool:
    """Whether its column has a unit that can be; else that is said of the column."""
    try:
        units.factor(entry.unit, entry.si)
    except ValueError:
        return False
    return True


def _check_derived(found: Collector, config: Config) -> None:
    for name, spec in config.record.channels.items():
        for kind in Sensed.model_fields if spec.derived_from is not None else ():
            if getattr(spec, kind) is not None:
                message = (
                    f"{name} is derived from {spec.derived_from}, and no evidence; remove this"
                )
                found.add(("record", "channels", name, kind), message)


def _check_constant(found: Collector, config: Config) -> None:
    for name in INPUTS:
        spec = getattr(config.inputs, name)
        if isinstance(spec, InputQuantity) and spec.gain is not None and spec.value == 0:
            message = "a gain of nothing changes nothing; give `offset:`, or another value"
            found.add(("inputs", name, "gain"), message)


def _check_steady(found: Collector, config: Config, model: Model) -> None:
    """The inputs give all but where the angles begin."""
    if model.frictions:
        message = (
            "where a rig that rubs turns steadily, or sticks, is not worked out; write "
            "`initial: free`, or the states there"
        )
        found.add(("initial",), message)
        return
    named = [name for name in model.states if name in config.initial.model_fields_set]
    angles = [name for name in named if vocabulary.STATES[name].unit == "rad"]
    for name in named:
        if name not in angles:
            message = "the steady state gives it; remove this entry, or `state: steady`"
            found.add(("initial", name), message)
    for name in angles[1:]:
        message = (
            f"the steady state gives the twist, and {angles[0]} the rest; remove one of the two"
        )
        found.add(("initial", name), message)
