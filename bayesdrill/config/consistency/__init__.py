"""Check what must hold between the entries of a config, and build the experiment from them.

Each broken rule is an issue with its location.
"""

from __future__ import annotations

from collections.abc import Sequence

from bayesdrill.basics.errors import Issue
from bayesdrill.config.consistency import record, several, unknowns, work
from bayesdrill.config.resolve import case, quantities
from bayesdrill.config.resolve.case import ResolvedExperiment
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location, Source
from bayesdrill.rig.models.drive_parts import PartsError
from bayesdrill.rig.models.linear import Model


def _model(errors: IssueCollector, config: Config, spoilt_names: Sequence[str]) -> Model | None:
    """The model with what is named of what it offers, of which not all may go together."""
    try:
        return case.build_model(config, spoilt_names)
    except PartsError as error:
        for entry, message in error.entries:
            errors.add(("model", entry), message)
    except ValueError as error:
        errors.add(("model", "name"), str(error))
    return None


def check(
    config: Config, source: Source, spoilt: frozenset[Location], label: str = "", *, alone: bool
) -> tuple[list[Issue], ResolvedExperiment | None]:
    """Problems of a config whose entries are each valid; `spoilt` places were reported already.

    `alone`: whether there is no other experiment, so that it is known what all unknowns are called.
    """
    errors = IssueCollector(source, spoilt)
    names = config.vocabulary.parameters
    spoilt_names = [name for name in names if errors.is_reported(("parameters", name))]
    model = _model(errors, config, spoilt_names)
    given_nominal = {} if model is None else unknowns.check_nominal(errors, config, model)
    nominal = errors.run(("nominal", "table"), quantities.nominal_table, config, given_nominal)
    resolved = None
    if model is not None:
        unknowns.check_model(errors, config, model)
        rig = None
        if nominal is not None:
            rig = unknowns.check_rig(errors, config, model, nominal)
        channels = record.check_channels(errors, config, model)
        record.check_states(errors, config, model)
        sensed = record.check_sensors(errors, config, model)
        torque = unknowns.check_torque(errors, config, model, sensed.sensing)
        local_numbers = record.local_numbers(config, channels, sensed, torque)
        unknown_names = several.unknown_names(config, model, {"": local_numbers}) if alone else None
        work.check_counts(errors, config, unknown_names)
        work.check_map(errors, config, unknown_names)
        work.check_output(errors, config, model, unknown_names)
        if alone:
            truth_names = several.truth_names(config, {"": local_numbers})
            work.check_truth(errors, config, [*config.record.channels], truth_names)
        if nominal is not None and rig is not None and sensed.sensing is not None:
            resolved = ResolvedExperiment(
                label=label,
                config=config,
                source=source,
                model=model,
                nominal=nominal,
                rig_numbers=rig[0],
                space=rig[1],
                channels=tuple(channel for channel in channels.values() if channel is not None),
                sensor_entries=sensed.entries,
                sensor_numbers=tuple(number for number in sensed.numbers if number is not None),
                sensing=sensed.sensing,
                free_states=sensed.free_states,
                torque={name: x for name, x in torque.items() if x is not None},
                local_numbers=local_numbers,
            )
    for key in ("shared", "own"):
        if getattr(config, key) and alone:
            errors.add(
                (key,), "there is one experiment alone; remove this entry, or add `experiments:`"
            )
    record.check_record(errors, config)
    record.check_inputs(errors, config, model)
    work.check_simulation(errors, config)
    work.check_calibration(errors, config)
    if alone:
        work.check_identify(errors, config, [""])
    return errors.issues, None if errors.issues else resolved
