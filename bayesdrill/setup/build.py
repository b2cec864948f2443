"""Config to objects, through the registries: the one place where names become things.

The single steps raise `ValueError` with a message for the user, and `consistency` runs them one
by one to collect all mistakes.  `problem` puts everything together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from bayesdrill.basics import symbols, units
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.expressions import linear_combination
from bayesdrill.basics.formulas import Expression, resolved
from bayesdrill.engines.optimisers import OPTIMISERS
from bayesdrill.engines.optimisers.contract import Optimiser
from bayesdrill.engines.optimisers.pairwise import circle
from bayesdrill.inference.coordinates import Coordinates
from bayesdrill.inference.likelihood import Likelihood
from bayesdrill.inference.noise.gaussian import Gaussian
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.insight.identifiability.study import Asked, Thresholds
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models import MODELS, constants
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.response import Response
from bayesdrill.setup import number_entries
from bayesdrill.setup.config import ChannelSpec, Config, InputColumn
from bayesdrill.setup.number_objects import formula, prior, quantity, relation, rescaled, start

PAIRWISE = ("pairs", "iterations", "steady")  # entries of `map:` that are for this method only


@dataclass(frozen=True, slots=True)
class Measured:
    """A channel, how many SI units one unit of its column is, and its sigma: SI or a prior."""

    channel: Channel
    factor: float
    sigma: float | Prior
    sigma_start: float


def model(config: Config) -> Model:
    """With the constants that the config gives, as far as the model has them."""
    kind = lookup(MODELS, config.model.name, "model")
    given = {name: getattr(config.model, name) for name in constants(kind)}
    return kind(**{name: value for name, value in given.items() if value is not None})


def lookup[T](registry: Mapping[str, T], name: str, what: str) -> T:
    if name not in registry:
        raise ValueError(f"'{name}' is not a {what}{did_you_mean(name, registry)}")
    return registry[name]


def nominal(config: Config) -> dict[str, float]:
    """Nominal values of all parameters: those of the table, unless the config says otherwise."""
    table = lookup(symbols.NOMINAL, _table(config), "nominal table")
    own = {name: getattr(config.nominal, name) for name in symbols.PARAMETERS}
    return {name: table.values[name] if own[name] is None else own[name] for name in table.values}


def _table(config: Config) -> str:
    return config.nominal.table or symbols.DEFAULT_NOMINAL  # type: ignore[attr-defined]


def compared(config: Config) -> dict[str, float]:
    """Nominal values that are this rig's: all of a table that the config names or relies on.

    Where the config has values of its own, or no use for a table, the table speaks of another rig.
    """
    given, table = config.nominal, nominal(config)
    own = {name for name in table if getattr(given, name) is not None}
    used = {name for name in table if _refers(getattr(config.parameters, name))}
    if given.table is not None or (used and not own):  # type: ignore[attr-defined]
        return table
    return {name: value for name, value in table.items() if name in own | used}


def _refers(spec: object) -> bool:
    return spec == "nominal" or (isinstance(spec, number_entries.PriorBase) and spec.relative)


def _published(config: Config) -> list[str]:
    """Names whose nominal value is that of a table, not the config's own."""
    return [name for name in compared(config) if getattr(config.nominal, name) is None]


def tolerance(config: Config) -> dict[str, float]:
    """Of nominal values, relative, of all parameters."""
    given = config.nominal.tolerance  # type: ignore[attr-defined]
    if isinstance(given, float):
        return dict.fromkeys(symbols.PARAMETERS, given)
    own = {name: getattr(given, name) for name in symbols.PARAMETERS}
    return {name: given.default if value is None else value for name, value in own.items()}


def asked(config: Config) -> Asked:
    own = config.identify
    thresholds = Thresholds(determined=own.determined, left_to_prior=own.left_to_prior)
    return Asked(of_interest=tuple(own.of_interest), thresholds=thresholds, seed=config.seed)


def compared_with(config: Config) -> str:
    """What the nominal values are called in sentences."""
    whole = compared(config)
    own = [name for name in whole if getattr(config.nominal, name) is not None]
    if not own:
        return _table(config)
    if len(own) == len(whole):
        return "the config's own values"
    return f"{_table(config)} ({', '.join(own)} as in the config)"


def optimiser(config: Config, unknown: Sequence[str]) -> Optimiser:
    """How the MAP is searched; `unknown` names what there is to search."""
    own = config.map
    found = lookup(OPTIMISERS, own.method, "method")
    if own.method != "pairwise":
        given = [name for name in PAIRWISE if getattr(own, name) is not None]
        if given:
            raise ValueError(f"{own.method} has no `{given[0]}`; remove it, or `method: pairwise`")
        return found
    pairs = [(first, second) for first, second in own.pairs or circle(unknown)]
    for name in (name for pair in pairs for name in pair):
        if name not in unknown:
            raise ValueError(f"'{name}' in `pairs:` is not unknown{did_you_mean(name, unknown)}")
    twice = [first for first, second in pairs if first == second]
    if twice:
        raise ValueError(f"`pairs:` has {twice[0]} with itself; name two different unknowns")
    idle = [name for name in unknown if not any(name in pair for pair in pairs)]
    if idle:
        raise ValueError(f"no pair has {', '.join(idle)}, which would stay at the start; add it")
    return partial(
        found,
        pairs=tuple(pairs),
        iterations=own.iterations or 10,
        steady=own.steady or 0.01,
    )


def si(value: float | number_entries.Quantity, unit: str) -> float:
    if isinstance(value, number_entries.Quantity):
        return value.value * units.factor(value.unit, unit)
    return value


def measured_inputs(config: Config) -> dict[str, InputColumn]:
    every = {name: getattr(config.inputs, name) for name in symbols.INPUTS}
    return {name: spec for name, spec in every.items() if isinstance(spec, InputColumn)}


def constant_inputs(config: Config) -> dict[str, float]:
    """SI."""
    return {
        name: si(getattr(config.inputs, name), symbol.unit)
        for name, symbol in symbols.INPUTS.items()
        if name not in measured_inputs(config)
    }


def initial_state(config: Config, model: Model) -> dict[str, float]:
    """SI."""
    return {
        name: si(getattr(config.initial, name), symbols.STATES[name].unit) for name in model.states
    }


def measured(name: str, spec: ChannelSpec, states: tuple[str, ...]) -> Measured:
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot name a channel; use letters, digits and `_`")
    if name in {*symbols.INPUTS, *symbols.AXES}:
        raise ValueError(f"{name} has a meaning of its own here; choose another name")
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
    begin = start(spec.sigma, built)
    scaled = rescaled(spec.sigma, factor)
    return Measured(channel, factor, prior(scaled, 1.0), begin * factor)


def space(config: Config, model: Model, channels: list[Measured]) -> ParameterSpace:
    """The unknowns: free parameters in the model's order, quantities, then unknown sigmas."""
    table, known = nominal(config), compared(config)
    priors: dict[str, Prior] = {}
    starts: dict[str, float] = {}
    fixed: dict[str, float] = {}
    relations: dict[str, Expression] = {}
    for name in model.parameters:
        spec = getattr(config.parameters, name)
        related = relation(config, model, name)
        if related is not None:
            relations[name] = related
        elif spec == "nominal":
            fixed[name] = table[name]
        elif isinstance(spec, float | int):
            fixed[name] = float(spec)
        else:
            priors[name] = prior(spec, table[name])
            starts[name] = start(spec, priors[name], known.get(name))
    given = {name: quantity(name, spec) for name, spec in config.quantities.items()}
    unknown = [(name, q.value, q.start) for name, q in given.items()]
    unknown += [(f"sigma_{e.channel.name}", e.sigma, e.sigma_start) for e in channels]
    for name, value, begin in unknown:
        if not isinstance(value, float):
            priors[name], starts[name] = value, begin
        elif name in given:
            fixed[name] = value
    relations = resolved(relations)
    for name in [n for n, r in relations.items() if not set(r.names) & set(priors)]:
        fixed[name] = float(relations.pop(name).value(fixed))
    return ParameterSpace(
        model=model.parameters,
        priors=priors,
        fixed=fixed,
        start=starts,
        relations=relations,
        quantities=tuple(given),
    )


def channels(config: Config, model: Model) -> list[Measured]:
    return [measured(name, spec, model.states) for name, spec in config.record.channels.items()]


def problem(config: Config, experiment: Experiment) -> Problem:
    """Everything, for a record already read (`recording.read`)."""
    rig = model(config)
    entries = channels(config, rig)
    unknowns = space(config, rig, entries)
    noise = Gaussian(
        n_samples=len(experiment.t),
        known={k: entry.sigma for k, entry in enumerate(entries) if isinstance(entry.sigma, float)},
        n_channels=len(entries),
    )
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood(Response(rig, experiment), noise, unknowns),
        coordinates=Coordinates(tuple(prior.in_logs for prior in unknowns.priors.values())),
    )
    return Problem(
        posterior=posterior,
        symbols=tuple(_symbol(name, config, entries) for name in unknowns.free),
        nominal=compared(config),
        published=frozenset(_published(config)),
        tolerance=tolerance(config),
        derived=tuple(formula(config, rig, name) for name in config.derived),
    )


def _symbol(name: str, config: Config, entries: list[Measured]) -> symbols.Symbol:
    if name in symbols.PARAMETERS:
        return symbols.PARAMETERS[name]
    if name in config.quantities:
        return quantity(name, config.quantities[name]).symbol
    (channel,) = (e.channel for e in entries if f"sigma_{e.channel.name}" == name)
    return symbols.noise_symbol(channel.name, channel.unit, channel.latex, channel.latex_unit)
