"""Build one experiment of a config with valid entries, or collect all contradictions."""

from __future__ import annotations

from bayesdrill.basics.entries import unknown_keys
from bayesdrill.basics.errors import Issue
from bayesdrill.config.building import case
from bayesdrill.config.building.case import LocalNumbers, ResolvedExperiment
from bayesdrill.config.building.channels import check_channels
from bayesdrill.config.building.experiments import check_truth, unknown_names
from bayesdrill.config.building.initial import check_initial, free_states
from bayesdrill.config.building.inputs import check_inputs
from bayesdrill.config.building.missing_torque import check_torque
from bayesdrill.config.building.nominal import check_nominal, nominal_table
from bayesdrill.config.building.parameters import build_model, check_rig, free_parameters
from bayesdrill.config.building.parsed_numbers import is_tied
from bayesdrill.config.building.record import check_record
from bayesdrill.config.building.sensors import check_sensors
from bayesdrill.config.building.settings import (
    check_calibration,
    check_identify,
    check_settings,
    check_simulation,
    check_unknown,
)
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location, Source
from bayesdrill.rig.models import MODELS


def build_experiment(
    config: Config, source: Source, spoilt: frozenset[Location], label: str = ""
) -> tuple[list[Issue], ResolvedExperiment | None]:
    """Build an experiment of a config with valid entries; return the issues and the experiment.

    Mistakes at `spoilt` locations were reported before, and are not reported again.
    """
    errors, alone = IssueCollector(source, spoilt), not source.labels
    names = config.vocabulary.parameters
    spoilt_names = [name for name in names if errors.is_reported(("parameters", name))]
    model = errors.run(("model", "name"), build_model, config, spoilt_names)
    given_nominal = {} if model is None else check_nominal(errors, config, model)
    nominal = errors.run(("nominal", "table"), nominal_table, config, given_nominal)
    rig = sensing = None
    if model is not None:
        surplus = unknown_keys(("name", "model"), MODELS.usable(), type(model), config.model)
        errors.add_all(("model",), surplus)
        rig = None if nominal is None else check_rig(errors, config, model, nominal)
        channels = check_channels(errors, config, model)
        free, initial_state = free_states(config, model), check_initial(errors, config, model)
        sensor_numbers, sensing = check_sensors(errors, config, model, free)
        torque = check_torque(errors, config, model, sensing)
        local_numbers = case.local_numbers(config, channels, sensor_numbers, free, torque)
        _check_own_names(errors, config, local_numbers)
        check_settings(errors, config)
        if alone:
            unknown = unknown_names(config, model, local_numbers)
            tied = [name for name in names if is_tied(config.parameters.get(name))]
            check_unknown(errors, config, unknown, tied)
            check_truth(errors, config, {"": local_numbers})
    message = "this entry needs several experiments; remove it, or add `experiments:`"
    for key in ("shared", "own"):
        if getattr(config, key) and alone:
            errors.add((key,), message)
    check_record(errors, config)
    constant = check_inputs(errors, config, model)
    check_simulation(errors, config)
    check_calibration(errors, config)
    if alone:
        check_identify(errors, config, free_parameters(config, names))
    if errors.issues or model is None or nominal is None or rig is None or sensing is None:
        return errors.issues, None
    experiment = ResolvedExperiment(
        label=label,
        config=config,
        source=source,
        model=model,
        nominal=nominal,
        rig_numbers=rig,
        channels=tuple(channel for channel in channels.values() if channel is not None),
        sensor_numbers={e: x for e, x in sensor_numbers.items() if x is not None},
        sensing=sensing,
        constant_inputs={n: x for n in model.inputs if (x := constant.get(n)) is not None},
        initial_state=initial_state,
        free_states=free,
        torque={name: x for name, x in torque.items() if x is not None},
        local_numbers=local_numbers,
    )
    return [], experiment


def _check_own_names(errors: IssueCollector, config: Config, local: LocalNumbers) -> None:
    """Check that no quantity or formula has the name of an unknown of sensors, noise or torque.

    With several experiments, these names have a label, and formulas are checked later.
    """
    for section in ("quantities",) if errors.source.labels else ("quantities", "derived"):
        for name in getattr(config, section):
            if name in local.numbers and not name.startswith("sigma_"):  # another check refuses it
                message = "an unknown of a sensor, noise or torque has this name"
                errors.add((section, name), f"{message}; choose another one")
