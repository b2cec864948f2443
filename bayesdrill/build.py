"""Config to objects, through the registries: the one place where names become things.

The single steps raise `ValueError` with a message for the user, and `consistency` runs them one
by one to collect all mistakes.  `problem` puts everything together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill import config as records
from bayesdrill import coordinates, symbols, units
from bayesdrill.errors import did_you_mean
from bayesdrill.experiment import Channel, Experiment
from bayesdrill.expressions import linear_combination
from bayesdrill.likelihood import Likelihood
from bayesdrill.models import MODELS
from bayesdrill.models.linear import Model
from bayesdrill.noise.gaussian import Gaussian
from bayesdrill.parameters import ParameterSpace
from bayesdrill.posterior import Posterior
from bayesdrill.priors import PRIORS, Prior
from bayesdrill.response import Response


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """All that inference needs: `symbols` of the unknowns and their nominal values (if any)."""

    posterior: Posterior
    symbols: tuple[symbols.Symbol, ...]
    nominal: Mapping[str, float]

    @property
    def experiment(self) -> Experiment:
        return self.posterior.likelihood.response.experiment

    @property
    def names(self) -> tuple[str, ...]:
        return self.posterior.space.free


@dataclass(frozen=True, slots=True)
class Measured:
    """A channel, how many SI units one unit of its column is, and its sigma: SI or a prior."""

    channel: Channel
    factor: float
    sigma: float | Prior
    sigma_start: float


def model(config: records.Config) -> Model:
    return lookup(MODELS, config.model.name, "model")(config.model.i_m)


def lookup[T](registry: Mapping[str, T], name: str, what: str) -> T:
    if name not in registry:
        raise ValueError(f"'{name}' is not a {what}{did_you_mean(name, registry)}")
    return registry[name]


def nominal(config: records.Config) -> dict[str, float]:
    """Nominal values of all parameters: those of the table, unless the config says otherwise."""
    table = lookup(symbols.NOMINAL, config.nominal.table, "nominal table")  # type: ignore[attr-defined]
    own = {name: getattr(config.nominal, name) for name in symbols.PARAMETERS}
    return {name: table.values[name] if own[name] is None else own[name] for name in table.values}


_SCALED = ("low", "high", "mean", "sd", "median", "scale")


def prior(spec: records.PriorSpec, nominal_value: float) -> Prior:
    """The prior in SI; `relative` multiplies all but the sd of a log by `nominal_value`."""
    values = spec.model_dump(exclude={"prior", "relative", "start"})
    if "low" in values and not values["low"] < values["high"]:
        raise ValueError(
            f"low {values['low']:g} is not below high {values['high']:g}; exchange or mend them"
        )
    if spec.relative:
        values = {k: v * nominal_value if k in _SCALED else v for k, v in values.items()}
    return PRIORS[spec.prior](**values)


def start(spec: records.PriorSpec, built: Prior, default: float) -> float:
    """Where the MAP search begins; raises where the prior excludes it."""
    value = default if spec.start is None else spec.start
    if not np.isfinite(built.logpdf(np.array([value]))[0]):
        what = "the nominal value" if spec.start is None else "the start"
        raise ValueError(
            f"{what} {value:g} is outside the prior ({built.describe()}); widen the prior, or give "
            "a `start:` inside it"
        )
    return value


def si(value: float | records.Quantity, unit: str) -> float:
    if isinstance(value, records.Quantity):
        return value.value * units.factor(value.unit, unit)
    return value


def measured_inputs(config: records.Config) -> dict[str, records.InputColumn]:
    every = {name: getattr(config.inputs, name) for name in symbols.INPUTS}
    return {name: spec for name, spec in every.items() if isinstance(spec, records.InputColumn)}


def constant_inputs(config: records.Config) -> dict[str, float]:
    """SI."""
    return {
        name: si(getattr(config.inputs, name), symbol.unit)
        for name, symbol in symbols.INPUTS.items()
        if name not in measured_inputs(config)
    }


def initial_state(config: records.Config, model: Model) -> dict[str, float]:
    """SI."""
    return {
        name: si(getattr(config.initial, name), symbols.STATES[name].unit) for name in model.states
    }


def measured(name: str, spec: records.ChannelSpec, states: tuple[str, ...]) -> Measured:
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot name a channel; use letters, digits and `_`")
    if spec.measures is None and name not in states:
        raise ValueError(
            f"'{name}' is not a state{did_you_mean(name, states)}; name the states it combines, for "
            "example `measures: theta_1 - theta_2`"
        )
    weights = linear_combination(spec.measures or name, states)
    found = [symbols.STATES[state] for state in weights]
    if len({symbol.unit for symbol in found}) > 1:
        listed = ", ".join(f"{symbol.name} [{symbol.unit}]" for symbol in found)
        raise ValueError(f"'{spec.measures}' adds different units: {listed}")
    first = found[0]
    factor = units.factor(spec.unit, first.unit)
    latex = first.latex if name in states else rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"
    channel = Channel(
        name=name, weights=weights, unit=first.unit, latex=latex, latex_unit=first.latex_unit
    )
    if isinstance(spec.sigma, float):
        return Measured(channel, factor, spec.sigma * factor, spec.sigma * factor)
    if spec.sigma.relative:
        raise ValueError("sigma has no nominal value; write its prior in the unit of the column")
    built = prior(spec.sigma, 1.0)
    begin = start(spec.sigma, built, float(built.quantile(np.array([0.5]))[0]))
    scaled = _rescaled(spec.sigma, factor)
    return Measured(channel, factor, prior(scaled, 1.0), begin * factor)


def _rescaled(spec: Any, factor: float) -> Any:
    changes = {
        key: getattr(spec, key) * factor for key in _SCALED if key in type(spec).model_fields
    }
    return spec.model_copy(update=changes)


def space(config: records.Config, model: Model, channels: list[Measured]) -> ParameterSpace:
    """The unknowns: free parameters in the model's order, then unknown sigmas."""
    table = nominal(config)
    priors: dict[str, Prior] = {}
    starts: dict[str, float] = {}
    fixed: dict[str, float] = {}
    for name in model.parameters:
        spec = getattr(config.parameters, name)
        if spec == "nominal":
            fixed[name] = table[name]
        elif isinstance(spec, float | int):
            fixed[name] = float(spec)
        else:
            priors[name] = prior(spec, table[name])
            starts[name] = start(spec, priors[name], table[name])
    for entry in channels:
        if not isinstance(entry.sigma, float):
            name = f"sigma_{entry.channel.name}"
            priors[name], starts[name] = entry.sigma, entry.sigma_start
    return ParameterSpace(model=model.parameters, priors=priors, fixed=fixed, start=starts)


def channels(config: records.Config, model: Model) -> list[Measured]:
    return [measured(name, spec, model.states) for name, spec in config.record.channels.items()]


def problem(config: records.Config, experiment: Experiment) -> Problem:
    """Everything, for a record already read (`recording.read`)."""
    rig = model(config)
    entries = channels(config, rig)
    unknowns = space(config, rig, entries)
    noise = Gaussian(
        n_samples=len(experiment.t),
        known={k: entry.sigma for k, entry in enumerate(entries) if isinstance(entry.sigma, float)},
        n_channels=len(entries),
    )
    charted = unknowns.free[: len(unknowns.free) - len(noise.unknown)]
    chart = rig.chart(_usual_voltage(experiment), charted, unknowns.fixed) if charted else None
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood(Response(rig, experiment), noise, unknowns),
        coordinates=coordinates.choose(config.coordinates, chart, len(charted)),
    )
    return Problem(
        posterior=posterior,
        symbols=tuple(_symbol(name, entries) for name in unknowns.free),
        nominal=nominal(config),
    )


def _symbol(name: str, entries: list[Measured]) -> symbols.Symbol:
    if name in symbols.PARAMETERS:
        return symbols.PARAMETERS[name]
    (channel,) = (e.channel for e in entries if f"sigma_{e.channel.name}" == name)
    return symbols.noise_symbol(channel.name, channel.unit, channel.latex, channel.latex_unit)


def _usual_voltage(experiment: Experiment) -> float:
    """A scale for the chart; any positive number is right, the usual voltage is best."""
    series = experiment.series.get("v", np.array([experiment.constant.get("v", 0.0)]))
    return float(np.sqrt(np.mean(series**2))) or 1.0
