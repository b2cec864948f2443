"""What drives the rig: the inputs that its model has, with their units."""

from __future__ import annotations

from bayesdrill.basics import symbols, units
from bayesdrill.rig.models.composed import lacking, with_named
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import given_inputs
from bayesdrill.setup.config import Config
from bayesdrill.setup.consistency.collector import Collector
from bayesdrill.setup.consistency.record import check_quantity, check_series
from bayesdrill.setup.record_entries import AngleColumn, InputColumn
from bayesdrill.setup.sensor_entries import Sensed
from bayesdrill.setup.yaml_source import Place

MISSING = "this entry is missing; see `bayesdrill schema` or configs/nominal_step.yaml"
NOTHING = "nothing is not a number; write the value itself"


def check_inputs(found: Collector, config: Config, model: Model | None) -> None:
    for entry in given_inputs.ENTRIES:
        spec = getattr(config.inputs, entry)
        place: Place = ("inputs", entry)
        if isinstance(spec, InputColumn):
            found.run((*place, "unit"), units.factor, spec.unit, given_inputs.unit(entry))
            check_series(found, place, spec)
        elif spec is not None:
            check_quantity(found, place, spec, given_inputs.unit(entry))
    if model is not None and not lacking(model):
        _check_wanted(found, config, model)
    _check_angles(found, config)
    _check_holds(found, config)
    if given_inputs.measured(config) and config.initial.time is not None:
        found.add(
            ("initial", "time"),
            "with measured inputs the initial state is that of the first sample; remove this entry",
        )


def _check_wanted(found: Collector, config: Config, model: Model) -> None:
    """The model's own, and no other."""
    given = {
        name for name in config.inputs.model_fields_set if getattr(config.inputs, name) is not None
    }
    entries = [e for name in model.inputs for e in (name, given_inputs.IMPOSED.get(name, name))]
    for entry in [e for e in given_inputs.ENTRIES if e in given]:
        if entry not in entries:
            own = ", ".join(dict.fromkeys(entries)) or "none"
            with_more = _with_more(model, entry)
            also = f", or name {with_more}, with which it has it" if with_more else ""
            message = f"the model {model.name} has no such input; remove it (its own: {own}){also}"
            found.add(("inputs", entry), message)
    for name in model.inputs:
        angle = ("inputs", given_inputs.IMPOSED.get(name, name))
        none = getattr(config.inputs, given_inputs.entry(config, name)) is None
        if none and not found.spoilt(angle):
            found.add(("inputs", name), _missing(config, name))


def _with_more(model: Model, entry: str) -> str:
    """Parameters that give it such an input."""
    for name, needs in model.offers.items():
        if entry in with_named(model, (name, *needs)).inputs:
            return " and ".join((name, *needs))
    return ""


def _missing(config: Config, name: str) -> str:
    if name in config.inputs.model_fields_set:
        return NOTHING
    if name == "v":
        return MISSING
    one = symbols.INPUTS[name]
    other = (
        f" (or `{given_inputs.IMPOSED[name]}:`, the angle)" if name in given_inputs.IMPOSED else ""
    )
    return (
        f"missing: the model wants the {one.meaning}; give a number in {one.plain_unit}, or "
        f"`{{column: ..., unit: ...}}`{other}"
    )


def _check_angles(found: Collector, config: Config) -> None:
    """An angle that is imposed says all of its speed and of where it begins."""
    for name, entry in given_inputs.IMPOSED.items():
        spec = getattr(config.inputs, entry)
        if spec is None:
            continue
        if getattr(config.inputs, name) is not None:
            message = f"{name} is what it says as well; remove one of the two"
            found.add(("inputs", entry), message)
        if entry in config.initial.model_fields_set:
            message = "the angle that is imposed begins at its first sample; remove this entry"
            found.add(("initial", entry), message)
        for kind in Sensed.model_fields:
            if getattr(spec, kind) is not None:
                message = (
                    f"all else is measured against the angle that is imposed; remove this, or give "
                    f"`{name}:`, its speed"
                )
                found.add(("inputs", entry, kind), message)


def _check_holds(found: Collector, config: Config) -> None:
    every = given_inputs.measured(config).values()
    holds = {"zero" if isinstance(spec, AngleColumn) else spec.hold for spec in every}
    if len(holds) > 1:
        also = (
            "; the speed of an imposed angle is held (zero)"
            if any(isinstance(spec, AngleColumn) for spec in every)
            else ""
        )
        found.add(("inputs",), f"all measured inputs need the same `hold:`{also}")
