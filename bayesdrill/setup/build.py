"""Config to objects, through the registries: the one place where names become things.

The single steps raise `ValueError` with a message for the user, and `consistency` runs them one
by one to collect all mistakes.  `assembling` puts everything together.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from bayesdrill.basics import symbols, units
from bayesdrill.basics.entries import made
from bayesdrill.basics.errors import did_you_mean
from bayesdrill.basics.expressions import linear_combination
from bayesdrill.basics.formulas import Expression, resolved
from bayesdrill.basics.registry import lookup
from bayesdrill.engines.optimisers import OPTIMISERS
from bayesdrill.engines.optimisers.contract import Optimiser
from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import Noise, Noisy
from bayesdrill.inference.noise.mixed import Mixed
from bayesdrill.inference.noise.mixed import Part as Kind
from bayesdrill.inference.priors import Prior
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.insight.identifiability.study import Asked, Thresholds
from bayesdrill.record.experiment import Channel
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.composed import with_named
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import missing_torque, number_entries, number_objects
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiment_entries import ChannelSpec
from bayesdrill.setup.number_objects import prior, quantity, relation, rescaled, start
from bayesdrill.setup.sensors import Declared

RUBBING_WALKERS = 96
WALKERS_OF_EXPERIMENT = 16  # more: it may bring unknowns of its own


@dataclass(frozen=True, slots=True)
class Measured:
    """How many SI units one unit of a column is, the kind of its noise, and what that has to know."""

    factor: float
    kind: str
    noisy: Noisy

    @property
    def channel(self) -> Channel:
        return self.noisy.channel


def model(config: Config, more: Collection[str] = ()) -> Model:
    """With the constants that the config gives, as far as the model has them, and with what it offers of
    the parameters that the config names, or that are `more`.
    """
    rig = made(lookup(MODELS, config.model.name, "model"), config.model)
    given = config.parameters
    named = [name for name in vocabulary.PARAMETERS if getattr(given, name) is not None]
    return with_named(rig, {*named, *more})


def with_walkers(config: Config) -> Config:
    """Fewer by themselves where the rig rubs: a step of a walker is dear there, and its 256 would tell
    far more than is asked.
    """
    sampler = config.sampler
    if "walkers" in sampler.model_fields_set or not model(config).frictions:
        return config
    walkers = min(
        sampler.walkers, RUBBING_WALKERS + WALKERS_OF_EXPERIMENT * len(config.experiments)
    )
    fewer = sampler.model_copy(update={"walkers": walkers})
    return config.model_copy(update={"sampler": fewer})


def nominal(config: Config) -> dict[str, float]:
    """Nominal values of parameters: those of the table, unless the config says otherwise."""
    table = lookup(symbols.NOMINAL, _table(config), "nominal table")
    own = {name: getattr(config.nominal, name) for name in vocabulary.PARAMETERS}
    return {**table.values, **{name: value for name, value in own.items() if value is not None}}


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


def published(config: Config) -> list[str]:
    """Names whose nominal value is that of a table, not the config's own."""
    return [name for name in compared(config) if getattr(config.nominal, name) is None]


def tolerance(config: Config) -> dict[str, float]:
    """Of nominal values, relative, of all parameters."""
    given = config.nominal.tolerance  # type: ignore[attr-defined]
    if isinstance(given, float):
        return dict.fromkeys(vocabulary.PARAMETERS, given)
    own = {name: getattr(given, name) for name in vocabulary.PARAMETERS}
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
        return "the config's nominal values"
    return f"{_table(config)} ({', '.join(own)} as in the config)"


def optimiser(config: Config) -> Optimiser:
    """How the MAP is searched."""
    return made(lookup(OPTIMISERS, config.map.method, "method"), config.map)


def initial_state(config: Config, model: Model) -> dict[str, float]:
    """What is held of it, SI; of a steady start only what is named."""
    initial = config.initial
    given = {name: getattr(initial, name) for name in model.outer}
    return {
        name: number_objects.si(value, vocabulary.STATES[name].unit)
        for name, value in given.items()
        if isinstance(value, float | int | number_entries.Quantity)
        and (initial.state != "steady" or name in initial.model_fields_set)
    }


def measured(name: str, spec: ChannelSpec, states: tuple[str, ...]) -> Measured:
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot name a channel; use letters, digits and `_`")
    if name not in states and name in {*symbols.INPUTS, *symbols.AXES}:
        raise ValueError(f"{name} has a meaning of its own here; choose another name")
    if spec.measures is None and name not in states:
        raise ValueError(
            f"'{name}' is not a state{did_you_mean(name, states)}; name the states it combines, for "
            "example `measures: theta_1 - theta_2`"
        )
    weights = linear_combination(spec.measures or name, states)
    found = [vocabulary.STATES[state] for state in weights]
    if len({symbol.unit for symbol in found}) > 1:
        listed = ", ".join(f"{symbol.name} [{symbol.unit}]" for symbol in found)
        raise ValueError(f"'{spec.measures}' adds different units: {listed}")
    first = found[0]
    factor = units.factor(spec.unit, first.unit)
    latex = first.latex if name in states else rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"
    channel = Channel(
        name=name, weights=weights, unit=first.unit, latex=latex, latex_unit=first.latex_unit
    )
    sigma, begin = _sigma(spec, factor)
    kind, entries = spec.noise.name, spec.noise.model_dump(exclude={"name"})
    noisy = Noisy(channel=channel, sigma=sigma, start=begin, entries=entries, factor=factor)
    return Measured(factor, kind, noisy)


def _sigma(spec: ChannelSpec, factor: float) -> tuple[float | Prior, float]:
    """Of the noise, SI, and where a search begins."""
    if isinstance(spec.sigma, float):
        return spec.sigma * factor, spec.sigma * factor
    if spec.sigma.relative:
        raise ValueError("sigma has no nominal value; write its prior in the unit of the column")
    begin = start(spec.sigma, prior(spec.sigma, 1.0))
    return prior(rescaled(spec.sigma, factor), 1.0), begin * factor


def space(
    config: Config,
    model: Model,
    noise: Sequence[Unknown],
    told: Sequence[Declared] = (),
    labels: Sequence[str] = (),
) -> ParameterSpace:
    """The unknowns: free parameters in the model's order, quantities, sensors and starts as they are
    `told`, then those of the `noise`.  What is `own` is there once for each of the `labels`.
    """
    table, known = nominal(config), compared(config)
    unknowns: list[Unknown] = []
    fixed: dict[str, float] = {}
    relations: dict[str, Expression] = {}
    for name in model.parameters:
        spec = getattr(config.parameters, name)
        related = relation(config, model, name)
        if related is not None:
            relations[name] = related
        elif spec == "nominal":
            if name not in table:
                raise ValueError(f"no table has {name}")
            fixed[name] = table[name]
        elif isinstance(spec, float | int):
            fixed[name] = float(spec)
        else:
            built = prior(spec, table.get(name))
            begin = start(spec, built, known.get(name))
            one = Unknown(symbol=vocabulary.PARAMETERS[name], role="rig", prior=built, start=begin)
            several = labels if name in config.own else [""]
            unknowns += [one.of(label) for label in several]
    for name, given in ((n, quantity(n, spec)) for n, spec in config.quantities.items()):
        if isinstance(given.value, float):
            fixed[name] = given.value
        else:
            symbol, own = given.symbol, given.value
            unknowns.append(Unknown(symbol=symbol, role="quantity", prior=own, start=given.start))
    relations, free = resolved(relations), {unknown.name for unknown in unknowns}
    for name in [n for n, r in relations.items() if not set(r.names) & free]:
        fixed[name] = float(relations.pop(name).value(fixed))
    for each in told:
        if isinstance(each.value, float):
            fixed[each.name] = each.value
        else:
            unknowns.append(
                Unknown(symbol=each.symbol, role=each.role, prior=each.value, start=each.start)
            )
    rig = [n for n in dict.fromkeys(local_names(config, model, labels)) if n]
    return ParameterSpace(
        model=(*rig, *(each.name for each in told)),
        unknowns=(*unknowns, *noise),
        fixed=fixed,
        relations=relations,
    )


def local_names(config: Config, model: Model, labels: Sequence[str]) -> list[str]:
    """Of the rig's parameters, what is own once for each label."""
    return [
        of_label(name, label)
        for name in model.parameters
        for label in (labels if name in config.own else [""])
    ]


def noise(channels: Sequence[Measured], n_samples: int) -> Noise:
    """Of all channels: one of a kind, or a mixture of kinds."""
    kinds: dict[str, list[int]] = {}
    for k, one in enumerate(channels):
        kinds.setdefault(one.kind, []).append(k)
    parts = [
        Kind(lookup(NOISES, kind, "noise").of([channels[k].noisy for k in own], n_samples), (*own,))
        for kind, own in kinds.items()
    ]
    return parts[0].noise if len(parts) == 1 else Mixed(tuple(parts))


def scatter(config: Config, channels: Sequence[Measured], n_samples: int) -> tuple[Unknown, ...]:
    """Unknowns of the noise of all channels, and of what shakes the rig."""
    return (*noise(channels, n_samples).unknowns, *missing_torque.unknowns(config))


def channels(config: Config, model: Model) -> list[Measured]:
    """Those that are evidence: what is only derived from another is not."""
    every = config.record.channels.items()
    return [measured(name, spec, model.outer) for name, spec in every if spec.derived_from is None]
