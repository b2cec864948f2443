"""What must hold between the entries of a config, each broken rule as a problem with its place, and
the experiment that they make where none is broken.
"""

from __future__ import annotations

from bayesdrill.basics.errors import Issue
from bayesdrill.config.consistency import record, several, unknowns, work
from bayesdrill.config.resolve import case, quantities
from bayesdrill.config.resolve.case import ResolvedExperiment
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Collector, Place, Source
from bayesdrill.rig import models


def check(
    config: Config, source: Source, spoilt: frozenset[Place], label: str = "", *, alone: bool
) -> tuple[list[Issue], ResolvedExperiment | None]:
    """Problems of a config whose entries are each valid; `spoilt` places were reported already.

    `alone`: whether there is no other experiment, so that it is known what all unknowns are called.
    """
    found = Collector(source, spoilt)
    told = [name for name in models.PARAMETERS if found.spoilt(("parameters", name))]
    model = found.run(("model", "name"), case.model, config, told)
    own = {} if model is None else unknowns.check_nominal(found, config, model)
    nominal = found.run(("nominal", "table"), quantities.nominal_table, config, own)
    resolved = None
    if model is not None:
        unknowns.check_model(found, config, model)
        rig = None
        if nominal is not None:
            rig = unknowns.check_rig(found, config, model, nominal)
        channels = record.check_channels(found, config, model)
        record.check_states(found, config, model)
        sensed = record.check_sensors(found, config, model)
        torque = unknowns.check_torque(found, config, model, sensed.sensing)
        beside = record.beside(config, channels, sensed, torque)
        every = several.names(config, model, {"": beside}) if alone else None
        work.check_counts(found, config, every)
        work.check_map(found, config, every)
        work.check_output(found, config, model, every)
        if alone:
            told = several.told(config, {"": beside})
            work.check_truth(found, config, [*config.record.channels], told)
        if nominal is not None and rig is not None and sensed.sensing is not None:
            resolved = ResolvedExperiment(
                label=label,
                config=config,
                source=source,
                model=model,
                nominal=nominal,
                numbers=rig[0],
                space=rig[1],
                channels=tuple(one for one in channels.values() if one is not None),
                entries=sensed.entries,
                declared=tuple(one for one in sensed.declared if one is not None),
                sensing=sensed.sensing,
                free=sensed.free,
                torque={name: x for name, x in torque.items() if x is not None},
                beside=beside,
            )
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
    return found.problems, None if found.problems else resolved
