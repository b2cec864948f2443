"""Records made from a config: exact response at given parameters, and noise with a seed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import own_files, seeds
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.inference import pieces
from bayesdrill.inference.noise.mixed import of_record
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.record.experiment import Experiment, frozen, raise_if_any, times
from bayesdrill.rig.choosing import simulator
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import (
    build,
    given_inputs,
    missing_torque,
    number_objects,
    reading,
    sensors,
    writing,
)
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiments import View, views
from bayesdrill.setup.yaml_source import Source

Array = NDArray[np.float64]


def simulate(config: Config, source: Source, seed: int, target: Path | None = None) -> str:
    """Of the only experiment; see `one`."""
    return one(View("", config, source), seed, target)


def every(config: Config, source: Source, seed: int, output: Path | None = None) -> dict[Path, str]:
    """Records of all experiments, by where they go: the files that the config names, or `output`; of
    several, files of those names in the folder `output`.  Raises `InputError` with all that is wrong.
    """
    made, problems = dict[Path, str](), list[Problem]()
    for index, view in enumerate(views(config, source)):
        own = reading.path_of(view.config, view.source)
        target = own if output is None else output / own.name if view.label else output
        try:
            if target in made:
                message = (
                    f"another experiment is simulated into {target} too; give each its own file"
                )
                raise InputError([view.source.problem(("record", "file"), message)])
            made[target] = one(view, seed, target, index)
        except InputError as error:
            problems += error.problems
    raise_if_any(list(dict.fromkeys(problems)))
    return made


def one(view: View, seed: int, target: Path | None = None, index: int = 0) -> str:
    """A record as text that the config itself reads, from `target` or by default its own record.

    Times and measured inputs are those of the config's `simulation:` grid, or else of its record.
    True values are nominal, or the config's fixed ones, unless `simulation:` names them; what is
    tied follows from them, and sensors are where their priors start.
    """
    config, source = view.config, view.source
    writing.check_form(config, source, target)
    experiment = grid(config, source)
    rig = build.model(config)
    measured = build.channels(config, rig)
    sensing = sensors.sensing(config, rig)
    response = simulator(rig, experiment, sensing, pieces.MOST)
    values = truth(config, rig, view.label) | _told(view, rig)
    full = np.array([[values[name] for name in response.parameters]])
    signals = response.signals(full)[0]
    known = [_known(config, source, entry) for entry in measured]
    noise = of_record(build.noise(known, len(signals)), experiment.t, experiment.seen)
    observed = missing_torque.observation(config, response, noise)
    own = [_true_of_noise(view, unknown) for unknown in observed.unknowns]
    rng = seeds.stream(seed, "record", index)
    space = ParameterSpace(
        model=response.parameters, unknowns=observed.unknowns, fixed=dict(values)
    )
    noisy = observed.placed(space).draw(signals[None], np.array([own]), rng)[0]
    y = noisy / np.array([entry.factor for entry in measured])
    return writing.as_text(config, source, experiment, y)


def save(text: str, target: Path, record: Path, *, force: bool) -> None:
    """See `check_place`."""
    check_place(text, target, record, force=force)
    own_files.write_text(target, text)


def check_place(text: str, target: Path, record: Path, *, force: bool) -> None:
    """Never over `record`, which the config names: that may be what was measured."""
    own_files.refuse_other_than_file(target)
    own_files.refuse_unwritable(target.parent)
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


def grid(config: Config, source: Source) -> Experiment:
    """Times and inputs, those of `simulation:` or else of the record; what was measured is no matter."""
    simulation: Any = config.simulation
    series = list(given_inputs.measured(config))
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
        constant=given_inputs.constant(config, rig),
        series={},
        first_order=False,
        start=build.initial_state(config, rig),
        t_start=min(0.0, config.initial.time or 0.0),
    )


def truth(config: Config, rig: Model, label: str = "") -> dict[str, float]:
    """What a simulated record is made of: the parameters of `rig`, SI.

    `label`: of the experiment that may have some of its own.
    """
    space = build.space(config, rig, [])
    simulation: Any = config.simulation
    named = {name: getattr(simulation, name, None) for name in rig.parameters}
    given = simulation.truth if simulation else {}
    named |= {n: x for n in rig.parameters if (x := _given(given, n, label)) is not None}
    values = {**space.start, **build.compared(config), **space.fixed}
    for name, value in simulation.quantities.items() if simulation else ():
        values[name] = value * number_objects.quantity(name, config.quantities[name]).factor
    values |= {name: value for name, value in named.items() if value is not None}
    for name in rig.parameters:
        if name in space.relations and named[name] is None:
            values[name] = float(space.relations[name].value(values))
    return values


def _told(view: View, rig: Model) -> dict[str, float]:
    """What is true of sensors and the start, SI; of a free start zero, unless it is given."""
    simulation: Any = view.config.simulation
    given = simulation.truth if simulation else {}
    free = sensors.free_states(view.config, rig)
    found = {sensors.state_name(name): 0.0 for name in free}
    factors = dict.fromkeys(found, 1.0)
    for each in (sensors.declared(entry) for entry in sensors.entries(view.config, rig)):
        found[each.name], factors[each.name] = each.start, each.factor
    own = {name: _given(given, name, view.label) for name in found}
    return found | {name: x * factors[name] for name, x in own.items() if x is not None}


def _true_of_noise(view: View, unknown: Unknown) -> float:
    """As `simulation.truth` has it, or where its search would start."""
    simulation: Any = view.config.simulation
    value = _given(simulation.truth if simulation else {}, unknown.name, view.label)
    low, high = unknown.between or (unknown.prior.low, unknown.prior.high)
    if value is None or low < value < high:
        return unknown.start if value is None else value
    message = f"{value:g} is impossible; give a number between {low:g} and {high:g}"
    raise InputError([view.source.problem(("simulation", "truth", unknown.name), message)])


def _given(values: Mapping[str, float], name: str, label: str) -> float | None:
    """That of the experiment, or of all of them."""
    return values.get(of_label(name, label), values.get(name))


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
