"""Build constant inputs, measured inputs and imposed angles."""

from __future__ import annotations

from bayesdrill.basics import units
from bayesdrill.basics.symbols import SPEED_UNITS
from bayesdrill.config.building.parsed_numbers import to_si
from bayesdrill.config.building.record import check_series
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import AngleColumn, InputColumn
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.rig.models.linear import Model, missing_requirements, with_named


def check_inputs(
    errors: IssueCollector, config: Config, model: Model | None
) -> dict[str, float | None]:
    """Check all inputs against the model; return constant inputs in SI, None for mistakes."""
    constant: dict[str, float | None] = {}
    for entry, symbol in config.vocabulary.entries.items():
        spec = config.inputs.get(entry)
        location: Location = ("inputs", entry)
        if isinstance(spec, InputColumn):
            errors.run((*location, "unit"), units.factor, spec.unit, symbol.unit)
            check_series(errors, location, spec)
        elif spec is not None:
            constant[entry] = errors.run((*location, "unit"), to_si, spec, symbol.unit)
    if model is not None and not missing_requirements(model):
        _check_required(errors, config, model)
    _check_angles(errors, config)
    _check_holds(errors, config)
    if config.measured_inputs and config.initial.time is not None:
        message = "with measured inputs the initial state is that of the first sample"
        errors.add(("initial", "time"), f"{message}; remove this entry")
    return {n: x for n, x in constant.items() if n not in config.measured_inputs}


def _check_required(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check that the config gives the inputs of the model, and no other inputs."""
    words, inputs = config.vocabulary, config.inputs
    given_entries = {n for n in inputs.model_fields_set if inputs.get(n) is not None}
    entries = [e for name in model.inputs for e in (name, words.imposed.get(name, name))]
    for entry in [e for e in words.entries if e in given_entries]:
        if entry not in entries:
            input_names = ", ".join(dict.fromkeys(entries)) or "none"
            having = ((name, *needs) for name, needs in model.offers.items())
            needed = next((n for n in having if entry in with_named(model, n).inputs), ())
            also = f", or add its parameters: {' and '.join(needed)}" if needed else ""
            message = f"the model {model.name} has no such input (its inputs: {input_names})"
            errors.add(("inputs", entry), f"{message}; remove this entry{also}")
    for name in model.inputs:
        angle = ("inputs", words.imposed.get(name, name))
        none = config.inputs.get(config.input_entry(name)) is None
        if none and not errors.is_reported(angle):
            errors.add(("inputs", name), _missing_message(config, name))


def _missing_message(config: Config, name: str) -> str:
    if name in config.inputs.model_fields_set:
        return "this entry is empty; write the value itself"
    if name == "v":
        return "this entry is missing; see `bayesdrill schema` or configs/nominal_step.yaml"
    symbol, angle = config.vocabulary.inputs[name], config.vocabulary.imposed.get(name)
    what = "angle" if symbol.unit == SPEED_UNITS["rad"] else "position"
    other = f" (or `{angle}:`, the {what})" if angle else ""
    way_out = f"give a number in {symbol.plain_unit}, or `{{column: ..., unit: ...}}`{other}"
    return f"missing: the model needs the {symbol.meaning}; {way_out}"


def _check_angles(errors: IssueCollector, config: Config) -> None:
    """Check that no entry contradicts an imposed angle, which fixes a speed and a start."""
    for name, entry in config.vocabulary.imposed.items():
        spec = config.inputs.get(entry)
        if spec is None:
            continue
        if config.inputs.get(name) is not None:
            message = f"{name} gives the same input; remove one of the two"
            errors.add(("inputs", entry), message)
        if entry in config.initial.model_fields_set:
            message = "the imposed angle starts at its first sample; remove this entry"
            errors.add(("initial", entry), message)
        for kind in numbers.SensorFields.model_fields:
            if getattr(spec, kind) is not None:
                message = f"the imposed angle is the reference, so it has no {kind}; remove this"
                errors.add(("inputs", entry, kind), f"{message}, or give `{name}:`, its speed")


def _check_holds(errors: IssueCollector, config: Config) -> None:
    specs = config.measured_inputs.values()
    angle = any(isinstance(spec, AngleColumn) for spec in specs)
    if len({"zero" if isinstance(spec, AngleColumn) else spec.hold for spec in specs}) > 1:
        also = " (`zero`, as an imposed angle requires it)" if angle else ""
        errors.add(("inputs",), f"all measured inputs need the same `hold:`{also}")
