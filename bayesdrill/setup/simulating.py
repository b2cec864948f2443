"""Records made from a config: exact response at given parameters, and noise with a seed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import own_files, seeds
from bayesdrill.basics.errors import InputError
from bayesdrill.record.experiment import Experiment, frozen, times
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.response import Response
from bayesdrill.setup import build, number_objects, reading, writing
from bayesdrill.setup.config import Config
from bayesdrill.setup.yaml_source import Source

Array = NDArray[np.float64]


def simulate(config: Config, source: Source, seed: int, target: Path | None = None) -> str:
    """A record as text that the config itself reads, from `target` or by default its own record.

    Times and measured inputs are those of the config's `simulation:` grid, or else of its record.
    True values are nominal, or the config's fixed ones, unless `simulation:` names them; what is
    tied follows from them.
    """
    writing.check_form(config, source, target)
    experiment = grid(config, source)
    rig = build.model(config)
    measured = build.channels(config, rig)
    values = truth(config, rig)
    signals = Response(rig, experiment).signals(np.array([[values[p] for p in rig.parameters]]))[0]
    noise = build.noise([_known(config, source, entry) for entry in measured], len(signals))
    own = np.array([[unknown.start for unknown in noise.unknowns]])
    noisy = noise.draw(signals[None], own, seeds.stream(seed, "record"))[0]
    y = noisy / np.array([entry.factor for entry in measured])
    return writing.as_text(config, source, experiment, y)


def save(text: str, target: Path, record: Path, *, force: bool) -> None:
    """Never over `record`, which the config names: that may be what was measured."""
    own_files.refuse_other_than_file(target)
    if target.exists():
        if record.exists() and target.samefile(record):
            message = "the record that the config names is never overwritten; give another --output"
            raise InputError.one(str(target), message)
        if not force:
            raise InputError.one(str(target), "exists already; give --force or another --output")
        header = text.partition("\n")[0].encode()
        with target.open("rb") as file:
            if file.readline(len(header) + 2).rstrip(b"\r\n") != header:
                message = "is no record with these columns, and is kept; give another --output"
                raise InputError.one(str(target), message)
    with own_files.whole(target) as path:
        path.write_text(text, encoding="utf-8")


def grid(config: Config, source: Source) -> Experiment:
    """Times and inputs, those of `simulation:` or else of the record; what was measured is no matter."""
    simulation: Any = config.simulation
    series = list(build.measured_inputs(config))
    if simulation is None or simulation.duration is None:
        return reading.read(config, source)
    if series:
        raise InputError(
            [
                source.problem(
                    ("simulation", "duration"),
                    f"the input {series[0]} is measured, so the times are those of the record; remove "
                    "`duration:` and `rate:`",
                )
            ]
        )
    rig = build.model(config)
    t = times(simulation.duration, simulation.rate)
    channels = tuple(entry.channel for entry in build.channels(config, rig))
    return Experiment(
        t=frozen(t),
        y=frozen(np.zeros((len(t), len(channels)))),
        channels=channels,
        constant=build.constant_inputs(config),
        series={},
        first_order=False,
        start=build.initial_state(config, rig),
        t_start=min(0.0, config.initial.time or 0.0),
    )


def truth(config: Config, rig: Model) -> dict[str, float]:
    """What a simulated record is made of: the parameters of `rig`, SI."""
    space = build.space(config, rig, [])
    simulation: Any = config.simulation
    named = {name: getattr(simulation, name, None) for name in rig.parameters}
    values = {**space.start, **build.compared(config), **space.fixed}
    for name, value in simulation.quantities.items() if simulation else ():
        values[name] = value * number_objects.quantity(name, config.quantities[name]).factor
    values |= {name: value for name, value in named.items() if value is not None}
    for name in rig.parameters:
        if name in space.relations and named[name] is None:
            values[name] = float(space.relations[name].value(values))
    return values


def _known(config: Config, source: Source, entry: build.Measured) -> build.Measured:
    """With the sigma of `simulation:`, where the noise is unknown."""
    if isinstance(entry.noisy.sigma, float):
        return entry
    simulation: Any = config.simulation
    name = entry.channel.name
    if simulation is None or name not in simulation.sigma:
        message = (
            f"the noise of this channel is unknown; add `simulation: {{sigma: {{{name}: ...}}}}`"
        )
        raise InputError([source.problem(("record", "channels", name, "sigma"), message)])
    sigma = float(simulation.sigma[name]) * entry.factor
    return dataclasses.replace(entry, noisy=dataclasses.replace(entry.noisy, sigma=sigma))
