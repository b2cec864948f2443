"""Check what must hold between entries of a config, and build its experiments."""

from __future__ import annotations

from bayesdrill.basics.entries import unknown_keys
from bayesdrill.basics.errors import Issue
from bayesdrill.config.consistency import record, several, unknowns, work
from bayesdrill.config.resolve import case, quantities, sensors
from bayesdrill.config.resolve.case import LocalNumbers, ResolvedExperiment
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location, Source
from bayesdrill.rig.models import MODELS


def check(
    config: Config, source: Source, spoilt: frozenset[Location], label: str = ""
) -> tuple[list[Issue], ResolvedExperiment | None]:
    """Problems of a config whose entries are each valid; `spoilt` places were reported already."""
    errors, alone = IssueCollector(source, spoilt), not source.labels
    names = config.vocabulary.parameters
    spoilt_names = [name for name in names if errors.is_reported(("parameters", name))]
    model = errors.run(("model", "name"), case.build_model, config, spoilt_names)
    given_nominal = {} if model is None else unknowns.check_nominal(errors, config, model)
    nominal = errors.run(("nominal", "table"), quantities.nominal_table, config, given_nominal)
    resolved = None
    if model is not None:
        vain = unknown_keys(("name", "model"), MODELS.usable(), type(model), config.model)
        errors.add_all(("model",), vain)
        rig = None if nominal is None else unknowns.check_rig(errors, config, model, nominal)
        channels = record.check_channels(errors, config, model)
        free = sensors.free_states(config, model)
        sensor_numbers, sensing = record.check_sensors(errors, config, model, free)
        torque = unknowns.check_torque(errors, config, model, sensing)
        local_numbers = record.local_numbers(config, channels, sensor_numbers, free, torque)
        _check_own_names(errors, config, local_numbers)
        work.check_settings(errors, config)
        if alone:
            unknown = several.unknown_names(config, model, local_numbers)
            tied = [name for name, x in config.parameters.items() if quantities.is_tied(x)]
            work.check_unknown(errors, config, unknown, tied)
            several.check_truth(errors, config, {"": local_numbers})
        if nominal is not None and rig is not None and sensing is not None:
            resolved = ResolvedExperiment(
                label=label,
                config=config,
                source=source,
                model=model,
                nominal=nominal,
                rig_numbers=rig,
                channels=tuple(channel for channel in channels.values() if channel is not None),
                sensor_numbers={e: x for e, x in sensor_numbers.items() if x is not None},
                sensing=sensing,
                free_states=free,
                torque={name: x for name, x in torque.items() if x is not None},
                local_numbers=local_numbers,
            )
    message = "there is one experiment alone; remove this entry, or add `experiments:`"
    for key in ("shared", "own"):
        if getattr(config, key) and alone:
            errors.add((key,), message)
    record.check_record(errors, config)
    record.check_inputs(errors, config, model)
    work.check_simulation(errors, config)
    work.check_calibration(errors, config)
    if alone:
        work.check_identify(errors, config, unknowns.free_parameters(config, config.parameters))
    return errors.issues, None if errors.issues else resolved


def _check_own_names(errors: IssueCollector, config: Config, local: LocalNumbers) -> None:
    """Check that no quantity or formula has the name of an unknown beside the rig.

    Of several experiments these names have a label, and formulas are checked against them later.
    """
    for section in ("quantities",) if errors.source.labels else ("quantities", "derived"):
        for name in getattr(config, section):
            if name in local.numbers and not name.startswith("sigma_"):  # which is refused for any
                message = "a sensor's number, or one of noise or torque, has this name"
                errors.add((section, name), f"{message}; choose another one")
