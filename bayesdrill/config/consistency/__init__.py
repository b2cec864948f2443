"""What must hold between the entries of a config, each broken rule as a problem with its place."""

from __future__ import annotations

from bayesdrill.basics.errors import Issue
from bayesdrill.config.consistency import record, several, unknowns, work
from bayesdrill.config.consistency.several import check_experiments
from bayesdrill.config.resolve import assembly
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Collector, Place, Source
from bayesdrill.rig import models

__all__ = ["check", "check_experiments"]


def check(config: Config, source: Source, spoilt: frozenset[Place], *, alone: bool) -> list[Issue]:
    """Problems of a config whose entries are each valid; `spoilt` places were reported already.

    `alone`: whether there is no other experiment, so that it is known what all unknowns are called.
    """
    found = Collector(source, spoilt)
    told = [name for name in models.PARAMETERS if found.spoilt(("parameters", name))]
    model = found.run(("model", "name"), assembly.model, config, told)
    nominal = found.run(("nominal", "table"), assembly.nominal, config)
    if model is not None:
        unknowns.check_model(found, config, model)
        if nominal is not None:
            unknowns.check_parameters(found, config, model, nominal)
            unknowns.check_relations(found, config, model)
        unknowns.check_torque(found, config, model)
        record.check_channels(found, config, model)
        record.check_states(found, config, model)
        record.check_sensors(found, config, model)
        every = several.names(config, model, {"": config}) if alone else None
        work.check_counts(found, config, every)
        work.check_map(found, config, every)
        work.check_output(found, config, model, every)
        if alone:
            told = several.told(config, model, {"": config})
            work.check_truth(found, config, [*config.record.channels], told)
    for key in ("shared", "own"):
        if getattr(config, key) and alone:
            found.add(
                (key,), "there is one experiment alone; remove this entry, or add `experiments:`"
            )
    record.check_record(found, config)
    record.check_inputs(found, config, model)
    work.check_simulation(found, config)
    work.check_calibration(found, config)
    if alone:
        work.check_identify(found, config, [""])
    return found.problems
