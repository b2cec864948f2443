"""Simulate records from a config: the response at given parameters, with noise, as CSV text."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import seeds, units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.config.building.case import ResolvedCase, ResolvedExperiment
from bayesdrill.config.building.channels import build_noise
from bayesdrill.config.building.initial import state_name
from bayesdrill.config.building.missing_torque import latent_torque
from bayesdrill.config.records import reading, sources
from bayesdrill.config.schema.records import ChannelSpec, ColumnSpec, TimeColumn
from bayesdrill.config.yaml_source import Location
from bayesdrill.inference import step_error
from bayesdrill.inference.likelihood import observe
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.noise.mixed import noise_for_record
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, labelled_name
from bayesdrill.record.experiment import Experiment, frozen, raise_if_any, times
from bayesdrill.record.formats import format_of
from bayesdrill.record.formats.csv import check_options
from bayesdrill.record.formats.csv import table as text_table
from bayesdrill.rig.simulators import simulator

DIGITS = 9  # significant digits of the numbers in a simulated record
READ_BACK_TOLERANCE = 1e-8  # largest (error of a number read back / range of its column)


def _check_format(resolved: ResolvedExperiment, target: Path | None) -> None:
    """Raise `InputError` if the config could not read a record that is written to `target`."""
    record, source, location = resolved.config.record, resolved.source, ("record", "file")
    try:
        kind = record.format or format_of(target or sources.path_of(resolved))
        check_options(Path(), reading.csv_options(record))
    except InputError as error:
        raise source.error(location, error.problems[0].message) from None
    if kind != "csv":
        raise source.error(location, "a simulated record is text; name a .csv file")
    for column, spec in sources.file_entries(resolved.config).items():
        for entry in ("file", "time"):
            if getattr(spec, entry) is not None:
                message = "a simulated record is one file with one time; remove this entry"
                raise source.error((*column, entry), message)
        if isinstance(spec, ChannelSpec) and spec.derived_from is not None:
            message = "a simulated record has measured channels only; remove this channel"
            raise source.error((*column, "derived_from"), message)
    if record.decimate is not None:
        message = "a simulated record would be decimated again; remove this entry"
        raise source.error(("record", "decimate"), message)
    if reading.csv_options(record).header is False:
        message = "a simulated record has a header; remove this entry"
        raise source.error(("record", "header"), message)


def record_text(resolved: ResolvedExperiment, grid: Experiment, y: Array) -> str:
    """Return times, inputs and channels `y (T, K)` as CSV text, in the units of their columns."""
    columns = _columns(resolved, grid, y)
    record = reading.csv_options(resolved.config.record)
    mark = record.delimiter or (";" if record.decimal == "," else ",")
    head, body = io.StringIO(), io.StringIO()
    csv.writer(head, delimiter=mark, lineterminator="\n").writerow([name for name, _ in columns])
    np.savetxt(body, np.stack([x for _, x in columns], axis=-1), f"%.{DIGITS}g", mark)
    numbers = body.getvalue()
    if record.decimal == ",":
        numbers = numbers.replace(".", ",")
    text = "# simulated\n" * record.skip_rows + head.getvalue() + numbers
    _check_read_back(resolved, text, columns)
    return text


def _columns(resolved: ResolvedExperiment, grid: Experiment, y: Array) -> list[tuple[str, Array]]:
    """Return names and values `(T,)` of all columns, in the units of the config."""
    entries: list[tuple[Location, ColumnSpec, Array]] = []
    config, time = resolved.config, resolved.config.record.time
    if isinstance(time, TimeColumn):
        entries.append((("record", "time"), time, grid.t / units.factor(time.unit, "s")))
    for (name, spec), channel in zip(config.record.channels.items(), y.T, strict=True):
        entries.append((("record", "channels", name), spec, channel))
    for entry, spec_of_input, values in sources.inputs_as_given(config, grid):
        entries.append((("inputs", entry), spec_of_input, values))
    columns = []
    for location, column, values in entries:
        if not isinstance(column.column, str):
            message = "a simulated record is a CSV file with named columns; give a name"
            raise resolved.source.error(location, message)
        columns.append((column.column, values))
    return columns


def _check_read_back(
    resolved: ResolvedExperiment, text: str, columns: list[tuple[str, Array]]
) -> None:
    """Raise `InputError` if the text, read with the config's options, gives other columns."""
    options = reading.csv_options(resolved.config.record)
    try:
        table = text_table(sources.path_of(resolved), text, options)
        for name, values in columns:
            allowed = READ_BACK_TOLERANCE * np.ptp(values)
            if not np.allclose(table.pick(name), values, rtol=0, atol=allowed):
                raise InputError.at("", f"column {name!r} would be read back with other values")
    except InputError as error:
        first = error.problems[0].message
        message = f"this config could not read the simulated record: {first}"
        raise resolved.source.error(("record",), message) from None


def simulate(case: ResolvedCase, seed: int, target: Path | None = None) -> str:
    """Simulate the record of the only experiment; see `simulate_one`."""
    (alone,) = case.experiments
    return simulate_one(alone, seed, target)


def simulate_all(case: ResolvedCase, seed: int, output: Path | None = None) -> dict[Path, str]:
    """Return the simulated records of all experiments as text, by path.

    The path is `output`, or that of the record in the config. With several experiments, `output` is
    a folder, in which each record keeps its file name. Raises `InputError` with all mistakes.
    """
    texts, problems = dict[Path, str](), list[Issue]()
    for index, resolved in enumerate(case.experiments):
        record_path = sources.path_of(resolved)
        target = output or record_path
        if output is not None and resolved.label:
            target = output / record_path.name
        try:
            if target in texts:
                other = f"another experiment is simulated into {target} too"
                raise resolved.source.error(("record", "file"), f"{other}; give each its own file")
            texts[target] = simulate_one(resolved, seed, target, index)
        except InputError as error:
            problems += error.problems
    raise_if_any(list(dict.fromkeys(problems)))
    return texts


def simulate_one(
    resolved: ResolvedExperiment, seed: int, target: Path | None = None, index: int = 0
) -> str:
    """Return the CSV text of a simulated record that the config can read.

    `target` is the file of the record, by default the one that the config names. Times and measured
    inputs are read from this config's record unless `simulation:` has a duration. True values of
    parameters come from `truth`, and of sensors from `simulation:` or the start values of priors.
    """
    _check_format(resolved, target)
    experiment = simulation_grid(resolved)
    response = simulator(resolved.model, experiment, resolved.sensing, step_error.MAX_CHOSEN_PIECES)
    values = truth(resolved) | _sensor_truth(resolved)
    full = np.array([[values[name] for name in response.parameters]])
    signals = response.signals(full)[0]
    noisy_channels = [_with_known_sigma(resolved, entry) for entry in resolved.channels]
    noise = build_noise(noisy_channels, len(signals))
    noise = noise_for_record(noise, experiment.t, experiment.is_measured)
    acts = latent_torque(resolved.config)
    observed = observe(response, noise, torque=acts, process=resolved.torque)
    noise_values = [_noise_truth(resolved, unknown) for unknown in observed.unknowns]
    rng = seeds.stream(seed, "record", index)
    space = ParameterSpace(model=response.parameters, unknowns=observed.unknowns, fixed=values)
    noisy = observed.bind(space).draw(signals[None], np.array([noise_values]), rng)[0]
    y = noisy / np.array([entry.channel.factor for entry in resolved.channels])
    return record_text(resolved, experiment, y)


def check_target(text: str, target: Path, read: Sequence[Path], *, force: bool) -> None:
    """Raise `InputError` if `target` may not be written.

    A file of `read` is never replaced. With `force`, a record with the same header is replaced.
    """
    output_files.refuse_other_than_file(target)
    output_files.refuse_unwritable(target.parent)
    output_files.refuse_replacing(read, [target])
    if target.exists():
        if not force:
            raise InputError.at(str(target), "exists already; give --force or another --output")
        header = text.partition("\n")[0].encode()
        with target.open("rb") as file:
            if file.readline(len(header) + 2).rstrip(b"\r\n") != header:
                message = "is no record with these columns, and is kept; give another --output"
                raise InputError.at(str(target), message)


def simulation_grid(resolved: ResolvedExperiment) -> Experiment:
    """Return times and inputs of `simulation:` or of the record; the channels are not used."""
    config = resolved.config
    simulation: Any = config.simulation
    series = list(config.measured_inputs)
    if simulation is None or simulation.duration is None:
        return reading.read(resolved)
    if series:
        message = f"the input {series[0]} is measured, so the times are those of the record"
        message += "; remove `duration:` and `rate:`"
        raise resolved.source.error(("simulation", "duration"), message)
    t = times(simulation.duration, simulation.rate)
    channels = tuple(entry.channel for entry in resolved.channels)
    return Experiment(
        t=frozen(t),
        y=frozen(np.zeros((len(t), len(channels)))),
        channels=channels,
        constant=resolved.constant_inputs,
        series={},
        first_order=False,
        start=resolved.initial_state,
        t_start=min(0.0, config.initial.time or 0.0),
        input_symbols=dict(config.vocabulary.inputs),
    )


def truth(resolved: ResolvedExperiment) -> dict[str, float]:
    """Return the true parameters in SI: from `simulation:`, else fixed, nominal or start values."""
    rig, space = resolved.model, resolved.rig_numbers.space()
    simulation: Any = resolved.config.simulation
    named = {name: simulation and simulation.get(name) for name in rig.parameters}
    named |= {n: x for n in rig.parameters if (x := _given_truth(resolved, n)) is not None}
    values = {**space.start, **resolved.nominal.compared, **space.fixed}
    for name, value in simulation.quantities.items() if simulation else ():
        values[name] = value * resolved.rig_numbers.quantities[name].factor
    values |= {name: value for name, value in named.items() if value is not None}
    for name in rig.parameters:
        if name in space.relations and named[name] is None:
            values[name] = float(space.relations[name].value(values))
    return values


def _sensor_truth(resolved: ResolvedExperiment) -> dict[str, float]:
    """Return true values of sensors and initial states in SI; free states are zero by default."""
    values = {state_name(name): 0.0 for name in resolved.free_states}
    factors = dict.fromkeys(values, 1.0)
    for number in resolved.sensor_numbers.values():
        values[number.name], factors[number.name] = number.start, number.factor
    given_values = {name: _given_truth(resolved, name) for name in values}
    return values | {name: x * factors[name] for name, x in given_values.items() if x is not None}


def _noise_truth(resolved: ResolvedExperiment, unknown: Unknown) -> float:
    """Return the true value of a noise unknown from `simulation.truth`, else its start value."""
    value = _given_truth(resolved, unknown.name)
    low, high = unknown.between or (unknown.prior.low, unknown.prior.high)
    if value is None or low < value < high:
        return unknown.start if value is None else value
    message = f"{value:g} is impossible; give a number between {low:g} and {high:g}"
    raise resolved.source.error(("simulation", "truth", unknown.name), message)


def _given_truth(resolved: ResolvedExperiment, name: str) -> float | None:
    """Return the value in `simulation.truth` for this experiment, else for all experiments."""
    simulation: Any = resolved.config.simulation
    values = simulation.truth if simulation else {}
    return values.get(labelled_name(name, resolved.label), values.get(name))


def _with_known_sigma(resolved: ResolvedExperiment, entry: NoisyChannel) -> NoisyChannel:
    """Return the channel with the sigma of `simulation:` if the channel's sigma is unknown."""
    if isinstance(entry.sigma, float):
        return entry
    simulation: Any = resolved.config.simulation
    name = entry.channel.name
    if simulation is None or name not in simulation.sigma:
        way_out = f"add `simulation: {{sigma: {{{name}: ...}}}}`"
        message = f"the noise of this channel is unknown; {way_out}"
        raise resolved.source.error(("record", "channels", name, "sigma"), message)
    sigma = float(simulation.sigma[name]) * entry.channel.factor
    return dataclasses.replace(entry, sigma=sigma)
